"""Pages of the documentation that follow from the code: the interface, the layers of the package, the papers' lines."""

import ast
import importlib
import inspect
import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from workbench.energies.terms import TABLE


def layers(root: Path) -> list[str]:
    """The parts of the package from the bottom to the top, as the test of the layers lists them."""
    tree = ast.parse((root / "tests" / "test_layers.py").read_text(encoding="utf-8"))
    named = (node for node in tree.body if isinstance(node, ast.Assign) and node.targets[0].id == "ORDER")
    return ast.literal_eval(next(named).value)


def first_line(root: Path, name: str) -> str:
    """What a part of the package says of itself in the first line of its docstring."""
    folder = root / "workbench" / name
    file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    said = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
    return said.partition("\n")[0]


def used_layers(root: Path, name: str) -> list[str]:
    """The other parts of the package that one imports from."""
    place = root / "workbench" / name
    files = sorted(place.rglob("*.py")) if place.is_dir() else [place.with_suffix(".py")]
    found = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("workbench."):
                found.add(node.module.split(".")[1])
    return [other for other in layers(root) if other in found and other != name]


def architecture_page(root: Path) -> str:
    """The parts of the package from the top to the bottom, with what each imports."""
    rows = [
        f"| `{name}` | {first_line(root, name).replace('|', '&#124;')} | {', '.join(used_layers(root, name))} |"
        for name in reversed(layers(root))
    ]
    return "\n".join(
        [
            "# Architecture",
            "",
            "A part of the package imports what stands below it here, and nothing above: `tests/test_layers.py` keeps",
            "it so, and this table follows from that test. To add a term, a detector, a face model or a diagnosis, see",
            "`CONTRIBUTING.md`, whose recipes are tested.",
            "",
            "| part | what it is | imports from |",
            "|---|---|---|",
            *rows,
            "",
        ]
    )


@cache
def packages(root: Path) -> tuple[str, ...]:
    """The front door and the packages behind it, from the bottom to the top; not the command line."""
    within = [f"workbench.{name}" for name in layers(root) if name != "cli"]
    return ("workbench", *(name for name in within if offered(root, name)))


@cache
def offered(root: Path, package: str) -> dict[str, str]:
    """The names that a package offers, with the directive that documents each."""
    folder = root.joinpath(*package.split("."))
    stub = next((file for file in (folder / "__init__.pyi", folder / "__init__.py") if file.is_file()), None)
    if stub is None:
        return {}
    body = ast.parse(stub.read_text(encoding="utf-8")).body
    taken = [node for node in body if isinstance(node, ast.ImportFrom)]
    ours = [node for node in taken if node.level or (node.module or "").startswith("workbench")]
    names = {alias.asname for node in ours for alias in node.names if alias.asname}
    names |= {node.name for node in body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    public = sorted((name for name in names if not name.startswith("_")), key=str.lower)
    module = importlib.import_module(package)
    directives = {name: directive(getattr(module, name)) for name in public}
    return {name: kind for name, kind in directives.items() if kind}


def directive(thing: object) -> str:
    """How Sphinx documents a thing: as a class, a function or data; empty for a module."""
    if inspect.ismodule(thing):
        return ""
    if inspect.isclass(thing):
        return "autoexception" if issubclass(thing, Exception) else "autoclass"
    return "autofunction" if callable(thing) else "autodata"


def shown_before(root: Path, package: str, name: str) -> bool:
    """Whether a package below offers the same thing, whose page is then the one that the index leads to."""
    thing = getattr(importlib.import_module(package), name)
    below = [*packages(root)[1:], "workbench"]
    for other in below[: below.index(package)]:
        if name in offered(root, other) and getattr(importlib.import_module(other), name) is thing:
            return True
    return False


def api_page(root: Path, package: str) -> str:
    """The page of a package: what it says of itself, and every name that it offers."""
    lines = [f"# `{package}`", "", "```{eval-rst}", f".. automodule:: {package}", ""]
    for name, kind in offered(root, package).items():
        options = ["   :members:"] if kind == "autoclass" else []
        if shown_before(root, package, name):
            options.append("   :no-index:")
        lines += [f".. {kind}:: {package}.{name}", *options, ""]
    return "\n".join([*lines, "```", ""])


def paper_table(root: Path) -> list[dict[str, Any]]:
    """The papers with their lines, as `docs/papers.toml` has them."""
    return tomllib.loads((root / "docs" / "papers.toml").read_text(encoding="utf-8"))["papers"]


def papers_page(root: Path) -> str:
    """Every equation and setting of the papers: where it is, what shows and tests it, and where ours differs."""
    lines = [
        "# The papers, line by line",
        "",
        "Every equation and setting: the function that has it, the cell that shows it, its tests, and what is ours",
        "instead. `tests/paper_formulas.py` has the printed formulas in plain NumPy, written from the papers alone;",
        "`test_paper_face_it.py` and `test_paper_deep_energies.py` compare them with ours after the conversions that",
        "are told here: values and gradients agree to 1e-9, and to 1e-4 where a render or a network in single",
        "precision is inside.",
        "",
    ]
    for paper in paper_table(root):
        lines += [f"## {paper['title']}", "", "| | | |", "|---|---|---|"]
        lines += [f"| {line['place']} | {line['says']} | {_verdict(line)} |" for line in paper["lines"]]
        lines.append("")
        for line in paper["lines"]:
            lines += paper_line(root, line)
    return "\n".join(lines)


def paper_line(root: Path, line: dict[str, Any]) -> list[str]:
    """One line of a paper as a section."""
    code = [name.replace(":", ".") for name in line.get("code", ())]
    settings = list(line.get("settings", ()))
    made = [f"### {line['place']}: {line['says']}", ""]
    if "term" in line:
        term = TABLE[line["term"]]
        made += [f"`{term.formula}`, the term `{term.name}`", ""]
        code.insert(0, "workbench.energies." + term.residual.replace(":", "."))
        if term.of != "landmarks":
            settings = list(dict.fromkeys([*(term.omega_key(name) for name in _systems(term)), *settings]))
    shown = [_notebook_link(root, place) for place in line.get("notebooks", ())]
    rows = {
        "Code": [f"{{py:obj}}`{name}`" for name in code],
        "Settings": [f"`{key}`" for key in settings],
        "Notebook": shown,
        "Tests": [f"`tests/{test}`" for test in line.get("tests", ())],
    }
    made += [f"- {name}: {', '.join(parts)}" for name, parts in rows.items() if parts]
    return [*made, f"- {_verdict(line)}{': ' + line['differs'] if 'differs' in line else '.'}", ""]


def notebook_headings(root: Path, name: str) -> list[str]:
    """The headings of a notebook, without their marks."""
    cells = json.loads((root / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]
    written = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    return [line.lstrip("# ") for line in written.splitlines() if line.startswith("#")]


def _verdict(line: dict[str, Any]) -> str:
    return "Ours differs" if "differs" in line else "As printed"


def _systems(term) -> tuple[str, ...]:
    return tuple(dict.fromkeys([*term.systems, *term.listed])) or ("face-it",)


def _notebook_link(root: Path, place: str) -> str:
    name, begins = place.split("#")
    heading = next(heading for heading in notebook_headings(root, name) if heading.startswith(begins))
    return f"[{name[:2]}, {heading}](notebooks/{name}.ipynb)"
