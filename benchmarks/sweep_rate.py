"""Fits a second of a sweep on two processes as a multiple of fits one by one, both in the same run.

One by one is what a loop over settings does: a whole run of the session for each. The sweep makes the same fits. Beside
the clock stands processor time, which other work on the machine lengthens less.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from result import print_result
from sweep_scaling import processor_seconds, warm_up

from workbench.config import preset
from workbench.face import load_default_head
from workbench.samples import sample
from workbench.session import open_session
from workbench.sweeps import ClipSolver, Sweep, SweptClip, read_axis, run_sweep, sources_of
from workbench.workers import workers_for

SETTINGS = 64
BASE = preset("joint").changed(camera={"fov_deg": 33.0})
OBJECTIVES = ("error", "jitter")


def main() -> None:
    """Measure in turn and print."""
    head, clip_file = load_default_head(), sample("performance-landmarks")
    session = open_session(clip_file, BASE, head)
    clip = SweptClip("clip", "benchmark", session.material.observations, False)
    configs = [BASE.changed(weights={"tau": float(tau)}) for tau in np.geomspace(1e-3, 10.0, SETTINGS)]
    fits = SETTINGS * len(session)
    solver = ClipSolver(head)
    solver.fits(configs[:1], clip, clip.shots)
    session.fit_clip(config=configs[0])
    alone = spent(lambda: [session.fit_clip(config=config) for config in configs])
    together = spent(lambda: solver.fits(configs, clip, clip.shots))
    workers = workers_for(2, kind="pool")
    try:
        with tempfile.TemporaryDirectory() as folder:
            warm_up(workers, lambda k: run_sweep(swept(f"{k + 1}e-4,1", 16), Path(folder) / f"warm{k}", workers))
            before = processor_seconds()
            both, _ = spent(lambda: run_sweep(swept("1e-3,10", SETTINGS), Path(folder) / "sweep", workers))
            busy = [seconds - before.get(process, 0.0) for process, seconds in processor_seconds().items()]
    finally:
        workers.close()
    details = {
        "fits": fits,
        "one_by_one_per_s": fits / alone[0],
        "one_by_one_per_processor_s": fits / alone[1],
        "batched_in_one_process_per_s": fits / together[0],
        "batched_per_processor_s": fits / together[1],
        "batched_by_processor_time": alone[1] / together[1],
        "two_processes_per_s": fits / both,
        "two_processes_by_processor_time": alone[1] / max(busy),
    }
    against = "the same fits one by one in the same run"
    print_result("sweep_rate", alone[0] / both, "times the rate", ">= 4", against, details)


def swept(ends: str, count: int) -> Sweep:
    """A sweep of ω_τ over the sample clip."""
    axis = read_axis(f"weights.tau=log({ends},{count})")
    return Sweep(sources_of([str(sample("performance-landmarks"))]), (axis,), BASE, objectives=OBJECTIVES)


def spent(work: Callable) -> tuple[float, float]:
    """Seconds by the clock, and of this process's processor time."""
    wall, processor = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - wall, time.process_time() - processor


if __name__ == "__main__":
    main()
