"""Training the networks on renders of the package's own heads (extra `[train]`)."""
