"""Terms on the weights alone: sparsity E_σ, range E_β (FACE IT! Eqs. 11, 12), and the alternatives that we add."""

import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray, Scalar
from workbench.energies.weights import EnergyConstants

Weights = Float[AnyArray, "k"]


def sigma_residual(weights: Weights) -> Float[AnyArray, "1"]:
    """E_σ as a single residual Σ|w|: Eq. 11 without the factor n that its sum over ‖w‖ brings; ω_σ takes that up.

    A least-squares solver squares it: what is minimised is (Σ|w|)².
    """
    return jnp.sum(jnp.abs(weights), keepdims=True)


def sigma_smooth_residual(weights: Weights, delta: Scalar) -> Weights:
    """One residual a weight whose squares sum to the smoothed L1 norm Σ (√(w² + δ²) − δ)."""
    return weights / jnp.sqrt(jnp.sqrt(weights * weights + delta * delta) + delta)


def sigma_smooth_slope(weights: Weights, delta: Scalar) -> Weights:
    """Derivative of each entry of `sigma_smooth_residual` by its weight."""
    norm = jnp.sqrt(weights * weights + delta * delta)
    return (1.0 - 0.5 * weights * weights / (norm * (norm + delta))) / jnp.sqrt(norm + delta)


def beta_curve(weights: Weights, constants: EnergyConstants) -> Weights:
    """E_β of each weight (Eq. 12): about 0.03 inside [0, 1] and c = 2.5 outside, almost a step."""
    upper = jnp.arctan((weights - constants.a) / constants.b)
    lower = jnp.arctan((weights + constants.a - 1.0) / constants.b)
    return 0.25 * jnp.pi * (upper - lower) + constants.c


def beta_slope(weights: Weights, constants: EnergyConstants) -> Weights:
    """Derivative of `beta_curve`: 39,000 where it rises (1 − a and a), 4 at 0 and 1, 0.0016 a tenth outside.

    A Gauss–Newton step hardly feels it.
    """
    upper = (weights - constants.a) / constants.b
    lower = (weights + constants.a - 1.0) / constants.b
    return 0.25 * jnp.pi / constants.b * (1.0 / (1.0 + upper * upper) - 1.0 / (1.0 + lower * lower))


def beta_residual(weights: Weights, constants: EnergyConstants) -> Float[AnyArray, "1"]:
    """E_β as the paper's single residual, summed over the weights; the solver minimises its square."""
    return jnp.sum(beta_curve(weights, constants), keepdims=True)


def range_residual(weights: Weights) -> Weights:
    """Distance of each weight from [0, 1]: its square pulls a weight back from any distance, unlike E_β."""
    return jnp.minimum(weights, 0.0) + jnp.maximum(weights - 1.0, 0.0)


def range_slope(weights: Weights) -> Weights:
    """Derivative of `range_residual`: 1 outside [0, 1], 0 inside."""
    return ((weights < 0.0) | (weights > 1.0)).astype(weights.dtype)


def identity_residual(identity: Float[AnyArray, "i"]) -> Float[AnyArray, "i"]:
    """Identity coefficients in standard deviations: their squares are the L2 prior of the identity basis."""
    return identity
