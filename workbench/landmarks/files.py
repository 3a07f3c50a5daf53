"""Landmark files: CSV (one row per frame, streamed), JSON and iBUG .pts.

All of them hold what `Landmarks2D` holds: 0-based pixel-centre coordinates, (0, 0) the centre of the top-left pixel.
Only .pts files count pixels from 1, as iBUG's annotations do; reading subtracts 1, writing adds 1.

CSV: header `frame,width,height,x0,y0,...,x67,y67`, optionally followed by `c0,...,c67` (confidence, else 1). A row with
empty x and y cells is a frame without a face. Frame indices ascend; frames may be left out.

JSON: `{"format": "ibug68", "frames": [{"frame": 0, "name": "...", "width": 640, "height": 360,
"points": [[x, y], ...] or null, "confidence": [...]}, ...]}`; `name` and `confidence` may be left out.
"""

import csv
import json
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import POINT_COUNT
from workbench.reading import checked_file, checked_json, reading, shortened

CSV_POINT_COLUMNS = [f"{axis}{i}" for i in range(POINT_COUNT) for axis in "xy"]
CSV_COLUMNS = ["frame", "width", "height", *CSV_POINT_COLUMNS]
CSV_CONFIDENCE_COLUMNS = [f"c{i}" for i in range(POINT_COUNT)]
LARGEST_FRAME = 2**53
LARGEST_SIDE = 10**6
"""Pixels of a picture's side; more is a damaged number."""


@dataclass(frozen=True)
class LandmarkRecord:
    """The landmarks of one frame as a file holds them."""

    frame: int
    """0-based frame index."""
    name: str
    """The name of the frame, or of the file if it has none."""
    landmarks: Landmarks2D | None
    """None where the frame has no face."""
    image_size: tuple[int, int] | None
    """(width, height), or None where the file does not say (.pts without its picture)."""


def read_landmark_file(path: str | Path, image_size: tuple[int, int] | None = None) -> Iterator[LandmarkRecord]:
    """Read a .csv, .json or .pts file by its suffix; CSV is streamed.

    A .pts file does not know the size of its picture: give `image_size`, else the smallest size that contains all
    points stands in. Raises `InputError` that names the line (or frame) and what to mend, for the header of a CSV at
    this call, for its rows while iterating.
    """
    absent = f"the landmark file {path} does not exist: check the name and the folder"
    path = checked_file(path, "landmarks", absent=absent, may_be_empty=True)
    suffix = path.suffix.lower()
    with _door(path):
        if suffix == ".csv":
            return _read_csv(path, _csv_has_confidence(path))
        if suffix == ".json":
            return iter(_read_json(path))
        if suffix == ".pts":
            return iter([_read_pts(path, image_size)])
    raise InputError(f"landmark files are .csv, .json or .pts, got {path.name}")


def _door(path: Path) -> AbstractContextManager[None]:
    return reading(path, "landmarks", "export them again")


def write_landmark_file(path: str | Path, records: Iterable[LandmarkRecord]) -> None:
    """Write records as .csv, .json or .pts by suffix, whole or not at all; .pts holds exactly one face."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        with LandmarkCsvWriter(path) as writer:
            for record in records:
                writer.write(record)
    elif suffix == ".json":
        _write_text(path, json.dumps({"format": "ibug68", "frames": [_json_frame(r) for r in records]}, indent=1))
    elif suffix == ".pts":
        records = list(records)
        if len(records) != 1 or records[0].landmarks is None:
            raise InputError(f"a .pts file holds one face, got {len(records)} frames: write .csv or .json instead")
        _write_text(path, _pts_text(records[0].landmarks))
    else:
        raise InputError(f"landmark files are .csv, .json or .pts, got {path.name}")


def _write_text(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _landmarks(where: str, points: object, confidence: object, size: tuple[int, int]) -> Landmarks2D:
    """Build the checked record; its complaint is prefixed with the place in the file."""
    try:
        array = np.asarray(points, np.float64)
        certainty = np.ones(POINT_COUNT) if confidence is None else np.asarray(confidence, np.float64)
        landmarks = Landmarks2D(array, certainty, size)
        far = np.flatnonzero((np.abs(landmarks.points) > LARGEST_SIDE).any(axis=1))
        if far.size:
            raise InputError(f"landmark {far[0]} lies at {landmarks.points[far[0]].tolist()}: outside of any picture")
        return landmarks
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    except (ValueError, TypeError, OverflowError) as error:
        told = shortened(error)
        raise InputError(f"{where}: the points are not 68 pairs of numbers ({told}): write them as [x, y]") from error


# --- CSV ---


class LandmarkCsvWriter:
    """Write a CSV one frame at a time, with constant memory; used in a `with` block, whole or not at all."""

    def __init__(self, path: str | Path, confidence: bool = True) -> None:
        self.path = Path(path)
        self._confidence = confidence
        self._stack = ExitStack()
        self._last = -1

    def __enter__(self) -> "LandmarkCsvWriter":
        temporary = self._stack.enter_context(atomic_path(self.path))
        file = self._stack.enter_context(open(temporary, "w", newline="", encoding="utf-8"))
        self._rows = csv.writer(file, lineterminator="\n")
        self._rows.writerow(CSV_COLUMNS + (CSV_CONFIDENCE_COLUMNS if self._confidence else []))
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._stack.__exit__(kind, error, traceback)

    def write(self, record: LandmarkRecord) -> None:
        """Append one frame. Coordinates keep 3 decimals, confidence 4. Raises `InputError` if indices do not ascend."""
        size = record.landmarks.image_size if record.landmarks else record.image_size
        if size is None:
            raise InputError(f"frame {record.frame} has no image size: a CSV row needs width and height")
        if record.frame <= self._last:
            raise InputError(f"frames are written in ascending order, got {record.frame} after {self._last}")
        self._last = record.frame
        if record.landmarks is None:
            cells = [""] * (len(CSV_POINT_COLUMNS) + (POINT_COUNT if self._confidence else 0))
        else:
            cells = [f"{value:.3f}" for value in record.landmarks.points.ravel()]
            if self._confidence:
                cells += [f"{value:.4f}" for value in record.landmarks.confidence]
        self._rows.writerow([record.frame, *size, *cells])


def _csv_has_confidence(path: Path) -> bool:
    with open(path, newline="", encoding="utf-8-sig", errors="replace") as file:
        header = [cell.strip() for cell in next(csv.reader(file), [])]
    if header in (CSV_COLUMNS, CSV_COLUMNS + CSV_CONFIDENCE_COLUMNS):
        return len(header) > len(CSV_COLUMNS)
    expected = "frame,width,height,x0,y0,...,x67,y67 and optionally c0,...,c67"
    missing = [name for name in CSV_COLUMNS if name not in header]
    if not header:
        problem = "the file is empty"
    elif not missing:
        problem = "the columns are in another order, or there are others"
    elif len(missing) > 8:
        problem = f"it begins with {shortened(repr(','.join(header[:4])))} and {len(missing)} columns are missing"
    else:
        problem = f"missing: {', '.join(missing)}"
    raise InputError(f"{path}, line 1: expected the header {expected}; {problem}")


def _read_csv(path: Path, has_confidence: bool) -> Iterator[LandmarkRecord]:
    width = len(CSV_COLUMNS) + (POINT_COUNT if has_confidence else 0)
    last = -1
    # Here as well as where the file is opened: the rows are read later.
    with _door(path), open(path, newline="", encoding="utf-8-sig", errors="replace") as file:
        rows = csv.reader(file)
        next(rows)
        for row in rows:
            where = f"{path}, line {rows.line_num}"
            if not row:
                continue
            if len(row) != width:
                raise InputError(f"{where}: expected {width} cells as in the header (68 points), got {len(row)}")
            frame, *size = _integers(where, row[:3])
            if frame <= last:
                raise InputError(f"{where}: frame indices must ascend, got {frame} after {last}: sort the rows")
            last = frame
            yield LandmarkRecord(frame, f"{path.stem}#{frame}", _csv_landmarks(where, row, tuple(size)), tuple(size))


def _integers(where: str, cells: list[str]) -> list[int]:
    try:
        frame, width, height = (int(cell) for cell in cells)
    except ValueError:
        raise InputError(f"{where}: frame, width and height must be whole numbers, got {_listed(cells)}") from None
    if frame < 0 or width < 1 or height < 1:
        raise InputError(f"{where}: frame counts from 0, width and height from 1, got {_listed(cells)}")
    if frame > LARGEST_FRAME or max(width, height) > LARGEST_SIDE:
        raise InputError(f"{where}: frame, width and height are not those of a picture, got {_listed(cells)}")
    return [frame, width, height]


def _listed(cells: list[str]) -> str:
    return shortened(",".join(cells))


def _csv_landmarks(where: str, row: list[str], size: tuple[int, int]) -> Landmarks2D | None:
    points, confidence = row[3 : len(CSV_COLUMNS)], row[len(CSV_COLUMNS) :]
    empty = [not cell.strip() for cell in points]
    if all(empty):
        return None
    if any(empty):
        name = CSV_POINT_COLUMNS[empty.index(True)]
        raise InputError(f"{where}: {name} is empty: fill it, or empty all x and y cells where there is no face")
    xy = _floats(where, points, CSV_POINT_COLUMNS)
    certainty = _floats(where, confidence, CSV_CONFIDENCE_COLUMNS) if any(c.strip() for c in confidence) else None
    return _landmarks(where, np.reshape(xy, (POINT_COUNT, 2)), certainty, size)


def _floats(where: str, cells: list[str], names: list[str]) -> list[float]:
    numbers = []
    for cell, name in zip(cells, names, strict=True):
        try:
            numbers.append(float(cell))
        except ValueError:
            raise InputError(f"{where}: {name} is {shortened(repr(cell))}, expected a number") from None
    return numbers


# --- JSON ---


def _json_frame(record: LandmarkRecord) -> dict[str, object]:
    size = record.landmarks.image_size if record.landmarks else record.image_size
    if size is None:
        raise InputError(f"frame {record.frame} has no image size: JSON needs width and height")
    frame: dict[str, object] = {"frame": record.frame, "name": record.name, "width": size[0], "height": size[1]}
    if record.landmarks is None:
        return {**frame, "points": None}
    points, confidence = record.landmarks.points, record.landmarks.confidence
    return {**frame, "points": points.round(3).tolist(), "confidence": confidence.round(4).tolist()}


def _read_json(path: Path) -> list[LandmarkRecord]:
    try:
        content = checked_json(path.read_bytes())
    except json.JSONDecodeError as error:
        raise InputError(f"{path}, line {error.lineno}: this is not JSON ({error.msg})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file: expected JSON in UTF-8") from error
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list):
        raise InputError(f'{path}: expected {{"format": "ibug68", "frames": [...]}}, found no list named "frames"')
    return [_json_record(f"{path}, entry {i} of frames", entry, path.stem) for i, entry in enumerate(frames)]


def _json_record(where: str, entry: object, stem: str) -> LandmarkRecord:
    if not isinstance(entry, dict):
        told = shortened(repr(entry))
        raise InputError(f"{where}: expected an object with frame, width, height and points, got {told}")
    missing = [key for key in ("frame", "width", "height", "points") if key not in entry]
    if missing:
        raise InputError(f"{where}: {', '.join(missing)} is missing: give points as null where there is no face")
    frame, *size = _integers(where, [str(entry[key]) for key in ("frame", "width", "height")])
    points, confidence = entry["points"], entry.get("confidence")
    landmarks = None if points is None else _landmarks(where, points, confidence, tuple(size))
    return LandmarkRecord(frame, str(entry.get("name", f"{stem}#{frame}")), landmarks, tuple(size))


# --- .pts ---


def _pts_text(landmarks: Landmarks2D) -> str:
    rows = "\n".join(f"{x + 1:.3f} {y + 1:.3f}" for x, y in landmarks.points)
    return f"version: 1\nn_points: {POINT_COUNT}\n{{\n{rows}\n}}\n"


def _read_pts(path: Path, image_size: tuple[int, int] | None) -> LandmarkRecord:
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    opening = next((i for i, line in enumerate(lines) if line.strip() == "{"), None)
    closing = next((i for i, line in enumerate(lines) if line.strip() == "}"), None)
    if not lines or not lines[0].strip().startswith("version") or opening is None:
        raise InputError(f"{path}, line 1: expected an iBUG file: version: 1, n_points: 68, then points in braces")
    if closing is None:
        raise InputError(f"{path}, line {len(lines)}: the closing brace is missing: the file may be cut off")
    rows = []
    for number, line in enumerate(lines[opening + 1 : closing], opening + 2):
        cells = line.split()
        if not cells:
            continue
        try:
            x, y = (float(cell) for cell in cells)
        except ValueError:
            told = shortened(repr(line.strip()))
            raise InputError(f"{path}, line {number}: expected x and y, got {told}") from None
        rows.append((x - 1, y - 1))
    points = np.array(rows, np.float64).reshape(-1, 2)
    size = image_size or tuple(int(v) + 1 for v in np.nan_to_num(points).max(axis=0, initial=0))
    return LandmarkRecord(0, path.stem, _landmarks(str(path), points, None, size), image_size)
