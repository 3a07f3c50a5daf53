"""Optimistix' Levenberg–Marquardt and dogleg behind the same call, as a second route to the same answers.

`optimistix.least_squares` wants its step limit as a Python integer, so each new limit would compile again; driving
`init`, `step` and `postprocess` inside a loop takes a traced limit.
"""

from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Float

from workbench.arrays import AnyArray, Count, Scalar
from workbench.solvers.levenberg_marquardt import Solution, Status, trace_after, trace_rows

_LINEAR = lx.Normal(lx.Cholesky())


def minimise_with_optimistix(
    residual: Callable[[Float[AnyArray, "n"]], Float[AnyArray, "m"]],
    start: Float[AnyArray, "n"],
    scale: Float[AnyArray, "n"],
    limit: Count,
    tolerance: Scalar = 1e-10,
    method: Literal["lm", "dogleg"] = "lm",
    record: Callable[[Float[AnyArray, "n"]], Any] | None = None,
    record_length: int = 0,
) -> Solution:
    """Up to `limit` steps on Σ residual(x)², without bounds; `limit` and `tolerance` may be traced.

    `scale` is the typical size of each unknown: Optimistix damps with λ·I, so unknowns of mixed units must be scaled.
    `record` as in `minimise`.
    """
    kinds = {"lm": optx.LevenbergMarquardt, "dogleg": optx.Dogleg}
    solver = kinds[method](rtol=tolerance, atol=tolerance, linear_solver=_LINEAR)

    def function(scaled, _):
        return residual(scaled * scale), None

    first = start / scale
    structure = jax.eval_shape(lambda scaled: function(scaled, None), first)
    state = solver.init(function, first, None, {}, *structure, frozenset())
    arrays, static = eqx.partition(state, eqx.is_array)

    trace = None
    limit = jnp.asarray(limit)
    if record is not None:
        trace = trace_rows(record(start), record_length)
        limit = jnp.minimum(limit, record_length)

    def running(carry):
        count, scaled, arrays, _ = carry
        done, result = solver.terminate(function, scaled, None, {}, eqx.combine(arrays, static), frozenset())
        return (count < limit) & ~done & (result == optx.RESULTS.successful)

    def body(carry):
        count, scaled, arrays, trace = carry
        scaled, state, _ = solver.step(function, scaled, None, {}, eqx.combine(arrays, static), frozenset())
        if record is not None:
            accepted, *_ = solver.postprocess(
                function, scaled, None, None, {}, state, frozenset(), optx.RESULTS.successful
            )
            trace = trace_after(trace, count, record(accepted * scale))
        return count + 1, scaled, eqx.filter(state, eqx.is_array), trace

    count, scaled, arrays, trace = jax.lax.while_loop(running, body, (jnp.asarray(0), first, arrays, trace))
    state = eqx.combine(arrays, static)
    done, _ = solver.terminate(function, scaled, None, {}, state, frozenset())
    scaled, _, _ = solver.postprocess(function, scaled, None, None, {}, state, frozenset(), optx.RESULTS.successful)
    x = scaled * scale
    final = residual(x)
    cost = final @ final
    status = jnp.where(done, Status.CONVERGED.value, Status.ITERATION_LIMIT.value)
    status = jnp.where(jnp.isfinite(cost), status, Status.NOT_FINITE.value)
    return Solution(x, cost, status, count, trace)
