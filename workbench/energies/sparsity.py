"""E_σ (FACE IT! Eq. 11): few weights at work, as the paper's single residual and as a smoothed separable norm."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, Scalar
from workbench.energies.term import Term, TermContext
from workbench.face.parameters import FaceParameters

Weights = Float[AnyArray, "k"]


def sigma_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "1"]:
    """E_σ as a single residual Σ|w|: Eq. 11 without the factor n that its sum over ‖w‖ brings; ω_σ takes that up.

    A least-squares solver squares it: what is minimised is (Σ|w|)².
    """
    return jnp.sum(jnp.abs(parameters.expression), keepdims=True)


def smoothed_l1(weights: Weights, delta: Scalar) -> Weights:
    """One residual a weight whose squares sum to the smoothed L1 norm Σ (√(w² + δ²) − δ)."""
    return weights / jnp.sqrt(jnp.sqrt(weights * weights + delta * delta) + delta)


def sigma_smooth_residual(parameters: FaceParameters, context: TermContext) -> Weights:
    """The smoothed L1 norm of the weights."""
    return smoothed_l1(parameters.expression, context.constants.delta)


SIGMA = Term(
    name="sigma",
    symbol="E_σ",
    source="FACE IT! Eq. 11",
    says="the paper's single-residual L1 norm",
    formula="(Σ|w|)²",
    residual=sigma_residual,
    unknowns=("expression",),
    structure="single",
    systems=("face-it",),
    presets={"face-it": 0.01},
)
SIGMA_SMOOTH = Term(
    name="sigma_smooth",
    symbol="E_σ L1",
    source="after FACE IT! Eq. 11",
    says="smoothed separable L1 norm, one residual a weight",
    formula="Σ √(w² + δ²) − δ",
    residual=sigma_smooth_residual,
    unknowns=("expression",),
    structure="diagonal",
    systems=("face-it",),
    presets={"calibrated": 20.0, "joint": 20.0},
    slider=(1e-3, 1e3),
    constants=("delta",),
)
