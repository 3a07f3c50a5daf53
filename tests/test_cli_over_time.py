"""`workbench infill|refine|reestimate` on stored tracks, and the same inside of `track`."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.films import FOV_DEG
from workbench.config import preset, read_config
from workbench.errors import InputError
from workbench.face.default_head import EARLIER_EDITIONS
from workbench.frames import VideoWriter
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord
from workbench.landmarks.observations import Landmarks2D
from workbench.pipeline import config_of, retrack, temporal_run, track
from workbench.tracking import Track
from workbench.tracking.records import SOURCES
from workbench.tracking.track_writer import TrackWriter

COUNT = 12
MISSING = (5, 6)
QUICK = ("--no-pictures",)


def motion(index: int):
    return {"jawOpen": 0.05 * index}, (index - 6.0, 0.0, 0.0), (0.5 * index, 0.0, 0.0)


@pytest.fixture(scope="module")
def clip(film_maker, tmp_path_factory):
    """A video and its landmark file with two frames in which nothing was found."""
    folder = tmp_path_factory.mktemp("clip")
    film = film_maker.film(COUNT, motion)
    with VideoWriter(folder / "clip.mp4") as writer:
        for picture in film.pictures:
            writer.write(picture)
    size = film.pictures[0].shape[1::-1]
    with LandmarkCsvWriter(folder / "points.csv", confidence=False) as table:
        for fit in film.truth:
            found = None if fit.index in MISSING else Landmarks2D(fit.observed, np.ones(68), size)
            table.write(LandmarkRecord(fit.index, f"f{fit.index}", found, size))
    return folder


@pytest.fixture(scope="module")
def config():
    return preset("joint").changed(
        camera={"fov_deg": FOV_DEG}, identity={"calibrate": False}, flow={"side": 192, "points": 300}
    )


@pytest.fixture(scope="module")
def finished(head, clip, config):
    """A run on the clip."""
    track(clip / "clip.mp4", clip / "talk", head, config, landmarks=clip / "points.csv", pictures=False)
    return clip / "talk"


@pytest.fixture
def talk(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "talk")


def test_infill_writes_a_new_track_with_its_tables(run, talk, tmp_path):
    code, out, err = run("infill", "talk", *QUICK)
    assert (code, err) == (0, "")
    assert "2 frames from their neighbours" in out
    made = tmp_path / "talk-infill"
    assert {path.name for path in made.iterdir()} == {
        "track.npz", "summary.json", "parameters.csv", "landmarks.csv", "config.toml"
    }  # fmt: skip
    before, after = Track.load(talk / "track.npz"), Track.load(made / "track.npz")
    assert np.flatnonzero(~before.found).tolist() == list(MISSING)
    assert after.found.all()
    assert np.flatnonzero(after.source == SOURCES.index("filled")).tolist() == list(MISSING)
    assert np.array_equal(after.rotation[:5], before.rotation[:5])
    assert after.meta["steps"] == ["infill"]
    assert after.meta["track"]["path"].endswith("track.npz")
    assert read_config(made / "config.toml").infill.method == "flow"
    assert json.loads((made / "summary.json").read_text())["frames_filled"] == 2


def test_a_track_that_is_replaced_leaves_no_film_behind(run, talk, tmp_path):
    assert run("infill", "talk", *QUICK)[0] == 0
    before = sorted(path.name for path in (tmp_path / "talk-infill").iterdir())
    (tmp_path / "talk-infill" / "overlay.mp4").write_text("of an earlier track")
    assert run("infill", "talk", "--method", "linear", "--overwrite", *QUICK)[0] == 0
    assert sorted(path.name for path in (tmp_path / "talk-infill").iterdir()) == before


def test_filled_frames_lie_on_the_way(run, talk, tmp_path, film_maker):
    assert run("infill", "talk", "--out", "made", *QUICK)[0] == 0
    track = Track.load(tmp_path / "made" / "track.npz")
    yaw = track.angles_deg[:, 0]
    assert np.diff(yaw)[4:7] == pytest.approx(np.diff(yaw).mean(), abs=0.4)


def test_named_frames_are_filled_although_they_have_a_fit(run, talk, tmp_path):
    code, _, err = run("infill", "talk", "--frames", "2-3", "--frames", "9", "--method", "linear", *QUICK)
    assert (code, err) == (0, "")
    after = Track.load(tmp_path / "talk-infill" / "track.npz")
    assert np.flatnonzero(after.source == SOURCES.index("filled")).tolist() == [2, 3, 5, 6, 9]
    assert read_config(tmp_path / "talk-infill" / "config.toml").infill.frames == ((2, 3), (9, 9))


def test_refine_and_reestimate_follow_each_other(run, talk, tmp_path):
    assert run("refine", "talk", "--method", "averaging", *QUICK)[0] == 0
    assert run("reestimate", "talk-refine", "--out", "again", *QUICK)[0] == 0
    before, refined, again = (Track.load(tmp_path / name / "track.npz") for name in ("talk", "talk-refine", "again"))
    middle = 0.25 * before.translation[1] + 0.5 * before.translation[2] + 0.25 * before.translation[3]
    assert refined.translation[2] == pytest.approx(middle)
    assert np.allclose(again.rotation, refined.rotation, equal_nan=True)
    assert not np.allclose(again.expression[2], refined.expression[2])
    assert again.meta["steps"] == ["refine", "reestimate"]


def test_a_run_with_infill_and_refinement_is_the_same_as_one_after_the_other(run, talk, clip, config, tmp_path):
    given = ("--landmarks", str(clip / "points.csv"), "--config", "c.toml", "--out", "whole")
    from workbench.config import write_config

    write_config(config, tmp_path / "c.toml")
    chosen = ("--infill", "flow", "--refine", "hybrid")
    code, out, err = run("track", str(clip / "clip.mp4"), *given, *chosen, *QUICK)
    assert (code, err) == (0, "")
    assert "unrefined.npz" in out
    assert run("infill", "talk", "--out", "filled", *QUICK)[0] == 0
    assert run("refine", "filled", "--out", "refined", *QUICK)[0] == 0
    whole, parts = (Track.load(tmp_path / name / "track.npz") for name in ("whole", "refined"))
    single, raw = Track.load(tmp_path / "whole" / "unrefined.npz"), Track.load(talk / "track.npz")
    for name in ("rotation", "translation", "expression", "projected"):
        assert np.array_equal(getattr(whole, name), getattr(parts, name)), name
        assert np.array_equal(getattr(single, name), getattr(raw, name), equal_nan=True), name


def test_moved_pictures_are_named(run, talk, clip, tmp_path):
    meta = Track.load(talk / "track.npz").meta
    meta["inputs"][0]["path"] = "/nowhere/clip.mp4"
    track = Track.load(talk / "track.npz")
    type(track)(**{**vars(track), "meta": meta}).save(talk / "track.npz")
    code, _, err = run("infill", "talk", *QUICK)
    assert code == 2
    assert "no longer at /nowhere/clip.mp4; name them with --clip" in err.replace("\n", " ")
    assert not (tmp_path / "talk-infill").exists()
    assert run("infill", "talk", "--clip", str(clip / "clip.mp4"), *QUICK)[0] == 0


def test_without_the_pictures_a_method_that_looks_at_none_draws_no_film_and_says_so(run, talk, tmp_path):
    meta = Track.load(talk / "track.npz").meta
    meta["inputs"][0]["path"] = "/nowhere/clip.mp4"
    track = Track.load(talk / "track.npz")
    type(track)(**{**vars(track), "meta": meta}).save(talk / "track.npz")
    code, out, _ = run("infill", "talk", "--method", "spline")
    assert code == 0
    assert "No film was drawn" in out
    assert not (tmp_path / "talk-infill" / "overlay.mp4").exists()
    code, _, err = run("infill", "talk", "--method", "spline", "--clip", "elsewhere.mp4", "--overwrite")
    assert code == 2
    assert "no longer at elsewhere.mp4" in err


def test_a_method_that_looks_at_no_pictures_opens_none_where_no_film_is_drawn(run, talk, monkeypatch):
    for needless in ("gone_pictures", "open_frames"):
        monkeypatch.setattr(temporal_run, needless, None)
    assert run("infill", "talk", "--method", "linear", *QUICK)[0] == 0


def test_a_run_on_landmarks_alone_refuses_a_method_that_needs_pictures_before_it_fits(run, clip, tmp_path):
    code, _, err = run("track", str(clip / "points.csv"), "--infill", "flow", "--out", "out", *QUICK)
    assert code == 2
    assert "'flow' needs the pictures, and the input has none; track the clip and name the file with" in err
    assert not (tmp_path / "out").exists()


def test_what_is_interrupted_while_its_film_is_drawn_leaves_nothing_to_go_on_with(
    run, talk, head, tmp_path, monkeypatch
):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    config = config_of(Track.load(talk / "track.npz").meta).changed(infill={"method": "linear"})
    monkeypatch.setattr("workbench.pipeline.runs.write_overlay_video", interrupted)
    with pytest.raises(KeyboardInterrupt):
        retrack(talk / "track.npz", tmp_path / "new", head, config, ["infill"])
    assert not (tmp_path / "new" / "track.npz.parts").exists()
    code, _, err = run("infill", "talk", "--method", "linear", "--out", "new", *QUICK)
    assert code == 2
    assert "--overwrite" in err
    assert "--resume" not in err


@pytest.mark.parametrize(
    "command",
    [("infill", "talk", "--method", "linear"), ("refine", "talk", "--method", "self"), ("reestimate", "talk")],
)
def test_what_was_killed_is_only_replaced_for_it_cannot_be_resumed(run, talk, tmp_path, command):
    (tmp_path / "new" / "track.npz.parts").mkdir(parents=True)
    code, _, err = run(*command, "--out", "new", *QUICK)
    said = "new already holds an interrupted run; name another folder, or replace it with --overwrite."
    assert (code, err.split()) == (2, f"error: {said}".split())


@pytest.mark.parametrize(
    ("cut", "again"),
    [("over_time", "repeat the command"), ("write_overlay_video", "repeat the command with --overwrite")],
)
def test_an_interruption_says_how_to_repeat_the_command(run, talk, monkeypatch, cut, again):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(f"workbench.pipeline.runs.{cut}", interrupted)
    code, _, err = run("infill", "talk", "--method", "linear", "--out", "new")
    assert (code, err.strip()) == (130, f"interrupted: the new track was not written; {again}")


def test_a_track_of_landmarks_alone_needs_methods_that_look_at_none(run, clip, head, config, tmp_path):
    track(clip / "points.csv", tmp_path / "points", head, config, pictures=False)
    code, _, err = run("infill", "points", *QUICK)
    assert code == 2
    assert "The method 'flow' needs the pictures, and there are none" in err
    assert run("infill", "points", "--method", "spline", *QUICK)[0] == 0
    assert run("refine", "points-infill", "--method", "self", *QUICK)[0] == 0


def test_a_track_without_inputs_needs_methods_that_look_at_no_pictures(run, talk):
    """As a live recording that was saved without its pictures."""
    track = Track.load(talk / "track.npz")
    type(track)(**{**vars(track), "meta": {**track.meta, "inputs": []}}).save(talk / "track.npz")
    code, _, err = run("refine", "talk", "--method", "plate", *QUICK)
    assert code == 2
    assert "The method 'plate' needs the pictures, and there are none" in " ".join(err.split())
    assert run("infill", "talk", "--method", "spline", *QUICK)[0] == 0


def test_a_track_without_its_configuration_is_refused(run, talk):
    track = Track.load(talk / "track.npz")
    meta = {name: value for name, value in track.meta.items() if name != "config"}
    type(track)(**{**vars(track), "meta": meta}).save(talk / "track.npz")
    code, _, err = run("infill", "talk", *QUICK)
    assert code == 2
    assert "does not hold the configuration it was made with; run the tracking again" in " ".join(err.split())


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("infill", "none"), "The track none does not exist"),
        (("infill", "talk", "--method", "magic"), "The method is one of flow, linear, spline, got 'magic'"),
        (("refine", "talk", "--method", "flow"), "averaging, self, plate, hybrid, got 'flow'"),
        (("infill", "talk", "--frames", "300-310"), "The track has frames 0 to 11, got --frames 300-310"),
        (("infill", "talk", "--frames", "9-2"), "first and last frame as A-B"),
        (("infill", "talk", "--out", "talk"), "holds the track itself"),
        (("infill", "talk", "--view", "right=x.mp4"), "The rig has no view 'right'"),
        (("refine", "talk", "--estimator", "magic"), "flow estimators are network, dis, farneback"),
        (("refine", "talk", "--order", "random"), "refinement.order"),
    ],
)
def test_mistakes_are_told_in_a_sentence(run, talk, arguments, sentence):
    code, _, err = run(*arguments)
    assert code == 2
    assert sentence in err.replace("\n", " ")
    assert "Traceback" not in err


def test_where_nothing_was_filled_it_says_what_to_try(run, talk):
    code, _, err = run("infill", "talk", "--method", "linear", "--longest", "1", *QUICK)
    assert code == 1
    assert "Nothing was filled" in err
    assert "--longest" in err


def test_where_all_frames_are_named_it_says_so(run, talk):
    code, _, err = run("infill", "talk", "--method", "linear", "--frames", "0-11", *QUICK)
    assert code == 1
    assert "the frames named have no usable fit next to them to fill from; name fewer" in " ".join(err.split())


@pytest.mark.parametrize("named", [".", "track.npz", "../talk", "sub/.."])
def test_a_track_named_from_inside_its_folder_has_its_result_beside_it(run, talk, tmp_path, monkeypatch, named):
    (talk / "sub").mkdir()
    monkeypatch.chdir(talk)
    assert run("refine", named, "--method", "averaging", *QUICK)[0] == 0
    assert (tmp_path / "talk-refine" / "track.npz").is_file()


def test_another_face_model_is_noticed(run, talk):
    track = Track.load(talk / "track.npz")
    meta = {**track.meta, "model": {"name": "other head", "sha256": "0" * 64}}
    type(track)(**{**vars(track), "meta": meta}).save(talk / "track.npz")
    code, _, err = run("infill", "talk", *QUICK)
    assert code == 2
    assert "made with the face model 'other head'" in err


@pytest.mark.parametrize("edition", range(2))
def test_a_track_of_the_head_as_it_was_goes_on(run, talk, edition):
    track = Track.load(talk / "track.npz")
    with_gaze = len(track.expression_names) == 52
    sha256 = [former for former, gaze in EARLIER_EDITIONS.items() if gaze == with_gaze][edition]
    meta = {**track.meta, "model": {**track.meta["model"], "sha256": sha256}}
    type(track)(**{**vars(track), "meta": meta}).save(talk / "track.npz")
    code, _, err = run("infill", "talk", *QUICK)
    assert code == 0, err


def test_unrelated_photos_have_no_neighbours(run, talk, clip):
    track = Track.load(talk / "track.npz")
    type(track)(**{**vars(track), "meta": {**track.meta, "stills": True}}).save(talk / "track.npz")
    code, _, err = run("infill", "talk", *QUICK)
    assert code == 2
    assert "holds unrelated photos" in err
    code, _, err = run("track", str(clip / "points.csv"), "--stills", "--infill", "linear", *QUICK)
    assert code == 2
    assert "no neighbours in time" in err


def test_an_interrupted_run_over_time_goes_on(head, clip, config, tmp_path, monkeypatch):
    """The single frames are kept; what is done over time begins again, with the same result."""
    from workbench.tracking import refinement

    changed = config.changed(infill={"method": "linear"}, refinement={"method": "averaging"})
    given = {"landmarks": clip / "points.csv", "pictures": False}
    with monkeypatch.context() as patch:
        patch.setattr(refinement, "averaged", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            track(clip / "clip.mp4", tmp_path / "cut", head, changed, **given)
    assert not (tmp_path / "cut" / "track.npz").exists()
    assert not (tmp_path / "cut" / "track.npz.parts").exists()
    track(clip / "clip.mp4", tmp_path / "cut", head, changed, resume=True, **given)
    track(clip / "clip.mp4", tmp_path / "whole", head, changed, **given)
    cut, whole = (Track.load(tmp_path / name / "track.npz") for name in ("cut", "whole"))
    assert np.array_equal(cut.rotation, whole.rotation)


def test_a_run_over_time_that_is_interrupted_between_its_two_tracks_goes_on(head, clip, config, tmp_path, monkeypatch):
    changed = config.changed(infill={"method": "linear"})
    given = {"landmarks": clip / "points.csv", "pictures": False, "resume": True}
    close = TrackWriter.close

    def cut(writer):
        if writer.path.name == "track.npz":
            raise KeyboardInterrupt
        close(writer)

    with monkeypatch.context() as patch:
        patch.setattr(TrackWriter, "close", cut)
        with pytest.raises(KeyboardInterrupt):
            track(clip / "clip.mp4", tmp_path, head, changed, **given)
    assert (tmp_path / "track.npz.parts").exists()
    assert not (tmp_path / "unrefined.npz.parts").exists()
    track(clip / "clip.mp4", tmp_path, head, changed, **given)
    assert Track.load(tmp_path / "track.npz").found.all()


@pytest.fixture
def own(clip, tmp_path):
    """A clip that a test may change."""
    return Path(shutil.copy(clip / "clip.mp4", tmp_path))


def replacing(path, *steps):
    """A progress that puts another file in a clip's place at the last frame of one of these steps."""
    other = path.read_bytes() + b"\0"
    return lambda step, done, total: path.write_bytes(other) if step in steps and done == COUNT else None


CHANGED = r"clip\.mp4 was changed while this run read it; once the file stays as it is, repeat the run with --overwrite"


def test_a_clip_that_is_replaced_before_its_film_is_drawn_ends_the_run(head, clip, config, own, tmp_path):
    """Else fits of one clip would be drawn on the pictures of another."""
    with pytest.raises(InputError, match=CHANGED):
        track(
            own,
            tmp_path / "new",
            head,
            config,
            landmarks=clip / "points.csv",
            progress=replacing(own, "overlay"),
        )
    assert not (tmp_path / "new" / "track.npz").exists()


def test_a_clip_that_is_replaced_before_the_film_of_a_new_track_ends_it(head, finished, config, own, tmp_path):
    averaged = config.changed(refinement={"method": "averaging"})
    with pytest.raises(InputError, match=CHANGED):
        retrack(
            finished / "track.npz",
            tmp_path / "new",
            head,
            averaged,
            ("refine",),
            clip=own,
            progress=replacing(own, "time"),
        )
    assert not list((tmp_path / "new").glob("track.npz*"))


def test_a_clip_that_is_replaced_after_its_frames_were_fitted_ends_the_run(head, clip, config, own, tmp_path):
    changed = config.changed(refinement={"method": "averaging"})
    given = {"landmarks": clip / "points.csv", "pictures": False, "progress": replacing(own, "refine")}
    with pytest.raises(InputError, match=CHANGED):
        track(own, tmp_path / "new", head, changed, **given)
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["unrefined.npz.parts"]
