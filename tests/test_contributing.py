"""The recipes of CONTRIBUTING.md work: applied to a copy of the package, what they add is there and does its work."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
RECIPES = dict(re.findall(r"^## (A [^\n]*)\n(.*?)(?=^## |\Z)", TEXT, re.S | re.M))
TRIED = {
    "A term of the energy": """
import json, sys
import numpy as np
from tests.deep_scenes import POINTS, make_deep_scene, make_parameters
from tests.scenes import make_scene
from workbench.config import Stage, config_schema, config_toml, preset
from workbench.energies.terms import table_page
from workbench.face import load_default_head
from workbench.planning import plan_of
from workbench.session.knobs import KNOBS, effective_weights
from workbench.tracking import FrameContext
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.face_it_fitter import FaceItFitter

assert "neighbours" in json.loads(config_schema())["$defs"]["WeightsConfig"]["properties"]
assert "neighbours = 0.0 # ω_nb: neighbouring weights alike." in config_toml(preset("joint"))
assert "## E_nb: `neighbours`" in table_page()
(knob,) = [knob for knob in KNOBS if knob.path == "weights.neighbours"]
assert "neighbouring weights alike" in knob.tip and knob.label == "ω_nb"
assert effective_weights(preset("joint").changed(weights={"neighbours": 7.0}))["weights.neighbours"] == 7.0

head, smile = load_default_head(), {"mouthSmileLeft": 0.8, "jawOpen": 0.4}
scene = make_scene(head, weights=smile)
deep = make_deep_scene(DeepFitter(head, plan_of(POINTS)), make_parameters(head, weights=smile))
stage = Stage(name="all", free=("rotation", "translation", "expression"), limit=10)
rough = []
for base, fitter, observation in (
    (preset("joint"), FaceItFitter, scene.observation()), (POINTS, DeepFitter, deep.observation())
):
    for terms in ((), ("neighbours",)):
        config = base.changed(stages=[stage.model_dump() | {"terms": terms}], weights={"neighbours": 1e4})
        made = fitter(head, plan_of(config))
        fit, traces = made.explain(observation, FrameContext(0, np.zeros(50), None, None))
        rough.append(np.abs(np.diff(fit.expression)).sum())
        assert ("neighbours" in made.terms) == bool(terms)
        assert traces[0].energies.shape[1] == len(made.terms) == fit.energies.shape[1]
    assert rough[-1] < 0.5 * rough[-2], rough
""",
    "A detector": """
import numpy as np
import workbench
from workbench.landmarks.detectors import make_detector
picture = np.zeros((240, 320, 3), np.uint8)
detector = make_detector("centre")
(face,) = detector.detect_faces(picture)
points = detector.align(picture, face.box).points
assert abs(points[36:48].mean(axis=0) - [160.0, 120.0 - 0.19 * 120.0]).max() < 1.0  # the eyes
config = workbench.preset("joint").changed(landmarks={"detector": "centre"})
assert workbench.fit(picture, config=config).frame.found
""",
    "A face model's format": """
import json, pathlib
import numpy as np
from workbench.face import load_default_head, load_face_model
head = load_default_head()
shapes = {"jawOpen": head.expression_deltas[head.expression_names.index("jawOpen")].tolist()}
nearest = head.landmarks.vertices[np.arange(68), head.landmarks.barycentric.argmax(axis=1)]
held = {"vertices": head.neutral.tolist(), "triangles": head.triangles.tolist(), "blendshapes": shapes,
        "landmarks": nearest.tolist()}
path = pathlib.Path("mine.json")
path.write_text(json.dumps(held))
model = load_face_model(path)
assert model.expression_names == ("jawOpen",)
assert np.abs(model.neutral - head.neutral).max() < 0.5
""",
    "A reason of the diagnosis": """
from types import SimpleNamespace
from workbench.diagnosis.causes import INPUT_CAUSES
from workbench.diagnosis.causes.size import small_face
assert small_face in INPUT_CAUSES
seen = lambda px: list(small_face(SimpleNamespace(face_px=px, fit=None, error_percent=lambda fit: 2.0)))
assert seen(100.0) == []
assert "40 pixels" in seen(40.0)[0].evidence
""",
}


def test_every_recipe_is_tried():
    assert set(RECIPES) == set(TRIED)


@pytest.mark.parametrize("recipe", TRIED)
def test_a_recipe_works_as_it_is_written(recipe, tmp_path):
    for name in ("workbench", "tests"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__", "*.pyc"))
    (tmp_path / "data_samples").symlink_to(ROOT / "data_samples")
    blocks = re.findall(r"```(python|diff)\n# (\S+)\n(.*?)```", RECIPES[recipe], re.S)
    assert {kind for kind, _, _ in blocks} == {"python", "diff"}
    for kind, name, text in blocks:
        (write if kind == "python" else apply)(tmp_path / name, text)
    done = subprocess.run(
        [sys.executable, "-c", TRIED[recipe]],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


def write(path: Path, text: str) -> None:
    assert not path.exists()
    path.write_text(text, encoding="utf-8")


def apply(path: Path, changes: str) -> None:
    """Put a block of changes into a file: lines that stay or go are there once, in this order."""
    lines = changes.splitlines()
    before = "".join(f"{line[1:]}\n" for line in lines if line[:1] != "+")
    after = "".join(f"{line[1:]}\n" for line in lines if line[:1] != "-")
    text = path.read_text(encoding="utf-8")
    assert text.count(before) == 1, f"{path.name} does not hold once:\n{before}"
    path.write_text(text.replace(before, after), encoding="utf-8")


def test_the_table_of_packages_names_those_that_there_are():
    table = TEXT[TEXT.index("| package |") :].split("\n\n")[0]
    named = set(re.findall(r"`(\w+)`[,| ]", "\n".join(line.split("|")[1] + "|" for line in table.splitlines()[2:])))
    packages = {path.stem for path in (ROOT / "workbench").iterdir() if (path / "__init__.py").exists()}
    assert named <= packages | {"config", "planning", "tracker"}
    assert packages - named <= {"training"}
