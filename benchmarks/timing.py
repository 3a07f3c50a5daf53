"""Times of compiled programs."""

import time
from collections.abc import Callable

import jax


def least_ms(run: Callable, repeats: int) -> float:
    """Milliseconds of the quickest of some calls, after one that compiles."""
    jax.block_until_ready(run())
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(run())
        times.append(time.perf_counter() - began)
    return 1e3 * min(times)
