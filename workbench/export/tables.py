"""Tables of a track as CSV."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from workbench.files import atomic_path
from workbench.tracking import Track
from workbench.tracking.records import frame_errors

POSE_COLUMNS = ("rx", "ry", "rz", "tx", "ty", "tz", "yaw_deg", "pitch_deg", "roll_deg")
ERROR_COLUMNS = ("error_px", "error_inner_pct", "error_all_pct")


def write_parameter_table(tracks: Iterable[Track], expression_names: Sequence[str], path: str | Path) -> None:
    """A row a frame: found, axis-angle (rad), translation (mm), yaw/pitch/roll, the weights by name, the errors.

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
