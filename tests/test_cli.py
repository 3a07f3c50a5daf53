"""The command line: what a user types and reads."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
import warnings
from functools import partial
from io import StringIO
from itertools import count

import numpy as np
import pytest

import workbench
from tests.scenes import make_scene
from tests.small_disk import small_disk
from workbench import cli
from workbench.cli import screen, servers
from workbench.config import PRESETS, preset, read_config, write_config
from workbench.errors import WorkbenchWarning
from workbench.frames import write_picture
from workbench.geometry import yaw_pitch_roll_deg
from workbench.landmarks import chosen_detector
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, read_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.planning import plan_of
from workbench.runtime import cache_folder
from workbench.samples import sample, samples_folder
from workbench.sweeps.storage import Storage
from workbench.tracker import FaceTracker
from workbench.tracking import FrameObservation, Track
from workbench.workers import ThisProcess, ready


@pytest.fixture
def points(head, tmp_path):
    """A landmark file of five frames."""
    path = tmp_path / "points.csv"
    with LandmarkCsvWriter(path, confidence=False) as writer:
        for index in range(5):
            scene = make_scene(head, (4.0 * index, 0, 0), {"jawOpen": 0.1 * index})
            writer.write(LandmarkRecord(index, "", Landmarks2D(scene.points, np.ones(68), (640, 480)), None))
    return path


def test_track_writes_the_results_beside_the_caller_and_tells_what_they_are(run, points, tmp_path):
    code, out, err = run("track", "points.csv", "--no-pictures")
    assert code == 0
    assert err == ""
    assert "5 of 5 with a face" in out
    assert "of the eye distance" in out
    assert "guessed" in out
    assert "parameters.csv" in out
    assert json.loads((tmp_path / "out" / "points" / "summary.json").read_text())["frames"] == 5


def test_options_end_up_in_the_stored_configuration(run, points, tmp_path):
    arguments = ["--preset", "face-it", "--fov", "40", "--no-identity", "--face", "320,200", "--out", "here"]
    assert run("track", "points.csv", "--no-pictures", *arguments)[0] == 0
    config = read_config(tmp_path / "here" / "config.toml")
    assert config.preset == "face-it"
    assert config.camera.fov_deg == 40.0
    assert config.landmarks.face == (320.0, 200.0)
    assert not config.identity.calibrate
    summary = json.loads((tmp_path / "here" / "summary.json").read_text())
    assert summary["camera"]["guessed"] is False


def test_a_lens_that_has_the_angle_of_the_guess_is_no_guess_if_it_is_given(run, points, tmp_path):
    assert "as given" in run("track", "points.csv", "--no-pictures", "--no-identity", "--fov", "45")[1]
    assert json.loads((tmp_path / "out" / "points" / "summary.json").read_text())["camera"]["guessed"] is False
    stored = read_config(tmp_path / "out" / "points" / "config.toml")
    assert plan_of(stored).identity.size == stored.identity.size > 0.0
    assert plan_of(stored.changed(camera={"fov_known": False})).identity.size == 0.0


def test_a_character_of_ones_own_is_stored_where_every_folder_finds_it(run, points, tmp_path):
    (tmp_path / "me").mkdir()
    (tmp_path / "me" / "character.toml").write_text("")
    assert run("track", "points.csv", "--no-pictures", "--character", "me", "--out", "here")[0] == 0
    assert read_config(tmp_path / "here" / "config.toml").head.character == str(tmp_path / "me")


def test_an_exported_configuration_gives_the_same_numbers_and_an_edited_one_does_not(run, points, tmp_path):
    run("track", "points.csv", "--no-pictures", "--out", "first")
    run("track", "points.csv", "--no-pictures", "--out", "second", "--config", "first/config.toml")
    text = (tmp_path / "first" / "config.toml").read_text()
    (tmp_path / "edited.toml").write_text(text.replace("sigma_smooth = 20.0", "sigma_smooth = 0.1"))
    run("track", "points.csv", "--no-pictures", "--out", "third", "--config", "edited.toml")
    first, second, third = (Track.load(tmp_path / name / "track.npz") for name in ("first", "second", "third"))
    np.testing.assert_array_equal(first.expression, second.expression)
    assert np.abs(first.expression - third.expression).max() > 0.01


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["track", "nowhere.mp4"], "nowhere.mp4"),
        (["track", "points.csv", "--preset", "nope"], "There is no preset 'nope'"),
        (["track", "points.csv", "--config", "none.toml"], "does not exist"),
        (["track", "points.csv", "--preset", "face-it", "--config", "none.toml"], "not both"),
        (["track", "points.csv", "--fov", "200"], "camera.fov_deg"),
        (["track", "points.csv", "--detector", "magic"], "landmarks.detector"),
        (["track", "points.csv", "--face-landmarker", "f.task"], "belongs to the detector mediapipe; add --detector"),
        (["track", "points.csv", "--face", "left"], "X,Y"),
        (["track", "points.csv", "--fov", "40", "--rig", "rig.toml"], "--fov has no effect with a rig"),
        (
            ["track", "points.csv", "--rig", "rig.toml", "--view", "side=a.csv", "--view", "side=b.csv"],
            "The view 'side' is given twice, as a.csv and as b.csv",
        ),
        (["track", "points.csv", "--workers", "2"], "--workers and --scheduler belong to Deep Energies"),
        (["track", "points.csv", "--frames", "500-600"], "points.csv holds no frame from 500 to 600"),
    ],
)
def test_mistakes_are_one_sentence_and_exit_code_2(arguments, message, run, points):
    code, out, err = run(*arguments)
    assert code == 2
    assert err.startswith("error: ")
    assert message in err
    assert "Traceback" not in out + err


def test_a_field_of_view_beside_the_configurations_rig_is_refused(run, points, tmp_path):
    write_config(preset("deep").changed(camera={"rig": "rig.toml"}), tmp_path / "stereo.toml")
    err = run("track", "points.csv", "--config", "stereo.toml", "--fov", "40")[2]
    assert "--fov has no effect with a rig, whose file holds the lenses; leave one of them out." in err


NAMES = ("track", "landmarks", "demo", "diagnose", "export", "config", "weights", "train", "lab", "app", "info")
COMMANDS = [[name] for name in NAMES]
CONFIG_COMMANDS = [["config", name] for name in ("show", "check", "diff", "schema")]


@pytest.mark.parametrize("command", [[], *COMMANDS, *CONFIG_COMMANDS], ids=" ".join)
def test_help_explains_every_command(command, run):
    code, out, _ = run(*command, "--help")
    assert code == 0
    assert "Usage" in out
    if command == ["track"]:
        assert "workbench track talk.mp4 --preset face-it" in out
        assert all(name in out for name in PRESETS)


def test_the_help_lists_every_command(run):
    out = run("--help")[1]
    for (command,) in COMMANDS:
        assert f" {command} " in out


def test_brackets_in_a_message_are_printed_as_they_are(run):
    assert "no[bold]where.mp4" in run("track", "no[bold]where.mp4")[2]


def test_a_step_whose_note_changes_stays_one_step_and_shows_how_fast_it_goes(monkeypatch):
    console = screen.Console(width=200, force_terminal=True, file=StringIO(), color_system=None)
    monkeypatch.setattr(screen, "console", console)
    # A clock by which each look takes a second.
    monkeypatch.setattr(screen, "Progress", partial(screen.Progress, get_time=count().__next__, auto_refresh=False))
    with screen.progress_bar("steps/s") as progress:
        for done in range(1, 4):
            progress("learn", done, 4, f"{1.0 / done:.4g}")
    shown = console.file.getvalue()
    assert "3/4 0.3333 1.0 steps/s 0:00:01" in shown


def test_steps_that_take_turns_each_keep_their_speed(monkeypatch):
    console = screen.Console(width=200, force_terminal=True, file=StringIO(), color_system=None)
    monkeypatch.setattr(screen, "console", console)
    monkeypatch.setattr(screen, "Progress", partial(screen.Progress, get_time=count().__next__, auto_refresh=False))
    with screen.progress_bar() as progress:
        for done in range(1, 4):
            progress("flow", done, 9)
            progress("solve", done, 9)
    shown = console.file.getvalue().split("\n")
    assert "frames/s" in [line for line in shown if "solve" in line][-1]


def test_the_version_is_told_without_a_command(run):
    assert run("--version")[:2] == (0, f"{workbench.__version__}\n")


def test_info_names_versions_and_places(run):
    code, out, _ = run("info")
    assert code == 0
    for word in ("jax", "optimistix", "presets", "samples", "dlib detector", "3D pictures"):
        assert word in out


def test_info_names_places_whole_however_narrow_the_window(run, monkeypatch):
    monkeypatch.setattr(screen, "console", screen.Console(width=40, highlight=False))
    lines = run("info")[1].splitlines()
    for name, place in (("samples", samples_folder()), ("cache", cache_folder())):
        assert [line for line in lines if line.startswith(name) and line.endswith(f" {place}")], name


def test_the_demo_finds_the_faces_itself_and_says_what_to_open_next(run, monkeypatch, tmp_path):
    """Of the clip its beginning: all of it is tracked where the wheel is tried (`tests/test_wheel.py`)."""
    track = workbench.pipeline.track

    def beginning(inputs, *rest, **options):
        clip = inputs[0].suffix == ".mp4"
        return track(inputs, *rest, **options, frames=(0, 5) if clip else None)

    monkeypatch.setattr(workbench.pipeline, "track", beginning)
    code, out, err = run("demo", "--no-pictures")
    assert code == 0, err
    for name, frames, character in (("astronaut", 1, "sofia"), ("laugh", 6, "ravi")):
        assert read_config(tmp_path / "demo_out" / name / "config.toml").head.character == character
        summary = json.loads((tmp_path / "demo_out" / name / "summary.json").read_text(encoding="utf-8"))
        assert summary["detector"] == chosen_detector()
        tracked = Track.load(tmp_path / "demo_out" / name / "track.npz")
        assert len(tracked) == frames
        assert tracked.found.all()
    assert out.rstrip().splitlines()[-1].endswith("To tune it in the browser: workbench lab.")


def test_a_clip_is_tracked_close_to_its_truth(head):
    records = read_landmark_file(sample("performance-landmarks"))
    config = preset("calibrated").changed(camera={"fov_deg": 33.0})
    fits = list(
        FaceTracker(head, config).fit_all(
            FrameObservation(record.frame, record.landmarks, record.landmarks.image_size) for record in records
        )
    )
    with np.load(sample("performance-truth"), allow_pickle=False) as truth:
        expected = yaw_pitch_roll_deg(truth["rotation"])
    errors = np.abs(np.array([fit.angles_deg for fit in fits]) - expected).mean(axis=0)
    assert (errors < 3.0).all()
    assert np.mean([fit.errors[1] for fit in fits]) < 2.5


def test_lab_serves_the_notebooks_and_keeps_its_token(monkeypatch, capsys):
    commands = []

    def remember(command, environment, is_up, ready):
        commands.append(command)
        ready()
        assert environment["JUPYTER_TOKEN"] in capsys.readouterr().out
        return 0

    monkeypatch.setattr(servers, "serve", remember)
    monkeypatch.setattr(sys, "argv", ["workbench", "lab", "--no-browser", "--port", "8899"])
    with pytest.raises(SystemExit):
        cli.main()
    text = " ".join(commands[0])
    assert "-m workbench.cli.lab_server" in text
    assert "--no-browser" in text
    assert "00_" in text
    assert "token" not in text


@pytest.mark.long
def test_lab_prints_one_address_and_hardly_anything_else(tmp_path):
    """A real server, on the first free port."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        # Where the tests run in the background, Ctrl-C is ignored, and programs that they start inherit that.
        heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
        command = [sys.executable, "-c", f"{heard}; from workbench.cli import main; main()", "lab", "--no-browser"]
        lab = subprocess.Popen(
            [*command, "--port", str(port)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            env={**os.environ, "JUPYTER_CONFIG_DIR": str(tmp_path), "JUPYTER_DATA_DIR": str(tmp_path)},
        )  # fmt: skip
        try:
            pattern = re.compile(r"http://127.0.0.1:(\d+)/lab/tree/00_quickstart.ipynb\?token=(\w+)")
            lines = []
            while not (lines and pattern.search(lines[-1])):
                lines.append(lab.stdout.readline())
                assert lines[-1], lines
            address = pattern.search(lines[-1])
            assert int(address[1]) != port
            status = f"http://127.0.0.1:{address[1]}/api/status"
            with urllib.request.urlopen(f"{status}?token={address[2]}") as answer:
                assert answer.status == 200
            with pytest.raises(urllib.error.HTTPError, match="403"):
                urllib.request.urlopen(status)
        finally:
            lab.send_signal(signal.SIGINT)
            rest = lab.stdout.read()
            lab.stdout.close()
            lab.wait(60)
    assert "Ctrl-C ends it." in rest
    assert "http" not in rest + "".join(lines[:-1])
    assert len(lines) + len(rest.splitlines()) <= 8  # with a warning of Jupyter's own, and the server's farewell


def test_flags_of_the_help_have_no_type_and_options_of_track_stand_in_groups(run):
    out = run("track", "--help")[1]
    assert "<bool>" not in out + run("config", "show", "--help")[1] + run("--help")[1]
    assert re.findall(r"╭─ ([A-Z][\w ]+) ─", out) == [
        "Arguments",
        "Options",
        "Input",
        "Fit",
        "Deep Energies",
        "Results",
    ]


@pytest.mark.parametrize("place", [None, 3.0])
def test_a_landmark_file_without_any_face_says_so(run, tmp_path, place):
    points = None if place is None else Landmarks2D(np.full((68, 2), place), np.ones(68), (640, 480))
    with LandmarkCsvWriter(tmp_path / "none.csv", confidence=False) as writer:
        writer.write(LandmarkRecord(0, "", points, (640, 480)))
    code, out, err = run("track", "none.csv", "--no-pictures", "--face", "320,200")
    assert code == 1
    assert "0 of 1 with a face" in out
    assert err.startswith("error: The landmark file has no face in any frame: its points are missing, all at one")
    assert "--detector" not in err


def test_pictures_without_any_face_end_with_what_to_try(run, tmp_path):
    write_picture(tmp_path / "grey.png", np.full((240, 320, 3), 90, np.uint8))
    code, _, err = run("track", "grey.png", "--no-pictures", "--detector", "network")
    assert code == 1
    assert err.startswith("error: No face was found in any frame; ")
    assert "--detector" in err


def test_where_a_point_names_no_face_the_error_names_the_point(run, tmp_path):
    write_picture(tmp_path / "grey.png", np.full((240, 320, 3), 90, np.uint8))
    code, _, err = run("landmarks", "grey.png", "--detector", "network", "--face", "300,20.5")
    assert code == 1
    assert err.startswith("error: No face was found at 300,20.5; name a point inside the face")


def test_the_workbenchs_warnings_are_notes_and_those_of_others_come_as_ever(monkeypatch, capsys):
    def warn():
        warnings.warn("the mouth [stays] shut", WorkbenchWarning, stacklevel=1)
        warnings.warn("others speak", UserWarning, stacklevel=1)

    monkeypatch.setattr(screen, "errors", screen.Console(width=200, stderr=True, highlight=False))
    monkeypatch.setattr(cli, "app", warn)
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        others = []
        monkeypatch.setattr(warnings, "showwarning", lambda message, *_: others.append(str(message)))
        cli.main()
    assert capsys.readouterr().err == "note: the mouth [stays] shut\n"
    assert others == ["others speak"]


def test_notebooks_of_an_installed_package_are_opened_as_copies(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    installed = tmp_path / "site-packages" / "workbench" / "notebooks"
    installed.mkdir(parents=True)
    (installed / "00_first.ipynb").write_text("original")
    copies = cli.working_copies(installed, installed.parent)
    assert copies == tmp_path / "workbench_notebooks"
    (copies / "00_first.ipynb").write_text("changed by the user")
    assert (cli.working_copies(installed, installed.parent) / "00_first.ipynb").read_text() == "changed by the user"
    assert (installed / "00_first.ipynb").read_text() == "original"


@pytest.fixture
def notebooks(monkeypatch, tmp_path):
    """Notebooks of an installed package, for `lab` and `app` too."""
    folder = tmp_path / "site-packages" / "workbench" / "notebooks"
    folder.mkdir(parents=True)
    for name in ("00_first.ipynb", servers.APP_NOTEBOOK):
        (folder / name).write_text("original" * 200)
    monkeypatch.setattr(servers, "notebooks_folder", lambda: folder)
    monkeypatch.setattr(servers, "working_copies", partial(cli.working_copies, package=folder.parent))
    monkeypatch.setattr(servers, "check_installed", lambda *_: None)
    return folder


@pytest.mark.parametrize("command", ["lab", "app"])
def test_a_full_disk_cuts_no_notebook(run, notebooks, tmp_path, command):
    with small_disk(1000):
        code, _, err = run(command, "--no-browser")
    assert code == 2
    assert len(err.splitlines()) == 1
    assert "start it in a folder that can be written to and has room" in err
    assert list((tmp_path / "workbench_notebooks").iterdir()) == []
    copies = servers.working_copies(notebooks)
    assert {path.read_text() for path in copies.iterdir()} == {"original" * 200}


@pytest.mark.parametrize("command", ["lab", "app"])
def test_where_no_notebooks_can_be_copied_to_one_reads_to_start_elsewhere(run, notebooks, tmp_path, command):
    (tmp_path / "workbench_notebooks").write_text("mine")
    code, _, err = run(command, "--no-browser")
    assert code == 2
    assert err == (
        f"error: The notebooks cannot be copied to {tmp_path / 'workbench_notebooks'} (File exists); "
        "start it in a folder that can be written to and has room for them.\n"
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["track", "points.csv", "--preset", "deep", "--out", "taken"], "taken already holds a finished run"),
        (["track", "nowhere.mp4", "--preset", "deep"], "nowhere.mp4"),
        (["track", "points.csv", "--preset", "deep", "--frames", "5-"], "first and last frame as A-B"),
        (["sweep", "points.csv", "--set", "weights.tau=0.1,1", "--out", "taken"], "taken holds a sweep"),
    ],
)
def test_what_is_wrong_with_a_command_is_told_before_workers_start(
    arguments, message, run, points, tmp_path, monkeypatch
):
    Storage(str(tmp_path / "taken")).write("sweep.json", b"{}")
    (tmp_path / "taken" / "track.npz").touch()
    monkeypatch.setattr("workbench.workers.workers_for", lambda *wanted: pytest.fail(f"started {wanted}"))
    code, out, err = run(*arguments, "--workers", "2")
    assert code == 2
    assert message in err
    assert out == ""


def test_workers_of_a_command_start_once_tell_their_dashboard_and_end_with_it(monkeypatch, capsys):
    class Dashboard(ThisProcess):
        said = "Dask dashboard: here"
        closed = False

        def close(self):
            self.closed = True

    hired = []
    monkeypatch.setattr("workbench.workers.workers_for", lambda *wanted: hired.append(Dashboard()) or hired[-1])
    with screen.at_work(2, None) as workers:
        assert workers.count == 2
    assert hired == []
    with screen.at_work(2, None) as workers:
        for _ in range(2):
            assert dict(workers.results([])) == {}
        assert (len(hired), hired[0].closed) == (1, False)
    assert hired[0].closed
    with screen.at_work(2, None) as workers:
        assert ready(workers) is workers
        assert len(hired) == 2
    with screen.at_work(2, "tcp://host:1"):  # whether it can be reached is known at once
        assert len(hired) == 3
    assert capsys.readouterr().out.splitlines() == ["Dask dashboard: here"] * 3


def test_an_interruption_says_how_to_go_on_where_frames_are_kept(run, points, monkeypatch, tmp_path):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr("workbench.pipeline.track", interrupted)
    parts = tmp_path / "out" / "track.npz.parts"
    parts.mkdir(parents=True)
    for name, continued in (("fingerprint", False), ("00000.npz", True)):
        (parts / name).touch()
        code, _, err = run("track", "points.csv", "--out", "out")
        assert code == 130
        assert ("--resume" in err) is continued
