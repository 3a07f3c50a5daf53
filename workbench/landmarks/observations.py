"""The record that every detector, tracker and landmark file delivers."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Num

from workbench.errors import InputError
from workbench.landmarks.scheme import check_68


@dataclass(frozen=True, eq=False)
class Landmarks2D:
    """The 68 iBUG points of one face in one picture; checked and read-only.

    Raises `InputError` for another count or shape, a point that is not finite (the first one is named), a confidence
    outside 0..1 or an empty image size.
    """

    points: Num[np.ndarray, "..."]
    """(68, 2): x right, y down, in pixels, (0, 0) the centre of the top-left pixel; may lie outside the picture."""
    confidence: Num[np.ndarray, "..."]
    """(68,): 0 (worthless) to 1 (certain)."""
    image_size: tuple[int, int]
    """(width, height) of the picture, in pixels."""

    def __post_init__(self) -> None:
        points = check_68(np.asarray(self.points))
        confidence = np.array(self.confidence, np.float64)
        bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
        if bad.size:
            raise InputError(f"landmark {bad[0]} is {points[bad[0]].tolist()}: every point must be finite")
        if confidence.shape != (len(points),):
            raise InputError(f"expected one confidence for each of 68 landmarks, got shape {confidence.shape}")
        bad = np.flatnonzero(~((confidence >= 0) & (confidence <= 1)))
        if bad.size:
            raise InputError(f"the confidence of landmark {bad[0]} is {confidence[bad[0]]}: it must lie in 0..1")
        width, height = (int(length) for length in self.image_size)
        if width < 1 or height < 1:
            raise InputError(f"the image size is (width, height) of at least one pixel, got {self.image_size}")
        points.setflags(write=False)
        confidence.setflags(write=False)
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "confidence", confidence)
        object.__setattr__(self, "image_size", (width, height))
