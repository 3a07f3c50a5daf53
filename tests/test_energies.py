"""Every term of FACE IT! Eqs. 5-12: its formula, its derivative, its place in the hierarchy of ω."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.scenes import make_scene
from workbench.energies import (
    TERMS,
    EnergyConstants,
    EnergyProblem,
    EnergyWeights,
    Observation,
    beta_curve,
    beta_residual,
    beta_slope,
    energy_by_term,
    identity_residual,
    normal_system,
    pack,
    range_residual,
    range_slope,
    reprojection_residual,
    reprojection_with_jacobian,
    residuals,
    sigma_residual,
    sigma_smooth_residual,
    sigma_smooth_slope,
    tau_residual,
    tau_scale,
    unpack,
)
from workbench.face import contour_blend, landmark_model, model_landmarks

FREE_SETS = [
    ("rotation", "translation"),
    ("expression",),
    ("rotation", "translation", "expression"),
    ("rotation", "translation", "expression", "identity"),
    ("expression", "identity"),
]
weights_in_range = st.lists(st.floats(-0.3, 1.3), min_size=3, max_size=6).map(np.array)
CONSTANTS = EnergyConstants()


@pytest.fixture(scope="module")
def problem(head):
    """An energy with every term switched on, at a pose and expression off its minimum."""
    scene = make_scene(head, (15.0, -8.0, 5.0), {"jawOpen": 0.5, "mouthSmileLeft": 0.4})
    model = landmark_model(head)
    points = model_landmarks(model, contour_blend(model.contour_yaw, 0.2, 1.0), scene.parameters.identity)
    rng = np.random.default_rng(0)
    observed = jnp.asarray(scene.points + rng.normal(0.0, 2.0, (68, 2)))
    weights = jnp.asarray(rng.uniform(0.0, 1.0, 68))
    problem = EnergyProblem(
        camera=scene.camera,
        points=points,
        observation=Observation(observed, weights, jnp.asarray(0.8)),
        weights=EnergyWeights(1.5, 0.7, 1.3, 0.9, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8),
        constants=EnergyConstants(b=0.05),
        before_last_pose=jnp.asarray(rng.normal(size=6)),
        last_pose=jnp.asarray(rng.normal(size=6)),
        history=jnp.ones(()),
    )
    parameters = scene.parameters._replace(
        expression=jnp.asarray(rng.uniform(-0.2, 1.2, 44)), identity=jnp.asarray(rng.normal(size=50))
    )
    return problem, parameters


def test_e_pose_is_the_sum_of_squared_distances_of_eq_8(problem):
    energy, parameters = problem
    rotation = Rotation.from_rotvec(np.array(parameters.rotation)).as_matrix()
    head = energy.points.neutral + np.tensordot(parameters.expression, energy.points.expression, 1)
    head = head + np.tensordot(parameters.identity, energy.points.identity, 1)
    total = 0.0
    for point, observed in zip(np.asarray(head), np.asarray(energy.observation.points), strict=True):
        x, y, z = rotation @ point + np.asarray(parameters.translation)
        projected = energy.camera.focal_px * [x / z, y / z] + energy.camera.principal_point_px
        total += float(((projected - observed) ** 2).sum())
    plain = energy.observation._replace(weights=jnp.ones(68), unit_px=jnp.ones(()))
    residual = reprojection_residual(energy.camera, energy.points, parameters, plain)
    assert float(residual @ residual) == pytest.approx(total, rel=1e-10)


def test_a_landmark_weight_multiplies_its_squared_error(problem):
    energy, parameters = problem
    once = energy.observation._replace(weights=jnp.ones(68))
    twice = energy.observation._replace(weights=jnp.ones(68).at[30].set(3.0))
    first = reprojection_residual(energy.camera, energy.points, parameters, once).reshape(68, 2)
    second = reprojection_residual(energy.camera, energy.points, parameters, twice).reshape(68, 2)
    np.testing.assert_allclose((second**2).sum(1)[30], 3.0 * (first**2).sum(1)[30])


def test_e_tau_is_the_second_difference_of_eq_9():
    before, last, now = np.random.default_rng(1).normal(size=(3, 6))
    residual = tau_residual(jnp.asarray(before), jnp.asarray(last), jnp.asarray(now), 100.0)
    difference = before - 2 * last + now
    expected = 100.0**2 * (difference[:3] ** 2).sum() + (difference[3:] ** 2).sum()
    assert float(residual @ residual) == pytest.approx(expected)


def test_e_tau_is_zero_for_constant_velocity():
    start, velocity = np.random.default_rng(2).normal(size=(2, 6))
    poses = [jnp.asarray(start + k * velocity) for k in range(3)]
    np.testing.assert_allclose(tau_residual(*poses, 100.0), 0.0, atol=1e-12)


@given(weights_in_range)
def test_e_sigma_in_both_forms(weights):
    w = jnp.asarray(weights)
    single = sigma_residual(w)
    assert float(single @ single) == pytest.approx(np.abs(weights).sum() ** 2)
    smooth = sigma_smooth_residual(w, 0.01)
    assert float(smooth @ smooth) == pytest.approx((np.sqrt(weights**2 + 1e-4) - 0.01).sum(), abs=1e-12)


@given(weights_in_range)
def test_e_beta_is_eq_12_summed_over_the_weights(weights):
    expected = np.pi / 4 * (np.arctan((weights - 1.002) / 2e-5) - np.arctan((weights + 0.002) / 2e-5)) + 2.5
    np.testing.assert_allclose(beta_curve(jnp.asarray(weights), CONSTANTS), expected, rtol=1e-9)
    assert float(beta_residual(jnp.asarray(weights), CONSTANTS)[0]) == pytest.approx(expected.sum())


def test_the_trap_of_e_beta_flat_inside_steep_on_the_bound_flat_outside():
    inside, outside = beta_curve(jnp.array([0.5]), CONSTANTS)[0], beta_curve(jnp.array([-0.1]), CONSTANTS)[0]
    assert float(inside) == pytest.approx(0.0326, abs=1e-3)
    assert float(outside) == pytest.approx(2.5, abs=1e-3)
    on_bound, beyond = beta_slope(jnp.array([-0.002, -0.1]), CONSTANTS)
    assert abs(float(on_bound)) == pytest.approx(39270, rel=0.01)
    assert abs(float(beyond)) < 0.01


@given(weights_in_range)
def test_the_range_term_is_zero_inside_and_grows_with_the_distance_outside(weights):
    expected = np.maximum(0, np.maximum(-weights, weights - 1))
    np.testing.assert_allclose(np.abs(range_residual(jnp.asarray(weights))), expected, atol=1e-15)


def test_the_identity_prior_is_the_squared_norm():
    identity = jnp.array([1.0, -2.0, 0.5])
    assert float(jnp.sum(identity_residual(identity) ** 2)) == pytest.approx(5.25)


@pytest.mark.parametrize(
    ("residual", "slope"),
    [
        (lambda w: sigma_smooth_residual(w, 0.01), lambda w: sigma_smooth_slope(w, 0.01)),
        (lambda w: beta_curve(w, EnergyConstants(b=0.05)), lambda w: beta_slope(w, EnergyConstants(b=0.05))),
        (range_residual, range_slope),
    ],
    ids=["sigma_smooth", "beta", "range"],
)
def test_slopes_agree_with_central_differences(residual, slope):
    w, h = jnp.array([-0.21, -0.004, 0.003, 0.37, 0.998, 1.31]), 1e-7
    numeric = (residual(w + h) - residual(w - h)) / (2 * h)
    np.testing.assert_allclose(slope(w), numeric, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("free", FREE_SETS, ids="+".join)
def test_the_written_out_jacobian_agrees_with_central_differences(problem, free):
    energy, parameters = problem
    start = pack(parameters, free)

    def residual_at(vector):
        return reprojection_residual(energy.camera, energy.points, unpack(vector, parameters, free), energy.observation)

    residual, jacobian = reprojection_with_jacobian(energy.camera, energy.points, parameters, energy.observation, free)
    np.testing.assert_allclose(residual, residual_at(start), rtol=1e-9, atol=1e-9)
    evaluate = jax.jit(residual_at)
    for column in np.linspace(0, len(start) - 1, 12).astype(int):
        h = 1e-6 * max(1.0, abs(float(start[column])))
        numeric = (evaluate(start.at[column].add(h)) - evaluate(start.at[column].add(-h))) / (2 * h)
        np.testing.assert_allclose(jacobian[:, column], numeric, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("free", FREE_SETS, ids="+".join)
def test_normal_equations_are_those_of_all_residuals_by_automatic_differentiation(problem, free):
    energy, parameters = problem
    start = pack(parameters, free)

    def all_residuals(vector):
        found = residuals(energy, unpack(vector, parameters, free), free)
        return jnp.concatenate([found[term] for term in TERMS if term in found])

    residual, jacobian = all_residuals(start), jax.jacfwd(all_residuals)(start)
    system = normal_system(energy, parameters, free)
    scale = float(jnp.abs(jacobian.T @ jacobian).max())
    np.testing.assert_allclose(system.cost, residual @ residual, rtol=1e-10)
    np.testing.assert_allclose(system.gradient, jacobian.T @ residual, rtol=1e-8, atol=1e-9 * scale)
    np.testing.assert_allclose(system.matrix, jacobian.T @ jacobian, rtol=1e-8, atol=1e-10 * scale)


def test_omegas_multiply_down_their_branch(problem):
    energy, parameters = problem
    free = FREE_SETS[2]
    base = np.asarray(energy_by_term(energy, parameters, free))
    doubled_prior = energy._replace(weights=energy.weights._replace(prior=2 * energy.weights.prior))
    doubled_sparse = energy._replace(weights=energy.weights._replace(sparse=2 * energy.weights.sparse))
    prior_terms = np.array([term not in ("data", "identity") for term in TERMS])
    data_terms = np.array([term == "data" for term in TERMS])
    np.testing.assert_allclose(
        np.asarray(energy_by_term(doubled_prior, parameters, free))[prior_terms], 2 * base[prior_terms]
    )
    np.testing.assert_allclose(
        np.asarray(energy_by_term(doubled_sparse, parameters, free))[data_terms], 2 * base[data_terms]
    )
    assert (base[prior_terms] > 0).all()


def test_omega_pose_counts_in_pose_stages_and_omega_fit_in_expression_stages(problem):
    energy, parameters = problem
    none = energy._replace(weights=energy.weights._replace(pose=0.0))
    assert float(energy_by_term(none, parameters, ("rotation", "translation"))[0]) == 0.0
    assert float(energy_by_term(none, parameters, ("expression",))[0]) > 0.0


def test_there_is_no_temporal_term_on_the_weights_nor_without_history(problem):
    energy, parameters = problem
    tau = TERMS.index("tau")
    assert float(energy_by_term(energy, parameters, ("expression",))[tau]) == 0.0
    alone = energy._replace(history=jnp.zeros(()))
    assert float(energy_by_term(alone, parameters, ("rotation", "translation"))[tau]) == 0.0
    np.testing.assert_allclose(tau_scale(7.0), [7, 7, 7, 1, 1, 1])


def test_effective_weights_are_the_products_shown_to_the_user():
    effective = EnergyWeights(sparse=2.0, pose=3.0, fit=5.0, prior=7.0, tau=11.0).effective()
    assert effective["pose"] == 6.0
    assert effective["fit"] == 10.0
    assert effective["tau"] == 77.0
