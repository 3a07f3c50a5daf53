"""The loop and its methods on problems without faces, against SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares

from workbench.solvers import (
    ArrowheadSystem,
    DenseSystem,
    LevenbergMarquardt,
    Status,
    TrustRegion,
    init,
    judge,
    minimise,
    normal_equations,
    propose,
)

TANH = jnp.asarray(np.random.default_rng(0).normal(size=(60, 12)))
TIMES = jnp.linspace(0.0, 5.0, 20)
PROBLEMS = {
    "rosenbrock": (lambda x: jnp.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), np.array([-1.2, 1.0])),
    "exponential": (lambda x: x[0] * jnp.exp(-x[1] * TIMES) - 2.0 * jnp.exp(-0.7 * TIMES) - 0.1, np.array([1.0, 0.2])),
    "tanh": (lambda x: jnp.tanh(TANH @ x) - 0.3, np.zeros(12)),
}


def evaluator(residual):
    return lambda x: normal_equations(residual(x), jax.jacfwd(residual)(x))


def unbounded(start):
    infinite = jnp.full(len(start), jnp.inf)
    return -infinite, infinite


def methods(count):
    return {
        "lm": LevenbergMarquardt(),
        "damped": TrustRegion(jnp.ones(count), "damped"),
        "dogleg": TrustRegion(jnp.ones(count), "dogleg"),
        "dogleg in other units": TrustRegion(jnp.linspace(0.2, 5.0, count), "dogleg"),
    }


METHODS = tuple(methods(1))
LM = LevenbergMarquardt()


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("method", METHODS)
def test_every_method_finds_scipys_minimum(name, method):
    residual, start = PROBLEMS[name]
    found = minimise(
        methods(len(start))[method], evaluator(residual), jnp.asarray(start), *unbounded(start), 500, 1e-14
    )
    expected = least_squares(lambda x: np.asarray(residual(x)), start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert float(found.cost) == pytest.approx(2 * expected.cost, rel=1e-6, abs=1e-10)
    assert int(found.status) in (Status.CONVERGED, Status.STALLED)


@pytest.mark.parametrize("upper", [0.01, 0.05, 0.3])
@pytest.mark.parametrize("method", METHODS)
def test_bounds_are_kept_and_the_minimum_inside_them_is_scipys(upper, method):
    residual, _ = PROBLEMS["tanh"]
    lower_bound, upper_bound = jnp.zeros(12), jnp.full(12, upper)
    start = jnp.full(12, upper / 2)
    found = minimise(methods(12)[method], evaluator(residual), start, lower_bound, upper_bound, 500, 1e-14)
    expected = least_squares(
        lambda x: np.asarray(residual(x)),
        np.full(12, upper / 2),
        bounds=(0.0, upper),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
    )
    assert ((found.x >= 0.0) & (found.x <= upper)).all()
    np.testing.assert_allclose(found.x, expected.x, atol=1e-6)
    # A rounding beside its bound an unknown would count as free, and mislead the others' next step.
    assert set(np.asarray(found.x)[np.abs(found.x - np.clip(found.x, 1e-9, upper - 1e-9)) > 0]) <= {0.0, upper}


def test_a_start_outside_the_bounds_is_moved_inside():
    found = minimise(LM, evaluator(lambda x: x - 3.0), jnp.array([9.0]), jnp.array([0.0]), jnp.array([1.0]), 5)
    np.testing.assert_allclose(found.x, [1.0])


def test_the_limit_and_the_tolerance_are_traced():
    residual, start = PROBLEMS["rosenbrock"]
    solve = jax.jit(
        lambda limit, tolerance: minimise(
            LM, evaluator(residual), jnp.asarray(start), *unbounded(start), limit, tolerance
        )
    )
    runs = [solve(limit, tolerance) for limit, tolerance in ((1, 1e-6), (3, 1e-6), (200, 1e-12))]
    assert solve._cache_size() == 1
    assert [int(run.iterations) for run in runs[:2]] == [1, 3]
    assert [int(run.status) for run in runs] == [Status.ITERATION_LIMIT, Status.ITERATION_LIMIT, Status.CONVERGED]


def test_stepping_by_hand_is_what_minimise_does():
    residual, start = PROBLEMS["rosenbrock"]
    evaluate = evaluator(residual)
    bounds = unbounded(start)
    state = init(LM, jnp.asarray(start), evaluate(jnp.asarray(start)).cost)
    for _ in range(5):
        system = evaluate(state.x)
        candidate, move = propose(LM, system, state, *bounds)
        state = judge(LM, system, state, candidate, move, evaluate(candidate).cost, 1e-12)
    expected = minimise(LM, evaluate, jnp.asarray(start), *unbounded(start), 5, 1e-12)
    np.testing.assert_allclose(state.x, expected.x, rtol=1e-12)


def test_the_trace_records_the_start_and_every_step_and_changes_nothing():
    residual, start = PROBLEMS["rosenbrock"]
    plain = minimise(LM, evaluator(residual), jnp.asarray(start), *unbounded(start), 50, 1e-12)
    cost = lambda x: residual(x) @ residual(x)  # noqa: E731
    traced = minimise(LM, evaluator(residual), jnp.asarray(start), *unbounded(start), 50, 1e-12, cost, 60)
    costs = np.asarray(traced.trace)
    np.testing.assert_array_equal(traced.x, plain.x)
    assert costs[0] == pytest.approx(24.2)
    assert (np.diff(costs) <= 0).all()
    assert costs[int(traced.iterations)] == costs[-1] == float(plain.cost)
    assert plain.trace is None


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("limit", [0, 1, 4, 300])
def test_a_cost_of_its_own_spares_normal_equations_and_changes_nothing(name, limit):
    residual, start = PROBLEMS[name]
    cost = lambda x: residual(x) @ residual(x)  # noqa: E731
    asked = (LM, evaluator(residual), jnp.asarray(start), *unbounded(start), limit, 1e-12)
    plain, spared = minimise(*asked), minimise(*asked, cost=cost)
    np.testing.assert_allclose(spared.x, plain.x, rtol=1e-9)
    np.testing.assert_allclose(spared.cost, plain.cost, rtol=1e-9, atol=1e-15)
    assert int(spared.iterations) == int(plain.iterations)
    assert int(spared.status) == int(plain.status)


@pytest.mark.parametrize("method", METHODS)
def test_what_is_held_between_equal_bounds_stays_and_the_rest_solves_the_smaller_problem(method):
    residual, start = PROBLEMS["tanh"]
    held = np.arange(12) % 3 == 0
    lower, upper = (jnp.where(held, jnp.asarray(start), bound) for bound in unbounded(start))
    found = minimise(methods(12)[method], evaluator(residual), jnp.asarray(start), lower, upper, 300, 1e-14)
    np.testing.assert_array_equal(found.x[held], start[held])
    smaller = lambda y: residual(jnp.asarray(start).at[np.flatnonzero(~held)].set(y))  # noqa: E731
    expected = least_squares(lambda y: np.asarray(smaller(y)), start[~held], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    np.testing.assert_allclose(found.x[~held], expected.x, atol=1e-6)


def test_a_start_that_is_not_finite_is_a_status_not_a_crash():
    found = minimise(LM, evaluator(lambda x: jnp.log(x)), jnp.array([-1.0]), *unbounded([0.0]), 5)
    assert int(found.status) == Status.NOT_FINITE


@pytest.mark.parametrize("method", METHODS)
def test_where_nothing_changes_anything_the_start_has_converged(method):
    found = minimise(methods(1)[method], evaluator(lambda x: 0.0 * x), jnp.array([1.0]), *unbounded([0.0]), 50)
    np.testing.assert_array_equal(found.x, [1.0])
    assert int(found.status) == Status.CONVERGED


def test_an_unknown_that_changes_nothing_stays_where_it_is():
    found = minimise(LM, evaluator(lambda x: x[:1] - 2.0), jnp.array([0.0, 0.7]), *unbounded([0.0, 0.0]), 50, 1e-12)
    np.testing.assert_allclose(found.x, [2.0, 0.7], atol=1e-6)


def test_the_arrowhead_system_solves_like_the_dense_one():
    rng = np.random.default_rng(2)
    blocks, size, shared = 3, 4, 5
    jacobians = rng.normal(size=(blocks, 12, size + shared))
    full = np.zeros((blocks * 12, blocks * size + shared))
    for k in range(blocks):
        full[12 * k : 12 * (k + 1), size * k : size * (k + 1)] = jacobians[k][:, :size]
        full[12 * k : 12 * (k + 1), -shared:] = jacobians[k][:, size:]
    residual = rng.normal(size=len(full))
    dense = normal_equations(jnp.asarray(residual), jnp.asarray(full))
    matrix = np.einsum("fra,frb->fab", jacobians, jacobians)
    arrow = ArrowheadSystem(
        cost=dense.cost,
        local_gradient=dense.gradient[: blocks * size].reshape(blocks, size),
        shared_gradient=dense.gradient[blocks * size :],
        local=jnp.asarray(matrix[:, :size, :size]),
        border=jnp.asarray(matrix[:, :size, size:]),
        shared=jnp.asarray(matrix[:, size:, size:].sum(0)),
    )
    extra, right = jnp.asarray(rng.uniform(0.1, 1.0, full.shape[1])), jnp.asarray(rng.normal(size=full.shape[1]))
    assert isinstance(dense, DenseSystem)
    np.testing.assert_allclose(arrow.solve(extra, right), dense.solve(extra, right), rtol=1e-9)
    np.testing.assert_allclose(arrow.product(right), dense.product(right), rtol=1e-10)
    np.testing.assert_allclose(arrow.diagonal(), dense.diagonal(), rtol=1e-12)
    np.testing.assert_allclose(arrow.gradient, dense.gradient, rtol=1e-12)
    moving = jnp.asarray(rng.uniform(size=full.shape[1]) < 0.6)
    held_arrow, held_dense = arrow.restricted(moving), dense.restricted(moving)
    np.testing.assert_allclose(held_arrow.solve(extra, right), held_dense.solve(extra, right), rtol=1e-9)
    np.testing.assert_allclose(held_arrow.gradient, held_dense.gradient, rtol=1e-12)
    move = held_arrow.solve(extra, -held_arrow.gradient)
    np.testing.assert_array_equal(move[~moving], 0.0)
