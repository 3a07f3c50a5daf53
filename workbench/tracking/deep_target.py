"""N(F*): the network's landmarks in the photo, in the same crop that a render of this face would get."""

from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt8

from workbench.energies.deep import crop_of
from workbench.landmarks.network_detector import bundled_landmark_network
from workbench.landmarks.observations import Landmarks2D, of_ibug68
from workbench.networks import Fan, LandmarkNetwork, landmarks_of, read_weights, reduction_for
from workbench.networks.fan import NAME as FAN
from workbench.networks.fan import fan_from
from workbench.networks.landmark_network import landmark_network_from
from workbench.runtime import COMPUTING

LOOKS = 2
"""The first evaluation corrects the crop for the second."""


@cache
def energy_network(path: str) -> Fan | LandmarkNetwork:
    """The landmark network of a weights file, 3D-FAN's or our own; the bundled one for an empty path.

    Raises `InputError` or `ModelError` if the file cannot be read.
    """
    if not path:
        return bundled_landmark_network()
    weights = read_weights(path)
    return fan_from(weights) if weights.architecture == FAN else landmark_network_from(weights)


def photo_landmarks(
    network: Fan | LandmarkNetwork, picture: UInt8[np.ndarray, "h w 3"], detected: Landmarks2D
) -> Landmarks2D:
    """N(F*) for a detected face, in full-resolution pixels (Deep Energies Sec. 4): its 68 points, whoever found it."""
    points = of_ibug68(detected).points
    for _ in range(LOOKS):
        with COMPUTING:
            box = crop_of(network, jnp.asarray(points))
            seen, confidence = _look(network, picture, box, reduction_for(box))
            points = np.asarray(seen, float)
    return Landmarks2D(points, np.clip(np.asarray(confidence, float), 0.0, 1.0), detected.image_size)


@partial(jax.jit, static_argnames=("reduction",))
def _look(network, picture, box, reduction):
    seen = landmarks_of(network, picture.astype(jnp.float32) / 255.0, box, reduction=reduction)
    return seen.points, network.confidence_of(seen.heat_maps)
