"""The flow term: a frame held to the one before it by the optical flow of their pictures, in either system."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.films import FOV_DEG, SIZE, FilmMaker, film_config, landmark_error_px
from workbench.config import Config, preset, read_config
from workbench.energies import residual_of
from workbench.errors import InputError
from workbench.flow import personal_points, points_in_camera
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import IBUG68
from workbench.pipeline import track
from workbench.pipeline.deep_sources import RigSource
from workbench.planning import plan_of
from workbench.session import Material, TuningSession
from workbench.session.dependence import fits_key
from workbench.session.material import PictureStore
from workbench.tracker import FaceTracker
from workbench.tracking import FaceItFitter, FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.fitting import Continuation
from workbench.tracking.flow_fitter import parameters_of
from workbench.tracking.frame_solver import solve_frame
from workbench.tracking.observation import motion_of

ROOT = Path(__file__).resolve().parent.parent
CLIP = ROOT / "data_samples/performance.mp4"
POINTS = ROOT / "data_samples/performance_landmarks.csv"
FRAMES = 8
SMALL = {"side": 192, "points": 300}
DEEP = preset("deep").changed(
    camera={"fov_deg": FOV_DEG},
    deep={"appearance": "model", "energy": "points", "start": "landmarks"},
    identity={"calibrate": False},
    flow=SMALL,
    stages=[
        {"name": "pose", "free": ("rotation", "translation"), "limit": 20},
        {"name": "jaw", "free": ("rotation", "translation", "jaw"), "limit": 10, "terms": ("regularisation",)},
    ],
)
ONE_STAGE = DEEP.changed(stages=[{"name": "all", "free": ("rotation", "translation", "jaw"), "limit": 4}])
FACE_IT = film_config(identity={"calibrate": False})


def linked(config: Config, weight: float = 1.0) -> Config:
    """The configuration with the flow term in every stage."""
    stages = [stage.model_dump() | {"terms": (*stage.terms, "flow")} for stage in config.stages]
    return config.changed(stages=stages, weights={"flow": weight})


def talking(index: int):
    """A head that turns evenly while its mouth opens and closes."""
    weights = {"jawOpen": 0.25 + 0.2 * np.sin(0.9 * index), "mouthSmileLeft": 0.3}
    return weights, (1.5 * index - 6.0, 2.0 * np.sin(0.5 * index), 0.0), (0.6 * index, 0.0, 0.0)


@pytest.fixture(scope="module")
def film(film_maker: FilmMaker):
    return film_maker.film(FRAMES, talking)


def observations(film, noise_px=0.0, pictures=True):
    """The film as a detector with this noise reports it."""
    seen = []
    for k, fit in enumerate(film.truth):
        points = fit.observed + np.random.default_rng(k).normal(0.0, noise_px, (68, 2))
        before = film.pictures[k - 1] if k and pictures else None
        landmarks = Landmarks2D(points, np.ones(68), SIZE)
        seen.append(FrameObservation(k, landmarks, SIZE, "detected", motion=motion_of(before, film.pictures[k])))
    return seen


def tracked(head, config, seen):
    return list(FaceTracker(head, config).fit_all(seen))


def poses(fits):
    return np.array([np.concatenate([100.0 * fit.rotation, fit.translation]) for fit in fits])


def jitter(values) -> float:
    return float(np.linalg.norm(np.diff(values, 2, axis=0), axis=1).mean())


def landmark_error(fits, film) -> float:
    return float(np.mean([landmark_error_px(fit, true) for fit, true in zip(fits, film.truth, strict=True)]))


def same(first, second) -> bool:
    """Whether two fits agree to the bit."""
    names = ("rotation", "translation", "expression", "projected", "jaw")
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)


# What it does to tracks.


@pytest.mark.long
def test_noisy_landmarks_of_face_it_jitter_less_and_err_less(film_maker, film):
    seen = observations(film, noise_px=1.0)
    alone, flowing = (tracked(film_maker.head, config, seen) for config in (FACE_IT, linked(FACE_IT)))
    assert jitter(poses(flowing) - poses(film.truth)) < 0.6 * jitter(poses(alone) - poses(film.truth))
    weights, true = ([fit.expression for fit in fits] for fits in (flowing, film.truth))
    assert jitter(np.subtract(weights, true)) < 0.9 * jitter(np.subtract([fit.expression for fit in alone], true))
    assert landmark_error(flowing, film) < 0.9 * landmark_error(alone, film)


@pytest.mark.long
def test_noisy_landmarks_of_deep_energies_jitter_less_and_err_less(film_maker, film):
    seen = observations(film, noise_px=1.0)
    alone, flowing = (tracked(film_maker.head, config, seen) for config in (DEEP, linked(DEEP)))
    assert jitter(poses(flowing) - poses(film.truth)) < 0.6 * jitter(poses(alone) - poses(film.truth))
    assert landmark_error(flowing, film) < 0.9 * landmark_error(alone, film)


def test_wrong_landmarks_of_a_frame_move_it_less(film_maker, film):
    seen = observations(film)[:3]
    wrong = seen[2].landmarks.points + np.array([6.0, 0.0])
    seen[2] = replace(seen[2], landmarks=replace(seen[2].landmarks, points=wrong))
    trusting = linked(DEEP, 3.0).changed(flow={"robust": 10.0})
    alone, flowing = (tracked(film_maker.head, config, seen) for config in (DEEP, trusting))
    misses = [landmark_error_px(fits[2], film.truth[2]) for fits in (alone, flowing)]
    assert misses[0] > 5.0
    assert misses[1] < 0.5 * misses[0]


# What it says of a frame.


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_where_nothing_moves_the_frame_before_has_no_residual(head, film, projection):
    config = linked(DEEP.changed(camera={"projection": projection}))
    fitter, first = DeepFitter(head, plan_of(config)), parameters_of(film.truth[0])
    depth_mm = first.translation[2] if projection == "perspective" else config.deep.distance_mm
    before = first._replace(translation=np.array([*first.translation[:2], depth_mm]))
    last = Continuation(before, np.zeros(6), np.zeros(6), 1, film.truth[0].observed)
    seen = replace(observations(film)[0], motion=motion_of(film.pictures[0], film.pictures[0]))
    problem = fitter.problem(seen, FrameContext(0, first.identity, None, last))
    residual = [np.asarray(residual_of("flow")(at, problem.history))
                for at in (before, before._replace(rotation=before.rotation + 0.03))]  # fmt: skip
    assert problem.history.flow.targets.weights.mean() > 0.5
    assert np.abs(residual[0]).max() < 0.02
    assert np.abs(residual[1]).max() > 0.2


def test_points_of_one_person_lie_where_those_of_any_identity_do(film_maker):
    points, state = (
        film_maker.flow.linker.points,
        film_maker.state({"eyeBlinkLeft": 0.7}, (9.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    )
    identity = np.random.default_rng(5).normal(0.0, 0.7, len(film_maker.head.identity_deltas))
    whole = state._replace(identity=identity, jaw=np.array([0.2, 0.0, 0.0, 0.0, 1.0, 0.0]))
    person = personal_points(points, identity)
    baked = np.asarray(points_in_camera(person, whole._replace(identity=np.zeros(0))))
    np.testing.assert_allclose(baked, np.asarray(points_in_camera(points, whole)), atol=1e-3)


# Where no frame before is known.


@pytest.mark.long
def test_the_first_frame_and_those_after_gap_jump_and_cut_are_fitted_without_it(film_maker, film):
    head, seen = film_maker.head, observations(film, noise_px=1.0)
    far = seen[6].landmarks.points + np.array([40.0, 0.0])
    seen[2] = replace(seen[2], landmarks=None)
    seen[4] = replace(seen[4], cut=True)
    seen[6] = replace(seen[6], landmarks=replace(seen[6].landmarks, points=far))
    flowing = tracked(head, linked(FACE_IT), seen)
    column = linked(FACE_IT).terms.index("flow")
    for k in (0, 3, 4, 6):
        alone = FaceItFitter(head, plan_of(FACE_IT)).fit(seen[k], FrameContext(0, flowing[k].identity, None, None))[0]
        assert flowing[k].energies[-1, column] == 0.0
        np.testing.assert_allclose(flowing[k].rotation, alone.rotation, atol=1e-9)
        np.testing.assert_allclose(flowing[k].expression, alone.expression, atol=1e-8)
    assert all(flowing[k].energies[-1, column] > 0.0 for k in (1, 5))


@pytest.mark.long
def test_photos_are_fitted_without_it(film_maker, film):
    seen = observations(film)[:2]
    fits = [
        list(FaceTracker(film_maker.head, config, stills=True).fit_all(seen)) for config in (FACE_IT, linked(FACE_IT))
    ]
    np.testing.assert_allclose(fits[1][1].expression, fits[0][1].expression, atol=1e-8)


@pytest.mark.parametrize("config", [FACE_IT, DEEP], ids=["face-it", "deep-energies"])
def test_landmarks_without_pictures_are_refused(film_maker, film, config):
    seen = [replace(observation, motion=None) for observation in observations(film)[:2]]
    with pytest.raises(
        InputError, match="picture of frame 1 with the one before, but they are not given; open the clip"
    ):
        tracked(film_maker.head, linked(config), seen)


def test_a_disabled_stage_needs_no_pictures(film_maker, film):
    stages = [stage.model_dump() for stage in FACE_IT.stages]
    idle = stages[-1] | {"name": "idle", "terms": ("flow",), "enabled": False}
    seen = [replace(observation, motion=None) for observation in observations(film)[:2]]
    fits = [tracked(film_maker.head, FACE_IT.changed(stages=given), seen) for given in (stages, [*stages, idle])]
    np.testing.assert_allclose(fits[1][1].expression, fits[0][1].expression, atol=1e-8)


# Runs, sessions, processes.


@pytest.mark.long
@pytest.mark.parametrize("config", [FACE_IT, ONE_STAGE], ids=["face-it", "deep-energies"])
def test_a_run_that_is_cut_goes_on_with_the_same_numbers(head, tmp_path, config):
    config, whole, cut = linked(config), tmp_path / "whole", tmp_path / "cut"
    options = {"landmarks": POINTS, "frames": (0, 19), "pictures": False}
    track([CLIP], whole, head, config, **options)

    def stop(step, done, total):
        if step == "track" and done == 18:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track([CLIP], cut, head, config, progress=stop, **options)
    track([CLIP], cut, head, config, resume=True, **options)
    first, second = (np.load(folder / "track.npz") for folder in (whole, cut))
    assert first["energies"][1:, -1, config.terms.index("flow")].min() > 0.0
    for name in ("rotation", "translation", "expression", "jaw", "energies"):
        np.testing.assert_array_equal(first[name], second[name])


def session_of(head, film, config) -> TuningSession:
    seen = [replace(observation, motion=None) for observation in observations(film, noise_px=1.0)]
    pictures = PictureStore(None, [SIZE] * len(seen), given=film.pictures)
    return TuningSession(head, Material("film", tuple(seen), pictures, stills=False), config)


def test_a_session_fits_clip_and_frame_as_a_run_does_and_its_slider_compiles_nothing(film_maker, film):
    session = session_of(film_maker.head, film, linked(FACE_IT))
    run = tracked(film_maker.head, linked(FACE_IT), observations(film, noise_px=1.0))
    session.fit_clip()
    assert all(same(fit, other) for fit, other in zip(session.track_fits(), run, strict=True))
    assert same(session.fit_frame(5), run[5])
    compiled = solve_frame._cache_size()
    session.set("flow", weights={"flow": 20.0})
    assert session.stale.all()
    moved = session.fit_frame(5)
    assert solve_frame._cache_size() == compiled
    assert np.abs(moved.rotation - run[5].rotation).max() > 1e-5


def test_settings_of_the_flow_count_only_where_a_stage_names_a_term_of_it():
    plain, named = FACE_IT, linked(FACE_IT)
    assert fits_key(plain) == fits_key(plain.changed(flow={"robust": 2.0}))
    assert fits_key(named) != fits_key(named.changed(flow={"robust": 2.0}))


def test_the_configuration_of_the_guide_is_one(tmp_path):
    guide = (ROOT / "docs/guides/flow.md").read_text(encoding="utf-8")
    (tmp_path / "steady.toml").write_text(guide.split("```toml\n")[1].split("```")[0], encoding="utf-8")
    config = read_config(tmp_path / "steady.toml")
    column = config.terms.index("flow")
    assert [config.factors(stage)[column] for stage in config.stages] == [0.0, 1.0]
    assert config.compares_pictures


@pytest.mark.long
def test_processes_do_not_share_frames_that_the_flow_links(head, tmp_path):
    with pytest.raises(InputError, match="take 'flow' out of the stages' terms"):
        track([CLIP], tmp_path, head, linked(DEEP), landmarks=POINTS, frames=(0, 3), workers=2)


class View:
    """A camera's film, as sources bring it."""

    frames = detector = None
    image_size, count, single_picture, views, scheme = SIZE, 2, False, (), IBUG68

    def __init__(self, seen):
        self.seen = seen

    def observations(self, start, state, stills):
        return iter(self.seen[start:2])


def test_the_pictures_of_a_rigs_views_come_together(film):
    seen = observations(film)
    first, second = RigSource([View(seen), View(seen[3:])], ("left", "right")).observations(0, {}, False)
    assert first.motion is None
    assert [len(part) for part in second.motion] == [2, 2]
    assert second.motion.before[1] is film.pictures[3]
    assert second.motion.now[0] is film.pictures[1]
