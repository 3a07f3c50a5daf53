"""`workbench diagnose`: which frames stand out, and why one does."""

import csv
import json
import shlex
from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import IMAGE_SIZE, make_scene
from workbench.cli import diagnosis_files, screen
from workbench.config import preset
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import MIRROR
from workbench.pipeline import track
from workbench.session import TuningSession
from workbench.tracking import Track

COUNT, BROKEN, EMPTY = 24, 13, 20


def landmarks(head, index: int, broken: bool) -> Landmarks2D | None:
    """A talking head; one frame of a broken clip has its points in mirrored order, another one has none."""
    if broken and index == EMPTY:
        return None
    weights = {"jawOpen": 0.3 + 0.2 * np.sin(index / 3), "mouthSmileLeft": 0.3}
    points = make_scene(head, (1.0 * index - 10.0, 3.0, 0.0), weights, sliding=True).points
    points = points + np.random.default_rng(index).normal(0.0, 0.3, (68, 2))
    return Landmarks2D(points[list(MIRROR)] if broken and index == BROKEN else points, np.ones(68), IMAGE_SIZE)


@pytest.fixture(scope="module")
def runs(head, tmp_path_factory):
    """Folder of two runs: `clean` and `broken`."""
    folder = tmp_path_factory.mktemp("runs")
    for name in ("clean", "broken"):
        with LandmarkCsvWriter(folder / f"{name}.csv", confidence=False) as writer:
            for index in range(COUNT):
                found = landmarks(head, index, name == "broken")
                writer.write(LandmarkRecord(index, "", found, IMAGE_SIZE))
        track(folder / f"{name}.csv", folder / name, head, preset("calibrated"), pictures=False)
    return folder


def test_a_clean_track_has_no_frame_that_stands_out(run, runs):
    code, out, err = run("diagnose", str(runs / "clean"))
    assert (code, err) == (0, "")
    assert out == "no frame stands out (24 frames, 24 with a face)\n"


def test_a_track_without_any_face_says_so(run, head, tmp_path):
    with LandmarkCsvWriter(tmp_path / "none.csv", confidence=False) as writer:
        writer.write(LandmarkRecord(0, "", None, IMAGE_SIZE))
    track(tmp_path / "none.csv", tmp_path / "none", head, preset("calibrated"), pictures=False)
    assert run("diagnose", "none")[1] == "no frame has a face (1 frame)\n"


def test_a_broken_frame_heads_the_list_and_the_files(run, runs, tmp_path):
    code, out, err = run("diagnose", str(runs / "broken" / "track.npz"), "--json", "flags.json", "--csv", "flags.csv")
    assert (code, err) == (0, "")
    header, first = out.splitlines()[:2]
    assert header.split() == ["frame", "severity", "why"]
    assert first.split()[0] == str(BROKEN)
    assert len(first.split()) > 3
    assert f"--frame {BROKEN}" in out
    record = json.loads((tmp_path / "flags.json").read_text())
    assert (record["frames"], record["frames_with_face"]) == (COUNT, COUNT - 1)
    assert record["flagged"][0]["frame"] == BROKEN
    with (tmp_path / "flags.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row["frame"]) for row in rows] == [item["frame"] for item in record["flagged"]]
    assert rows[0]["why"] == record["flagged"][0]["why"]


def test_the_command_that_tells_why_can_be_copied(run, runs, tmp_path):
    (tmp_path / "my takes").symlink_to(runs)
    out = run("diagnose", "my takes/broken")[1]
    command = next(line for line in out.splitlines() if line.endswith("tells why")).removesuffix("  tells why")
    assert shlex.split(command) == ["workbench", "diagnose", "my takes/broken", "--frame", str(BROKEN)]


def test_the_list_is_cut_unless_all_frames_are_wanted(run, runs, monkeypatch):
    flagged = [{"frame": k, "severity": 0.9, "why": "text"} for k in range(30)]
    record = {"frames": 50, "frames_with_face": 50, "flagged": flagged}
    monkeypatch.setattr(diagnosis_files, "flags_record", lambda track, flags: record)
    short, whole = (run("diagnose", str(runs / "clean"), *more)[1] for more in ([], ["--all"]))
    assert short.count(" 0.90 ") == 20
    assert "30 of 50 frames stand out; these are the worst 20, --all lists the others" in short
    assert whole.count(" 0.90 ") == 30
    assert "--all" not in whole
    record["flagged"] = flagged[:1]
    assert "1 of 50 frames stands out" in run("diagnose", str(runs / "clean"))[1]


def test_one_frame_is_explained_with_what_mends_it_in_a_narrow_terminal(run, runs, tmp_path, monkeypatch):
    monkeypatch.setattr(screen, "console", screen.Console(width=80, highlight=False))
    arguments = ["--frame", str(BROKEN), "--json", "why.json", "--csv", "why.csv"]
    code, printed, err = run("diagnose", str(runs / "broken"), *arguments)
    assert (code, err) == (0, "")
    assert all(len(line) <= 80 for line in printed.splitlines())
    out = " ".join(printed.split())
    assert out.startswith(f"frame {BROKEN} of {COUNT}, error inner 51: ")
    listed = run("diagnose", str(runs / "broken"))[1]
    record = json.loads((tmp_path / "why.json").read_text())
    assert record["flagged"]
    assert f"flagged: {record['flagged']} " in out
    assert record["flagged"] in " ".join(listed.split())
    assert "from the landmarks alone" in out
    for title in ("left out", "What is least certain", "pitch ±", "depth ±"):
        assert title in out
    record = json.loads((tmp_path / "why.json").read_text())
    first = record["reasons"][0]
    assert first["code"] == "mirrored_order"
    assert first["after_percent"] < 0.3 * first["before_percent"]
    assert len(first["change"]["landmarks"]) == 68
    assert f"1. {first['title']} (score {first['score']:.2f})" in out
    numbers = f"{first['before_percent']:.2f} → {first['after_percent']:.2f} %"
    assert f"→ {first['change']['label']}: {first['measure']} {numbers}" in out
    assert {pull["group"] for pull in record["leave_group_out"]} >= {"jaw", "mouth", "eyes"}
    assert set(record["uncertainty"]["weights"]) >= {"jawOpen", "mouthSmileLeft"}
    with (tmp_path / "why.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert rows[0]["code"] == "mirrored_order"
    assert rows[0]["change"] == first["change"]["label"]
    assert [int(row["rank"]) for row in rows] == list(range(1, len(record["reasons"]) + 1))


def test_numbers_that_are_not_finite_become_null(tmp_path):
    record = {"condition": np.inf, "offset": np.array([1.0, np.nan]), "points": {3: np.int64(2)}, "pair": ("a", True)}
    diagnosis_files.write_json(record, tmp_path / "record.json")
    stored = json.loads((tmp_path / "record.json").read_text())
    assert stored == {"condition": None, "offset": [1.0, None], "points": {"3": 2}, "pair": ["a", True]}


def test_an_unremarkable_frame_says_so(run, runs):
    out = run("diagnose", str(runs / "clean"), "--frame", "5")[1]
    assert "No reason found: the frame is unremarkable" in out
    assert "1. " not in out.split("The fit without")[0]


def test_a_track_of_another_model_asks_for_it(run, runs, tmp_path):
    """Another face would be fitted in its place, and its faults explained."""
    stored = Track.load(runs / "clean" / "track.npz")
    replace(stored, meta={**stored.meta, "model": {"name": "flame", "sha256": "1"}}).save(tmp_path / "track.npz")
    code, _, err = run("diagnose", str(tmp_path), "--frame", "5")
    assert code == 2
    assert "fitted with the model flame; name its file with --model" in err


@pytest.fixture
def of_deep_energies(runs, tmp_path):
    """The broken track as if Deep Energies had made it, with the clips of other views."""

    def store(views):
        stored, config = Track.load(runs / "broken" / "track.npz"), preset("deep-points").model_dump(mode="json")
        replace(stored, meta={**stored.meta, "config": config, "views": views}).save(tmp_path / "track.npz")
        return str(tmp_path / "track.npz")

    return store


@pytest.mark.parametrize(
    ("views", "message"),
    [
        ({"side": "side.mp4"}, "Runs of several cameras are not diagnosed frame by frame; track the first view's clip"),
        ({}, "Diagnosis tries changes to FACE IT! only; choose a FACE IT! preset to use it."),
    ],
)
def test_runs_whose_frames_are_not_diagnosed_say_so_before_the_clip_is_fitted(
    views, message, of_deep_energies, run, monkeypatch
):
    monkeypatch.setattr(TuningSession, "fit_clip", lambda *_: pytest.fail("the clip was fitted"))
    err = run("diagnose", of_deep_energies(views), "--frame", "5")[2]
    assert message in err


@pytest.mark.parametrize("views", [{"side": "side.mp4"}, {}])
def test_no_hint_follows_the_list_of_such_runs(views, of_deep_energies, run):
    out = run("diagnose", of_deep_energies(views))[1]
    assert out.splitlines()[-1].endswith("stand out") or out.splitlines()[-1].endswith("stands out")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere"),
        (["{runs}/clean", "--frame", "99"], "There is no frame 99"),
        (["{runs}/broken", "--frame", str(EMPTY)], "choose a frame with a face"),
        (["{runs}/clean", "--frame", "1", "--all"], "not both"),
    ],
)
def test_mistakes_are_one_sentence_and_exit_code_2(arguments, message, run, runs):
    code, out, err = run("diagnose", *(argument.replace("{runs}", str(runs)) for argument in arguments))
    assert code == 2
    assert err.startswith("error: ")
    assert message in err
    assert "Traceback" not in out + err
