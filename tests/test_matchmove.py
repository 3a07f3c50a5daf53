"""The stand-in for a matchmove artist: dots on the rigid part of a face, followed through a film, and their poses."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.pictures.mesh import to_camera, to_pixels
from workbench.reproduction.matchmove import (
    DOTS,
    STILL_MM,
    TrackedDots,
    matchmove,
    poses_of_dots,
    rigid_vertices,
    with_dots,
)
from workbench.reproduction.people import Motion
from workbench.reproduction.stereo_solves import rigid_differences
from workbench.training.skin import SIDE, vertex_places

SIZE, FRAMES = (480, 360), 5


@pytest.fixture(scope="module")
def camera() -> Camera:
    found = camera_from_fov(SIZE, 33.0)
    return Camera(*(np.asarray(part, float) for part in found))


@pytest.fixture(scope="module")
def motion() -> Motion:
    """A head that turns by 2° a frame."""
    time = np.arange(FRAMES)[:, None]
    places = np.tile([0.0, 0.0, 600.0], (FRAMES, 1)) + time * [2.0, -1.0, 3.0]
    return Motion(axis_angle_from_yaw_pitch_roll(time * [2.0, 1.0, -0.5]), places, np.zeros((FRAMES, 44)))


@pytest.fixture(scope="module")
def dots_head(head):
    return head.neutral[rigid_vertices(head)]


def filmed(dots_head, motion: Motion, camera: Camera) -> list[np.ndarray]:
    """Dark dots before a wall."""
    pictures = []
    for pose in zip(motion.rotation, motion.translation_mm, strict=True):
        picture = np.full((SIZE[1], SIZE[0], 3), 180, np.uint8)
        for x, y in np.rint(16.0 * to_pixels(camera, to_camera(dots_head, *pose))).astype(int).tolist():
            cv2.circle(picture, (x, y), 40, (30, 25, 25), -1, cv2.LINE_AA, 4)
        pictures.append(cv2.GaussianBlur(picture, (0, 0), 0.8))
    return pictures


def test_dots_are_on_skin_that_no_expression_moves(head):
    chosen = rigid_vertices(head)
    assert len(set(chosen)) == DOTS
    assert set(chosen) <= set(head.regions["skin"])
    assert np.linalg.norm(head.expression_deltas[:, chosen], axis=-1).max() < STILL_MM


def test_a_dot_is_painted_where_its_vertex_lies_in_the_skin(head, monkeypatch):
    chosen = rigid_vertices(head, 5)
    monkeypatch.setattr("workbench.reproduction.matchmove.replace", lambda who, albedo: albedo)
    painted = with_dots(SimpleNamespace(albedo=np.full((SIDE, SIDE, 3), 200, np.uint8), model=head), chosen)
    columns, rows = np.rint(vertex_places(head)[chosen]).astype(int).T
    assert painted[rows, columns].max() < 60
    assert (painted == 200).mean() > 0.99


def test_poses_follow_the_dots_of_a_film(dots_head, motion, camera):
    rotations, translations = matchmove(filmed(dots_head, motion, camera), dots_head, motion, camera)
    np.testing.assert_allclose(np.degrees(rotations - motion.rotation), 0.0, atol=0.3)
    np.testing.assert_allclose((translations - motion.translation_mm)[:, :2], 0.0, atol=0.2)
    np.testing.assert_allclose((translations - motion.translation_mm)[:, 2], 0.0, atol=3.0)


def test_dots_that_went_astray_are_outvoted_and_too_few_give_no_pose(dots_head, motion, camera):
    exact = to_pixels(camera, to_camera(dots_head, motion.rotation[1], motion.translation_mm[1]))
    astray = exact + np.where(np.arange(DOTS)[:, None] < 4, 25.0, 0.0)
    few = np.arange(DOTS) < 3
    dots = TrackedDots(np.stack([astray, exact]), np.stack([np.ones(DOTS, bool), few]))
    rotations, translations = poses_of_dots(dots, dots_head, camera)
    np.testing.assert_allclose(rotations[0], motion.rotation[1], atol=1e-4)
    np.testing.assert_allclose(translations[0], motion.translation_mm[1], atol=0.05)
    assert np.isnan(rotations[1]).all()
    assert np.isnan(translations[1]).all()


def test_differences_are_by_axis(motion):
    angles = np.array([3.0, -2.0, 1.0])
    fit = SimpleNamespace(angles_deg=angles, translation=motion.translation_mm[0] + [1.0, 2.0, 3.0])
    np.testing.assert_allclose(rigid_differences({0: fit}, motion), [[3.0, -2.0, 1.0, 1.0, 2.0, 3.0]], atol=1e-9)
