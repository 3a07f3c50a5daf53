"""How far a landmark group is from its prediction by all others, and whether that is usual in the shot.

A fit that includes a shifted group distorts pose and expression towards it and leaves little residual. The *innovation*
of a group, its mean offset from a fit without it, is not affected by this. Usual values come from the other frames of
the shot, and from motions that the model's blendshapes give a group and that no other point predicts (a raised brow).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.diagnosis.reference import ShotReference, robust_similarity
from workbench.face import FaceModel, landmark_model
from workbench.landmarks.scheme import LEFT_EYE_OUTER_CORNER, RIGHT_EYE_OUTER_CORNER, LandmarkScheme, face_size
from workbench.tracking import FrameObservation

INNOVATION_GROUPS = ("jaw", "right_brow", "left_brow", "nose", "right_eye", "left_eye", "mouth")
PREDICTED = ("jaw", "nose")
"""Groups that move with the others: blendshapes that move them also move other points."""
FLOOR_PERCENT = 1.2
TYPICAL_WEIGHT = 0.35
"""A typical blendshape weight."""
EFFECTIVE_POINTS = 4.0
"""Number of independent points that the mean of a group counts as."""
JUMP_REACH = 4
"""Number of previous frames searched for a jump of a group."""
STEADY_QUANTILE = 0.95
LEAST_STEP_PERCENT = 1.0


class UsualOffset(NamedTuple):
    """Mean and covariance of a group's innovation over a shot, % of the face's size."""

    mean: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "2 2"]


def usual_offsets(model: FaceModel, reference: ShotReference) -> dict[str, UsualOffset]:
    """The usual innovation in the shot, by group."""
    spans = _spans(model)
    found = {}
    for group in INNOVATION_GROUPS:
        offsets = reference.offsets_without(model.scheme.groups[group])
        covariance = FLOOR_PERCENT**2 * np.eye(2) + spans[group]
        mean = np.zeros(2)
        if len(offsets):
            mean = np.median(offsets, axis=0)
            covariance = covariance + np.diag((1.4826 * np.median(np.abs(offsets - mean), axis=0)) ** 2)
        found[group] = UsualOffset(mean, covariance)
    return found


def offset_nats(offset_percent: Float[np.ndarray, "2"], usual: UsualOffset) -> float:
    """Cost of an innovation in nats: `EFFECTIVE_POINTS` times log(1 + squared Mahalanobis distance)."""
    away = offset_percent - usual.mean
    return float(EFFECTIVE_POINTS * np.log1p(away @ np.linalg.solve(usual.covariance, away)))


def jump_of(
    group: str,
    scheme: LandmarkScheme,
    observation: FrameObservation,
    shot: dict[int, FrameObservation],
    steps: Float[np.ndarray, "n"],
) -> tuple[Float[np.ndarray, "2"], float] | None:
    """The jump of a group within the last frames: its offset from the earlier position (pixels) and its nats.

    A face needs several frames to raise a brow; a detector error needs only one. `steps` are the group's usual motions
    between frames relative to the rest, %. None if nothing jumped.
    """
    index, mask = observation.index, scheme.group_mask(group)
    usual = max(float(np.quantile(steps, STEADY_QUANTILE)) if len(steps) else 0.0, LEAST_STEP_PERCENT)
    best = None
    for k in range(index, index - JUMP_REACH, -1):
        if k not in shot or k - 1 not in shot:
            break
        now = observation.landmarks.points if k == index else shot[k].landmarks.points
        size = 100.0 / face_size(now)
        step = float(size * np.linalg.norm(group_step(mask, shot[k - 1].landmarks.points, now)))
        if best is None or step > best[0]:
            best = step, k - 1
    if best is None or best[0] < 2.0 * usual:
        return None
    step, start = best
    offset = group_step(mask, shot[start].landmarks.points, observation.landmarks.points)
    return offset, float(EFFECTIVE_POINTS * np.log1p((0.5 * step / usual) ** 2))


def group_step(
    mask: np.ndarray, before: Float[np.ndarray, "points 2"], now: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "2"]:
    """Mean motion of a group relative to the face as a whole, pixels."""
    return (now - robust_similarity(before, now).to_image(before))[mask].mean(axis=0)


def _spans(model: FaceModel) -> dict[str, Float[np.ndarray, "2 2"]]:
    """By group: covariance of its mean position, % of the eye distance, under blendshapes of typical weight."""
    landmarks = landmark_model(model)
    neutral = landmarks.frontal_neutral()
    eye = np.linalg.norm(neutral[LEFT_EYE_OUTER_CORNER] - neutral[RIGHT_EYE_OUTER_CORNER])
    motions = np.concatenate([landmarks.contour_expression[0], landmarks.inner_expression], axis=1)[:, :, :2]
    spans = {}
    for group in INNOVATION_GROUPS:
        moved = 100.0 * TYPICAL_WEIGHT / eye * motions[:, list(model.scheme.groups[group])].mean(axis=1)
        spans[group] = np.zeros((2, 2)) if group in PREDICTED else moved.T @ moved
    return spans
