"""Runs that are killed, at random moments and in the middle of writes, and resumed: how many give equal arrays."""

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from result import print_result

FRAMES, PART_FRAMES = 300, 16
"""Many parts, so that many moments fall into their writing."""
WRITES = {"os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.chmod", "shutil.rmtree"}


def main() -> None:
    """Kill and resume runs of `workbench track` on a landmark file, and print how many came out as if left alone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--random", type=int, default=40, help="kills at random moments")
    parser.add_argument("--placed", type=int, default=20, help="kills in the middle of writes")
    parser.add_argument("--run", nargs=2, type=Path, metavar=("FILE", "FOLDER"), help="one run; then stop")
    parser.add_argument("--die-at", type=int, default=0, help="with --run: the write to die at")
    arguments = parser.parse_args()
    if arguments.run:
        return run(*arguments.run, arguments.die_at)
    rng = random.Random(12)
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        write_landmarks(home / "clip.csv")
        start(home, "whole").wait()  # compiles
        began = time.perf_counter()
        writes = int(start(home, "whole2", capture=True).communicate()[0].split()[-1])
        seconds = time.perf_counter() - began
        kills = [("random", rng.uniform(0.1, 1.0) * seconds) for _ in range(arguments.random)]
        kills += [("placed", rng.randint(1, writes)) for _ in range(arguments.placed)]
        equal, killed = 0, 0
        for kind, moment in kills:
            died, same = kill_and_resume(home, kind, moment)
            killed, equal = killed + died, equal + same
            print(
                f"{kind} {moment:.4g}: {'killed' if died else 'ended before'}, {'equal' if same else 'DIFFERENT'}",
                flush=True,
            )
    details = {"random": arguments.random, "placed": arguments.placed, "died_in_time": killed, "writes": writes}
    print_result("kills", equal / len(kills), "of the runs", ">= 1", "a run that is left alone", details)


def kill_and_resume(home: Path, kind: str, moment: float) -> tuple[bool, bool]:
    """Whether the run died before it ended, and whether it came out like the whole one when resumed."""
    folder = home / "cut"
    process = start(home, "cut", die_at=int(moment) if kind == "placed" else 0)
    if kind == "random":
        try:
            process.wait(moment)
        except subprocess.TimeoutExpired:
            process.kill()
    died = process.wait() == -signal.SIGKILL
    resumed = start(home, "cut").wait() == 0
    same = resumed and equal_tracks(home / "whole" / "track.npz", folder / "track.npz")
    same = same and {path.name for path in folder.iterdir()} == {path.name for path in (home / "whole").iterdir()}
    shutil.rmtree(folder)
    return died, same


def equal_tracks(first: Path, second: Path) -> bool:
    """Whether all arrays are equal to the last bit; times and metadata do not count."""
    with np.load(first) as one, np.load(second) as other:
        names = set(one.files) - {"milliseconds", "meta"}
        return all(np.array_equal(one[name], other[name], equal_nan=one[name].dtype.kind == "f") for name in names)


def start(home: Path, folder: str, die_at: int = 0, capture: bool = False) -> subprocess.Popen:
    """Begin a run, or go on with it, in a process of its own."""
    command = [sys.executable, __file__, "--run", str(home / "clip.csv"), str(home / folder), "--die-at", str(die_at)]
    return subprocess.Popen(command, stdout=subprocess.PIPE if capture else subprocess.DEVNULL, text=True)


def run(landmarks: Path, folder: Path, die_at: int) -> None:
    """Track with resume; print how many writes there were."""
    from workbench.config import preset
    from workbench.face import load_default_head
    from workbench.pipeline import track
    from workbench.tracking import track_writer

    track_writer.PART_FRAMES = PART_FRAMES
    model, writes = load_default_head(), [0]

    def count(event: str, arguments: tuple) -> None:
        written = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if (event in WRITES or written) and str(folder) in str(arguments[0]):
            writes[0] += 1
            if writes[0] == die_at:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(count)
    track(landmarks, folder, model, preset("calibrated"), pictures=False, resume=True)
    print(writes[0])


def write_landmarks(file: Path) -> None:
    """The synthetic clip's landmarks."""
    from synthetic_clip import IMAGE_SIZE, synthetic_clip

    from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord

    clip = synthetic_clip(FRAMES)
    with LandmarkCsvWriter(file) as writer:
        for frame in range(FRAMES):
            writer.write(LandmarkRecord(frame, f"{frame}", clip.observation(frame).landmarks, IMAGE_SIZE))


if __name__ == "__main__":
    main()
