"""A second camera judges fits to the first: from the commands, stored with its clip, and told where it is missing."""

import csv
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.stereo_scenes import make_rig, make_stereo_scene
from workbench.cli import app
from workbench.config import preset, read_config, write_config
from workbench.errors import ConfigError, InputError
from workbench.face import load_default_head
from workbench.geometry import read_rig, write_rig
from workbench.landmarks.files import LandmarkCsvWriter
from workbench.sweeps import Sweep, in_first_view, read_axis, sources_of
from workbench.sweeps.storage import Storage
from workbench.sweeps.stored_clips import digest_of, observe, store_clip, stored_clip

FRAMES = 24


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Landmark files of both cameras and the rig; the second one misses a frame and ends two frames early."""
    folder = tmp_path_factory.mktemp("stereo")
    rig = make_rig((-15.0, 15.0))
    scene = make_stereo_scene(load_default_head(), rig, frames=FRAMES, sliding=True)
    write_rig(rig, folder / "rig.toml")
    for view, name in enumerate(rig.names):
        with LandmarkCsvWriter(folder / f"{name}.csv", confidence=False) as writer:
            for record in scene.records(view, missing=(3,) if view else ())[: FRAMES - 2 * view]:
                writer.write(record)
    return {"clip": str(folder / "middle.csv"), "second": str(folder / "side.csv"), "rig": str(folder / "rig.toml")}


@pytest.fixture
def given(files):
    return [files["clip"], "--rig", files["rig"], "--view", f"side={files['second']}", "--objective", "second-view"]


def run(*arguments):
    told = CliRunner().invoke(app, [*arguments])
    return told.exit_code, " ".join((told.output + str(told.exception or "")).split())


def test_a_sweep_finds_the_setting_that_the_second_camera_agrees_with(given, tmp_path):
    out = tmp_path / "s"
    axis = ["--set", "identity.calibrate=false,true", "--preset", "joint"]
    code, said = run("sweep", *given, *axis, "--out", str(out))
    assert code == 0, said
    with (out / "table.csv").open() as stream:
        true, calibrated = (float(row["second-view"]) for row in csv.DictReader(stream))
    # The head is the mean one. Calibrated from one camera it gets a depth that only another camera can see is wrong.
    assert true < 1.0
    assert calibrated > 2.0 * true
    best = read_config(out / "best.toml")
    lens = read_rig(given[2]).views[0].camera
    np.testing.assert_allclose(np.diag(best.camera.matrix)[:2], lens.focal_px)


def test_tuning_takes_it_and_says_what_it_was_tuned_on(given, files, tmp_path):
    out = tmp_path / "learned.toml"
    parts = ["--train", "0:12", "--held-out", "12:24", "--search", "weights.tau=0.01,0.1", "--trials", "1"]
    code, said = run("tune", *given, *parts, "--out", str(out))
    assert code == 0, said
    found = read_config(out).provenance
    assert found.objective == "second-view"
    assert np.isfinite([found.before["held_out"], found.after["held_out"]]).all()
    assert [line.split(" sha256:")[0] for line in found.inputs] == [files["clip"], files["second"], files["rig"]]


@pytest.mark.slow
@pytest.mark.long
def test_a_gradient_of_what_it_sees_is_followed_and_taken_up_again(given, tmp_path):
    joint, out, base = preset("joint"), tmp_path / "learned.toml", tmp_path / "base.toml"
    # A stage less makes half the program: what is tried here does not depend on it.
    only = [joint.stages[-1].model_dump()]
    heavy = {"weights": {"tau": 30.0}, "identity": {"calibrate": False}}
    write_config(joint.changed(stages=only, **heavy), base)
    asked = ["tune", *given, "--learn", "weights.tau", "--config", str(base), "--out", str(out)]
    asked += ["--train", "0:12", "--held-out", "12:24"]
    code, said = run(*asked, "--steps", "3")
    assert code == 0, said
    found, first = read_config(out), json.loads(out.with_suffix(".learning.json").read_text())
    # The second camera misses a frame of those that are learned on: it does not count, and the others do.
    assert found.weights.tau < 0.7 * heavy["weights"]["tau"]
    assert found.provenance.after["held_out"] < found.provenance.before["held_out"]
    code, said = run(*asked, "--steps", "4", "--resume")
    assert code == 0, said
    second = json.loads(out.with_suffix(".learning.json").read_text())
    assert second["values"][:3] == first["values"]
    assert len(second["values"]) == 4


def test_what_it_sees_is_stored_with_the_clip_and_known_by_its_content(files, tmp_path):
    head, config = load_default_head(), preset("joint")
    (source,) = sources_of([files["clip"]], views=[("side", files["second"])], rig=files["rig"])
    (alone,) = sources_of([files["clip"]])
    digest = digest_of(source, config, head)
    assert digest != digest_of(alone, config, head)
    clip = observe(source, config, head, digest)
    seen = np.isfinite(clip.second.points).all((1, 2))
    assert np.flatnonzero(~seen).tolist() == [3, 22, 23]
    store_clip(Storage(str(tmp_path)), clip)
    again = stored_clip(Storage(str(tmp_path)), digest, "clip")
    np.testing.assert_array_equal(again.second.points, clip.second.points)
    for one, other in zip(again.second.placed.camera, clip.second.placed.camera, strict=True):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_allclose(
        again.second.placed.translation_view_reference_mm, read_rig(files["rig"]).translation_view_reference_mm[1]
    )


@pytest.mark.parametrize(
    "command", [["sweep", "--set", "weights.tau=0.1,1"], ["tune", "--search", "weights.tau=0.1,1"]]
)
def test_where_it_is_missing_one_sentence_says_so_before_anything_is_done(command, files, tmp_path):
    where = ["--objective", "second-view", "--out", str(tmp_path / "out")]
    code, said = run(command[0], files["clip"], *command[1:], *where)
    assert code != 0
    assert "needs the clip of a second camera and the rig of both (--view, --rig)" in said
    assert not (tmp_path / "out").exists()
    code, said = run(command[0], files["clip"], *command[1:], *where, "--view", f"side={files['second']}")
    assert code != 0
    assert "give --view and --rig" in said


def test_a_view_that_cannot_judge_is_told(files, tmp_path):
    head = load_default_head()

    def seen(view, **changes):
        (source,) = sources_of([files["clip"]], views=[(view, files["second"])], rig=changes.get("rig", files["rig"]))
        return observe(source, preset("joint"), head)

    with pytest.raises(InputError, match="is the rig's first view"):
        seen("middle")
    with pytest.raises(InputError, match="has no view 'top'"):
        seen("top")
    write_rig(make_rig((-15.0, 15.0), image_size=(320, 240)), tmp_path / "small.toml")
    with pytest.raises(InputError, match="calibrated at 320 × 240"):
        seen("side", rig=str(tmp_path / "small.toml"))
    base = in_first_view(preset("joint"), files["rig"])
    with pytest.raises(ConfigError, match="no effect with a camera's matrix"):
        Sweep(sources_of([files["clip"]]), (read_axis("camera.fov_deg=30,40"),), base).checked()
