"""Detectors on annotated photos: the network against dlib, from the same boxes.

Give a folder of AFLW2000-3D samples (NAME.jpg with NAME.mat), or photos with a landmark file beside each (NAME.pts,
NAME.csv). Without a folder the bundled portrait is taken, whose reference is dlib's own answer: then only the distance
between the two detectors is told.
"""

import argparse
from pathlib import Path

import numpy as np
import scipy.io
from result import print_result

from workbench.errors import MissingDependencyError
from workbench.frames import read_picture
from workbench.landmarks.alignment import frame_from_points
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.scheme import outer_eye_distance
from workbench.samples import sample

GOAL = "<= 0.9"
DETECTORS = ("network", "dlib")


def main() -> None:
    """Print the network's mean inner-51 error over dlib's, and each photo's errors."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("folder", type=Path, nargs="?", help="annotated photos")
    options = arguments.parse_args()
    common = {"name": "landmark_photos", "unit": "ratio of inner-51 errors", "against": "dlib on the same boxes"}
    try:
        detectors = {name: make_detector(name) for name in DETECTORS}
    except MissingDependencyError as error:
        print_result(**common, goal=GOAL, value=None, details={"skipped": str(error)})
        return
    if options.folder is None:
        picture, points = read_picture(sample("astronaut")), _points(sample("astronaut-landmarks"))
        error = _error(detectors["network"], picture, points)
        note = {"skipped": "no folder of annotated photos", "network_to_dlib_percent_on_portrait": error}
        print_result(**common, goal=GOAL, value=None, details=note)
        return
    rows = {}
    for path in sorted(options.folder.glob("*.jpg")):
        annotation = next((p for p in (path.with_suffix(end) for end in (".mat", ".pts", ".csv")) if p.is_file()), None)
        if annotation is not None:
            picture, points = read_picture(path), _points(annotation)
            rows[path.stem] = [_error(detectors[name], picture, points) for name in DETECTORS]
    errors = np.array(list(rows.values()))
    turned = np.array([error > 10 for _, error in rows.values()])
    print_result(
        **common,
        goal=GOAL,
        value=float(errors[:, 0].mean() / errors[:, 1].mean()),
        details={
            "photos": {name: dict(zip(DETECTORS, row, strict=True)) for name, row in rows.items()},
            "mean_percent": dict(zip(DETECTORS, errors.mean(axis=0).tolist(), strict=True)),
            "ratio_where_dlib_is_below_10_percent": float(errors[~turned, 0].mean() / errors[~turned, 1].mean()),
        },
    )


def _error(detector, picture, points) -> float:
    """Mean distance of the inner 51 points in percent of the outer-eye distance, from the annotation's own box."""
    found = detector.align(picture, frame_from_points(points).box()).points
    return float(100 * np.linalg.norm(found - points, axis=1)[17:].mean() / outer_eye_distance(points))


def _points(path: Path) -> np.ndarray:
    if path.suffix == ".mat":
        return scipy.io.loadmat(path)["pt3d_68"][:2].T - 1.0  # MATLAB counts pixels from 1
    return next(iter(read_landmark_file(path))).landmarks.points


if __name__ == "__main__":
    main()
