"""Causes shown by time and pictures: frozen landmarks, landmarks that deviate from optical flow, motion blur."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from workbench.diagnosis.flags import STILL_PX
from workbench.diagnosis.records import Change
from workbench.diagnosis.trial import Finding, Trial, points_change

MOVING_PERCENT = 0.6
"""Median motion of the picture, % of the face's size, above which unmoving landmarks are wrong."""
DUPLICATE_PERCENT = 0.1
"""Motion of the picture below which it is a duplicate of the previous one."""
FARTHEST_STEPS = 60
FLOW_SURPRISE = 3.0
"""Multiple of the usual motion deviation above which a landmark contradicts the picture."""
FEWEST_SURPRISED = 4
BLURRED = 0.55
"""Squared slope along the blur, relative to the previous picture, below which the picture counts as blurred."""
SHARP_ALONE = 0.12
"""The same without a previous picture: relative to the slope across."""
ALONG = 1.5
"""Ratio of the residuals along and across the blur above which it affects the landmarks."""


def frozen_detector(trial: Trial) -> Iterator[Finding]:
    """The landmarks repeat those of the previous frame although the face moves."""
    before = trial.case.before
    if before is None or np.abs(trial.points - before.landmarks.points).max() > STILL_PX:
        return
    index = trial.case.observation.index
    first, last = index - 1, index
    while _same(trial, first - 1) and first > index - FARTHEST_STEPS:
        first -= 1
    while _same(trial, last + 1) and last < index + FARTHEST_STEPS:
        last += 1
    flow = _picture_motion(trial)
    if flow is not None and flow < DUPLICATE_PERCENT:
        return
    places = _thawed(trial, first, last)
    jump = 0.0 if places is None else float(trial.percent(np.linalg.norm(places - trial.points, axis=1).mean()))
    if max(flow or 0.0, 0.5 * jump) < MOVING_PERCENT:
        return
    change = (
        Change("")
        if places is None
        else points_change("Carry the points over the gap", places, trial.scheme.group_mask("all"))
    )
    fit = trial.refit(change)
    moved = f"the picture moved by {flow:.1f} % of the eye distance" if flow is not None else "the face moved"
    yield Finding(
        code="frozen_detector",
        title="The landmarks are frozen",
        evidence=f"All {len(trial.points)} points are exactly those of frame {first} ({last - first + 1} equal frames) "
        f"although {moved} since the previous frame.",
        change=change if places is not None else None,
        gain=trial.gain(fit),
        before_percent=jump if flow is None else flow,
        after_percent=_step_disagreement(trial, places, first, last) if flow is not None else 0.0,
        direct=0.97 if flow is not None else 0.8,
        numbers={"frames": float(last - first + 1), "picture_motion_percent": flow or 0.0, "jump_percent": jump},
        measure="distance from the motion of the picture",
        outranks=("low_flow_consistency", "group_biased", "motion_blur", "occluded", "jaw_disagrees"),
    )


def low_flow_consistency(trial: Trial) -> Iterator[Finding]:
    """Landmarks deviate from the motion of the picture (Lucas–Kanade from the previous frame)."""
    if trial.carried is None:
        return
    deviation = trial.motion_deviation(trial.points)
    known = np.isfinite(trial.carried[:, 0])
    surprised = known & (deviation > FLOW_SURPRISE * trial.reference.motion_percent)
    count, counted = int(surprised.sum()), trial.total(surprised)
    if counted < FEWEST_SURPRISED:
        return
    change = points_change("Move these points with the picture", trial.carried, surprised)
    fit = trial.refit(change)
    mean = float(deviation[surprised].mean())
    yield Finding(
        code="low_flow_consistency",
        title="Landmarks do not follow the motion of the picture",
        evidence=f"{count} points lie {mean:.1f} % of the eye distance from where optical flow from the "
        "previous frame puts them.",
        change=change,
        # Each replaced point has a cost, because any frame agrees with the previous one if it takes its points.
        gain=trial.gain(fit, 0.5 * counted),
        before_percent=_flow_disagreement(trial, trial.points),
        after_percent=_flow_disagreement(trial, change.moved(trial.case.observation).landmarks.points),
        specificity=0.7,
        numbers={"points": float(count), "deviation_percent": mean},
        measure="distance from the motion of the picture",
    )


def motion_blur(trial: Trial) -> Iterator[Finding]:
    """The picture is blurred along one direction, and the landmarks scatter along it."""
    blur, places = trial.blur, trial.neighbours
    if blur is None:
        return
    alone = trial.case.previous_picture is None
    if blur.sharpness > (SHARP_ALONE if alone else BLURRED):
        return
    # The part of the error not explained by a shift of the whole face.
    error = trial.points - (trial.fit.projected if places is None else places)
    error = error - np.median(error, axis=0)
    along = float(np.sqrt(np.mean((error @ blur.direction) ** 2)))
    across = float(np.sqrt(np.mean((error @ np.array([-blur.direction[1], blur.direction[0]])) ** 2)))
    if along < ALONG * across:
        return
    change = interpolated(trial, places)
    fit = trial.refit(change)
    gain = trial.gain(fit, 4.0)
    limit = SHARP_ALONE if alone else BLURRED
    sure = float(np.interp(blur.sharpness / limit, [0.3, 1.0], [1.0, 0.5]))
    angle = float(np.degrees(np.arctan2(blur.direction[1], blur.direction[0]))) % 180.0
    before, after = trial.error_percent(trial.fit), trial.error_percent(fit)
    better = bool(change.landmarks) or after < before
    yield Finding(
        code="motion_blur",
        title="The picture is blurred by motion",
        evidence=f"Along {angle:.0f}° the face has {100 * blur.sharpness:.0f} % of the detail "
        f"{'it has across' if alone else 'of the previous frame'}, and the points scatter "
        f"{along / max(across, 1e-9):.1f} times as much along it as across.",
        change=change if better else None,
        gain=gain,
        before_percent=before,
        after_percent=after if better else before,
        specificity=sure,
        direct=0.0 if gain <= 0.0 else 0.8 * sure,
        numbers={
            "direction_deg": angle,
            "sharpness": blur.sharpness,
            "sharpness_across": blur.across,
            "along_percent": float(trial.percent(along)),
            "across_percent": float(trial.percent(across)),
        },
        outranks=("occluded", "group_biased", "low_flow_consistency", "jaw_disagrees"),
    )


def interpolated(trial: Trial, places: Float[np.ndarray, "points 2"] | None) -> Change:
    """The change that takes the points from the adjacent frames; without any, it trusts all frames' less."""
    if places is None:
        less = {"landmarks": {"weights": trial.lessened("all", 0.2)}}
        return Change("Trust the landmarks less in all frames", config=less)
    both = trial.case.before is not None and trial.case.after is not None
    label = "Interpolate the points from adjacent frames" if both else "Use the points of the adjacent frame"
    return points_change(label, places, trial.scheme.group_mask("all"))


def _same(trial: Trial, index: int) -> bool:
    found = trial.case.observation_at(index)
    return found is not None and bool(np.abs(found.landmarks.points - trial.points).max() <= STILL_PX)


def _picture_motion(trial: Trial) -> float | None:
    """Median motion of the picture at the landmarks since the previous frame, %; None without pictures."""
    if trial.picture_steps is None:
        return None
    return float(trial.percent(np.median(np.linalg.norm(trial.picture_steps, axis=1))))


def _thawed(trial: Trial, first: int, last: int) -> Float[np.ndarray, "points 2"] | None:
    """The landmarks interpolated between the last valid ones (frame `first`) and the next (`last` + 1), or by flow."""
    after = trial.case.observation_at(last + 1)
    if after is not None:
        part = (trial.case.observation.index - first) / (last + 1 - first)
        return (1.0 - part) * trial.points + part * after.landmarks.points
    if trial.carried is None:
        return None
    return np.where(np.isfinite(trial.carried), trial.carried, trial.points)


def _step_disagreement(trial: Trial, places: Float[np.ndarray, "points 2"] | None, first: int, last: int) -> float:
    """Median difference between the motion per frame up to these places and that of the picture, %.

    The places of `_thawed` are as many frames of motion away as the frame is from `first`, those by flow one.
    """
    if places is None:
        return 0.0
    frames = 1 if trial.case.observation_at(last + 1) is None else trial.case.observation.index - first
    part = np.linalg.norm((places - trial.points) / frames, axis=1)
    moved = np.linalg.norm(trial.carried - trial.case.before.landmarks.points, axis=1)
    return float(trial.percent(np.nanmedian(np.abs(moved - part))))


def _flow_disagreement(trial: Trial, points: Float[np.ndarray, "points 2"]) -> float:
    if trial.carried is None:
        return float(trial.motion_deviation(points).mean())
    away = np.linalg.norm(points - trial.carried, axis=1)
    known = np.isfinite(away)
    return float(trial.percent(away[known].mean())) if known.any() else 0.0
