"""Killed runs, full disks, outputs that are inputs: nothing that was there or was done is lost."""

import json
import os
import shutil
import subprocess
import sys
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np
import pytest

from tests.killed_runs import FRAMES, StubModel, StubTracker, make_fit
from tests.performances import performance
from tests.small_disk import small_disk
from tests.stereo_scenes import make_rig
from tests.test_pipeline import NoFaces
from workbench.cli.training import training_folder
from workbench.config import preset
from workbench.errors import InputError, OutputError
from workbench.export import FORMATS, export_track
from workbench.face.usual_expressions import Moments, write_moments
from workbench.files import atomic_path
from workbench.frames import VideoWriter, write_picture
from workbench.geometry import write_rig
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, write_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.networks.weights import write_weights
from workbench.pipeline import track
from workbench.pipeline.output_folder import locked
from workbench.pipeline.runs import _telling_what_is_kept
from workbench.samples import sample
from workbench.session.recording import Recording
from workbench.tracking.track_writer import FINGERPRINT, TrackWriter
from workbench.training import PLAN_FILE

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def points(tmp_path):
    """A landmark file of some frames."""
    path = tmp_path / "points.csv"
    with LandmarkCsvWriter(path, confidence=False) as writer:
        for index in range(FRAMES):
            places = np.random.default_rng(index).uniform(100.0, 400.0, (68, 2))
            writer.write(LandmarkRecord(index, "", Landmarks2D(places, np.ones(68), (640, 480)), None))
    return path


@pytest.fixture
def quick(monkeypatch):
    """Runs with a stub for tracker and model: all that they write is real."""
    monkeypatch.setattr("workbench.pipeline.runs.FaceTracker", StubTracker)

    def run(points, folder, **options):
        return track(points, folder, StubModel(), preset("calibrated"), pictures=False, **options)

    return run


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.long
def test_a_run_killed_at_any_write_resumes_to_the_same_numbers_and_leaves_nothing_behind(points, tmp_path):
    command = [sys.executable, "-m", "tests.killed_runs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    found = json.loads(done.stdout)
    assert found["writes"] > 50
    assert found["unequal"] == []
    assert found["left"] == {}


class TestPartsOfATrack:
    @pytest.fixture
    def parts(self, tmp_path):
        """The folder with three parts of two frames each."""
        writer = TrackWriter(tmp_path / "track.npz", {}, "a run")
        for index in range(6):
            writer.add(make_fit(index, [index, index]))
            if index % 2:
                writer.write_part({"frame": np.array(index)})
        return writer.parts_folder

    def resumed(self, parts):
        return TrackWriter(parts.with_name("track.npz"), {}, "a run", resume=True)

    @pytest.mark.parametrize("damage", ["cut", "empty", "flipped", "missing", "another's"])
    def test_a_damaged_part_is_dropped_with_all_behind_it(self, parts, damage):
        part = parts / "000001.npz"
        content = bytearray(part.read_bytes())
        if damage == "cut":
            part.write_bytes(content[: len(content) // 2])
        elif damage == "empty":
            part.write_bytes(b"")
        elif damage == "flipped":
            content[len(content) // 2] ^= 0xFF
            part.write_bytes(content)
        elif damage == "another's":
            part.write_bytes((parts / "000002.npz").read_bytes())
        else:
            part.unlink()
        writer = self.resumed(parts)
        assert len(writer) == 2
        assert writer.state()["frame"] == 1
        assert sorted(path.name for path in parts.iterdir()) == ["000000.npz", "fingerprint"]

    def test_what_a_killed_write_left_is_no_part(self, parts):
        (parts / ".000003.partial-a1b2c3d4.npz").write_bytes(b"half of a part")
        assert len(self.resumed(parts)) == 6
        assert len(list(parts.iterdir())) == 4

    def test_a_part_is_written_when_frames_take_long(self, parts, monkeypatch):
        writer = self.resumed(parts)
        assert not writer.wants_part()
        writer.add(make_fit(6, [6, 6]))
        assert not writer.wants_part()
        monkeypatch.setattr("workbench.tracking.track_writer.PART_SECONDS", 0.0)
        assert writer.wants_part()

    def test_frames_are_read_in_any_order(self, parts):
        writer = self.resumed(parts)
        for position in (5, 0, 3, 2, 4, 1):
            assert writer[position].index == position


class TestInputsAreNotWrittenOver:
    @pytest.mark.parametrize("how", ["path", "symbolic link", "hard link", "link to it"])
    @pytest.mark.parametrize("options", [{}, {"overwrite": True}, {"resume": True}], ids=str)
    def test_a_run_whose_output_is_its_input_is_refused(self, quick, points, tmp_path, how, options):
        folder = tmp_path / "out"
        folder.mkdir()
        named = points
        if how == "path":
            named = Path(shutil.move(points, folder / "landmarks.csv"))
        elif how == "symbolic link":
            (folder / "landmarks.csv").symlink_to(points)
        elif how == "hard link":
            os.link(points, folder / "landmarks.csv")
        else:
            shutil.move(points, folder / "landmarks.csv")
            points.symlink_to(folder / "landmarks.csv")
        before = content(folder)
        with pytest.raises(OutputError, match=r"landmarks.csv is an input.*would be overwritten; name another output"):
            quick(named, folder, **options)
        assert content(folder) == before

    def test_results_do_not_go_among_the_pictures(self, head, tmp_path):
        shutil.copy(sample("astronaut"), tmp_path)
        with pytest.raises(OutputError, match="is an input"):
            track(tmp_path, tmp_path, head, preset("calibrated"))
        assert len(list(tmp_path.iterdir())) == 1

    def test_results_in_a_folder_inside_of_the_pictures_can_be_resumed_and_replaced(self, quick, points, tmp_path):
        photos = tmp_path / "photos"
        photos.mkdir()
        for index in range(FRAMES):
            write_picture(photos / f"{index}.png", np.zeros((480, 640, 3), np.uint8))

        def interrupt(step, done, total):
            if done == 3:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            quick(photos, photos / "result", landmarks=points, stills=True, progress=interrupt)
        for options in ({"resume": True}, {"overwrite": True}):
            made = quick(photos, photos / "result", landmarks=points, stills=True, **options)
            assert len(made.track) == FRAMES

    def test_landmarks_of_an_earlier_call_are_no_picture_of_the_folder(self, run, tmp_path, monkeypatch):
        monkeypatch.setattr("workbench.pipeline.picture_source.make_detector", lambda *_: NoFaces())
        write_picture(tmp_path / "a.png", np.zeros((48, 64, 3), np.uint8))
        command = ("landmarks", ".", "--no-pictures")
        assert run(*command)[0] == 1
        assert "is an input" not in run(*command)[2]

    @pytest.mark.parametrize(
        "arguments",
        [
            ["track", "points.csv", "--out", "out", "--config", "out/config.toml"],
            ["track", "points.csv", "--out", "out", "--model", "out/track.npz"],
            ["landmarks", "talk.mp4", "--out", "talk.csv"],
            ["landmarks", "photos", "--out", "photos.csv"],
            ["export", "made", "--to", "talk.mp4"],
            ["export", "made", "--to", "talk.csv", "--to", "hero.glb", "--character", "hero.glb"],
            ["rig", "convert", "rig.toml"],
            ["rig", "show", "rig.toml", "--picture", "rig.png"],
            ["model", "show", "hero.glb", "--picture", "hero.png"],
            ["diagnose", "made", "--json", "talk.mp4"],
        ],
        ids=" ".join,
    )
    def test_every_command_that_writes_refuses_to_write_over_what_it_reads(
        self, run, quick, points, tmp_path, arguments
    ):
        for name in ("talk.mp4", "hero.glb"):
            shutil.copy(sample("performance"), tmp_path / name)
        (tmp_path / "rig.png").symlink_to("rig.toml")
        (tmp_path / "hero.png").symlink_to("hero.glb")
        (tmp_path / "photos").mkdir()
        shutil.copy(sample("astronaut"), tmp_path / "photos")
        quick(points, tmp_path / "out")
        made = quick(points, tmp_path / "made").track
        made.meta["inputs"] = [{"path": "talk.mp4", "sha256": ""}]
        made.save(tmp_path / "made" / "track.npz")
        write_rig(make_rig((-15.0, 15.0)), tmp_path / "rig.toml")
        before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        code, _, err = run(*arguments)
        assert code == 2
        assert "would be overwritten; name another output" in err.replace("\n", " ")
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before

    @pytest.mark.parametrize("source", ["out", "out/track.npz"])
    @pytest.mark.parametrize(
        "command",
        [
            "export {} --to out/parameters.csv",
            "export {} --to x.csv --to link.csv",
            "diagnose {} --json out/summary.json",
        ],
    )
    def test_a_commands_file_does_not_replace_a_result_of_the_run(self, run, quick, points, tmp_path, command, source):
        quick(points, tmp_path / "out")
        (tmp_path / "link.csv").symlink_to("out/landmarks.csv")
        before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
        code, _, err = run(*command.format(source).split())
        assert code == 2
        assert "is a result of the run" in err
        assert "would be overwritten; name another output" in err.replace("\n", " ")
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before

    @pytest.mark.parametrize("landmarks", [False, True])
    def test_an_input_is_kept_from_every_folder(self, run, quick, points, tmp_path, monkeypatch, landmarks):
        shutil.copy(sample("performance"), tmp_path / "talk.mp4")
        if landmarks:
            quick("talk.mp4", "out", landmarks=Path("points.csv"), frames=(0, 2))
        else:
            quick("points.csv", "out")
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir(tmp_path / "elsewhere")
        before = points.read_bytes()
        code, _, err = run("export", "../out", "--to", "../points.csv")
        assert code == 2
        assert "points.csv is an input" in err
        assert points.read_bytes() == before


class TestFinishedRuns:
    def test_a_finished_run_is_replaced_only_on_demand(self, quick, points, tmp_path):
        quick(points, tmp_path / "out")
        before = content(tmp_path / "out")
        with pytest.raises(OutputError, match="already holds a finished run; name another folder, or replace it with"):
            quick(points, tmp_path / "out")
        assert content(tmp_path / "out") == before
        assert len(quick(points, tmp_path / "out", overwrite=True, frames=(0, 2)).track) == 3

    def test_of_a_run_that_is_replaced_nothing_is_left(self, quick, points, tmp_path):
        """Else a later `--resume` would list its films and pictures as those of the new run."""
        quick(points, tmp_path / "out")
        for name in ("overlay.mp4", "unrefined.npz", "overlay/0000-a.jpg", "stages/0003.jpg", "stages/me.jpg"):
            (tmp_path / "out" / name).parent.mkdir(exist_ok=True)
            (tmp_path / "out" / name).write_text("of an earlier run")
        made = quick(points, tmp_path / "out", overwrite=True).files
        mine = tmp_path / "out" / "stages" / "me.jpg"
        assert {path for path in (tmp_path / "out").rglob("*") if path.is_file()} == {*made, mine}
        assert not (tmp_path / "out" / "overlay").exists()
        assert set(quick(points, tmp_path / "out", resume=True).files) == set(made)

    def test_a_finished_run_that_is_resumed_has_nothing_left_to_do(self, quick, points, tmp_path):
        whole = quick(points, tmp_path / "out")
        before = content(tmp_path / "out")
        again = quick(points, tmp_path / "out", resume=True)
        assert content(tmp_path / "out") == before
        assert "already finished" in again.notes[0]
        assert again.summary["frames"] == FRAMES
        assert set(again.files) == set(whole.files)

    def test_a_finished_run_of_something_else_is_not_resumed(self, quick, points, tmp_path):
        quick(points, tmp_path / "out")
        with pytest.raises(OutputError, match="a finished run of another input or configuration"):
            quick(points, tmp_path / "out", resume=True, frames=(0, 2))

    @pytest.fixture
    def begun(self, quick, points, tmp_path):
        """The folder of a run that was interrupted after its third frame."""

        def interrupt(step, done, total):
            if done == 3:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            quick(points, tmp_path / "out", progress=interrupt)
        return tmp_path / "out"

    def test_an_interrupted_run_is_not_thrown_away_unasked(self, quick, points, begun):
        with pytest.raises(OutputError, match="holds an interrupted run; continue it with --resume"):
            quick(points, begun)
        assert len(quick(points, begun, resume=True).track) == FRAMES

    def test_an_interrupted_run_of_something_else_is_not_thrown_away_by_resume(self, quick, points, begun):
        before = content(begun / "track.npz.parts")
        with pytest.raises(OutputError, match="an interrupted run of another input or configuration; name another"):
            quick(points, begun, resume=True, frames=(0, 2))
        assert content(begun / "track.npz.parts") == before
        assert len(quick(points, begun, resume=True, overwrite=True, frames=(0, 2)).track) == 3

    def test_a_finished_run_beside_the_parts_of_another_does_not_throw_these_away(self, quick, points, tmp_path):
        quick(points, tmp_path / "out", frames=(0, 2))
        with pytest.raises(KeyboardInterrupt):
            quick(
                points, tmp_path / "out", overwrite=True, progress=lambda *_: (_ for _ in ()).throw(KeyboardInterrupt)
            )
        before = content(tmp_path / "out" / "track.npz.parts")
        with pytest.raises(OutputError, match="an interrupted run of another input"):
            quick(points, tmp_path / "out", resume=True, frames=(0, 2))
        assert content(tmp_path / "out" / "track.npz.parts") == before
        assert len(quick(points, tmp_path / "out", resume=True).track) == FRAMES

    @pytest.mark.parametrize("finished", [False, True])
    def test_a_run_begun_with_other_versions_says_so(self, quick, points, tmp_path, monkeypatch, finished):
        versions = {"workbench": "1.0", "jax": "0.7"}
        monkeypatch.setattr("workbench.pipeline.runs.software_versions", lambda: dict(versions))

        def interrupt(step, done, total):
            if done == 3 and not finished:
                raise KeyboardInterrupt

        with suppress(KeyboardInterrupt):
            quick(points, tmp_path / "out", progress=interrupt)
        versions["jax"] = "0.8"
        with pytest.raises(
            OutputError, match=r"run that was started with other versions \(jax 0\.7, now 0\.8\); install"
        ):
            quick(points, tmp_path / "out", resume=True)
        with pytest.raises(OutputError, match="of another input or configuration"):
            quick(points, tmp_path / "out", resume=True, frames=(0, 2))
        versions["jax"] = "0.7"
        assert len(quick(points, tmp_path / "out", resume=True).track) == FRAMES

    def test_resume_goes_before_overwrite_and_says_how_to_repeat(self, quick, points, tmp_path):
        quick(points, tmp_path / "out")
        (note,) = quick(points, tmp_path / "out", resume=True, overwrite=True).notes
        assert "--overwrite without --resume repeats it" in note

    @pytest.mark.parametrize("meta", ['{"a": 1}', "[1]", "null", "no JSON"])
    def test_parts_that_say_nothing_of_their_run_are_those_of_another(self, quick, points, begun, meta):
        (begun / "track.npz.parts" / FINGERPRINT).write_text(f"another\n{meta}")
        before = content(begun / "track.npz.parts")
        with pytest.raises(OutputError, match="an interrupted run of another input or configuration"):
            quick(points, begun, resume=True)
        assert content(begun / "track.npz.parts") == before

    def test_a_run_goes_on_where_it_was_begun_by_relative_names(self, quick, points, begun, monkeypatch):
        """As an older workbench began it."""
        monkeypatch.chdir(points.parent)
        note = begun / "track.npz.parts" / FINGERPRINT
        note.write_text("another\n" + note.read_text().partition("\n")[2].replace(str(points), points.name))
        fitted = []
        made = quick(points.name, begun, resume=True, progress=lambda step, done, total: fitted.append(done))
        assert fitted[0] == 4
        assert made.track.meta["inputs"][0]["path"] == str(points)

    def test_a_run_goes_on_in_a_folder_that_was_moved_with_its_input(self, quick, points, begun, tmp_path):
        (tmp_path / "moved").mkdir()
        points, begun = (path.rename(tmp_path / "moved" / path.name) for path in (points, begun))
        fitted = []
        quick(points, begun, resume=True, progress=lambda step, done, total: fitted.append(done))
        assert fitted[0] == 4

    def test_a_refusal_says_once_how_to_go_on(self, run, points, begun, monkeypatch):
        monkeypatch.setattr("workbench.cli.tracking.face_model", lambda path: StubModel())
        command = ("track", "points.csv", "--no-pictures", "--out", "out")
        err = run(*command)[2]
        assert err.count("--resume") == 1
        assert "Finished parts" not in err
        with locked(begun):
            assert "--resume" not in run(*command, "--resume")[2]

    def test_other_files_of_the_same_names_are_not_replaced_unasked(self, quick, points, tmp_path):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "config.toml").write_text("mine")
        with pytest.raises(OutputError, match=r"already holds a file config.toml"):
            quick(points, tmp_path / "out")

    def test_the_command_line_has_the_same_choice(self, run, quick, points, monkeypatch):
        monkeypatch.setattr("workbench.cli.tracking.face_model", lambda path: StubModel())
        assert run("track", "points.csv", "--no-pictures")[0] == 0
        code, _, err = run("track", "points.csv", "--no-pictures")
        assert code == 2
        assert "already holds a finished run" in err
        assert run("track", "points.csv", "--no-pictures", "--overwrite")[0] == 0
        assert "already finished" in run("track", "points.csv", "--no-pictures", "--resume")[1]


class TestInputsThatChangeMeanwhile:
    """At its third frame something happens to what a run reads."""

    @staticmethod
    def at_the_third(happens):
        return lambda step, done, total: happens() if done == 3 else None

    @pytest.fixture
    def replaced(self, points):
        """Puts other landmarks in the file's place, and the file's own content."""
        own = points.read_bytes()
        other = own.replace(b",1", b",2")
        return lambda: points.write_bytes(other), own

    def test_a_run_whose_input_is_replaced_ends_and_leaves_nothing(self, quick, points, replaced, tmp_path):
        with pytest.raises(InputError, match=r"points\.csv was changed while this run read it; .* with --overwrite"):
            quick(points, tmp_path / "out", progress=self.at_the_third(replaced[0]))
        assert not (tmp_path / "out").exists()

    def test_it_goes_on_with_the_parts_of_before_where_the_input_is_put_back(
        self, quick, points, replaced, tmp_path, monkeypatch
    ):
        monkeypatch.setattr("workbench.tracking.track_writer.PART_FRAMES", 2)
        whole = quick(points, tmp_path / "whole").track
        with pytest.raises(InputError, match="was changed"):
            quick(points, tmp_path / "cut", progress=self.at_the_third(replaced[0]))
        with pytest.raises(OutputError, match="an interrupted run of another input"):
            quick(points, tmp_path / "cut", resume=True)
        points.write_bytes(replaced[1])
        fitted = []
        resumed = quick(points, tmp_path / "cut", resume=True, progress=lambda *step: fitted.append(step[1])).track
        assert fitted[0] == 3
        assert np.array_equal(resumed.expression, whole.expression)

    def test_an_interruption_keeps_no_frame_that_may_be_of_another_file(self, quick, points, replaced, tmp_path):
        def change_and_stop():
            replaced[0]()
            raise KeyboardInterrupt

        with pytest.raises(InputError, match="was changed"):
            quick(points, tmp_path / "out", progress=self.at_the_third(change_and_stop))
        assert not (tmp_path / "out").exists()

    def test_a_finished_run_is_not_thrown_away_for_one_whose_input_changed(self, quick, points, replaced, tmp_path):
        quick(points, tmp_path / "out", frames=(0, 1))
        before = content(tmp_path / "out")
        with pytest.raises(InputError, match="was changed"):
            quick(points, tmp_path / "out", overwrite=True, progress=self.at_the_third(replaced[0]))
        assert content(tmp_path / "out") == before

    @pytest.mark.parametrize("happens", [Path.touch, Path.unlink])
    def test_a_file_that_is_touched_or_gone_ends_no_run(self, quick, points, tmp_path, happens):
        made = quick(points, tmp_path / "out", progress=self.at_the_third(lambda: happens(points)))
        assert len(made.track) == FRAMES

    @pytest.mark.parametrize(("name", "changes"), [("notes.txt", False), ("new.png", False), ("4.png", True)])
    def test_of_a_folder_its_pictures_count(self, quick, points, tmp_path, name, changes):
        photos = tmp_path / "photos"
        for index in range(FRAMES):
            write_picture(photos / f"{index}.png", np.zeros((480, 640, 3), np.uint8))
        (photos / "notes.txt").write_text("of before")
        given = {
            "landmarks": points,
            "stills": True,
            "progress": self.at_the_third(lambda: shutil.copy(sample("astronaut"), photos / name)),
        }
        with pytest.raises(InputError, match=r"4\.png was changed") if changes else nullcontext():
            quick(photos, photos / "result", **given)


class TestPartsOfAnInput:
    def test_a_part_that_goes_beyond_the_end_is_told(self, quick, points, tmp_path):
        result = quick(points, tmp_path / "out", frames=(2, 9))
        assert len(result.track) == FRAMES - 2
        assert "Frames 2 to 9 were asked for; points.csv ends with frame 4, and the run with it." in result.notes

    def test_a_part_within_it_is_not(self, quick, points, tmp_path):
        assert quick(points, tmp_path / "out", frames=(2, 4)).notes == ()


class TestTwoRunsInOneFolder:
    def test_the_second_is_refused_and_the_first_is_not_disturbed(self, quick, points, tmp_path):
        refused = []

        def second(step, done, total):
            if done == 3:
                assert f"process {os.getpid()} on " in (tmp_path / "out" / "run.lock").read_text()
                with pytest.raises(OutputError, match=rf"Another run writes into .*process {os.getpid()} on") as error:
                    quick(points, tmp_path / "out", overwrite=True)
                refused.append(error)

        assert len(quick(points, tmp_path / "out", progress=second).track) == FRAMES
        assert refused
        assert not (tmp_path / "out" / "run.lock").exists()

    def test_a_lock_that_a_killed_run_left_holds_nobody_up(self, quick, points, tmp_path):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "run.lock").write_text("process 1 on here since 2001-01-01 00:00")
        quick(points, tmp_path / "out")
        assert not (tmp_path / "out" / "run.lock").exists()

    def test_a_run_that_fails_at_once_leaves_no_folder(self, quick, tmp_path):
        with pytest.raises(ValueError, match=r"nowhere.csv"):
            quick(tmp_path / "nowhere.csv", tmp_path / "a" / "b")
        assert not (tmp_path / "a").exists()


IN_THE_WAY = {
    "a file": (lambda home: (home / "out").write_text("mine"), "out", "a file is in the way"),
    "below a file": (lambda home: (home / "file").write_text("mine"), "file/out", "a file is in the way"),
    "a device": (lambda home: None, "/dev/null", "a file is in the way"),
    "a link to nothing": (lambda home: (home / "out").symlink_to("nowhere"), "out", "a file is in the way"),
    "a long name": (lambda home: None, "x" * 300, "name a shorter one"),
    "NUL": (lambda home: None, "a\0b", "null byte"),
    "no folder to write to": (lambda home: None, "/proc/x", "name another place"),
    "a folder for a file": (lambda home: (home / "out/track.npz").mkdir(parents=True), "out", "track.npz is a folder"),
}


class TestPlacesThatCannotBeWritten:
    @pytest.mark.parametrize("place", IN_THE_WAY)
    def test_a_run_tells_so_in_a_sentence(self, quick, points, tmp_path, place):
        prepare, name, sentence = IN_THE_WAY[place]
        prepare(tmp_path)
        with pytest.raises(OutputError, match=sentence) as error:
            quick(points, tmp_path / name)
        assert "\n" not in str(error.value)
        assert Path(name).parts[-1][:20].replace("\0", r"\x00") in str(error.value)

    @pytest.mark.parametrize("place", [place for place in IN_THE_WAY if place != "a folder for a file"])
    def test_single_files_tell_so_too(self, tmp_path, place):
        prepare, name, _ = IN_THE_WAY[place]
        prepare(tmp_path)
        with pytest.raises(OutputError, match=r"cannot be written"):
            write_landmark_file(tmp_path / name / "points.csv", [])

    def test_a_device_is_not_replaced_by_a_file(self):
        with pytest.raises(OutputError, match="/dev/null is a pipe or device"), atomic_path("/dev/null"):
            pass
        assert Path("/dev/null").is_char_device()

    def test_a_link_stays_and_what_it_points_to_is_new(self, tmp_path):
        (tmp_path / "disk").mkdir()
        (tmp_path / "disk" / "real.txt").write_text("old")
        (tmp_path / "link.txt").symlink_to("disk/real.txt")
        with atomic_path(tmp_path / "link.txt") as temporary:
            temporary.write_text("new")
        assert (tmp_path / "link.txt").is_symlink()
        assert (tmp_path / "disk" / "real.txt").read_text() == "new"
        assert [path.name for path in (tmp_path / "disk").iterdir()] == ["real.txt"]

    def test_errors_of_what_is_read_meanwhile_are_not_laid_to_the_file(self, tmp_path):
        with pytest.raises(FileNotFoundError, match="another"), atomic_path(tmp_path / "a.txt"):
            (tmp_path / "another").read_text()
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("suffix", [".png", ".jpg"])
    def test_a_picture_that_finds_no_room_says_what_the_system_says(self, tmp_path, suffix):
        noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
        with pytest.raises(OutputError, match="the system allows no larger file there"), small_disk(1000):
            write_picture(tmp_path / f"a{suffix}", noise)
        assert list(tmp_path.iterdir()) == []

    def test_an_array_that_finds_no_room_says_what_to_do(self, tmp_path):
        refused = pytest.raises(OutputError, match="free some space and repeat")
        with refused, small_disk(1000), atomic_path(tmp_path / "a.npy") as temporary:
            np.save(temporary, np.zeros(1000))
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize(
        "write",
        [
            lambda path: write_weights(path, {"a": np.zeros(1000, np.float32)}, {}),
            lambda path: write_moments(path, Moments(("a",) * 40, np.eye(40)), {}),
        ],
        ids=["weights", "moments of expressions"],
    )
    def test_weights_that_find_no_room_say_what_the_system_says(self, tmp_path, write):
        refused = pytest.raises(OutputError, match=r"w\.safetensors cannot be written .*; the system allows no larger")
        with refused, small_disk(1000):
            write(tmp_path / "w.safetensors")
        assert list(tmp_path.iterdir()) == []

    @pytest.mark.parametrize("suffix", [*FORMATS, ".usda"])
    def test_an_export_to_a_full_disk_leaves_nothing(self, head, tmp_path, suffix):
        track = performance(head)
        if suffix == ".mp4":
            with VideoWriter(tmp_path / "clip.mp4") as writer:
                for _ in range(len(track)):
                    writer.write(np.full((480, 640, 3), 60, np.uint8))
            track.meta["inputs"] = [{"path": str(tmp_path / "clip.mp4"), "sha256": ""}]
        # Once with room: what JAX compiles then must not be cut off in its cache.
        export_track(track, head, tmp_path / f"x{suffix}")
        (tmp_path / "made").mkdir()
        with pytest.raises(OutputError, match=r"x.* cannot be written .*; "), small_disk(1000):
            export_track(track, head, tmp_path / "made" / f"x{suffix}")
        assert list((tmp_path / "made").iterdir()) == []

    @pytest.mark.parametrize("most_bytes", [100, 3_000, 5_000, 6_500])
    def test_a_run_that_filled_the_disk_goes_on_when_there_is_room(
        self, quick, points, tmp_path, most_bytes, monkeypatch
    ):
        monkeypatch.setattr("workbench.tracking.track_writer.PART_FRAMES", 2)
        whole = quick(points, tmp_path / "whole").track
        with pytest.raises(OutputError, match=r"cannot be written .* larger file"), small_disk(most_bytes):
            quick(points, tmp_path / "cut")
        resumed = quick(points, tmp_path / "cut", resume=True).track
        assert np.array_equal(resumed.expression, whole.expression)
        assert {path.name for path in (tmp_path / "cut").iterdir()} == {
            path.name for path in (tmp_path / "whole").iterdir()
        }

    @pytest.mark.parametrize(
        ("left", "kept"), [("fingerprint", False), (".000000.partial-1.npz", False), ("000000.npz", True)]
    )
    def test_an_error_says_that_finished_parts_are_kept_where_there_are_any(self, tmp_path, left, kept):
        parts = tmp_path / "track.npz.parts"
        parts.mkdir()
        (parts / left).touch()
        with pytest.raises(OutputError) as told, _telling_what_is_kept(tmp_path):
            raise OutputError("x cannot be written.")
        assert ("the run can be resumed (--resume)" in str(told.value)) is kept

    def test_on_a_full_disk_the_command_line_promises_no_parts(self, run, quick, points, tmp_path, monkeypatch):
        monkeypatch.setattr("workbench.cli.tracking.face_model", lambda path: StubModel())
        with small_disk(3_000):
            code, _, err = run("track", "points.csv", "--no-pictures")
        assert code == 2
        assert "cannot be written" in err
        assert "--resume" not in err
        assert "Traceback" not in err


class PicturesOfPaper:
    """Stands for the overlay pictures: writes which frame it was given."""

    note = None

    def __init__(self, model, dressed=None):
        self._waiting = None

    def add(self, path, picture, fit):
        self.flush()
        self._waiting = path, f"{fit.index} {picture.shape}"

    def flush(self):
        if self._waiting is not None:
            path, text = self._waiting
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        self._waiting = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


class TestPicturesOfStills:
    @pytest.fixture
    def stills(self, quick, points, monkeypatch):
        monkeypatch.setattr("workbench.pipeline.still_pictures.OverlayPictures", PicturesOfPaper)

        def run(folder, photos=points, **options):
            return track(photos, folder, StubModel(), preset("calibrated"), stills=True, **options)

        return run

    def test_they_come_with_the_fits(self, stills, tmp_path):
        seen = []
        result = stills(tmp_path / "out", progress=lambda *_: seen.append(len(list(tmp_path.glob("out/overlay/*")))))
        assert seen == list(range(FRAMES))
        drawn = sorted((tmp_path / "out" / "overlay").iterdir())
        assert [path.name for path in drawn] == [f"{index:04d}-points-{index}.jpg" for index in range(FRAMES)]
        assert [path.read_text() for path in drawn] == [f"{index} (480, 640, 3)" for index in range(FRAMES)]
        assert set(drawn) < set(result.files)

    @pytest.mark.parametrize("other", [False, True])
    def test_a_photo_that_cannot_be_read_leaves_no_pictures_of_the_others(self, stills, points, tmp_path, other):
        photos, drawn = tmp_path / "photos", tmp_path / "out" / "overlay"
        for index in range(FRAMES):
            write_picture(photos / f"{index}.png", np.zeros((480, 640, 3), np.uint8))
        (photos / "3.png").write_bytes(b"no picture")
        if other:
            drawn.mkdir(parents=True)
            (drawn / "mine.jpg").write_text("of the user")
        seen = []
        with pytest.raises(InputError, match=r"3\.png does not contain a readable picture: .*; remove or replace it"):
            stills(
                tmp_path / "out",
                photos=photos,
                landmarks=points,
                progress=lambda *_: seen.append(len(list(drawn.glob("*")))),
            )
        assert seen[-1] == 2 + other  # one is being drawn
        assert [path.name for path in tmp_path.glob("out/**/*") if path.is_file()] == ["mine.jpg"] * other
        assert (tmp_path / "out").exists() == other

    @pytest.mark.parametrize("lost", [False, True])
    def test_an_interrupted_run_draws_only_what_is_missing(self, stills, tmp_path, lost):
        def interrupt(step, done, total):
            if done == 3:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            stills(tmp_path / "out", progress=interrupt)
        drawn = sorted((tmp_path / "out" / "overlay").iterdir())
        assert len(drawn) == 3
        for path in drawn:
            path.write_text("drawn before")
        if lost:
            drawn[1].unlink()
        stills(tmp_path / "out", resume=True)
        texts = [path.read_text()[:5] for path in sorted((tmp_path / "out" / "overlay").iterdir())]
        assert texts == ["drawn", "1 (48" if lost else "drawn", "drawn", "3 (48", "4 (48"]


class TestTrainings:
    """`workbench train`, its trainings replaced by what they leave."""

    @pytest.fixture
    def begun(self, tmp_path):
        """A folder with the checkpoints of an interrupted training."""
        self.begin(tmp_path / "nets", "half way")
        return tmp_path / "nets"

    def begin(self, folder, checkpoint):
        (folder / "landmarks").mkdir(parents=True)
        (folder / "landmarks" / PLAN_FILE).write_text("the plan")
        (folder / "landmarks" / "checkpoint.pt").write_text(checkpoint)

    def finish(self, folder):
        for name in ("landmarks.safetensors", "tables.md"):
            (folder / name).write_text("hours of work")

    def test_an_interrupted_one_goes_on(self, begun):
        with training_folder(begun, "landmarks"):
            (begun / "landmarks.safetensors").write_text("not measured yet")
        with training_folder(begun, "landmarks"):
            assert (begun / "landmarks" / "checkpoint.pt").read_text() == "half way"

    def test_a_finished_one_is_repeated_only_on_demand(self, begun):
        self.finish(begun)
        with pytest.raises(OutputError, match="already holds a finished training; name another folder, or replace it"):
            training_folder(begun, "landmarks").__enter__()
        assert (begun / "landmarks" / "checkpoint.pt").exists()
        with training_folder(begun, "landmarks", overwrite=True):
            assert content(begun).keys() == {"run.lock"}

    def test_one_that_is_repeated_can_be_interrupted_and_goes_on(self, begun):
        self.finish(begun)
        with training_folder(begun, "landmarks", overwrite=True):
            self.begin(begun, "half way again")
        with training_folder(begun, "landmarks"):
            assert (begun / "landmarks" / "checkpoint.pt").read_text() == "half way again"

    @pytest.mark.parametrize("name", ["landmarks.safetensors", "landmarks/weights.safetensors"])
    def test_weights_to_start_from_are_not_replaced(self, begun, name):
        self.finish(begun)
        (begun / "landmarks" / "weights.safetensors").write_text("hours of work")
        with pytest.raises(OutputError, match=f"{name} is an input and would be overwritten"):
            training_folder(begun, "landmarks", overwrite=True, start=begun / name).__enter__()
        assert (begun / name).read_text() == "hours of work"

    @pytest.mark.parametrize("network", ["landmarks", "expressions"])
    def test_a_folder_of_somebody_else_is_kept_whatever_its_name(self, tmp_path, network):
        notes = tmp_path / network / "notes.csv"
        notes.parent.mkdir()
        notes.write_text("mine")
        with training_folder(tmp_path, network, overwrite=True):
            assert notes.read_text() == "mine"
        (tmp_path / "tables.md").write_text("mine")
        with pytest.raises(OutputError, match=r"already holds a file tables.md"):
            training_folder(tmp_path, "landmarks").__enter__()

    def test_what_is_learned_in_one_go_is_repeated_where_it_was_interrupted(self, tmp_path):
        (tmp_path / "dense_gain.safetensors").write_text("not measured yet")
        with training_folder(tmp_path, "gain"):
            (tmp_path / "dense_gain_tables.md").write_text("all done")
        with pytest.raises(OutputError, match="already holds a finished training"):
            training_folder(tmp_path, "gain").__enter__()

    def test_weights_of_somebody_else_are_not_replaced_unasked(self, tmp_path):
        (tmp_path / "finder.safetensors").write_text("mine")
        with pytest.raises(OutputError, match=r"already holds a file finder.safetensors; name another folder"):
            training_folder(tmp_path, "finder").__enter__()

    def test_two_at_once_are_refused(self, tmp_path):
        with (
            training_folder(tmp_path, "flow"),
            pytest.raises(OutputError, match="Another run writes into"),
            training_folder(tmp_path, "landmarks"),
        ):
            pass


def test_a_recording_is_not_written_over_unasked(head, tmp_path):
    recording = Recording(performance(head), ())
    recording.save(tmp_path / "take")
    with pytest.raises(
        OutputError, match="already holds a recording or a run; name another folder, or replace it with"
    ):
        recording.save(tmp_path / "take")
    (tmp_path / "clips").mkdir()
    (tmp_path / "clips" / "clip.mp4").write_text("mine")
    with pytest.raises(OutputError, match="already holds a recording"):
        recording.save(tmp_path / "clips")
    assert recording.save(tmp_path / "take", overwrite=True) == tmp_path / "take" / "track.npz"


def test_a_recording_that_does_not_fit_on_the_disk_leaves_an_earlier_one_as_it_was(head, tmp_path):
    for name in ("track.npz", "clip.mp4"):
        (tmp_path / name).write_text("an earlier one")
    before = content(tmp_path)
    with pytest.raises(OutputError, match=r"track\.npz cannot be written"), small_disk(100):
        Recording(performance(head), ()).save(tmp_path, overwrite=True)
    assert content(tmp_path) == before
