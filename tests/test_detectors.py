"""Detectors: by name, without their packages, and what each finds on a real portrait at any size and roll."""

import importlib.util
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.optional_parts import needs_dlib
from workbench.config import LandmarksConfig
from workbench.errors import ConfigError, InputError, MissingDependencyError
from workbench.frames import open_frames, read_picture
from workbench.landmarks import dlib_detector
from workbench.landmarks.alignment import frame_from_points, grey_face_crop
from workbench.landmarks.detection import AUTO, FaceDetection, LandmarkDetector
from workbench.landmarks.detectors import DETECTORS, chosen_detector, make_detector
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.network_detector import CLEAR, CROP_SIDE, NetworkDetector, crop_frame, network_box
from workbench.landmarks.scheme import GROUPS, MIRROR, outer_eye_distance
from workbench.landmarks.turned_faces import sureness
from workbench.networks import to_picture
from workbench.networks.face_finder import FaceFinder
from workbench.networks.landmark_network import empty_landmark_network
from workbench.pictures.heat import heat_layer
from workbench.runtime import COMPUTING
from workbench.samples import sample

ASTRONAUT = Path(__file__).resolve().parents[1] / "data_samples" / "astronaut.png"
LOOKED_AT = [index for index in GROUPS["inner"] if index not in (*GROUPS["right_eye"], *GROUPS["left_eye"])]
"""Points that are where a look puts them; lids are lowered after it where eyes are narrow."""
REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="module")
def astronaut():
    return read_picture(ASTRONAUT)


@pytest.fixture(scope="module")
def detector():
    return make_detector("dlib")


@pytest.fixture(scope="module")
def laugh():
    """Every sixth frame of the clip, with its true landmarks."""
    truth = np.load(sample("laugh-truth"), allow_pickle=False)["landmarks"]
    return [
        (frame.picture, truth[frame.index]) for frame in open_frames(sample("laugh")).iterate() if frame.index % 6 == 0
    ]


# --- by name, and without the package ---


def test_unknown_names_list_the_detectors():
    for function in (make_detector, chosen_detector):
        with pytest.raises(ConfigError, match=r"'dlb'.*auto, dlib\+network, network, network\+pupils, dense, dlib"):
            function("dlb")


def test_importing_the_workbench_imports_no_dlib_and_reads_no_weights():
    asked = "'dlib' in sys.modules, network_detector.bundled_landmark_network.cache_info().currsize"
    code = f"import sys, workbench; from workbench.landmarks import network_detector; print({asked})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False 0"


def test_without_dlib_the_error_gives_the_line_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "dlib", None)
    for name in ("dlib+network", "dlib", "dlib-hog", "dlib-cnn"):
        with pytest.raises(MissingDependencyError, match=r'needs dlib: pip install "face-energy-workbench\[dlib\]"'):
            make_detector(name)


def test_without_the_model_files_the_error_gives_the_line_that_installs_them(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingDependencyError, match=r"face_recognition_models\): pip install"):
        dlib_detector.model_path("shape_predictor_68_face_landmarks.dat")


@pytest.mark.parametrize("installed", [pytest.param(True, marks=needs_dlib), False])
def test_auto_is_the_network_with_and_without_dlib(installed, monkeypatch):
    if not installed:
        monkeypatch.setitem(sys.modules, "dlib", None)
    assert LandmarksConfig().detector == "auto"
    assert chosen_detector() == chosen_detector("auto") == make_detector("auto").name == "network"


def test_a_detector_that_is_named_is_the_one_that_runs():
    assert {name: chosen_detector(name) for name in DETECTORS} == {name: name for name in DETECTORS}


def test_every_name_of_a_configuration_is_a_detector_or_auto_and_the_other_way_round():
    assert set(LandmarksConfig.model_fields["detector"].annotation.__args__) == {AUTO, *DETECTORS}


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
@pytest.mark.parametrize("shape", [(20, 6000, 3), (6000, 20, 3)])
def test_a_long_strip_is_valid_and_has_no_face(shape):
    assert make_detector("dlib-cnn").detect_faces(np.zeros(shape, np.uint8)) == []


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


# --- the network, from a given box ---

PORTRAIT_TOLERANCE = 0.08
"""Mean distance of the inner points from dlib's on the portrait; this and what follows in outer-eye distances."""
MIRROR_TOLERANCE = 0.02
ROLL_TOLERANCE = 0.03
SIZE_TOLERANCE = 0.04
REFINE_TOLERANCE = 0.04
SURE = 0.7
"""Median confidence on the portrait, which is a good picture."""
SAME_BOX_PX = 8.0
"""Between a given box and that of the landmarks found in it; the portrait's box has 99 pixels."""
UNSURE = 0.4
"""Median confidence at most where there is no face."""


class KnownFaces(FaceFinder):
    """A finder that gives the same boxes at every look, whatever the picture."""

    def __init__(self, *boxes, in_parts=()):
        super().__init__(empty_landmark_network((4, 4, 4, 4), 1, outputs=4))
        self.boxes, self.in_parts = boxes, in_parts

    def find(self, picture, least_score=0.0):
        return [(box, 0.9) for box in self.boxes]

    def find_smaller(self, picture, least_score=0.0):
        yield []
        yield [(box, 0.9) for box in self.in_parts]


@pytest.fixture(scope="module")
def network():
    """The bundled landmark network behind a finder that finds nothing: boxes are given."""
    return NetworkDetector(finder=KnownFaces())


@pytest.fixture(scope="module")
def portrait_points():
    """dlib's points of the portrait, as they are bundled."""
    (record,) = read_landmark_file(sample("astronaut-landmarks"))
    return record.landmarks.points


@pytest.fixture(scope="module")
def portrait_box(portrait_points):
    return frame_from_points(portrait_points).box()


@pytest.fixture(scope="module")
def aligned(network, astronaut, portrait_box):
    return network.align(astronaut, portrait_box)


def distance(points, expected, only=slice(None)) -> float:
    """Mean distance in distances of the outer eye corners."""
    return np.linalg.norm(points - expected, axis=1)[only].mean() / outer_eye_distance(expected)


def test_the_network_detector_says_its_name_and_offers_the_protocol(network):
    assert network.name == "network"
    assert isinstance(network, LandmarkDetector)


def test_the_network_agrees_with_dlib_on_the_portrait_and_is_sure(aligned, portrait_points):
    assert aligned.image_size == (512, 512)
    assert distance(aligned.points, portrait_points, slice(17, None)) < PORTRAIT_TOLERANCE
    assert np.median(aligned.confidence) > SURE


def test_the_networks_confidences_lie_between_0_and_1(network, astronaut, portrait_box, aligned):
    noise = np.random.default_rng(0).integers(0, 256, (200, 300, 3), np.uint8)
    looks = [aligned, network.refine(astronaut, aligned.points), network.align(noise, (50.0, 20.0, 210.0, 180.0))]
    beside = tuple(edge + 400.0 for edge in portrait_box)
    for landmarks in (*looks, network.align(astronaut, beside)):
        assert landmarks.confidence.min() >= 0
        assert landmarks.confidence.max() <= 1


def test_a_mirrored_picture_gives_mirrored_points(network, astronaut, portrait_box, aligned):
    left, top, right, bottom = portrait_box
    mirrored = network.align(np.ascontiguousarray(astronaut[:, ::-1]), (511 - right, top, 511 - left, bottom))
    expected = aligned.points[list(MIRROR)] * [-1, 1] + [511, 0]
    assert distance(mirrored.points, expected) < MIRROR_TOLERANCE


@pytest.mark.parametrize("degrees", [-60, -35, 25, 60])
def test_the_network_finds_the_roll_of_a_head_by_itself(network, astronaut, portrait_box, aligned, degrees):
    turn = cv2.getRotationMatrix2D(aligned.points.mean(axis=0), degrees, 1.0)
    turned = network.align(cv2.warpAffine(astronaut, turn, (512, 512)), portrait_box)
    assert distance(turned.points, aligned.points @ turn[:, :2].T + turn[:, 2]) < ROLL_TOLERANCE


@pytest.mark.parametrize("size", [160, 1500, 4000])
def test_the_networks_points_are_in_the_pixels_of_the_picture(network, astronaut, portrait_box, aligned, size):
    picture = cv2.resize(astronaut, (size, size), interpolation=cv2.INTER_AREA if size < 512 else cv2.INTER_LINEAR)
    resized = network.align(picture, tuple((edge + 0.5) * size / 512 - 0.5 for edge in portrait_box))
    assert distance(resized.points, (aligned.points + 0.5) * size / 512 - 0.5) < SIZE_TOLERANCE


def test_refining_follows_a_face_that_moved_a_little(network, astronaut, aligned):
    move = np.array([[1.0, 0.0, 9.0], [0.0, 1.0, -6.0]])
    moved = cv2.warpAffine(astronaut, move, (512, 512), borderMode=cv2.BORDER_REPLICATE)
    refined = network.refine(moved, aligned.points)
    assert distance(refined.points, aligned.points + move[:, 2]) < REFINE_TOLERANCE


def test_a_clear_face_is_followed_by_one_look(network, laugh):
    picture, truth = laugh[0]
    look, refined = network.look(picture, truth).landmarks, network.refine(picture, truth)
    assert sureness(look) > CLEAR
    assert np.array_equal(refined.points[LOOKED_AT], look.points[LOOKED_AT])
    assert np.array_equal(refined.confidence, look.confidence)


def test_a_face_half_in_the_dark_is_looked_at_twice_and_seen_better(network, laugh):
    errors = []
    for picture, truth in laugh:
        dark, nose = picture.copy(), int(truth[27:31, 0].mean())
        dark[:, nose:] = 0.04 * picture[:, nose:]
        answers = network.look(dark, truth).landmarks, network.refine(dark, truth)
        errors.append([np.linalg.norm((found.points - truth)[LOOKED_AT], axis=1).mean() for found in answers])
    one, two = np.mean(errors, axis=0)
    assert two < 0.95 * one


def test_a_look_shows_where_the_network_takes_landmarks_to_be(network, astronaut, aligned):
    look = network.look(astronaut, aligned.points)
    assert look.probability.sum(axis=(1, 2)) == pytest.approx(np.ones(68), abs=1e-4)
    side = look.probability.shape[-1]
    row, column = np.divmod(look.probability.reshape(68, -1).argmax(axis=1), side)
    places = look.to_image.to_image((np.stack([column, row], axis=1) + 0.5) * CROP_SIDE / side - 0.5)
    cell = CROP_SIDE / side * look.to_image.side
    assert np.abs(places - look.landmarks.points).max() < 1.5 * cell


@pytest.mark.parametrize("enlarged", [1, 5])
def test_the_heat_layer_glows_at_the_landmarks_and_outlines_the_crop(network, astronaut, aligned, enlarged):
    picture = cv2.resize(astronaut, None, fx=enlarged, fy=enlarged, interpolation=cv2.INTER_NEAREST)
    look = network.look(picture, (aligned.points + 0.5) * enlarged - 0.5)
    layer = heat_layer(look, (36, 45))
    scale = len(layer) / len(picture)
    assert layer.shape[:2] == ((512, 512) if enlarged == 1 else (1280, 1280))
    for point in (30, 36, 45):
        x, y = np.rint((look.landmarks.points[point] + 0.5) * scale - 0.5).astype(int)
        assert (layer[y, x, 3] > 180) == (point != 30)
    outline = (layer[..., 0] > 200) & (layer[..., 3] > 100)
    ends = CROP_SIDE * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - 0.5
    corners = (look.to_image.to_image(ends) + 0.5) * scale - 0.5
    rows, columns = np.nonzero(outline)
    least, most = corners.min(axis=0).clip(0), corners.max(axis=0).clip(max=len(layer) - 1)
    assert [columns.min(), rows.min()] == pytest.approx(least, abs=3)
    assert [columns.max(), rows.max()] == pytest.approx(most, abs=3)
    assert heat_layer(look)[..., 3].sum() > 3 * layer[..., 3].sum()


@pytest.mark.parametrize("seed", [0, 1])
def test_where_there_is_no_face_the_network_is_unsure(network, seed):
    noise = np.random.default_rng(seed).integers(0, 256, (300, 400, 3), np.uint8)
    for picture in (np.zeros((300, 400, 3), np.uint8), noise, cv2.GaussianBlur(noise, (0, 0), 9)):
        assert np.median(network.align(picture, (100.0, 80.0, 220.0, 200.0)).confidence) < UNSURE


def test_an_empty_box_is_refused(network, astronaut):
    with pytest.raises(InputError, match="right > left"):
        network.align(astronaut, (10.0, 10.0, 10.0, 40.0))


# --- the network, with a finder that is right or wrong ---


def test_what_the_finder_proposes_is_a_face_only_if_the_landmark_network_agrees(astronaut, portrait_box):
    wall = (20.0, 380.0, 120.0, 480.0)
    (face,) = NetworkDetector(finder=KnownFaces(wall, portrait_box)).detect_faces(astronaut)
    assert face.box == pytest.approx(portrait_box, abs=SAME_BOX_PX)


def test_the_networks_faces_come_largest_first(astronaut, portrait_box):
    picture = np.zeros((512, 780, 3), np.uint8)
    picture[:256, :256] = cv2.resize(astronaut, (256, 256), interpolation=cv2.INTER_AREA)
    picture[:, 268:] = astronaut
    small = tuple((edge + 0.5) / 2 - 0.5 for edge in portrait_box)
    left, top, right, bottom = portrait_box
    large = (left + 268, top, right + 268, bottom)
    faces = NetworkDetector(finder=KnownFaces(small, large)).detect_faces(picture)
    for face, box in zip(faces, (large, small), strict=True):
        assert face.box == pytest.approx(box, abs=SAME_BOX_PX)


def test_two_boxes_on_one_face_are_one_face(astronaut, portrait_box):
    left, top, right, bottom = portrait_box
    finder = KnownFaces(portrait_box, (left - 12, top + 5, right - 6, bottom + 14))
    assert len(NetworkDetector(finder=finder).detect_faces(astronaut)) == 1


def test_parts_of_the_picture_are_searched_only_where_there_is_time_for_it(astronaut, portrait_box):
    detector = NetworkDetector(finder=KnownFaces(in_parts=[portrait_box]))
    assert detector.detect_faces(astronaut, "quick") == []
    for effort in ("thorough", "full"):
        assert len(detector.detect_faces(astronaut, effort)) == 1


@pytest.mark.parametrize("shape", [(1, 1, 3), (8, 600, 3), (40, 15, 3)])
def test_in_a_tiny_picture_the_network_looks_for_no_face(shape):
    detector = NetworkDetector(finder=KnownFaces((0.0, 0.0, 8.0, 8.0)))
    assert detector.detect_faces(np.zeros(shape, np.uint8)) == []


def test_looks_from_several_threads_wait_for_each_other_and_agree(network, astronaut, aligned):
    alone = network.refine(astronaut, aligned.points)
    with ThreadPoolExecutor(4) as threads:
        for landmarks in threads.map(lambda _: network.refine(astronaut, aligned.points), range(8)):
            np.testing.assert_array_equal(landmarks.points, alone.points)


def test_the_network_waits_for_no_compiled_program(network, astronaut, aligned):
    done = threading.Event()
    thread = threading.Thread(target=lambda: (network.refine(astronaut, aligned.points), done.set()))
    with COMPUTING:
        thread.start()
        assert done.wait(60)
    thread.join()


def test_the_view_of_the_differentiable_chain_is_that_of_the_detector(aligned):
    face = frame_from_points(aligned.points)
    pixels = np.array([[0.0, 0.0], [CROP_SIDE - 1.0, 0.0], [100.0, 200.0]])
    expected = crop_frame(face).to_image(pixels)
    np.testing.assert_allclose(to_picture(pixels, network_box(face), CROP_SIDE), expected, atol=1e-3)


# --- the network with its own finder ---


@pytest.fixture(scope="module")
def whole_network():
    return make_detector("network")


def test_the_network_finds_the_one_face_of_the_portrait(whole_network, astronaut, portrait_points):
    for effort in ("quick", "thorough", "full"):
        (face,) = whole_network.detect_faces(astronaut, effort)
        landmarks = whole_network.align(astronaut, face.box)
        assert distance(landmarks.points, portrait_points, slice(17, None)) < PORTRAIT_TOLERANCE


@pytest.mark.parametrize("size", [100, 200, 1500])
def test_the_network_finds_the_portraits_face_at_any_size(whole_network, astronaut, portrait_points, size):
    picture = cv2.resize(astronaut, (size, size), interpolation=cv2.INTER_AREA if size < 512 else cv2.INTER_LINEAR)
    (face,) = whole_network.detect_faces(picture)
    landmarks = whole_network.align(picture, face.box)
    expected = (portrait_points + 0.5) * size / 512 - 0.5
    assert distance(landmarks.points, expected, slice(17, None)) < PORTRAIT_TOLERANCE


@pytest.mark.parametrize("effort", ["quick", "full"])
def test_the_network_finds_no_face_where_there_is_none(whole_network, effort):
    noise = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)
    for picture in (np.zeros((300, 400, 3), np.uint8), noise, cv2.GaussianBlur(noise, (0, 0), 9)):
        assert whole_network.detect_faces(picture, effort) == []
