"""The dogleg that a caller drives: Optimistix' own, step for step; and Broyden's update."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from workbench.solvers.dogleg import Quadratic, dogleg_step, judge_step
from workbench.tracking.deep_solver import broyden

TANH = jnp.asarray(np.random.default_rng(0).normal(size=(30, 6)))
PROBLEMS = {
    "rosenbrock": (lambda x: jnp.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), np.array([-1.2, 1.0])),
    "tanh": (lambda x: jnp.tanh(TANH @ x) - 0.3, np.zeros(6)),
    "far tanh": (lambda x: jnp.tanh(TANH @ x) - 0.3, np.linspace(-0.8, 0.8, 6)),
}


def quadratic_at(residual, x):
    values, jacobian = residual(x), jax.jacfwd(residual)(x)
    return Quadratic(0.5 * values @ values, jacobian.T @ values, jacobian.T @ jacobian)


def path_of(residual, start, steps, free=None):
    """Every place that the loop stands at, by our two calls."""
    place = jnp.asarray(start)
    free = np.ones(len(start), bool) if free is None else free
    radius, path = 1.0, []
    for _ in range(steps):
        model = quadratic_at(residual, place)
        step = dogleg_step(model, free, radius)
        tried = residual(place + step)
        accepted, radius = judge_step(model, free, step, 0.5 * tried @ tried, radius)
        place = place + step if accepted else place
        path.append(np.asarray(place))
    return np.array(path)


def optimistix_path(residual, start, steps):
    """The same by `optimistix.Dogleg`, driven one step at a time; it tells of an accepted step one call later."""
    solver = optx.Dogleg(rtol=1e-30, atol=1e-30)
    start = jnp.asarray(start)
    wrapped = lambda x, args: (residual(x), None)  # noqa: E731
    shape = jax.eval_shape(lambda: wrapped(start, None))[0]
    state = solver.init(wrapped, start, None, {}, shape, None, frozenset())
    step = eqx.filter_jit(lambda place, state: solver.step(wrapped, place, None, {}, state, frozenset()))
    place, path = start, []
    for _ in range(steps + 1):
        place, state, _ = step(place, state)
        path.append(np.asarray(place))
    return np.array(path)


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_path_is_that_of_optimistix(name):
    residual, start = PROBLEMS[name]
    ours, theirs = path_of(residual, start, 8), optimistix_path(residual, start, 8)
    # Optimistix' first call only evaluates the start.
    np.testing.assert_allclose(ours, theirs[1:], atol=1e-5)


@pytest.mark.parametrize("name", PROBLEMS)
def test_it_ends_in_scipys_minimum(name):
    residual, start = PROBLEMS[name]
    expected = least_squares(lambda x: np.asarray(residual(x)), start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    found = residual(path_of(residual, start, 40)[-1])
    assert 0.5 * float(found @ found) == pytest.approx(expected.cost, rel=1e-5, abs=1e-8)


def test_what_is_not_free_stays_and_the_rest_solves_the_smaller_problem():
    residual, start = PROBLEMS["far tanh"]
    free = np.array([True, False, True, True, False, True])
    model = quadratic_at(residual, jnp.asarray(start))
    step = np.asarray(dogleg_step(model, free, 1.0))
    assert (step[~free] == 0.0).all()
    part = np.ix_(free, free)
    alone = np.linalg.solve(np.asarray(model.hessian)[part], -np.asarray(model.gradient)[free])
    np.testing.assert_allclose(step[free], alone, rtol=1e-6)
    smaller = lambda y: residual(jnp.asarray(start).at[np.flatnonzero(free)].set(y))  # noqa: E731
    whole, reduced = path_of(residual, start, 5, free), path_of(smaller, start[free], 5)
    np.testing.assert_allclose(whole[:, free], reduced, atol=1e-8)
    assert (whole[:, ~free] == start[~free]).all()


@settings(max_examples=25)
@given(radius=st.floats(1e-4, 1.0), seed=st.integers(0, 100))
def test_a_step_is_as_long_as_its_radius_and_goes_downhill(radius, seed):
    rng = np.random.default_rng(seed)
    jacobian, values = rng.normal(size=(10, 4)), rng.normal(size=10)
    model = Quadratic(0.5 * values @ values, jacobian.T @ values, jacobian.T @ jacobian)
    free = np.ones(4, bool)
    whole, step = (np.asarray(dogleg_step(model, free, share)) for share in (1.0, radius))
    np.testing.assert_allclose(whole, np.linalg.lstsq(jacobian, -values, rcond=None)[0], rtol=1e-5, atol=1e-8)
    assert np.linalg.norm(step) == pytest.approx(radius * np.linalg.norm(whole), rel=1e-5)
    assert step @ np.asarray(model.gradient) < 0.0


def test_a_tiny_step_is_steepest_descent():
    residual, start = PROBLEMS["rosenbrock"]
    model = quadratic_at(residual, jnp.asarray(start))
    step, slope = np.asarray(dogleg_step(model, np.ones(2, bool), 1e-3)), np.asarray(model.gradient)
    assert step @ slope == pytest.approx(-np.linalg.norm(step) * np.linalg.norm(slope))


def test_unknowns_without_any_effect_stay_where_they_are():
    jacobian, values = np.zeros((5, 3)), np.ones(5)
    jacobian[:, 0] = 1.0
    model = Quadratic(0.5 * values @ values, jacobian.T @ values, jacobian.T @ jacobian)
    np.testing.assert_allclose(dogleg_step(model, np.ones(3, bool), 1.0), [-1.0, 0.0, 0.0], atol=1e-6)


def test_a_step_that_leads_uphill_is_refused_and_the_next_one_shorter():
    residual, start = PROBLEMS["rosenbrock"]
    model, free = quadratic_at(residual, jnp.asarray(start)), np.ones(2, bool)
    step = dogleg_step(model, free, 1.0)
    accepted, radius = judge_step(model, free, step, 2.0 * float(model.value), 1.0)
    assert not accepted
    assert float(radius) < 1.0
    accepted, radius = judge_step(model, free, step, 0.0, 1.0)
    assert accepted
    assert float(radius) >= 1.0


numbers = st.integers(0, 10_000).map(lambda seed: np.random.default_rng(seed))


@settings(max_examples=25)
@given(rng=numbers)
def test_broydens_update_explains_the_last_step_and_nothing_else(rng):
    derivative, step, change = rng.normal(size=(2, 5, 68, 2)), rng.normal(size=5), rng.normal(size=(2, 68, 2))
    updated = broyden(derivative, step, change)
    np.testing.assert_allclose(np.einsum("n,vnij->vij", step, updated), change, atol=1e-9)
    across = rng.normal(size=5)
    across -= across @ step / (step @ step) * step
    before, after = (np.einsum("n,vnij->vij", across, each) for each in (derivative, updated))
    np.testing.assert_allclose(after, before, atol=1e-9)


def test_broydens_update_keeps_a_derivative_that_was_right_and_survives_no_step_at_all():
    rng = np.random.default_rng(0)
    derivative, step = rng.normal(size=(1, 4, 68, 2)), rng.normal(size=4)
    right = np.einsum("n,vnij->vij", step, derivative)
    np.testing.assert_allclose(broyden(derivative, step, right), derivative, atol=1e-12)
    np.testing.assert_array_equal(broyden(derivative, np.zeros(4), right), derivative)
