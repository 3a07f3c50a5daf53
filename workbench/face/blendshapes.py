"""Blendshapes in absolute and in delta form (FACE IT! Eqs. 1–3)."""

import numpy as np
from jaxtyping import Float

from workbench.errors import ModelError


def absolute_form(targets: Float[np.ndarray, "n p 3"], weights: Float[np.ndarray, "n"]) -> Float[np.ndarray, "p 3"]:
    """f = Σ_k w_k b_k, with the neutral among the targets (FACE IT! Eqs. 1, 2); millimetres in, millimetres out."""
    return np.tensordot(weights, targets, axes=1)


def delta_form(
    neutral: Float[np.ndarray, "p 3"], deltas: Float[np.ndarray, "n p 3"], weights: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "p 3"]:
    """f = b_0 + Σ_k w_k (b_k − b_0) (FACE IT! Eq. 3); millimetres in, millimetres out."""
    return neutral + np.tensordot(weights, deltas, axes=1)


def targets_to_deltas(
    neutral: Float[np.ndarray, "p 3"], targets: Float[np.ndarray, "n q 3"]
) -> Float[np.ndarray, "n p 3"]:
    """Offsets b_k − b_0 of targets in vertex correspondence with the neutral.

    Raises `ModelError` if the vertex counts differ.
    """
    if targets.shape[1:] != neutral.shape:
        raise ModelError(
            f"Targets need the neutral's {len(neutral)} vertices, got {targets.shape[1]}; "
            "export all of them from one mesh without reordering."
        )
    return targets - neutral
