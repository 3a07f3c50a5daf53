"""Training the landmark network on renders of the package's own heads (extra `[train]`)."""
