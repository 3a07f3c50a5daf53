"""N(F*): the network's landmarks in the photo, in the same crop that a render of this face would get."""

from dataclasses import replace
from functools import cache, lru_cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from workbench.energies.deep import confidence_of, crop_of
from workbench.errors import ModelError
from workbench.landmarks.dense_detector import bundled_dense_network
from workbench.landmarks.network_detector import BUNDLED as BUNDLED_FOLDER
from workbench.landmarks.network_detector import CROP_BOXES, STILL_MOVES, bundled_landmark_network
from workbench.landmarks.observations import Landmarks2D, of_ibug68
from workbench.landmarks.scheme import IBUG68, LandmarkScheme, mirror_points
from workbench.landmarks.schemes import DENSE
from workbench.networks import (
    CropBox,
    DenseNetwork,
    EnergyNetwork,
    EnsembleNetwork,
    LandmarkNetwork,
    landmarks_of,
    read_landmark_network,
    read_weights,
    reduction_for,
    to_picture,
)
from workbench.networks.dense_network import NAME as DENSE_NETWORK
from workbench.networks.dense_network import dense_network_from
from workbench.networks.fan import NAME as FAN
from workbench.networks.fan import fan_from
from workbench.networks.landmark_network import landmark_network_from
from workbench.networks.regression import NUMBERS, covariance_of
from workbench.runtime import COMPUTING

LOOKS = 2
"""The first evaluation corrects the crop for the second."""


@cache
def bundled_heat_maps() -> LandmarkNetwork:
    """Heat maps by weights that learned from painted heads, like those we render; photo and render go through them in
    the papers' presets. The detector's were trained further on photographed skin."""
    return read_landmark_network(BUNDLED_FOLDER / "heat_maps.safetensors")


@cache
def bundled_ensemble() -> EnsembleNetwork:
    """Both of our networks of 68 points as one."""
    return EnsembleNetwork(bundled_heat_maps(), bundled_landmark_network())


BUNDLED = {
    "ensemble": bundled_ensemble,
    "heat-maps": bundled_heat_maps,
    "landmarks": bundled_landmark_network,
    "dense": bundled_dense_network,
}
"""The networks that come with the package, by what a configuration calls them."""


def energy_network(name: str) -> EnergyNetwork:
    """N: one of `BUNDLED`, or the network of a weights file: 3D-FAN's or one of our own two kinds.

    Raises `InputError` or `ModelError` if the file cannot be read, or has other points than the scheme `dense`.
    """
    if name in BUNDLED:
        return BUNDLED[name]()
    return _network_of(name, Path(name).stat().st_mtime_ns if Path(name).is_file() else None)


@lru_cache(maxsize=4)
def _network_of(name: str, _written_ns: int | None) -> EnergyNetwork:
    """The network of a weights file as of when it was written: training may write it again."""
    weights = read_weights(name)
    if weights.architecture == DENSE_NETWORK:
        return _of_the_scheme(dense_network_from(weights), weights.origin)
    return fan_from(weights) if weights.architecture == FAN else landmark_network_from(weights)


def network_scheme(name: str) -> LandmarkScheme:
    """What the points are called that a network (`energy_network`) sees. Raises as that does."""
    return DENSE if isinstance(energy_network(name), DenseNetwork) else IBUG68


def _of_the_scheme(network: DenseNetwork, origin: str) -> DenseNetwork:
    points = len(network.head.bias) // NUMBERS
    if points != len(DENSE):
        raise ModelError(
            f"the dense network of {origin} should answer the {len(DENSE)} points of the scheme {DENSE.name!r}, it "
            f"answers {points}; train it on that scheme"
        )
    return network


def photo_landmarks(network: EnergyNetwork, picture: UInt8[np.ndarray, "h w 3"], detected: Landmarks2D) -> Landmarks2D:
    """N(F*) for a detected face, in full-resolution pixels (Deep Energies Sec. 4), about the 68 points of whoever found
    it: the points that the network knows, a dense one's each with its covariance."""
    points = of_ibug68(detected).points
    for _ in range(LOOKS):
        with COMPUTING:
            box = crop_of(network, jnp.asarray(points))
            seen, confidence = _look(network, picture, box, reduction_for(box))
            points = np.asarray(seen.points, float)
    covariance = None if seen.whitening is None else covariance_of(np.asarray(seen.whitening, float))
    return Landmarks2D(points, np.clip(np.asarray(confidence, float), 0.0, 1.0), detected.image_size, covariance)


def steadied(network: EnergyNetwork, picture: UInt8[np.ndarray, "h w 3"], seen: Landmarks2D) -> Landmarks2D:
    """`photo_landmarks`, moved by the difference between the mean of several looks and a single one.

    The looks are at crops somewhat higher, lower, closer and farther, each of the picture and of its mirror image,
    because the network errs differently in each. For what is learned of a person once: a solve's N(F) is one look, and
    so is its N(F*). A point that was moved by hand stays moved.
    """
    looks = []
    with COMPUTING:
        box = crop_of(network, jnp.asarray(seen.points))
        for x, y, scale in STILL_MOVES:
            centre = to_picture(np.array([[x, y]]) / CROP_BOXES, box, 1)[0]
            moved = CropBox(centre, box.side * scale, box.roll)
            looks += [_points(network, picture, moved), _mirrored_points(network, picture, moved)]
    return replace(seen, points=seen.points + np.mean(looks, axis=0) - looks[0])


def _points(network: EnergyNetwork, picture: UInt8[np.ndarray, "h w 3"], box: CropBox) -> Float[np.ndarray, "points 2"]:
    return np.asarray(_look(network, picture, box, reduction_for(box))[0].points, float)


def _mirrored_points(
    network: EnergyNetwork, picture: UInt8[np.ndarray, "h w 3"], box: CropBox
) -> Float[np.ndarray, "points 2"]:
    """What the network sees in the mirrored picture, back in this one."""
    width, (x, y) = picture.shape[1], box.centre
    mirrored = CropBox(np.array([width - 1 - x, y]), box.side, -box.roll)
    points = _points(network, np.ascontiguousarray(picture[:, ::-1]), mirrored)
    return mirror_points(points, width, DENSE if isinstance(network, DenseNetwork) else IBUG68)


@partial(jax.jit, static_argnames=("reduction",))
def _look(network, picture, box, reduction):
    seen = landmarks_of(network, picture.astype(jnp.float32) / 255.0, box, reduction=reduction)
    return seen, confidence_of(network, seen)
