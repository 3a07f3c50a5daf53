"""FACE IT! on landmarks with known truth: pose, expression, identity, shots, and nothing compiled twice."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.pages import PAGES
from tests.scenes import FOV_DEG, IMAGE_SIZE, make_scene, random_expression
from workbench.config import PRESETS, Config, Stage, preset
from workbench.diagnosis.identifiability import indistinguishable_groups
from workbench.errors import ConfigError
from workbench.face import contour_blend, landmark_model, model_landmarks
from workbench.geometry import camera_from_fov
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.solvers import Status
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation
from workbench.tracking.frame_solver import run_stages, solve_frame
from workbench.tracking.identity import CalibrationSettings, identity_prior, spread_over_yaw

EXACT = Config(
    identity={"calibrate": False},
    contour={"mode": "fixed"},
    solver={"tolerance": 1e-14, "bounded": True},
    weights={"tau": 0.0, "sigma_smooth": 0.0},
    stages=(
        PRESETS["calibrated"].stages[0],
        Stage(name="both", free=("rotation", "translation", "expression"), limit=200),
    ),
)
POSES = [(0, 0, 0), (40, 0, 0), (-40, 20, 0), (25, -20, 10), (-15, 15, -20)]


@pytest.mark.parametrize("angles", POSES)
def test_exact_landmarks_give_the_pose_within_a_tenth_of_a_degree_and_explain_the_picture(head, angles):
    rng = np.random.default_rng(abs(hash(angles)) % 1000)
    scene = make_scene(head, angles, random_expression(head, rng))
    fit = FaceTracker(head, EXACT).push(scene.observation())[0]
    np.testing.assert_allclose(fit.angles_deg, angles, atol=0.1)
    assert fit.residuals_px.max() < 0.1


@pytest.fixture(scope="module")
def telling(head):
    """What a frontal view of the 68 landmarks tells about the weights."""
    frontal = make_scene(head).parameters
    model = landmark_model(head)
    points = model_landmarks(model, contour_blend(model.contour_yaw, 0.0, 0.0), frontal.identity)
    camera = camera_from_fov(IMAGE_SIZE, FOV_DEG)
    return indistinguishable_groups(points, camera, [frontal], head.expression_names)


@pytest.mark.parametrize("seed", range(10))
def test_weights_that_the_landmarks_can_tell_apart_are_recovered(seed, head, telling):
    """Any expression, also one with shapes from the indistinguishable groups, on a head turned anywhere."""
    rng = np.random.default_rng(seed)
    hidden = {name for group in (*telling.groups, telling.unseen) for name in group}
    clear = [name for name in head.expression_names if name not in hidden]
    truth = {str(name): float(rng.uniform(0.1, 0.9)) for name in rng.choice(clear, 6, replace=False)}
    angles = rng.uniform(-20, 20, 3)
    fit = FaceTracker(head, EXACT).push(make_scene(head, angles, truth).observation())[0]
    found = dict(zip(head.expression_names, fit.expression, strict=True))
    for name in clear:
        assert found[name] == pytest.approx(truth.get(name, 0.0), abs=0.05), name
    assert fit.residuals_px.max() < 0.1


def test_the_limits_name_the_indistinguishable_groups(telling):
    for group in (*telling.groups, telling.unseen):
        assert ", ".join(f"`{name}`" for name in group) in PAGES["docs/limits.md"]


def test_frames_for_the_identity_are_spread_over_yaw_and_one_alone_is_the_middle():
    yaws_deg = np.array([0.0, -60.0, 5.0, 2.0, 50.0])
    chosen = {count: spread_over_yaw(yaws_deg, count).tolist() for count in (1, 2, 3, 9)}
    assert chosen == {1: [3], 2: [1, 4], 3: [1, 3, 4], 9: [0, 1, 2, 3, 4]}


def test_a_calibrated_identity_is_shared_by_the_frames_and_explains_them(head):
    identity = np.random.default_rng(3).normal(0.0, 1.0, 50)
    scenes = [make_scene(head, (yaw, 5, 0), {"jawOpen": 0.3}, identity, sliding=True) for yaw in (-30, -15, 0, 15, 30)]
    tracker = FaceTracker(head, PRESETS["calibrated"])
    fits = list(tracker.fit_all(scene.observation(k) for k, scene in enumerate(scenes)))
    without = FaceTracker(head, PRESETS["calibrated"].changed(identity={"calibrate": False}))
    plain = list(without.fit_all(scene.observation(k) for k, scene in enumerate(scenes)))
    assert len({fit.identity.tobytes() for fit in fits}) == 1
    assert np.mean([fit.errors[1] for fit in fits]) < 0.5 * np.mean([fit.errors[1] for fit in plain])
    errors = np.abs([fit.angles_deg - scene.angles_deg for fit, scene in zip(fits, scenes, strict=True)])
    plain_errors = np.abs([fit.angles_deg - scene.angles_deg for fit, scene in zip(plain, scenes, strict=True)])
    assert errors.mean() < 0.5 * plain_errors.mean()


def growth_percent(head, identity):
    """How much larger an identity makes the frontal landmarks, by the similarity that lays the mean face's on them."""
    mean = landmark_model(head).frontal_neutral()
    points = landmark_model(head).personal(identity).frontal_neutral()
    mean, points = (each - each.mean(axis=0) for each in (mean, points))
    turn, _ = Rotation.align_vectors(points, mean)
    return 100.0 * ((turn.apply(mean) * points).sum() / (mean**2).sum() - 1.0)


def test_the_prior_of_the_size_is_the_squared_growth_of_the_landmarks(head):
    settings = CalibrationSettings(0.0, 1.0, 1.0, (1, 1), np.ones((2, 68)), 1.0)
    prior = np.asarray(identity_prior(landmark_model(head), settings))
    for identity in np.random.default_rng(4).normal(0.0, 0.3, (20, 50)):
        assert identity @ prior @ identity == pytest.approx(growth_percent(head, identity) ** 2, rel=0.02, abs=0.02)
    alone = identity_prior(landmark_model(head), settings._replace(identity=5.0, size=0.0))
    np.testing.assert_array_equal(alone, 5.0 * np.eye(50))


def test_proportions_of_another_size_do_not_become_the_heads_size_where_the_lens_is_known(head):
    child = np.zeros(50)
    child[0] = -4.0
    scenes = [make_scene(head, (yaw, 5, 0), identity=child) for yaw in (-30, -15, 0, 15, 30)]

    def growth(size, fov_deg=FOV_DEG + 0.01):
        config = PRESETS["calibrated"].changed(camera={"fov_deg": fov_deg}, identity={"size": size})
        fit = next(FaceTracker(head, config).fit_all(scene.observation(k) for k, scene in enumerate(scenes)))
        return growth_percent(head, fit.identity)

    free = growth(0.0)
    assert free < -10.0
    assert 0.2 * free < growth(30.0) < 0.0
    assert growth(30.0, FOV_DEG) == pytest.approx(free, abs=0.1)  # the default is a guess


def test_with_a_guessed_lens_the_size_is_free():
    guessed = Config()
    assert plan_of(guessed).identity.size == 0.0
    assert plan_of(guessed.changed(camera={"fov_deg": 30.0})).identity.size == guessed.identity.size > 0.0


def test_calibration_off_leaves_the_models_mean_face(head):
    scene = make_scene(head, (5, 0, 0))
    fit = FaceTracker(head, PRESETS["face-it"]).push(scene.observation())[0]
    np.testing.assert_array_equal(fit.identity, 0.0)


def test_bounds_keep_every_weight_in_range_where_landmarks_alone_do_not(head):
    scene = make_scene(head, (0, 0, 0), {"jawOpen": 1.0})
    exaggerated = scene.points.copy()
    exaggerated[54:60, 1] += 25.0
    landmarks = Landmarks2D(exaggerated, np.ones(68), IMAGE_SIZE)
    observation = FrameObservation(0, landmarks, IMAGE_SIZE)
    bounded = FaceTracker(head, PRESETS["calibrated"].changed(identity={"calibrate": False})).push(observation)[0]
    free = FaceTracker(head, PRESETS["face-it"].changed(weights={"beta": 0.0})).push(observation)[0]
    assert bounded.expression.min() >= 0.0
    assert bounded.expression.max() <= 1.0
    assert free.expression.min() < -0.01 or free.expression.max() > 1.01


def test_the_published_energy_keeps_weights_in_range_on_the_sample_clip(head):
    """E_β with a large ω is a fence: nearly every weight stays inside, at the price of a larger landmark error."""
    records = list(read_landmark_file(sample("performance-landmarks")))[:80]
    observations = [FrameObservation(k, each.landmarks, each.image_size) for k, each in enumerate(records)]
    found = {}
    for label, weights in (("fenced", {}), ("free", {"beta": 0.0, "sigma": 0.01})):
        config = PRESETS["face-it"].changed(camera={"fov_deg": 33.0}, weights=weights)
        found[label] = list(FaceTracker(head, config).fit_all(observations))
    outside = {
        label: np.mean([np.maximum(fit.expression - 1.0, -fit.expression) > 0.01 for fit in fits])
        for label, fits in found.items()
    }
    errors = {label: np.mean([fit.errors[2] for fit in fits]) for label, fits in found.items()}
    assert outside["fenced"] <= 0.05
    assert outside["free"] > 0.3
    assert errors["free"] < errors["fenced"] < 1.5 * errors["free"]


def test_a_frame_without_a_face_is_a_record_and_the_next_face_starts_afresh(head):
    scene = make_scene(head, (10, 0, 0))
    tracker = FaceTracker(head, EXACT)
    gap = FrameObservation(1, None, IMAGE_SIZE)
    fits = [fit for item in (scene.observation(0), gap, scene.observation(2)) for fit in tracker.push(item)]
    assert [fit.found for fit in fits] == [True, False, True]
    assert np.isnan(fits[1].rotation).all()
    assert np.isnan(fits[1].angles_deg).all()
    assert fits[1].source == "none"
    assert fits[2].status[0] >= 0  # the initial-pose stage ran again


def test_no_temporal_term_links_two_shots(head):
    config = EXACT.changed(weights={"tau": 1e6})
    first = [make_scene(head, (yaw, 0, 0)).observation(k) for k, yaw in enumerate((0, 5, 10))]
    after = make_scene(head, (-30, 0, 0))
    tracker = FaceTracker(head, config)
    fits = list(tracker.fit_all([*first, after.observation(3, cut=True)]))
    assert [fit.shot for fit in fits] == [0, 0, 0, 1]
    np.testing.assert_allclose(fits[3].angles_deg, (-30, 0, 0), atol=0.1)


def test_a_jump_of_the_landmarks_restarts_the_pose_without_a_cut(head):
    config = EXACT.changed(weights={"tau": 1e6})
    poses = [make_scene(head, (yaw, 0, 0)).observation(k) for k, yaw in enumerate((0, 1, 2))]
    elsewhere = make_scene(head, (-20, 0, 0), translation=(150.0, 40.0, 500.0)).observation(3)
    fits = list(FaceTracker(head, config).fit_all([*poses, elsewhere]))
    assert fits[3].shot == 0
    np.testing.assert_allclose(fits[3].angles_deg, (-20, 0, 0), atol=0.1)


def test_tau_damps_the_jitter_of_the_pose(head):
    def jitter(tau):
        config = PRESETS["face-it"].changed(weights={"tau": tau}, constants={"rotation_mm": 100.0})
        observations = (make_scene(head, (k, 0, 0)).observation(k, noise_px=1.0, seed=5) for k in range(20))
        angles = np.array([fit.angles_deg for fit in FaceTracker(head, config).fit_all(observations)])
        return np.abs(np.diff(angles, 2, axis=0)).mean()

    assert jitter(30.0) < 0.7 * jitter(0.0)


def test_a_weight_of_zero_takes_a_landmark_out(head):
    scene = make_scene(head, (10, 0, 0))
    spoiled = scene.points.copy()
    spoiled[17:27] += 80.0
    landmarks = Landmarks2D(spoiled, np.ones(68), IMAGE_SIZE)
    muted = Stage(
        name="both", free=("rotation", "translation", "expression"), landmarks={"all": 1.0, "brows": 0.0}, limit=200
    )
    config = EXACT.changed(stages=(EXACT.stages[0], muted))
    fit = FaceTracker(head, config).push(FrameObservation(0, landmarks, IMAGE_SIZE))[0]
    np.testing.assert_allclose(fit.angles_deg, (10, 0, 0), atol=0.1)


def test_confidence_zero_takes_a_landmark_out(head):
    scene = make_scene(head, (10, 0, 0))
    spoiled, confidence = scene.points.copy(), np.ones(68)
    spoiled[:10] += 80.0
    confidence[:10] = 0.0
    landmarks = Landmarks2D(spoiled, confidence, IMAGE_SIZE)
    fit = FaceTracker(head, EXACT).push(FrameObservation(0, landmarks, IMAGE_SIZE))[0]
    np.testing.assert_allclose(fit.angles_deg, (10, 0, 0), atol=0.1)


def test_without_confidences_all_points_that_were_found_count_alike(head):
    alike = EXACT.changed(landmarks={"confidence": False})
    scene = make_scene(head, (10, 0, 0), {"jawOpen": 0.4})
    observation, rng = scene.observation(), np.random.default_rng(3)
    noisy = observation.landmarks.points + rng.normal(0.0, 1.0, (68, 2))
    doubtful = rng.uniform(0.1, 1.0, 68)
    doubtful[30] = 0.0
    seen = np.where(doubtful > 0.0, 1.0, 0.0)
    fits = {
        name: FaceTracker(head, config).push(
            replace(observation, landmarks=Landmarks2D(noisy, confidence, IMAGE_SIZE))
        )[0]
        for name, config, confidence in (
            ("off", alike, doubtful),
            ("certain", EXACT, seen),
            ("on", EXACT, doubtful),
        )
    }
    np.testing.assert_array_equal(fits["off"].expression, fits["certain"].expression)
    assert np.abs(fits["off"].expression - fits["on"].expression).max() > 0.01


def test_the_sliding_contour_follows_the_yaw(head):
    scene = make_scene(head, (35, 0, 0), sliding=True)
    fixed = FaceTracker(head, EXACT).push(scene.observation())[0]
    sliding = FaceTracker(head, EXACT.changed(contour={"mode": "sliding"})).push(scene.observation())[0]
    assert sliding.errors[0] < 0.3 * fixed.errors[0]


def test_stills_do_not_know_each_other(head):
    scenes = [make_scene(head, (yaw, 0, 0)) for yaw in (-20, 30)]
    together = FaceTracker(head, PRESETS["calibrated"], stills=True)
    both = [fit for k, scene in enumerate(scenes) for fit in together.push(scene.observation(k))]
    alone = FaceTracker(head, PRESETS["calibrated"], stills=True).push(scenes[1].observation(1))[0]
    np.testing.assert_array_equal(both[1].expression, alone.expression)
    np.testing.assert_array_equal(both[1].rotation, alone.rotation)
    assert [fit.shot for fit in both] == [0, 1]


def test_a_restored_tracker_goes_on_with_the_same_numbers(head):
    observations = [make_scene(head, (2 * k, 0, 0), {"jawOpen": 0.05 * k}).observation(k, 0.5) for k in range(8)]
    config = PRESETS["calibrated"].changed(identity={"window": 4})
    whole = list(FaceTracker(head, config).fit_all(observations))
    first, second = FaceTracker(head, config), FaceTracker(head, config)
    for item in observations[:5]:
        first.push(item)
    second.restore(first.state())
    rest = [fit for item in observations[5:] for fit in second.push(item)]
    for expected, found in zip(whole[5:], rest, strict=True):
        np.testing.assert_array_equal(found.rotation, expected.rotation)
        np.testing.assert_array_equal(found.expression, expected.expression)
        np.testing.assert_array_equal(found.identity, expected.identity)


def test_moving_any_number_compiles_nothing(head):
    """50 random settings of ρ, ε, every ω, a, b, c, landmark weights, confidences, bounds, unit, contour, stages: their
    order, free parameters, and which run."""
    rng = np.random.default_rng(7)
    tracker = FaceTracker(head, PRESETS["calibrated"].changed(identity={"calibrate": False}))
    observations = [make_scene(head, (k, 0, 0)).observation(k) for k in range(3)]
    for item in observations:
        tracker.push(item)
    before = solve_frame._cache_size()
    for index in range(3, 53):
        stored = tracker.config.model_dump()
        stored["weights"] = {name: float(rng.uniform(0, 2)) for name in stored["weights"]}
        stored["constants"] = {name: float(rng.uniform(0.01, 2)) for name in stored["constants"]}
        stored["constants"]["weighted_edges"] = bool(rng.integers(2))
        stored["landmarks"]["confidence"] = bool(rng.integers(2))
        stored["solver"] = {
            "bounded": bool(rng.integers(2)),
            "tolerance": float(rng.uniform(0, 1e-3)),
            "unit": str(rng.choice(["px", "percent"])),
        }
        stored["contour"]["mode"] = str(rng.choice(["sliding", "fixed"]))
        for stage in stored["stages"]:
            stage["limit"] = int(rng.integers(1, 60))
            stage["landmarks"] = {"all": 1.0, "jaw": float(rng.uniform(0, 2)), "36": float(rng.uniform(0, 2))}
        order = rng.permutation(len(stored["stages"]))
        stored["stages"] = tuple(stored["stages"][k] for k in order)
        for stage in stored["stages"]:
            blocks = ("rotation", "translation", "expression")
            stage["free"] = tuple(str(name) for name in rng.choice(blocks, rng.integers(1, 4), replace=False))
            stage["enabled"] = stage["when"] == "always" or bool(rng.integers(2))
        stored["landmarks"]["weights"] = {"brows": float(rng.uniform(0, 2)), "8": 0.0}
        tracker.configure(Config.model_validate(stored))
        tracker.push(make_scene(head, (1, 0, 0)).observation(index))
    assert solve_frame._cache_size() == before


def test_many_frames_are_solved_in_one_program_like_one_by_one(head):
    """The stages are data of the host, and may be constants of a larger program."""
    tracker = FaceTracker(head, PRESETS["calibrated"].changed(identity={"calibrate": False}))
    scenes = [make_scene(head, (k, 0, 0), {"jawOpen": 0.1 * k}).observation(k) for k in range(4)]
    contexts = [context for seen in scenes for _, context in tracker.advance(seen)]
    pairs = zip(scenes, contexts, strict=True)
    problems = [tracker.fitter.problem(*pair) for pair in pairs if pair[1].last is not None]
    first, terms = problems[0], tracker.fitter.plan.terms

    def solve(frame):
        return run_stages(first.camera, first.person, first.settings, first.program, frame, terms=terms).report

    frames = jax.tree.map(lambda *leaves: np.stack(leaves), *(problem.frame for problem in problems))
    together = jax.jit(lambda frames: jax.lax.map(solve, frames))(frames)
    alone = [tracker.fitter.solve(problem).found.report for problem in problems]
    np.testing.assert_allclose(together, alone, rtol=1e-6, atol=1e-9)


def test_the_trace_shows_every_iteration_of_every_stage(head):
    tracker = FaceTracker(head, PRESETS["face-it"])
    observation = make_scene(head, (20, 5, 0), {"jawOpen": 0.5}).observation(0, 0.5)
    fit, traces = tracker.explain(observation)
    assert [trace.stage for trace in traces] == ["initial pose", "pose", "expression"]
    for trace, iterations in zip(traces, fit.iterations, strict=True):
        assert trace.energies.shape == (iterations + 1, 7)
        assert trace.residuals_px.shape == (iterations + 1, 68)
        assert (np.diff(trace.energies.sum(axis=1)) <= 1e-9).all()
    np.testing.assert_allclose(traces[-1].residuals_px[-1], fit.residuals_px, atol=1e-9)
    plain = tracker.push(observation)[0]
    np.testing.assert_allclose(plain.expression, fit.expression, atol=1e-9)


def test_explaining_a_still_starts_afresh_as_push_does(head):
    tracker = FaceTracker(head, PRESETS["calibrated"], stills=True)
    tracker.push(make_scene(head, (-20, 0, 0)).observation(0))
    still = make_scene(head, (30, 0, 0), translation=(80.0, 0.0, 500.0)).observation(1)
    explained, _ = tracker.explain(still)
    pushed = tracker.push(still)[0]
    np.testing.assert_allclose(explained.angles_deg, pushed.angles_deg, atol=1e-6)
    np.testing.assert_allclose(explained.expression, pushed.expression, atol=1e-6)


def test_explaining_a_cut_starts_afresh_as_push_does(head):
    tracker = FaceTracker(head, PRESETS["calibrated"].changed(identity={"window": 1, "frames": 1}))
    tracker.push(make_scene(head, (-20, 0, 0)).observation(0))
    after = replace(make_scene(head, (-18, 0, 0), {"jawOpen": 0.3}).observation(1), cut=True)
    explained, _ = tracker.explain(after)
    (pushed,) = tracker.push(after)
    assert (explained.shot, pushed.shot) == (1, 1)
    np.testing.assert_array_equal(explained.iterations > 0, pushed.iterations > 0)
    np.testing.assert_allclose(explained.identity, pushed.identity, atol=1e-6)
    np.testing.assert_allclose(explained.expression, pushed.expression, atol=1e-6)


def test_each_stage_has_its_own_row_on_every_frame(head):
    pose, expression = ("rotation", "translation"), ("expression",)
    stages = (
        Stage(name="pose", free=pose, limit=7),
        Stage(name="first expression", free=expression, when="start", limit=1),
        Stage(name="joint", free=(*pose, *expression), limit=2),
    )
    tracker = FaceTracker(head, EXACT.changed(stages=stages))
    scene = make_scene(head, (20, 5, 0), {"jawOpen": 0.5})
    first, later = (tracker.push(scene.observation(k, 1.0))[0] for k in range(2))
    assert (first.status > 0).all()
    assert (later.status > 0).tolist() == [True, False, True]
    assert later.iterations[1] == 0
    assert np.isnan(later.energies[1]).all()
    assert np.isfinite(later.energies[[0, 2]]).all()


def test_frames_held_back_follow_the_settings_of_their_fit(head):
    tracker = FaceTracker(head, PRESETS["calibrated"])
    assert not tracker.push(make_scene(head, (5, 0, 0)).observation(0))
    tracker.configure(tracker.config.changed(identity={"calibrate": False}))
    fits = tracker.push(make_scene(head, (6, 0, 0)).observation(1))
    assert [fit.index for fit in fits] == [0, 1]
    assert not any(fit.identity.any() for fit in fits)


def test_another_system_in_the_middle_of_a_shot_starts_afresh(head):
    stages = (Stage(name="pose", free=("rotation", "translation"), terms=("tau",), limit=5),)
    deep = preset("deep-points").changed(stages=stages, identity={"calibrate": False}, deep={"appearance": "model"})
    tracker, scene = FaceTracker(head, deep), make_scene(head, (10, 0, 0))
    tracker.push(scene.observation(0))
    tracker.configure(EXACT)
    (fit,) = tracker.push(scene.observation(1))
    np.testing.assert_allclose(fit.angles_deg, (10, 0, 0), atol=0.1)


def test_the_status_tells_a_limit_from_convergence(head):
    scene = make_scene(head, (20, 5, 0), {"jawOpen": 0.5})
    short = EXACT.changed(stages=(EXACT.stages[0], Stage(name="e", free=("expression",), limit=1)))
    assert FaceTracker(head, short).push(scene.observation())[0].status[-1] == Status.ITERATION_LIMIT
    assert FaceTracker(head, EXACT).push(scene.observation())[0].status[-1] == Status.CONVERGED


@pytest.mark.parametrize("method", ["optimistix-lm", "optimistix-dogleg"])
@pytest.mark.parametrize("bounded", [False, True])
def test_every_method_finds_the_same_fit(head, method, bounded):
    """Two routes to one answer: no term that only one of them could treat well."""
    scene = make_scene(head, (15, 5, 0), {"jawOpen": 0.4, "mouthSmileLeft": 0.5})
    free = EXACT.changed(solver={"bounded": bounded}, weights={"range": 1.0, "sigma_smooth": 5.0})
    ours = FaceTracker(head, free).push(scene.observation(0, 0.3))[0]
    other = FaceTracker(head, free.changed(solver={"method": method})).push(scene.observation(0, 0.3))[0]
    assert other.energies[-1].sum() == pytest.approx(ours.energies[-1].sum(), rel=1e-4)
    np.testing.assert_allclose(other.angles_deg, ours.angles_deg, atol=0.02)
    np.testing.assert_allclose(other.projected, ours.projected, atol=0.05)
    if bounded:
        assert other.expression.min() >= 0.0
        assert other.expression.max() <= 1.0


def test_distortion_counts_beside_a_field_of_view_too(head):
    coefficients = [0.1, -0.2, 0.001, 0.002]
    scene = make_scene(head, (10, 0, 0))
    bent = FaceTracker(head, EXACT.changed(camera={"distortion": coefficients})).push(scene.observation())[0]
    np.testing.assert_array_equal(bent.camera.distortion[:4], coefficients)
    with pytest.raises(ConfigError, match="coefficients"):
        EXACT.changed(camera={"distortion": [0.1]})


def test_a_muted_point_takes_no_part_in_any_stage_nor_in_the_identity(head):
    scene = make_scene(head, (10, 0, 0), {"jawOpen": 0.3})
    spoiled = scene.points.copy()
    spoiled[30] += 60.0
    observation = FrameObservation(0, Landmarks2D(spoiled, np.ones(68), IMAGE_SIZE), IMAGE_SIZE)
    muted = PRESETS["calibrated"].changed(landmarks={"weights": {"30": 0.0}})
    clean, fit = (FaceTracker(head, muted, stills=True).push(item)[0] for item in (scene.observation(), observation))
    np.testing.assert_allclose(fit.identity, clean.identity, atol=1e-6)
    np.testing.assert_allclose(fit.expression, clean.expression, atol=1e-6)


def test_a_tracker_resumed_in_a_frames_context_repeats_that_frame_and_goes_on(head):
    observations = [make_scene(head, (2 * k, 0, 0), {"jawOpen": 0.05 * k}).observation(k, 0.5) for k in range(8)]
    tracker = FaceTracker(head, PRESETS["calibrated"].changed(identity={"window": 4}))
    whole = [pair for item in observations for pair in tracker.advance(item)] + tracker.complete()
    again = FaceTracker(head, tracker.config)
    again.resume(whole[5][1])
    for k in (5, 6, 7):
        fit = again.push(observations[k])[0]
        np.testing.assert_array_equal(fit.expression, whole[k][0].expression)
        np.testing.assert_array_equal(fit.rotation, whole[k][0].rotation)


def test_a_detection_put_right_by_hand_is_fitted_where_it_was_put(head):
    scene = make_scene(head, (10, 0, 0), {"jawOpen": 0.3})
    spoiled = scene.points.copy()
    spoiled[30] += 60.0
    observation = FrameObservation(4, Landmarks2D(spoiled, np.ones(68), IMAGE_SIZE), IMAGE_SIZE)
    place = tuple(float(x) for x in scene.points[30])
    config = PRESETS["calibrated"].changed(landmarks={"moved": {"4": {"30": place}}})
    fit = FaceTracker(head, config, stills=True).push(observation)[0]
    clean = FaceTracker(head, PRESETS["calibrated"], stills=True).push(scene.observation(4))[0]
    np.testing.assert_array_equal(fit.observed[30], scene.points[30])
    np.testing.assert_array_equal(fit.expression, clean.expression)
