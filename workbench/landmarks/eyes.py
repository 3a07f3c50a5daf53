"""Eyes by themselves: upright crops of each, and what the eye network sees in them."""

from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.landmarks.alignment import FaceFrame, frame_from_points, sampled
from workbench.landmarks.network_detector import BUNDLED
from workbench.landmarks.schemes import DENSE, PUPILS
from workbench.networks.eye_network import SIDE, EyeNetwork, read_eye_network
from workbench.networks.frozen import FrozenEyeNetwork
from workbench.networks.regression import covariance_of

EYE_BOXES = 0.27
"""Face boxes across an eye's crop: the corners of a frontal eye are about 60 % of it apart."""
CORNERS = ((36, 39), (42, 45))
"""Of the person's right and left eye."""
LEAST_OPEN = 0.02
"""Of how likely an eye is open: what a shut one's points still count."""
_FLIPPED = np.array([-1.0, 1.0])


def _iris_points() -> tuple[tuple[int, ...], tuple[int, ...]]:
    rings = DENSE.groups["irises"][len(PUPILS) :]
    right = (PUPILS[0], *rings[: len(rings) // 2])
    return right, tuple(DENSE.mirror[point] for point in right)


IRISES = np.array(_iris_points())
"""The numbers in the scheme `dense` of what the eye network sees, of the person's right and left eye."""


class SeenEyes(NamedTuple):
    """Pupils and irises in the picture, the right eye's and then the left one's, in the order of `IRISES`."""

    points: Float[np.ndarray, "2 9 2"]
    """Pixels."""
    covariance: Float[np.ndarray, "2 9 2 2"]
    """Square pixels; large where a lid hides the eye."""
    is_open: Float[np.ndarray, "2"]
    """How likely no lid hides the pupil."""


class EyeDetector:
    """Looks at the eyes of a face whose landmarks are known, with the bundled weights or others of the same kind."""

    def __init__(self, network: EyeNetwork | None = None) -> None:
        self._network = FrozenEyeNetwork(network or bundled_eye_network())

    def see(self, picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "points 2"]) -> SeenEyes:
        """Both eyes; a shut one's covariance is `1 / LEAST_OPEN²` times what the network claims."""
        return SeenEyes(*map(np.stack, zip(*(self._eye(picture, points, eye) for eye in (0, 1)), strict=True)))

    def _eye(self, picture, points, eye: int):
        to_image = eye_frame(points, eye)
        seen = self._network(eye_crop(picture, to_image, eye))
        places, whitening = seen.points, seen.whitening
        if eye == 1:
            places, whitening = places * _FLIPPED + [SIDE - 1.0, 0.0], whitening * _FLIPPED
        covariance = covariance_of(whitening) / max(float(seen.is_open), LEAST_OPEN) ** 2
        turn = to_image.matrix
        return to_image.to_image(places), turn @ covariance @ turn.T, seen.is_open


def eye_frame(points: Float[np.ndarray, "points 2"], eye: int, side: int = SIDE) -> FaceFrame:
    """The similarity from the pixels of an eye's crop to the picture's: about its corners, upright as the face is."""
    matrix = frame_from_points(points).matrix * EYE_BOXES
    return FaceFrame(matrix, points[list(CORNERS[eye])].mean(axis=0)).crop(side)


def eye_crop(
    picture: UInt8[np.ndarray, "h w 3"], to_image: FaceFrame, eye: int, side: int = SIDE
) -> UInt8[np.ndarray, "s s 3"]:
    """The network's input: a right eye, or a left one mirrored."""
    crop = sampled(picture, to_image, side, cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(crop[:, ::-1]) if eye == 1 else crop


@cache
def bundled_eye_network() -> EyeNetwork:
    """The eye network that comes with the package."""
    return read_eye_network(BUNDLED / "eyes.safetensors")
