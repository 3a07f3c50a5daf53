"""Squared norms that hold parameters near zero: λ‖w‖² (Deep Energies Sec. 8.2) and the identity's prior."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from workbench.energies.context import TermContext
from workbench.face.jaw import OPEN_DEG, TRAVEL_MM
from workbench.face.parameters import FaceParameters


def magnitude_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "n"]:
    """Blendshape weights, and the jaw counted in blendshapes."""
    parts = [parameters.expression]
    if len(parameters.jaw):
        parts += [parameters.jaw[:3] / np.radians(OPEN_DEG), parameters.jaw[3:] / TRAVEL_MM]
    return jnp.concatenate(parts)


def identity_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "i"]:
    """Identity coefficients in standard deviations: their squares are the L2 prior of the identity basis."""
    return parameters.identity
