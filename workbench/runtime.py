"""How JAX runs here: double precision for the solves, and compiled programs kept between sessions."""

import os
import threading
from pathlib import Path

import jax

COMPUTING = threading.RLock()
"""Held while a large compiled program runs. XLA splits such a program over a pool of one thread a core; two programs
at once, called from two threads, can fill the pool with parts that wait for each other, and then wait for ever."""


def cache_folder() -> Path:
    """Folder of compiled programs and other things that can be made again."""
    base = os.environ.get("WORKBENCH_CACHE") or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "face-energy-workbench"


def configure_jax() -> None:
    """Switch on float64 and the persistent compilation cache, leaving what the user has set himself.

    A float32 Levenberg–Marquardt diverges on E_β, whose slope at the bounds is about 40,000. The cache keeps even
    small programs (JAX skips those under a second by default), so a second start of a notebook compiles nothing.
    """
    jax.config.update("jax_enable_x64", True)
    # A call returns when its result is there, so that `COMPUTING` covers the whole run.
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    if jax.config.jax_compilation_cache_dir is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_folder() / "jax"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
