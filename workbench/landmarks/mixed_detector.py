"""dlib's landmarks with the lids of the workbench's network, and the network's own on faces that are turned aside.

dlib draws open eyes on closed ones and frontal faces on profiles; the network does neither. Elsewhere lips stay dlib's:
on two real clips the network's inner lips made the errors of the fit 3 and 10 % larger.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8

from workbench.landmarks.detection import Box, Effort, FaceDetection, LandmarkDetector
from workbench.landmarks.lids import with_lids
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.turned_faces import sureness, turn_deg

TURNED_DEG = (40.0, 55.0)
"""Turns between which the network takes over: dlib's predictor was not trained beyond some 45 degrees."""
LOOKED_AT_DEG = 35.0
"""Turn of a followed face from which the network looks by itself."""
LEAST_SURE = 0.3
"""Sureness below which a detector's answer is nothing: the network's on a face that it takes for turned, or dlib's on
one between `TURNED_DEG`, where its points may have strayed."""


class MixedDetector:
    """Faces and landmarks by one detector; lids, turned faces and those that the first does not find by another one."""

    name = "dlib+network"

    def __init__(self, face: LandmarkDetector, network: LandmarkDetector) -> None:
        self._face, self._network = face, network

    def detect_faces(self, picture: UInt8[np.ndarray, "h w 3"], effort: Effort = "full") -> list[FaceDetection]:
        """Faces, the largest first, as the first detector finds them, or as the second one does if there are none."""
        return self._face.detect_faces(picture, effort) or self._network.detect_faces(picture, effort)

    def align(self, picture: UInt8[np.ndarray, "h w 3"], box: Box) -> Landmarks2D:
        """The landmarks of the face in `box`: the second detector's if it is turned aside, else with its lids."""
        return self._mixed(picture, self._network.align(picture, box), lambda: self._face.align(picture, box))

    def refine(self, picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "68 2"]) -> Landmarks2D:
        """The landmarks of the face near `points`: the second detector's if it is turned aside, else with its lids."""
        if turn_deg(points) < LOOKED_AT_DEG:
            return self._with_lids(picture, self._face.refine(picture, points))
        return self._mixed(picture, self._network.refine(picture, points), lambda: self._face.refine(picture, points))

    def _mixed(self, picture: np.ndarray, seen: Landmarks2D, frontal: Callable[[], Landmarks2D]) -> Landmarks2D:
        """The network's look at a face that is turned aside; `frontal` is asked only where it counts."""
        share = _turned(seen)
        return seen if share == 1.0 else _mean(self._with_lids(picture, frontal()), seen, share)

    def _with_lids(self, picture: np.ndarray, face: Landmarks2D) -> Landmarks2D:
        return with_lids(face, self._network.refine(picture, face.points))


def _turned(seen: Landmarks2D) -> float:
    """How much a look at a face counts beside a frontal detector's, 0 to 1."""
    if sureness(seen) < LEAST_SURE:
        return 0.0
    return float(np.interp(turn_deg(seen.points), TURNED_DEG, (0.0, 1.0)))


def _mean(first: Landmarks2D, second: Landmarks2D, share: float) -> Landmarks2D:
    """Between two detectors' landmarks, by the share of the second; all its, where the first is unsure."""
    if share == 0.0:
        return first
    if sureness(first) < LEAST_SURE:
        return second
    points, confidence = (
        (1.0 - share) * getattr(first, name) + share * getattr(second, name) for name in ("points", "confidence")
    )
    return replace(first, points=points, confidence=confidence)
