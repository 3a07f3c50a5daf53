"""Metrics over the fits of a clip: errors, and jitter of the head pose."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.tracking import FrameFit, Track
from workbench.tracking.records import frame_errors, stack_fits


def metrics_of(fits: Sequence[FrameFit]) -> dict[str, float]:
    """`metrics_of_track` for these fits."""
    return metrics_of_track(Track(meta={}, **stack_fits(list(fits))))


def metrics_of_track(track: Track) -> dict[str, float]:
    """Errors in % of the outer-eye distance over all frames with landmarks, and the jitter of the head pose.

    Frames made by infill have no landmarks. Jitter is the mean length of the change from one frame's turn to
    the next one's, in degrees, within shots.
    """
    found = track.found
    errors = frame_errors(track)
    errors = errors[found & np.isfinite(errors).all(axis=1)]
    numbers = {"frames": float(len(track)), "frames_with_face": float(found.sum())}
    if not found.any():
        return numbers
    for name, column in (("inner_51_percent", 2), ("all_68_percent", 3)) if len(errors) else ():
        numbers[f"{name}_mean"] = round(float(errors[:, column].mean()), 4)
        numbers[f"{name}_p95"] = round(float(np.percentile(errors[:, column], 95)), 4)
    jitter = _jitter_deg(track.rotation, track.shot, found)
    if jitter is not None:
        numbers["jitter_deg"] = round(jitter, 4)
    return numbers


def _jitter_deg(rotation: Float[np.ndarray, "n 3"], shot: np.ndarray, found: np.ndarray) -> float | None:
    if len(rotation) < 3:
        return None
    whole = found[:-2] & found[1:-1] & found[2:] & (shot[:-2] == shot[2:])
    if not whole.any():
        return None
    turns = Rotation.from_rotvec(np.nan_to_num(rotation))
    # Rotation vectors jump at half a turn, in pictures that are upside down; turns from frame to frame do not.
    steps = (turns[1:] * turns[:-1].inv()).as_rotvec()
    second = np.linalg.norm(np.diff(steps, axis=0), axis=1)[whole]
    return float(np.degrees(second.mean()))
