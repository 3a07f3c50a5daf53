"""The workbench's JSON.

`{"format": "ibug68", "frames": [{"frame": 0, "name": "...", "width": 640, "height": 360,
"points": [[x, y], ...] or null, "confidence": [...]}, ...]}`; `name` and `confidence` may be left out. `format` names
the landmark scheme.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from workbench.errors import InputError
from workbench.landmarks.formats.records import LandmarkRecord, checked_landmarks, scheme_of_records, whole_numbers
from workbench.reading import checked_json, shortened


def json_text(records: Iterable[LandmarkRecord]) -> str:
    """The text of a file. Coordinates keep 3 decimals, confidence 4. Raises `InputError` for a frame without a size."""
    records = list(records)
    return json.dumps(
        {"format": scheme_of_records(records).name, "frames": [_json_frame(record) for record in records]}, indent=1
    )


def json_content(path: Path) -> Any:
    """What a JSON file holds. Raises `InputError` with the line where it is damaged."""
    try:
        return checked_json(path.read_bytes())
    except json.JSONDecodeError as error:
        raise InputError(f"{path}, line {error.lineno}: this is not JSON ({error.msg})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not a text file: expected JSON in UTF-8") from error


def read_json(path: Path, content: Any) -> list[LandmarkRecord]:
    """The records of a file's `json_content`."""
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list):
        raise InputError(f'{path}: expected {{"format": "ibug68", "frames": [...]}}, found no list named "frames"')
    return [_json_record(f"{path}, entry {i} of frames", entry, path.stem) for i, entry in enumerate(frames)]


def _json_frame(record: LandmarkRecord) -> dict[str, object]:
    if record.size is None:
        raise InputError(f"frame {record.frame} has no image size: JSON needs width and height")
    width, height = record.size
    frame: dict[str, object] = {"frame": record.frame, "name": record.name, "width": width, "height": height}
    if record.landmarks is None:
        return {**frame, "points": None}
    points, confidence = record.landmarks.points, record.landmarks.confidence
    return {**frame, "points": points.round(3).tolist(), "confidence": confidence.round(4).tolist()}


def _json_record(where: str, entry: object, stem: str) -> LandmarkRecord:
    if not isinstance(entry, dict):
        told = shortened(repr(entry))
        raise InputError(f"{where}: expected an object with frame, width, height and points, got {told}")
    missing = [key for key in ("frame", "width", "height", "points") if key not in entry]
    if missing:
        raise InputError(f"{where}: {', '.join(missing)} is missing: give points as null where there is no face")
    frame, *size = whole_numbers(where, [str(entry[key]) for key in ("frame", "width", "height")])
    points, confidence = entry["points"], entry.get("confidence")
    landmarks = None if points is None else checked_landmarks(where, points, confidence, tuple(size))
    return LandmarkRecord(frame, str(entry.get("name", f"{stem}#{frame}")), landmarks, tuple(size))
