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
    FACE_IT_TERMS,
    TABLE,
    EnergyConstants,
    EnergyProblem,
    Observation,
    TermContext,
    beta_curve,
    beta_slope,
    distance_from_range,
    energy_by_term,
    landmark_errors,
    landmark_residual,
    normal_system,
    project_landmarks,
    reprojection_with_jacobian,
    residual_of,
    residuals,
    second_difference,
    smoothed_l1,
    stage_factors,
    still,
)
from workbench.energies.context import Gaze
from workbench.energies.flow import choose_surface
from workbench.energies.flow_link import FlowLink, FlowTargets
from workbench.face import FaceParameters, contour_blend, landmark_model, model_landmarks, pack, unpack
from workbench.flow import surface_points
from workbench.rendering import render_model
from workbench.tracking.point_links import flow_views

FREE_SETS = [
    ("rotation", "translation"),
    ("expression",),
    ("rotation", "translation", "expression"),
    ("rotation", "translation", "expression", "identity"),
    ("expression", "identity"),
]
weights_in_range = st.lists(st.floats(-0.3, 1.3), min_size=3, max_size=6).map(np.array)
CONSTANTS = EnergyConstants()


OMEGA = {
    f"weights.{name}": value
    for name, value in {
        "sparse": 1.5, "pose": 0.7, "fit": 1.3, "prior": 0.9, "tau": 0.2, "beta": 0.3, "sigma": 0.4,
        "sigma_smooth": 0.5, "range": 0.6, "flow": 0.8, "vergence": 0.3, "opposites": 0.9, "gaze": 0.2, "symmetry": 0.6,
        "usual": 0.1,
    }.items()
}  # fmt: skip
OMEGA |= {"identity.weight": 0.8, "deep.edges": 0.7, "deep.regularisation": 1.1, "deep.prior": 0.4, "flow.stay": 1.7}


def factors(free=("expression",), named=(), terms=FACE_IT_TERMS, **changed):
    """What stands in front of each term in a stage of FACE IT!."""
    omega = OMEGA | {f"weights.{name}": value for name, value in changed.items()}
    return jnp.array(stage_factors(omega, "face-it", free, named, terms))


def of_weights(name, weights, constants=CONSTANTS):
    """A term's residual for some blendshape weights."""
    parameters = FaceParameters(jnp.zeros(3), jnp.zeros(3), jnp.asarray(weights, float), jnp.zeros(0))
    return residual_of(name)(parameters, still(parameters, constants))


def moved_points(head, scene, rng) -> FlowLink:
    """A few points of the face that another frame's flow sends somewhere near."""
    points = surface_points(render_model(head), *choose_surface(head, 16))
    count = len(points.barycentric)
    targets = FlowTargets(
        rng.normal(300.0, 40.0, (1, 1, count, 2)), np.ones((1, 1, count)), np.zeros((1, 1, count, 2)), np.array([1.2])
    )
    return FlowLink(points, flow_views(None, scene.camera), targets, np.asarray(50.0))


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
        omega=factors(),
        context=TermContext(
            constants=EnergyConstants(b=0.05),
            before_last_pose=jnp.asarray(rng.normal(size=6)),
            last_pose=jnp.asarray(rng.normal(size=6)),
            history=jnp.ones(()),
            start=scene.parameters,
            flow=moved_points(head, scene, rng),
            usual=model.usual,
        ),
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
    residual = landmark_residual(landmark_errors(energy.camera, energy.points, parameters, plain))
    assert float(residual @ residual) == pytest.approx(total, rel=1e-10)


def test_a_landmark_weight_multiplies_its_squared_error(problem):
    energy, parameters = problem
    once = energy.observation._replace(weights=jnp.ones(68))
    twice = energy.observation._replace(weights=jnp.ones(68).at[30].set(3.0))
    first, second = (
        landmark_residual(landmark_errors(energy.camera, energy.points, parameters, observation)).reshape(68, 2)
        for observation in (once, twice)
    )
    np.testing.assert_allclose((second**2).sum(1)[30], 3.0 * (first**2).sum(1)[30])


def test_e_tau_is_the_second_difference_of_eq_9():
    before, last, now = np.random.default_rng(1).normal(size=(3, 6))
    residual = second_difference(jnp.asarray(before), jnp.asarray(last), jnp.asarray(now), 100.0)
    difference = before - 2 * last + now
    expected = 100.0**2 * (difference[:3] ** 2).sum() + (difference[3:] ** 2).sum()
    assert float(residual @ residual) == pytest.approx(expected)


def test_e_tau_is_zero_for_constant_velocity():
    start, velocity = np.random.default_rng(2).normal(size=(2, 6))
    poses = [jnp.asarray(start + k * velocity) for k in range(3)]
    np.testing.assert_allclose(second_difference(*poses, 100.0), 0.0, atol=1e-12)


@given(weights_in_range)
def test_e_sigma_in_both_forms(weights):
    single = of_weights("sigma", weights)
    assert float(single @ single) == pytest.approx(np.abs(weights).sum() ** 2)
    smooth = of_weights("sigma_smooth", weights)
    assert float(smooth @ smooth) == pytest.approx((np.sqrt(weights**2 + 1e-4) - 0.01).sum(), abs=1e-12)


@given(weights_in_range)
def test_e_beta_is_eq_12_summed_over_the_weights(weights):
    expected = np.pi / 4 * (np.arctan((weights - 1.002) / 2e-5) - np.arctan((weights + 0.002) / 2e-5)) + 2.5
    np.testing.assert_allclose(beta_curve(jnp.asarray(weights), CONSTANTS), expected, rtol=1e-9)
    assert float(of_weights("beta", weights)[0]) == pytest.approx(expected.sum())


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
    np.testing.assert_allclose(np.abs(of_weights("range", weights)), expected, atol=1e-15)


def test_the_identity_prior_is_the_squared_norm(problem):
    parameters = problem[1]._replace(identity=jnp.array([1.0, -2.0, 0.5]))
    residual = residual_of("identity")(parameters, still(parameters))
    assert float(jnp.sum(residual**2)) == pytest.approx(5.25)


@pytest.mark.parametrize(
    "residual",
    [
        lambda w: smoothed_l1(w, 0.01),
        lambda w: beta_curve(w, EnergyConstants(b=0.05)),
        distance_from_range,
    ],
    ids=["sigma_smooth", "beta", "range"],
)
def test_derivatives_agree_with_central_differences(residual):
    w, h = jnp.array([-0.21, -0.004, 0.003, 0.37, 0.998, 1.31]), 1e-7
    numeric = (residual(w + h) - residual(w - h)) / (2 * h)
    _, slope = jax.jvp(residual, (w,), (jnp.ones(6),))
    np.testing.assert_allclose(slope, numeric, rtol=1e-5, atol=1e-6)


def test_a_weight_on_its_bound_is_not_pushed_by_the_range_term():
    _, slope = jax.jvp(distance_from_range, (jnp.array([0.0, 1.0]),), (jnp.ones(2),))
    np.testing.assert_array_equal(slope, 0.0)


@pytest.fixture(scope="module")
def looking():
    """Weights of a head whose eyes' units are the first four, and the context that says so."""
    turns = np.zeros((4, 6))
    turns[[0, 2], [0, 1]], turns[[1, 3], [2, 3]] = (21.0, -21.0), (10.0, 10.0)
    start = FaceParameters(jnp.zeros(3), jnp.zeros(3), jnp.zeros(6), jnp.zeros(0))
    return still(start)._replace(gaze=Gaze(turns, np.asarray(0.25), np.zeros(6)))


def test_the_eyes_terms_are_angles_in_degrees(looking):
    at = looking.start._replace(expression=jnp.array([0.5, 0.2, 0.3, 0.1, 0.9, 0.9]))
    np.testing.assert_allclose(residual_of("vergence")(at, looking), [-4.2 - 10.5, 1.0 - 3.0])
    np.testing.assert_allclose(
        residual_of("gaze")(at, looking), [0.5 * 10.5, 0.5 * 4.2, 0.5 * 3.0, 0.5 * 1.0, 0.0, 0.0]
    )
    blind = looking._replace(gaze=None)
    assert not residual_of("vergence")(at, blind).any()
    assert not residual_of("gaze")(at, blind).any()


def test_opposite_turns_of_one_eye_count_by_their_product(looking):
    turns = np.zeros((4, 6))
    turns[1, :2], turns[2, 2:4] = (10.0, -20.0), (21.0, -21.0)
    context = looking._replace(gaze=Gaze(turns, np.asarray(0.0), np.zeros(6)))
    at = looking.start._replace(expression=jnp.array([0.5, 0.2, 0.0, 0.9, 0.9, 0.9]))
    up_and_down = residual_of("opposites")(at, context)
    np.testing.assert_allclose(up_and_down**2, [0.0, np.hypot(5.0 * 4.0, 1.0) - 1.0, 0.0, 0.0], atol=1e-12)
    assert not residual_of("opposites")(at, looking._replace(gaze=None)).any()


def test_sparsity_counts_little_for_eyes_that_are_seen(looking):
    at = looking.start._replace(expression=jnp.full(6, 0.5))
    seen, blind = (residual_of("sigma_smooth")(at, context) for context in (looking, looking._replace(gaze=None)))
    np.testing.assert_allclose(seen[:4] ** 2, 0.05 * blind[:4] ** 2)
    np.testing.assert_array_equal(seen[4:], blind[4:])
    assert (blind > 0.0).all()


@pytest.mark.parametrize("name", ["vergence", "opposites", "gaze", "sigma_smooth"])
def test_derivatives_of_the_eyes_terms_agree_with_central_differences(looking, name):
    opposed = looking.gaze.turns - np.roll(looking.gaze.turns, 4, axis=1)
    context = looking._replace(gaze=looking.gaze._replace(turns=opposed))

    def residual(weights):
        return residual_of(name)(looking.start._replace(expression=weights), context)

    at, way = (jnp.asarray(part) for part in np.random.default_rng(3).uniform(0.1, 0.9, (2, 6)))
    _, slope = jax.jvp(residual, (at,), (way,))
    numeric = (residual(at + 1e-6 * way) - residual(at - 1e-6 * way)) / 2e-6
    np.testing.assert_allclose(slope, numeric, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("free", FREE_SETS, ids="+".join)
def test_the_written_out_jacobian_agrees_with_central_differences(problem, free):
    energy, parameters = problem
    start = pack(parameters, free)

    @jax.jit
    def residual_at(vector):
        at = unpack(vector, parameters, free)
        return landmark_residual(landmark_errors(energy.camera, energy.points, at, energy.observation))

    written_out = jax.jit(reprojection_with_jacobian, static_argnames="free")
    residual, jacobian = (
        np.asarray(array)
        for array in written_out(energy.camera, energy.points, parameters, energy.observation, free=free)
    )
    np.testing.assert_allclose(residual, residual_at(start), rtol=1e-9, atol=1e-9)
    for column in np.linspace(0, len(start) - 1, 12).astype(int):
        h = 1e-6 * max(1.0, abs(float(start[column])))
        step = h * (np.arange(len(start)) == column)
        numeric = (residual_at(start + step) - residual_at(start - step)) / (2 * h)
        np.testing.assert_allclose(jacobian[:, column], numeric, rtol=1e-6, atol=1e-6)


IN_DOUBLE = tuple(name for name, term in TABLE.items() if not term.compares_pictures)


@pytest.mark.parametrize(
    ("terms", "looser"),
    [(FACE_IT_TERMS, 1.0), (IN_DOUBLE, 1.0), (tuple(TABLE), 1e2)],
    ids=["own", "all in double precision", "all"],
)
@pytest.mark.parametrize("free", FREE_SETS, ids="+".join)
def test_normal_equations_are_those_of_all_residuals_by_automatic_differentiation(problem, free, terms, looser):
    """Of terms on single unknowns with the whole second derivative. The flow term places the face's points in single
    precision, like a render."""
    compare_with_differentiation(*problem, free, terms, looser)


def test_normal_equations_are_those_of_all_residuals_where_points_have_covariances(problem):
    energy, parameters = problem
    energy = energy._replace(observation=energy.observation._replace(whitening=some_whitening(68)))
    compare_with_differentiation(energy, parameters, FREE_SETS[3], IN_DOUBLE)


def some_whitening(count):
    return jnp.asarray(np.triu(np.random.default_rng(4).uniform(0.2, 1.5, (count, 2, 2))))


def test_a_shift_of_all_points_leaves_their_edges_as_they_are(problem):
    """Also where points have covariances: edges do not count in standard deviations."""
    energy, parameters = problem
    terms = ("landmarks", "edges")
    at = project_landmarks(energy.camera, energy.points, parameters)
    for whitening in (None, some_whitening(68)):
        seen = energy.observation._replace(points=at - jnp.array([3.0, -2.0]), whitening=whitening)
        shifted = energy._replace(observation=seen, omega=jnp.ones(2))
        found = residuals(shifted, parameters, FREE_SETS[0], terms)
        assert float(jnp.sum(found["landmarks"] ** 2)) > 1.0
        np.testing.assert_allclose(found["edges"], 0.0, atol=1e-9)
    rng = np.random.default_rng(5)
    apart = energy.observation._replace(points=at + rng.normal(0.0, 2.0, (68, 2)))

    def edges(whitening):
        seen = energy._replace(observation=apart._replace(whitening=whitening), omega=jnp.ones(2))
        return residuals(seen, parameters, FREE_SETS[0], terms)["edges"]

    plain, whitened = edges(None), edges(some_whitening(68))
    np.testing.assert_allclose(whitened, plain, rtol=1e-12)


def compare_with_differentiation(energy, parameters, free, terms, looser=1.0):
    """The normal system against the derivatives of the residuals."""
    energy = energy._replace(omega=factors(free, named=terms, terms=terms))
    start = pack(parameters, free)

    def split(vector):
        found = residuals(energy, unpack(vector, parameters, free), free, terms)
        of_single = {True: [jnp.zeros(0)], False: [jnp.zeros(0)]}
        for name, part in found.items():
            of_single[TABLE[name].structure == "diagonal"].append(part)
        return tuple(jnp.concatenate(parts) for parts in of_single.values())

    def single_energy(vector):
        return 0.5 * jnp.sum(split(vector)[0] ** 2)

    # As one program: step by step it would be hundreds of small ones.
    (single, others), (single_slopes, slopes), curvature = jax.tree.map(
        np.asarray,
        jax.jit(lambda vector: (split(vector), jax.jacfwd(split)(vector), jax.hessian(single_energy)(vector)))(start),
    )
    residual, jacobian = np.concatenate([single, others]), np.concatenate([single_slopes, slopes])
    matrix = slopes.T @ slopes + curvature
    system = jax.jit(normal_system, static_argnames=("free", "terms"))(energy, parameters, free=free, terms=terms)
    scale = np.abs(matrix).max()
    np.testing.assert_allclose(system.cost, residual @ residual, rtol=1e-10 * looser)
    np.testing.assert_allclose(system.gradient, jacobian.T @ residual, rtol=1e-8 * looser, atol=1e-9 * scale * looser)
    np.testing.assert_allclose(system.matrix, matrix, rtol=1e-8 * looser, atol=1e-10 * scale * looser)


def test_omegas_multiply_down_their_branch(problem):
    energy, parameters = problem
    free = FREE_SETS[2]

    def energies(**changed):
        return np.asarray(energy_by_term(energy._replace(omega=factors(free, **changed)), parameters, free))

    base = energies()
    prior_terms = np.array([term not in ("landmarks", "identity") for term in FACE_IT_TERMS])
    data_terms = np.array([term == "landmarks" for term in FACE_IT_TERMS])
    np.testing.assert_allclose(energies(prior=2 * 0.9)[prior_terms], 2 * base[prior_terms])
    np.testing.assert_allclose(energies(prior=2 * 0.9)[data_terms], base[data_terms])
    np.testing.assert_allclose(energies(sparse=2 * 1.5)[data_terms], 2 * base[data_terms])
    assert (base[prior_terms] > 0).all()


def test_omega_pose_counts_in_pose_stages_and_omega_fit_in_expression_stages():
    assert factors(("rotation", "translation"), pose=0.0)[0] == 0.0
    assert factors(("expression",), pose=0.0)[0] > 0.0


def test_there_is_no_temporal_term_on_the_weights_nor_without_history(problem):
    energy, parameters = problem
    tau = FACE_IT_TERMS.index("tau")
    assert float(energy_by_term(energy, parameters, ("expression",))[tau]) == 0.0
    assert float(energy_by_term(energy, parameters, ("rotation", "translation"))[tau]) > 0.0
    alone = energy._replace(context=energy.context._replace(history=jnp.zeros(())))
    assert float(energy_by_term(alone, parameters, ("rotation", "translation"))[tau]) == 0.0


def test_a_radian_counts_as_so_many_millimetres():
    np.testing.assert_allclose(second_difference(np.zeros(6), np.zeros(6), np.ones(6), 7.0), [7, 7, 7, 1, 1, 1])


def test_effective_weights_are_the_products_shown_to_the_user():
    changed = {"sparse": 2.0, "pose": 3.0, "fit": 5.0, "prior": 7.0, "tau": 11.0}
    pose_stage = dict(zip(FACE_IT_TERMS, factors(("rotation", "translation"), **changed), strict=True))
    assert pose_stage["landmarks"] == 6.0
    assert pose_stage["tau"] == 77.0
    assert factors(("expression",), **changed)[0] == 10.0


def test_a_term_that_no_stage_names_counts_nothing():
    assert factors(named=(), terms=("landmarks", "edges", "regularisation"))[1:].tolist() == [0.0, 0.0]
    assert factors(named=("edges",), terms=("landmarks", "edges", "regularisation"))[1:].tolist() == [0.7, 0.0]


@pytest.mark.parametrize("name", list(TABLE))
def test_every_row_of_the_table_says_what_its_term_is(name):
    term = TABLE[name]
    assert callable(residual_of(name))
    assert term.symbol
    assert term.formula
    assert term.says
    assert not term.says.endswith(".")
    assert term.slider[0] < term.slider[1]
    assert term.default >= 0.0
