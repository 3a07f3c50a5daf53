"""Squared norms that hold parameters near zero: λ‖w‖² (Deep Energies Sec. 8.2) and the identity's prior."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.context import TermContext
from workbench.face.jaw import in_blendshapes
from workbench.face.parameters import FaceParameters


def magnitude_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "n"]:
    """Blendshape weights, and the jaw counted in blendshapes."""
    jaw = [in_blendshapes(parameters.jaw, context.jaw_unit)] if len(parameters.jaw) else []
    return jnp.concatenate([parameters.expression, *jaw])


def identity_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "i"]:
    """Identity coefficients in standard deviations: their squares are the L2 prior of the identity basis."""
    return parameters.identity
