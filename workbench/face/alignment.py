"""Rigid alignment of blendshape targets to the neutral (FACE IT! Eq. 4, constrained orthogonal Procrustes)."""

import numpy as np
from jaxtyping import Float, Int

from workbench.errors import ModelError


def rigid_alignment(
    source: Float[np.ndarray, "p 3"], target: Float[np.ndarray, "p 3"]
) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Rotation and translation that minimise ‖R·source + t − target‖²; det R = +1 even if a reflection fits better.

    Raises `ModelError` for fewer than three points or points on one line, which do not determine the rotation.
    """
    if source.shape != target.shape or len(source) < 3:
        raise ModelError(
            f"A rigid alignment needs three or more points in correspondence, got {source.shape} and {target.shape}."
        )
    source_centre, target_centre = source.mean(0), target.mean(0)
    left, singular, right = np.linalg.svd((source - source_centre).T @ (target - target_centre))
    if singular[1] <= 1e-12 * max(singular[0], 1e-300):
        raise ModelError("The points of a rigid alignment lie on one line; choose a subset that spans the head.")
    # The last singular direction is turned round where the best orthogonal matrix would be a reflection.
    keep_handedness = np.array([1.0, 1.0, np.sign(np.linalg.det(right.T @ left.T))])
    rotation = (right.T * keep_handedness) @ left.T
    return rotation, target_centre - rotation @ source_centre


def align_targets(
    neutral: Float[np.ndarray, "p 3"],
    targets: Float[np.ndarray, "n p 3"],
    vertex_subset: Int[np.ndarray, "m"],
) -> Float[np.ndarray, "n p 3"]:
    """Targets moved rigidly so that a subset of their vertices meets the neutral's (FACE IT! Eq. 4).

    The paper takes points on the back of the head: they do not move with expressions, so what is left after the
    alignment is expression alone. Raises `ModelError` as `rigid_alignment`.
    """
    aligned = np.empty_like(targets)
    for k, target in enumerate(targets):
        rotation, translation = rigid_alignment(target[vertex_subset], neutral[vertex_subset])
        aligned[k] = target @ rotation.T + translation
    return aligned
