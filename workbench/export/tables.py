"""Tables of a track as CSV and Parquet."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from workbench.extras import needs
from workbench.files import atomic_path
from workbench.tracking import Track
from workbench.tracking.records import frame_errors

POSE_COLUMNS = ("rx", "ry", "rz", "tx", "ty", "tz", "yaw_deg", "pitch_deg", "roll_deg")
JAW_COLUMNS = ("jaw_rx", "jaw_ry", "jaw_rz", "jaw_tx", "jaw_ty", "jaw_tz")
ERROR_COLUMNS = ("error_px", "error_inner_pct", "error_all_pct")


def write_parameter_table(tracks: Iterable[Track], expression_names: Sequence[str], path: str | Path) -> None:
    """One row per frame: found, axis-angle (rad), translation (mm), yaw/pitch/roll, the weights by name, the errors.

    `tracks` are consecutive pieces of one run, so that its length does not matter. Frames without a face keep their
    row with empty cells. Errors are means over landmarks, in pixels and in percent of the outer-eye distance (point
    36 to 45), for the inner 51 and for all 68.
    """
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["frame", "found", *POSE_COLUMNS, *expression_names, *ERROR_COLUMNS])
        for track in tracks:
            blocks = [track.rotation, track.translation, track.angles_deg, track.expression, frame_errors(track)[:, 1:]]
            for index, found, row in zip(track.index, track.found, np.concatenate(blocks, axis=1), strict=True):
                numbers = ["" if not np.isfinite(cell) else f"{cell:.9g}" for cell in row]
                writer.writerow([int(index), int(found), *numbers])


def curve_columns(track: Track, rate: float) -> dict[str, np.ndarray]:
    """Every curve of a track by name: frame, time, pose, weights, errors, camera; NaN without a face.

    Axis-angle in radians, translation in millimetres, yaw, pitch and roll in degrees, errors as in
    `write_parameter_table`, focal lengths in pixels. Tracks of Deep Energies have the jaw joint's motion too, and the
    head's scale and the number of a failure (`tracking.records.FAILURES`) where there are any.
    """
    pose = np.concatenate([track.rotation, track.translation, track.angles_deg], axis=1)
    columns = {
        "frame": track.index,
        "time_s": track.index / rate,
        "shot": track.shot,
        "found": track.found,
        **dict(zip(POSE_COLUMNS, pose.T, strict=True)),
        **dict(zip(track.expression_names, track.expression.T, strict=True)),
        **dict(zip(ERROR_COLUMNS, frame_errors(track)[:, 1:].T, strict=True)),
        "confidence": track.confidence.mean(1),
        "focal_x_px": track.focal_px[:, 0],
        "focal_y_px": track.focal_px[:, 1],
    }
    if track.jaw.any():
        columns |= dict(zip(JAW_COLUMNS, track.jaw.T, strict=True))
    if (track.scale[track.found] != 1.0).any():
        columns["scale"] = track.scale
    if track.failure.any():
        columns["failure"] = track.failure
    return columns


def write_curves(track: Track, path: str | Path, rate: float) -> None:
    """`curve_columns` as CSV with one row per frame; cells without a number are empty."""
    columns = curve_columns(track, rate)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        for row in zip(*columns.values(), strict=True):
            writer.writerow([_cell(value) for value in row])


def write_parquet(track: Track, path: str | Path, rate: float) -> None:
    """`curve_columns` as Parquet, with the units as its metadata.

    Raises `MissingDependencyError` without pyarrow.
    """
    with needs("parquet"):
        import pyarrow
        from pyarrow import parquet
    table = pyarrow.table({name: np.ascontiguousarray(values) for name, values in curve_columns(track, rate).items()})
    units = {"rx, ry, rz": "radians", "tx, ty, tz": "mm", "frames_per_second": f"{rate:g}", "errors": "px, % of eyes"}
    with atomic_path(path) as temporary:
        parquet.write_table(table.replace_schema_metadata(units), temporary)


def _cell(value: np.generic) -> str:
    if isinstance(value, np.floating):
        return f"{value:.9g}" if np.isfinite(value) else ""
    return str(int(value))
