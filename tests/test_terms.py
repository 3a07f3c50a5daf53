"""One table of terms for both systems: from a row follow configuration, slider, chart and effect; any term works in any
system and stage."""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.deep_scenes import POINTS, make_deep_scene, make_parameters
from tests.scenes import make_scene
from workbench.config import Config, Stage, config_toml, preset
from workbench.energies import TABLE, project_landmarks
from workbench.energies.terms import table_page
from workbench.errors import ConfigError, InputError
from workbench.face import contour_blend, landmark_model, model_landmarks
from workbench.pipeline import track
from workbench.planning import plan_of
from workbench.session.knobs import KNOBS, inert_among
from workbench.tracker import FaceTracker
from workbench.tracking import FrameContext
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.face_it_fitter import FaceItFitter

ROOT = Path(__file__).resolve().parent.parent
STEADY = Stage(name="pose", free=("rotation", "translation"), limit=20)
LANDMARKS_ALONE = {"tau": 0.0, "beta": 0.0, "sigma": 0.0, "sigma_smooth": 0.0, "range": 0.0}


def linked(config: Config, tau: float) -> Config:
    """A Deep Energies configuration whose only stage links frames."""
    stage = STEADY.model_copy(update={"terms": ("tau",)})
    return config.changed(stages=[stage.model_dump()], weights={"tau": tau})


def nodding(head, fitter: DeepFitter, count: int, noise_px: float):
    """Observations of a head that turns evenly, as a detector with this noise reports them."""
    for k in range(count):
        scene = make_deep_scene(fitter, make_parameters(head, (2.0 * k, -k, 0.0)))
        observation = scene.observation(k)
        landmarks = observation.landmarks
        noisy = landmarks.points + np.random.default_rng(k).normal(0.0, noise_px, (68, 2))
        yield replace(observation, landmarks=replace(landmarks, points=noisy))


# Every term in every system.


def test_lambda_in_face_it_is_a_ridge_fit(head):
    """With the pose held and no other term, E_fit + λ‖w‖² is what SciPy finds for the same residuals."""
    scene = make_scene(head, weights={"jawOpen": 0.5, "mouthSmileLeft": 0.4, "browInnerUp": 0.6})
    stage = Stage(name="ridge", free=("expression",), terms=("regularisation",), limit=100)
    config = preset("face-it").changed(
        stages=[stage.model_dump()],
        weights=LANDMARKS_ALONE,
        deep={"regularisation": 3.0},
        solver={"tolerance": 1e-14},
        camera={"fov_deg": 45.0},
    )
    observation = scene.observation(noise_px=1.0)
    fitter = FaceItFitter(head, plan_of(config))
    start = scene.parameters._replace(expression=np.zeros(44), identity=np.zeros(0))
    fit, _ = fitter.fit(observation, FrameContext(0, np.zeros(50), start, None))

    model = landmark_model(head)
    seen = np.asarray(model.expression_upper > model.expression_lower)
    points = model_landmarks(model, contour_blend(model.contour_yaw, 0.0, 0.0), np.zeros(50))

    @jax.jit
    def projected(expression):
        return project_landmarks(
            scene.camera, points, scene.parameters._replace(expression=expression, identity=np.zeros(50))
        )

    def residual(weights):
        expression = np.zeros(44)
        expression[seen] = weights
        error = np.asarray(projected(expression)) - observation.landmarks.points
        return np.concatenate([error.ravel(), np.sqrt(3.0) * weights])

    ridge = least_squares(residual, np.zeros(int(seen.sum())), xtol=1e-12, ftol=1e-14, gtol=1e-12).x
    np.testing.assert_allclose(fit.expression[seen], ridge, atol=2e-5)
    assert np.abs(ridge).max() > 0.1


def test_the_edge_term_changes_a_fit_of_face_it_and_shows_in_its_energies(head):
    observation = make_scene(head, (10.0, 0.0, 0.0), {"jawOpen": 0.5}).observation(noise_px=2.0)
    context = FrameContext(0, np.zeros(50), None, None)
    stages = [stage.model_dump() | {"terms": ("edges",)} for stage in preset("joint").stages]
    plain = FaceItFitter(head, plan_of(preset("joint"))).fit(observation, context)[0]
    config = preset("joint").changed(stages=stages, deep={"edges": 5.0})
    edged = FaceItFitter(head, plan_of(config)).fit(observation, context)[0]
    column = config.terms.index("edges")
    assert edged.energies[-1, column] > 0.0
    assert np.abs(edged.expression - plain.expression).max() > 1e-3
    errors = [np.diff(fit.projected - fit.observed, axis=0) for fit in (plain, edged)]
    assert (errors[1] ** 2).sum() < (errors[0] ** 2).sum()


def test_e_tau_steadies_a_clip_of_deep_energies(head):
    fitter = DeepFitter(head, plan_of(POINTS))
    observations = list(nodding(head, fitter, 8, noise_px=3.0))
    jitter = []
    for tau in (0.0, 30.0):
        tracker = FaceTracker(head, linked(POINTS.changed(identity={"calibrate": False}), tau))
        poses = np.array([np.concatenate([100.0 * fit.rotation, fit.translation])
                          for fit in tracker.fit_all(observations)])  # fmt: skip
        jitter.append(float(np.linalg.norm(np.diff(poses, 2, axis=0), axis=1).mean()))
    assert jitter[1] < 0.5 * jitter[0]


@pytest.mark.long
def test_frames_that_a_term_links_are_not_spread_over_processes(head, tmp_path):
    clip, points = ROOT / "data_samples/performance.mp4", ROOT / "data_samples/performance_landmarks.csv"
    with pytest.raises(InputError, match="--workers 1"):
        track([clip], tmp_path, head, linked(POINTS, 1.0), landmarks=points, frames=(0, 3), workers=2)


@pytest.mark.long
def test_a_linked_run_that_is_cut_goes_on_with_the_same_numbers(head, tmp_path):
    clip, points = ROOT / "data_samples/performance.mp4", ROOT / "data_samples/performance_landmarks.csv"
    config, whole, cut = linked(POINTS, 1.0), tmp_path / "whole", tmp_path / "cut"
    options = {"landmarks": points, "frames": (0, 19), "pictures": False}
    track([clip], whole, head, config, **options)

    def stop(step, done, total):
        if step == "track" and done == 18:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track([clip], cut, head, config, progress=stop, **options)
    track([clip], cut, head, config, resume=True, **options)
    first, second = (np.load(folder / "track.npz") for folder in (whole, cut))
    for name in ("rotation", "translation", "expression", "energies"):
        np.testing.assert_array_equal(first[name], second[name])


@pytest.mark.parametrize("name", [name for name in TABLE if name not in ("landmarks", "identity")])
def test_a_stage_of_either_system_may_name_any_term(name):
    for system in ("joint", "deep"):
        stages = [stage.model_dump() for stage in preset(system).stages]
        stages[-1]["terms"] = (name,)
        config = preset(system).changed(stages=stages)
        assert name in config.terms
        assert config.factors(config.stages[-1])[config.terms.index(name)] == config.omega()[
            TABLE[name].omega_key(config.system)
        ] * (config.weights.prior if TABLE[name].branch else 1.0)


def test_a_term_that_does_not_exist_is_named_with_those_that_do():
    stages = [stage.model_dump() | {"terms": ("smoothness",)} for stage in preset("joint").stages]
    with pytest.raises(ConfigError, match="'edges'"):
        preset("joint").changed(stages=stages)


# What follows from a row.


def test_the_constants_of_a_term_that_a_disabled_stage_alone_names_have_no_effect():
    joint = preset("joint").changed(deep={"edges": 1.0})
    stages = [stage.model_dump() for stage in joint.stages]
    more = stages[-1] | {"name": "edges", "terms": ("edges",)}
    on, off = (joint.changed(stages=[*stages, more | {"enabled": enabled}]) for enabled in (True, False))
    assert [inert_among(config, ["constants.weighted_edges"]) != set() for config in (on, off)] == [False, True]


def test_the_slider_of_a_term_is_grey_until_a_stage_names_it():
    asked = ("deep.edges", "deep.lambda_reading", "weights.tau", "constants.rotation_mm", "constants.a")
    assert {"deep.edges", "deep.lambda_reading"} <= inert_among(preset("joint"), asked)
    assert "deep.lambda_reading" in inert_among(preset("orthographic"), asked)
    assert "weights.tau" in inert_among(preset("deep"), asked)
    assert "deep.lambda_reading" not in inert_among(preset("deep"), asked)
    assert not {"weights.tau", "constants.rotation_mm"} & inert_among(linked(POINTS, 1.0), asked)
    assert "constants.a" in inert_among(POINTS, asked)
    assert inert_among(preset("deep"), ()) == frozenset()


def test_every_term_with_a_weight_of_its_own_has_a_slider_and_a_comment():
    paths, text = {knob.path for knob in KNOBS}, config_toml(preset("joint"))
    for name, term in TABLE.items():
        if name != "landmarks":
            assert term.omega_key("face-it") in paths
            assert term.says in text


def test_the_page_of_the_documentation_is_that_of_the_table():
    assert (ROOT / "docs" / "terms.md").read_text(encoding="utf-8") == table_page()
