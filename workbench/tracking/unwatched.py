"""Work that nobody watches: the defaults of what is called while a clip is fitted."""


def never() -> bool:
    """The default for `cancelled`: never cancel."""
    return False


def silent(step: str, done: int, total: int | None) -> None:
    """The default for `progress`: nobody watches."""
