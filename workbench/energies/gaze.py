"""Where the eyes look: both the same way, none two ways at once, and shut ones where they looked before.

Directions are linear in the eyes' units, each counted by the angle that it turns an eye at weight 1, in degrees.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.context import TermContext
from workbench.energies.sparsity import smoothed_l1
from workbench.face.parameters import FaceParameters

LEAST_OPPOSED = 1.0
"""Square degrees: products of opposite turns below it count quadratically, larger ones by their size."""


def vergence_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "2"]:
    """What the left eye is turned more than the right one, across and upwards; 0 of a model whose eyes do not turn."""
    if context.gaze is None:
        return jnp.zeros(2)
    right, left = (jnp.asarray(context.gaze.turns) @ parameters.expression).reshape(2, 2)
    return left - right


def opposites_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "4"]:
    """How far an eye is turned one way by some units and back by others; squares sum to the products of both turns.

    Units that turn an eye up and down move its lids as well: both at once shut it without turning it.
    """
    if context.gaze is None:
        return jnp.zeros(4)
    turns = jnp.asarray(context.gaze.turns)
    one_way, back = (jnp.maximum(part, 0.0) @ parameters.expression for part in (turns, -turns))
    return smoothed_l1(one_way * back, LEAST_OPPOSED)


def gaze_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "k"]:
    """What each unit has turned its eye since the frame before, times the root of how far both eyes are hidden.

    By unit, not by direction: the lids that units move along are held with the eye, so that they tell of blinks alone.
    """
    if context.gaze is None:
        return jnp.zeros(len(parameters.expression))
    degrees = jnp.linalg.norm(jnp.asarray(context.gaze.turns), axis=0)
    since = parameters.expression - jnp.asarray(context.gaze.before)
    return jnp.sqrt(jnp.asarray(context.gaze.hidden)) * degrees * since
