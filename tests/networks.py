"""Networks with random weights, for the tests."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from workbench.networks.landmark_network import LandmarkNetwork, empty_landmark_network

Module = TypeVar("Module", bound=eqx.Module)


def randomised(module: Module, seed: int = 0, dtype: type = np.float32) -> Module:
    """The module with random weights that keep the signal's size from layer to layer."""
    rng = np.random.default_rng(seed)

    def weights(array: jax.Array) -> jax.Array:
        inputs = int(np.prod(array.shape[1:])) if array.ndim > 1 else 10
        return jnp.asarray(rng.normal(size=array.shape) / np.sqrt(inputs), dtype)

    return jax.tree.map(weights, module)


def random_landmark_network(
    widths: tuple[int, int, int, int] = (4, 6, 8, 10), blocks: int = 2, seed: int = 0, dtype: type = np.float32
) -> LandmarkNetwork:
    """Our network with random weights."""
    return randomised(empty_landmark_network(widths, blocks), seed, dtype)
