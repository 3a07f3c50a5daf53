"""The tuning session without a screen: history, fits equal to the command line's, landmarks, export."""

import shlex
import shutil
import threading
from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from tests.other_heads import resized
from tests.performances import performance
from tests.scenes import IMAGE_SIZE, make_scene
from workbench.cli import app
from workbench.config import PRESETS, Hashed, Stage, preset, read_config, write_config
from workbench.errors import ConfigError, InputError
from workbench.export.sources import pictures_of
from workbench.export.summary import summary_of
from workbench.frames import open_frames, read_picture, write_picture
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import IBUG68
from workbench.pipeline import track as run_track
from workbench.planning import plan_of
from workbench.reading import content_hash
from workbench.samples import sample
from workbench.session import Material, TuningSession, material_of_photo, material_of_track, open_session, readiness
from workbench.session.exports import free_file, track_command
from workbench.session.knobs import changed_by, value_of
from workbench.session.landmark_edits import LEAST_FACTOR, rescaled, unmuted, weighed
from workbench.session.material import PictureStore
from workbench.session.metrics import metrics_of_track
from workbench.session.performance import performance_track
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation, Track
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.frame_solver import solve_frame
from workbench.tracking.identity import calibrate_identity
from workbench.tracking.records import ARRAYS, stack_fits
from workbench.tracking.track_layout import model_record

QUICK = preset("calibrated").changed(identity={"window": 6, "frames": 12})


@pytest.fixture(scope="module")
def clip(head):
    """Two shots of one person, a gap without a face in the second."""
    rng = np.random.default_rng(2)
    identity = rng.normal(0.0, 0.7, 50)
    observations = []
    for k in range(22):
        angles = (2.0 * k - 20.0, 5.0 * np.sin(k / 3), 0.0)
        weights = {"jawOpen": 0.3 + 0.3 * np.sin(k / 2), "mouthSmileLeft": 0.4}
        scene = make_scene(head, angles, weights, identity, sliding=True)
        found = scene.observation(k, noise_px=0.5, cut=k == 10)
        observations.append(FrameObservation(k, None, IMAGE_SIZE) if k == 15 else found)
    pictures = PictureStore(None, [IMAGE_SIZE] * len(observations))
    return Material("clip", tuple(observations), pictures, stills=False)


@pytest.fixture(scope="module")
def photo():
    landmarks = next(iter(read_landmark_file(sample("astronaut-landmarks")))).landmarks
    return material_of_photo(read_picture(sample("astronaut")), landmarks, "astronaut")


@pytest.fixture
def session(head, clip):
    return TuningSession(head, clip, QUICK)


def test_a_steady_turn_through_half_a_turn_has_no_jitter(head):
    track = performance(head, frames=21, gap=None)
    degrees = np.arange(170.0, 191.0)
    rolling = Rotation.from_rotvec(np.outer(degrees, [0.0, 0.0, 1.0]), degrees=True).as_rotvec()
    assert metrics_of_track(replace(track, rotation=rolling))["jitter_deg"] == pytest.approx(0.0, abs=1e-3)


def test_a_photo_in_memory_has_a_picture_and_landmarks_alone_have_none(photo, clip):
    np.testing.assert_array_equal(photo.pictures[0], read_picture(sample("astronaut")))
    assert photo.pictures.real
    assert not clip.pictures.real
    assert (clip.pictures[0] == clip.pictures[0][0, 0]).all()


def same(first, second):
    """Whether two fits agree to the bit."""
    names = ("rotation", "translation", "expression", "identity", "projected", "observed")
    return all(np.array_equal(getattr(first, name), getattr(second, name), equal_nan=True) for name in names)


# --- history ---


def test_every_change_can_be_taken_back_and_made_again(session):
    session.set("tau", weights={"tau": 0.5})
    session.set("fov", camera={"fov_deg": 30.0})
    assert (session.undo_label, session.redo_label) == ("fov", None)
    assert session.undo() == "fov"
    assert session.config.camera.fov_deg == QUICK.camera.fov_deg
    assert session.undo() == "tau"
    assert session.config == QUICK
    assert session.undo() is None
    assert [session.redo(), session.redo(), session.redo()] == ["tau", "fov", None]
    assert session.config.weights.tau == 0.5


def test_a_change_after_undo_forgets_what_was_taken_back(session):
    session.set("a", weights={"tau": 0.5})
    session.undo()
    session.set("b", weights={"tau": 0.7})
    assert session.redo_label is None


def test_a_dragged_slider_is_one_step(session):
    for value in np.linspace(0.1, 2.0, 30):
        session.set("ω_τ", gesture="weights.tau", weights={"tau": float(value)})
    session.set("ω_σ", gesture="weights.sigma_smooth", weights={"sigma_smooth": 3.0})
    assert session.undo() == "ω_σ"
    assert session.undo() == "ω_τ"
    assert session.config == QUICK


def test_a_refused_change_leaves_everything_as_it_was(session):
    with pytest.raises(ConfigError, match="did you mean 'tau'"):
        session.set(weights={"tao": 1.0})
    assert session.config == QUICK
    assert session.undo_label is None


def test_snapshots_are_kept_by_name_and_restored_as_a_step(session):
    session.set(weights={"tau": 0.5})
    session.take_snapshot("strong τ")
    session.set(weights={"tau": 0.0})
    assert [str(item) for item in session.changes("strong τ")] == ["weights.tau: 0.5 → 0"]
    session.restore_snapshot("strong τ")
    assert session.config.weights.tau == 0.5
    session.undo()
    assert session.config.weights.tau == 0.0
    with pytest.raises(ConfigError, match="There is no snapshot 'x'; the snapshots are: strong τ"):
        session.restore_snapshot("x")
    with pytest.raises(ConfigError, match="needs a name"):
        session.take_snapshot(" ")
    for name in ("now", " the start"):
        with pytest.raises(ConfigError, match="choose another one"):
            session.take_snapshot(name)


def test_going_back_to_a_snapshot_is_named_by_the_word_once(session):
    for name, label in {"mine": "snapshot mine", "snapshot 1": "snapshot 1"}.items():
        session.set(weights={"tau": 0.5})
        session.take_snapshot(name)
        session.set(weights={"tau": 0.0})
        session.restore_snapshot(name)
        assert session.undo_label == label


def test_listeners_hear_of_changes_until_they_leave(session):
    heard = []
    leave = session.listen(heard.append)
    session.set(weights={"tau": 0.5})
    session.undo()
    leave()
    session.redo()
    assert heard == ["config", "config"]


# --- fits ---


def test_a_run_has_the_bits_of_the_tracker(session, head, clip):
    expected = list(FaceTracker(head, QUICK).fit_all(clip.observations))
    session.fit_clip()
    assert len(session.run.fits) == len(expected)
    assert all(same(found, fit) for found, fit in zip(session.run.fits, expected, strict=True))
    assert [fit.shot for fit in session.run.fits] == [fit.shot for fit in expected]


def test_stills_have_the_bits_of_the_tracker(head, clip):
    stills = Material("stills", clip.observations[:4], clip.pictures, stills=True)
    session = TuningSession(head, stills, QUICK)
    session.fit_clip()
    tracker = FaceTracker(head, QUICK, stills=True)
    expected = [fit for item in stills.observations for fit in tracker.push(item)]
    assert all(same(found, fit) for found, fit in zip(session.run.fits, expected, strict=True))


def test_a_frame_of_an_unchanged_clip_is_fitted_as_the_run_did(session):
    session.fit_clip()
    for frame in (0, 5, 10, 14, 16, 21):
        assert same(session.fit_frame(frame), session.run.fits[frame])


def test_a_change_makes_the_run_stale_until_it_is_taken_back_or_run_again(session):
    assert session.stale.all()
    session.fit_clip()
    assert not session.stale.any()
    session.set(weights={"sigma_smooth": 5.0})
    assert session.stale.all()
    session.undo()
    assert not session.stale.any()
    session.redo()
    session.fit_clip()
    assert not session.stale.any()


def test_a_moved_point_makes_only_its_shot_stale(session):
    session.fit_clip()
    session.move(3, 30, (300.0, 200.0))
    np.testing.assert_array_equal(np.flatnonzero(session.stale), np.arange(10))


def test_an_export_that_is_cancelled_while_the_start_is_fitted_writes_nothing(session, tmp_path):
    """The metrics of the start are written beside those of the present configuration."""
    session.set(weights={"tau": 9.0})
    session.fit_clip()
    asked = []

    def cancelled():
        asked.append(True)
        return True

    with pytest.raises(InputError, match="The export was cancelled"):
        session.export(tmp_path / "tuned.toml", cancelled=cancelled)
    assert asked
    assert list(tmp_path.iterdir()) == []


def test_a_cancelled_run_leaves_the_last_one(session):
    session.fit_clip()
    before = session.run
    session.set(weights={"tau": 0.5})
    assert session.fit_clip(cancelled=lambda: True) is None
    assert session.run is before


def test_a_run_reports_each_frame(session):
    told = []
    session.fit_clip(progress=lambda step, done, total: told.append((step, done, total)))
    assert told[0] == ("fit", 1, 22)
    assert told[-1] == ("fit", 22, 22)


def test_stepping_goes_through_the_stages_one_iteration_at_a_time(session):
    _, traces = session.explain_frame(0)
    counts = [len(trace.energies) - 1 for trace in traces]
    at = 0
    for trace, count in zip(traces, counts, strict=True):
        for step in range(1, count + 1):
            fit = session.fit_steps(0, at + step)
            np.testing.assert_allclose(fit.residuals_px, trace.residuals_px[step], atol=1e-6)
        at += count
    assert same(session.fit_steps(0, at), session.fit_frame(0))


def test_steps_of_a_frame_without_a_face_are_refused(session):
    for ask in (session.explain_frame, lambda frame: session.fit_steps(frame, 3)):
        with pytest.raises(InputError, match="Frame 15 has no landmarks; choose a frame with a face"):
            ask(15)


def test_a_coarse_fit_keeps_the_identity_of_the_shot(session):
    exact = session.fit_frame(4)
    session.set(camera={"fov_deg": 30.0})
    coarse, full = session.fit_frame(4, coarse=True), session.fit_frame(4)
    np.testing.assert_array_equal(coarse.identity, exact.identity)
    assert not np.array_equal(full.identity, exact.identity)


def test_nothing_compiles_after_the_warm_up(head, photo):
    session = TuningSession(head, photo)
    session.warm_up()
    before = solve_frame._cache_size(), calibrate_identity._cache_size()
    session.fit_frame(0)
    for changes in (
        {"weights": {"tau": 1.0, "sigma": 1.0, "beta": 0.5, "range": 1.0}},
        {"camera": {"fov_deg": 60.0}},
        {"contour": {"mode": "fixed"}},
        {"identity": {"calibrate": False}},
        {"solver": {"bounded": False}},
        {"solver": {"method": "optimistix-lm", "bounded": False}},
        {"solver": {"method": "optimistix-dogleg", "bounded": False}},
        {"stages": [stage.model_dump() for stage in PRESETS["joint"].stages]},
    ):
        session.set(**changes)
        session.fit_frame(0)
        session.explain_frame(0)
    assert (solve_frame._cache_size(), calibrate_identity._cache_size()) == before


@pytest.mark.parametrize("turn", [1, -1], ids=["to-deep", "to-face-it"])
def test_a_frame_is_fitted_anew_by_the_other_system_once_the_session_has_changed_to_it(turn, head, photo):
    stages = (Stage(name="pose", free=("rotation", "translation"), terms=("tau",), limit=5),)
    deep = preset("deep-points").changed(stages=stages, identity={"calibrate": False}, deep={"appearance": "model"})
    first, other = (preset("joint"), deep)[::turn]
    session = TuningSession(head, photo, first)
    before = session.fit_frame(0)
    session.use(other)
    after = session.fit_frame(0)
    session.use(first)
    assert [same(session.fit_frame(0), fit) for fit in (before, after)] == [True, False]


def test_getting_ready_is_no_error_where_the_system_is_changed_meanwhile(head, photo, monkeypatch):
    session = TuningSession(head, photo)
    monkeypatch.setattr(readiness, "compile_solvers", lambda *what: session.use(preset("deep")))
    session.warm_up()
    assert session.config.system == "deep-energies"


def test_threads_may_change_and_fit_at_once(session):
    session.fit_clip()
    wrong = []

    def work(seed):
        rng = np.random.default_rng(seed)
        try:
            for _ in range(6):
                session.set(weights={"sigma_smooth": float(rng.uniform(0, 30))})
                assert np.isfinite(session.fit_frame(int(rng.integers(10))).expression).all()
                session.undo()
        except Exception as error:
            wrong.append(error)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert wrong == []


# --- landmarks ---


def test_a_muted_point_has_no_say_and_comes_back(session):
    session.weigh([48, 54], 0.0)
    assert session.config.point_weights()[48] == 0.0
    session.weigh([48, 54], 1.0)
    assert session.config == QUICK


def test_a_muted_point_of_a_weighted_group_comes_back_to_one(session):
    session.set(landmarks={"weights": {"jaw": 0.2}})
    session.weigh([8], 0.0)
    session.weigh([8], 1.0)
    assert session.config.point_weights()[7:10] == [0.2, 1.0, 0.2]


def test_unmuted_points_are_weighed_as_their_group_and_those_of_a_muted_group_fully():
    grouped = QUICK.changed(landmarks={"weights": {"jaw": 0.2, "nose": 0.0}})
    muted = weighed(grouped, [8, 30, 48], 0.0)
    found = unmuted(muted, [8, 30, 48], IBUG68)
    assert [found.point_weights()[point] for point in (8, 30, 48)] == [0.2, 1.0, 1.0]
    assert found.landmarks.weights == {"jaw": 0.2, "nose": 0.0, "30": 1.0}
    assert unmuted(weighed(QUICK, [8], 0.0), [8], IBUG68) == QUICK


def test_the_slider_of_a_group_shows_and_changes_what_wider_groups_weigh_it():
    config = QUICK.changed(landmarks={"weights": {"mouth": 2.0, "brows": 0.0, "17": 3.0}})
    assert [value_of(config, f"group.{name}") for name in ("outer_lips", "right_brow", "jaw")] == [2.0, 0.0, 1.0]
    back = config.changed(**changed_by(config, "group.right_brow", 1.0))
    assert value_of(back, "group.right_brow") == 1.0
    assert back.point_weights()[17:23] == [3.0, 1.0, 1.0, 1.0, 1.0, 0.0]  # single points keep their own
    jaw = config.changed(**changed_by(config, "group.jaw", 0.5))
    assert jaw.changed(**changed_by(jaw, "group.jaw", 1.0)) == config


def test_the_slider_of_a_group_leaves_its_parts_and_subsets_what_they_weigh():
    config = QUICK.changed(subsets={"mine": (0, 1)}, landmarks={"weights": {"nose_bridge": 0.0, "mine": 0.0}})
    for group, points, held in (("nose", range(31, 36), 27), ("jaw", range(2, 17), 0)):
        half = config.changed(**changed_by(config, f"group.{group}", 0.5))
        assert {half.point_weights()[point] for point in points} == {0.5}
        assert half.point_weights()[held] == 0.0
        assert half.changed(**changed_by(half, f"group.{group}", 1.0)) == config


def test_the_weight_of_each_point_is_multiplied_for_itself():
    config = weighed(weighed(QUICK, [30], 0.0), [31], 3.0)
    found = rescaled(config, [30, 31, 32], 2.0, IBUG68).point_weights()
    assert [found[point] for point in (30, 31, 32)] == [2.0 * LEAST_FACTOR, 6.0, 2.0]


def test_a_moved_detection_is_fitted_and_put_back(session):
    place = (310.0, 222.0)
    session.move(4, 30, place)
    np.testing.assert_array_equal(session.fit_frame(4).observed[30], place)
    session.put_back(4, [30])
    assert session.config == QUICK


def test_a_point_that_is_not_there_is_not_moved(session):
    with pytest.raises(InputError, match="Frame 15 has no landmarks to move"):
        session.move(15, 30, (310.0, 222.0))
    for point in (-1, 68, 500):
        with pytest.raises(InputError, match=f"There is no landmark {point}; this clip has 0 to 67"):
            session.move(4, point, (310.0, 222.0))
    with pytest.raises(InputError, match="There is no frame 22"):
        session.move(22, 30, (310.0, 222.0))
    assert session.config == QUICK


def test_what_a_track_holds_where_it_was_moved_is_not_put_back(session, head):
    """Where it was detected, the track does not say."""
    session.move(4, 30, (310.0, 222.0))
    session.fit_clip()
    again = open_session(session.track, model=head)
    with pytest.raises(InputError, match=r"landmark 30 of frame 4 where it was moved, .*; open the clip itself"):
        again.put_back(4, [30])
    again.move(4, 31, (320.0, 222.0))
    again.put_back(4, [30, 31])  # what can be put back is
    assert again.config == session.config


def test_a_subset_is_saved_for_stages(session):
    session.save_subset("upper lip", [50, 51, 52, 51])
    assert session.config.subsets == {"upper lip": (50, 51, 52)}
    session.set(landmarks={"weights": {"upper lip": 3.0}})
    assert session.config.point_weights()[51] == 3.0
    with pytest.raises(ConfigError, match="at least one point"):
        session.save_subset("empty", [])
    with pytest.raises(ConfigError, match="a subset needs a name"):
        session.save_subset(" ", [50])
    with pytest.raises(ConfigError, match=r"'upper, lower'.* leave it out"):
        session.save_subset("upper, lower", [50])


def test_a_frame_outside_the_material_is_refused(session):
    with pytest.raises(InputError, match="There is no frame 22; clip has frames 0 to 21"):
        session.fit_frame(22)


# --- material ---


def test_pictures_come_in_any_order_and_stay_the_same(head):
    session = open_session(sample("performance"), landmarks=sample("performance-landmarks"), model=head)
    first, later = session.picture(0), session.picture(120)
    assert first.std() > 10
    assert np.abs(first.astype(int) - later).mean() > 0.5
    np.testing.assert_array_equal(session.picture(0), first)
    small = PictureStore(session.material.pictures._frames, [first.shape[1::-1]] * 240, kept_bytes=1)
    np.testing.assert_array_equal(small[120], later)
    np.testing.assert_array_equal(small[0], first)


def test_a_track_is_tuned_on_as_the_input_that_it_came_from(head, tmp_path):
    result = run_track(sample("astronaut"), tmp_path, head, QUICK, landmarks=sample("astronaut-landmarks"))
    session = open_session(result.track, model=head)
    assert session.config == QUICK
    assert session.material.pictures.real
    assert same(session.fit_frame(0), result.track[0])


@pytest.fixture(scope="module")
def track(head, photo):
    return TuningSession(head, photo, QUICK).track


@pytest.fixture
def resized_track(track, head):
    """A track of another model than the default head."""
    return replace(track, meta=track.meta | {"model": model_record(resized(head, 1.3))})


def test_the_folder_of_a_run_is_tuned_on_as_its_track(track, tmp_path):
    track.save(tmp_path / "track.npz")
    assert open_session(tmp_path).config == QUICK


DAMAGED_TRACKS = {
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:500]),
    "empty": lambda path: path.write_bytes(b""),
    "junk": lambda path: path.write_bytes(b"junk " * 50),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
}


@pytest.mark.parametrize("results", [("config.toml",), ("summary.json",), ()], ids=" ".join)
@pytest.mark.parametrize("damage", DAMAGED_TRACKS)
def test_the_folder_of_a_run_with_a_damaged_track_is_told_as_by_reading_it(track, tmp_path, damage, results):
    track.save(tmp_path / "track.npz")
    for name in results:
        (tmp_path / name).write_text("")
    if results:
        shutil.copy(sample("astronaut"), tmp_path)
    DAMAGED_TRACKS[damage](tmp_path / "track.npz")
    with pytest.raises(InputError) as told:
        Track.load(tmp_path / "track.npz")
    with pytest.raises(InputError) as opened:
        open_session(tmp_path)
    assert str(opened.value) == str(told.value)


def test_the_folder_of_a_run_without_its_track_says_that_it_is_missing(tmp_path):
    for name in ("config.toml", "summary.json"):
        (tmp_path / name).write_text("")
    with pytest.raises(InputError, match=r"The track .*track\.npz does not exist"):
        open_session(tmp_path)


def test_the_picture_that_a_run_drew_is_no_photo(tmp_path):
    for name in ("config.toml", "summary.json"):
        (tmp_path / name).write_text("")
    shutil.copy(sample("astronaut"), tmp_path / "overlay.png")
    with pytest.raises(InputError, match=r"The track .*track\.npz does not exist"):
        open_session(tmp_path)


def test_photos_beside_another_array_of_that_name_are_photos(tmp_path):
    shutil.copy(sample("astronaut"), tmp_path)
    np.savez(tmp_path / "track.npz", points=np.zeros(3))
    assert open_session(tmp_path, landmarks=sample("astronaut-landmarks")).material.pictures.real


def test_a_folder_of_photos_with_their_landmarks_is_no_run(track, tmp_path):
    shutil.copy(sample("astronaut"), tmp_path)
    track.save(tmp_path / "track.npz")
    assert open_session(tmp_path, landmarks=sample("astronaut-landmarks")).material.inputs == (tmp_path,)


def test_a_track_takes_no_other_landmarks(track, tmp_path):
    with pytest.raises(InputError, match="A track has its own landmarks; open its pictures"):
        open_session(track, landmarks=sample("astronaut-landmarks"))


def test_a_track_of_another_model_is_not_opened_on_the_default_head(resized_track):
    with pytest.raises(InputError, match=r"fitted with the model resized; .* model=load_face_model\(FILE\)"):
        open_session(resized_track)


def test_a_track_of_another_model_opens_with_that_one(resized_track, head):
    assert open_session(resized_track, model=resized(head, 1.3)).model.name == "resized"


def test_a_track_that_names_no_model_opens_on_the_default_head(track):
    meta = {name: value for name, value in track.meta.items() if name != "model"}
    assert open_session(replace(track, meta=meta)).model.name == "default-head"


def test_a_file_of_settings_is_told_as_such(tmp_path):
    write_config(QUICK, tmp_path / "tuned.toml")
    with pytest.raises(InputError, match=r"tuned.toml holds settings .* session.use\(read_config\(FILE\)\)"):
        open_session(tmp_path / "tuned.toml")


def test_a_track_whose_pictures_are_gone_is_tuned_on_a_blank_canvas(head, tmp_path):
    result = run_track(sample("astronaut-landmarks"), tmp_path, head, QUICK, pictures=False)
    material = material_of_track(result.track)
    assert not material.pictures.real
    assert np.ptp(material.pictures[0]) == 0


def test_other_pictures_in_the_place_of_the_tracked_ones_are_not_tuned_on(head, tmp_path):
    photo = tmp_path / "face.png"
    write_picture(photo, read_picture(sample("astronaut")))
    result = run_track(photo, tmp_path / "out", head, QUICK, landmarks=sample("astronaut-landmarks"))
    write_picture(photo, np.zeros((512, 512, 3), np.uint8))
    session = open_session(result.track, model=head)
    assert not session.material.pictures.real
    assert session.material.sources() == []
    assert performance_track(session).meta["inputs"] == []


def test_what_a_session_exports_says_what_found_its_landmarks(head, photo, tmp_path):
    config = QUICK.changed(landmarks={"detector": "network"})
    session = open_session(sample("astronaut"), config, model=head)
    track = performance_track(session)
    assert track.meta["detector"] == "network"
    assert summary_of([track])["detector"] == "network"
    track.save(tmp_path / "track.npz")
    shown = open_session(tmp_path, model=head)
    assert performance_track(shown).meta["detector"] == "network"
    from_file = open_session(sample("astronaut"), QUICK, landmarks=sample("astronaut-landmarks"), model=head)
    assert performance_track(from_file).meta["detector"] is None
    assert "detector" not in performance_track(TuningSession(head, photo, QUICK)).meta


@pytest.fixture
def photo_session(head, tmp_path):
    """A session on a copy of the portrait, `face.png`."""
    shutil.copy(sample("astronaut"), tmp_path / "face.png")
    return open_session(tmp_path / "face.png", landmarks=sample("astronaut-landmarks"), model=head, config=QUICK)


@pytest.mark.parametrize("replaced", [True, False])
def test_settings_and_performances_name_the_pictures_that_were_opened(photo_session, tmp_path, replaced):
    photo = tmp_path / "face.png"
    opened = content_hash(photo)
    if replaced:
        write_picture(photo, np.zeros((512, 512, 3), np.uint8))
    else:
        photo.unlink()
    track = performance_track(photo_session)
    assert photo_session.material.sources() == [Hashed(str(photo), opened)]
    assert track.meta["inputs"] == [{"path": str(photo), "sha256": opened}]
    with pytest.raises(InputError, match="The pictures of this track are no longer at"):
        pictures_of(track)


def test_a_performance_names_what_was_opened_from_another_folder_too(head, tmp_path, monkeypatch):
    shutil.copy(sample("astronaut"), tmp_path / "face.png")
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path)
    session = open_session("face.png", landmarks=sample("astronaut-landmarks"), model=head, config=QUICK)
    monkeypatch.chdir("other")
    assert performance_track(session).meta["inputs"][0]["path"] == str(tmp_path / "face.png")


def test_a_session_on_a_track_names_the_landmarks_that_were_tracked(head, tmp_path):
    points = tmp_path / "points.csv"
    shutil.copy(sample("astronaut-landmarks"), points)
    tracked = run_track(sample("astronaut"), tmp_path / "out", head, QUICK, landmarks=points, pictures=False).track
    points.write_bytes(points.read_bytes() + b"\n")
    session = open_session(tracked, model=head)
    assert session.material.landmark_source() == Hashed(str(points), tracked.meta["landmarks"]["sha256"])


@pytest.mark.parametrize("config", [None, "calibrated"])
def test_a_session_on_a_track_keeps_the_detector_that_found_its_points(config, head, clip):
    tracked = performance_track(TuningSession(head, clip, QUICK))
    stored = QUICK.changed(landmarks={"detector": "dlib"}).model_dump(mode="json")
    session = open_session(replace(tracked, meta=tracked.meta | {"config": stored}), config, model=head)
    assert session.config.preset == (config or QUICK.preset)
    assert session.config.landmarks.detector == "dlib"


def test_a_picture_that_could_not_be_read_for_a_while_is_shown_when_it_is_back(tmp_path):
    for k in range(4):
        write_picture(tmp_path / f"{k}.png", np.full((8, 8, 3), 10 * k, np.uint8))
    store = PictureStore(open_frames(tmp_path), [(8, 8)] * 4)
    (tmp_path / "1.png").rename(tmp_path / "away")
    for _ in range(2):
        with pytest.raises(InputError, match=r"1\.png does not exist"):
            store[1]
    (tmp_path / "away").rename(tmp_path / "1.png")
    assert [int(store[k].mean()) for k in (1, 2, 3)] == [10, 20, 30]


def test_the_command_asks_for_the_clip_of_another_camera_that_is_gone(head, tmp_path):
    track = run_track(sample("astronaut-landmarks"), tmp_path, head, QUICK, pictures=False).track
    gone = {"path": "/gone/side.mp4", "sha256": "0"}
    meta = track.meta | {"inputs": [*track.meta["inputs"], gone], "views": {"side": gone["path"]}}
    material = material_of_track(replace(track, meta=meta))
    assert "--view side=CLIP" in track_command(material, "tuned.toml", preset("deep"))


# --- long clips ---


class Watched(tuple):
    """Observations that note which of them were looked at."""

    def __new__(cls, items, looked=None):
        made = super().__new__(cls, items)
        made.looked = set() if looked is None else looked
        return made

    def __iter__(self):
        for item in super().__iter__():
            self.looked.add(item.index)
            yield item

    def __getitem__(self, place):
        if isinstance(place, slice):
            return Watched(super().__getitem__(place), self.looked)
        item = super().__getitem__(place)
        self.looked.add(item.index)
        return item


def long_clip(clip, frames):
    """The first shot back and forth, so that the head never jumps."""
    shot = clip.observations[:10]
    there_and_back = [*shot, *shot[-2:0:-1]]
    observations = [replace(there_and_back[k % len(there_and_back)], index=k, cut=False) for k in range(frames)]
    return Material("long", Watched(observations), PictureStore(None, [IMAGE_SIZE] * frames), stills=False)


def test_a_track_whose_pictures_are_gone_keeps_their_rate(session, head):
    track = session.track
    track = replace(track, meta=track.meta | {"rate": 60.0, "inputs": [{"path": "/gone/clip.mp4", "sha256": "0"}]})
    again = performance_track(open_session(track, model=head))
    assert again.meta["rate"] == 60.0


def test_a_fit_in_a_long_clip_does_not_go_through_all_of_it(head, clip):
    material = long_clip(clip, 400)
    session = TuningSession(head, material, QUICK)
    session.fit_frame(3)  # finds the shots, once
    material.observations.looked.clear()
    session.set(identity={"expression": 0.5})  # another identity
    session.fit_frame(200)
    needed = {*range(QUICK.identity.window), 200}
    assert len(material.observations.looked - needed) < 20  # run-time checks of types look at one more here and there


def test_the_track_of_a_session_says_what_it_was_made_of(head, tmp_path):
    session = open_session(sample("performance-landmarks"), QUICK)
    assert session.track.meta == performance_track(session).meta
    session.track.save(tmp_path / "mine.npz")
    again = open_session(tmp_path / "mine.npz")
    assert again.material.landmark_file == session.material.landmark_file
    assert again.material.rate == session.material.rate


def test_a_session_for_fits_alone_needs_no_pictures(head, clip):
    session = TuningSession(head, replace(clip, pictures=None), QUICK)
    assert len(session.fit_clip()) == len(clip.observations)
    assert session.track.meta["rate"] is None


@pytest.mark.parametrize("name", ["talk.glb", "talk.usda", "talk.arkit.csv", "TALK.MP4"])
def test_settings_are_not_written_under_the_name_of_an_animation(session, tmp_path, name):
    with pytest.raises(InputError, match=r"The settings are TOML, .*export_track\(session\.track"):
        session.export(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_run_is_stacked_once_for_all_that_is_shown_of_it(head, clip, monkeypatch):
    stacked = []

    def counted(fits):
        stacked.append(len(fits))
        return stack_fits(fits)

    for module in ("clip_run", "metrics", "failed_frames"):
        monkeypatch.setattr(f"workbench.session.{module}.stack_fits", counted)
    session = TuningSession(head, clip, QUICK)
    session.fit_clip()
    assert (len(session.track), len(session.run.flags.text)) == (22, 22)
    assert session.metrics()["frames"] == 22
    assert session.temporal.failed() == (15,)
    assert stacked == [22]


def test_a_run_keeps_a_few_kilobytes_of_each_frame(session):
    session.fit_clip()
    kept = [getattr(session.run.track, name) for name in ARRAYS]
    kept += jax.tree.leaves((session.run.before,))
    assert not any(isinstance(leaf, jax.Array) for leaf in kept)  # each takes a kilobyte besides its numbers
    assert sum(np.asarray(leaf).nbytes for leaf in kept) < 8_000 * len(session)


def test_the_fits_of_a_run_are_a_sequence_like_any_other(session):
    session.fit_clip()
    fits = session.run.fits
    assert [fit.index for fit in fits] == list(range(22))
    assert (fits[-1].index, [fit.index for fit in fits[3:5]]) == (21, [3, 4])
    with pytest.raises(IndexError):
        fits[22]


# --- export ---

SETUPS = {
    "photo, weights and stages": {
        "weights": {"sigma_smooth": 7.0},
        "stages": [stage.model_dump() for stage in PRESETS["joint"].stages],
    },
    "photo, dogleg": {
        "solver": {"method": "optimistix-dogleg", "bounded": False},
        "weights": {"range": 2.0},
        "camera": {"fov_deg": 30.0},
    },
    "landmarks, subset, moved and muted": {
        "subsets": {"corners": (48, 54)},
        "landmarks": {"weights": {"corners": 0.3, "8": 0.0}, "moved": {"3": {"30": (322.123456, 241.5)}}},
        "contour": {"mode": "fixed"},
        "weights": {"tau": 2.0},
    },
}


@pytest.mark.parametrize("name", SETUPS)
def test_an_exported_configuration_gives_the_same_bits_on_the_command_line(name, head, tmp_path):
    if name.startswith("photo"):
        inputs, landmarks = sample("astronaut"), sample("astronaut-landmarks")
    else:
        inputs, landmarks = _short_clip(tmp_path), None
    session = open_session(inputs, landmarks=landmarks, model=head)
    session.set(**SETUPS[name])
    file = session.export(tmp_path / "tuned.toml")
    command = [*shlex.split(session.command(file))[1:], "--no-pictures", "--out", str(tmp_path / "again")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    again = Track.load(tmp_path / "again" / "track.npz")
    assert all(same(again[k], fit) for k, fit in enumerate(session.run.fits))
    text = file.read_text(encoding="utf-8").replace("sigma_smooth = 7.0", "sigma_smooth = 9.0")
    text = text.replace("range = 2.0", "range = 0.5").replace("tau = 2.0", "tau = 0.0")
    file.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(app, [*command, "--overwrite"])
    assert done.exit_code == 0, done.output
    other = Track.load(tmp_path / "again" / "track.npz")
    assert not all(same(other[k], fit) for k, fit in enumerate(session.run.fits))


def test_loaded_settings_bring_points_that_were_moved_in_the_same_clip(head, tmp_path):
    clip = _short_clip(tmp_path)
    first, second = (open_session(clip, model=head) for _ in range(2))
    first.move(3, 30, (322.0, 241.5))
    first.export(tmp_path / "tuned.toml")
    clip.rename(tmp_path / "renamed.csv")
    second.load(tmp_path / "tuned.toml")
    assert second.config == first.config
    assert not second.unexported


def test_loaded_settings_of_another_clip_leave_how_points_were_found(session, head, tmp_path):
    other = open_session(_short_clip(tmp_path), model=head)
    other.move(3, 30, (322.0, 241.5))
    other.set(weights={"tau": 2.0})
    other.export(tmp_path / "tuned.toml")
    session.move(4, 30, (310.0, 222.0))
    moved = session.config.landmarks.moved
    loaded = session.load(tmp_path / "tuned.toml")
    assert loaded.weights.tau == 2.0
    assert loaded.landmarks.moved == moved
    assert "landmarks.moved.4" in {change.path for change in session.unexported}  # the file does not hold them
    session.undo()
    assert session.config.weights.tau == QUICK.weights.tau


def _short_clip(folder):
    path = folder / "clip.csv"
    lines = sample("performance-landmarks").read_text().splitlines()[:31]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_exported_file_says_where_it_comes_from(session, tmp_path):
    session.set(weights={"tau": 3.0})
    session.export(tmp_path / "tuned.toml")
    stored = read_config(tmp_path / "tuned.toml")
    provenance = stored.provenance
    assert stored.changed(provenance=None) == session.config
    assert provenance.changed == ["weights.tau: 0.1 → 3"]
    assert provenance.model.startswith("default-head sha256:")
    assert provenance.versions["jax"]
    assert provenance.after["jitter_deg"] < provenance.before["jitter_deg"]
    assert provenance.before["frames_with_face"] == 21


def test_an_export_leaves_a_file_that_it_did_not_write(session, head, clip, tmp_path):
    other = TuningSession(head, replace(clip, name="other", inputs=(_short_clip(tmp_path),), opened=None), QUICK)
    path = other.export(tmp_path / "tuned.toml")
    before = path.read_bytes()
    with pytest.raises(
        InputError, match=r"exported for clip\.csv; export to clip-tuned\.toml instead, or pass overwrite"
    ):
        session.export(path)
    assert path.read_bytes() == before
    (tmp_path / "notes.toml").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.toml exists already; export to"):
        session.export(tmp_path / "notes.toml")
    assert (tmp_path / "notes.toml").read_text() == "mine"


def test_an_export_may_follow_another_one_of_the_same_session_or_overwrite_when_told(session, tmp_path):
    (tmp_path / "old.toml").write_text("mine")
    session.export(tmp_path / "old.toml", overwrite=True)
    session.set(weights={"tau": 3.0})
    session.export(tmp_path / "old.toml")
    assert read_config(tmp_path / "old.toml").weights.tau == 3.0


def test_an_export_leaves_its_own_file_once_it_was_edited(session, tmp_path):
    file = session.export(tmp_path / "tuned.toml")
    edited = file.read_text(encoding="utf-8") + "# mine\n"
    file.write_text(edited, encoding="utf-8")
    with pytest.raises(InputError, match=r"tuned\.toml exists already"):
        session.export(file)
    assert file.read_text(encoding="utf-8") == edited


def test_an_export_leaves_its_own_file_where_it_was_edited_during_the_fits(session, tmp_path):
    file = session.export(tmp_path / "tuned.toml")
    session.set(weights={"tau": 3.0})
    with pytest.raises(InputError, match=r"tuned\.toml exists already"):
        session.export(file, lambda *_: file.write_text("mine"))
    assert file.read_text() == "mine"


def test_an_export_replaces_when_told_what_appears_during_the_fits(session, tmp_path):
    file = tmp_path / "tuned.toml"
    session.set(weights={"tau": 3.0})
    session.export(file, lambda *_: file.write_text("mine"), overwrite=True)
    assert read_config(file).weights.tau == 3.0


def test_of_two_sessions_none_replaces_unasked_what_the_other_saved(session, head, clip, tmp_path):
    file, other = session.export(tmp_path / "shared.toml"), TuningSession(head, clip, QUICK)
    other.set(weights={"tau": 7.0})
    other.export(file, overwrite=True)
    assert not session.may_write(file)
    assert other.may_write(file)


def test_an_export_of_an_earlier_configuration_leaves_the_last_run(session, tmp_path):
    session.set(weights={"tau": 1.0})
    earlier = session.config
    session.set(weights={"tau": 9.0})
    session.fit_clip()
    session.export(tmp_path / "tau1.toml", config=earlier)
    assert read_config(tmp_path / "tau1.toml").changed(provenance=None) == earlier
    assert session.run.config == session.config
    assert [str(item) for item in session.unexported] == ["weights.tau: 1 → 9"]


def test_the_proposed_name_is_free(tmp_path):
    for name in ("clip-tuned.toml", "clip-tuned-2.toml"):
        (tmp_path / name).touch()
    assert free_file(tmp_path, "clip") == tmp_path / "clip-tuned-3.toml"


def test_a_diagnosis_repeats_why_the_run_flags_the_frame(head, clip):
    observations = list(clip.observations)
    landmarks = observations[6].landmarks
    observations[6] = replace(
        observations[6], landmarks=replace(landmarks, points=landmarks.points + np.array([60.0, 0.0]))
    )
    session = TuningSession(head, replace(clip, observations=tuple(observations)), QUICK)
    assert session.diagnose(6).flag == ""  # no run that could flag it
    session.fit_clip()
    assert "the pose jumps" in session.run.flags.text[6]
    assert session.diagnose(6).flag == session.run.flags.text[6]
    assert session.diagnose(12).flag == ""


def test_the_summary_of_a_flagged_frame_without_a_reason_says_why_it_was_flagged(session):
    session.fit_clip()
    found = replace(session.diagnose(3), reasons=(), flag="the pose jumps (10°, 10 mm)")
    assert "flagged: the pose jumps (10°, 10 mm)" in found.summary
    assert "unremarkable" not in found.summary
    assert "unremarkable" in replace(found, flag="").summary


def test_what_changed_since_the_export_is_known(session, tmp_path):
    session.set(weights={"tau": 3.0})
    assert len(session.unexported) == 1
    session.export(tmp_path / "tuned.toml")
    assert session.unexported == []
    session.set(weights={"tau": 4.0})
    assert [item.path for item in session.unexported] == ["weights.tau"]


def test_a_photo_of_another_shape_is_fitted(head):
    scene = make_scene(head)
    landmarks = Landmarks2D(scene.points, np.ones(68), IMAGE_SIZE)
    session = TuningSession(head, material_of_photo(np.zeros((480, 640, 3), np.uint8), landmarks))
    assert session.fit_frame(0).errors[1] < 1.0


def test_threads_that_calibrate_at_the_same_time_all_come_to_an_end(head, clip):
    config = preset("calibrated").changed(identity={"window": 12, "frames": 12})
    observations = [observation for observation in clip.observations if observation.landmarks is not None][:12]
    identities = []

    def calibrate() -> None:
        for _ in range(3):
            identities.append(FaceItFitter(head, plan_of(config)).calibrate(observations, 12).identity)

    threads = [threading.Thread(target=calibrate, daemon=True) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=120)
    assert not any(thread.is_alive() for thread in threads)
    assert all(np.array_equal(identity, identities[0]) for identity in identities)
