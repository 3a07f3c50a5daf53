"""The network detector's 68 landmarks and the two pupils: where the eyes look, without the dense points."""

from dataclasses import replace

import numpy as np
from jaxtyping import UInt8

from workbench.landmarks.alignment import FaceFrame
from workbench.landmarks.dense_detector import nearness
from workbench.landmarks.eyes import EyeDetector
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.observations import Landmarks2D
from workbench.networks.eye_network import EyeNetwork


class PupilDetector(NetworkDetector):
    """Finds faces as the network detector does, and answers the points of the scheme `ibug68+pupils`.

    A pupil's confidence is how likely it lies within 5 % of the outer-eye distance: about 0 behind a shut lid.
    """

    name = "network+pupils"

    def __init__(self, eyes: EyeNetwork | None = None) -> None:
        super().__init__()
        self._eyes = EyeDetector(eyes)

    def _look(self, picture: UInt8[np.ndarray, "h w 3"], face: FaceFrame, mirrored: bool = False) -> Landmarks2D:
        seen = super()._look(picture, face, mirrored)
        eyes = self._eyes.see(picture, seen.points)
        points = np.concatenate([seen.points, eyes.points[:, 0]])
        pupils = nearness(points, eyes.covariance[:, 0])
        return replace(seen, points=points, confidence=np.concatenate([seen.confidence, pupils]))
