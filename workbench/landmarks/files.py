"""Landmark files of the workbench and of other programs: read by suffix and content, written as .csv, .json and .pts.

| suffix | layouts |
|---|---|
| `.csv` | the workbench's (`formats.own_csv`); OpenFace's, and MediaPipe's points in columns (`formats.columns`) |
| `.json` | the workbench's (`formats.own_json`); MediaPipe's results, face-alignment's points (`formats.nested`) |
| `.npy` | face-alignment's and MediaPipe's points (`formats.nested`) |
| `.pts` | iBUG's 300-W (`formats.pts`); a folder of them has a frame each |
| `.xml` | dlib's imglab (`formats.dlib_xml`) |

All become what `Landmarks2D` holds: 0-based pixel-centre coordinates, (0, 0) the centre of the top-left pixel. Only
.pts files count pixels from 1, as iBUG's annotations do, and only MediaPipe's points are fractions of width and height.
"""

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.landmarks.formats import columns, dlib_xml, nested, own_csv, own_json, pts
from workbench.landmarks.formats.own_csv import LandmarkCsvWriter as LandmarkCsvWriter
from workbench.landmarks.formats.records import LandmarkRecord as LandmarkRecord
from workbench.landmarks.formats.records import door, needed_size, scheme_of_records
from workbench.reading import checked_file

SUFFIXES = (".csv", ".json", ".npy", ".pts", ".xml")
"""Of the files that are read."""
WITHOUT_FACE = "has no face in any frame: its points are missing, all at one place or without any confidence"
"""What is said of a landmark file in which no frame shows a face."""
_LISTED = f"{', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"


def is_landmark_file(path: Path) -> bool:
    """Whether a path names a landmark file and not a picture or a video."""
    return path.suffix.lower() in SUFFIXES


def read_landmark_file(path: str | Path, image_size: tuple[int, int] | None = None) -> Iterator[LandmarkRecord]:
    """Read a landmark file of the workbench or another program, or a folder of .pts, see above; CSV is streamed.

    `image_size`, (width, height) in pixels, is for files that do not state it (`states_size`). It may be left out only
    for a single .pts: then the smallest size that contains all points is used. Points that all coincide, or have no
    confidence, mean that there is no face (`Landmarks2D.shows_face`). Raises `InputError` that names the line (or
    entry) and what to correct: for the header of a CSV at this call, for its rows while iterating.
    """
    return map(_with_real_face, _records(Path(path), image_size))


def _records(path: Path, image_size: tuple[int, int] | None) -> Iterator[LandmarkRecord]:
    if os.path.isdir(path):
        return pts.read_folder(path, needed_size(path, image_size))
    path = _checked(path)
    suffix = path.suffix.lower()
    with door(path):
        if suffix == ".csv":
            header = own_csv.csv_header(path)
            if not own_csv.is_own(header) and columns.is_of_another_program(header):
                return columns.read_columns(path, header, needed_size(path, image_size))
            return own_csv.read_csv(path, header)
        if suffix == ".json":
            content = own_json.json_content(path)
            if nested.is_of_another_program(content):
                return iter(nested.read_nested(path, content, needed_size(path, image_size)))
            return iter(own_json.read_json(path, content))
        if suffix == ".npy":
            return iter(nested.read_npy(path, needed_size(path, image_size)))
        if suffix == ".xml":
            return iter(dlib_xml.read_dlib_xml(path, image_size))
        return iter([pts.read_pts(path, image_size)])


def _with_real_face(record: LandmarkRecord) -> LandmarkRecord:
    """The record, without a face that is none."""
    if record.landmarks is None or record.landmarks.shows_face:
        return record
    return replace(record, landmarks=None, image_size=record.size)


def states_size(path: str | Path) -> bool:
    """Whether a landmark file says how large its pictures are. Raises `InputError` as `read_landmark_file` does."""
    if os.path.isdir(path):
        return False
    path = _checked(path)
    suffix = path.suffix.lower()
    with door(path):
        if suffix == ".csv":
            header = own_csv.csv_header(path)
            return own_csv.is_own(header) or not columns.is_of_another_program(header)
        if suffix == ".json":
            return not nested.is_of_another_program(own_json.json_content(path))
        return suffix == ".xml" and dlib_xml.states_size(path)


def _checked(path: str | Path) -> Path:
    absent = f"the landmark file {path} does not exist: check the name and the folder"
    path = checked_file(path, "landmarks", absent=absent, may_be_empty=True)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"landmark files are {_LISTED}, got {path.name}")
    return path


def write_landmark_file(path: str | Path, records: Iterable[LandmarkRecord]) -> None:
    """Write records as .csv, .json or .pts by suffix, completely or not at all; .pts holds exactly one face."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        records = list(records)
        with LandmarkCsvWriter(path, scheme=scheme_of_records(records)) as writer:
            for record in records:
                writer.write(record)
    elif suffix == ".json":
        _write_text(path, own_json.json_text(records))
    elif suffix == ".pts":
        records = list(records)
        if len(records) != 1 or records[0].landmarks is None:
            raise InputError(f"a .pts file holds one face, got {len(records)} frames: write .csv or .json instead")
        _write_text(path, pts.pts_text(records[0].landmarks))
    else:
        raise InputError(f"landmarks are written as .csv, .json or .pts, got {path.name}")


def _write_text(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
