"""How well landmarks fix pose and weights: the covariance against noisy re-fits, bounds, condition, vertices."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import FOV_DEG, make_scene
from workbench.config import preset
from workbench.diagnosis import estimate_uncertainty, vertex_uncertainty
from workbench.diagnosis.reference import JOINT_STAGES
from workbench.diagnosis.uncertainty import correlated_pairs, inverse_on, linearise
from workbench.errors import InputError
from workbench.face.principal import principal_expressions
from workbench.planning import plan_of
from workbench.tracking import FaceItFitter, FrameContext

SHAPES = ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "browInnerUp", "eyeBlinkLeft", "mouthPucker")
TRUTH = dict.fromkeys(SHAPES, 0.5)
NOISE_PX = 0.4
CONFIG = preset("joint").changed(
    camera={"fov_deg": FOV_DEG},
    weights={"sigma_smooth": 0.0},
    solver={"tolerance": 1e-12, "bounded": False},
    contour={"mode": "fixed"},
    stages=[stage.model_dump() for stage in JOINT_STAGES],
)
"""No prior and no bound: least squares, whose scatter theory knows."""


@pytest.fixture(scope="module")
def small(head):
    return head.with_expressions(SHAPES)


@pytest.fixture(scope="module")
def scene(small):
    return make_scene(small, angles_deg=(12.0, -6.0, 4.0), weights=TRUTH)


def context(model, config=CONFIG):
    return FrameContext(0, FaceItFitter(model, plan_of(config)).mean_identity(), None, None)


@pytest.fixture(scope="module")
def refits(small, scene):
    """The unknowns of 300 fits, each with its own landmark noise."""
    fitter, rows = FaceItFitter(small, plan_of(CONFIG)), []
    for seed in range(300):
        fit, _ = fitter.fit(scene.observation(noise_px=NOISE_PX, seed=seed), context(small))
        rows.append(np.concatenate([fit.rotation, fit.translation, fit.expression]))
    return np.array(rows)


@pytest.mark.long
def test_the_scatter_of_weighted_landmarks_is_that_of_noisy_refits(small, scene):
    """Weights that do not mirror the noise: the fit is no longer the best one, and theory must say by how much."""
    weighted = CONFIG.changed(landmarks={"weights": {"jaw": 0.1, "mouth": 3.0}})
    fitter, rows = FaceItFitter(small, plan_of(weighted)), []
    for seed in range(300):
        fit, _ = fitter.fit(scene.observation(noise_px=NOISE_PX, seed=seed), context(small, weighted))
        rows.append(np.concatenate([fit.rotation, fit.translation, fit.expression]))
    found = estimate_uncertainty(small, weighted, context(small, weighted), fit)
    np.testing.assert_allclose(np.sqrt(np.diagonal(found.scatter)), np.std(rows, axis=0), rtol=0.25)


@pytest.mark.long
def test_the_covariance_is_the_scatter_of_noisy_refits(small, scene, refits):
    fit, _ = FaceItFitter(small, plan_of(CONFIG)).fit(scene.observation(noise_px=NOISE_PX, seed=1000), context(small))
    found = estimate_uncertainty(small, CONFIG, context(small), fit)
    theory, measured = np.sqrt(np.diagonal(found.covariance)), refits.std(axis=0)
    # The noise is estimated from one frame of 136 coordinates (6 %), the scatter from 300 fits (4 %).
    np.testing.assert_allclose(theory, measured, rtol=0.25)
    np.testing.assert_allclose(found.scatter, found.covariance, atol=1e-9)
    correlation = np.corrcoef(refits.T)
    scale = np.outer(theory, theory)
    np.testing.assert_allclose(found.covariance / scale, correlation, atol=0.2)


def test_the_noise_is_found_in_the_residual(small, scene):
    noise = []
    for seed in range(20):
        fit, _ = FaceItFitter(small, plan_of(CONFIG)).fit(
            scene.observation(noise_px=NOISE_PX, seed=seed), context(small)
        )
        problem = linearise(small, CONFIG, context(small), fit)
        unit_px = np.linalg.norm(fit.projected - fit.observed) / np.linalg.norm(problem.residual)
        noise.append(estimate_uncertainty(small, CONFIG, context(small), fit).noise_percent * unit_px)
    assert np.mean(noise) == pytest.approx(NOISE_PX, rel=0.06)


def test_priors_make_refits_scatter_less_than_the_weights_are_uncertain(small, scene):
    config = CONFIG.changed(weights={"sigma_smooth": 20.0})
    fit, _ = FaceItFitter(small, plan_of(config)).fit(scene.observation(noise_px=NOISE_PX), context(small, config))
    found = estimate_uncertainty(small, config, context(small, config), fit)
    assert np.linalg.eigvalsh(found.covariance - found.scatter).min() > -1e-9
    assert (np.diagonal(found.scatter) < np.diagonal(found.covariance) + 1e-12).all()


def test_the_condition_number_is_that_of_the_scaled_matrix(small, scene):
    fit, _ = FaceItFitter(small, plan_of(CONFIG)).fit(scene.observation(noise_px=NOISE_PX), context(small))
    matrix = linearise(small, CONFIG, context(small), fit).matrix
    scale = np.array([0.1] * 3 + [10.0] * 3 + [0.3] * len(SHAPES))
    expected = np.linalg.cond(matrix * scale[:, None] * scale[None, :])
    found = estimate_uncertainty(small, CONFIG, context(small), fit)
    assert found.condition == pytest.approx(expected, rel=1e-6)


def test_the_matrix_is_that_of_finite_differences(small, scene):
    fit, _ = FaceItFitter(small, plan_of(CONFIG)).fit(scene.observation(noise_px=NOISE_PX), context(small))
    problem = linearise(small, CONFIG, context(small), fit)
    step, column = 1e-5, 6 + SHAPES.index("jawOpen")
    moved = fit.expression.copy()
    moved[0] += step
    there = linearise(small, CONFIG, context(small), replace(fit, expression=moved))
    np.testing.assert_allclose((there.residual - problem.residual) / step, problem.jacobian[:, column], atol=1e-3)


def test_weights_that_rest_on_a_bound_have_no_deviation(head):
    config = preset("joint").changed(camera={"fov_deg": FOV_DEG})
    scene = make_scene(head, weights={"jawOpen": 0.6}, sliding=True)
    fit, _ = FaceItFitter(head, plan_of(config)).fit(scene.observation(noise_px=NOISE_PX), context(head, config))
    found = estimate_uncertainty(head, config, context(head, config), fit)
    opened = head.expression_names.index("jawOpen")
    assert not found.on_bound[opened]
    assert found.weights[opened] > 0.0
    assert found.on_bound.sum() > 10
    assert (found.weights[found.on_bound] == 0.0).all()
    assert (fit.expression[found.on_bound] < 1e-9).all()


def test_unseen_weights_are_as_uncertain_as_their_range(head):
    config = preset("joint").changed(camera={"fov_deg": FOV_DEG}, weights={"sigma_smooth": 0.0})
    scene = make_scene(head, weights={"tongueOut": 0.0}, sliding=True)
    fit, _ = FaceItFitter(head, plan_of(config)).fit(scene.observation(noise_px=NOISE_PX), context(head, config))
    middle = fit.expression.copy()
    tongue = head.expression_names.index("tongueOut")
    middle[tongue] = 0.5
    found = estimate_uncertainty(head, config, context(head, config), replace(fit, expression=middle))
    assert found.weights[tongue] == pytest.approx(0.5, rel=0.05)


def test_weights_of_components_have_the_bounds_of_their_model(head):
    """They run from −3 to 3: a negative weight is on no bound, and one beyond 1 does not press against any."""
    model = principal_expressions(head, 6)
    config = preset("joint").changed(camera={"fov_deg": FOV_DEG}, weights={"sigma_smooth": 0.0})
    for first, at_bound in ((-1.4, False), (-3.6, True)):
        scene = make_scene(model, weights={"expression_000": first, "expression_001": 1.3}, sliding=True)
        seen = scene.observation(noise_px=NOISE_PX)
        fit, _ = FaceItFitter(model, plan_of(config)).fit(seen, context(model, config))
        found = estimate_uncertainty(model, config, context(model, config), fit)
        assert found.on_bound.tolist() == [at_bound, *[False] * 5]
        np.testing.assert_array_equal(found.weights > 0.0, ~found.on_bound)
    assert fit.expression[0] == -3.0


def test_correlated_unknowns_are_named_strongest_first():
    covariance = np.array([[4.0, 3.9, 0.1], [3.9, 4.0, -1.83], [0.1, -1.83, 1.0]])
    pairs = correlated_pairs(covariance, ("a", "b", "c"))
    assert [(first, second) for first, second, _ in pairs] == [("a", "b"), ("b", "c")]
    assert pairs[0][2] == pytest.approx(0.975)
    assert pairs[1][2] == pytest.approx(-0.915)


def test_what_nothing_fixes_keeps_its_typical_size():
    precision = np.diag([1e4] * 3 + [1.0] * 3 + [0.0])
    covariance, condition = inverse_on(precision, np.ones(7, bool))
    assert condition == np.inf
    assert covariance[0, 0] == pytest.approx(1e-4)
    assert np.sqrt(covariance[6, 6]) == pytest.approx(0.3)


def test_vertices_are_uncertain_where_uncertain_shapes_move_them(head):
    config = preset("joint").changed(camera={"fov_deg": FOV_DEG})
    scene = make_scene(head, weights={"jawOpen": 0.6}, sliding=True)
    fit, _ = FaceItFitter(head, plan_of(config)).fit(scene.observation(noise_px=NOISE_PX), context(head, config))
    found = estimate_uncertainty(head, config, context(head, config), fit)
    shape, place = (vertex_uncertainty(head, found, fit, pose=pose) for pose in (False, True))
    assert shape.shape == (len(head.neutral),)
    assert (shape >= 0.0).all()
    assert 0.01 < shape.max() < 20.0
    still = np.linalg.norm(head.expression_deltas, axis=2).max(axis=0) == 0.0
    assert (shape[still] == 0.0).all()
    # The depth of the head is the least known of all.
    assert np.median(place) > np.median(shape)
    assert found.translation_mm[2] > 3.0 * found.translation_mm[:2].max()


def test_a_frame_without_a_face_has_no_uncertainty(small, scene):
    fitter = FaceItFitter(small, plan_of(CONFIG))
    fit, _ = fitter.fit(replace(scene.observation(), landmarks=None), context(small))
    with pytest.raises(InputError, match="Frame 0 has no landmarks; choose"):
        estimate_uncertainty(small, CONFIG, context(small), fit)
