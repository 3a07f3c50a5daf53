"""iBUG's .pts, as 300-W is published: one face of one picture, whose pixels are counted from 1.

A clip, as in 300-VW, is a folder of them.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from workbench.errors import InputError
from workbench.landmarks.formats.records import LandmarkRecord, checked_landmarks, door
from workbench.landmarks.observations import Landmarks2D, of_ibug68
from workbench.landmarks.scheme import POINT_COUNT
from workbench.reading import checked_file, natural_key, shortened


def pts_text(landmarks: Landmarks2D) -> str:
    """The text of a file: the 68 points, of whatever scheme."""
    rows = "\n".join(f"{x + 1:.3f} {y + 1:.3f}" for x, y in of_ibug68(landmarks).points)
    return f"version: 1\nn_points: {POINT_COUNT}\n{{\n{rows}\n}}\n"


def read_pts(path: Path, image_size: tuple[int, int] | None) -> LandmarkRecord:
    """The one record of a file; without `image_size` the smallest size that contains all points stands in."""
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
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
    if len(points) != POINT_COUNT:
        raise InputError(f"{path}: the iBUG scheme has 68 points, got {len(points)}: convert other schemes first")
    size = image_size or tuple(int(v) + 1 for v in np.nan_to_num(points).max(axis=0, initial=0))
    return LandmarkRecord(0, path.stem, checked_landmarks(str(path), points, None, size), image_size)


def files_in(folder: Path) -> list[Path]:
    """The .pts files of a folder, but for hidden ones. Raises `InputError` for a folder that cannot be read."""
    with door(folder):
        return [path for path in folder.iterdir() if path.suffix.lower() == ".pts" and path.name[0] != "."]


def read_folder(folder: Path, image_size: tuple[int, int]) -> Iterator[LandmarkRecord]:
    """The files of a folder as frames, in the order of their names (2 before 10); files of other kinds are left alone.

    Raises `InputError` at once for a folder without any, for a damaged file when it is reached.
    """
    files = files_in(folder)
    if not files:
        raise InputError(
            f"{folder} is a folder without .pts files: name a landmark file, or a folder with one per frame"
        )
    return _frames(sorted(files, key=natural_key), image_size)


def _frames(files: list[Path], image_size: tuple[int, int]) -> Iterator[LandmarkRecord]:
    for index, path in enumerate(files):
        with door(path):
            yield replace(read_pts(checked_file(path, "landmarks"), image_size), frame=index)
