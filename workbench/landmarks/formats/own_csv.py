"""The workbench's CSV: one row per frame, streamed in both directions.

Header `frame,width,height,x0,y0,...,x67,y67`, optionally followed by `c0,...,c67` (confidence, else 1). A file of the
scheme `dense` goes on to its last point, and its number of columns says so. A row with empty x and y cells is a frame
without a face. Frame indices ascend; frames may be left out. Covariances are not kept: a track has them.
"""

import csv
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.landmarks.formats.records import LandmarkRecord, cell_numbers, checked_landmarks, door, whole_numbers
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import IBUG68, LandmarkScheme
from workbench.landmarks.schemes import SCHEMES
from workbench.reading import shortened

PLACE_COLUMNS = ["frame", "width", "height"]


def csv_columns(scheme: LandmarkScheme = IBUG68) -> list[str]:
    """The columns that a file of these points has."""
    return [*PLACE_COLUMNS, *(f"{axis}{i}" for i in range(len(scheme)) for axis in "xy")]


def confidence_columns(scheme: LandmarkScheme = IBUG68) -> list[str]:
    """Those that may follow."""
    return [f"c{i}" for i in range(len(scheme))]


class LandmarkCsvWriter:
    """Write a CSV one frame at a time, with constant memory; used in a `with` block, completely or not at all."""

    def __init__(self, path: str | Path, confidence: bool = True, scheme: LandmarkScheme = IBUG68) -> None:
        self.path = Path(path)
        self._confidence, self._scheme = confidence, scheme
        self._stack = ExitStack()
        self._last = -1

    def __enter__(self) -> "LandmarkCsvWriter":
        temporary = self._stack.enter_context(atomic_path(self.path))
        file = self._stack.enter_context(open(temporary, "w", newline="", encoding="utf-8"))
        self._rows = csv.writer(file, lineterminator="\n")
        self._rows.writerow(csv_columns(self._scheme) + (confidence_columns(self._scheme) if self._confidence else []))
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._stack.__exit__(kind, error, traceback)

    def write(self, record: LandmarkRecord) -> None:
        """Append one frame. Coordinates keep 3 decimals, confidence 4. Raises `InputError` if indices do not ascend."""
        if record.size is None:
            raise InputError(f"frame {record.frame} has no image size: a CSV row needs width and height")
        if record.frame <= self._last:
            raise InputError(f"frames are written in ascending order, got {record.frame} after {self._last}")
        self._last = record.frame
        count = len(self._scheme)
        if record.landmarks is None:
            cells = [""] * ((3 if self._confidence else 2) * count)
        elif len(record.landmarks.points) != count:
            raise InputError(
                f"frame {record.frame} has {len(record.landmarks.points)} points, the others {count}: a CSV holds one "
                "scheme"
            )
        else:
            cells = [f"{value:.3f}" for value in record.landmarks.points.ravel()]
            if self._confidence:
                cells += [f"{value:.4f}" for value in record.landmarks.confidence]
        self._rows.writerow([record.frame, *record.size, *cells])


def csv_header(path: Path) -> list[str]:
    """The column names of a CSV, without the spaces around them."""
    with open(path, newline="", encoding="utf-8-sig", errors="replace") as file:
        return [cell.strip() for cell in next(csv.reader(file), [])]


def is_own(header: list[str]) -> bool:
    """Whether a header is that of some landmark scheme."""
    return _known(header) is not None


def _known(header: list[str]) -> tuple[LandmarkScheme, bool] | None:
    """Whose points a file holds, and whether their confidences follow."""
    for scheme in SCHEMES.values():
        columns = csv_columns(scheme)
        if header in (columns, columns + confidence_columns(scheme)):
            return scheme, len(header) > len(columns)
    return None


def _columns_of(path: Path, header: list[str]) -> tuple[LandmarkScheme, bool]:
    """As `_known`. Raises `InputError` for another header."""
    known = _known(header)
    if known is not None:
        return known
    expected = "frame,width,height,x0,y0,...,x67,y67 and optionally c0,...,c67"
    missing = [name for name in csv_columns() if name not in header]
    if not header:
        problem = "the file is empty"
    elif not missing:
        problem = "the columns are in another order, or some are unknown"
    elif len(missing) > 8:
        problem = f"it begins with {shortened(repr(','.join(header[:4])))} and {len(missing)} columns are missing"
    else:
        problem = f"missing: {', '.join(missing)}"
    raise InputError(f"{path}, line 1: expected the header {expected}; {problem}")


def read_csv(path: Path, header: list[str]) -> Iterator[LandmarkRecord]:
    """Records row by row. Raises `InputError` for the header at once, for a row when it is reached."""
    return _rows(path, *_columns_of(path, header))


def _rows(path: Path, scheme: LandmarkScheme, has_confidence: bool) -> Iterator[LandmarkRecord]:
    width = len(PLACE_COLUMNS) + (3 if has_confidence else 2) * len(scheme)
    last = -1
    # Here as well as where the file is opened: the rows are read later.
    with door(path), open(path, newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.reader(file)
        next(rows)
        for row in rows:
            where = f"{path}, line {rows.line_num}"
            if not row:
                continue
            if len(row) != width:
                raise InputError(
                    f"{where}: expected {width} cells as in the header ({len(scheme)} points), got {len(row)}"
                )
            frame, *size = whole_numbers(where, row[:3])
            if frame <= last:
                raise InputError(f"{where}: frame indices must ascend, got {frame} after {last}: sort the rows")
            last = frame
            yield LandmarkRecord(
                frame, f"{path.stem}#{frame}", _landmarks(where, row, scheme, tuple(size)), tuple(size)
            )


def _landmarks(where: str, row: list[str], scheme: LandmarkScheme, size: tuple[int, int]) -> Landmarks2D | None:
    columns = csv_columns(scheme)
    points, confidence = row[len(PLACE_COLUMNS) : len(columns)], row[len(columns) :]
    names = columns[len(PLACE_COLUMNS) :]
    empty = [not cell.strip() for cell in points]
    if all(empty):
        return None
    if any(empty):
        name = names[empty.index(True)]
        raise InputError(f"{where}: {name} is empty: fill it, or empty all x and y cells where there is no face")
    xy, certainty = cell_numbers(where, points, names), None
    if any(cell.strip() for cell in confidence):
        certainty = cell_numbers(where, confidence, confidence_columns(scheme))
    return checked_landmarks(where, np.reshape(xy, (len(scheme), 2)), certainty, size)
