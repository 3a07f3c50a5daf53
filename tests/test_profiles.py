"""Heads that turn to the profile: half of the points are hidden, and the face is followed and fitted all the same."""

from functools import cache
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.io import loadmat
from scipy.spatial.transform import Rotation

from tests.optional_parts import needs_dlib
from workbench.config import preset
from workbench.face import load_character, load_default_head, posed_vertices
from workbench.frames import read_picture
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov, yaw_pitch_roll_deg
from workbench.geometry.camera import project
from workbench.landmarks import network_detector
from workbench.landmarks.alignment import frame_from_points
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.scheme import error_unit, outer_eye_distance
from workbench.landmarks.tracker_options import ACCEPT_CONFIDENCE, TrackerOptions, options_for
from workbench.landmarks.tracking import LandmarkTracker
from workbench.landmarks.turned_faces import shape_deviation, sureness, turn_deg
from workbench.pictures import HeadRenderer
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation

SIZE, FOV_DEG = (480, 360), 40.0
CAMERA = camera_from_fov(SIZE, FOV_DEG)
PLACE_MM = np.array([0.0, 20.0, 620.0])
REAL_PHOTOS = Path(__file__).resolve().parents[2] / "shared" / "data" / "aflw2000"
YAWS_DEG = (*range(0, 91, 6), *range(84, -91, -6))
"""To one profile and through the front to the other."""


@cache
def turned(who: str, yaws_deg: tuple[float, ...], background: tuple[int, int, int] = (120, 125, 130)):
    """Pictures of a character, and where its landmarks are in them."""
    dressed = load_character(who, gaze=False)
    person = dressed.person
    vertices = posed_vertices(person, np.zeros(len(person.expression_names)), np.zeros(6))
    pictures, points = [], []
    with HeadRenderer(person, SIZE, dressed=dressed) as renderer:
        for yaw in yaws_deg:
            rotation = axis_angle_from_yaw_pitch_roll(np.array([yaw, 0.0, 0.0]))
            pictures.append(renderer.render(vertices, CAMERA, rotation, PLACE_MM, background))
            turn = Rotation.from_rotvec(rotation).as_matrix()
            points.append(np.asarray(project(CAMERA, person.landmarks.of(vertices) @ turn.T + PLACE_MM)))
    return pictures, points


@pytest.mark.parametrize("pitch_deg", [-15.0, 0.0, 15.0])
def test_a_turned_face_has_the_shape_of_a_face_and_its_shape_tells_the_turn(pitch_deg):
    head = load_default_head()
    points = np.asarray(head.landmarks.of(head.neutral))
    for yaw_deg in range(-90, 91, 10):
        seen = Rotation.from_euler("yx", [yaw_deg, pitch_deg], degrees=True).apply(points)[:, :2]
        assert shape_deviation(3.0 * seen) < 0.06 < TrackerOptions.largest_deviation_sides
        assert turn_deg(3.0 * seen) == pytest.approx(abs(yaw_deg), abs=7.0 if abs(yaw_deg) <= 70 else 11.0)
    random = np.random.default_rng(0)
    assert shape_deviation(random.permutation(points[:, :2])) > TrackerOptions.largest_deviation_sides


def test_the_unit_of_errors_is_the_outer_eye_distance_until_that_vanishes():
    head = load_default_head()
    points = np.asarray(head.landmarks.of(head.neutral))
    for yaw_deg in range(-90, 91, 10):
        seen = Rotation.from_euler("y", yaw_deg, degrees=True).apply(points)[:, :2]
        if abs(yaw_deg) <= 60:
            assert error_unit(seen) == outer_eye_distance(seen)
        assert error_unit(seen) > 0.35 * outer_eye_distance(points[:, :2])
        np.testing.assert_allclose(error_unit(jnp.asarray(seen)), error_unit(seen))


@pytest.fixture(scope="module")
def followed():
    tracker = LandmarkTracker(NetworkDetector(), options_for("network"))
    return [tracker.step(picture) for picture in turned("ravi", YAWS_DEG)[0]]


@pytest.mark.long
def test_a_head_is_followed_from_profile_to_profile(followed):
    assert [each.source for each in followed] == ["detected", *["tracked"] * (len(followed) - 1)]
    _, points = turned("ravi", YAWS_DEG)
    apart = np.array(
        [np.linalg.norm(each.landmarks.points - true, axis=1) for each, true in zip(followed, points, strict=True)]
    )
    assert np.median(apart[:, 17:], axis=1).max() < 0.02 * frame_from_points(points[0]).side


@pytest.mark.long
def test_the_back_of_a_head_is_no_face_and_the_profile_that_returns_is_found():
    yaws_deg = (*range(60, 181, 8), *range(180, 59, -8))
    tracker = LandmarkTracker(NetworkDetector(), options_for("network"))
    found = np.array([tracker.step(picture).landmarks is not None for picture in turned("bruno", yaws_deg)[0]])
    turn = np.array(yaws_deg)
    assert found[turn <= 84].all()
    assert not found[turn >= 140].any()


@pytest.mark.long
def test_the_fit_turns_with_it(followed):
    config = preset("joint").changed(camera={"fov_deg": FOV_DEG})
    seen = (FrameObservation(k, each.landmarks, SIZE) for k, each in enumerate(followed))
    fits = FaceTracker(load_default_head(), config).fit_all(seen)
    found = np.array([yaw_pitch_roll_deg(fit.rotation)[0] for fit in fits])
    off, turn = np.abs(found - YAWS_DEG), np.abs(YAWS_DEG)
    assert off[turn < 75].max() < 2.0
    assert off[turn >= 75].max() < 7.0


@pytest.mark.skipif(not REAL_PHOTOS.is_dir(), reason="the real photos are not part of the project")
@pytest.mark.parametrize("name", ["image00251", "image00475"])
@pytest.mark.parametrize("detector", ["network", "dense", pytest.param("dlib+network", marks=needs_dlib)])
def test_profiles_of_real_people_are_found(name, detector):
    truth = loadmat(REAL_PHOTOS / f"{name}.mat")["pt3d_68"][:2].T - 1.0  # 1-based
    found = LandmarkTracker(make_detector(detector), options_for(detector)).step(
        read_picture(REAL_PHOTOS / f"{name}.jpg")
    )
    apart = np.linalg.norm(found.landmarks.points[:68] - truth, axis=1)[17:]
    assert np.median(apart) < 0.05 * np.sqrt(np.prod(np.ptp(truth, axis=0)))


@needs_dlib
@pytest.mark.long
def test_dlibs_points_give_way_to_the_networks_as_the_head_turns():
    pictures, points = turned("ravi", YAWS_DEG)
    tracker = LandmarkTracker(make_detector("dlib+network"), options_for("dlib+network"))
    found = [tracker.step(picture).landmarks.points for picture in pictures]
    apart = np.median(np.linalg.norm(np.array(found) - points, axis=2)[:, 17:], axis=1)
    assert apart.max() < 0.03 * frame_from_points(points[0]).side


@needs_dlib
def test_a_profile_that_dlib_does_not_find_is_the_networks():
    (picture, *_), (points, *_) = turned("mei", (85.0, 0.0))
    assert not make_detector("dlib").detect_faces(picture, "quick")
    mixed = make_detector("dlib+network")
    (face,) = mixed.detect_faces(picture)
    found = mixed.align(picture, face.box).points
    assert np.median(np.linalg.norm(found - points, axis=1)[17:]) < 0.03 * frame_from_points(points).side


def test_a_doubtful_face_in_the_dark_counts_if_it_is_steady(monkeypatch):
    ((picture,), (points,)) = turned("ravi", (-88.0,), (10, 12, 20))
    noise = np.random.default_rng(0).normal(0.0, 4.0, picture.shape)
    dark = np.clip(picture * np.array([0.09, 0.11, 0.2]) + noise, 0, 255).astype(np.uint8)
    detector = NetworkDetector()
    assert not detector.detect_faces(dark, "quick")
    (face,) = detector.detect_faces(dark)
    found = detector.align(dark, face.box).points
    assert np.median(np.linalg.norm(found - points, axis=1)[17:]) < 0.04 * frame_from_points(points).side
    monkeypatch.setattr(network_detector, "STEADY_SIDES", 0.001)
    assert not detector.detect_faces(dark)


@pytest.mark.long
def test_the_network_is_less_sure_of_a_wall_than_of_a_hidden_point():
    detector, random = NetworkDetector(), np.random.default_rng(1)
    rows, columns = np.mgrid[:240, :320]
    sure = []
    for _ in range(20):
        waves = sum(
            random.uniform(5, 40) * np.sin(random.normal(0, 0.05) * rows + random.normal(0, 0.05) * columns)
            for _ in range(4)
        )
        wall = np.clip(waves[..., None] + random.uniform(40, 200, 3), 0, 255) + random.normal(0, 4, (240, 320, 3))
        seen = detector.align(np.clip(wall, 0, 255).astype(np.uint8), (80.0, 60.0, 220.0, 200.0))
        sure.append(sureness(seen))
    assert max(sure) < 0.5 * TrackerOptions.keep_confidence < ACCEPT_CONFIDENCE["network"]
    pictures, _ = turned("ravi", YAWS_DEG)
    profile = detector.refine(pictures[YAWS_DEG.index(84)], turned("ravi", YAWS_DEG)[1][YAWS_DEG.index(84)])
    assert np.quantile(profile.confidence, 0.1) > max(sure)
