"""Blendshapes that move none of the 68 landmarks (the tongue) stay at 0 in every fit."""

from dataclasses import replace

import numpy as np
import pytest

from tests.deep_scenes import POINTS, make_deep_scene, make_parameters
from tests.films import film_config
from tests.scenes import make_scene
from workbench.config import FACE_IT_PRESETS, PRESETS, Stage, preset
from workbench.face import FaceParameters, free_parameters, landmark_model, load_default_head, seen_shapes
from workbench.landmarks.files import read_landmark_file
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracker import FaceTracker
from workbench.tracking import FaceItFitter, FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.flow_fitter import FlowFitter

TALKING = {"jawOpen": 0.6, "mouthSmileLeft": 0.4, "browInnerUp": 0.3}


@pytest.fixture(scope="module")
def tongue(head):
    return head.expression_names.index("tongueOut")


def unseen_names(model):
    return [name for name, seen in zip(model.expression_names, seen_shapes(model), strict=True) if not seen]


def with_tongue_out(head):
    """Parameters that something else than a fit has made, the tongue out."""
    expression = np.zeros(len(head.expression_names))
    expression[head.expression_names.index("tongueOut")] = 0.7
    return FaceParameters(np.zeros(3), np.array([0.0, 0.0, 600.0]), expression, np.zeros(0))


# Which ones.


@pytest.mark.parametrize("gaze", [False, True])
def test_the_tongue_is_the_only_shape_of_the_default_head_that_no_landmark_sees(gaze):
    assert unseen_names(load_default_head(gaze=gaze)) == ["tongueOut"]


def test_the_next_shapes_move_landmarks_by_many_times_the_threshold(head):
    model = landmark_model(head)
    moved = np.linalg.norm(np.concatenate([model.inner_expression, model.contour_expression[0]], axis=1), axis=2)
    assert np.sort(moved.max(axis=1))[:2] == pytest.approx([0.0, 3.54], abs=0.01)


def test_what_counts_is_the_largest_weight(head):
    """A statistical component's weight goes to 3 deviations: one of 0.05 mm moves landmarks by 0.15 mm."""
    faint = head.expression_deltas / 100.0
    ranges = np.tile([-3.0, 3.0], (len(faint), 1))
    assert "eyeSquintLeft" in unseen_names(replace(head, expression_deltas=faint))
    assert unseen_names(replace(head, expression_deltas=faint, expression_range=ranges)) == ["tongueOut"]


def test_a_shape_that_only_a_turned_heads_contour_shows_is_seen(head):
    only = np.zeros_like(head.expression_deltas)
    frontal = set(head.landmarks.vertices.ravel())
    vertex = next(k for k in head.contour.vertices.ravel() if k not in frontal)
    only[0, vertex] = 5.0
    assert seen_shapes(replace(head, expression_deltas=only)).tolist() == [True] + [False] * (len(only) - 1)


# Fits from landmarks.


@pytest.mark.parametrize("name", FACE_IT_PRESETS)
def test_the_tongue_stays_in_on_the_sample_clip(head, tongue, name):
    records = list(read_landmark_file(sample("performance-landmarks")))[::4]
    observations = (FrameObservation(k, record.landmarks, record.image_size) for k, record in enumerate(records))
    fits = [fit for fit in FaceTracker(head, preset(name)).fit_all(observations) if fit.found]
    assert len(fits) > 50
    assert all(fit.expression[tongue] == 0.0 for fit in fits)
    assert all(np.abs(fit.expression).max() > 0.01 for fit in fits)


@pytest.mark.parametrize("method", ["lm", "optimistix-lm", "optimistix-dogleg"])
def test_every_method_holds_it_whatever_the_fit_starts_from(head, tongue, method):
    config = preset("face-it").changed(solver={"method": method}, weights={"beta": 0.0, "sigma": 0.01})
    context = FrameContext(0, np.zeros(50), with_tongue_out(head), None)
    fit, handed_on = FaceItFitter(head, plan_of(config)).fit(make_scene(head, weights=TALKING).observation(), context)
    assert fit.expression[tongue] == 0.0
    assert handed_on.parameters.expression[tongue] == 0.0
    assert fit.expression[head.expression_names.index("jawOpen")] > 0.3


def test_calibration_holds_it_too(head, tongue):
    observations = [make_scene(head, (yaw, 0, 0), TALKING).observation(k) for k, yaw in enumerate((-20, 0, 20))]
    found = FaceItFitter(head, plan_of(preset("calibrated"))).calibrate(observations, 12)
    assert all(start.expression[tongue] == 0.0 for start in found.starts.values())


# Renders and flow.


@pytest.mark.filterwarnings("ignore:The stages free first")
@pytest.mark.parametrize("name", [name for name in PRESETS if name not in FACE_IT_PRESETS])
def test_deep_energies_frees_it_in_no_stage(head, tongue, name):
    config = preset(name)
    everything = Stage(name="all of it", free=("rotation", "translation", "expression"))
    named = Stage(name="tongue", free=("expression",), shapes=("tongue", "mouth"))
    plan = plan_of(config.model_copy(update={"stages": (*config.stages, named, everything)}))
    fitter = DeepFitter(head, plan)
    for stage in plan.stages:
        assert not fitter.free(stage)[6 + tongue], stage.name
    assert fitter.free(plan.stages[-1])[6:][: len(head.expression_names)].sum() == len(head.expression_names) - 1


def test_names_choose_blendshapes_and_numbers_components_of_the_identity_too(head):
    both = ("expression", "identity")
    named = free_parameters(head, both, ("jaw",), stage="shape")
    assert [name for name, free in zip(head.expression_names, named.expression, strict=True) if free] == [
        name for name in head.expression_names if name.startswith("jaw")
    ]
    assert named.identity.all()
    first = free_parameters(head, both, ("jaw", "first:3"), stage="shape")
    assert np.flatnonzero(first.identity).tolist() == [0, 1, 2]


def test_deep_energies_starts_with_the_tongue_in(head, tongue):
    everything = (Stage(name="all of it", free=("rotation", "translation", "expression"), limit=3),)
    fitter = DeepFitter(head, plan_of(POINTS.model_copy(update={"stages": everything})))
    scene = make_deep_scene(fitter, make_parameters(head, weights=TALKING))
    fit, _ = fitter.fit(scene.observation(), scene.context()._replace(start=with_tongue_out(head)))
    assert fit.expression[tongue] == 0.0
    assert np.abs(fit.expression).max() > 0.05


def test_flow_moves_everything_but_it(head, tongue):
    free = FlowFitter(head, plan_of(film_config())).free[6 : 6 + len(head.expression_names)]
    assert np.flatnonzero(~free).tolist() == [tongue]
