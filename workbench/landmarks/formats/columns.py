"""Tables of other programs with a column for each coordinate: OpenFace's CSV, and MediaPipe's points in a CSV.

OpenFace (https://github.com/TadasBaltrusaitis/OpenFace/wiki/Output-Format) writes
`frame, face_id, timestamp, confidence, success, ..., x_0, ..., x_67, y_0, ..., y_67, ...`, with frames counted from 1,
and for single pictures `face, confidence, ..., x_0, ...`, where every row is a face of the one picture. Its pixels are
counted from 0. Its one confidence of a face becomes that of all points; `success` 0 is a frame without a face.

MediaPipe has no CSV of its own. Taken are columns `x_0, y_0, ...` or `x0, y0, ...` up to 467 or 477, in any order, with
or without `frame` (counted from 0), `confidence` and `success`; others are left alone. Without `frame` every row is a
frame. Empty cells are a frame without a face.

Several rows of one frame are several faces: the largest is taken. Frames without a row have no face.
"""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from workbench.errors import InputError
from workbench.landmarks.formats.points import COUNTS, face_landmarks
from workbench.landmarks.formats.records import LandmarkRecord, cell_numbers, door, largest_face, without_gaps
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import POINT_COUNT
from workbench.reading import shortened

_COORDINATE = re.compile(r"[xy]_?(?:0|[1-9]\d{0,3})")
_UNDERSCORED = re.compile(r"x_\d+")


@dataclass(frozen=True)
class Layout:
    """Which column of a table holds what."""

    names: tuple[str, ...]
    coordinates: tuple[int, ...]
    """Columns of x and y of each point in turn."""
    frame: int | None
    first_frame: int
    """The number of the first frame: 1 for OpenFace, else 0."""
    one_picture: bool
    """Whether all rows are faces of one picture."""
    confidence: int | None
    success: int | None

    @property
    def points(self) -> int:
        """How many points a face has."""
        return len(self.coordinates) // 2


def is_of_another_program(header: Sequence[str]) -> bool:
    """Whether a header names points as OpenFace does, or more than the 68 of the workbench's own CSV."""
    return any(_UNDERSCORED.fullmatch(name) or name == f"x{POINT_COUNT}" for name in header)


def read_columns(path: Path, header: Sequence[str], image_size: tuple[int, int]) -> Iterator[LandmarkRecord]:
    """Records frame by frame. Raises `InputError` for the header at once, for a row when it is reached."""
    return without_gaps(path, _records(path, _layout(path, header), image_size))


def _layout(path: Path, header: Sequence[str]) -> Layout:
    places = {name: column for column, name in reversed(list(enumerate(header)))}
    named = [name for name in places if _COORDINATE.fullmatch(name)]
    joint = "_" if any("_" in name for name in named) else ""
    last = max(int(name[1:].lstrip("_")) for name in named)
    count = next((count for count in COUNTS if count > last), COUNTS[-1])
    wanted = [f"{axis}{joint}{i}" for i in range(count) for axis in "xy"]
    missing = [name for name in wanted if name not in places]
    if missing or last >= count:
        problem = f"missing: {shortened(', '.join(missing))}" if missing else f"the last one is number {last}"
        raise InputError(f"{path}, line 1: expected x and y of 68 points (OpenFace) or of 468 or 478; {problem}")
    openface = count == POINT_COUNT
    return Layout(
        names=tuple(wanted),
        coordinates=tuple(places[name] for name in wanted),
        frame=places.get("frame"),
        first_frame=1 if openface else 0,
        one_picture=openface and "face" in places and "frame" not in places,
        confidence=places.get("confidence"),
        success=places.get("success"),
    )


def _records(path: Path, layout: Layout, size: tuple[int, int]) -> Iterator[LandmarkRecord]:
    following = 0
    with door(path), open(path, newline="", encoding="utf-8-sig", errors="replace") as file:
        for frame, rows in groupby(_rows(path, file, layout), key=lambda row: row[0]):
            if frame < following:
                raise InputError(f"{path}: frame numbers must ascend, got {frame + layout.first_frame}: sort the rows")
            faces = [face for where, cells in _of(rows) if (face := _face(where, cells, layout, size)) is not None]
            yield LandmarkRecord(frame, f"{path.stem}#{frame}", largest_face(faces), size)
            following = frame + 1


Row = tuple[int, str, list[str]]
"""0-based frame, place in the file, cells."""


def _rows(path: Path, file: Iterator[str], layout: Layout) -> Iterator[Row]:
    rows = csv.reader(file)
    width = len(next(rows))
    count = 0
    for cells in rows:
        where = f"{path}, line {rows.line_num}"
        if not cells:
            continue
        if len(cells) != width:
            raise InputError(f"{where}: expected {width} cells as in the header, got {len(cells)}")
        yield _frame(where, cells, layout, count), where, cells
        count += 1


def _of(rows: Iterator[Row]) -> Iterator[tuple[str, list[str]]]:
    return ((where, cells) for _, where, cells in rows)


def _frame(where: str, cells: list[str], layout: Layout, row: int) -> int:
    if layout.frame is None:
        return 0 if layout.one_picture else row
    try:
        number = int(cells[layout.frame])
    except ValueError:
        told = shortened(repr(cells[layout.frame]))
        raise InputError(f"{where}: frame is {told}, expected a whole number") from None
    if number < layout.first_frame:
        raise InputError(f"{where}: frame counts from {layout.first_frame}, got {number}")
    return number - layout.first_frame


def _face(where: str, cells: list[str], layout: Layout, size: tuple[int, int]) -> Landmarks2D | None:
    texts = [cells[column] for column in layout.coordinates]
    empty = not any(text.strip() for text in texts)
    if empty or (layout.success is not None and not _number(where, cells, layout.success, "success")):
        return None
    points = np.reshape(cell_numbers(where, texts, layout.names), (layout.points, 2))
    sure = 1.0 if layout.confidence is None else _number(where, cells, layout.confidence, "confidence")
    return face_landmarks(where, points, np.full(POINT_COUNT, sure), size)


def _number(where: str, cells: list[str], column: int, name: str) -> float:
    return cell_numbers(where, [cells[column]], [name])[0]
