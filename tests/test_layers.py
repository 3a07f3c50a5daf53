"""Imports point one way, and the repository keeps its promises."""

import ast
import json
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "workbench"

# A folder or module may import itself and what stands before it. The solvers know nothing of faces; the energies
# build their systems, so the solvers come first.
ORDER = [
    "errors",
    "arrays",
    "reading",
    "files",
    "inert_pickle",
    "runtime",
    "samples",
    "geometry",
    "solvers",
    "networks",
    "frames",
    "landmarks",
    "face",
    "rendering",
    "flow",
    "energies",
    "config",
    "tracking",
    "diagnosis",
    "pictures",
    "training",
    "plots",
    "export",
    "pipeline",
    "session",
    "widgets",
    "cli",
]


def modules() -> list[Path]:
    return sorted(PACKAGE.rglob("*.py"))


def layer(path: Path) -> str:
    part = path.relative_to(PACKAGE).parts[0]
    return part.removesuffix(".py")


def imported_layers(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module] if node.module != "workbench" else [f"workbench.{name.name}" for name in node.names]
        elif isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        found |= {name.split(".")[1] for name in names if name.startswith("workbench.")}
    return found


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_module_imports_only_what_stands_before_it(path):
    if path == PACKAGE / "__init__.py":
        return
    allowed = set(ORDER[: ORDER.index(layer(path)) + 1]) | {"__version__"}
    assert imported_layers(path) <= allowed


def test_solvers_know_nothing_of_faces():
    for path in (PACKAGE / "solvers").glob("*.py"):
        assert imported_layers(path) <= {"solvers", "arrays"}


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_nothing_is_loaded_by_executing_it(path):
    text = path.read_text(encoding="utf-8")
    for word in ("import pickle", "allow_pickle=True", "eval(", "exec("):
        assert word not in text


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.name)
def test_notebooks_are_stored_without_outputs_and_with_short_cells(path):
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None
            assert len("".join(cell["source"]).splitlines()) <= 25


def test_every_package_folder_says_what_it_is():
    for folder in [PACKAGE, *(path for path in PACKAGE.iterdir() if (path / "__init__.py").is_file())]:
        assert ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
