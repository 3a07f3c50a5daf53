"""Head pose of unknown people: renders of random identities with expressions, landmarks by dlib, one still each.

Yaw within ±40°, pitch within ±20°, roll within ±10°; the true camera is given. The people are samples of the default
head's own identity basis, so this is kinder than real faces are.
"""

import argparse

import numpy as np
from result import print_result

from workbench.config import DEFAULT_PRESET, preset
from workbench.errors import MissingDependencyError
from workbench.face import load_default_head
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.tracking import LandmarkTracker
from workbench.pictures import HeadRenderer
from workbench.pictures.gl_probe import gl_available
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation

SIZE = (512, 512)
FOV_DEG = 30.0
GOAL = "<= 3.0"


def main() -> None:
    """Print the mean absolute error over the three axes."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--faces", type=int, default=100)
    arguments.add_argument("--seed", type=int, default=0)
    options = arguments.parse_args()
    common = {"name": "head_pose", "unit": "degrees", "goal": GOAL, "against": "exact pose of the render"}
    try:
        detector = make_detector("dlib")
    except MissingDependencyError as error:
        print_result(**common, value=None, details={"skipped": str(error)})
        return
    if not gl_available():
        print_result(**common, value=None, details={"skipped": "VTK finds no OpenGL here"})
        return
    errors, missed = _errors(detector, options.faces, options.seed)
    by_axis = np.abs(errors).mean(axis=0)
    print_result(
        **common,
        value=float(by_axis.max()),
        details={
            "yaw_pitch_roll_mae_deg": by_axis.round(3).tolist(),
            "mean_deg": round(float(by_axis.mean()), 3),
            "bias_deg": errors.mean(axis=0).round(3).tolist(),
            "faces": options.faces,
            "not_found": missed,
        },
    )


def _errors(detector, count: int, seed: int) -> tuple[np.ndarray, int]:
    head, rng = load_default_head(), np.random.default_rng(seed)
    camera = camera_from_fov(SIZE, FOV_DEG)
    config = preset(DEFAULT_PRESET).changed(camera={"fov_deg": FOV_DEG})
    tracker = FaceTracker(head, config, stills=True)
    finder = LandmarkTracker(detector)
    errors, missed = [], 0
    with HeadRenderer(head, SIZE) as renderer:
        for index in range(count):
            angles = rng.uniform(-1.0, 1.0, 3) * (40.0, 20.0, 10.0)
            person = head.personal(rng.normal(size=len(head.identity_deltas)))
            weights = np.zeros(len(head.expression_names))
            active = rng.choice(len(weights), 4, replace=False)
            weights[active] = rng.uniform(0.2, 0.9, 4)
            rotation = axis_angle_from_yaw_pitch_roll(angles)
            background = tuple(int(level) for level in rng.integers(60, 180, 3))
            picture = renderer.render(
                person.vertices(weights), camera, rotation, np.array([0.0, 0.0, 900.0]), background
            )
            finder.reset()
            landmarks = finder.step(picture).landmarks
            if landmarks is None:
                missed += 1
                continue
            fit = tracker.push(FrameObservation(index, landmarks, SIZE))[0]
            errors.append(fit.angles_deg - angles)
    return np.array(errors), missed


if __name__ == "__main__":
    main()
