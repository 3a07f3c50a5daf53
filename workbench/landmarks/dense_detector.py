"""Landmarks of the whole face, each with its covariance: the dense network beside the network detector's.

The heat maps say whether there is a face, and where its 68 points are; the dense network says where all others are, and
how surely each of them all, corrected by what it misses at the 68; pupils and irises are the eye network's. After Wood
et al., "3D Face Reconstruction with Dense Landmarks" (ECCV 2022).
"""

from functools import cache

import jax
import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray, library_of
from workbench.landmarks.alignment import FaceFrame
from workbench.landmarks.eyes import IRISES, EyeDetector
from workbench.landmarks.lids import true_lids
from workbench.landmarks.network_detector import BUNDLED, CROP_SIDE, NetworkDetector, crop_frame, sampled_crop
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import POINT_COUNT, error_unit
from workbench.landmarks.schemes import DENSE
from workbench.networks.dense_gain import DenseGain, read_dense_gain
from workbench.networks.dense_network import DenseNetwork, read_dense_network
from workbench.networks.eye_network import EyeNetwork
from workbench.networks.frozen import FrozenDenseNetwork
from workbench.networks.regression import Places, covariance_of

HEAT_MAP_DEVIATION = 0.6
"""Of the 68 points: what their places in the heat maps deviate by, as a share of what the dense network claims for its
own. On the bundled clips the share of the errors is 0.63 to 0.82."""
SHUT_DEVIATION = 0.6
"""Of a shut eye's lids: what their places deviate by, as a share of what they would in an open eye. By the bundled
clips, where `eyeBlink` comes out as 0.56 instead of 0.44 (median of the frames with shut eyes)."""
NEAR_PERCENT = 5.0
"""The confidence of a point that has no heat map: how likely it lies within this part of the outer-eye distance."""
LIDS = tuple(np.setdiff1d(DENSE.groups[name], IRISES) for name in ("right_eye", "left_eye"))
"""The numbers in the scheme `dense` of the corners and lids of the person's right and left eye."""
_MIRRORED = np.array([-1.0, 1.0])


class DenseDetector(NetworkDetector):
    """Finds faces as the network detector does, and answers the points of the scheme `dense`."""

    name = "dense"

    def __init__(self, dense: DenseNetwork | None = None, eyes: EyeNetwork | None = None) -> None:
        super().__init__()
        self._dense = FrozenDenseNetwork(dense or bundled_dense_network())
        self._gain = bundled_dense_gain() if dense is None else None
        self._eyes = EyeDetector(eyes)

    def _look(self, picture: np.ndarray, face: FaceFrame, mirrored: bool = False) -> Landmarks2D:
        to_image = crop_frame(face)
        crop = sampled_crop(picture, to_image, mirrored)
        landmarks, _ = self._answer(crop, picture, to_image, mirrored)
        places = _unmirrored(self._dense(crop)) if mirrored else self._dense(crop)
        if self._gain is not None:
            places = self._gain.corrected(places, to_image.to_face(landmarks.points))
        covariance = covariance_of(places.whitening)
        covariance[:POINT_COUNT] *= HEAT_MAP_DEVIATION**2
        turn = to_image.matrix
        covariance = turn @ covariance @ turn.T
        points = np.concatenate([true_lids(landmarks.points), to_image.to_image(places.points)[POINT_COUNT:]])
        eyes = self._eyes.see(picture, points)
        points[IRISES], covariance[IRISES] = eyes.points, eyes.covariance
        for lids, is_open in zip(LIDS, eyes.is_open, strict=True):
            covariance[lids] *= np.interp(is_open, (0.0, 1.0), (SHUT_DEVIATION, 1.0)) ** 2
        confidence = np.concatenate([landmarks.confidence, nearness(points, covariance)[POINT_COUNT:]])
        return Landmarks2D(points, confidence, landmarks.image_size, covariance)


@cache
def bundled_dense_network() -> DenseNetwork:
    """The dense network that comes with the package."""
    return read_dense_network(BUNDLED / "dense.safetensors")


@cache
def bundled_dense_gain() -> DenseGain:
    """What the bundled landmark network tells of the bundled dense network's points, in NumPy."""
    return jax.tree.map(np.asarray, read_dense_gain(BUNDLED / "dense_gain.safetensors"))


def _unmirrored(places: Places) -> Places:
    """Places of the mirrored crop in the crop's own pixels, by the number of the point that each really is."""
    order = list(DENSE.mirror)
    points = places.points[order] * _MIRRORED + np.array([CROP_SIDE - 1.0, 0.0])
    return Places(points, places.whitening[order] * _MIRRORED)


def nearness(face: Float[AnyArray, "points 2"], covariance: Float[AnyArray, "n 2 2"]) -> Float[AnyArray, "n"]:
    """How likely each point of a face lies within `NEAR_PERCENT`, were its covariance as large in every direction."""
    library = library_of(face)
    radius = 0.01 * NEAR_PERCENT * error_unit(face)
    return 1.0 - library.exp(-0.5 * radius**2 / library.sqrt(library.linalg.det(covariance)))
