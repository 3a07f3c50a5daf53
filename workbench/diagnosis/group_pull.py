"""The effect of each landmark group on the fit, measured by fits without it."""

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.diagnosis.records import Change, GroupPull
from workbench.diagnosis.trial import Trial
from workbench.landmarks.scheme import GROUPS, PARTS, LandmarkScheme, error_unit
from workbench.tracking import FrameFit

PULLING_GROUPS = ("jaw", "right_brow", "left_brow", "nose", "eyes", "mouth")
"""Groups of every scheme; a scheme's own parts follow (`pulling_groups`)."""
MOST_WEIGHTS = 5
LEAST_CHANGE = 0.02
"""Change of a blendshape weight that is worth reporting."""


def leave_one_group_out(trial: Trial) -> tuple[GroupPull, ...]:
    """The pull of each of the `pulling_groups`: pose, weights and prediction without the group."""
    return tuple(_pull(trial, group) for group in pulling_groups(trial.scheme))


def pulling_groups(scheme: LandmarkScheme) -> tuple[str, ...]:
    """The groups that are left out in turn: those of the 68, and the parts that only this scheme has."""
    return (*PULLING_GROUPS, *(part for part in PARTS if part in scheme.groups and part not in GROUPS))


def between_poses(first: FrameFit, second: FrameFit) -> tuple[float, float]:
    """Angle in degrees and distance in millimetres between the poses of two fits."""
    turn = Rotation.from_rotvec(np.array(second.rotation)) * Rotation.from_rotvec(np.array(first.rotation)).inv()
    return float(np.degrees(turn.magnitude())), float(np.linalg.norm(second.translation - first.translation))


def _pull(trial: Trial, group: str) -> GroupPull:
    mask = trial.scheme.group_mask(group)
    without = trial.refit(Change("", config={"landmarks": {"weights": {group: 0.0}}}))
    degrees, millimetres = between_poses(trial.fit, without)
    difference = without.expression - trial.fit.expression
    largest = np.argsort(-np.abs(difference), kind="stable")[:MOST_WEIGHTS]
    offset = 100.0 * (trial.points[mask] - without.projected[mask]) / error_unit(trial.points)
    return GroupPull(
        group=group,
        rotation_deg=degrees,
        translation_mm=millimetres,
        weights=tuple((trial.names[k], float(difference[k])) for k in largest if abs(difference[k]) >= LEAST_CHANGE),
        distance_percent=float(np.linalg.norm(offset, axis=1).mean()),
        offset_percent=offset.mean(axis=0),
        error_without_percent=trial.error_percent(without, mask),
        error_with_percent=trial.error_percent(trial.fit, mask),
    )
