"""What keeps weights in [0, 1]: E_β (FACE IT! Eq. 12), and a quadratic of our own."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.energies.constants import EnergyConstants
from workbench.energies.context import TermContext
from workbench.face.parameters import FaceParameters

Weights = Float[AnyArray, "k"]


def beta_curve(weights: Weights, constants: EnergyConstants) -> Weights:
    """E_β of each weight (Eq. 12): about 0.03 inside [0, 1] and c = 2.5 outside, almost a step."""
    upper = jnp.arctan((weights - constants.a) / constants.b)
    lower = jnp.arctan((weights + constants.a - 1.0) / constants.b)
    return 0.25 * jnp.pi * (upper - lower) + constants.c


def beta_slope(weights: Weights, constants: EnergyConstants) -> Weights:
    """Derivative of `beta_curve`: 39,000 where it rises (1 − a and a), 4 at 0 and 1, 0.0016 a tenth outside.

    A Gauss–Newton step hardly feels it.
    """
    weights = jnp.asarray(weights, float)
    return jax.jvp(lambda at: beta_curve(at, constants), (weights,), (jnp.ones_like(weights),))[1]


def beta_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "1"]:
    """E_β as the paper's single residual, summed over the weights; the solver minimises its square."""
    return jnp.sum(beta_curve(parameters.expression, context.constants), keepdims=True)


def distance_from_range(weights: Weights) -> Weights:
    """Distance of each weight from [0, 1], negative below it."""
    # `where`, not `minimum`: on a bound itself, where bounded weights often lie, the derivative is that of the inside.
    below = jnp.where(weights < 0.0, weights, 0.0)
    return below + jnp.where(weights > 1.0, weights - 1.0, 0.0)


def range_residual(parameters: FaceParameters, context: TermContext) -> Weights:
    """One residual per weight: its square pulls a weight back from any distance, unlike E_β."""
    return distance_from_range(parameters.expression)
