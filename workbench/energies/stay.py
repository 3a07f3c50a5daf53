"""Terms that hold parameters where they are expected: the pose's prior (Deep Energies Sec. 5), and that of the flow
(Sec. 7)."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.term import Term, TermContext
from workbench.face.parameters import FaceParameters

JAW_RADIAN, JAW_MM = 0.46, 20.0
"""Jaw motions that count as a blendshape's whole travel."""


def pose_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "6"]:
    """Distance of the pose from the expected one, a radian counted as `rotation_mm` millimetres."""
    turned = jnp.asarray(parameters.rotation) - context.start.rotation
    moved = jnp.asarray(parameters.translation) - context.start.translation
    return jnp.concatenate([context.constants.rotation_mm * turned, moved])


def expression_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "n"]:
    """Distance of blendshapes and jaw from the expected ones, the jaw counted in blendshapes."""
    parts = [jnp.asarray(parameters.expression) - context.start.expression]
    if len(parameters.jaw):
        sizes = jnp.asarray([JAW_RADIAN] * 3 + [JAW_MM] * 3)
        parts.append((jnp.asarray(parameters.jaw) - context.start.jaw) / sizes)
    return jnp.concatenate(parts)


PRIOR = Term(
    name="prior",
    symbol="E_prior",
    source="Deep Energies Sec. 5",
    says="staying near the pose that the stage starts from",
    formula="‖[r|t] − [r|t]_start‖²",
    residual=pose_residual,
    unknowns=("rotation", "translation"),
    structure="diagonal",
    listed=("deep-energies",),
    key="deep.prior",
    branch="",
    default=1.0,
    slider=(1e-3, 1e3),
    constants=("rotation_mm",),
)
STAY = Term(
    name="stay",
    symbol="E_stay",
    source="Deep Energies Sec. 7",
    says="blendshapes and jaw staying where they are expected",
    formula="‖w − w_start‖²",
    residual=expression_residual,
    unknowns=("expression", "jaw"),
    key="flow.stay",
    branch="",
    default=20.0,
    slider=(1e-1, 1e4),
)
