"""MediaPipe as a detector: what it finds comes back in pixels of the picture, and what is missing is named.

Its package and model are the user's and cannot be had here, so that a stand-in with the same calls takes their place:
it finds faces in green squares that are not too small in the picture, as MediaPipe's own finder needs faces to be.
"""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.landmark_layouts import mesh_of
from workbench.config import preset
from workbench.errors import ConfigError, MissingDependencyError
from workbench.landmarks.alignment import MEAN_SHAPE, FaceFrame, frame_from_box, frame_from_points
from workbench.landmarks.detection import LandmarkDetector
from workbench.landmarks.detectors import make_detector
from workbench.pipeline import track

SIZE = (640, 480)
SMALLEST = 0.2
"""Of the picture's shorter side: smaller squares are overlooked."""


class Landmarker:
    """Finds an average face in every green square, the place of its box."""

    def __init__(self, options: SimpleNamespace) -> None:
        if b"landmarker" not in options.base_options.content:
            raise RuntimeError("no archive.\nSource Location Trace: ...")

    def detect(self, image: SimpleNamespace) -> SimpleNamespace:
        size = image.data.shape[1::-1]
        green = np.all(image.data == (0, 255, 0), axis=2).astype(np.uint8)
        _, _, squares, _ = cv2.connectedComponentsWithStats(green)
        faces = [
            frame_from_box((x - 0.5, y - 0.5, x + width - 0.5, y + height - 0.5)).to_image(MEAN_SHAPE)
            for x, y, width, height, _ in squares[1:]
            if width > SMALLEST * min(size)
        ]
        meshes = (mesh_of(face, size) for face in faces)
        return SimpleNamespace(face_landmarks=[[SimpleNamespace(x=x, y=y) for x, y, _ in mesh] for mesh in meshes])


@pytest.fixture
def mediapipe(monkeypatch):
    """The stand-in as the package."""
    package, tasks, python = (ModuleType(name) for name in ("mediapipe", "mediapipe.tasks", "mediapipe.tasks.python"))
    package.Image = lambda image_format, data: SimpleNamespace(data=data)
    package.ImageFormat = SimpleNamespace(SRGB="sRGB")
    python.BaseOptions = lambda model_asset_path: SimpleNamespace(content=Path(model_asset_path).read_bytes())
    landmarker = SimpleNamespace(create_from_options=Landmarker)
    python.vision = SimpleNamespace(FaceLandmarker=landmarker, FaceLandmarkerOptions=SimpleNamespace)
    for module in (package, tasks, python):
        monkeypatch.setitem(sys.modules, module.__name__, module)


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "face_landmarker.task"
    path.write_bytes(b"a landmarker")
    return path


@pytest.fixture
def detector(mediapipe, model):
    return make_detector("mediapipe", model)


def picture_of(*faces: FaceFrame) -> np.ndarray:
    """Green squares on black."""
    picture = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    corners = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)])
    for face in faces:
        cv2.fillPoly(picture, [np.round(face.to_image(corners)).astype(int)], (0, 255, 0))
    return picture


def face_at(x: float, y: float, side: float, roll: float = 0.0) -> FaceFrame:
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    return FaceFrame(side * turn, np.array([x, y], float))


def off(points: np.ndarray, face: FaceFrame) -> float:
    """Largest distance from an average face at this place, in box sides."""
    return np.linalg.norm(points - face.to_image(MEAN_SHAPE), axis=1).max() / face.side


def test_it_offers_what_a_detector_does(detector):
    assert isinstance(detector, LandmarkDetector)
    assert detector.name == "mediapipe"


def test_faces_come_the_largest_first(detector):
    small, large = face_at(150, 200, 120), face_at(420, 240, 200)
    boxes = [face.box for face in detector.detect_faces(picture_of(small, large), "quick")]
    np.testing.assert_allclose(boxes, [large.box(), small.box()], atol=3)


def test_a_small_face_is_found_by_a_second_look_at_parts(detector):
    face = face_at(500, 380, 80)
    assert detector.detect_faces(picture_of(face), "quick") == []
    (found,) = detector.detect_faces(picture_of(face))
    np.testing.assert_allclose(found.box, face.box(), atol=3)


@pytest.mark.parametrize("roll", [0.0, 0.6])
def test_the_face_near_known_points_is_seen_upright_whatever_stands_beside_it(detector, roll):
    face, other = face_at(250, 240, 90, roll), face_at(380, 200, 90)
    found = detector.refine(picture_of(face, other), face.moved(0.1, -0.05, 1.1).to_image(MEAN_SHAPE))
    assert off(found.points, face) < 0.03
    assert found.confidence.min() == 1.0


def test_of_a_box_the_face_in_its_middle_is_taken(detector):
    face, other = face_at(250, 240, 90), face_at(380, 200, 110)
    assert off(detector.align(picture_of(face, other), face.moved(-0.1, 0.05).box()).points, face) < 0.03


def test_where_there_is_no_face_nothing_is_believed(detector):
    empty, points = picture_of(), face_at(200, 200, 100).to_image(MEAN_SHAPE)
    assert detector.detect_faces(empty) == []
    kept = detector.refine(empty, points)
    assert np.array_equal(kept.points, points)
    assert kept.confidence.max() == 0.0
    guessed = detector.align(empty, (150.0, 150.0, 250.0, 250.0))
    assert guessed.confidence.max() == 0.0
    np.testing.assert_allclose(frame_from_points(guessed.points).box(), (150, 150, 250, 250), atol=1)


def test_a_run_takes_the_model_from_the_configuration(mediapipe, model, head, tmp_path):
    cv2.imwrite(str(tmp_path / "face.png"), picture_of(face_at(320, 240, 220)))
    config = preset("face-it").changed(landmarks={"detector": "mediapipe", "face_landmarker": str(model)})
    result = track(tmp_path / "face.png", tmp_path / "run", head, config, pictures=False)
    assert result.track.found.all()
    assert result.summary["detector"] == "mediapipe"


def test_without_the_package_the_error_gives_the_line_that_installs_it(monkeypatch, model):
    monkeypatch.setitem(sys.modules, "mediapipe", None)
    with pytest.raises(MissingDependencyError, match=r'needs MediaPipe: pip install --no-deps "mediapipe>=1.2,<2"'):
        make_detector("mediapipe", model)


def test_without_a_model_the_error_says_where_to_get_it_and_how_to_name_it(mediapipe, tmp_path):
    with pytest.raises(ConfigError, match=r"face_landmarker\.task from https://.* set landmarks\.face_landmarker"):
        make_detector("mediapipe")
    with pytest.raises(ConfigError, match=r"landmarks\.face_landmarker: there is no file .*none\.task"):
        make_detector("mediapipe", tmp_path / "none.task")


def test_a_file_that_is_no_model_is_named(mediapipe, tmp_path):
    wrong = tmp_path / "other.task"
    wrong.write_bytes(b"nothing of the kind")
    with pytest.raises(ConfigError, match=r"cannot use .*other\.task as a face landmarker: no archive\.$"):
        make_detector("mediapipe", wrong)
