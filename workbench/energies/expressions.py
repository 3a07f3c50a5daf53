"""What expressions usually are: both sides alike, and blendshapes that act together (`face.usual_expressions`)."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.context import TermContext
from workbench.face.parameters import FaceParameters


def symmetry_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "pairs"]:
    """Weight of the left side minus that of the right one, of each pair; nothing where no pairs are known."""
    if context.usual is None:
        return jnp.zeros(0)
    return jnp.asarray(context.usual.sides) @ parameters.expression


def usual_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "known"]:
    """The weights whitened by how they usually act together: one for each blendshape that the moments know."""
    if context.usual is None:
        return jnp.zeros(0)
    return jnp.asarray(context.usual.whitening) @ parameters.expression
