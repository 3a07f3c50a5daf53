"""Faces that are turned aside: by how much, what shape they have, and how sure the points are that can be seen."""

import numpy as np
from jaxtyping import Float

from workbench.errors import InputError
from workbench.landmarks.alignment import MEAN_SHAPE
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import GROUPS, POINT_COUNT, first_68

MEAN_DEPTH: Float[np.ndarray, "68"] = np.array(
    [
        *(0.382, 0.355, 0.323, 0.324, 0.305, 0.23, 0.166, 0.108, 0.071),
        *(0.108, 0.166, 0.23, 0.305, 0.324, 0.323, 0.355, 0.382),
        *(0.126, 0.064, 0.015, -0.011, -0.018, -0.018, -0.011, 0.015, 0.064, 0.126),
        *(-0.002, -0.027, -0.077, -0.132, -0.025, -0.051, -0.066, -0.051, -0.025),
        *(0.1, 0.066, 0.062, 0.073, 0.063, 0.074, 0.073, 0.062, 0.066, 0.1, 0.074, 0.063),
        *(0.014, -0.047, -0.069, -0.077, -0.069, -0.047, 0.014, -0.028, -0.046, -0.053, -0.046, -0.028),
        *(0.004, -0.049, -0.052, -0.049, 0.004, -0.046, -0.056, -0.046),
    ]
)
"""Depth of the average face (`MEAN_SHAPE`) away from the camera in box sides, from the default head."""
MEAN_DEPTH.setflags(write=False)
TURNS_DEG = (-90.0, -60.0, -30.0, 0.0, 30.0, 60.0, 90.0)
"""Yaws of the faces that a shape is compared with."""
HALF_HIDDEN_DEG = (45.0, 75.0)
"""Between these turns half of the face comes to be hidden."""

_INNER = list(GROUPS["inner"])
_TURNED = np.stack(
    [
        np.cos(yaw) * MEAN_SHAPE[_INNER, 0] + np.sin(yaw) * MEAN_DEPTH[_INNER] + 1j * MEAN_SHAPE[_INNER, 1]
        for yaw in np.radians(TURNS_DEG)
    ]
)
_TURNED -= _TURNED.mean(axis=1, keepdims=True)


def sureness(landmarks: Landmarks2D) -> float:
    """Median confidence of the 68 points; on a profile, that of the surer half. Further points may be hidden on a face
    that is well seen."""
    surer = np.interp(turn_deg(landmarks.points), HALF_HIDDEN_DEG, (0.5, 0.75))
    return float(np.quantile(landmarks.confidence[:POINT_COUNT], surer))


def shape_deviation(points: Float[np.ndarray, "points 2"]) -> float:
    """Mean distance of the inner 51 points from the average face, turned as fits best, in box sides.

    Of faces up to the profile it stays below 0.09, unless they are raised or lowered by more than 30 degrees as well.
    """
    return float(_deviations(points).min())


def turn_deg(points: Float[np.ndarray, "points 2"]) -> float:
    """By how much a face is turned aside, 0 to 90 degrees, by the shape of its inner 51 points alone.

    To some five degrees, ten near the profile; a face that is raised or lowered a lot seems less turned than it is.
    """
    deviations = _deviations(points)
    best = int(deviations.argmin())
    middle = int(np.clip(best, 1, len(TURNS_DEG) - 2))
    before, at, after = deviations[middle - 1 : middle + 2]
    # The lowest point of a parabola through three turns.
    offset = 0.5 * (before - after) / max(before - 2.0 * at + after, 1e-9)
    turned = TURNS_DEG[middle] + (TURNS_DEG[1] - TURNS_DEG[0]) * np.clip(offset, -1.0, 1.0)
    return float(min(abs(turned), 90.0))


def _deviations(points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "turns"]:
    """Of the inner points from the average face at each of `TURNS_DEG`, each laid on them by its own similarity.

    Points are complex numbers here: a similarity is a factor.
    """
    inner = first_68(points)[_INNER] @ np.array([1.0, 1j])
    inner = inner - inner.mean()
    factor = (_TURNED.conj() @ inner) / (np.abs(_TURNED) ** 2).sum(axis=1)
    if not np.abs(factor).all():
        raise InputError("no similarity can be fitted: the points coincide")
    return np.abs(inner / factor[:, None] - _TURNED).mean(axis=1)
