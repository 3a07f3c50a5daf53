"""`workbench config`: what it prints, its exit codes, and that its output can be used as input."""

import json

import pytest

from workbench.cli import screen
from workbench.config import PRESETS, config_schema, config_toml, preset, read_config


@pytest.mark.parametrize("name", PRESETS)
def test_show_prints_a_file_that_can_be_run(name, run, tmp_path):
    code, out, err = run("config", "show", "--preset", name)
    assert (code, err) == (0, "")
    assert out == config_toml(preset(name))
    (tmp_path / "again.toml").write_text(out)
    assert read_config(tmp_path / "again.toml") == preset(name)


def test_show_fills_in_what_a_file_leaves_out(run, tmp_path):
    (tmp_path / "short.toml").write_text("[weights]\ntau = 0.5\n")
    out = run("config", "show", "short.toml")[1]
    assert "tau = 0.5 # ω_τ: second difference of the pose (Eq. 9)." in out
    assert "sigma_smooth = 20.0" in out


def test_show_highlights_on_a_terminal_without_changing_the_text(run, monkeypatch):
    terminal = screen.Console(width=40, force_terminal=True, color_system=None)
    monkeypatch.setattr(screen, "console", terminal)
    assert run("config", "show")[1] == config_toml(preset("joint"))
    monkeypatch.setattr(screen, "console", screen.Console(width=40, force_terminal=True, color_system="standard"))
    assert "\x1b[" in run("config", "show")[1]


def test_check_tells_preset_version_and_distance_of_each_file(run, tmp_path):
    (tmp_path / "same.toml").write_text(config_toml(preset("joint")))
    (tmp_path / "tuned.toml").write_text('preset = "face-it"\n[weights]\ntau = 0.5\nbeta = 1.0\n')
    (tmp_path / "old.toml").write_text("version = 1\n[contour]\nsliding = false\n")
    code, out, _ = run("config", "check", "same.toml", "tuned.toml", "old.toml")
    assert code == 0
    assert out.splitlines() == [
        "OK     same.toml: preset joint, version 3, no differences from the preset",
        "OK     tuned.toml: preset face-it, version 3, 2 differences from the preset",
        "OK     old.toml: preset calibrated, version 1, migrated to version 3, 1 difference from the preset",
    ]


@pytest.mark.parametrize(
    ("section", "key"),
    [("camera", "rig"), ("deep", "network"), ("flow", "estimator"), ("landmarks", "face_landmarker"),
     ("head", "character")],
)  # fmt: skip
def test_check_tells_a_file_that_is_named_and_not_there(section, key, run, tmp_path):
    (tmp_path / "mine.toml").write_text(f'preset = "joint"\n[{section}]\n{key} = "other/own.toml"\n')
    code, out, _ = run("config", "check", "mine.toml")
    assert code == 2
    assert f"{section}.{key} names 'other/own.toml', which does not exist here" in " ".join(out.split())
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "own.toml").touch()
    assert run("config", "check", "mine.toml")[0] == 0


def test_check_goes_on_after_a_bad_file_and_fails(run, tmp_path):
    (tmp_path / "bad.toml").write_text("[weights]\ntua = 0.5\n")
    (tmp_path / "good.toml").write_text("")
    code, out, _ = run("config", "check", "bad.toml", "none.toml", "good.toml")
    assert code == 2
    bad, none, good = out.splitlines()
    assert bad == "ERROR  bad.toml: there is no key 'weights.tua'; did you mean 'tau'?"
    assert none.startswith("ERROR  The configuration none.toml does not exist")
    assert good.startswith("OK     good.toml")


def test_diff_of_equal_configurations_is_silent_success(run, tmp_path):
    config = preset("joint").changed(provenance={"exported": "2026-01-01"})
    (tmp_path / "exported.toml").write_text(config_toml(config))
    assert run("config", "diff", "joint", "exported.toml") == (0, "no differences\n", "")


def test_diff_lists_each_value_as_a_file_has_it(run, tmp_path):
    stages = [stage.model_dump() for stage in preset("joint").stages]
    stages[1]["landmarks"] = {"all": 1.0, "jaw": 0.25}
    config = preset("joint").changed(
        weights={"tau": 0.5}, contour={"mode": "fixed"}, landmarks={"face": (320.0, 180.0)}, stages=stages
    )
    (tmp_path / "tuned.toml").write_text(config_toml(config))
    code, out, err = run("config", "diff", "joint", "tuned.toml")
    assert (code, err) == (1, "")
    rows = [[cell.strip() for cell in line.split("  ") if cell.strip()] for line in out.splitlines()]
    assert rows == [
        ["path", "joint", "tuned.toml"],
        ["weights.tau", "0.1", "0.5"],
        ["contour.mode", '"sliding"', '"fixed"'],
        ["landmarks.face", "–", "[320.0, 180.0]"],
        ["stages.pose and expression.landmarks", "{all = 1.0, jaw = 0.1}", "{all = 1.0, jaw = 0.25}"],
    ]


def test_the_schema_goes_to_the_screen_or_into_a_file(run, tmp_path):
    assert run("config", "schema") == (0, config_schema(), "")
    code, out, _ = run("config", "schema", "--out", "made/config.schema.json")
    assert (code, out) == (0, "made/config.schema.json\n")
    assert json.loads((tmp_path / "made" / "config.schema.json").read_text())["type"] == "object"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["show", "none.toml"], "does not exist"),
        (["show", "--preset", "nope"], "There is no preset 'nope'"),
        (["show", "some.toml", "--preset", "joint"], "not both"),
        (["diff", "joint", "none.toml"], "neither a file nor a preset 'none.toml'"),
        (["diff", "bad.toml", "joint"], "did you mean 'tau'"),
    ],
)
def test_mistakes_are_one_sentence_and_exit_code_2(arguments, message, run, tmp_path):
    (tmp_path / "bad.toml").write_text("[weights]\ntua = 0.5\n")
    code, out, err = run("config", *arguments)
    assert code == 2
    assert err.startswith("error: ")
    assert message in err
    assert "Traceback" not in out + err
