"""Points of the whole face by regression, each with its own uncertainty.

After Wood et al., "3D Face Reconstruction with Dense Landmarks" (ECCV 2022).

The landmark network's encoder, then two fully connected layers: 256×256 colours to the places of the 68 landmarks, two
pupils and the dense points, and to the covariance of each place.
"""

from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, library_of
from workbench.errors import ModelError
from workbench.networks.encoder import Encoder, encoder_convolutions, network_size
from workbench.networks.layers import Conv, empty_conv
from workbench.networks.weights import Weights, fill, read_weights
from workbench.reading import shortened

NAME = "face-energy-dense-1"
"""Value of the metadata key `architecture`."""
SIDE = 256
"""Pixels of the input, which the fully connected layers are made for."""
NUMBERS = 5
"""Of a point: x, y, and the three of its precision's Cholesky factor."""
LEAST_DEVIATION_PX, MOST_DEVIATION_PX = 0.15, 60.0
"""Between these lie the deviations that the network may claim."""


class Linear(eqx.Module):
    """A fully connected layer: `torch.nn.Linear`."""

    weight: Float[Array, "out in"]
    bias: Float[Array, "out"]

    def __call__(self, x: Float[Array, "in"]) -> Float[Array, "out"]:
        """W·x + b."""
        return self.weight @ x + self.bias


class DensePlaces(NamedTuple):
    """Where points are, and how surely."""

    points: Float[AnyArray, "n 2"]
    """Pixels of the crop."""
    whitening: Float[AnyArray, "n 2 2"]
    """Takes an error in pixels to one of unit variance: upper triangular, its square the inverse of the covariance."""


class DenseNetwork(Encoder):
    """The encoder, one convolution that leaves few channels, a hidden layer and the numbers of every point."""

    squeeze: Conv
    hidden: Linear
    head: Linear
    deviation_factor: Float[Array, "n"] | None = None
    """By which the claimed deviations are multiplied: measured on renders that training has not seen."""

    def __call__(self, picture: Float[AnyArray, "3 256 256"]) -> DensePlaces:
        """Points and their whitening, of RGB in 0..1."""
        x = jax.nn.relu(self.squeeze(self.features(picture)[-1]))
        x = jnp.moveaxis(x, -1, 0).reshape(-1)
        return dense_places(self.head(jax.nn.relu(self.hidden(x))), self.deviation_factor)


def dense_places(numbers: Float[AnyArray, "n5"], deviation_factor: Float[AnyArray, "n"] | None = None) -> DensePlaces:
    """What the last layer's numbers mean."""
    library = library_of(numbers)
    numbers = numbers.reshape(-1, NUMBERS)
    points = (numbers[:, :2] + 0.5) * SIDE - 0.5
    diagonal = 1.0 / library.clip(library.exp(-numbers[:, 2:4]), LEAST_DEVIATION_PX, MOST_DEVIATION_PX)
    upper = library.stack([diagonal[:, 0], numbers[:, 4]], axis=-1)
    lower = library.stack([0.0 * diagonal[:, 1], diagonal[:, 1]], axis=-1)
    whitening = library.stack([upper, lower], axis=1)
    if deviation_factor is not None:
        whitening = whitening / deviation_factor[:, None, None]
    return DensePlaces(points, whitening)


def empty_dense_network(
    widths: tuple[int, int, int, int], blocks: int, squeezed: int, hidden: int, points: int, calibrated: bool = False
) -> DenseNetwork:
    """The network with zero weights."""
    return DenseNetwork(
        **encoder_convolutions(widths, blocks),
        squeeze=empty_conv(widths[-1], squeezed, 1),
        hidden=_empty_linear(squeezed * (SIDE // 32) ** 2, hidden),
        head=_empty_linear(hidden, NUMBERS * points),
        deviation_factor=jnp.ones(points, jnp.float32) if calibrated else None,
    )


def read_dense_network(path: str | Path) -> DenseNetwork:
    """The network of a safetensors file.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    weights = read_weights(path)
    if weights.architecture != NAME:
        raise ModelError(
            f"{weights.origin} should hold the weights of {NAME}, but its metadata names "
            f"{shortened(weights.architecture)}"
        )
    widths, blocks = network_size(weights)
    squeezed, hidden, numbers = (_length(weights, name) for name in ("squeeze.bias", "hidden.bias", "head.bias"))
    calibrated = "deviation_factor" in weights.arrays
    return fill(lambda: empty_dense_network(widths, blocks, squeezed, hidden, numbers // NUMBERS, calibrated), weights)


def _length(weights: Weights, name: str) -> int:
    array = weights.arrays.get(name)
    return 1 if array is None or array.ndim != 1 else len(array)


def _empty_linear(inputs: int, outputs: int) -> Linear:
    return Linear(jnp.zeros((outputs, inputs), jnp.float32), jnp.zeros(outputs, jnp.float32))
