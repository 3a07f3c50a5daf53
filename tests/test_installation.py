"""What the first commands install: pinned versions, and nothing that only the tests need."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

import workbench

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
OWN = f"{PROJECT['name']}["
DECLARED = [
    need
    for group in (PROJECT["dependencies"], *EXTRAS.values())
    for need in group
    if not need.startswith(OWN)  # an extra may take in others
]
PINS = [line for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if line[0] != "#"]


def test_the_constraints_are_plain_versions():
    assert len(PINS) > 100
    for line in PINS:
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.]*", line), line


@pytest.mark.parametrize("declared", DECLARED)
def test_every_dependency_is_pinned_inside_its_range(declared):
    pinned = {canonical(name): version for name, _, version in (line.partition("==") for line in PINS)}
    need = Requirement(declared)
    assert need.specifier.contains(pinned[canonical(need.name)])


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize(
    ("target", "extras"),
    [
        ("demo", [""]),
        ("lab", ["", "app,formats,lab"]),
        ("test", ["", "test"]),
        ("test-train", ["", "test", "test,train"]),
        ("docs", ["", "docs"]),
    ],
)
def test_a_target_installs_what_it_needs_and_nothing_else(target, extras, tmp_path):
    planned = subprocess.run(
        ["make", "--dry-run", f"VENV={tmp_path}/fresh", target], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert "--constraint constraints.txt" in planned
    assert re.findall(r'--editable "\.(?:\[(.+?)\])?"', planned) == extras
    assert ("face-alignment" in planned) == (target == "test-train")


def test_pytorch_comes_with_training_only():
    assert [kind for kind, needs in EXTRAS.items() if any(need.startswith("torch") for need in needs)] == ["train"]
    assert not any(need.startswith("torch") for need in PROJECT["dependencies"])


def test_an_extra_takes_in_only_extras_that_there_are():
    taken = [need for needs in EXTRAS.values() for need in needs if need.startswith(OWN)]
    assert taken
    assert {name for need in taken for name in Requirement(need).extras} <= set(EXTRAS)


def test_one_version_everywhere():
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)[1]
    latest = re.findall(r"^## (\d\S*)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.M)[0]
    assert workbench.__version__ == cited == latest
