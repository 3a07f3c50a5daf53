"""A disk that is full after some bytes."""

from contextlib import contextmanager


@contextmanager
def small_disk(most_bytes):
    """No file can grow above this: the system's answer is that of a full disk in another word."""
    import resource  # not on Windows

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
