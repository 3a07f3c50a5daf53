"""Where the eyes look: both the same way, and where they looked before unless their points say otherwise.

Directions are linear in the eyes' units, each counted by the angle that it turns an eye at weight 1. Residuals are in
degrees.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.context import TermContext
from workbench.face.parameters import FaceParameters


def vergence_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "2"]:
    """What the left eye is turned more than the right one, across and upwards; 0 of a model whose eyes do not turn."""
    right, left = _turned(parameters, context)
    return left - right


def gaze_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "4"]:
    """What both eyes have turned since the frame before, times the root of how far both are hidden."""
    if context.gaze is None:
        return jnp.zeros(4)
    since = _turned(parameters, context) - _turned(context.start, context)
    return jnp.sqrt(jnp.asarray(context.gaze.hidden)) * since.ravel()


def _turned(parameters: FaceParameters, context: TermContext) -> Float[Array, "2 2"]:
    """Degrees that the right and the left eye are turned, to the subject's left and upwards."""
    if context.gaze is None:
        return jnp.zeros((2, 2))
    return (jnp.asarray(context.gaze.turns) @ parameters.expression).reshape(2, 2)
