"""The unknowns of a fit."""

from typing import NamedTuple

from jaxtyping import Float

from workbench.arrays import AnyArray


class FaceParameters(NamedTuple):
    """Pose, expression and identity of one frame."""

    rotation: Float[AnyArray, "3"]
    """Axis-angle, head frame to camera frame, radians."""
    translation: Float[AnyArray, "3"]
    """Head origin in the camera frame, millimetres."""
    expression: Float[AnyArray, "n_expressions"]
    """Blendshape weights w, nominally 0 to 1."""
    identity: Float[AnyArray, "n_identities"]
    """Identity coefficients, unit variance."""
