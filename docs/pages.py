"""Pages of the documentation that follow from the code: the interface, and the layers of the package."""

import ast
import importlib
import inspect
from functools import cache
from pathlib import Path


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
