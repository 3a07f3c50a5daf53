"""Squared norms that hold parameters near zero: λ‖w‖² (Deep Energies Sec. 8.2) and the identity's prior."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from workbench.energies.term import Term, TermContext
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


REGULARISATION = Term(
    name="regularisation",
    symbol="λ‖w‖²",
    source="Deep Energies Sec. 8.2",
    says="holds blendshapes and jaw near 0; in other units than the paper's 100",
    formula="‖w‖²",
    residual=magnitude_residual,
    unknowns=("expression", "jaw"),
    listed=("deep-energies",),
    key="deep.regularisation",
    weight="λ",
    branch="",
    default=30.0,
    slider=(1e-2, 1e4),
)
IDENTITY = Term(
    name="identity",
    symbol="E_identity",
    source="",
    says="keeps to the mean face",
    formula="‖identity‖²",
    residual=identity_residual,
    unknowns=("identity",),
    structure="diagonal",
    systems=("face-it", "deep-energies"),
    key="identity.weight",
    deep_key="deep.identity",
    default=5.0,
    slider=(1e-2, 1e4),
)
