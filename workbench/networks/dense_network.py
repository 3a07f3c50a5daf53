"""Points of the whole face by regression, each with its own uncertainty.

After Wood et al., "3D Face Reconstruction with Dense Landmarks" (ECCV 2022): 256×256 colours to the places of the 68
landmarks, two pupils and the dense points, and to the covariance of each place.
"""

from pathlib import Path

import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.networks.encoder import check_largest
from workbench.networks.regression import NUMBERS, Places, Regression, empty_layers, places_of, regression_sizes
from workbench.networks.weights import Weights, fill, read_weights

NAME = "face-energy-dense-1"
"""Value of the metadata key `architecture`."""
SIDE = 256
"""Pixels of the input, which the fully connected layers are made for."""


class DenseNetwork(Regression):
    """The points of a face."""

    def __call__(self, picture: Float[AnyArray, "3 256 256"]) -> Places:
        """Points and their whitening, of RGB in 0..1."""
        return places_of(self.numbers(picture), SIDE, self.deviation_factor)


def empty_dense_network(
    widths: tuple[int, int, int, int],
    blocks: int,
    squeezed: int,
    hidden: int,
    points: int,
    calibrated: bool = False,
    layers: int = 0,
) -> DenseNetwork:
    """The network with zero weights; `layers`: those whose largest numbers are known."""
    return DenseNetwork(
        **empty_layers(widths, blocks, squeezed, hidden, NUMBERS * points, SIDE),
        deviation_factor=jnp.ones(points, jnp.float32) if calibrated else None,
        largest=jnp.zeros(layers, jnp.float32) if layers else None,
    )


def read_dense_network(path: str | Path) -> DenseNetwork:
    """The network of a safetensors file.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    return dense_network_from(read_weights(path))


def dense_network_from(weights: Weights) -> DenseNetwork:
    """As `read_dense_network`, of weights in memory."""
    *sizes, outputs = regression_sizes(weights, NAME)
    calibrated, layers = "deviation_factor" in weights.arrays, weights.size_of("largest")
    network = fill(lambda: empty_dense_network(*sizes, outputs // NUMBERS, calibrated, layers), weights)
    check_largest(network, network.largest, weights.origin)
    return network
