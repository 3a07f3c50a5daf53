"""A cheap screen over a whole track, without any fits, for frames that deserve a diagnosis."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from workbench.config import Config
from workbench.diagnosis.records import FrameFlags
from workbench.landmarks.scheme import POINT_COUNT, face_size
from workbench.solvers import Status
from workbench.tracking import Track
from workbench.tracking.failures import failures_of
from workbench.tracking.records import frame_errors
from workbench.tracking.track_layout import expression_range_of

FLOOR_PERCENT = 2.5
"""Mean error over the inner points, % of the face's size, below which no frame is flagged for its residual."""
DEVIATIONS = 5.0
"""Robust standard deviations above the shot's median at which a frame is an outlier."""
JUMP_DEG, JUMP_MM = 8.0, 30.0
"""Second difference of the pose between frames that no real head reaches at 25 frames/s."""
MOST_AT_BOUND = 0.25
"""Fraction of the blendshapes at their upper bound that is too high."""
FEWEST_OUTSIDE = 6
"""Number of landmarks outside the picture at which a face is cut off; fewer are a chin touching the edge."""
STILL_PX = 1e-3
"""Motion of every landmark below which they are frozen: no detector repeats itself so exactly."""


class _Screen(NamedTuple):
    """One test: severity of each frame, 0 if it passes, and the message."""

    severity: Float[np.ndarray, "n"]
    text: Callable[[int], str]


def flag_frames(track: Track, config: Config | None = None) -> FrameFlags:
    """Suspicious frames of a track, each with a severity and a short text; none in a clean clip.

    Flagged are failed fits (`failures_of`), robust residual outliers within the shot that also exceed an absolute
    floor, pose jumps, frozen landmarks, stages that end at their limit while those of other frames do not, many weights
    at their bounds, and cut-off faces. Frames without a face are not flagged, and residuals are compared among frames
    with landmarks. `config` is the configuration of the run (for its bounds), if known.
    """
    screens = [test(track) for test in (_failed, _residual, _jump, _frozen, _limit)]
    screens += [_bounds(track, config), _outside(track)]
    severity = np.stack([np.where(track.found, screen.severity, 0.0) for screen in screens])
    worst = severity.max(axis=0)
    texts = []
    for frame in range(len(track)):
        order = np.argsort(-severity[:, frame], kind="stable")
        texts.append("; ".join(screens[k].text(frame) for k in order if severity[k, frame] > 0.0))
    return FrameFlags(worst > 0.0, worst, tuple(texts))


def _failed(track: Track) -> _Screen:
    why = failures_of(track)
    return _Screen(np.where(why == "", 0.0, 1.0), lambda frame: f"the fit failed: {why[frame]}")


def _residual(track: Track) -> _Screen:
    residual = np.linalg.norm(track.projected - track.observed, axis=2)[:, :POINT_COUNT]
    percent = 100.0 * residual[:, 17:].mean(1) / face_size(track.observed)
    shown = frame_errors(track)[:, 2]  # the error shown in tables and charts
    above = np.zeros(len(track))
    for shot in _shots(track):
        usual = np.median(percent[shot])
        spread = max(1.4826 * np.median(np.abs(percent[shot] - usual)), 0.1 * usual)
        limit = max(usual + DEVIATIONS * spread, FLOOR_PERCENT) if shot.sum() >= 5 else 2.0 * FLOOR_PERCENT
        above[shot] = percent[shot] / limit
    return _Screen(_ramp(above), lambda frame: f"error {shown[frame]:.1f} % of the eye distance")


def _jump(track: Track) -> _Screen:
    degrees, millimetres = np.zeros(len(track)), np.zeros(len(track))
    if len(track) > 2:
        rotations = Rotation.from_rotvec(np.nan_to_num(track.rotation))
        turns = (rotations[1:] * rotations[:-1].inv()).as_rotvec()
        beside = track.found[1:] & track.found[:-1] & (np.diff(track.shot) == 0) & (np.diff(track.index) == 1)
        whole = beside[1:] & beside[:-1]
        turned = np.degrees(np.linalg.norm(np.diff(turns, axis=0), axis=1))
        moved = np.linalg.norm(np.diff(track.translation, n=2, axis=0)[:, :2], axis=1)
        degrees[1:-1] = np.where(whole, np.minimum(turned, 180.0), 0.0)
        millimetres[1:-1] = np.where(whole, moved, 0.0)
    above = np.maximum(degrees / JUMP_DEG, millimetres / JUMP_MM)
    return _Screen(_ramp(above), lambda frame: f"the pose jumps ({degrees[frame]:.0f}°, {millimetres[frame]:.0f} mm)")


def _frozen(track: Track) -> _Screen:
    same = np.zeros(len(track), bool)
    moved = np.linalg.norm(np.diff(track.observed, axis=0), axis=2).max(axis=1)
    seen = track.found & track.seen
    beside = (np.diff(track.shot) == 0) & (np.diff(track.index) == 1) & seen[1:] & seen[:-1]
    same[1:] = beside & (moved < STILL_PX)
    return _Screen(0.6 * same, lambda frame: "the landmarks repeat the previous frame")


def _limit(track: Track) -> _Screen:
    at_limit = (track.status == Status.ITERATION_LIMIT.value).any(axis=1)
    distance = np.linalg.norm(track.projected - track.observed, axis=2)[:, :POINT_COUNT]
    residual = distance.mean(1) / face_size(track.observed)
    severity = np.zeros(len(track))
    for shot in _shots(track):
        converged = shot & ~at_limit
        if at_limit[shot].mean() < 0.2 and converged.sum() >= 5:
            usual = np.median(residual[converged])
            severity[shot & at_limit & (residual > 3.0 * usual) & (100.0 * residual > FLOOR_PERCENT)] = 0.5
    return _Screen(severity, lambda frame: "a stage ends at its iteration limit")


def _bounds(track: Track, config: Config | None) -> _Screen:
    if config is not None and not config.solver.bounded:
        return _Screen(np.zeros(len(track)), lambda frame: "")
    lower, upper = expression_range_of(track.meta, track.expression.shape[1]).T
    # The lower end of [0, 1] is rest, that of a component's range is a bound like the upper one.
    at_bound = (track.expression >= upper - 1e-9) | ((lower < 0.0) & (track.expression <= lower + 1e-9))
    count = (at_bound & (lower < upper)).sum(axis=1)
    above = count / max(MOST_AT_BOUND * track.expression.shape[1], 1.0)
    return _Screen(_ramp(above), lambda frame: f"{count[frame]} weights are at their bound")


def _outside(track: Track) -> _Screen:
    count = outside_picture(track.observed[:, :POINT_COUNT], track.image_size[:, None]).sum(axis=1)
    return _Screen(_ramp(count / FEWEST_OUTSIDE), lambda frame: f"{count[frame]} landmarks outside the picture")


def outside_picture(points: Float[np.ndarray, "*n points 2"], image_size) -> Bool[np.ndarray, "*n points"]:
    """Which points lie beyond the picture's edge pixels, or on the edge, where detectors clamp them."""
    size = np.asarray(image_size, float)
    return ((points <= 0.0) | (points >= size - 1.0)).any(axis=-1)


def _ramp(above: np.ndarray) -> np.ndarray:
    """Severity of a ratio to its limit: 0 below 1, 0.5 at 1, approaching 1 above."""
    above = np.nan_to_num(above)
    return np.where(above >= 1.0, 1.0 - 0.5 / np.maximum(above, 1.0), 0.0)


def _shots(track: Track) -> list[Bool[np.ndarray, "n"]]:
    """The frames of each shot that have landmarks of their own."""
    seen = track.found & track.seen
    return [(track.shot == shot) & seen for shot in np.unique(track.shot[seen])]
