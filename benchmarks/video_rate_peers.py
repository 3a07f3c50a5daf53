"""A video file to a track beside MediaPipe's face mesh on the same frames: processor and wall time of a frame.

Ours are pose, weights and identity with the detector `network`, and the same under the presets `gaze` and `dense`,
tables and track written; MediaPipe's are points alone. All decode the file themselves, in turns, and the quickest of
some rounds counts. MediaPipe needs not be in this environment: `--python` names an interpreter that has it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from result import print_result

from workbench.config import Config, preset
from workbench.face import FaceModel, load_default_head
from workbench.pipeline import track
from workbench.samples import samples_folder

GOAL, DENSE_GOAL = "<= 1.5", "<= 2"
ROUNDS = 5
PEER = Path(__file__).parent / "peers" / "mediapipe_rate.py"
AGAINST = "MediaPipe's face mesh, processor time"


@dataclass(frozen=True)
class Rate:
    """How long a frame takes, and how many there were."""

    wall_ms: float
    processor_ms: float
    frames: int
    frames_with_face: int


def main() -> None:
    """Print our processor time of a frame as a multiple of MediaPipe's."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("video", nargs="?", type=Path, default=samples_folder() / "performance.mp4")
    parser.add_argument("--python", default=sys.executable, help="an interpreter that can import mediapipe")
    options = parser.parse_args()
    probe = subprocess.run([options.python, "-c", "import mediapipe"], capture_output=True, text=True)
    if probe.returncode:
        reason = "MediaPipe is not installed; pip install mediapipe==0.10.21 elsewhere and pass --python"
        return print_result("video_rate_peers", None, "times as long", GOAL, AGAINST, {"skipped": reason})
    head = load_default_head()
    ours = preset("calibrated").changed(landmarks={"detector": "network"})
    configs = {"ours": ours, "gaze": preset("gaze"), "dense": preset("dense")}
    for config in configs.values():
        our_rate(options.video, head, config)  # compiles
    rounds = [
        (
            *(our_rate(options.video, head, config) for config in configs.values()),
            peer_rate(options.video, options.python),
        )
        for _ in range(ROUNDS)
    ]
    best = dict(
        zip((*configs, "mediapipe"), (quickest(list(rates)) for rates in zip(*rounds, strict=True)), strict=True)
    )
    theirs = best["mediapipe"]
    details = {"video": options.video.name} | {name: asdict(rate) for name, rate in best.items()}
    for name in ("gaze", "dense"):
        details[f"{name}, times as long"] = {
            "processor": best[name].processor_ms / theirs.processor_ms,
            "wall": best[name].wall_ms / theirs.wall_ms,
            "goal": DENSE_GOAL,
        }
    ratio = best["ours"].processor_ms / theirs.processor_ms
    print_result("video_rate_peers", ratio, "times as long", GOAL, AGAINST, details)


def our_rate(video: Path, head: FaceModel, config: Config) -> Rate:
    """One run of the pipeline, from opening the file to the last table."""
    wall, processor = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        summary = track(video, folder, head, config, pictures=False).summary
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    frames = summary["frames"]
    return Rate(1e3 * wall / frames, 1e3 * processor / frames, frames, summary["frames_with_face"])


def peer_rate(video: Path, interpreter: str) -> Rate:
    """One run of MediaPipe, in a process of its own."""
    done = subprocess.run([interpreter, PEER, video], capture_output=True, text=True, check=True)
    return Rate(**json.loads(done.stdout))


def quickest(rates: list[Rate]) -> Rate:
    """The least of each time: on a busy machine the others tell of the machine."""
    wall, processor = (min(getattr(rate, name) for rate in rates) for name in ("wall_ms", "processor_ms"))
    return Rate(wall, processor, rates[0].frames, rates[0].frames_with_face)


if __name__ == "__main__":
    main()
