"""The browser programs: the ES modules of `browser/`, joined into the single program that anywidget needs.

anywidget loads a widget's program from a blob, which cannot import files, and recommends a bundler. Our modules use so
little of the import syntax that they are joined here, without tools or network: each becomes a function that returns
its exports, called in order of dependency.
"""

import re
from pathlib import Path

from workbench.errors import InputError

BROWSER = Path(__file__).with_name("browser").resolve()
IMPORT = re.compile(r'^import \{([^}]*)\} from "(\.[^"]*)";$', re.MULTILINE)
EXPORT = re.compile(r"^export (?=(?:async function|function|class|const)\b)", re.MULTILINE)
DECLARED = re.compile(r"^export (?:(?:async function|function|class) (\w+)|const ([^;]*);)", re.MULTILINE)
CONSTANT = re.compile(r"(?:^|, )(\w+) = ")
FOREIGN = re.compile(r"^(?:import\b|export (?!default )).*", re.MULTILINE)


def browser_program(name: str, folder: Path = BROWSER) -> str:
    """The program of a module such as "chart/view.js" with everything it imports: a string for `_esm`.

    Modules write `import { a, b } from "./other.js";`, and `export` before functions, classes and constants of one
    line; only the requested one has an `export default`. Raises `InputError` for other imports and exports, and for
    circular imports.
    """
    entry = (folder / name).resolve()
    return "\n".join([*(_called(path, folder) for path in _needed(entry)), _text(entry, folder)])


def style_text(name: str, folder: Path = BROWSER) -> str:
    """The style sheet of a file such as "chart/view.css": a string for `_css`.

    Of a path, anywidget would follow the file for each widget, and so keep every widget for good.
    """
    return (folder / name).read_text(encoding="utf-8")


def _needed(path: Path, above: tuple[Path, ...] = ()) -> list[Path]:
    """The modules that a module imports, each after its own dependencies."""
    if path in above:
        raise InputError(
            f"{path.name} and {above[-1].name} import each other in a circle; move what they share into a third module."
        )
    others = [(path.parent / place).resolve() for _, place in IMPORT.findall(path.read_text(encoding="utf-8"))]
    return list(dict.fromkeys(found for other in others for found in (*_needed(other, (*above, path)), other)))


def _called(path: Path, folder: Path) -> str:
    """A module as a function, to keep its names private, with its exports assigned to a constant."""
    returned = []
    for function, constants in DECLARED.findall(path.read_text(encoding="utf-8")):
        returned += [function] if function else CONSTANT.findall(constants)
    text = _text(path, folder)
    return f"const {_constant(path, folder)} = (() => {{\n{text}return {{ {', '.join(returned)} }};\n}})();"


def _text(path: Path, folder: Path) -> str:
    """The text of a module with its imports as constants, and without the keyword of non-default exports."""

    def imported(match: re.Match[str]) -> str:
        return f"const {{{match[1]}}} = {_constant((path.parent / match[2]).resolve(), folder)};"

    text = EXPORT.sub("", IMPORT.sub(imported, path.read_text(encoding="utf-8")))
    if foreign := FOREIGN.search(text):
        raise InputError(f"{path} has {foreign[0]!r}; write imports and exports as described in `browser_program`.")
    return text


def _constant(path: Path, folder: Path) -> str:
    """The name of a module in the program, for example $chart_scale."""
    return "$" + "_".join(path.relative_to(folder.resolve()).with_suffix("").parts)
