"""A statistical basis of a head's own expressions, and Appendix C.2 on it."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from tests.deep_scenes import IMAGE_SIZE
from workbench.config import Stage, preset
from workbench.errors import ModelError
from workbench.face import FaceModel, keeps_the_mouth_shut, principal_expressions
from workbench.face.principal import random_expressions
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov, project, rotation_matrix
from workbench.landmarks.observations import Landmarks2D
from workbench.pipeline.deep_run import FrameWork
from workbench.planning import plan_of
from workbench.tracking import FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter

FRAMES = 12
TELEPHOTO_DEG, AWAY_MM = 20.0, 1500.0


@pytest.fixture(scope="module")
def principal(head):
    return principal_expressions(head)


def lips_apart(model: FaceModel, vertices) -> float:
    """Distance of the inner lips' middles as a share of the outer-eye distance."""
    points = model.landmarks.of(vertices)
    return float(np.linalg.norm(points[66] - points[62]) / np.linalg.norm(points[36] - points[45]))


# The basis.


def test_components_are_sorted_orthogonal_and_of_the_neutral_face(principal, head):
    flat = principal.expression_deltas.reshape(10, -1)
    sizes = np.linalg.norm(flat, axis=1)
    assert (np.diff(sizes) < 0.0).all()
    np.testing.assert_allclose(flat @ flat.T / np.outer(sizes, sizes), np.eye(10), atol=1e-9)
    np.testing.assert_array_equal(principal.vertices(np.zeros(10)), head.neutral)


def test_the_largest_motion_of_a_component_goes_down(principal):
    along_y = principal.expression_deltas[..., 1]
    assert (along_y.max(axis=1) > -along_y.min(axis=1)).all()


def test_a_component_that_moves_sideways_alone_is_kept(head):
    sideways = head.expression_deltas * [1.0, 0.0, 0.0]
    made = principal_expressions(replace(head, expression_deltas=sideways), 3)
    assert np.abs(made.expression_deltas).max(axis=(1, 2)).min() > 0.1


def test_jaw_and_mouth_go_to_one_side_at_a_time(head):
    names = head.expression_names
    weights = random_expressions(names, 200, np.random.default_rng(0))
    for left, right in (("jawLeft", "jawRight"), ("mouthLeft", "mouthRight")):
        pair = weights[:, [names.index(left), names.index(right)]]
        assert pair.min(axis=1).max() == 0.0
        assert ((pair > 0.0).sum(axis=0) > 10).all()


def test_a_components_weight_varies_by_one_over_the_faces(principal, head):
    weights = random_expressions(head.expression_names, 2000, np.random.default_rng(0))
    faces = np.tensordot(weights, head.expression_deltas, axes=1).reshape(2000, -1)
    flat = principal.expression_deltas.reshape(10, -1)
    coefficients = faces @ flat.T / (flat**2).sum(axis=1)
    np.testing.assert_allclose((coefficients**2).mean(axis=0), 1.0, atol=1e-6)


def test_ten_components_hold_most_of_other_faces_and_ten_blendshapes_do_not(principal, head):
    weights = random_expressions(head.expression_names, 100, np.random.default_rng(1))
    faces = np.tensordot(weights, head.expression_deltas, axes=1).reshape(100, -1).T

    def left(deltas):
        basis = deltas.reshape(len(deltas), -1).T
        return np.linalg.norm(faces - basis @ np.linalg.lstsq(basis, faces, rcond=None)[0]) / np.linalg.norm(faces)

    assert left(principal.expression_deltas) < 0.25
    assert left(head.expression_deltas[:10]) > 0.8


def test_the_same_seed_makes_the_same_basis(principal, head):
    again = principal_expressions(head)
    np.testing.assert_array_equal(again.expression_deltas, principal.expression_deltas)


@pytest.mark.parametrize("count", [0, 45])
def test_more_components_than_blendshapes_are_refused(head, count):
    with pytest.raises(ModelError, match=f"has 44 blendshapes, so {count} components cannot be made"):
        principal_expressions(head, count)


def test_too_few_faces_and_statistical_bases_are_refused(principal, head):
    with pytest.raises(ModelError, match="44 blendshapes need as many random faces or more, got 43"):
        principal_expressions(head, faces=43)
    with pytest.raises(ModelError, match="do not run from 0 to 1; it has a statistical basis already"):
        principal_expressions(principal)


# The mouth.


def dumped(name):
    return [stage.model_dump() for stage in preset(name).stages]


def test_the_first_blendshapes_of_the_default_head_keep_the_mouth_shut(principal, head):
    assert keeps_the_mouth_shut(head, ("first:10",))
    assert not keeps_the_mouth_shut(principal, ("first:10",))
    assert not keeps_the_mouth_shut(head, ("jawOpen",))


@pytest.mark.parametrize("name", ["orthographic", "deep-parallel"])
def test_first_components_that_open_no_mouth_are_warned_of(principal, head, name):
    with pytest.warns(UserWarning, match="stages free first:10 of default-head, none of which parts the lips"):
        DeepFitter(head, plan_of(preset(name)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        FrameWork(head, plan_of(preset(name)))._fitter  # noqa: B018 (a worker's own: the command has warned)
        DeepFitter(principal, plan_of(preset(name)))
        DeepFitter(head, plan_of(preset("deep")))
        opening = Stage(name="jaw", free=("expression",), shapes=("jawOpen",))
        DeepFitter(head, plan_of(preset(name).changed(stages=[*dumped(name), opening.model_dump()])))


@pytest.mark.slow
def test_ten_and_ten_components_open_the_mouth_as_far_as_it_is(principal, head):
    """Appendix C.2 on points of other people with open and closed mouths, seen from afar."""
    camera, rng = camera_from_fov(IMAGE_SIZE, TELEPHOTO_DEG), np.random.default_rng(4)
    config = preset("deep-parallel").changed(
        camera={"fov_deg": TELEPHOTO_DEG}, deep={"energy": "points", "distance_mm": AWAY_MM}
    )
    fitter = DeepFitter(principal, plan_of(config))
    names = head.expression_names
    for k in range(FRAMES):
        opened = 0.0 if k % 3 == 0 else rng.uniform(0.3, 0.9)
        expression, identity = np.zeros(len(names)), np.zeros(len(head.identity_deltas))
        expression[names.index("jawOpen")] = opened
        for name in ("mouthSmileLeft", "mouthSmileRight", "browInnerUp", "mouthPucker"):
            expression[names.index(name)] = rng.uniform(0.0, 0.4) * (rng.random() < 0.6)
        identity[:5] = rng.normal(0.0, 0.7, 5)
        person = head.personal(identity)
        vertices = person.vertices(expression)
        turn = np.asarray(rotation_matrix(axis_angle_from_yaw_pitch_roll(rng.uniform(-12.0, 12.0, 3))))
        points = project(camera, person.landmarks.of(vertices) @ turn.T + np.array([5.0, -4.0, AWAY_MM]))
        observation = FrameObservation(k, Landmarks2D(np.asarray(points), np.ones(68), IMAGE_SIZE), IMAGE_SIZE)
        fit, _ = fitter.fit(observation, FrameContext(0, fitter.mean_identity(), None, None))
        fitted = principal.personal(np.asarray(fit.identity))
        found, truth = lips_apart(fitted, fitted.vertices(fit.expression)), lips_apart(person, vertices)
        if opened:
            assert found == pytest.approx(truth, rel=0.2)
        else:
            assert abs(found - truth) < 0.04
