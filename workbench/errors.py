"""Errors that a user can fix: one sentence that says what was expected, what was found, and what to do."""


class WorkbenchError(Exception):
    """Base of every error that the workbench raises on purpose; the command line prints it and exits with 2."""


class InputError(WorkbenchError, ValueError):
    """A picture, video, landmark file or array that cannot be used as it is."""


class ModelError(WorkbenchError, ValueError):
    """A face model whose parts are missing or do not belong together."""


class ConfigError(WorkbenchError, ValueError):
    """A configuration with unknown keys or values out of range."""


class OutputError(WorkbenchError, OSError):
    """A file or folder that cannot be written, or that must not be: it is an input, or holds another run."""


class LostSchedulerError(OutputError):
    """A scheduler or workers of a cluster that cannot be reached any more; what was done is kept."""


class StoppedError(WorkbenchError):
    """Work that was cancelled before it had a result; nothing has changed."""


class WorkbenchWarning(UserWarning):
    """What a user should know of a result that was made all the same; the command line prints it as a note."""


class MissingDependencyError(WorkbenchError, ImportError):
    """An optional package that is needed for what was asked."""
