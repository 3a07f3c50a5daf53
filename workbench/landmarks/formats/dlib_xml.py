"""dlib's XML, as imglab writes it: pictures, boxes in them, and the points of a box as its parts.

`<image file="..." width="..." height="..."><box ...><part name="00" x="..." y="..."/>...</box></image>`. Parts are
named by their number, 0 to 67, in any order; pixels are counted from 0. Boxes without parts, and those with
`ignore="1"`, are no faces. Of several faces the largest is taken. Every picture is a frame, in the order of the file.
"""

import io
import re
from collections.abc import Mapping
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from workbench.errors import InputError
from workbench.landmarks.formats.records import (
    LandmarkRecord,
    cell_numbers,
    checked_landmarks,
    largest_face,
    needed_size,
    whole_numbers,
)
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import POINT_COUNT
from workbench.reading import checked_content, shortened

MOST_NESTED = 16
_SIZED = re.compile(rb"<image\b[^>]*\swidth=")
DEEPEST = "dataset, images, image, box and part"


def read_dlib_xml(path: Path, image_size: tuple[int, int] | None) -> list[LandmarkRecord]:
    """The records of a file; `image_size` counts where a picture does not say its own. Raises `InputError`."""
    text = checked_content(path, "landmarks").decode("utf-8", errors="replace")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise InputError(f"{path} defines entities, which imglab's files do not: export them again")
    records: list[LandmarkRecord] = []
    depth = 0
    # In pieces: the files of whole collections are large, and a tree of them larger.
    for event, element in ElementTree.iterparse(io.StringIO(text), events=("start", "end")):
        depth += 1 if event == "start" else -1
        if depth > MOST_NESTED:
            raise InputError(f"{path} is nested more than {MOST_NESTED} deep, imglab's files hold {DEEPEST}")
        if event == "end" and element.tag == "image":
            records.append(_record(path, len(records), element, image_size))
            element.clear()
    if not records:
        raise InputError(f"{path} names no picture: expected imglab's <image> with <box> and 68 <part>")
    return records


def states_size(path: Path) -> bool:
    """Whether a file's pictures name their width and height."""
    return _SIZED.search(checked_content(path, "landmarks")) is not None


def _record(path: Path, index: int, image: ElementTree.Element, given: tuple[int, int] | None) -> LandmarkRecord:
    name = image.get("file", f"{path.stem}#{index}")
    where = f"{path}, picture {index} ({shortened(name)})"
    sides = [image.get("width"), image.get("height")]
    if None in sides:
        size = needed_size(path, given)
    else:
        _, *size = whole_numbers(where, [str(index), *sides])
    size = (size[0], size[1])
    boxes = [box for box in image.iter("box") if box.get("ignore") != "1" and box.find("part") is not None]
    faces = [_face(where, {part.get("name", ""): part for part in box.iter("part")}, size) for box in boxes]
    return LandmarkRecord(index, name, largest_face(faces), size)


def _face(where: str, parts: Mapping[str, ElementTree.Element], size: tuple[int, int]) -> Landmarks2D:
    numbered = {int(name): part for name, part in parts.items() if name.isascii() and name.isdigit() and len(name) < 4}
    missing = [str(i) for i in range(POINT_COUNT) if i not in numbered]
    if missing or len(parts) != POINT_COUNT:
        problem = f"missing: {shortened(', '.join(missing))}" if missing else f"it has {len(parts)}"
        raise InputError(f"{where}: expected a box with the parts 00 to 67; {problem}")
    cells = [numbered[i].get(axis, "") for i in range(POINT_COUNT) for axis in "xy"]
    names = [f"{axis} of part {i}" for i in range(POINT_COUNT) for axis in "xy"]
    return checked_landmarks(where, np.reshape(cell_numbers(where, cells, names), (POINT_COUNT, 2)), None, size)
