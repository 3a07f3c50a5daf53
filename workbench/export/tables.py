"""Tables of a track as CSV."""

import csv
from pathlib import Path

import numpy as np

from workbench.files import atomic_path
from workbench.tracking import Track

POSE_COLUMNS = ("rx", "ry", "rz", "tx", "ty", "tz", "yaw_deg", "pitch_deg", "roll_deg")
ERROR_COLUMNS = ("error_px", "error_inner_pct", "error_all_pct")


def write_parameter_table(track: Track, path: str | Path) -> None:
    """A row a frame: found, axis-angle (rad), translation (mm), yaw/pitch/roll, the weights by name, the errors.

    Frames without a face keep their row with empty cells. Errors are means over landmarks, in pixels and in percent
    of the outer-eye distance (point 36 to 45), for the inner 51 and for all 68.
    """
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", "found", *POSE_COLUMNS, *track.expression_names, *ERROR_COLUMNS])
        angles = track.angles_deg
        for row in range(len(track)):
            cells = np.concatenate(
                [track.rotation[row], track.translation[row], angles[row], track.expression[row], track[row].errors]
            )
            numbers = ["" if not np.isfinite(cell) else f"{cell:.9g}" for cell in cells]
            writer.writerow([int(track.index[row]), int(track.found[row]), *numbers])
