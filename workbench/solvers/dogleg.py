"""Optimistix' dogleg with derivatives from outside: one step at a time, between evaluations that the caller makes.

Where one evaluation renders a picture and runs a network, the loop belongs to the caller: it can show progress, stop,
or bring a derivative of its own. Descent and trust region are `optimistix.DoglegDescent` and
`optimistix.ClassicalTrustRegion`, as in `optimistix.Dogleg`.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float

from workbench.arrays import AnyArray, Scalar

DAMPING = 1e-9
"""Share of the mean curvature added to every unknown: directions without any curvature stay where they are."""


class Quadratic(NamedTuple):
    """½Σr² near a point, in scaled unknowns: value, Jᵀr and JᵀJ."""

    value: Float[AnyArray, ""]
    gradient: Float[AnyArray, "n"]
    hessian: Float[AnyArray, "n n"]


@jax.jit
def dogleg_step(model: Quadratic, free: Bool[AnyArray, "n"], radius: Scalar) -> Float[Array, "n"]:
    """The step of the dogleg path of this radius, as a share of the Gauss–Newton step's length; 0 where not free."""
    model = _restricted(model, free)
    descent = optx.DoglegDescent(linear_solver=lx.Cholesky())
    start = jnp.zeros_like(model.gradient)
    state = descent.init(start, _information(model))
    state = descent.query(start, _information(model), state)
    step, _ = descent.step(jnp.asarray(radius, float), state)
    return jnp.where(free, step, 0.0)


@jax.jit
def judge_step(
    model: Quadratic, free: Bool[AnyArray, "n"], step: Float[AnyArray, "n"], value: Scalar, radius: Scalar
) -> tuple[Bool[Array, ""], Float[Array, ""]]:
    """Whether a step that led to `value` (½Σr²) is accepted, and the next radius."""
    model = _restricted(model, free)
    search = optx.ClassicalTrustRegion()
    state = search.init(step, _information(model))
    state = type(state)(step_size=jnp.asarray(radius, float))
    evaluated = optx.FunctionInfo.Eval(jnp.asarray(value, float))
    start = jnp.zeros_like(step)
    next_radius, accepted, _, _ = search.step(
        jnp.asarray(False), start, jnp.asarray(step), _information(model), evaluated, state
    )
    return accepted, next_radius


def _restricted(model: Quadratic, free) -> Quadratic:
    """The model in the free unknowns alone, keeping its size: the others get a unit curvature and no slope."""
    both = jnp.outer(free, free)
    damping = DAMPING * jnp.trace(jnp.where(both, model.hessian, 0.0)) / jnp.maximum(jnp.sum(free), 1)
    hessian = jnp.where(both, model.hessian, 0.0) + jnp.diag(jnp.where(free, damping, 1.0))
    return Quadratic(jnp.asarray(model.value, float), jnp.where(free, model.gradient, 0.0), hessian)


def _information(model: Quadratic) -> optx.FunctionInfo.EvalGradHessian:
    operator = lx.MatrixLinearOperator(model.hessian, lx.positive_semidefinite_tag)
    return optx.FunctionInfo.EvalGradHessian(model.value, model.gradient, operator)
