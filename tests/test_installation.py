"""What the first commands install: pinned versions, and nothing that only the tests need."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
DECLARED = [*PROJECT["dependencies"], *(need for extra in PROJECT["optional-dependencies"].values() for need in extra)]
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
    ("target", "tools", "torch"),
    [("lab", False, False), ("demo", False, False), ("test", True, False), ("test-train", True, True)],
)
def test_the_tests_tools_come_with_the_tests_only_and_pytorch_with_those_of_training(target, tools, torch, tmp_path):
    planned = subprocess.run(
        ["make", "--dry-run", f"VENV={tmp_path}/fresh", target], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    assert "--constraint constraints.txt" in planned
    assert ("app,test" in planned) == tools
    assert ("train]" in planned) == ("face-alignment" in planned) == torch


def test_the_tests_tools_hold_no_pytorch():
    assert not any(need.startswith("torch") for need in PROJECT["optional-dependencies"]["test"])
