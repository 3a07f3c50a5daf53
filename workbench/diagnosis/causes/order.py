"""Points with wrong numbers: left and right exchanged throughout, or a few pairs of points."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from workbench.diagnosis.records import Change, moved_to
from workbench.diagnosis.reference import robust_similarity
from workbench.diagnosis.trial import Finding, Trial, points_change
from workbench.landmarks.scheme import GROUPS
from workbench.tracker import calibration_window
from workbench.tracking import FrameFit

SUSPECT_PERCENT = 4.0
"""Distance from the prediction, % of the face's size, above which a point is tried with another number."""
AGREEMENT = 0.4
"""Largest fraction of the distance that may remain after an exchange."""
MOST_PAIRS = 6


def mirrored_order(trial: Trial) -> Iterator[Finding]:
    """The landmarks are those of the mirror image: each point carries the number of its counterpart.

    In any picture of a face from the front, the turn from the eye line (right to left) to the direction of the mouth is
    clockwise, however the head is rotated; for mirrored points it is the other way, as for a head seen from behind.
    A whole shot is mended where its points come from: a change moves those of one frame.
    """
    if turning(trial.points) >= 0.0:
        return
    places = list(trial.scheme.mirror)
    others = [frame for frame in trial.case.shot if frame.landmarks is not None]
    whole_shot = len(others) > 1 and float(np.mean([turning(frame.landmarks.points) < 0.0 for frame in others])) > 0.5
    where = "in the whole shot" if whole_shot else "in this frame"
    every = trial.scheme.group_mask("all")
    change = points_change("Exchange the points of left and right in this frame", trial.points[places], every)
    if whole_shot and trial.case.config.identity.calibrate:
        # The identity was calibrated on mirrored faces.
        mended = [moved_to(frame, frame.landmarks.points[places]) for frame in others]
        window = calibration_window(mended, trial.case.config.identity.window)
        identity = trial.reference.identity_of(window, trial.case.config)
        change = replace(change, calibrate=True, identity=identity)
    context = trial.case.context._replace(last=None, start=None)
    fit = trial.refit(change, context)
    before, after = trial.error_percent(trial.fit), trial.error_percent(fit)
    evidence = f"The points {where} are in mirrored order, as if the face were seen from behind; with every point "
    evidence += "renamed to its mirror partner "
    if whole_shot:
        evidence += f"the error here would be {after:.1f} % of the eye distance instead of {before:.1f}. Exchange them "
        evidence += "where they come from: the pictures or the order of the points were mirrored there."
    else:
        evidence += "the error goes from {before} to {after} % of the eye distance."
    yield Finding(
        code="mirrored_order",
        title="Left and right are exchanged in the order of the points",
        evidence=evidence,
        change=None if whole_shot else change,
        gain=trial.gain(fit),
        before_percent=before,
        after_percent=before if whole_shot else after,
        direct=0.97,
        numbers={"turning": turning(trial.points), "whole_shot": float(whole_shot)},
        outranks=(
            *("points_swapped", "occluded", "group_biased", "jaw_disagrees", "wrong_identity", "wrong_focal"),
            *("motion_blur", "low_flow_consistency"),
        ),
    )


def turning(points: Float[np.ndarray, "points 2"]) -> float:
    """Sine of the angle from the eye line (right to left) to the direction of the mouth: about 1, mirrored −1."""
    right, left, mouth = (points[list(GROUPS[group])].mean(axis=0) for group in ("right_eye", "left_eye", "mouth"))
    line, down = left - right, mouth - 0.5 * (left + right)
    cross = line[0] * down[1] - line[1] * down[0]
    return float(cross / max(np.linalg.norm(line) * np.linalg.norm(down), 1e-9))


def points_swapped(trial: Trial) -> Iterator[Finding]:
    """A few points have exchanged numbers."""
    best = None
    for predicted in _predictions(trial):
        pairs = exchanged_pairs(trial.points, predicted, 0.01 * SUSPECT_PERCENT * trial.face_px)
        if not 1 <= len(pairs) <= MOST_PAIRS:
            continue
        points = trial.points.copy()
        for first, second in pairs:
            points[[first, second]] = points[[second, first]]
        chosen = np.isin(np.arange(len(points)), pairs)
        change = points_change(f"Exchange {_named(trial, pairs)}", points, chosen)
        fit = trial.refit(change)
        gain = trial.gain(fit, 0.5 * len(pairs), past_doubted=True)
        if best is None or gain > best[0]:
            best = gain, pairs, change, fit
    if best is None or best[0] <= 0.0:
        return
    gain, pairs, change, fit = best
    before, after, named = trial.error_percent(trial.fit), trial.error_percent(fit), _named(trial, pairs)
    yield Finding(
        code="points_swapped",
        title="Two points are exchanged" if len(pairs) == 1 else f"{len(pairs)} pairs of points are exchanged",
        evidence=f"{named[0].upper()}{named[1:]} lie where the other one belongs; exchanged, the error "
        f"falls from {{before}} to {{after}} % of the eye distance.",
        change=change,
        gain=gain,
        before_percent=before,
        after_percent=after,
        numbers={"pairs": float(len(pairs)), "first": float(pairs[0][0]), "second": float(pairs[0][1])},
        outranks=("occluded", "group_biased", "jaw_disagrees", "low_flow_consistency"),
    )


def exchanged_pairs(
    points: Float[np.ndarray, "points 2"], predicted: Float[np.ndarray, "points 2"], suspect_px: float
) -> list[tuple[int, int]]:
    """Pairs of suspect points that each lie where the other is predicted, most certain first."""
    away = np.linalg.norm(points[:, None] - predicted[None], axis=2)
    own = np.diagonal(away)
    suspects = np.flatnonzero(own > suspect_px)
    found = []
    for k, first in enumerate(suspects):
        for second in suspects[k + 1 :]:
            apart, exchanged = own[first] + own[second], away[first, second] + away[second, first]
            if exchanged < AGREEMENT * apart:
                found.append((exchanged - apart, int(first), int(second)))
    pairs, taken = [], set()
    for _, first, second in sorted(found):
        if first not in taken and second not in taken:
            pairs.append((first, second))
            taken |= {first, second}
    return pairs


def _predictions(trial: Trial) -> list[Float[np.ndarray, "points 2"]]:
    """Predictions of the points: from a fit that ignores distant points, and from neighbouring frames."""
    predictions = [robust_fit(trial).projected]
    if trial.neighbours is not None:
        predictions.append(robust_similarity(trial.neighbours, trial.points).to_image(trial.neighbours))
    return predictions


def robust_fit(trial: Trial, rounds: int = 3) -> FrameFit:
    """The fit with the most distant points muted step by step: a prediction robust to single bad points."""
    fit = trial.fit
    for _ in range(rounds):
        ratio = trial.percent(fit.residuals_px) / trial.reference.residual_percent
        muted = ratio > max(3.0, float(np.quantile(ratio, 0.75)))
        if not muted.any():
            break
        weights = {str(index): 0.0 for index in np.flatnonzero(muted)}
        fit = trial.refit(Change("", config={"landmarks": {"weights": weights}}))
    return fit


def _named(trial: Trial, pairs: list[tuple[int, int]]) -> str:
    names = trial.scheme.point_names
    named = [f"{first} ({names[first]}) and {second} ({names[second]})" for first, second in pairs[:2]]
    return "points " + ", ".join(named) + (" and others" if len(pairs) > 2 else "")
