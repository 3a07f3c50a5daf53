"""The loop over a trust region that a caller drives: Optimistix' own, step for step; and Broyden's update."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from workbench.solvers import Status, TrustRegion, init, judge, normal_equations, propose
from workbench.tracking.deep_solver import broyden

TANH = jnp.asarray(np.random.default_rng(0).normal(size=(30, 6)))
PROBLEMS = {
    "rosenbrock": (lambda x: jnp.stack([10.0 * (x[1] - x[0] ** 2), 1.0 - x[0]]), np.array([-1.2, 1.0])),
    "tanh": (lambda x: jnp.tanh(TANH @ x) - 0.3, np.zeros(6)),
    "far tanh": (lambda x: jnp.tanh(TANH @ x) - 0.3, np.linspace(-0.8, 0.8, 6)),
}


SOLVERS = {"dogleg": optx.Dogleg, "damped": optx.LevenbergMarquardt}


def system_at(residual, x):
    return normal_equations(residual(x), jax.jacfwd(residual)(x))


def region(count, descent="dogleg", **sizes):
    return TrustRegion(jnp.ones(count), descent, **sizes)


def bounds(start, free):
    return (jnp.where(free, bound, jnp.asarray(start)) for bound in (-jnp.inf, jnp.inf))


def step_from(method, system, radius=1.0, free=True):
    """The move that a method proposes at the origin."""
    origin = jnp.zeros(len(system.gradient))
    state = init(method, origin, system.cost)._replace(trust=jnp.asarray(radius))
    return np.asarray(propose(method, system, state, *bounds(origin, free))[1])


def path_of(residual, start, steps, free=True, descent="dogleg"):
    """Every place that the loop stands at, by our two calls."""
    method, place, path = region(len(start), descent), jnp.asarray(start), []
    lower, upper = bounds(start, free)
    state = init(method, place, jnp.sum(residual(place) ** 2))
    for _ in range(steps):
        system = system_at(residual, state.x)
        candidate, move = propose(method, system, state, lower, upper)
        state = judge(method, system, state, candidate, move, jnp.sum(residual(candidate) ** 2), 0.0)
        path.append(np.asarray(state.x))
    return np.array(path)


def optimistix_path(residual, start, steps, descent):
    """The same by Optimistix' solver, driven one step at a time; it tells of an accepted step one call later."""
    solver = SOLVERS[descent](rtol=1e-30, atol=1e-30)
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


@pytest.mark.parametrize("descent", SOLVERS)
def test_a_descent_chosen_by_data_takes_the_same_steps(descent):
    residual, start = PROBLEMS["rosenbrock"]
    system, chosen = system_at(residual, start), region(2, "either", is_dogleg=jnp.asarray(descent == "dogleg"))
    for radius in (0.3, 3.0):  # shorter than a Gauss–Newton step, and longer
        np.testing.assert_array_equal(step_from(chosen, system, radius), step_from(region(2, descent), system, radius))
    moves = [step_from(region(2, name), system, 0.3) for name in SOLVERS]
    assert not np.array_equal(*moves)


@pytest.mark.parametrize("descent", SOLVERS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_the_path_is_that_of_optimistix(name, descent):
    residual, start = PROBLEMS[name]
    ours, theirs = path_of(residual, start, 8, descent=descent), optimistix_path(residual, start, 8, descent)
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
    system = system_at(residual, jnp.asarray(start))
    step = step_from(region(6), system, free=free)
    assert (step[~free] == 0.0).all()
    part = np.ix_(free, free)
    alone = np.linalg.solve(np.asarray(system.matrix)[part], -np.asarray(system.gradient)[free])
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
    system = normal_equations(jnp.asarray(values), jnp.asarray(jacobian))
    whole, step = (step_from(region(4), system, share) for share in (1.0, radius))
    np.testing.assert_allclose(whole, np.linalg.lstsq(jacobian, -values, rcond=None)[0], rtol=1e-5, atol=1e-8)
    assert np.linalg.norm(step) == pytest.approx(radius * np.linalg.norm(whole), rel=1e-5)
    assert step @ np.asarray(system.gradient) < 0.0


def test_a_tiny_step_is_steepest_descent():
    residual, start = PROBLEMS["rosenbrock"]
    system = system_at(residual, jnp.asarray(start))
    step, slope = step_from(region(2), system, 1e-3), np.asarray(system.gradient)
    assert step @ slope == pytest.approx(-np.linalg.norm(step) * np.linalg.norm(slope))


def test_unknowns_without_any_effect_stay_where_they_are():
    jacobian, values = jnp.zeros((5, 3)).at[:, 0].set(1.0), jnp.ones(5)
    np.testing.assert_allclose(step_from(region(3), normal_equations(values, jacobian)), [-1.0, 0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("scale", [0.1, 7.0])
def test_the_scale_is_the_unit_of_the_radius_and_not_of_the_answer(scale):
    residual, start = PROBLEMS["far tanh"]
    sizes = jnp.asarray([scale, 1.0, 1.0, scale, 1.0, 1.0])
    system, rescaled = (
        system_at(function, place)
        for function, place in (
            (residual, jnp.asarray(start)),
            (lambda y: residual(y * sizes), jnp.asarray(start) / sizes),
        )
    )
    for radius in (0.3, 1.0):
        ours, theirs = step_from(TrustRegion(sizes), system, radius), step_from(region(6), rescaled, radius)
        np.testing.assert_allclose(ours, theirs * np.asarray(sizes), rtol=1e-6)


def test_a_step_that_leads_uphill_is_refused_and_the_next_one_shorter():
    residual, start = PROBLEMS["rosenbrock"]
    method, place = region(2, smallest=0.3), jnp.asarray(start)
    system = system_at(residual, place)
    state = init(method, place, system.cost)
    candidate, move = propose(method, system, state, *bounds(start, True))
    refused = judge(method, system, state, candidate, move, 2.0 * system.cost)
    assert not refused.accepted
    np.testing.assert_array_equal(refused.x, start)
    assert float(refused.trust) < 1.0
    # Shorter than the smallest radius.
    assert int(refused.status) == Status.STALLED
    taken = judge(method, system, state, candidate, move, 0.0)
    assert taken.accepted
    assert float(taken.trust) >= 1.0
    capped = judge(region(2, largest=1.0), system, state, candidate, move, 0.0)
    assert float(capped.trust) == 1.0


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
