"""The one loop of every solve: form the normal equations, propose a place, evaluate it, judge the step.

Minimises Σ r(x)² over lower ≤ x ≤ upper. `minimise` is the compiled loop. Where an evaluation renders a picture and
runs a network, the caller loops itself over `propose` and `judge` and evaluates in between: it can show progress, stop,
or bring a derivative of its own. How a step is found and how far it is trusted is the *method*'s
(`LevenbergMarquardt`, `TrustRegion`).

The iteration limit and the tolerance are traced numbers, so a slider on them compiles nothing.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from workbench.arrays import AnyArray, Count, Scalar
from workbench.solvers.normal_equations import System

Evaluate = Callable[[Float[AnyArray, "n"]], System]
Cost = Callable[[Float[AnyArray, "n"]], Float[AnyArray, ""]]


class Status(IntEnum):
    """How a solve ended."""

    RUNNING = 0
    CONVERGED = 1
    ITERATION_LIMIT = 2
    STALLED = 3
    NOT_FINITE = 4


class Judgement(NamedTuple):
    """What a method makes of a step that was tried."""

    accepted: Bool[AnyArray, ""]
    trust: Any
    """What the next step is proposed with."""
    exhausted: Bool[AnyArray, ""]
    """No step is short enough to be accepted."""


@runtime_checkable
class Method(Protocol):
    """How a step is found and how far it is trusted; `trust` is whatever the method hands from step to step."""

    def start(self) -> Any:
        """Trust before the first step."""

    def propose(
        self,
        system: System,
        trust: Any,
        x: Float[AnyArray, "n"],
        lower: Float[AnyArray, "n"],
        upper: Float[AnyArray, "n"],
    ) -> tuple[Float[AnyArray, "n"], Float[AnyArray, "n"]]:
        """The next place to try, inside the bounds, and the move that leads there."""

    def judge(self, system: System, trust: Any, move: Float[AnyArray, "n"], value: Scalar) -> Judgement:
        """What to make of a move that led to the cost `value`."""


class SolverState(NamedTuple):
    """Everything that one step hands to the next."""

    x: Float[AnyArray, "n"]
    cost: Float[AnyArray, ""]
    trust: Any
    accepted: Bool[AnyArray, ""]
    status: Int[AnyArray, ""]
    """A `Status` value."""


class Solution(NamedTuple):
    """Result of `minimise`."""

    x: Float[AnyArray, "n"]
    cost: Float[AnyArray, ""]
    status: Int[AnyArray, ""]
    """A `Status` value."""
    iterations: Int[AnyArray, ""]
    trace: Any
    """What `record` returned at the start and after each step, stacked (rows beyond the last step repeat it)."""


def init(method: Method, start: Float[AnyArray, "n"], cost: Scalar) -> SolverState:
    """State before the first step, from a place and its cost."""
    status = jnp.where(jnp.isfinite(cost), Status.RUNNING.value, Status.NOT_FINITE.value)
    return SolverState(start, jnp.asarray(cost, float), method.start(), jnp.asarray(True), status)


@jax.jit
def propose(
    method: Method, system: System, state: SolverState, lower: Float[AnyArray, "n"], upper: Float[AnyArray, "n"]
) -> tuple[Float[AnyArray, "n"], Float[AnyArray, "n"]]:
    """The next place to try, inside the bounds, and the move that leads there."""
    return method.propose(system, state.trust, state.x, lower, upper)


@jax.jit
def judge(
    method: Method,
    system: System,
    state: SolverState,
    candidate: Float[AnyArray, "n"],
    move: Float[AnyArray, "n"],
    value: Scalar,
    tolerance: Scalar = 1e-6,
) -> SolverState:
    """The state after a place with the cost `value` was tried; converged when an accepted step lowers the cost by less
    than `tolerance` of itself."""
    accepted, trust, exhausted = method.judge(system, state.trust, move, value)
    # A step that moves nothing means that every unknown rests on a bound or at the minimum.
    still = jnp.max(jnp.abs(move)) <= 1e-15 * (1.0 + jnp.max(jnp.abs(state.x)))
    converged = (accepted & (system.cost - value <= tolerance * system.cost)) | still
    status = jnp.where(converged, Status.CONVERGED.value, jnp.where(exhausted, Status.STALLED.value, state.status))
    return SolverState(
        x=jnp.where(accepted, candidate, state.x),
        cost=jnp.where(accepted, value, system.cost),
        trust=trust,
        accepted=accepted,
        status=status,
    )


def step(
    method: Method,
    system: System,
    state: SolverState,
    lower: Float[AnyArray, "n"],
    upper: Float[AnyArray, "n"],
    cost: Cost,
    tolerance: Scalar = 1e-6,
) -> SolverState:
    """One step from a state whose normal equations are `system`."""
    candidate, move = propose(method, system, state, lower, upper)
    return judge(method, system, state, candidate, move, cost(candidate), tolerance)


def minimise(
    method: Method,
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
    steps beyond that length are not taken. Without it no trace is computed. `cost` gives what `evaluate(x).cost` would,
    where there is a shorter way to it.

    Normal equations are formed only where a step starts: neither a rejected place nor the last one pays for them.
    """
    cost = cost or (lambda x: evaluate(x).cost)
    start = jnp.clip(start, lower, upper)
    limit = jnp.asarray(limit)
    none_yet = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), jax.eval_shape(evaluate, start))

    def running(carry):
        count, state, *_ = carry
        return (count < limit) & (state.status == Status.RUNNING.value)

    def body(carry):
        count, state, system, trace = carry
        # After a rejected step the equations still are those of the place where the loop stands.
        system = jax.lax.cond(state.accepted, lambda: evaluate(state.x), lambda: system)
        state = step(method, system, state, lower, upper, cost, tolerance)
        if record is not None:
            trace = _trace_after(trace, count, record(state.x))
        return count + 1, state, system, trace

    trace = None
    if record is not None:
        trace = _trace_rows(record(start), record_length)
        limit = jnp.minimum(limit, record_length)
    first = (jnp.asarray(0), init(method, start, cost(start)), none_yet, trace)
    count, state, _, trace = jax.lax.while_loop(running, body, first)
    status = jnp.where(state.status == Status.RUNNING.value, Status.ITERATION_LIMIT.value, state.status)
    return Solution(state.x, state.cost, status, count, trace)


def _trace_rows(first: Any, length: int) -> Any:
    """Room for `length` steps behind the value at the start."""
    return jax.tree.map(lambda value: jnp.repeat(value[None], length + 1, axis=0), first)


def _trace_after(trace: Any, count: Count, value: Any) -> Any:
    """The trace with `value` in the row behind step `count` and all later ones: a plot of all rows shows a plateau."""

    def spread(old, new):
        rows = jnp.arange(len(old)) > count
        return jnp.where(rows.reshape(-1, *[1] * new.ndim), new, old)

    return jax.tree.map(spread, trace, value)
