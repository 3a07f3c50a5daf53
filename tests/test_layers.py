"""Imports point one way, and the repository keeps its promises."""

import ast
import json
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "workbench"

# A folder or module may import itself and what stands before it. The solvers know nothing of faces; the energies
# build their systems, so the solvers come first.
ORDER = [
    "errors",
    "extras",
    "arrays",
    "reading",
    "files",
    "inert_pickle",
    "program_cache",
    "runtime",
    "workers",
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
    "tracking",
    "config",
    "planning",
    "tracker",
    "diagnosis",
    "objectives",
    "pictures",
    "training",
    "plots",
    "export",
    "pipeline",
    "one_picture",
    "reproduction",
    "sweeps",
    "learning",
    "session",
    "widgets",
    "cli",
]


LONGEST_CLASS = {"config": 150, "landmarks": 225, "session": 225, "tracking": 225, "widgets": 200}
"""Lines of classes by package. Take a class apart along what it does before you name it among the longer ones."""
LONGER_CLASSES = {
    "TuningPanel": 212,  # here alone meet fits, session and views, each of which has a class of its own
    "TuningSession": 312,  # what notebooks, panels and commands call: forty short calls with their documentation
}


def modules() -> list[Path]:
    """The modules, and the stubs that say what packages load when it is used."""
    return sorted([*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.pyi")])


def layer(path: Path) -> str:
    part = path.relative_to(PACKAGE).parts[0]
    return part.removesuffix(".py")


def dotted(path: Path) -> str:
    """The module that a file holds, or speaks for."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(source: str, package: str) -> set[tuple[str, str]]:
    """(module, name) of everything of ours that a source text imports, at its top or late; no name: all of a module.

    What is reached through the front door, as `workbench.face.FaceModel`, counts as imported from `workbench.face`.
    `package` is where relative imports begin.
    """
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            module = ".".join(filter(None, [package, node.module])) if node.level else node.module
            found |= {(module, name.name) for name in node.names}
        elif isinstance(node, ast.Import):
            found |= {(name.name, "") for name in node.names}
        elif isinstance(node, ast.Attribute):
            module, _, name = ast.unparse(node).rpartition(".")
            found |= {(module, name)} if module in module_files() else set()
    return {(module, name) for module, name in found if module.split(".")[0] == "workbench"}


def imports_of_file(path: Path) -> set[tuple[str, str]]:
    return imports(path.read_text(encoding="utf-8"), dotted(path.parent / "__init__.py"))


@cache
def module_files() -> dict[str, Path]:
    return {dotted(path): path for path in PACKAGE.rglob("*.py")}


@cache
def package_names() -> dict[tuple[str, str], tuple[str, str]]:
    """(package, name) -> (module, name): where packages take the names from that they offer."""
    offering = [*PACKAGE.rglob("__init__.pyi"), *PACKAGE.rglob("__init__.py")]
    return {(dotted(path), name): (module, name) for path in offering for module, name in imports_of_file(path)}


def home(module: str, name: str) -> str:
    """The module in which an imported name is written."""
    while True:
        if f"{module}.{name}" in module_files():
            return f"{module}.{name}"
        if (module, name) not in package_names() or package_names()[module, name] == (module, name):
            return module
        module, name = package_names()[module, name]


def imported_modules(path: Path) -> set[str]:
    """The modules that a file needs, with packages looked through."""
    return {home(module, name) for module, name in imports_of_file(path)}


def imported_layers(path: Path) -> set[str]:
    return {module.split(".")[1] for module in imported_modules(path) if module != "workbench"}


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Modules that import one another in turn; empty if there are none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_a_module_imports_only_what_stands_before_it(path):
    if path.parent == PACKAGE and path.stem == "__init__":
        return
    assert imported_layers(path) <= set(ORDER[: ORDER.index(layer(path)) + 1])


def test_no_modules_import_one_another_in_a_circle_not_even_inside_functions():
    files = [path for path in modules() if path.name != "__init__.pyi"]
    graph = {dotted(path): imported_modules(path) - {dotted(path), "workbench"} for path in files}
    assert circle(graph) == []


def test_imports_through_stubs_and_the_front_door_and_late_ones_are_seen():
    assert "workbench.face.formats.loading" in imported_modules(PACKAGE / "face" / "__init__.pyi")
    assert home("workbench", "TuningSession") == "workbench.session.tuning"
    late = "import workbench\ndef late():\n    from workbench import plots\n    return workbench.face.FaceModel"
    seen = {home(module, name) for module, name in imports(late, "workbench")}
    assert {"workbench.plots", "workbench.face.model"} <= seen


def test_a_circle_is_told_by_its_modules():
    assert set(circle({"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}})) == {"a", "b", "c"}
    assert circle({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_solvers_know_nothing_of_faces():
    for path in (PACKAGE / "solvers").glob("*.py"):
        assert imported_layers(path) <= {"solvers", "arrays"}


def class_lines(package: str) -> list[tuple[str, int]]:
    """Name and lines of every class of a package."""
    trees = [ast.parse(path.read_text(encoding="utf-8")) for path in (PACKAGE / package).rglob("*.py")]
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    return [(node.name, node.end_lineno - node.lineno + 1) for node in classes]


@pytest.mark.parametrize("package", LONGEST_CLASS)
def test_no_class_is_long(package):
    most = LONGEST_CLASS[package]
    long = {name: count for name, count in class_lines(package) if count > LONGER_CLASSES.get(name, most)}
    assert not long, f"take apart, along what they do, these classes with so many lines: {long}"


def test_a_class_that_is_no_longer_long_leaves_the_table():
    long = {name for package, most in LONGEST_CLASS.items() for name, count in class_lines(package) if count > most}
    assert long == set(LONGER_CLASSES)


def asks_for_the_system(source: str) -> list[int]:
    """Lines that compare `….system` with something, or ask whether something is one system's fitter."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            found += [node.lineno for side in sides if isinstance(side, ast.Attribute) and side.attr == "system"]
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("isinstance", "type"):
            found += [node.lineno] if "Fitter" in ast.unparse(node) else []
    return found


@pytest.mark.parametrize("name", ["session", "widgets", "pipeline", "cli", "diagnosis", "pictures", "export"])
def test_nothing_above_the_fitters_asks_which_system_it_is(name):
    """What a system can do stands in its row of `energies/systems.py`."""
    asking = {str(path): asks_for_the_system(path.read_text()) for path in modules() if layer(path) == name}
    assert {path: lines for path, lines in asking.items() if lines} == {}
    assert asks_for_the_system('if config.system == "face-it" and isinstance(fitter, DeepFitter): pass') == [1, 1]


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
