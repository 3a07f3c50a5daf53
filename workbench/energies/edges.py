"""E_2 (Deep Energies Sec. 8.1): the edges between consecutive landmarks."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.context import LandmarkErrors


def edge_residual(errors: LandmarkErrors) -> Float[Array, "n"]:
    """Differences of consecutive landmarks' errors.

    The paper counts all alike; a choice of ours is that each counts as its less certain end. Either way a view without
    a face counts nothing.
    """
    lesser = jnp.minimum(errors.root[..., 1:], errors.root[..., :-1])
    seen = (errors.root.max(axis=-1, keepdims=True) > 0.0).astype(lesser.dtype)
    ends = jnp.where(jnp.asarray(errors.weighted_edges) > 0.5, lesser, seen)
    return (ends[..., None] * (errors.error[..., 1:, :] - errors.error[..., :-1, :]) / errors.unit).ravel()
