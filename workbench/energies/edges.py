"""E_2 (Deep Energies Sec. 8.1): the edges between consecutive landmarks."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.term import LandmarkErrors, Term


def edge_residual(errors: LandmarkErrors) -> Float[Array, "n"]:
    """Differences of consecutive landmarks' errors. Ours is that each counts as its less certain end."""
    ends = jnp.minimum(errors.root[..., 1:], errors.root[..., :-1])
    return (ends[..., None] * (errors.error[..., 1:, :] - errors.error[..., :-1, :]) / errors.unit).ravel()


EDGES = Term(
    name="edges",
    symbol="E_2",
    source="Deep Energies Sec. 8.1",
    says="differences of consecutive landmarks, which preserve edges",
    formula="Σ‖(p_i+1 − p_i) − (p*_i+1 − p*_i)‖²",
    residual=edge_residual,
    of="landmarks",
    listed=("deep-energies",),
    key="deep.edges",
    weight="ω_edges",
    branch="",
    default=0.5,
    slider=(1e-3, 1e2),
)
