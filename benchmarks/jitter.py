"""How much of a clip's jitter is the head's own: its angles from frame to frame, by two independent detectors.

The mean second difference of yaw, pitch and roll under `dense`, degrees, beside what dlib's 68 points under `joint` see
as well (`shared`: from their covariance, in the same measure for a normal distribution). The two detectors share
neither weights nor training, so what agrees is mostly motion, and an upper bound of it: what misleads both, such as an
expression that is taken for a turn, is shared too. Without clips the bundled one is taken, whose true motion is known.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import Float
from result import print_result

from workbench.config import Config, preset
from workbench.errors import MissingDependencyError
from workbench.face import load_default_head
from workbench.landmarks.detectors import make_detector
from workbench.pipeline import track
from workbench.reproduction.rendered_clip import clip_truth
from workbench.samples import sample
from workbench.tracking import Track

GOAL = "<= 0.25"
MEAN_PER_RMS = np.sqrt(2 / np.pi)
"""Mean absolute value of a normal distribution of unit variance."""


def main() -> None:
    """Track each clip by both, and print the worst clip's jitter."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clips", nargs="*", type=Path)
    clips = parser.parse_args().clips
    try:
        make_detector("dlib")
    except MissingDependencyError as error:
        return print_result("jitter", None, "degrees", GOAL, "what dlib sees as well", {"skipped": str(error)})
    rows = {clip.stem: judged(clip) for clip in clips or [sample("performance")]}
    if not clips:
        truth = second_differences(clip_truth().angles_deg)
        rows["performance"]["true"] = float(np.abs(truth).mean())
    worst = max(row["dense"] for row in rows.values())
    print_result("jitter", worst, "degrees", GOAL, "what dlib sees as well", rows)


def judged(clip: Path) -> dict[str, float]:
    """Jitter by either detector, and what both see."""
    configs = {
        "dense": preset("dense"),
        "network": preset("joint").changed(landmarks={"detector": "network"}),
        "dlib": preset("joint").changed(landmarks={"detector": "dlib"}),
    }
    tracks = {name: tracked(clip, config) for name, config in configs.items()}
    steady = np.all([in_a_row(found) for found in tracks.values()], axis=0)
    differences = {name: second_differences(found.angles_deg)[steady] for name, found in tracks.items()}
    shared = (differences["dense"] * differences["dlib"]).mean(axis=0).clip(0.0)
    row = {name: float(np.abs(found).mean()) for name, found in differences.items()}
    return row | {"shared": float(MEAN_PER_RMS * np.sqrt(shared).mean()), "frames": int(steady.sum())}


def tracked(clip: Path, config: Config) -> Track:
    """The fits of a clip."""
    with tempfile.TemporaryDirectory() as folder:
        return track(clip, folder, load_default_head(), config, pictures=False).track


def in_a_row(track: Track) -> np.ndarray:
    """Where a frame and the two before it have a face, in one shot."""
    whole = track.found[2:] & track.found[1:-1] & track.found[:-2]
    return whole & (track.shot[2:] == track.shot[:-2])


def second_differences(angles_deg: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """Of each angle, over three frames in a row."""
    return angles_deg[2:] - 2 * angles_deg[1:-1] + angles_deg[:-2]


if __name__ == "__main__":
    main()
