"""How much faster two workers sweep over many short clips than one; the details have what the plan's model says.

Workers are warm, and each run has a folder of its own, so that nothing is done before. Beside the clock stands what the
workers' processors were busy: where other work takes the cores, only that says how evenly the work was shared out.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import psutil
from cluster_plan import Machine, Work, simulated
from result import print_result

from workbench.config import preset
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, read_landmark_file
from workbench.samples import sample
from workbench.sweeps import Sweep, read_axis, run_sweep, sources_of
from workbench.workers import Pool, Workers, workers_for

CLIPS, FRAMES, SETTINGS = 40, 48, 12
MOST_ROUNDS, LEAST_S = 20, 0.1
"""To warm up; processor time of a worker that has done a task."""


def main() -> None:
    """Measure with one worker, then with two, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--backend", choices=("pool", "dask"), default="pool")
    backend = parser.parse_args().backend
    with tempfile.TemporaryDirectory() as folder:
        clips = short_clips(Path(folder))
        runs = {count: measured(clips, count, backend, Path(folder)) for count in (1, 2)}
    busy = {count: sum(processors) for count, (_, processors) in runs.items()}
    task = busy[1] / CLIPS
    modelled = {
        count: simulated(Work(CLIPS, task, spread=0.1), Machine(workers=count, hand_out_s=0.005)).seconds
        for count in (1, 2)
    }
    details = {
        "backend": backend,
        "seconds": {count: seconds for count, (seconds, _) in runs.items()},
        "processor_seconds": {count: processors for count, (_, processors) in runs.items()},
        "speed_up_by_processor_time": busy[1] / max(runs[2][1]),
        "speed_up_of_the_model": modelled[1] / modelled[2],
    }
    print_result("sweep_scaling", runs[1][0] / runs[2][0], "times as fast", ">= 1.8", "one worker", details)


def short_clips(folder: Path) -> list[str]:
    """Landmark files of pieces of the sample clip."""
    rows, made = list(read_landmark_file(sample("performance-landmarks"))), []
    for k in range(CLIPS):
        path = folder / f"clip{k}.csv"
        with LandmarkCsvWriter(path, confidence=True) as writer:
            for index in range(FRAMES):
                record = rows[(5 * k + index) % len(rows)]
                writer.write(LandmarkRecord(index, "", record.landmarks, record.landmarks.image_size))
        made.append(str(path))
    return made


def measured(clips: list[str], count: int, backend: str, folder: Path) -> tuple[float, list[float]]:
    """Seconds of a sweep by the clock, and processor seconds of each worker in it."""
    axes, base = (read_axis(f"weights.tau=log(1e-3,10,{SETTINGS})"),), preset("joint")
    workers = workers_for(count, kind=backend) if backend == "dask" else Pool(count)  # a pool even of one
    try:
        warm = Sweep(sources_of(clips[: 4 * count]), axes, base, objectives=("error",))
        warm_up(workers, lambda k: run_sweep(warm, folder / f"warm{count}-{k}", workers))
        before = processor_seconds()
        began = time.perf_counter()
        run_sweep(Sweep(sources_of(clips), axes, base, objectives=("error", "jitter")), folder / f"run{count}", workers)
        seconds = time.perf_counter() - began
        after = processor_seconds()
    finally:
        workers.close()
    return seconds, sorted(after[pid] - before.get(pid, 0.0) for pid in after)[-count:]


def warm_up(workers: Workers, work: Callable[[int], object]) -> None:
    """Do work until every worker has had some of it twice: it loads and compiles in its first task."""
    times = dict.fromkeys(range(workers.count), 0)
    for k in range(MOST_ROUNDS):
        before = processor_seconds()
        work(k)
        busy = sorted(seconds - before.get(process, 0.0) for process, seconds in processor_seconds().items())
        times = {n: times[n] + (spent > LEAST_S) for n, spent in enumerate(busy[-workers.count :])}
        if min(times.values()) >= 2:
            return
    raise SystemExit(f"After {MOST_ROUNDS} rounds some of {workers.count} workers have not worked twice.")


def processor_seconds() -> dict[int, float]:
    """Of each child process."""
    found = {}
    for child in psutil.Process().children(recursive=True):
        times = child.cpu_times()
        found[child.pid] = times.user + times.system
    return found


if __name__ == "__main__":
    main()
