"""`workbench model show` and `workbench track --model`: another face model on the command line."""

import csv
import pickle

import numpy as np
import pytest
from pygltflib import GLTF2

from tests.face_files import Calls, flame_arrays, make_subject, python2_pickle
from tests.scenes import make_scene
from workbench.face import load_face_model
from workbench.frames import read_picture
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord
from workbench.landmarks.observations import Landmarks2D
from workbench.samples import sample
from workbench.tracking import Track


@pytest.fixture
def flame_file(tmp_path):
    (tmp_path / "flame.pkl").write_bytes(python2_pickle(flame_arrays(make_subject())))
    return tmp_path / "flame.pkl"


def test_show_tells_what_a_model_holds_and_draws_it(run, flame_file, tmp_path):
    code, out, err = run("model", "show", "flame.pkl", "--picture", "check.png")
    assert (code, err) == (0, "")
    told = {line.split()[0]: line.split(maxsplit=1)[1].strip() for line in out.splitlines() if " " in line}
    assert told["vertices"] == "3,521"
    assert told["shapes"] == "13: 3 with ARKit's names, 10 others"
    assert told["identity"] == "10 components"
    assert told["joints"] == "root, neck, jaw, leftEye, rightEye"
    assert told["jaw"].startswith("26.5° open, ")
    assert told["landmarks"] == "68, jaw contour for 9 yaws"
    assert "stored in metres" in told["note"]
    picture = read_picture(tmp_path / "check.png")
    assert picture.shape == (560, 3 * 560, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 200


def test_options_of_show_reach_the_reader(run, flame_file):
    _, out, _ = run("model", "show", "flame.pkl", "--identity", "2", "--expressions", "1")
    assert "2 components" in out
    assert "4: 3 with" in out
    code, _, err = run("model", "show", "flame.pkl", "--unit", "ells")
    assert code == 2
    assert "no unit 'ells'" in err


def test_a_hostile_model_is_one_sentence_and_leaves_no_trace(run, tmp_path):
    hostile = {"v_template": Calls(print, "run"), "shapedirs": 0}
    (tmp_path / "bad.pkl").write_bytes(pickle.dumps(hostile))
    for command in (("model", "show", "bad.pkl"), ("track", "points.csv", "--model", "bad.pkl")):
        code, out, err = run(*command)
        assert code == 2
        assert out == ""
        assert err.count("\n") == 1
        assert "nothing of it was run" in err


@pytest.mark.long
def test_track_takes_another_model(run, flame_file, tmp_path):
    model = load_face_model(flame_file)
    with LandmarkCsvWriter(tmp_path / "points.csv", confidence=False) as writer:
        for index in range(3):
            scene = make_scene(model, (4.0 * index, 0, 0), {"jawOpen": 0.2 * index, "expression_000": -1.0})
            writer.write(LandmarkRecord(index, "", Landmarks2D(scene.points, np.ones(68), (640, 480)), None))
    code, out, err = run("track", "points.csv", "--model", "flame.pkl", "--no-pictures")
    assert (code, err) == (0, "")
    assert "3 of 3 with a face" in out
    track = Track.load(tmp_path / "out" / "points" / "track.npz")
    assert track.expression_names == model.expression_names
    assert track.expression[:, 0].max() < -0.3


def test_export_takes_the_track_of_another_model(run, flame_file, tmp_path):
    model = load_face_model(flame_file)
    scene = make_scene(model, (4.0, 0, 0), {"jawOpen": 0.3, "expression_000": -1.0})
    with LandmarkCsvWriter(tmp_path / "points.csv", confidence=False) as writer:
        writer.write(LandmarkRecord(0, "", Landmarks2D(scene.points, np.ones(68), (640, 480)), None))
    run("track", "points.csv", "--model", "flame.pkl", "--no-pictures", "--out", "made")
    code, _, err = run("export", "made", "--to", "made.glb")
    assert code == 2
    assert "--model" in err
    code, out, err = run("export", "made", "--model", "flame.pkl", "--to", "made.glb", "--to", "made.csv")
    assert (code, err) == (0, "")
    assert "note" not in out
    with (tmp_path / "made.csv").open(newline="") as stream:
        row = next(csv.DictReader(stream))
    track = Track.load(tmp_path / "made" / "track.npz")
    for name, weight in zip(model.expression_names, track.expression[0], strict=True):
        assert float(row[name]) == pytest.approx(weight, abs=1e-4)
    names = GLTF2().load(str(tmp_path / "made.glb")).meshes[0].extras["targetNames"]
    assert set(model.expression_names) <= set(names)


def test_export_with_a_wrong_model_is_one_sentence(run, flame_file, tmp_path):
    run("track", str(sample("astronaut-landmarks")), "--no-pictures", "--out", "made")
    for wrong, words in (("flame.pkl", "retarget"), ("missing.npz", "missing.npz")):
        code, _, err = run("export", "made", "--model", wrong, "--to", "made.glb")
        assert code == 2
        assert err.count("\n") == 1
        assert words in err
    assert not (tmp_path / "made.glb").exists()
