"""Blinks with each detector: eyeBlink in frames with shut and with open eyes, errors and jitter of the fit, time.

The bundled clip is always run, `carphone.mp4`, `obama.mp4` and `hamilton.mp4` (shared test clips, not part of the
project) where a folder with them is given.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from result import print_result

from workbench.config import preset
from workbench.errors import MissingDependencyError
from workbench.face import FaceModel, load_default_head
from workbench.landmarks.detectors import chosen_detector, make_detector
from workbench.pipeline import track
from workbench.samples import sample
from workbench.session.metrics import metrics_of

GOAL = ">= 0.6"
DETECTORS = {"network": "joint", "dlib": "joint", "dlib+network": "joint", "dense": "dense"}
"""And the preset that each is run with."""
JUDGED = chosen_detector()
"""The detector of `auto`, whose blinks the value is."""
SHUT = {"carphone": (42, 92), "obama": (38, 39, 40), "hamilton": ()}
"""Frames in which both eyes are shut: contact sheets of the eyes, enlarged, were looked at frame by frame. In frame 38
of obama they are shut and blurred; in 112 and 113 of carphone they are half open and not counted."""
AWAY = 4
"""Frames between a blink and those that count as open."""
SHUT_WEIGHT, OPEN_WEIGHT = 0.8, 0.1
"""The bundled clip's exact eyeBlink weights that count as shut and open."""
BLINKS = ("eyeBlinkLeft", "eyeBlinkRight")


def main() -> None:
    """Print eyeBlink with the detector of "auto", the median of a clip's frames with shut eyes, of the worst clip."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("folder", type=Path, nargs="?", help="folder of the real clips")
    folder = arguments.parse_args().folder
    if folder and not any((folder / f"{name}.mp4").is_file() for name in SHUT):
        arguments.error(f"{folder} holds none of {', '.join(f'{name}.mp4' for name in SHUT)}")
    head = load_default_head()
    clips = {"performance": (sample("performance"), *_of_truth())}
    for name, shut in SHUT.items() if folder else ():
        clips[name] = (folder / f"{name}.mp4", list(shut), None)
    rows = {
        f"{name}, {detector}": row
        for detector in DETECTORS
        for name, (path, shut, opened) in clips.items()
        if path.is_file() and (row := _row(path, detector, head, shut, opened))
    }
    judged = [row for name, row in rows.items() if name.endswith(f", {JUDGED}")]
    value = min(row["shut_median"] for row in judged if "shut_median" in row)
    print_result("blinks", value, "eyeBlink, worst clip", GOAL, "frames with shut eyes", rows)


def _of_truth() -> tuple[list[int], list[int]]:
    """Frames of the bundled clip with shut and with open eyes."""
    with np.load(sample("performance-truth")) as truth:
        weights = truth["expression"][:, [list(truth["expression_names"]).index(name) for name in BLINKS]]
    shut, opened = (weights > SHUT_WEIGHT).all(axis=1), (weights < OPEN_WEIGHT).all(axis=1)
    return np.flatnonzero(shut).tolist(), np.flatnonzero(opened).tolist()


def _row(path: Path, detector: str, head: FaceModel, shut: list[int], opened: list[int] | None) -> dict[str, float]:
    """Numbers of one clip with one detector; empty without the detector's packages."""
    try:
        make_detector(detector)
    except MissingDependencyError:
        return {}
    config = preset(DETECTORS[detector]).changed(landmarks={"detector": detector})
    with tempfile.TemporaryDirectory() as folder:
        result = track(path, folder, head, config, pictures=False)
        fitted = result.track
    fits = [fitted[row] for row in range(len(fitted))]
    blinks = fitted.expression[:, [fitted.expression_names.index(name) for name in BLINKS]]
    if opened is None:
        opened = [row for row in range(len(fits)) if min((abs(row - one) for one in shut), default=AWAY + 1) > AWAY]
    opened = [row for row in opened if fits[row].found]
    numbers = metrics_of(fits)
    numbers["open_median"] = float(np.median(blinks[opened], axis=0).max())
    numbers["open_p95"] = float(np.percentile(blinks[opened], 95))
    if shut:
        numbers["shut_least"], numbers["shut_median"] = float(blinks[shut].min()), float(np.median(blinks[shut]))
    numbers["landmark_ms"] = float(np.median(fitted.milliseconds[:, :2].sum(axis=1)))
    return numbers


if __name__ == "__main__":
    main()
