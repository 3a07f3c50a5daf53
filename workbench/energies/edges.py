"""E_2 (Deep Energies Sec. 8.1): the edges between consecutive landmarks."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.context import LandmarkErrors
from workbench.landmarks.scheme import POINT_COUNT


def edge_residual(errors: LandmarkErrors) -> Float[Array, "n"]:
    """Differences of consecutive landmarks' errors, of the 68: the numbers of others follow no line.

    The paper counts all alike; a choice of ours is that each counts as its less certain end. Either way an edge with an
    end that takes no part counts nothing.
    """
    error, root = errors.error if errors.unwhitened is None else errors.unwhitened, errors.root[..., :POINT_COUNT]
    error = error[..., :POINT_COUNT, :]
    lesser = jnp.minimum(root[..., 1:], root[..., :-1])
    taking_part = (lesser > 0.0).astype(lesser.dtype)
    ends = jnp.where(jnp.asarray(errors.weighted_edges) > 0.5, lesser, taking_part)
    return (ends[..., None] * (error[..., 1:, :] - error[..., :-1, :]) / errors.unit).ravel()
