"""What the heat maps of 68 landmarks tell of the dense network's other points.

Both networks answer the 68, the heat maps more exactly, and the dense network's errors of neighbouring points go
together. So what it misses at the 68 is the best linear estimate of what it misses elsewhere: a Kalman gain.
"""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.errors import ModelError
from workbench.networks.landmark_network import LANDMARKS
from workbench.networks.regression import Places
from workbench.networks.weights import Weights, fill, read_weights
from workbench.reading import shortened

NAME = "face-energy-dense-gain-1"
"""Value of the metadata key `architecture`."""
MOST_PX = 20.0
"""Of 256: by so much the networks may differ at a landmark. Beyond it one of them is lost, and neither says how far."""


class DenseGain(eqx.Module):
    """Learned on renders by least squares; `training.dense_gain`."""

    gain: Float[AnyArray, "moves differences"]
    """x and y of each further point by x and y of each of the 68."""
    deviation_factor: Float[AnyArray, "n"]
    """Of the deviations that the dense network claims for its further points, how much is left."""

    def corrected(self, seen: Places, landmarks: Float[np.ndarray, "68 2"]) -> Places:
        """The dense network's answer in a crop, its further points moved by what the heat maps' landmarks tell."""
        points, whitening = np.array(seen.points), np.array(seen.whitening)
        first = len(points) - len(self.deviation_factor)
        points[first:] += (self.gain @ differences(seen.points, landmarks)).reshape(-1, 2)
        whitening[first:] /= self.deviation_factor[:, None, None]
        return Places(points, whitening)


def differences(points: Float[np.ndarray, "*n points 2"], landmarks: Float[np.ndarray, "*n 68 2"]) -> np.ndarray:
    """How far the heat maps' landmarks are from the dense network's, bounded: one column per coordinate."""
    apart = np.clip(landmarks - points[..., :LANDMARKS, :], -MOST_PX, MOST_PX)
    return apart.reshape(*apart.shape[:-2], -1)


def read_dense_gain(path: str | Path) -> DenseGain:
    """The gain of a safetensors file.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of something else.
    """
    weights = read_weights(path)
    if weights.architecture != NAME:
        raise ModelError(
            f"{weights.origin} should hold a {NAME}, but its metadata names {shortened(weights.architecture)}"
        )
    return fill(lambda: _empty(_points(weights)), weights)


def _empty(points: int) -> DenseGain:
    def zeros(*shape: int) -> Array:
        return jnp.zeros(shape, jnp.float32)

    return DenseGain(zeros(2 * points, 2 * LANDMARKS), zeros(points))


def _points(weights: Weights) -> int:
    factor = weights.arrays.get("deviation_factor")
    return 1 if factor is None or factor.ndim != 1 else len(factor)
