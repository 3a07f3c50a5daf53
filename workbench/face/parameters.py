"""The unknowns of a fit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float


class FaceParameters(NamedTuple):
    """Pose, expression and identity of one frame."""

    rotation: Float[Array | np.ndarray, "3"]
    """Axis-angle, head frame to camera frame, radians."""
    translation: Float[Array | np.ndarray, "3"]
    """Head origin in the camera frame, millimetres."""
    expression: Float[Array | np.ndarray, "n_expressions"]
    """Blendshape weights w, nominally 0 to 1."""
    identity: Float[Array | np.ndarray, "n_identities"]
    """Identity coefficients, unit variance."""
