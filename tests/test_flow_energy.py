"""Flow energies: what they say of a frame, how they change, and the solve on them (Deep Energies Sec. 6 and 7)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.stereo_scenes import make_rig
from workbench.energies import still
from workbench.energies.flow import (
    FlowWeights,
    choose_surface,
    flow_distances,
    flow_residual,
    flow_residuals,
    points_in_views,
    robust_scales,
)
from workbench.energies.flow_link import FlowLink, FlowTargets, FlowView
from workbench.errors import InputError
from workbench.face import FaceParameters, JawUnit, pack, unpack
from workbench.flow import surface_points
from workbench.geometry import Camera, camera_from_fov
from workbench.rendering import render_model
from workbench.tracking.flow_solver import MOVING, FlowLimits, solve_flow

SIZE = (640, 480)
COUNT = 200


@pytest.fixture(scope="module")
def points(head):
    return surface_points(render_model(head), *choose_surface(head, COUNT))


def state(head, jaw_open=0.0, rotation=(0.1, -0.2, 0.05), translation=(10.0, -5.0, 600.0), jaw=(0.0,) * 6):
    expression = np.zeros(len(head.expression_names))
    expression[head.expression_names.index("jawOpen")] = jaw_open
    identity = np.random.default_rng(3).normal(0.0, 0.5, len(head.identity_deltas))
    parts = (rotation, translation, expression, identity, jaw, np.ones(1))
    return FaceParameters(*(np.asarray(part, float) for part in parts))


def one_view():
    camera = Camera(*(np.asarray(part, float)[None] for part in camera_from_fov(SIZE, 45.0)))
    return FlowView(camera, np.eye(3)[None], np.zeros((1, 3)))


def two_views():
    rig = make_rig()
    cameras = zip(*(view.camera for view in rig.views), strict=True)
    stacked = Camera(*(np.stack([np.asarray(part, float) for part in parts]) for parts in cameras))
    return FlowView(stacked, rig.rotation_view_reference, rig.translation_view_reference_mm)


def targets_of(points, views, truth, sides=2):
    """Both neighbours say where the points truly are."""
    places = np.asarray(points_in_views(points, views, truth)[0], float)
    stacked = np.stack([places] * sides)
    return FlowTargets(stacked, np.ones(stacked.shape[:3]), np.zeros_like(stacked), np.full(len(places), 1.4))


def weights(flow=1.0, stay=0.0, stay_pose=0.0, robust=np.inf):
    return FlowWeights(*(np.asarray(value, float) for value in (flow, stay, stay_pose, robust)))


def limits(start, free=None):
    held = np.asarray(pack(start, MOVING))
    free = np.ones(len(held), bool) if free is None else free
    bounds = (np.where(free, sign * np.inf, held) for sign in (-1.0, 1.0))
    return FlowLimits(*bounds, np.asarray(15), np.asarray(1e-8))


def test_where_the_points_lie_as_the_flow_says_the_energy_is_zero(head, points):
    truth = state(head, 0.4)
    targets = targets_of(points, one_view(), truth)
    assert float(np.abs(flow_distances(points, one_view(), targets, truth)).max()) == 0.0


def test_the_energy_is_the_sum_over_points_as_if_they_were_68_landmarks(head, points):
    truth, other, views = state(head, 0.4), state(head, 0.1), one_view()
    targets = targets_of(points, views, truth)
    targets.weights[1] = 0.25
    scales = np.random.default_rng(0).uniform(0.2, 1.0, targets.weights.shape)
    prior = truth._replace(translation=truth.translation + 2.0)
    terms = flow_residuals(points, views, targets, weights(2.0, 3.0, 0.5), scales, other, prior)
    places = np.asarray(points_in_views(points, views, other)[0])
    missed = ((places - targets.places) / 1.4) ** 2
    expected = 2.0 * 68 / COUNT * (missed.sum(-1) * targets.weights * scales**2).sum()
    assert float(np.sum(terms["flow"] ** 2)) == pytest.approx(expected, rel=1e-5)
    apart = 0.3**2 * 3.0 + 0.5 * 3 * 2.0**2
    assert float(np.sum(terms["stay"] ** 2)) == pytest.approx(apart, rel=1e-6)


def test_the_jaw_stays_in_the_unit_of_its_model(head, points):
    truth, views = state(head, 0.4, jaw=np.array([0.2, 0.0, 0.0, 3.0, 0.0, -2.0])), one_view()
    targets, rest = targets_of(points, views, truth), truth._replace(jaw=np.zeros(6))
    unit = JawUnit(13.25, 4.0, 5.0)
    other = points._replace(model=points.model._replace(jaw=points.model.jaw._replace(unit=unit)))
    for surface, counted in ((points, [np.radians(26.5), 8.0, 8.0]), (other, [np.radians(13.25), 4.0, 5.0])):
        terms = flow_residuals(surface, views, targets, weights(stay=1.0), np.ones(targets.weights.shape), truth, rest)
        apart = ((np.array([0.2, 3.0, 2.0]) / counted) ** 2).sum()
        assert float(np.sum(terms["stay"] ** 2)) == pytest.approx(apart, rel=1e-6)


def test_residuals_change_as_finite_differences_say(head, points):
    start, views = state(head, 0.3, jaw=np.full(6, 0.01)), two_views()
    targets = targets_of(points, views, state(head, 0.5))
    scales = np.ones(targets.weights.shape)

    @jax.jit
    def residual(vector):
        at = unpack(vector, start, MOVING)
        terms = flow_residuals(points, views, targets, weights(1.0, 2.0, 0.1), scales, at, start)
        return jnp.concatenate([part.astype(float) for part in terms.values()])

    vector = pack(start, MOVING)
    jacobian = np.asarray(jax.jit(jax.jacfwd(residual))(vector))
    for column in (0, 2, 4, 5, 6 + head.expression_names.index("jawOpen"), len(vector) - 6, len(vector) - 1):
        step = np.zeros(len(vector))
        step[column] = 1e-2 if column not in (3, 4, 5) else 0.5
        numeric = np.asarray(residual(vector + step) - residual(vector - step)) / (2 * step[column])
        scale = np.abs(numeric).max()
        assert np.abs(jacobian[:, column] - numeric).max() < 0.01 * scale, column


def linked(points, views, targets, robust, start):
    """The context of a frame that the flow ties to the one before it."""
    return still(start)._replace(flow=FlowLink(points, views, targets, np.asarray(robust)))


def test_the_term_sums_cauchys_energy_over_points_as_if_they_were_68_landmarks(head, points):
    truth, other, views = state(head, 0.4), state(head, 0.1), two_views()
    targets = targets_of(points, views, truth, sides=1)
    targets.weights[0, 1, ::2] = 0.0
    context = linked(points, views, targets, 0.5, other)
    squared = (np.asarray(flow_distances(points, views, targets, other), float) ** 2).sum(axis=-1)
    expected = 68 / COUNT * (targets.weights * 0.25 * np.log1p(squared / 0.25)).sum()
    assert float(np.sum(flow_residual(other, context) ** 2)) == pytest.approx(expected, rel=1e-5)
    assert np.abs(flow_residual(truth, context)).max() == 0.0


def test_the_terms_residual_changes_as_finite_differences_say(head, points):
    start, views = state(head, 0.3, jaw=np.full(6, 0.01)), two_views()
    targets = targets_of(points, views, state(head, 0.5), sides=1)
    targets.places[0, 0, 3] = np.asarray(points_in_views(points, views, start)[0])[0, 3]  # its distance is 0
    context = linked(points, views, targets, 1.0, start)
    residual = jax.jit(lambda vector: flow_residual(unpack(vector, start), context))
    vector = pack(start)
    jacobian = np.asarray(jax.jit(jax.jacfwd(residual))(vector))
    assert np.isfinite(jacobian).all()
    jaw = 6 + head.expression_names.index("jawOpen")
    steps = {0: 1e-3, 2: 1e-3, 4: 0.05, 5: 0.1, jaw: 1e-2, len(vector) - 7: 1e-3, len(vector) - 1: 1e-3}
    for column, size in steps.items():
        step = np.zeros(len(vector))
        step[column] = size
        numeric = np.asarray(residual(vector + step) - residual(vector - step)) / (2 * size)
        assert np.abs(jacobian[:, column] - numeric).max() < 0.01 * np.abs(numeric).max(), column


def test_robust_factors_are_those_of_cauchy(head, points):
    missed = np.random.default_rng(0).normal(size=(2, 1, 5, 2))
    factors = np.asarray(robust_scales(missed, 2.0))
    assert factors**2 == pytest.approx(1.0 / (1.0 + (missed**2).sum(-1) / 4.0))
    assert np.asarray(robust_scales(missed, np.inf)) == pytest.approx(1.0)


@pytest.mark.parametrize("views", [one_view, two_views], ids=["one camera", "two cameras"])
def test_pose_and_weights_are_found_from_exact_flow(head, points, views):
    views, truth, start = views(), state(head, 0.45), state(head, 0.1, (0.12, -0.15, 0.0), (14.0, -2.0, 608.0))
    found = solve_flow(points, views, targets_of(points, views, truth), weights(), start, start, limits(start))
    assert np.asarray(found.parameters.rotation) == pytest.approx(truth.rotation, abs=2e-3)
    assert np.asarray(found.parameters.translation) == pytest.approx(truth.translation, abs=1.0)
    jaw = head.expression_names.index("jawOpen")
    assert float(found.parameters.expression[jaw]) == pytest.approx(0.45, abs=0.05)
    assert float(found.missed) < 0.02


def test_what_is_not_free_stays(head, points):
    truth, start, views = state(head, 0.5), state(head, 0.1), one_view()
    free = np.zeros(len(pack(start, MOVING)), bool)
    free[:6] = True
    found = solve_flow(points, views, targets_of(points, views, truth), weights(), start, start, limits(start, free))
    assert np.array_equal(found.parameters.expression, start.expression)
    assert not np.array_equal(found.parameters.rotation, start.rotation)


def test_points_that_the_flow_lost_have_no_say(head, points):
    truth, start, views = state(head, 0.3), state(head, 0.3, (0.1, -0.18, 0.05)), one_view()
    targets = targets_of(points, views, truth)
    targets.places[:, :, ::3] += 500.0
    targets.weights[:, :, ::3] = 0.0
    found = solve_flow(points, views, targets, weights(), start, start, limits(start))
    assert np.asarray(found.parameters.rotation) == pytest.approx(truth.rotation, abs=2e-3)


def test_a_tenth_of_wrong_flow_is_outvoted(head, points):
    truth, start, views = state(head, 0.3), state(head, 0.3, (0.1, -0.18, 0.05)), one_view()
    targets = targets_of(points, views, truth)
    targets.places[:, :, ::10] += np.array([12.0, -9.0])
    errors = {}
    for robust in (np.inf, 1.0):
        given = weights(stay=1.0, robust=robust)
        found = solve_flow(points, views, targets, given, start, start, limits(start))
        errors[robust] = np.linalg.norm(np.asarray(found.parameters.rotation) - truth.rotation)
    assert errors[1.0] < 0.3 * errors[np.inf]


def test_what_the_estimator_says_beside_the_exact_flow_moves_the_answer(head, points):
    truth, views = state(head, 0.3), one_view()
    targets = targets_of(points, views, truth)
    biased = targets._replace(bias_px=np.full_like(targets.bias_px, 1.5))
    found = solve_flow(points, views, biased, weights(stay=1.0), truth, truth, limits(truth))
    places = np.asarray(points_in_views(points, views, found.parameters)[0])
    assert (places - targets.places[0]).mean(axis=(0, 1)) == pytest.approx([-1.5, -1.5], abs=0.05)


def test_weights_targets_and_limits_compile_nothing(head, points):
    truth, start, views = state(head, 0.3), state(head), one_view()
    solve_flow(points, views, targets_of(points, views, truth), weights(), start, start, limits(start))
    compiled = solve_flow._cache_size()
    changed = limits(start)._replace(iterations=np.asarray(3), tolerance=np.asarray(0.1))
    solve_flow(points, views, targets_of(points, views, start), weights(2.0, 5.0, 1.0, 0.3), truth, start, changed)
    assert solve_flow._cache_size() == compiled


def test_points_lie_on_the_face_and_densest_about_eyes_and_mouth(head):
    triangle, barycentric = choose_surface(head, 600)
    assert barycentric.sum(axis=1) == pytest.approx(1.0)
    assert (barycentric >= 0.0).all()
    again = choose_surface(head, 600)
    assert np.array_equal(again[0], triangle)
    assert np.array_equal(again[1], barycentric)
    inside = np.concatenate([head.regions[name] for name in ("teethU", "teethL", "tongue", "mouth_cavity", "eyeL")])
    assert not np.isin(head.triangles[triangle], inside).any()
    places = np.einsum("nk,nkd->nd", barycentric, head.neutral[head.triangles[triangle]])
    landmarks = head.landmarks.of(head.neutral)
    near = np.linalg.norm(places[:, None] - landmarks[None, 36:], axis=2).min(axis=1) < 12.0
    assert 0.4 < near.mean() < 0.9
    assert places[:, 1].min() > landmarks[:, 1].min() - 31.0


def test_too_few_points_are_refused(head):
    with pytest.raises(InputError, match="16 surface points or more, got 8"):
        choose_surface(head, 8)
