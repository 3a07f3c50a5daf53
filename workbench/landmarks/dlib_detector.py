"""Faces and landmarks by dlib: HOG and CNN face detectors, and the ensemble of regression trees that FACE IT! uses.

The predictor (Kazemi and Sullivan 2014) reads single pixels and answers in whole pixels. So it is given an upright
crop of fixed size (sub-pixel answers in the picture, heads may roll), and it is run on several slightly moved boxes:
the mean is the answer. How far these answers scatter tells a landmark that is seen from one that is guessed, and a face
from a wall: the median scatter is 0.003 to 0.008 box sides on faces it fits, above 0.02 where it fails. Beyond a yaw of
about 50 degrees this predictor often fails, and the confidence says so.

dlib reports pixel indices: a whole number is the centre of a pixel, as everywhere in the workbench.
"""

import importlib.util
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import ConfigError, MissingDependencyError
from workbench.extras import install_command
from workbench.landmarks.alignment import FaceFrame, frame_from_box, frame_from_points, grey_face_crop
from workbench.landmarks.detection import Box, Effort, FaceDetection
from workbench.landmarks.observations import Landmarks2D

FACE_DETECTORS = ("hog", "cnn", "hog-then-cnn")
PREDICTOR_FILE, CNN_FILE = "shape_predictor_68_face_landmarks.dat", "mmod_human_face_detector.dat"
"""Model files in the package face_recognition_models."""

QUICK_SIDE = 640
"""Longest side in pixels that the quick search and the CNN see; HOG takes about 20 ms there, the CNN a second."""
THOROUGH_SIDE = 1280
"""Longest side of the thorough HOG search, which finds faces from about 40 pixels in a 640 pixel picture."""
COARSE_SIDE = 320
"""Longest side of the CNN's first look, which finds faces from a quarter of the picture on."""
CNN_SHORTEST_SIDE = 16
"""Reduced pictures with a shorter side in pixels hold no face that the CNN could find, and it fails below 8."""
MAX_ENLARGEMENT = 4.0
SMALLEST_SIDE = 16
"""Pictures with a shorter side in pixels hold no face with 68 landmarks."""

CROP_SIDE, CROP_MARGIN = 200, 80
"""Pixels of the box side in the predictor's crop, and of the margin around it."""
Moves = tuple[tuple[float, float, float], ...]
"""Moves of the predictor's box: (x, y, scale) in box sides."""
UNMOVED: Moves = ((0.0, 0.0, 1.0),)
STILL_MOVES: Moves = (
    (0.0, 0.0, 1.0),
    (0.03, 0.03, 0.95),
    (-0.03, 0.03, 1.05),
    (0.03, -0.03, 1.05),
    (-0.03, -0.03, 0.95),
)
QUICK_MOVES: Moves = ((0.0, -0.03, 1.0), (0.03, 0.02, 0.96), (-0.03, 0.02, 1.04))
"""Moves whose answers are averaged: on a still, and on a video frame."""
STILL_STARTS = (0.0, -0.15, 0.15, -0.3, 0.3)
"""Sideways starts in box sides: detectors centre a profile on the head, the predictor wants it on the face."""
DOUBTFUL_SCATTER = 0.012
"""Median scatter in box sides above which the next start is tried too."""
LARGEST_SHIFT = 0.4
"""Box sides by which the landmarks' middle may differ from the middle of the box that they were asked for."""
STRAYED_SCATTER = 0.03
"""Scatter added to answers that left their box."""
CONFIDENCE_SCATTER = 0.012
"""Scatter in box sides at which the confidence has fallen to exp(-1/2)."""

LIKENESS_SIDE, LIKENESS_MARGIN = 100, 60
"""Pixels of the box side, and around it, in the crop that HOG scores."""
LIKENESS_SCORES = (-1.0, -0.4)
"""HOG scores between which a crop turns from no face to a face."""
UNLIKE = 0.45
"""Factor on the confidence where HOG sees no face: more likely than not the landmarks are wrong."""

LICENCE_NOTICE = (
    "The dlib landmark predictor was trained on the iBUG 300-W data set, whose licence excludes commercial use. "
    "Ask Imperial College London before using it commercially, or use another detector."
)

_notice_given = False


def licence_notice() -> str:
    """What users of the dlib predictor must know about its training data."""
    return LICENCE_NOTICE


def licence_notice_once() -> str | None:
    """The notice at the first call in this process, None afterwards: the caller prints it."""
    global _notice_given
    if _notice_given:
        return None
    _notice_given = True
    return licence_notice()


class DlibDetector:
    """The dlib detector; `faces` says how faces are found: "hog", "cnn" or "hog-then-cnn".

    Raises `MissingDependencyError` without dlib or its model files, `ConfigError` for another `faces`.
    """

    def __init__(self, faces: str = "hog-then-cnn") -> None:
        if faces not in FACE_DETECTORS:
            raise ConfigError(f"faces are found by one of {', '.join(FACE_DETECTORS)}, got {faces!r}")
        self._dlib = import_dlib()
        self._faces = faces
        self.name = "dlib" if faces == "hog-then-cnn" else f"dlib-{faces}"
        self._hog = self._dlib.get_frontal_face_detector()
        self._predictor = _load_predictor()

    def detect_faces(self, picture: UInt8[np.ndarray, "h w 3"], effort: Effort = "full") -> list[FaceDetection]:
        """Faces, the largest first.

        Large pictures are reduced and small ones enlarged for the search. "hog-then-cnn" stops at the first of these
        that finds a face: HOG at 640 pixels ("quick" ends here), HOG at 1280, the CNN at 320 ("thorough" ends here, a
        third of a second at most), the CNN at 640. "hog" leaves out the CNN; "cnn" always runs it at 640.
        """
        if min(picture.shape[:2]) < SMALLEST_SIDE:
            return []
        if self._faces == "cnn":
            found = self._detect_cnn(picture, QUICK_SIDE)
        else:
            found = self._detect_hog(picture, QUICK_SIDE)
            if effort != "quick":
                found = found or self._detect_hog(picture, THOROUGH_SIDE)
            if effort != "quick" and self._faces == "hog-then-cnn":
                found = found or self._detect_cnn(picture, COARSE_SIDE)
                found = found or (self._detect_cnn(picture, QUICK_SIDE) if effort == "full" else [])
        return sorted(found, key=lambda face: -face.area)

    def align(self, picture: UInt8[np.ndarray, "h w 3"], box: Box) -> Landmarks2D:
        """The landmarks of the face in `box`: mean of five moved boxes, from the start with the least scatter."""
        wanted = frame_from_box(box)
        best: tuple[float, np.ndarray, np.ndarray] | None = None
        for start in STILL_STARTS:
            face = wanted.moved(x=start)
            for _ in range(2):  # the answer gives a better box (position, size, roll)
                face = frame_from_points(self._predict(picture, face, UNMOVED)[0])
            points, scatter = _mean_and_scatter(self._predict(picture, face, STILL_MOVES), face)
            if not _fills(points, wanted):
                scatter = scatter + STRAYED_SCATTER
            median = float(np.median(scatter))
            if best is None or median < best[0]:
                best = (median, points, scatter)
            if median < DOUBTFUL_SCATTER:
                break
        landmarks = _landmarks(best[1], best[2], picture)
        likeness = self._likeness(picture, frame_from_points(landmarks.points))
        return replace(landmarks, confidence=landmarks.confidence * likeness)

    def refine(self, picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "68 2"]) -> Landmarks2D:
        """The landmarks of the face near `points`: mean of three moved boxes, about 2 ms."""
        face = frame_from_points(points)
        return _landmarks(*_mean_and_scatter(self._predict(picture, face, QUICK_MOVES), face), picture)

    def _likeness(self, picture: np.ndarray, face: FaceFrame) -> float:
        """How much the upright crop looks like the face that the landmarks claim, UNLIKE to 1.

        HOG scores here: -0.2 and more on fitted faces up to a yaw of 40 degrees, below -1 or none on profiles whose
        landmarks lie on the cheek, and on walls.
        """
        crop, _ = grey_face_crop(picture, face, LIKENESS_SIDE, LIKENESS_MARGIN)
        best = LIKENESS_SCORES[0]
        for box, score in zip(*self._hog.run(crop, 0, LIKENESS_SCORES[0])[:2], strict=True):
            shift = np.array([box.left() + box.right(), box.top() + box.bottom()]) / 2 - (len(crop) - 1) / 2
            if np.abs(shift).max() < 0.3 * LIKENESS_SIDE and 0.65 < box.width() / LIKENESS_SIDE < 1.5:
                best = max(best, score)
        return float(np.interp(best, LIKENESS_SCORES, (UNLIKE, 1.0)))

    def _predict(self, picture: np.ndarray, face: FaceFrame, moves: Moves) -> Float[np.ndarray, "n 68 2"]:
        """The predictor's answers for the moved boxes on one upright crop of the face."""
        crop, to_image = grey_face_crop(picture, face, CROP_SIDE, CROP_MARGIN)
        answers = []
        for x, y, scale in moves:
            side = 2 * round(scale * CROP_SIDE / 2)
            left, top = (round(shift * CROP_SIDE) + CROP_MARGIN + (CROP_SIDE - side) // 2 for shift in (x, y))
            parts = self._predictor(crop, self._dlib.rectangle(left, top, left + side - 1, top + side - 1)).parts()
            answers.append(to_image.to_image(np.array([(part.x, part.y) for part in parts], np.float64)))
        return np.array(answers)

    def _detect_hog(self, picture: np.ndarray, longest_side: int) -> list[FaceDetection]:
        resized, scale = _resized(picture, longest_side)
        grey = cv2.cvtColor(resized, cv2.COLOR_RGB2GRAY)
        boxes, scores, _ = self._hog.run(grey, 0, 0.0)
        return [FaceDetection(_unscaled(box, scale), float(s)) for box, s in zip(boxes, scores, strict=True)]

    def _detect_cnn(self, picture: np.ndarray, longest_side: int) -> list[FaceDetection]:
        resized, scale = _resized(picture, longest_side)
        if min(resized.shape[:2]) < CNN_SHORTEST_SIDE:
            return []
        found = _load_cnn()(np.ascontiguousarray(resized), 0)
        return [FaceDetection(_unscaled(face.rect, scale), float(face.confidence)) for face in found]


def _mean_and_scatter(
    answers: Float[np.ndarray, "n 68 2"], face: FaceFrame
) -> tuple[Float[np.ndarray, "68 2"], Float[np.ndarray, "68"]]:
    """Mean of the answers, and each landmark's scatter (standard deviation) in box sides."""
    mean = answers.mean(axis=0)
    variance = ((answers - mean) ** 2).sum(axis=(0, 2)) / (len(answers) - 1)
    return mean, np.sqrt(variance) / face.side


def _fills(points: Float[np.ndarray, "68 2"], wanted: FaceFrame) -> bool:
    """Do the landmarks fill the box that they were asked for, rather than half of two faces?"""
    face = frame_from_points(points)
    distance = float(np.linalg.norm(face.origin - wanted.origin)) / wanted.side
    return distance < LARGEST_SHIFT and 0.7 < face.side / wanted.side < 1.4


def _landmarks(points: Float[np.ndarray, "68 2"], scatter: Float[np.ndarray, "68"], picture: np.ndarray) -> Landmarks2D:
    """Confidence from scatter: the point's own and the face's in equal parts, since few runs measure one roughly."""
    squared = (scatter**2 + np.median(scatter) ** 2) / 2
    confidence = np.exp(-0.5 * squared / CONFIDENCE_SCATTER**2)
    return Landmarks2D(points, confidence, (picture.shape[1], picture.shape[0]))


def _resized(picture: np.ndarray, longest_side: int) -> tuple[np.ndarray, float]:
    """The picture with its longest side brought to `longest_side` (enlarged 4 times at most), and the scale."""
    height, width = picture.shape[:2]
    scale = min(longest_side / max(height, width), MAX_ENLARGEMENT)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    if size == (width, height):
        return picture, 1.0
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR), scale


def _unscaled(rectangle: object, scale: float) -> Box:
    """dlib's first and last pixel indices in the resized picture as the box's edges in the picture."""
    edges = (rectangle.left(), rectangle.top(), rectangle.right() + 1, rectangle.bottom() + 1)
    left, top, right, bottom = (edge / scale - 0.5 for edge in edges)  # edge 0 lies half a pixel before centre 0
    return left, top, right, bottom


def import_dlib() -> ModuleType:
    """The dlib module; raises `MissingDependencyError` with the line that installs it."""
    try:
        import dlib
    except ImportError as error:
        raise MissingDependencyError(_install_line("dlib")) from error
    return dlib


def model_path(file_name: str) -> Path:
    """A model file of the package face_recognition_models, found without importing it.

    (Importing it needs pkg_resources, which setuptools has removed.) Raises `MissingDependencyError` if it is absent.
    """
    spec = importlib.util.find_spec("face_recognition_models")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        path = Path(folder) / "models" / file_name
        if path.is_file():
            return path
    raise MissingDependencyError(_install_line(f"the model file {file_name} (package face_recognition_models)"))


def check_installed() -> None:
    """Raises `MissingDependencyError` unless dlib and all its model files can be used."""
    import_dlib()
    for name in (PREDICTOR_FILE, CNN_FILE):
        model_path(name)


def _install_line(what: str) -> str:
    return f"the dlib detector needs {what}: {install_command('dlib')}"


@cache
def _load_predictor() -> object:
    return import_dlib().shape_predictor(str(model_path(PREDICTOR_FILE)))


@cache
def _load_cnn() -> object:
    return import_dlib().cnn_face_detection_model_v1(str(model_path(CNN_FILE)))
