"""The face at a point that a user named, also where detectors stop at larger ones."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import UInt8

from workbench.landmarks.detection import Box, Effort, FaceDetection, LandmarkDetector
from workbench.networks.face_finder import part_sides

Point = tuple[float, float]
SMALLEST_PART = 64
"""Side in pixels of the smallest part around the point: a face of 16 pixels is a quarter of it."""
MARGIN = 0.3
"""Box sides by which a point may lie beside a box, which leaves out forehead and ears, if it lies in no other one."""


def faces_at(
    detector: LandmarkDetector, picture: UInt8[np.ndarray, "h w 3"], point: Point, effort: Effort
) -> list[FaceDetection]:
    """The faces whose boxes hold `point` (x, y in pixels); none where the detector finds none there.

    But for "quick", ever smaller parts of the picture around the point are looked at until one shows such a face, as
    detectors look for small faces only where they see no large one: quickly, and for "full" once more thoroughly.
    """
    found = detector.detect_faces(picture, effort)
    if (here := _holding(found, point)) or effort == "quick":
        return here
    looks: tuple[Effort, ...] = ("quick", "thorough") if effort == "full" else ("quick",)
    for look, (left, top, part) in product(looks, _parts_around(picture, point)):
        seen = [_shifted(face, left, top) for face in detector.detect_faces(part, look)]
        if here := _holding(seen, point):
            return here
        found += seen
    return _holding(found, point, MARGIN)


def _parts_around(
    picture: UInt8[np.ndarray, "h w 3"], point: Point
) -> Iterator[tuple[int, int, UInt8[np.ndarray, "s t 3"]]]:
    """Left, top and pixels of parts of half the longer side, then of a quarter, …, moved into the picture."""
    height, width = picture.shape[:2]
    for side in part_sides(max(height, width), SMALLEST_PART):
        left, top = (
            round(min(max(place - side / 2, 0), max(length - side, 0)))
            for place, length in zip(point, (width, height), strict=True)
        )
        yield left, top, np.ascontiguousarray(picture[top : top + side, left : left + side])


def _holding(faces: list[FaceDetection], point: Point, margin: float = 0.0) -> list[FaceDetection]:
    return [face for face in faces if _holds(face.box, point, margin)]


def _holds(box: Box, point: Point, margin: float) -> bool:
    left, top, right, bottom = box
    x, y = point
    beside_x, beside_y = margin * (right - left), margin * (bottom - top)
    return bool(left - beside_x <= x <= right + beside_x and top - beside_y <= y <= bottom + beside_y)


def _shifted(face: FaceDetection, x: int, y: int) -> FaceDetection:
    left, top, right, bottom = face.box
    return replace(face, box=(left + x, top + y, right + x, bottom + y))
