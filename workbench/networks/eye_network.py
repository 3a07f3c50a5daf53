"""One eye: its pupil and the border of its iris, each with its own uncertainty, and whether it is open.

A crop of the whole face has a dozen pixels for an eye; this network sees the eye alone. It knows right eyes: left ones
are mirrored before and after (`landmarks.eyes`).
"""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray, library_of
from workbench.networks.regression import NUMBERS, Regression, empty_layers, places_of, regression_sizes
from workbench.networks.weights import fill, read_weights

NAME = "face-energy-eye-1"
"""Value of the metadata key `architecture`."""
SIDE = 64
"""Pixels of the input, which the fully connected layers are made for."""
POINTS = 9
"""The pupil's middle, then the eight of the iris's border from the outer corner's side upwards."""


class EyePlaces(NamedTuple):
    """Where pupil and iris are, how surely, and whether a pupil can be seen."""

    points: Float[AnyArray, "9 2"]
    """Pixels of the crop; behind a shut lid, where they would be."""
    whitening: Float[AnyArray, "9 2 2"]
    """Takes an error in pixels to one of unit variance: upper triangular."""
    is_open: Float[AnyArray, ""]
    """How likely no lid hides the pupil, 0 to 1."""


class EyeNetwork(Regression):
    """Pupil and iris of a right eye."""

    def __call__(self, picture: Float[AnyArray, "3 64 64"]) -> EyePlaces:
        """Points, their whitening and whether the eye is open, of RGB in 0..1."""
        return eye_places(self.numbers(picture), self.deviation_factor)


def eye_places(numbers: Float[AnyArray, "n"], deviation_factor: Float[AnyArray, "9"] | None = None) -> EyePlaces:
    """What the last layer's numbers mean: five a point, and the log odds of an open eye."""
    places = places_of(numbers[:-1], SIDE, deviation_factor)
    return EyePlaces(*places, 1.0 / (1.0 + library_of(numbers).exp(-numbers[-1])))


def empty_eye_network(
    widths: tuple[int, int, int, int], blocks: int, squeezed: int, hidden: int, calibrated: bool = False
) -> EyeNetwork:
    """The network with zero weights."""
    layers = empty_layers(widths, blocks, squeezed, hidden, NUMBERS * POINTS + 1, SIDE)
    return EyeNetwork(**layers, deviation_factor=jnp.ones(POINTS, jnp.float32) if calibrated else None)


def read_eye_network(path: str | Path) -> EyeNetwork:
    """The network of a safetensors file.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    weights = read_weights(path)
    *sizes, _ = regression_sizes(weights, NAME)
    return fill(lambda: empty_eye_network(*sizes, "deviation_factor" in weights.arrays), weights)
