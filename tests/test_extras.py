"""Without an extra the library still works; what needs one says in one sentence which, and how to install it."""

import ast
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from workbench import extras
from workbench.errors import MissingDependencyError

ROOT = Path(__file__).resolve().parent.parent
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
MODULES = {
    "lab": ("anywidget", "ipywidgets", "jupyterlab", "IPython", "traitlets"),
    "formats": ("h5py", "pygltflib", "trimesh"),
    "usd": ("pxr",),
    "parquet": ("pyarrow",),
    "cluster": ("bokeh", "dask", "distributed", "fsspec"),
    "app": ("voila",),
    "dlib": ("dlib", "face_recognition_models"),
    "train": ("torch",),
}
BROUGHT = {"mediapipe"}
"""Not declared, as installing it with what it depends on would replace the headless OpenCV."""
BARE = f"""
import sys
from importlib.machinery import PathFinder

find = PathFinder.find_spec
hidden = {[name for names in MODULES.values() for name in names]}
PathFinder.find_spec = lambda name, *rest: None if name.partition(".")[0] in hidden else find(name, *rest)
"""
"""Put before a program, it leaves it the library's own dependencies."""


def in_a_bare_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", BARE + code], capture_output=True, text=True)


def command(line: str) -> str:
    return f"sys.argv = {['workbench', *line.split()]}; from workbench.cli import main; main()"


def test_every_name_of_the_front_door_loads_without_extras():
    names = "[name for name in workbench.__all__ if name != 'widgets']"
    done = in_a_bare_python(f"import workbench; print([getattr(workbench, name) for name in {names}])")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("line", ["--help", "info", "config show", "track --help", "export --help"])
def test_the_command_line_runs_without_extras(line):
    done = in_a_bare_python(command(line))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("extra", "code"),
    [
        ("lab", "import workbench.widgets"),
        ("lab", "from workbench.widgets import TuningPanel"),
        ("formats", "import workbench.export.gltf"),
        ("formats", "from pathlib import Path; from workbench.face.formats.hdf5 import hdf5_arrays; "
         "hdf5_arrays(Path('model.h5'), ['shape'])"),
        ("dlib", "from workbench.landmarks import make_detector; make_detector('dlib')"),
        ("cluster", "from workbench.workers import workers_for; workers_for(2, kind='dask')"),
        ("cluster", "from workbench.sweeps.storage import Storage; Storage('s3://films').read('a')"),
    ],
)  # fmt: skip
def test_what_needs_an_extra_names_it_and_the_command(extra, code):
    done = in_a_bare_python(code)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("workbench.errors.MissingDependencyError: ")
    assert f'pip install "face-energy-workbench[{extra}]"' in last


@pytest.mark.parametrize(
    ("extra", "line"),
    [
        ("lab", "lab"),
        ("app", "app"),
        ("train", "train landmarks nowhere"),
        ("cluster", "sweep a.csv --scheduler tcp://127.0.0.1:9"),
    ],
)
def test_a_command_that_needs_an_extra_says_so_in_one_sentence(extra, line):
    done = in_a_bare_python(command(line))
    assert done.returncode == 2
    assert f'pip install "face-energy-workbench[{extra}]"' in done.stderr.replace("\n", " ")
    assert "Traceback" not in done.stderr


def test_a_mesh_without_landmarks_asks_for_the_extra(head, monkeypatch, tmp_path):
    from workbench.face.formats.landmark_fit import fit_landmarks

    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingDependencyError, match=r'trimesh .*pip install "face-energy-workbench\[formats\]"'):
        fit_landmarks(head.neutral, head.triangles, {}, {}, {}, 1.0, head)


def test_other_errors_of_an_import_pass():
    with pytest.raises(ImportError, match="no_such_name") as caught, extras.needs("formats"):
        from json import no_such_name  # noqa: F401
    assert not isinstance(caught.value, MissingDependencyError)


def test_every_package_that_is_imported_is_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    everything = [*project["dependencies"], *(need for needs in EXTRAS.values() for need in needs)]
    declared = {canonicalize_name(Requirement(need).name) for need in everything}
    of_module = {"dlib": ["dlib-bin"], "torch": ["torch"], **packages_distributions()}
    undeclared = {
        module
        for path in (ROOT / "workbench").rglob("*.py")
        for module in imported(path)
        if not declared & {canonicalize_name(name) for name in of_module.get(module, ())}
    }
    assert undeclared == BROUGHT


def imported(path: Path) -> set[str]:
    """The packages of others that a file imports, at its top or late."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module.partition(".")[0])
    return names - sys.stdlib_module_names - {"workbench"}


def test_the_library_itself_needs_none_of_the_extras_packages():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = {need.partition(">")[0] for need in project["dependencies"]}
    for extra in MODULES:
        own = {need.partition(">")[0] for need in EXTRAS[extra] if not need.startswith("face-energy-workbench")}
        assert own
        assert not own & names
