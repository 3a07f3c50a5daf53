"""The record that every detector, tracker and landmark file delivers."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Num

from workbench.errors import InputError
from workbench.landmarks.scheme import IBUG68, POINT_COUNT, LandmarkScheme
from workbench.landmarks.schemes import scheme_of_count

SYMMETRIC = 1e-6
"""How far the two covariances of x and y may differ, as a share of both deviations: what single precision leaves."""
SINGULAR = 1e-9
"""A share of the variance below which nothing of it is left but rounding."""


@dataclass(frozen=True, eq=False)
class Landmarks2D:
    """The points of one face in one picture, by a landmark scheme; checked and read-only.

    Raises `InputError` for a count that no scheme has or another shape, a point that is not finite (the first one is
    named), a confidence outside 0..1, a covariance that is none or an empty image size.
    """

    points: Num[np.ndarray, "..."]
    """(points, 2): x right, y down, in pixels, (0, 0) the centre of the top-left pixel; may lie outside the picture."""
    confidence: Num[np.ndarray, "..."]
    """(points,): 0 (worthless) to 1 (certain)."""
    image_size: tuple[int, int]
    """(width, height) of the picture, in pixels."""
    covariance: Num[np.ndarray, "..."] | None = None
    """(points, 2, 2): of each place, squared pixels; None where the detector tells a confidence alone."""

    def __post_init__(self) -> None:
        points = np.asarray(self.points)
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"landmarks are an array of shape (68, 2), x and y in pixels; got shape {points.shape}")
        scheme_of_count(len(points))
        points = points.astype(np.float64)
        confidence = np.array(self.confidence, np.float64)
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        if bad.size:
            raise InputError(f"landmark {bad[0]} is {points[bad[0]].tolist()}: every point must be finite")
        if confidence.shape != (len(points),):
            raise InputError(f"expected one confidence for each of {len(points)} landmarks, got {confidence.shape}")
        bad = np.flatnonzero(~((confidence >= 0) & (confidence <= 1)))
        if bad.size:
            raise InputError(f"the confidence of landmark {bad[0]} is {confidence[bad[0]]}: it must lie in 0..1")
        width, height = (int(length) for length in self.image_size)
        if width < 1 or height < 1:
            raise InputError(f"the image size is (width, height) of at least one pixel, got {self.image_size}")
        covariance = None if self.covariance is None else _checked_covariance(self.covariance, len(points))
        for array in (points, confidence, covariance):
            if array is not None:
                array.setflags(write=False)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "confidence", confidence)
        object.__setattr__(self, "image_size", (width, height))
        object.__setattr__(self, "covariance", covariance)

    @property
    def scheme(self) -> LandmarkScheme:
        """What the points are called."""
        return scheme_of_count(len(self.points))

    @property
    def shows_face(self) -> bool:
        """False where all points are at one place or none has any confidence, as some programs write "no face"."""
        return bool(np.ptp(self.points, axis=0).any() and (self.confidence > 0.0).any())


def scheme_of_faces(faces: Iterable[Landmarks2D | None]) -> LandmarkScheme:
    """What the points of the first face are called; iBUG's 68 without a face."""
    return next((face.scheme for face in faces if face is not None), IBUG68)


def of_ibug68(landmarks: Landmarks2D) -> Landmarks2D:
    """The 68 points that every scheme begins with, for what knows no others."""
    if len(landmarks.points) == POINT_COUNT:
        return landmarks
    return Landmarks2D(landmarks.points[:POINT_COUNT], landmarks.confidence[:POINT_COUNT], landmarks.image_size)


def _checked_covariance(given: Num[np.ndarray, "..."], count: int) -> Num[np.ndarray, "points 2 2"]:
    covariance = np.array(given, np.float64)
    if covariance.shape != (count, 2, 2):
        raise InputError(f"expected a covariance (2, 2) for each of {count} landmarks, got shape {covariance.shape}")
    (xx, xy), (yx, yy) = np.moveaxis(covariance, 0, -1)
    with np.errstate(all="ignore"):
        # What of xx the other coordinate leaves open: zero to rounding where a matrix is all but singular.
        left = xx - xy * yx / yy
        symmetric = np.abs(xy - yx) <= SYMMETRIC * np.sqrt(xx * yy)
        sound = np.isfinite(covariance).all(axis=(1, 2)) & (xx > 0) & (yy > 0) & symmetric & (left > SINGULAR * xx)
    bad = np.flatnonzero(~sound)
    if bad.size:
        told = covariance[bad[0]].tolist()
        raise InputError(
            f"the covariance of landmark {bad[0]} is {told}: it must be finite, symmetric and positive definite"
        )
    return covariance
