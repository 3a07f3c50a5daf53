"""The unknowns of a fit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray

UNUSED = np.zeros(0)
"""Stands for parameters that a system does not have."""
UNUSED.setflags(write=False)


class FaceParameters(NamedTuple):
    """Pose, expression and identity of one frame; Deep Energies adds the jaw joint and a scale."""

    rotation: Float[AnyArray, "3"]
    """θ as axis-angle, head frame to camera frame, radians."""
    translation: Float[AnyArray, "3"]
    """t: head origin in the camera frame, millimetres."""
    expression: Float[AnyArray, "n_expressions"]
    """Blendshape weights w, nominally 0 to 1."""
    identity: Float[AnyArray, "n_identities"]
    """Identity coefficients, unit variance; empty: the model's mean face."""
    jaw: Float[AnyArray, "n_jaw"] = UNUSED
    """Motion of the jaw joint in the head frame: axis-angle in radians, then millimetres; empty: the joint rests."""
    scale: Float[AnyArray, "n_scale"] = UNUSED
    """One uniform scale of the head, for views that do not tell its distance; empty: 1."""
