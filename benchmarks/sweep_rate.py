"""Fits a second of a sweep against one by one, and how two workers scale: `python -m benchmarks.sweep_rate`.

One by one is a whole run of the session for each setting, as a loop over settings would do it. The batch is the same
fits by `ClipSolver` in this process, and by a pool of processes; all in one run. Beside the clock stands the processor
time, which other work on the machine does not lengthen as much.
"""

import argparse
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from workbench.config import preset
from workbench.face import load_default_head
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, read_landmark_file
from workbench.samples import sample
from workbench.session import open_session
from workbench.sweeps import ClipSolver, Sweep, SweptClip, read_axis, run_sweep, sources_of, workers_for

SETTINGS = 16
FRAMES = 60
CLIPS = 40
CLIP_FRAMES = 48


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scaling", action="store_true", help="measure 1 and 2 workers on 40 short clips")
    parser.add_argument("--preset", default="joint")
    asked = parser.parse_args()
    if asked.scaling:
        scaling(asked.preset)
    else:
        rates(asked.preset)


def rates(name: str) -> None:
    """One by one, batched in one process, batched in two."""
    head, base = load_default_head(), preset(name).changed(camera={"fov_deg": 33.0})
    session = open_session(sample("performance-landmarks"), base, head)
    clip = SweptClip("clip", "benchmark", session.material.observations, False)
    configs = [base.changed(weights={"tau": float(tau)}) for tau in np.geomspace(1e-3, 10.0, SETTINGS)]
    windows = [range(60 * k, 60 * k + FRAMES) for k in range(4)]
    fits = SETTINGS * 4 * FRAMES
    solver = ClipSolver(head)
    solver.fits(configs[:1], clip, windows[:1])
    session.fit_clip(config=configs[0])
    alone = timed("one by one", lambda: [session.fit_clip(config=config) for config in configs], fits)
    together = timed("batched, one process", lambda: solver.fits(configs, clip, windows), fits)
    print(f"per processor second, batched / one by one: {alone[1] / together[1]:.2f}")
    with Pair() as pair:
        pair.sweep(name, 1)
        both = pair.sweep(name, SETTINGS * 2)
    print(f"two processes: {both:.0f} fits/s by the clock, {both * alone[0] / fits:.2f} × one by one")


def timed(label: str, work: Callable, fits: int) -> tuple[float, float]:
    """Prints and returns seconds by the clock and of the processor."""
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(f"{label}: {fits / wall:.0f} fits/s by the clock, {fits / cpu:.0f} per processor second")
    return wall, cpu


class Pair:
    """Two warm processes that sweep."""

    def __enter__(self):
        self.folder = Path(tempfile.mkdtemp())
        self.workers = workers_for(2, kind="pool")
        return self

    def __exit__(self, *error):
        self.workers.close()
        shutil.rmtree(self.folder)

    def sweep(self, name: str, points: int) -> float:
        """Fits a second of a sweep over the sample clip."""
        base = preset(name).changed(camera={"fov_deg": 33.0})
        axes = (read_axis(f"weights.tau=log(1e-3,{10 + points},{max(2, points)})"),)
        sweep = Sweep(sources_of([str(sample("performance-landmarks"))]), axes, base, objectives=("error", "jitter"))
        began, first = time.perf_counter(), []

        def progress(step, done, total):
            if step == "fits" and not first:
                first.append(time.perf_counter())

        result = run_sweep(sweep, self.folder / str(points), self.workers, progress=progress)
        fits = sum(values.shape[1] for values in result.values.values())
        return fits / (time.perf_counter() - first[0] if first else time.perf_counter() - began)


def scaling(name: str) -> None:
    """The same sweep over many short clips with one worker and with two, each warm."""
    rows = list(read_landmark_file(sample("performance-landmarks")))
    with tempfile.TemporaryDirectory() as folder:
        clips = []
        for k in range(CLIPS):
            path = Path(folder) / f"clip{k}.csv"
            with LandmarkCsvWriter(path, confidence=True) as writer:
                for index in range(CLIP_FRAMES):
                    record = rows[(5 * k + index) % len(rows)]
                    writer.write(LandmarkRecord(index, "", record.landmarks, record.landmarks.image_size))
            clips.append(str(path))
        axes = (read_axis("weights.tau=log(1e-3,10,12)"),)
        spent = {}
        for count in (1, 2):
            workers = workers_for(count, kind="pool")
            try:
                warm = Sweep(sources_of(clips[: 2 * count]), axes, preset(name), objectives=("error",))
                run_sweep(warm, Path(folder) / f"warm{count}", workers)
                began = time.perf_counter()
                run_sweep(Sweep(sources_of(clips), axes, preset(name)), Path(folder) / f"s{count}", workers)
                spent[count] = time.perf_counter() - began
            finally:
                workers.close()
            print(f"{count} worker(s): {spent[count]:.1f} s for {CLIPS} clips of {CLIP_FRAMES} frames, 12 settings")
        print(f"two workers are {spent[1] / spent[2]:.2f} × as fast as one")


if __name__ == "__main__":
    main()
