"""Seconds from starting Python to the first fitted frame, without and with stored compiled programs."""

import argparse
import os
import subprocess
import sys
import tempfile
import time

from result import print_result

WARM_RUNS = 3


def main() -> None:
    """Fit one frame in fresh processes that share one compilation cache, empty at first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fit", action="store_true", help="fit one frame and stop")
    if parser.parse_args().fit:
        return fit_one_frame()
    with tempfile.TemporaryDirectory() as cache:
        cold = seconds_to_first_fit(cache)
        warm = sorted(seconds_to_first_fit(cache) for _ in range(WARM_RUNS))[WARM_RUNS // 2]
    details = {"warm_seconds": warm, "preset": "calibrated"}
    print_result("compile_time", cold, "s", None, "an empty compilation cache", details)


def seconds_to_first_fit(cache: str) -> float:
    """Wall time of a fresh process that fits one frame, compiled programs kept in `cache`."""
    # JAX leaves out small programs unless told otherwise; the package does so only for its own cache folder.
    environment = os.environ | {
        "JAX_COMPILATION_CACHE_DIR": cache,
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    began = time.perf_counter()
    subprocess.run([sys.executable, __file__, "--fit"], check=True, env=environment)
    return time.perf_counter() - began


def fit_one_frame() -> None:
    """Calibrate the identity on one frame and fit it, as the start of a run does."""
    from synthetic_clip import synthetic_clip

    from workbench.config import preset
    from workbench.tracker import FaceTracker

    clip = synthetic_clip(1)
    tracker = FaceTracker(clip.head, preset("calibrated"))
    fits = tracker.push(clip.observation(0)) + tracker.finish()
    if len(fits) != 1:
        raise RuntimeError(f"one frame went in and {len(fits)} fits came out")


if __name__ == "__main__":
    main()
