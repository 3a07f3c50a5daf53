"""The first pose of a shot: any size of face, any lens, and no pose of nothing."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.geometry import camera_from_fov
from workbench.landmarks.scheme import GROUPS
from workbench.tracking.initial_pose import FEWEST_POINTS, frontal_pose, initial_pose

FULL_HD = 1920, 1080
TURNED = Rotation.from_euler("yxz", [30, -10, 5], degrees=True)


@pytest.fixture(scope="module")
def neutral(head):
    return np.asarray(head.landmarks.of(head.neutral), float)


def seen_by(camera, neutral, eye_px, place=(0.2, -0.1)):
    """The points of a turned head whose outer eye corners would be so many pixels apart if it faced the camera."""
    depth = float(camera.focal_px[0]) * np.linalg.norm(neutral[45] - neutral[36]) / eye_px
    aside = np.array(place) * FULL_HD / np.asarray(camera.focal_px) * depth
    head = TURNED.apply(neutral) + np.append(aside, depth)
    pixels = head[:, :2] / head[:, 2:] * np.asarray(camera.focal_px) + np.asarray(camera.principal_point_px)
    return pixels, depth


@pytest.mark.parametrize("fov_deg", [5.0, 15.0, 45.0, 90.0])
@pytest.mark.parametrize("eye_px", [4, 10, 22, 60, 200, 400])
def test_a_turned_face_has_its_pose_however_small_it_is_and_however_long_the_lens(fov_deg, eye_px, neutral):
    camera = camera_from_fov(FULL_HD, fov_deg)
    pixels, depth = seen_by(camera, neutral, eye_px)
    rotation, translation = initial_pose(camera, neutral, pixels)
    off = Rotation.from_rotvec(rotation) * TURNED.inv()
    assert np.degrees(off.magnitude()) < 3.0
    assert translation[2] == pytest.approx(depth, rel=0.05)


def test_points_that_coincide_give_a_frontal_pose(neutral):
    camera = camera_from_fov(FULL_HD, 45.0)
    rotation, translation = initial_pose(camera, neutral, np.zeros((68, 2)))
    assert not rotation.any()
    assert np.isfinite(translation).all()


def test_muted_points_take_no_part_as_long_as_enough_remain(neutral):
    camera = camera_from_fov(FULL_HD, 45.0)
    pixels, _ = seen_by(camera, neutral, 200)
    robust, used = list(GROUPS["robust"]), np.ones(68, bool)
    wrong = robust[: len(robust) - FEWEST_POINTS]
    pixels[wrong] += [150.0, 80.0]
    used[wrong] = False
    off = Rotation.from_rotvec(initial_pose(camera, neutral, pixels, used)[0]) * TURNED.inv()
    assert np.degrees(off.magnitude()) < 1e-3


def test_a_frontal_pose_has_the_size_of_the_points(neutral):
    camera = camera_from_fov(FULL_HD, 45.0)
    depth = float(camera.focal_px[0]) * 3.0
    pixels = neutral[:, :2] / (neutral[:, 2:] + depth) * np.asarray(camera.focal_px) + 300.0
    rotation, translation = frontal_pose(camera, neutral, pixels)
    assert not rotation.any()
    assert translation[2] == pytest.approx(depth, rel=0.1)
