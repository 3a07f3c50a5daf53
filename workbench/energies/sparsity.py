"""E_σ (FACE IT! Eq. 11): few weights at work, as the paper's single residual and as a smoothed separable norm."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, Scalar
from workbench.energies.context import TermContext
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
    """The smoothed L1 norm of the weights, without the eyes' units: to look straight ahead is no rest for them."""
    values = smoothed_l1(parameters.expression, context.constants.delta)
    return values if context.gaze is None else jnp.where(jnp.any(context.gaze.turns != 0.0, axis=0), 0.0, values)
