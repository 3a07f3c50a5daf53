"""Detectors: by name, without their packages, and what dlib's finds on a real portrait at any size and roll."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from workbench.errors import ConfigError, MissingDependencyError
from workbench.frames import read_picture
from workbench.landmarks import dlib_detector
from workbench.landmarks.alignment import frame_from_points, grey_face_crop
from workbench.landmarks.detectors import DETECTORS, FaceDetection, LandmarkDetector, make_detector
from workbench.landmarks.scheme import outer_eye_distance

ASTRONAUT = Path(__file__).resolve().parents[1] / "data_samples" / "astronaut.png"
REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

needs_dlib = pytest.mark.skipif(
    importlib.util.find_spec("dlib") is None or importlib.util.find_spec("face_recognition_models") is None,
    reason='dlib is not installed: pip install "face-energy-workbench[dlib]"',
)


@pytest.fixture(scope="module")
def astronaut():
    return read_picture(ASTRONAUT)


@pytest.fixture(scope="module")
def detector():
    return make_detector("dlib")


# --- by name, and without the package ---


def test_unknown_names_list_the_detectors():
    with pytest.raises(ConfigError, match=r"'dlb'.*dlib, dlib-hog, dlib-cnn"):
        make_detector("dlb")


def test_importing_the_landmarks_does_not_import_dlib():
    code = "import sys, workbench.landmarks.detectors, workbench.landmarks.tracking; print('dlib' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_without_dlib_the_error_gives_the_line_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "dlib", None)
    for name in DETECTORS:
        with pytest.raises(MissingDependencyError, match=r'needs dlib: pip install "face-energy-workbench\[dlib\]"'):
            make_detector(name)


def test_without_the_model_files_the_error_gives_the_line_that_installs_them(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r"face_recognition_models\): pip install"):
        dlib_detector.model_path("shape_predictor_68_face_landmarks.dat")


def test_licence_notice_names_the_restriction_and_is_given_once(monkeypatch):
    monkeypatch.setattr(dlib_detector, "_notice_given", False)
    assert "300-W" in dlib_detector.licence_notice()
    assert "commercial" in dlib_detector.licence_notice()
    assert dlib_detector.licence_notice_once() == dlib_detector.licence_notice()
    assert dlib_detector.licence_notice_once() is None


# --- the crop that the predictor sees ---


def test_a_face_crop_maps_back_to_the_picture():
    picture = np.zeros((200, 300, 3), np.uint8)
    cv2.circle(picture, (180, 90), 2, (255, 255, 255), -1)
    face = dlib_detector.frame_from_box((140.0, 50.0, 200.0, 110.0))
    for box_side in (30, 60, 120):  # reduced, as it is, enlarged
        crop, to_image = grey_face_crop(picture, face, box_side, margin=box_side // 2)
        y, x = np.mgrid[: len(crop), : len(crop)]
        weights = crop / crop.sum(dtype=float)
        middle = np.array([[(weights * x).sum(), (weights * y).sum()]])
        np.testing.assert_allclose(to_image.to_image(middle), [[180, 90]], atol=0.15)


# --- dlib ---


@needs_dlib
@pytest.mark.parametrize("name", ["dlib", "dlib-hog"])
def test_a_detector_says_its_name_and_offers_the_protocol(name):
    detector = make_detector(name)
    assert detector.name == name
    assert isinstance(detector, LandmarkDetector)


@needs_dlib
def test_other_ways_to_find_faces_are_refused():
    with pytest.raises(ConfigError, match="hog-then-cnn, got 'haar'"):
        dlib_detector.DlibDetector("haar")


@needs_dlib
def test_portrait_has_one_face_with_the_subjects_right_eye_at_image_left(detector, astronaut):
    (face,) = detector.detect_faces(astronaut)
    landmarks = detector.align(astronaut, face.box)
    assert landmarks.image_size == (512, 512)
    assert landmarks.points[36, 0] < landmarks.points[45, 0]
    left, top, right, bottom = face.box
    assert left < landmarks.points[30, 0] < right
    assert top < landmarks.points[30, 1] < bottom
    assert 50 < outer_eye_distance(landmarks.points) < 70
    assert np.median(landmarks.confidence) > 0.9


@needs_dlib
@pytest.mark.parametrize("size", [100, 200, 1500, 5000])
def test_the_face_is_found_at_any_picture_size_with_boxes_and_points_in_its_pixels(detector, astronaut, size):
    reference = detector.align(astronaut, detector.detect_faces(astronaut)[0].box).points
    picture = cv2.resize(astronaut, (size, size), interpolation=cv2.INTER_AREA if size < 512 else cv2.INTER_LINEAR)
    landmarks = detector.align(picture, detector.detect_faces(picture)[0].box)
    expected = (reference + 0.5) * size / 512 - 0.5
    error = np.linalg.norm(landmarks.points - expected, axis=1).mean() / outer_eye_distance(expected)
    assert error < 0.05


@needs_dlib
@pytest.mark.parametrize("degrees", [-35, 25])
def test_a_rolled_head_is_aligned_upright(detector, astronaut, degrees):
    face = detector.detect_faces(astronaut)[0]
    reference = detector.align(astronaut, face.box).points
    turn = cv2.getRotationMatrix2D(reference.mean(axis=0), degrees, 1.0)
    turned = cv2.warpAffine(astronaut, turn, (512, 512))
    landmarks = detector.align(turned, face.box)
    expected = reference @ turn[:, :2].T + turn[:, 2]
    error = np.linalg.norm(landmarks.points - expected, axis=1).mean() / outer_eye_distance(expected)
    assert error < 0.04


@needs_dlib
def test_refining_from_nearby_points_agrees_with_aligning(detector, astronaut):
    aligned = detector.align(astronaut, detector.detect_faces(astronaut)[0].box)
    refined = detector.refine(astronaut, aligned.points + np.array([4.0, -3.0]))
    error = np.linalg.norm(refined.points - aligned.points, axis=1).mean() / outer_eye_distance(aligned.points)
    assert error < 0.03


@needs_dlib
def test_where_there_is_no_face_none_is_found_and_landmarks_are_not_trusted(detector):
    noise = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)
    hills = cv2.GaussianBlur(noise, (0, 0), 9)
    assert detector.detect_faces(hills, effort="quick") == []
    assert np.median(detector.align(hills, (100.0, 80.0, 220.0, 200.0)).confidence) < 0.2


@needs_dlib
@pytest.mark.parametrize("shape", [(1, 1, 3), (8, 600, 3), (40, 3, 3)])
def test_a_tiny_picture_is_valid_and_has_no_face(detector, shape):
    assert detector.detect_faces(np.zeros(shape, np.uint8)) == []


@needs_dlib
def test_several_faces_come_largest_first(detector, astronaut):
    large = astronaut[:260, 100:360]
    small = cv2.resize(large, (200, 200), interpolation=cv2.INTER_AREA)
    picture = np.zeros((260, 460, 3), np.uint8)
    picture[:200, :200] = small
    picture[:, 200:] = large
    faces = detector.detect_faces(picture)
    assert len(faces) == 2
    assert faces[0].area > faces[1].area
    assert faces[0].box[0] > 200
    assert FaceDetection((0.0, 0.0, 2.0, 3.0), 1.0).area == 6


@needs_dlib
@pytest.mark.skipif(not REAL_DATA.is_dir(), reason="the real photos are not part of the project")
def test_real_photos_up_to_a_medium_yaw_agree_with_their_annotations():
    from scipy.io import loadmat

    detector = make_detector("dlib-hog")
    for name in ("image00050", "image00081", "image00430", "image00514"):
        picture = read_picture(REAL_DATA / "aflw2000" / f"{name}.jpg")
        truth = loadmat(REAL_DATA / "aflw2000" / f"{name}.mat")["pt3d_68"][:2].T - 1.0  # 1-based
        landmarks = detector.align(picture, detector.detect_faces(picture)[0].box)
        size = np.sqrt(np.ptp(truth[:, 0]) * np.ptp(truth[:, 1]))
        assert np.linalg.norm(landmarks.points - truth, axis=1)[17:].mean() < 0.03 * size
        assert frame_from_points(landmarks.points).side == pytest.approx(size, rel=0.35)
