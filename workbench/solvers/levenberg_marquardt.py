"""Levenberg–Marquardt with bounds, on normal equations.

The trust region follows Ceres: damping λ·diag(JᵀJ) with λ = 1/radius, radius widened by the gain ratio. Bounds are kept
by an active set inside each step: unknowns that would leave are put on their bound and the others solved again.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray, Scalar
from workbench.solvers.loop import Judgement
from workbench.solvers.normal_equations import System

INITIAL_DAMPING = 1e-4
SMALLEST_DAMPING = 1e-16
LARGEST_DAMPING = 1e16
HELD = 1e12
"""Stiffness, relative to the largest diagonal entry, that holds an unknown on its bound."""
ACTIVE_SET_PASSES = 8


class Damping(NamedTuple):
    """What Levenberg–Marquardt hands from step to step."""

    value: Float[AnyArray, ""]
    """λ."""
    growth: Float[AnyArray, ""]
    """Factor by which the next rejected step raises it."""


class LevenbergMarquardt(NamedTuple):
    """The method of `loop.step` that the workbench uses by default; it has no settings."""

    def start(self) -> Damping:
        """Damping of the first step."""
        return Damping(jnp.asarray(INITIAL_DAMPING), jnp.asarray(2.0))

    def propose(
        self,
        system: System,
        trust: Damping,
        x: Float[AnyArray, "n"],
        lower: Float[AnyArray, "n"],
        upper: Float[AnyArray, "n"],
    ) -> tuple[Float[AnyArray, "n"], Float[AnyArray, "n"]]:
        """The next place to try, inside the bounds, and the move that leads there."""
        extra = trust.value * jnp.clip(system.diagonal(), 1e-6, 1e32)
        lowest, highest = lower - x, upper - x
        move = _bounded_move(system, extra, lowest, highest)
        # Exactly on the bounds: what lies a rounding off would be free in the next step, and mislead the others.
        return jnp.where(move <= lowest, lower, jnp.where(move >= highest, upper, x + move)), move

    def judge(self, system: System, trust: Damping, move: Float[AnyArray, "n"], value: Scalar) -> Judgement:
        """Whatever lowers the cost is accepted; the gain ratio says how far to trust the next step."""
        decrease = system.cost - value
        predicted = -(2.0 * system.gradient @ move + move @ system.product(move))
        accepted = decrease > 0.0
        gain = decrease / jnp.where(predicted > 0.0, predicted, 1.0)
        shrink = jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
        damping = jnp.where(accepted, trust.value * shrink, trust.value * trust.growth)
        damping = jnp.clip(damping, SMALLEST_DAMPING, LARGEST_DAMPING)
        growth = jnp.where(accepted, 2.0, trust.growth * 2.0)
        return Judgement(accepted, Damping(damping, growth), ~accepted & (damping >= LARGEST_DAMPING))


def _bounded_move(system: System, extra, lowest_move, highest_move):
    """Damped Gauss–Newton step inside a box: unknowns that would leave it go to its face, the others adapt."""
    gradient = system.gradient
    stiffness = HELD * jnp.max(system.diagonal()) + 1.0
    pushed = ((lowest_move >= 0) & (gradient > 0)) | ((highest_move <= 0) & (gradient < 0))

    def solve(held, move):
        pinned = jnp.where(held, jnp.clip(move, lowest_move, highest_move), 0.0)
        move = system.solve(extra + jnp.where(held, stiffness, 0.0), jnp.where(held, stiffness * pinned, -gradient))
        return jnp.where(held, pinned, move)

    def leaves(carry):
        count, held, move = carry
        return (count < ACTIVE_SET_PASSES) & jnp.any(~held & ((move < lowest_move) | (move > highest_move)))

    def shrink(carry):
        count, held, move = carry
        held = held | (move < lowest_move) | (move > highest_move)
        return count + 1, held, solve(held, move)

    first = solve(pushed, jnp.zeros_like(gradient))
    _, _, move = jax.lax.while_loop(leaves, shrink, (jnp.asarray(0), pushed, first))
    return jnp.clip(move, lowest_move, highest_move)
