"""Levenberg–Marquardt on normal equations, with bounds, driven one step at a time.

Minimises Σ r(x)² over lower ≤ x ≤ upper. A problem is a function `evaluate(x)` that returns the cost and the normal
equations `JᵀJ` and `Jᵀr` as a *system*: dense, or arrowhead (many local blocks that share a few unknowns). The trust
region follows Ceres: damping λ·diag(JᵀJ) with λ = 1/radius, radius widened by the gain ratio. Bounds are kept by an
active set inside each step: unknowns that would leave are put on their bound and the others solved again.

The iteration limit and the tolerance are traced numbers, so a slider on them compiles nothing.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.scipy.linalg import cho_factor, cho_solve
from jaxtyping import Bool, Float, Int

from workbench.arrays import AnyArray, Count, Scalar

INITIAL_DAMPING = 1e-4
SMALLEST_DAMPING = 1e-16
LARGEST_DAMPING = 1e16
HELD = 1e12
"""Stiffness, relative to the largest diagonal entry, that holds an unknown on its bound."""
ACTIVE_SET_PASSES = 8


class Status(IntEnum):
    """How a solve ended."""

    RUNNING = 0
    CONVERGED = 1
    ITERATION_LIMIT = 2
    STALLED = 3
    NOT_FINITE = 4


class DenseSystem(NamedTuple):
    """Cost and normal equations of a small dense problem."""

    cost: Float[AnyArray, ""]
    gradient: Float[AnyArray, "n"]
    """Jᵀr."""
    matrix: Float[AnyArray, "n n"]
    """JᵀJ."""

    def diagonal(self) -> Float[AnyArray, "n"]:
        """Diagonal of JᵀJ."""
        return jnp.diagonal(self.matrix)

    def solve(self, extra: Float[AnyArray, "n"], right: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """Solution of (JᵀJ + diag(extra)) s = right."""
        return cho_solve(cho_factor(self.matrix + jnp.diag(extra), lower=True), right)

    def product(self, vector: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """JᵀJ · vector."""
        return self.matrix @ vector

    def restricted(self, moving: Bool[AnyArray, "n"]) -> "DenseSystem":
        """The problem in which only some unknowns move: the others neither feel a force nor pass one on."""
        return DenseSystem(self.cost, self.gradient * moving, self.matrix * (moving[:, None] & moving[None, :]))


class ArrowheadSystem(NamedTuple):
    """Normal equations of `f` local blocks of `m` unknowns that share `s` unknowns; x is [locals…, shared]."""

    cost: Float[AnyArray, ""]
    local_gradient: Float[AnyArray, "f m"]
    shared_gradient: Float[AnyArray, "s"]
    local: Float[AnyArray, "f m m"]
    border: Float[AnyArray, "f m s"]
    shared: Float[AnyArray, "s s"]

    @property
    def gradient(self) -> Float[AnyArray, "n"]:
        """Jᵀr."""
        return jnp.concatenate([self.local_gradient.ravel(), self.shared_gradient])

    def diagonal(self) -> Float[AnyArray, "n"]:
        """Diagonal of JᵀJ."""
        local = jnp.diagonal(self.local, axis1=1, axis2=2)
        return jnp.concatenate([local.ravel(), jnp.diagonal(self.shared)])

    def solve(self, extra: Float[AnyArray, "n"], right: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """Solution of (JᵀJ + diag(extra)) s = right by the Schur complement of the local blocks."""
        count, size = self.local_gradient.shape
        extra_local, right_local = extra[: count * size].reshape(count, size), right[: count * size]
        factor = jnp.linalg.cholesky(self.local + jax.vmap(jnp.diag)(extra_local))
        stacked = jnp.concatenate([self.border, right_local.reshape(count, size, 1)], axis=2)
        solved = jax.vmap(lambda lower, columns: cho_solve((lower, True), columns))(factor, stacked)
        reduced = self.shared + jnp.diag(extra[count * size :])
        reduced = reduced - jnp.einsum("fms,fmt->st", self.border, solved[..., :-1])
        reduced_right = right[count * size :] - jnp.einsum("fms,fm->s", self.border, solved[..., -1])
        shared = cho_solve(cho_factor(reduced, lower=True), reduced_right)
        return jnp.concatenate([(solved[..., -1] - solved[..., :-1] @ shared).ravel(), shared])

    def product(self, vector: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """JᵀJ · vector."""
        count, size = self.local_gradient.shape
        local, shared = vector[: count * size].reshape(count, size), vector[count * size :]
        top = jnp.einsum("fmn,fn->fm", self.local, local) + self.border @ shared
        return jnp.concatenate([top.ravel(), jnp.einsum("fms,fm->s", self.border, local) + self.shared @ shared])

    def restricted(self, moving: Bool[AnyArray, "n"]) -> "ArrowheadSystem":
        """The problem in which only some unknowns move; see `DenseSystem.restricted`."""
        count, size = self.local_gradient.shape
        local, shared = moving[: count * size].reshape(count, size), moving[count * size :]
        return ArrowheadSystem(
            self.cost,
            self.local_gradient * local,
            self.shared_gradient * shared,
            self.local * (local[:, :, None] & local[:, None, :]),
            self.border * (local[:, :, None] & shared),
            self.shared * (shared[:, None] & shared),
        )


System = DenseSystem | ArrowheadSystem
Evaluate = Callable[[Float[AnyArray, "n"]], System]
Cost = Callable[[Float[AnyArray, "n"]], Float[AnyArray, ""]]


class SolverState(NamedTuple):
    """Everything that one step hands to the next."""

    x: Float[AnyArray, "n"]
    cost: Float[AnyArray, ""]
    system: System
    """Normal equations at `x`, once `formed`; before that, those of an earlier place."""
    formed: Bool[AnyArray, ""]
    damping: Float[AnyArray, ""]
    growth: Float[AnyArray, ""]
    """Factor by which the next rejected step raises the damping."""
    accepted: Bool[AnyArray, ""]
    status: Int[AnyArray, ""]


class Solution(NamedTuple):
    """Result of `minimise`."""

    x: Float[AnyArray, "n"]
    cost: Float[AnyArray, ""]
    status: Int[AnyArray, ""]
    """A `Status` value."""
    iterations: Int[AnyArray, ""]
    trace: Any
    """What `record` returned at the start and after each step, stacked (rows beyond the last step repeat it)."""


def normal_equations(residual: Float[AnyArray, "m"], jacobian: Float[AnyArray, "m n"]) -> DenseSystem:
    """Cost, Jᵀr and JᵀJ of one residual vector."""
    return DenseSystem(residual @ residual, residual @ jacobian, jacobian.T @ jacobian)


def init(evaluate: Evaluate, start: Float[AnyArray, "n"], cost: Cost | None = None) -> SolverState:
    """State before the first step; `cost` as for `step`."""
    if cost is None:
        system = evaluate(start)
        value, formed = system.cost, True
    else:
        system = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), jax.eval_shape(evaluate, start))
        value, formed = cost(start), False
    return SolverState(
        x=start,
        cost=value,
        system=system,
        formed=jnp.asarray(formed),
        damping=jnp.asarray(INITIAL_DAMPING),
        growth=jnp.asarray(2.0),
        accepted=jnp.asarray(True),
        status=jnp.where(jnp.isfinite(value), Status.RUNNING.value, Status.NOT_FINITE.value),
    )


def step(
    evaluate: Evaluate,
    state: SolverState,
    lower: Float[AnyArray, "n"],
    upper: Float[AnyArray, "n"],
    tolerance: Scalar = 1e-6,
    cost: Cost | None = None,
) -> SolverState:
    """One damped Gauss–Newton step, taken if it lowers the cost; converged when it lowers it by less than `tolerance`
    of itself.

    `cost` gives what `evaluate(x).cost` would: with it normal equations are formed only where a step starts, so that
    neither a rejected place nor the last one pays for them.
    """
    x, damping = state.x, state.damping
    if cost is None:
        system = state.system
    else:
        system = jax.lax.cond(state.formed, lambda: state.system, lambda: evaluate(x))
    gradient, diagonal = system.gradient, system.diagonal()
    extra = damping * jnp.clip(diagonal, 1e-6, 1e32)
    move = _bounded_move(system, extra, lower - x, upper - x)
    candidate = x + move
    proposed = evaluate(candidate) if cost is None else None
    value = proposed.cost if cost is None else cost(candidate)
    decrease = system.cost - value
    predicted = -(2.0 * gradient @ move + move @ system.product(move))
    accepted = decrease > 0.0
    gain = decrease / jnp.where(predicted > 0.0, predicted, 1.0)
    shrink = jnp.maximum(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
    new_damping = jnp.clip(
        jnp.where(accepted, damping * shrink, damping * state.growth), SMALLEST_DAMPING, LARGEST_DAMPING
    )
    # A step that moves nothing means that every unknown rests on a bound or at the minimum.
    still = jnp.max(jnp.abs(move)) <= 1e-15 * (1.0 + jnp.max(jnp.abs(x)))
    converged = (accepted & (decrease <= tolerance * system.cost)) | still
    stalled = ~accepted & (damping >= LARGEST_DAMPING)
    status = jnp.where(converged, Status.CONVERGED.value, jnp.where(stalled, Status.STALLED.value, state.status))
    if cost is None:
        system = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), proposed, system)
    return SolverState(
        x=jnp.where(accepted, candidate, x),
        cost=jnp.where(accepted, value, system.cost),
        system=system,
        formed=~accepted if cost is not None else state.formed,
        damping=new_damping,
        growth=jnp.where(accepted, 2.0, state.growth * 2.0),
        accepted=accepted,
        status=status,
    )


def _bounded_move(system: System, extra, lowest_move, highest_move):
    """Damped Gauss–Newton step inside a box: unknowns that would leave it go to its face, the others adapt."""
    gradient = system.gradient
    stiffness = HELD * jnp.max(system.diagonal()) + 1.0
    pushed = ((lowest_move >= 0) & (gradient > 0)) | ((highest_move <= 0) & (gradient < 0))

    def solve(held, move):
        pinned = jnp.where(held, jnp.clip(move, lowest_move, highest_move), 0.0)
        return system.solve(extra + jnp.where(held, stiffness, 0.0), jnp.where(held, stiffness * pinned, -gradient))

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


def minimise(
    evaluate: Evaluate,
    start: Float[AnyArray, "n"],
    lower: Float[AnyArray, "n"],
    upper: Float[AnyArray, "n"],
    limit: Count,
    tolerance: Scalar = 1e-6,
    record: Callable[[Float[AnyArray, "n"]], Any] | None = None,
    record_length: int = 0,
    cost: Cost | None = None,
) -> Solution:
    """Up to `limit` steps from `start`; `limit` and `tolerance` may be traced.

    With `record`, its value `record(x)` at the start and after each step is kept in `record_length` + 1 rows, and
    steps beyond that length are not taken. Without it no trace is computed. `cost`: see `step`.
    """
    start = jnp.clip(start, lower, upper)
    first = init(evaluate, start, cost)
    limit = jnp.asarray(limit)

    def running(carry):
        count, state, _ = carry
        return (count < limit) & (state.status == Status.RUNNING.value)

    def body(carry):
        count, state, trace = carry
        state = step(evaluate, state, lower, upper, tolerance, cost)
        if record is not None:
            trace = trace_after(trace, count, record(state.x))
        return count + 1, state, trace

    trace = None
    if record is not None:
        trace = trace_rows(record(first.x), record_length)
        limit = jnp.minimum(limit, record_length)
    count, state, trace = jax.lax.while_loop(running, body, (jnp.asarray(0), first, trace))
    status = jnp.where(state.status == Status.RUNNING.value, Status.ITERATION_LIMIT.value, state.status)
    return Solution(state.x, state.cost, status, count, trace)


def trace_rows(first: Any, length: int) -> Any:
    """Room for `length` steps behind the value at the start."""
    return jax.tree.map(lambda value: jnp.repeat(value[None], length + 1, axis=0), first)


def trace_after(trace: Any, count: Count, value: Any) -> Any:
    """The trace with `value` in the row behind step `count` and all later ones: a plot of all rows shows a plateau."""

    def spread(old, new):
        rows = jnp.arange(len(old)) > count
        return jnp.where(rows.reshape(-1, *[1] * new.ndim), new, old)

    return jax.tree.map(spread, trace, value)
