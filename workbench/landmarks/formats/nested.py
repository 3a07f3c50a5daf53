"""Points of faces nested in lists: JSON and `.npy` of face-alignment and MediaPipe.

In an `.npy` of numbers the last axes are points and x, y (and z, which is left alone): (n, 2) is one picture's face,
(frames, n, 2) one face per frame, (frames, faces, n, 2) several. A face with a NaN is none.

In JSON a point is `[x, y]`, `[x, y, z]` or `{"x": ..., "y": ..., ...}`, and a face is a list of points or
`{"landmark": [...]}`. A frame is a face, a list of faces, or a MediaPipe result: an object with `faceLandmarks`,
`face_landmarks`, `multiFaceLandmarks` or `multi_face_landmarks`, a list of faces; null or an empty list has no face.
The file is a frame or a list of frames; `[face, face]` are two frames.

Of several faces of a frame the largest is taken.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.landmarks.formats.points import face_landmarks
from workbench.landmarks.formats.records import LandmarkRecord, largest_face
from workbench.landmarks.observations import Landmarks2D
from workbench.reading import array_header, check_numbers_held, shortened

FACES_KEYS = ("faceLandmarks", "face_landmarks", "multiFaceLandmarks", "multi_face_landmarks")
FACE_KEYS = ("landmark", "landmarks")


def read_npy(path: Path, image_size: tuple[int, int]) -> list[LandmarkRecord]:
    """The records of an array. Raises `InputError` for other shapes and for Python objects."""
    with open(path, "rb") as stream:
        shape, dtype = array_header(stream)
        if dtype.hasobject:
            raise InputError(
                f"{path} holds Python objects, which are not read: save frames of equal numbers of faces as one array "
                "(frames, faces, 68, 2), NaN where a face is missing"
            )
        check_numbers_held(path.name, shape, dtype, path.stat().st_size)
        if dtype.kind not in "fiu" or not 2 <= len(shape) <= 4 or shape[-1] not in (2, 3):
            raise InputError(
                f"{path}: expected numbers of shape (68, 2), (frames, 68, 2) or (frames, faces, 68, 2), or the same "
                f"with MediaPipe's 468 or 478 points, got {shortened(shape)} of {dtype.name}"
            )
        stream.seek(0)
        points = np.load(stream, allow_pickle=False)[..., :2].astype(np.float64)
    frames = points.reshape((1,) * (4 - points.ndim) + shape[:-1] + (2,)) if len(shape) != 3 else points[:, None]
    return [
        _record(path, index, [face for face in faces if not np.isnan(face).any()], image_size)
        for index, faces in enumerate(frames)
    ]


def is_of_another_program(content: Any) -> bool:
    """Whether a JSON's content is a list of something, or an object in MediaPipe's words."""
    return bool(content) and (isinstance(content, list) or (isinstance(content, dict) and _key(content) is not None))


def read_nested(path: Path, content: Any, image_size: tuple[int, int]) -> list[LandmarkRecord]:
    """The records of a JSON's content. Raises `InputError` with the entry that is wrong."""
    frames = [content] if isinstance(content, dict) or _is_face(content) else content
    places = [f"{path}, entry {index}" for index in range(len(frames))]
    return [
        _record(path, index, [_points(where, face) for face in _faces(where, frame)], image_size)
        for index, (where, frame) in enumerate(zip(places, frames, strict=True))
    ]


def _record(path: Path, index: int, faces: Sequence[np.ndarray], size: tuple[int, int]) -> LandmarkRecord:
    found: list[Landmarks2D] = [face_landmarks(f"{path}, entry {index}", face, None, size) for face in faces]
    return LandmarkRecord(index, f"{path.stem}#{index}", largest_face(found), size)


def _key(entry: Mapping[str, Any]) -> str | None:
    return next((key for key in (*FACES_KEYS, *FACE_KEYS) if key in entry), None)


def _is_point(entry: Any) -> bool:
    if isinstance(entry, dict):
        return "x" in entry and "y" in entry
    return isinstance(entry, list) and len(entry) in (2, 3) and all(isinstance(value, int | float) for value in entry)


def _is_face(entry: Any) -> bool:
    return isinstance(entry, list) and len(entry) > 0 and _is_point(entry[0])


def _faces(where: str, frame: Any) -> list[Any]:
    if isinstance(frame, dict):
        key = _key(frame)
        if key is None:
            raise InputError(f"{where}: expected one of {', '.join(FACES_KEYS)}, got {shortened(', '.join(frame))}")
        frame = frame[key] if key in FACES_KEYS else [frame[key]]
    elif _is_face(frame):
        frame = [frame]
    if frame is not None and not isinstance(frame, list):
        raise InputError(f"{where}: expected a list of faces, got {shortened(repr(frame))}")
    return frame or []


def _points(where: str, face: Any) -> np.ndarray:
    if isinstance(face, dict):
        face = next((face[key] for key in FACE_KEYS if key in face), None)
    if not isinstance(face, list) or not all(_is_point(point) for point in face):
        told = shortened(repr(face))
        raise InputError(f"{where}: expected a face as a list of points, each [x, y] or with x and y, got {told}")
    try:
        pairs = [(point["x"], point["y"]) if isinstance(point, dict) else point[:2] for point in face]
        return np.array(pairs, np.float64).reshape(-1, 2)
    except (ValueError, TypeError, OverflowError):
        raise InputError(f"{where}: x and y of a point are not numbers") from None
