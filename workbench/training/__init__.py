"""Training the networks on renders of the package's own heads (extra `[train]`)."""

PLAN_FILE = "plan.json"
"""The plan of a training, beside its checkpoints: a folder that holds one is a training's."""
