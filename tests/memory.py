"""A long run in little memory: compiled programs are let go between files once a process has grown large."""

import ctypes
import gc
import sys

import psutil

LARGE = max(2_000_000_000, psutil.virtual_memory().total // 5)
"""Bytes of a process that holds many programs. Those of one file take 0.3 to 0.7 GB; 1.7 GB are never freed."""


def let_go_of_programs(large: int = LARGE) -> bool:
    """Free JAX's programs if this process is larger than `large` bytes; whether it was.

    They come back from the cache on disk when they are needed again, for some seconds of tracing.
    """
    if "jax" not in sys.modules or psutil.Process().memory_info().rss <= large:
        return False
    sys.modules["jax"].clear_caches()
    gc.collect()
    # What the compiler freed stays with the process until it is asked for.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    return True
