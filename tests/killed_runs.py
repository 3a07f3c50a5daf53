"""Runs that are killed at one write after the other, each in a forked process: `python -m tests.killed_runs FOLDER`.

The tracker is a stub, because JAX cannot be forked; everything that is written is real. Prints JSON: how many writes a
run has, at which of them a killed run did not resume to the same arrays, and what was left behind.
"""

import json
import os
import shutil
import signal
import sys
from pathlib import Path

import numpy as np

from workbench.config import preset
from workbench.face import FaceModel
from workbench.face.jaw_unit import USUAL_JAW
from workbench.geometry import Camera
from workbench.landmarks.scheme import IBUG68
from workbench.pipeline import track
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit, Track, track_writer

FRAMES = 5
WRITES = {"os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.chmod", "shutil.rmtree"}
"""Events of Python's audit hooks that change the folder; files opened for writing count too."""


class StubModel(FaceModel):
    """As much of a face model as a run without pictures looks at."""

    name, expression_names, fixed_jaw_unit, scheme = "stub", ("smile", "frown"), USUAL_JAW, IBUG68

    def __init__(self):
        """Nothing of a real model."""

    def fingerprint(self) -> str:
        return "stub"


class StubTracker(FaceTracker):
    """Numbers that depend on all frames before, so that a run that goes on from a wrong place shows it."""

    def __init__(self, model, config, stills=False):
        self._sum = np.zeros(2)

    def warm_up(self, image_size) -> None:
        """Nothing to compile."""

    def push(self, observation) -> list[FrameFit]:
        self._sum = 0.5 * self._sum + observation.landmarks.points[:1].ravel()
        return [make_fit(observation.index, self._sum)]

    def finish(self) -> list[FrameFit]:
        return []

    def state(self) -> dict[str, np.ndarray]:
        return {"sum": self._sum}

    def restore(self, state) -> None:
        self._sum = state["sum"]


def make_fit(index: int, numbers) -> FrameFit:
    """A fit whose every frame says which one it is."""
    points = np.arange(136.0).reshape(68, 2) + index
    return FrameFit(
        index=index, found=True, shot=0, source="given", image_size=(640, 480),
        camera=Camera(np.full(2, 900.0), np.full(2, 300.0), np.zeros(8)),
        rotation=np.zeros(3), translation=np.array([0.0, 0.0, 600.0]), expression=np.asarray(numbers, float),
        identity=np.zeros(1), observed=points, confidence=np.ones(68), projected=points + 1.0,
        energies=np.zeros((1, 1)), status=np.zeros(1, int), iterations=np.ones(1, int), milliseconds=np.ones(3),
    )  # fmt: skip


def run(points: Path, folder: Path) -> None:
    """Begin a run or go on with it."""
    track(points, folder, StubModel(), preset("calibrated"), pictures=False, resume=True)


def killed_at(write: int, points: Path, folder: Path) -> bool:
    """Run in a forked process that dies without a trace at this write; whether it did, False if it had fewer."""
    child = os.fork()
    if not child:
        _die_at(write, folder)
        run(points, folder)
        os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def _die_at(write: int, folder: Path) -> None:
    seen = 0

    def count() -> None:
        nonlocal seen
        seen += 1
        if seen == write:
            os.kill(os.getpid(), signal.SIGKILL)

    def hook(event: str, arguments: tuple) -> None:
        written = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if (event in WRITES or written) and str(folder) in str(arguments[0]):
            count()

    def half_written(stream, array, **options):
        if array.shape[1:] == (68, 2):
            count()
        return write_array(stream, array, **options)

    sys.addaudithook(hook)
    # In the middle of a part, too.
    write_array, np.lib.format.write_array = np.lib.format.write_array, half_written


def main(home: Path) -> None:
    """Kill a run at its first, second, ... write until one of them ends; resume each."""
    track_writer.PART_FRAMES = 3
    points = home / "points.csv"
    run(points, home / "whole")
    whole = Track.load(home / "whole" / "track.npz")
    names = sorted(path.name for path in (home / "whole").iterdir())
    write, unequal, left = 1, [], {}
    while killed_at(write, points, home / "cut"):
        run(points, home / "cut")
        resumed = Track.load(home / "cut" / "track.npz")
        if not all(np.array_equal(vars(resumed)[name], vars(whole)[name]) for name in track_writer.ARRAYS):
            unequal.append(write)
        more = sorted({path.name for path in (home / "cut").iterdir()} ^ set(names))
        left |= {write: more} if more else {}
        shutil.rmtree(home / "cut")
        write += 1
    print(json.dumps({"writes": write - 1, "unequal": unequal, "left": left}))


if __name__ == "__main__":
    import workbench.pipeline.runs

    workbench.pipeline.runs.FaceTracker = StubTracker
    workbench.pipeline.runs.software_versions = dict  # the same each time, and slow
    main(Path(sys.argv[1]))
