"""The face that a user named by a point, also where detectors stop at larger ones."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, islice

import numpy as np
from jaxtyping import Float, UInt8

from workbench.landmarks.detection import Box, Effort, FaceDetection, LandmarkDetector
from workbench.networks.face_finder import part_sides

Point = tuple[float, float]
SMALLEST_PART = 64
"""Side in pixels of the smallest part around the point: a face of 16 pixels is a quarter of it."""
THOROUGH_PARTS = 2
"""The largest parts, which are looked at thoroughly as well: that takes seconds."""
MARGIN = 0.3
"""Box sides by which a point may lie beside a box, which leaves out forehead and ears, if it lies in no other one."""
LIKE = 2.0
"""By so much a face that was lost may have become larger or smaller until it is found again."""


def named_faces(
    detector: LandmarkDetector,
    picture: UInt8[np.ndarray, "h w 3"],
    point: Point,
    effort: Effort,
    place: Float[np.ndarray, "2"] | None,
    side: float,
) -> list[FaceDetection]:
    """The faces that can be the one at `point`: until it is found, `faces_at`; where it was lost, `faces_like`.

    It was lost at `place`; None after a cut, when any may be it. `side` is that of its box, 0 until it is found.
    """
    if side == 0.0:
        return faces_at(detector, picture, point, effort)
    if place is None:
        return detector.detect_faces(picture, effort)
    return faces_like(detector, picture, (float(place[0]), float(place[1])), side, effort)


def faces_at(
    detector: LandmarkDetector, picture: UInt8[np.ndarray, "h w 3"], point: Point, effort: Effort
) -> list[FaceDetection]:
    """The faces whose boxes hold `point` (x, y in pixels); none where the detector finds none there.

    But for "quick", ever smaller parts of the picture around the point are looked at until one shows such a face, as
    detectors look for small faces only where they see no large one: quickly, and for "full" once more thoroughly.
    """
    found = detector.detect_faces(picture, effort)
    if here := _holding(found, point):
        return here
    if effort != "quick":
        for seen in _in_parts(detector, picture, point, "quick"):
            if here := _holding(seen, point):
                return here
            found = [*found, *seen]
    if (near := _holding(found, point, MARGIN)) or effort != "full":
        return near
    thorough = (_holding(seen, point) for seen in _in_parts(detector, picture, point, "thorough", THOROUGH_PARTS))
    return next(filter(None, thorough), [])


def faces_like(
    detector: LandmarkDetector, picture: UInt8[np.ndarray, "h w 3"], point: Point, side: float, effort: Effort
) -> list[FaceDetection]:
    """The faces about as large as one with this box side (pixels) that was lost at `point`, wherever they are now.

    Others are not it, however near. But for "quick", parts of the picture around the point are looked at as well where
    the whole shows no such face.
    """
    looks = chain(
        [detector.detect_faces(picture, effort)],
        [] if effort == "quick" else _in_parts(detector, picture, point, "quick"),
    )
    like = ([face for face in seen if side / LIKE < face.area**0.5 < side * LIKE] for seen in looks)
    return next(filter(None, like), [])


def _in_parts(
    detector: LandmarkDetector,
    picture: UInt8[np.ndarray, "h w 3"],
    point: Point,
    effort: Effort,
    most: int | None = None,
) -> Iterator[list[FaceDetection]]:
    """What the detector finds in each part around the point, in pixels of the picture."""
    for left, top, part in islice(_parts_around(picture, point), most):
        yield [_shifted(face, left, top) for face in detector.detect_faces(part, effort)]


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
