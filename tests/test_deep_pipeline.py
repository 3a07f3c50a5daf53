"""Deep Energies over whole inputs: files, parts, several processes, interruptions, several cameras."""

import json
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from tests.killed_runs import make_fit
from tests.stereo_scenes import make_rig, make_stereo_scene
from workbench.cli import app
from workbench.config import preset, read_config
from workbench.errors import InputError, LostSchedulerError, OutputError
from workbench.frames import VideoWriter
from workbench.geometry import write_rig
from workbench.landmarks.alignment import MEAN_SHAPE
from workbench.landmarks.detection import FaceDetection
from workbench.landmarks.files import LandmarkCsvWriter
from workbench.landmarks.network_detector import BUNDLED
from workbench.landmarks.observations import Landmarks2D
from workbench.pipeline import DEEP_OUTPUTS, OUTPUTS, track
from workbench.pipeline.deep_run import ShownFrames
from workbench.pipeline.deep_sources import open_deep_source
from workbench.samples import sample
from workbench.session import material_of_track, observed_frames, open_session
from workbench.session.observed_frames import ObservedFrames
from workbench.tracking import FrameObservation, Track
from workbench.workers import Failed, workers_for

FRAMES = (4, 7)
QUICK = {"identity": {"window": 2, "frames": 2}, "camera": {"fov_deg": 33.0}}


@pytest.fixture(scope="module")
def config():
    return preset("deep").changed(**QUICK)


@pytest.fixture(scope="module")
def run(head, config, tmp_path_factory):
    """Four frames of the sample clip, from its stored detections."""
    folder = tmp_path_factory.mktemp("deep") / "run"
    return track(sample("performance"), folder, head, config, landmarks=sample("performance-landmarks"), frames=FRAMES)


@pytest.fixture(scope="module")
def stereo(head, tmp_path_factory):
    """Landmark files of three frames before two cameras, with the rig; the reference misses the last frame."""
    folder = tmp_path_factory.mktemp("stereo")
    rig = make_rig((-15.0, 15.0))
    scene = make_stereo_scene(head, rig, frames=3, sliding=True)
    write_rig(rig, folder / "rig.toml")
    files = {name: folder / f"{name}.csv" for name in rig.names}
    for view, name in enumerate(rig.names):
        with LandmarkCsvWriter(files[name], confidence=False) as writer:
            for record in scene.records(view, missing=(2,) if view == 0 else ()):
                writer.write(record)
    return folder / "rig.toml", scene, files


def same_numbers(first: Track, second: Track) -> bool:
    timeless = [name for name in vars(first) if name not in ("meta", "milliseconds")]
    return all(
        np.array_equal(getattr(first, name), getattr(second, name), equal_nan=getattr(first, name).dtype.kind == "f")
        for name in timeless
    )


def test_a_run_leaves_the_same_files_as_face_it_and_the_stages_of_some_frames(run):
    assert sorted(path.name for path in run.folder.iterdir()) == sorted([*OUTPUTS, *DEEP_OUTPUTS])
    strips = sorted(path.name for path in (run.folder / "stages").iterdir())
    assert strips == ["0000.jpg", "0001.jpg", "0002.jpg", "0003.jpg"]
    assert json.loads((run.folder / "summary.json").read_text())["frames_failed"] == {}


def test_a_run_that_is_worked_on_in_a_session_gives_its_own_numbers(run, head):
    """Its landmarks are what the energy's network saw, and not a detector's to look at anew."""
    session = open_session(run.track, model=head)
    session.fit_clip()
    again = session.track
    for name in ("observed", "rotation", "translation", "expression", "jaw", "identity"):
        np.testing.assert_allclose(getattr(again, name), getattr(run.track, name), rtol=0, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(("other", "looks"), [("own.safetensors", False), ("another.safetensors", True)])
def test_a_session_looks_anew_only_for_another_network_than_the_runs(run, head, tmp_path, monkeypatch, other, looks):
    """By which name a file is called does not matter."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(observed_frames, "energy_network", lambda name: name)
    asked = []
    monkeypatch.setattr(observed_frames, "photo_landmarks", lambda name, _, seen: asked.append(name) or seen)
    material = replace(material_of_track(run.track), network=str(tmp_path / "own.safetensors"))
    config = preset("deep").changed(deep={"network": other})
    ObservedFrames(material).observation(0, config)
    assert bool(asked) == looks


def test_the_pose_is_close_to_the_clip_s_truth(run):
    with np.load(sample("performance-truth"), allow_pickle=False) as truth:
        expected = truth["rotation"][FRAMES[0] : FRAMES[1] + 1]
    error = np.degrees(np.linalg.norm(run.track.rotation - expected, axis=1))
    assert len(error) == 4
    assert error.mean() < 3.5


@pytest.fixture(scope="module")
def quick(config):
    """Options of a run of the same frames with two steps a stage, and its configuration."""
    options = {"landmarks": sample("performance-landmarks"), "frames": FRAMES, "pictures": False}
    return config.changed(stages=[stage.model_dump() | {"limit": 2} for stage in config.stages]), options


@pytest.fixture(scope="module")
def whole(head, quick, tmp_path_factory):
    """What one process finds."""
    config, options = quick
    return track(sample("performance"), tmp_path_factory.mktemp("whole"), head, config, **options).track


def test_two_workers_find_the_same_numbers_though_one_is_killed(head, quick, whole, tmp_path):
    config, options = quick
    workers, killed = workers_for(2, kind="dask"), []

    def kill(step, done, total):
        if not killed:
            killed.append(next(iter(workers._cluster.workers.values())).pid)
            os.kill(killed[0], signal.SIGKILL)

    try:
        found = track(sample("performance"), tmp_path, head, config, workers=workers, progress=kill, **options)
    finally:
        workers.close()
    assert killed
    assert same_numbers(found.track, whole)


class Disturbed:
    """Workers that do one task here, and then fail."""

    said, count = "", 2

    def __init__(self, fail):
        self._fail = fail

    def results(self, tasks, do):
        yield 0, do(tasks[0])
        yield 1, self._fail()

    def close(self):
        pass


def raising(error):
    def fail():
        raise error

    return fail


def test_workers_in_another_folder_find_a_weights_file(head, quick, tmp_path, monkeypatch):
    shutil.copy(BUNDLED / "heat_maps.safetensors", tmp_path / "net.safetensors")
    monkeypatch.chdir(tmp_path)
    asked = []

    class Elsewhere(Disturbed):
        def results(self, tasks, do):
            asked.append(do.plan.deep.network)
            raise KeyboardInterrupt

    config = preset("deep-points").changed(**QUICK, deep={"network": "net.safetensors"})
    with pytest.raises(KeyboardInterrupt):
        track(sample("performance"), tmp_path / "run", head, config, workers=Elsewhere(None), **quick[1])
    assert asked == [str(tmp_path / "net.safetensors")]


def test_whatever_ends_a_run_it_goes_on_after_its_last_frame(head, quick, whole, tmp_path):
    config, options = quick
    done = []

    def go_on(workers):
        return track(
            sample("performance"), tmp_path, head, config, resume=True, workers=workers,
            progress=lambda step, count, total: done.append(count), **options,
        )  # fmt: skip

    with pytest.raises(InputError, match=r"Frame 1 ended the process\. Finished frames are kept; --resume"):
        go_on(Disturbed(lambda: Failed("Frame 1 ended the process.")))
    with pytest.raises(LostSchedulerError):
        go_on(Disturbed(raising(LostSchedulerError("The scheduler is gone."))))
    with pytest.raises(KeyboardInterrupt):
        go_on(Disturbed(raising(KeyboardInterrupt)))
    resumed = go_on(1)
    assert done == [1, 2, 3, 4]
    assert same_numbers(resumed.track, whole)


@pytest.mark.long
def test_a_run_that_goes_on_shows_the_stages_of_frames_before_and_after_its_interruption(head, quick, tmp_path):
    config, options = quick
    options = {**options, "pictures": True}

    def interrupt(step, done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track(sample("performance"), tmp_path, head, config, progress=interrupt, **options)
    track(sample("performance"), tmp_path, head, config, resume=True, **options)
    assert sorted(path.name for path in (tmp_path / "stages").iterdir()) == [f"000{index}.jpg" for index in range(4)]


@pytest.mark.parametrize(("count", "most"), [(None, 12), (100, 12), (500, 3)])
def test_the_frames_whose_stages_are_shown_are_spread_evenly_whatever_is_known_of_their_number(count, most):
    shown = ShownFrames(count)
    for index in range(100):
        fit = replace(make_fit(index, [0.0]), found=index != 41, failure="blurred" if index in (33, 41) else "")
        shown.add((FrameObservation(index, None, (64, 48)), None), fit)
    places = [observation.index for observation, _ in shown.pairs]
    chosen, failed = places[:-2], places[-2:]
    assert failed == [33, 41]
    assert most / 2 <= len(chosen) <= most
    assert chosen[0] == 0
    (spacing,) = set(np.diff(chosen))
    assert 100 - chosen[-1] <= spacing


def test_two_cameras_find_the_place_of_the_head_and_one_may_miss_it(head, stereo, tmp_path):
    rig, scene, files = stereo
    config = preset("deep-points").changed(camera={"rig": str(rig)}, identity={"calibrate": False})
    result = track(files["middle"], tmp_path, head, config, views={"side": files["side"]})
    truth = np.array([np.asarray(parameters.translation) for parameters in scene.parameters])
    errors = np.linalg.norm(result.track.translation - truth, axis=1)
    assert result.track.found.all()
    assert errors[:2].max() < 4.0
    assert np.isfinite(errors[2])


def test_a_rig_belongs_to_its_run_and_may_be_moved(head, stereo, tmp_path):
    _, _, files = stereo
    rig, folder = tmp_path / "rig.toml", tmp_path / "run"
    write_rig(make_rig((-15.0, 15.0)), rig)
    config = preset("deep-points").changed(camera={"rig": str(rig)}, identity={"calibrate": False})
    options = {"views": {"side": files["side"]}, "pictures": False}
    track(files["middle"], folder, head, config, **options)
    assert "already finished" in track(files["middle"], folder, head, config, resume=True, **options).notes[0]
    write_rig(make_rig((-15.0, 16.0)), rig)
    with pytest.raises(OutputError, match="another input or configuration"):
        track(files["middle"], folder, head, config, resume=True, **options)
    moved = rig.rename(tmp_path / "moved.toml")
    refining = ["refine", str(folder), "--method", "averaging", "--no-pictures"]
    result = CliRunner().invoke(app, refining)
    assert f"The rig of this track is no longer at {rig}; name it with --rig." in str(result.exception)
    assert CliRunner().invoke(app, [*refining, "--rig", str(moved)]).exit_code == 0
    assert Track.load(tmp_path / "run-refine" / "track.npz").meta["config"]["camera"]["rig"] == str(moved)


@pytest.fixture(scope="module")
def project(stereo, tmp_path_factory):
    """A folder with clips, rig and the run `rg`, which was begun in it by relative names."""
    folder = tmp_path_factory.mktemp("project")
    for path in (stereo[0], *stereo[2].values()):
        shutil.copy(path, folder)
    command = ["track", "middle.csv", "--rig", "rig.toml", "--view", "side=side.csv", "--preset", "deep-points"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        done = CliRunner().invoke(app, [*command, "--no-identity", "--no-pictures", "--out", "rg"])
    assert done.exit_code == 0, done.output
    return folder


def refined(run):
    return CliRunner().invoke(app, ["refine", str(run), "--method", "averaging", "--no-pictures", "--overwrite"])


def test_the_rig_of_a_run_is_found_from_another_folder(project, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert refined(project / "rg").exit_code == 0


def test_the_rig_of_an_older_run_is_found_from_another_folder(project, tmp_path, monkeypatch):
    """Its configuration names the rig as it was named then."""
    old = Track.load(shutil.copytree(project / "rg", tmp_path / "rg") / "track.npz")
    old.meta["config"]["camera"]["rig"] = "rig.toml"
    old.save(tmp_path / "rg" / "track.npz")
    monkeypatch.chdir(tmp_path)
    assert refined("rg").exit_code == 0


@pytest.fixture
def moved(project, tmp_path, monkeypatch):
    """The project in another folder, which is worked in, as if it were no longer where it was."""
    folder = Path(shutil.copytree(project, tmp_path / "moved"))
    stored = Track.load(folder / "rg" / "track.npz")
    gone = json.dumps(stored.meta).replace(str(project), "/nowhere/project")
    replace(stored, meta=json.loads(gone)).save(folder / "rg" / "track.npz")
    monkeypatch.chdir(folder)
    return folder


def test_the_rig_of_a_folder_that_was_moved_is_found_in_it(moved):
    assert refined("rg").exit_code == 0
    assert read_config("rg-refine/config.toml").camera.rig == str(moved / "rig.toml")


def test_the_configuration_of_a_folder_that_was_moved_names_files_in_it(moved):
    assert (moved / read_config("rg/config.toml").camera.rig).exists()


def test_a_run_that_was_begun_with_a_rig_by_another_name_of_it_goes_on(project, head, monkeypatch):
    monkeypatch.chdir(project)
    config = preset("deep-points").changed(camera={"rig": "rig.toml"}, identity={"calibrate": False})
    options = {"views": {"side": project / "side.csv"}, "pictures": False, "resume": True}
    assert "already finished" in track("middle.csv", "rg", head, config, **options).notes[0]


def test_a_rig_that_is_edited_while_a_run_reads_it_ends_the_run(project, head, tmp_path):
    rig = Path(shutil.copy(project / "rig.toml", tmp_path))
    config = preset("deep-points").changed(camera={"rig": str(rig)}, identity={"calibrate": False})
    options = {"views": {"side": project / "side.csv"}, "pictures": False}
    with pytest.raises(InputError, match=r"rig\.toml was changed while this run read it"):
        track(
            project / "middle.csv", tmp_path / "new", head, config, **options,
            progress=lambda *_: write_rig(make_rig((-15.0, 16.0)), rig),
        )  # fmt: skip


def test_views_that_do_not_fit_the_rig_are_named(head, stereo, tmp_path):
    rig, _, files = stereo
    single = preset("deep-points")
    config = single.changed(camera={"rig": str(rig)})
    side = {"side": files["side"]}
    with pytest.raises(InputError, match="needs the clip of its view 'side'"):
        track(files["middle"], tmp_path, head, config)
    with pytest.raises(InputError, match="has no view 'top'"):
        track(files["middle"], tmp_path, head, config, views={"top": files["side"]})
    with pytest.raises(InputError, match="name the rig file"):
        track(files["middle"], tmp_path, head, single, views=side)
    with pytest.raises(InputError, match="belong to Deep Energies"):
        track(files["middle"], tmp_path, head, preset("joint"), workers=2)
    write_rig(make_rig((-15.0, 15.0), image_size=(640, 640)), tmp_path / "square.toml")
    square = single.changed(camera={"rig": str(tmp_path / "square.toml")})
    with pytest.raises(InputError, match="are not scaled copies of view 'middle'"):
        track(files["middle"], tmp_path, head, square, views=side)


class TwoFaces:
    """A detector that sees a small face and a large one in every picture."""

    name = "network"

    def detect_faces(self, picture, effort="full"):
        return [FaceDetection((10.0, 20.0, 40.0, 50.0), 1.0), FaceDetection((60.0, 20.0, 140.0, 100.0), 1.0)]

    def align(self, picture, box):
        left, top, right, bottom = box
        points = np.array([left + right, top + bottom]) / 2 + (right - left) * MEAN_SHAPE
        return Landmarks2D(points, np.ones(68), picture.shape[1::-1])

    def refine(self, picture, points):
        return Landmarks2D(points, np.ones(68), picture.shape[1::-1])


def test_a_session_says_that_it_holds_one_camera(head, stereo, config):
    session = open_session(stereo[2]["middle"], config.changed(camera={"rig": str(stereo[0])}), model=head)
    with pytest.raises(InputError, match=r"a session takes one camera: leave camera\.rig out there"):
        session.fit_frame(0)


def test_views_of_different_frame_rates_are_told(stereo, config, tmp_path):
    clips = {name: tmp_path / f"{name}.mp4" for name in stereo[2]}
    for path, rate in zip(clips.values(), (25, 50), strict=True):
        with VideoWriter(path, rate) as film:
            for _ in range(3):
                film.write(np.zeros((480, 640, 3), np.uint8))
    reference, *others = clips
    rig = config.changed(camera={"rig": str(stereo[0])}, landmarks={"detector": "network"})
    source = open_deep_source([clips[reference]], rig, None, None, {name: clips[name] for name in others})
    assert any("different frame rates" in note and "25" in note and "50" in note for note in source.notes())


def test_the_face_is_chosen_in_the_first_view_alone(stereo, tmp_path, monkeypatch):
    """Its pixel says nothing of another camera's picture."""
    monkeypatch.setattr("workbench.pipeline.picture_source.make_detector", lambda *_: TwoFaces())
    monkeypatch.setattr("workbench.pipeline.deep_sources.photo_landmarks", lambda network, picture, seen: seen)
    cv2.imwrite(str(tmp_path / "photo.png"), np.full((120, 160, 3), 90, np.uint8))
    config = preset("deep-points").changed(camera={"rig": str(stereo[0])}, landmarks={"face": (25.0, 35.0)})
    source = open_deep_source([tmp_path / "photo.png"], config, None, views={"side": tmp_path / "photo.png"})
    (seen,) = source.observations(0, {}, stills=True)
    middles = [landmarks.points[:, 0].mean() for landmarks in (seen.landmarks, *seen.others)]
    assert middles == pytest.approx([25.0, 100.0], abs=5.0)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--energy", "deep"], "--energy belongs to Deep Energies"),
        (["--network", "dense"], "--network belongs to Deep Energies"),
        (["--rig", "gone.toml"], "gone.toml does not exist; check the name and the folder"),
        (["--frames", "9-3"], "first and last frame as A-B"),
        (["--frames", "500-600"], "frames 0 to 239"),
        (["--preset", "deep", "--view", "right"], "NAME=CLIP"),
        (["--preset", "deep", "--rig", "nowhere.toml"], "nowhere.toml"),
        (["--preset", "deep", "--scheduler", "tcp://127.0.0.1:9"], "127.0.0.1:9 cannot be reached"),
    ],
)
def test_the_command_line_says_what_is_wrong(options, sentence, tmp_path, monkeypatch):
    monkeypatch.setattr("workbench.workers.dask_workers.REACH_S", 1.0)
    result = CliRunner().invoke(app, ["track", str(sample("performance")), "--out", str(tmp_path), *options])
    message = " ".join((result.output + str(result.exception or "")).split())
    assert result.exit_code != 0
    assert sentence in message


def test_a_part_of_a_clip_is_tracked_by_either_system(head, tmp_path):
    result = track(
        sample("performance"), tmp_path, head, preset("joint").changed(**QUICK),
        landmarks=sample("performance-landmarks"), frames=FRAMES, pictures=False,
    )  # fmt: skip
    assert len(result.track) == 4
    assert result.track.meta["frames"] == [4, 7]
