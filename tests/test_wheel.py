"""The wheel, installed without the repository: it holds what is needed, tracks the demo and serves the notebooks."""

import json
import os
import re
import signal
import subprocess
import sys
import sysconfig
import urllib.request
import venv
import zipfile
from pathlib import Path

import pytest

from workbench.samples import SAMPLES

ROOT = Path(__file__).resolve().parent.parent
MOST_MB = 30.0  # nine of them are the dense network, six the characters' skins, hair and parts, six the heat maps

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, text=True)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory) -> Path:
    """An environment with the wheel, and with the other packages of this one lent to it; the repository is not there.

    A folder named in a .pth file is searched, but its own .pth files are not read, so the editable install stays out.
    """
    folder = tmp_path_factory.mktemp("clean")
    venv.create(folder / "env", with_pip=False, symlinks=True)
    scheme = {"base": str(folder / "env"), "platbase": str(folder / "env")}
    packages = Path(sysconfig.get_path("purelib", "venv", scheme))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    (packages / "lent.pth").write_text(f"{sysconfig.get_path('purelib')}\n", encoding="utf-8")
    return Path(sysconfig.get_path("scripts", "venv", scheme)) / "python"


@pytest.fixture
def environment(tmp_path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return {**kept, "JUPYTER_CONFIG_DIR": str(tmp_path), "JUPYTER_DATA_DIR": str(tmp_path)}


def workbench(python: Path, *words: str) -> list[str]:
    # Where the tests run in the background, Ctrl-C is ignored, and programs that they start inherit that.
    heard = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    return [str(python), "-c", f"{heard}; from workbench.cli import main; main()", *words]


def test_it_holds_the_samples_and_notebooks_but_nothing_that_only_the_repository_needs(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = set(archive.namelist())
    assert {f"workbench/data_samples/{file}" for file in SAMPLES.values()} <= held
    assert {f"workbench/notebooks/{path.name}" for path in (ROOT / "notebooks").glob("*.ipynb")} <= held
    assert {"workbench/py.typed", "workbench/__init__.pyi", "workbench/data_samples/SOURCES.md"} <= held
    assert not [name for name in held if "/bake/" in name or re.search(r"data_samples/.*\.py$", name)]
    assert not [name for name in held if name.startswith(("tests/", "docs/", "benchmarks/"))]
    assert wheel.stat().st_size < MOST_MB * 1e6


def test_every_sample_is_there_and_notebooks_open_no_other(python, environment, tmp_path):
    names = {
        name
        for path in (ROOT / "notebooks").glob("*.ipynb")
        for name in re.findall(r'\bsample\(\\?"([\w-]+)\\?"\)', path.read_text(encoding="utf-8"))
    }
    assert {"astronaut", "laugh", "performance"} <= names <= set(SAMPLES)
    code = f"import workbench; print([workbench.sample(name).stat().st_size for name in {sorted(SAMPLES)}])"
    done = subprocess.run([python, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert min(json.loads(done.stdout)) > 0


@pytest.mark.long
def test_the_demo_tracks_both_inputs_with_faces_that_it_finds(python, environment, tmp_path):
    done = subprocess.run(
        workbench(python, "demo"), cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stderr
    for name, frames, picture in (("astronaut", 1, "overlay.png"), ("laugh", 150, "overlay.mp4")):
        folder = tmp_path / "demo_out" / name
        summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
        assert summary["frames"] == summary["frames_with_face"] == frames
        assert summary["detector"] == "network"
        assert summary["reprojection_error"]["inner_51_percent_of_eye_distance"]["mean"] < 2.0
        assert (folder / picture).stat().st_size > 100_000
    assert str(ROOT) not in done.stdout


@pytest.mark.long
def test_jupyterlab_serves_copies_of_the_notebooks(python, environment, tmp_path):
    lab = subprocess.Popen(
        workbench(python, "lab", "--no-browser", "--port", "8950"), cwd=tmp_path, env=environment,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        lines = []
        while not (lines and "?token=" in lines[-1]):
            lines.append(lab.stdout.readline())
            assert lines[-1], lines
        address = re.search(r"http://\S+", lines[-1])[0]
        with urllib.request.urlopen(address) as answer:
            assert "jupyter-config-data" in answer.read().decode()
        asked = address.replace("/lab/tree/", "/api/contents/")
        with urllib.request.urlopen(asked) as answer:
            assert json.load(answer)["type"] == "notebook"
    finally:
        lab.send_signal(signal.SIGINT)
        lab.stdout.read()
        lab.stdout.close()
        lab.wait(60)
    assert (tmp_path / "workbench_notebooks" / "00_quickstart.ipynb").is_file()
