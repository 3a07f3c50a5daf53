"""MediaPipe's face landmarker as a detector: its mesh of 478 points, of which 68 are taken.

The package and its model file are the user's: `pip install --no-deps mediapipe`, as what it depends on would overwrite
the headless OpenCV, and `face_landmarker.task` from MediaPipe's pages. The 68 points are those of
`landmarks.formats.mediapipe`.
"""

from collections.abc import Iterator
from pathlib import Path
from threading import Lock

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import ConfigError, MissingDependencyError
from workbench.landmarks.alignment import MEAN_SHAPE, FaceFrame, frame_from_box, frame_from_points, sampled
from workbench.landmarks.detection import Box, Effort, FaceDetection
from workbench.landmarks.formats.mediapipe import ibug_points
from workbench.landmarks.observations import Landmarks2D

INSTALL = 'pip install --no-deps "mediapipe>=1.2,<2"'
MODEL_PAGE = "https://ai.google.dev/edge/mediapipe/solutions/vision/face_landmarker"
MOST_FACES = 5
CROP_SIDE, CROP_BOXES = 512, 2.4
"""Pixels and face boxes across what is looked at near a known face: its own finder wants some room around a face."""
CROP_DROP = 0.1
"""How far the crop's centre is below the box's, in box sides."""
PART = 0.6
"""Width and height of the parts in which a face is looked for that the whole picture does not show."""


class MediapipeDetector:
    """MediaPipe's landmarker, one picture at a time: the same picture gives the same points.

    It tells no confidence, so that every point of a face that it finds is certain, and worthless where it finds none.
    """

    name = "mediapipe"

    def __init__(self, model: str | Path | None) -> None:
        """`model` is the path of `face_landmarker.task`.

        Raises `MissingDependencyError` without the package, and `ConfigError` without a model file that it can read.
        """
        try:
            import mediapipe
            from mediapipe.tasks.python import BaseOptions, vision
        except ModuleNotFoundError as error:
            raise MissingDependencyError(f"the detector mediapipe needs MediaPipe: {INSTALL}") from error
        path = _model_file(model)
        options = vision.FaceLandmarkerOptions(
            base_options=BaseOptions(model_asset_path=str(path)), num_faces=MOST_FACES
        )
        try:
            self._landmarker = vision.FaceLandmarker.create_from_options(options)
        except (RuntimeError, ValueError) as error:
            reason = str(error).strip().split("\n")[0]
            raise ConfigError(f"MediaPipe cannot use {path} as a face landmarker: {reason}") from error
        self._image, self._format = mediapipe.Image, mediapipe.ImageFormat.SRGB
        self._lock = Lock()

    def detect_faces(self, picture: UInt8[np.ndarray, "h w 3"], effort: Effort = "full") -> list[FaceDetection]:
        """Faces, the largest first: in the whole picture, and but for "quick" in its four corners if there is none."""
        faces = self._faces(picture)
        if not faces and effort != "quick":
            parts = ([points + corner for points in self._faces(part)] for part, corner in _corners(picture))
            faces = next(filter(None, parts), [])
        found = [FaceDetection(frame_from_points(points).box(), 1.0) for points in faces]
        return sorted(found, key=lambda face: -face.area)

    def align(self, picture: UInt8[np.ndarray, "h w 3"], box: Box) -> Landmarks2D:
        """The landmarks of the face in `box`; of an average face, without confidence, where there is none."""
        frame = frame_from_box(box)
        return self._near(picture, frame, frame.to_image(MEAN_SHAPE))

    def refine(self, picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "68 2"]) -> Landmarks2D:
        """The landmarks of the face near `points`; these, without confidence, where there is none."""
        return self._near(picture, frame_from_points(points), points)

    def _near(self, picture: np.ndarray, face: FaceFrame, otherwise: np.ndarray) -> Landmarks2D:
        """The face that is nearest to the middle of an upright crop."""
        to_image = face.moved(y=CROP_DROP, scale=CROP_BOXES).crop(CROP_SIDE)
        found = self._faces(sampled(picture, to_image, CROP_SIDE, cv2.BORDER_CONSTANT))
        size = (picture.shape[1], picture.shape[0])
        if not found:
            return Landmarks2D(otherwise, np.zeros(68), size)
        off = [np.linalg.norm(points.mean(axis=0) - CROP_SIDE / 2) for points in found]
        return Landmarks2D(to_image.to_image(found[int(np.argmin(off))]), np.ones(68), size)

    def _faces(self, picture: UInt8[np.ndarray, "h w 3"]) -> list[Float[np.ndarray, "68 2"]]:
        """The points of every face, in pixels."""
        size = (picture.shape[1], picture.shape[0])
        image = self._image(image_format=self._format, data=np.ascontiguousarray(picture))
        with self._lock:
            faces = self._landmarker.detect(image).face_landmarks
        meshes = (np.array([(point.x, point.y) for point in face]) for face in faces)
        return [ibug_points("MediaPipe", mesh, size) for mesh in meshes]


def _corners(picture: np.ndarray) -> Iterator[tuple[np.ndarray, tuple[int, int]]]:
    """Four overlapping parts of a picture, each with the pixel at its upper left."""
    height, width = (round(PART * length) for length in picture.shape[:2])
    for top in (0, picture.shape[0] - height):
        for left in (0, picture.shape[1] - width):
            yield picture[top : top + height, left : left + width], (left, top)


def _model_file(model: str | Path | None) -> Path:
    """The model's path; raises `ConfigError` if none is named or the file does not exist."""
    if not model:
        raise ConfigError(
            "the detector mediapipe needs MediaPipe's model file: download face_landmarker.task from "
            f"{MODEL_PAGE} and set landmarks.face_landmarker to its path"
        )
    path = Path(model).expanduser()
    if not path.is_file():
        raise ConfigError(f"landmarks.face_landmarker: there is no file {path}")
    return path
