"""What `cv2.FileStorage` writes (YAML, JSON, XML), read without OpenCV: calibrations come from elsewhere.

OpenCV's own reader believes what a file says of a matrix: one without `cols` writes beyond its memory. Here the text is
parsed by Python's libraries, and a matrix is taken only when its sizes, type and numbers agree.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml
from jaxtyping import Float

from workbench.errors import InputError
from workbench.reading import checked_file, checked_json, reading

SUFFIXES = (".yml", ".yaml", ".json", ".xml")
MOST_BYTES = 4_000_000
LONGEST_ENTRY = 20_000
"""Characters of an entry in YAML that is wanted; a camera matrix has some hundred, and PyYAML takes its time."""
MOST_NESTED = 16
TYPES = re.compile(r"(?P<channels>[1-9]\d{0,2})?[ucwsifdh]")
"""Of a matrix: how many channels (1 if it does not say) of which numbers."""
YAML_ENTRY = re.compile(r"^(?P<key>[^\s#%\]}:-][^:\n]*):.*(?:\n(?:[ \t\]}].*|-(?!--).*|))*", re.MULTILINE)
"""An entry of the top level: what follows the key, and all lines that are indented or begin with a dash."""


def read_opencv_file(path: Path, wanted: re.Pattern[str]) -> dict[str, Any]:
    """The entries of a file's top level that `wanted` matches: arrays for matrices, else lists, numbers and text.

    What is none of these is None, and so are the entries that are not wanted: points and pictures may be many. Raises
    `InputError` for a damaged file, one of more than 4 MB, and entries nested more than 16 deep.
    """
    path = checked_file(path, "an OpenCV file", may_be_empty=True)
    if path.stat().st_size > MOST_BYTES:
        raise InputError(f"{path} has more than {MOST_BYTES / 1e6:g} MB; keep only the cameras in a calibration.")
    with reading(path, "an OpenCV file", "it may be cut off: write it again with cv2.FileStorage"):
        text = path.read_text(encoding="utf-8-sig", errors="replace")
        _check_nesting(path, text)
        entries = READERS[path.suffix.lower()](text, wanted)
        return {key: _value(entry) for key, entry in entries.items()}


def _check_nesting(path: Path, text: str) -> None:
    depth = deepest = 0
    for token in re.finditer(r"(?P<opening>[\[{]|<\w)|[\]}]|</|/>", text):
        depth += 1 if token["opening"] else -1
        deepest = max(deepest, depth)
    # YAML's lists nest by dashes too.
    if deepest > MOST_NESTED or re.search(rf"(?:-\s+){{{MOST_NESTED}}}", text):
        raise InputError(f"{path} nests its entries more than {MOST_NESTED} deep; it is not a calibration.")


class _Loader(yaml.SafeLoader):
    """Data only, without references: a few lines of these may stand for more than there is memory."""

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):
            raise ValueError("it refers from one entry to another")
        return super().compose_node(parent, index)


# The tag says what `_value` sees in the entries.
for _tag in ("opencv-matrix", "opencv-nd-matrix", "opencv-sparse-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", lambda loader, node: loader.construct_mapping(node, deep=True))


def _from_yaml(text: str, wanted: re.Pattern[str]) -> dict[str, Any]:
    """Only wanted entries are parsed, one by one."""
    found: dict[str, Any] = {}
    for entry in YAML_ENTRY.finditer(text):
        key = entry["key"].strip("\"' \t")
        if wanted.fullmatch(key) and len(entry[0]) > LONGEST_ENTRY:
            raise ValueError(f"{key} has {len(entry[0])} characters")
        parsed = yaml.load(entry[0], _Loader) if wanted.fullmatch(key) else {key: None}
        if not isinstance(parsed, dict):
            raise ValueError(f"{key} has no value")
        found |= parsed
    if not found:
        raise ValueError("it has no entries")
    return found


def _from_json(text: str, wanted: re.Pattern[str]) -> dict[str, Any]:
    # OpenCV writes comments and its own spelling of what is not finite.
    text = re.sub(r"^[ \t]*//.*$", "", text, flags=re.MULTILINE)
    entries = checked_json(re.sub(r"-?\.(?:Nan|Inf)\b(?=\s*[,\]}])", "NaN", text))
    if not isinstance(entries, dict):
        raise ValueError("its top level has no names")
    return {key: value if wanted.fullmatch(key) else None for key, value in entries.items()}


def _from_xml(text: str, wanted: re.Pattern[str]) -> dict[str, Any]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("it defines entities")
    root = ElementTree.fromstring(text)
    return {entry.tag: _xml_value(entry) if wanted.fullmatch(entry.tag) else None for entry in root}


def _xml_value(entry: ElementTree.Element) -> Any:
    if len(entry):
        return {child.tag: _xml_value(child) for child in entry}
    # Text in quotes may hold spaces.
    parts = [_number_or_text(part) for part in re.findall(r'"[^"]*"|[^\s"]+', entry.text or "")]
    return parts[0] if len(parts) == 1 else parts


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text.strip('"')


def _value(entry: Any) -> Any:
    if isinstance(entry, dict):
        return _matrix(entry) if "data" in entry else None
    return entry if isinstance(entry, str | int | float | list) and not isinstance(entry, bool) else None


def _matrix(entry: Mapping[str, Any]) -> Float[np.ndarray, "..."]:
    """The matrix, its channels as a last axis. Raises ValueError where sizes, type and numbers do not agree."""
    sizes = _list(entry["sizes"]) if "sizes" in entry else [entry.get("rows"), entry.get("cols")]
    kind = TYPES.fullmatch(str(entry.get("dt", "d")))
    if kind is None or not all(isinstance(size, int | float) and size == int(size) and size > 0 for size in sizes):
        raise ValueError(f"a matrix has the sizes {sizes} and the type {entry.get('dt')}")
    numbers = np.array(_list(entry["data"]), float)
    shape = tuple(int(size) for size in (*sizes, *([kind["channels"]] if kind["channels"] else [])))
    if numbers.shape != (math.prod(shape),):
        raise ValueError(f"a matrix of the sizes {shape} holds {numbers.size} numbers")
    return numbers.reshape(shape)


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


READERS = {".yml": _from_yaml, ".yaml": _from_yaml, ".json": _from_json, ".xml": _from_xml}
