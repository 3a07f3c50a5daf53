"""Which blendshapes the landmarks cannot tell apart: constructed cases, and the default head."""

import re
from itertools import takewhile
from pathlib import Path

import numpy as np
import pytest

from workbench.diagnosis import group_columns, indistinguishable_groups, landmark_motion
from workbench.errors import InputError
from workbench.face import FaceParameters, PointModel, contour_blend, in_scheme, landmark_model, model_landmarks
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.scheme import IBUG68
from workbench.landmarks.schemes import DENSE

ROOT = Path(__file__).resolve().parent.parent
RNG = np.random.default_rng(0)
MOTION = 5.0 * np.linalg.qr(RNG.normal(size=(136, 8)))[0] * np.sqrt(136)
"""Eight independent movements, each far above what counts as seen."""
CAMERA = camera_from_fov((640, 480), 45.0)


@pytest.fixture(scope="module")
def points(head):
    model = landmark_model(head)
    found = model_landmarks(model, contour_blend(model.contour_yaw, 0.0, 0.0), np.zeros(50))
    return PointModel(*(np.asarray(part) for part in found))._replace(identity=np.zeros((0, 68, 3)))


def view(count: int, yaw: float = 0.0) -> FaceParameters:
    rotation = axis_angle_from_yaw_pitch_roll(np.array([yaw, 0.0, 0.0]))
    return FaceParameters(rotation, np.array([0.0, 0.0, 600.0]), np.zeros(count), np.zeros(0))


def test_independent_movements_form_no_group():
    found = group_columns(MOTION, "abcdefgh")
    assert found.groups == ()
    assert found.unseen == ()


def test_a_movement_that_reaches_no_landmark_is_unseen_and_in_no_group():
    motion = MOTION.copy()
    motion[:, 3] *= 1e-4
    found = group_columns(motion, "abcdefgh")
    assert found.unseen == ("d",)
    assert found.groups == ()
    assert found.motion_percent[3] < 0.1


@pytest.mark.parametrize("factor", [1.0, 0.1, -1.0], ids=["same", "weaker", "opposite"])
def test_parallel_movements_are_a_pair_whatever_their_size_and_sign(factor):
    motion = MOTION.copy()
    motion[:, 5] = factor * motion[:, 1]
    found = group_columns(motion, "abcdefgh")
    assert found.groups == (("b", "f"),)
    assert found.similarity[1, 5] == pytest.approx(np.sign(factor))


def test_three_dependent_movements_are_one_group_although_no_two_are_parallel():
    motion = MOTION.copy()
    motion[:, 2] = motion[:, 0] + motion[:, 6]
    found = group_columns(motion, "abcdefgh")
    assert found.groups == (("a", "c", "g"),)
    assert np.abs(found.similarity - np.eye(8)).max() < 0.75
    assert np.trace(found.trade) == pytest.approx(1.0)


def test_separate_dependencies_are_separate_groups():
    motion = MOTION.copy()
    motion[:, 1] = motion[:, 0]
    motion[:, 7] = -motion[:, 4]
    assert group_columns(motion, "abcdefgh").groups == (("a", "b"), ("e", "h"))


def test_nearly_dependent_counts_up_to_the_tolerance():
    motion = MOTION.copy()
    motion[:, 1] = motion[:, 0] + 0.2 * motion[:, 1]
    assert group_columns(motion, "abcdefgh", tolerance=0.25).groups == (("a", "b"),)
    assert group_columns(motion, "abcdefgh", tolerance=0.05).groups == ()


def test_a_blendshape_that_only_moves_the_head_is_taken_for_a_pose(points):
    shifted = np.broadcast_to(np.array([4.0, 0.0, 0.0]), (68, 3))
    bent = np.where(np.arange(68)[:, None] % 2, 4.0, -4.0) * np.array([0.0, 1.0, 0.0])
    model = points._replace(expression=np.stack([shifted, bent]))
    found = indistinguishable_groups(model, CAMERA, [view(2)], ("shift", "bend"))
    assert found.unseen == ("shift",)


def test_motion_is_in_percent_of_the_eye_distance_at_any_distance(points):
    near, far = (
        landmark_motion(points, CAMERA, view(44)._replace(translation=np.array([0.0, 0.0, z]))) for z in (8e3, 16e3)
    )
    np.testing.assert_allclose(near, far, atol=0.03 * np.abs(near).max())


def test_the_default_heads_groups(head, points):
    found = indistinguishable_groups(points, CAMERA, [view(44)], head.expression_names)
    groups = [set(group) for group in found.groups]
    assert found.unseen == ("tongueOut",)
    assert {"eyeBlinkLeft", "eyeWideLeft"} in groups
    assert {"mouthDimpleLeft", "mouthPressLeft"} <= next(group for group in groups if "mouthPressLeft" in group)
    assert found.similarity[names_at(head, "eyeBlinkLeft", "eyeWideLeft")] < -0.9
    mirrored = {frozenset(swap_sides(name) for name in group) for group in found.groups}
    assert mirrored == {frozenset(group) for group in found.groups}


@pytest.mark.parametrize(("scheme", "title"), [(IBUG68, "**What 68 points"), (DENSE, "**What 377 points")])
def test_the_documentation_lists_what_each_scheme_cannot_tell_apart(head, scheme, title):
    model = in_scheme(head, scheme)
    landmarks = landmark_model(model)
    points = model_landmarks(landmarks, np.eye(len(landmarks.contour_yaw))[0], np.zeros(50))
    frontal = view(len(model.expression_names))._replace(identity=np.zeros(50))
    found = indistinguishable_groups(points, CAMERA, [frontal], model.expression_names)
    lines = (ROOT / "docs" / "limits.md").read_text(encoding="utf-8").split(title)[1].splitlines()
    listed = takewhile(lambda line: not line.startswith("- **"), lines[1:])
    groups = [part for line in listed if line.startswith("  - ") for part in line.split("; and ")]
    assert sorted(tuple(re.findall("`(.+?)`", group)) for group in groups) == sorted(found.groups)


def test_more_views_leave_fewer_hidden_combinations(head, points):
    one = indistinguishable_groups(points, CAMERA, [view(44)], head.expression_names)
    three = indistinguishable_groups(
        points, CAMERA, [view(44, yaw) for yaw in (-35.0, 0.0, 35.0)], head.expression_names
    )
    assert np.trace(three.trade) < np.trace(one.trade)


def test_errors_say_what_to_do(points):
    with pytest.raises(InputError, match="8 columns, 2 names"):
        group_columns(MOTION, ("a", "b"))
    with pytest.raises(InputError, match="at least one view"):
        indistinguishable_groups(points, CAMERA, [], ())


def names_at(head, *names):
    return tuple(head.expression_names.index(name) for name in names)


def swap_sides(name: str) -> str:
    if name.endswith("Left"):
        return name.removesuffix("Left") + "Right"
    return name.removesuffix("Right") + "Left" if name.endswith("Right") else name
