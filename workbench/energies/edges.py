"""E_2 (Deep Energies Sec. 8.1): the edges between consecutive landmarks."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.context import LandmarkErrors


def edge_residual(errors: LandmarkErrors) -> Float[Array, "n"]:
    """Differences of consecutive landmarks' errors. Ours is that each counts as its less certain end."""
    ends = jnp.minimum(errors.root[..., 1:], errors.root[..., :-1])
    return (ends[..., None] * (errors.error[..., 1:, :] - errors.error[..., :-1, :]) / errors.unit).ravel()
