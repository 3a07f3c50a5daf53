"""Places in a small picture by regression, each with its own uncertainty: what the dense and the eye network share.

The encoder, a convolution that leaves few channels, a hidden layer, and five numbers a point: its place, and the
Cholesky factor of the inverse of its covariance.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, library_of
from workbench.errors import ModelError
from workbench.networks.encoder import Encoder, encoder_convolutions, network_size
from workbench.networks.layers import Conv, empty_conv
from workbench.networks.weights import Weights
from workbench.reading import shortened

NUMBERS = 5
"""Of a point: x, y, and the three of its precision's Cholesky factor."""
LEAST_DEVIATION_PX, MOST_DEVIATION_PX = 0.15, 60.0
"""Between these lie the deviations that a network may claim."""
SMALLEST = 32
"""The encoder's last level has one cell for so many pixels."""


class Linear(eqx.Module):
    """A fully connected layer: `torch.nn.Linear`."""

    weight: Float[Array, "out in"]
    bias: Float[Array, "out"]

    def __call__(self, x: Float[Array, "in"]) -> Float[Array, "out"]:
        """W·x + b."""
        return self.weight @ x + self.bias


class Regression(Encoder):
    """The layers; subclasses say what the last numbers mean."""

    squeeze: Conv
    hidden: Linear
    head: Linear
    deviation_factor: Float[Array, "n"] | None = None
    """By which the claimed deviations are multiplied: measured on renders that training has not seen."""
    largest: Float[Array, "layers"] | None = None
    """As `LandmarkNetwork.largest`."""

    def numbers(self, picture: Float[AnyArray, "3 s s"]) -> Float[Array, "out"]:
        """The last layer's answer to RGB in 0..1."""
        x = jax.nn.relu(self.squeeze(self.features(picture)[-1]))
        x = jnp.moveaxis(x, -1, 0).reshape(-1)
        return self.head(jax.nn.relu(self.hidden(x)))


class Places(NamedTuple):
    """Where points are, and how surely."""

    points: Float[AnyArray, "n 2"]
    """Pixels of the crop."""
    whitening: Float[AnyArray, "n 2 2"]
    """Takes an error in pixels to one of unit variance: upper triangular, its square the inverse of the covariance."""


def places_of(
    numbers: Float[AnyArray, "n5"], side: int, deviation_factor: Float[AnyArray, "n"] | None = None
) -> Places:
    """What five numbers a point mean in a crop of `side` pixels."""
    library = library_of(numbers)
    numbers = numbers.reshape(-1, NUMBERS)
    points = (numbers[:, :2] + 0.5) * side - 0.5
    diagonal = 1.0 / library.clip(library.exp(-numbers[:, 2:4]), LEAST_DEVIATION_PX, MOST_DEVIATION_PX)
    upper = library.stack([diagonal[:, 0], numbers[:, 4]], axis=-1)
    lower = library.stack([0.0 * diagonal[:, 1], diagonal[:, 1]], axis=-1)
    whitening = library.stack([upper, lower], axis=1)
    if deviation_factor is not None:
        whitening = whitening / deviation_factor[:, None, None]
    return Places(points, whitening)


def covariance_of(whitening: Float[AnyArray, "n 2 2"]) -> Float[AnyArray, "n 2 2"]:
    """(WᵀW)⁻¹: what errors are distributed by that W takes to unit variance."""
    library = library_of(whitening)
    return library.linalg.inv(library.swapaxes(whitening, 1, 2) @ whitening)


def empty_layers(
    widths: tuple[int, int, int, int], blocks: int, squeezed: int, hidden: int, outputs: int, side: int
) -> dict:
    """The parts of a `Regression` with zero weights, for crops of `side` pixels."""
    return {
        **encoder_convolutions(widths, blocks),
        "squeeze": empty_conv(widths[-1], squeezed, 1),
        "hidden": _empty_linear(squeezed * (side // SMALLEST) ** 2, hidden),
        "head": _empty_linear(hidden, outputs),
    }


class LayerSizes(NamedTuple):
    """What a weights file says of a regression's size, in the order of `empty_layers`."""

    widths: tuple[int, int, int, int]
    blocks: int
    squeezed: int
    hidden: int
    outputs: int


def regression_sizes(weights: Weights, name: str) -> LayerSizes:
    """How large a network its weights make. Raises `ModelError` for weights of another than `name`."""
    if weights.architecture != name:
        raise ModelError(
            f"{weights.origin} should hold the weights of {name}, but its metadata names "
            f"{shortened(weights.architecture)}"
        )
    lengths = (_length(weights, part) for part in ("squeeze.bias", "hidden.bias", "head.bias"))
    return LayerSizes(*network_size(weights), *lengths)


def _length(weights: Weights, name: str) -> int:
    array = weights.arrays.get(name)
    return 1 if array is None or array.ndim != 1 else len(array)


def _empty_linear(inputs: int, outputs: int) -> Linear:
    return Linear(jnp.zeros((outputs, inputs), jnp.float32), jnp.zeros(outputs, jnp.float32))
