"""The first pose of a shot, from the landmarks least affected by expressions (FACE IT! Sec. 4, after its ref. [24])."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from workbench.geometry import Camera
from workbench.geometry.triangulation import camera_matrix
from workbench.landmarks.scheme import GROUPS

FEWEST_POINTS = 6
"""Minimum number of robust landmarks; with fewer, the pose would depend on the noise of single points."""


def initial_pose(
    camera: Camera,
    neutral_head: Float[np.ndarray, "points 3"],
    points: Float[np.ndarray, "points 2"],
    used: Bool[np.ndarray, "points"] | None = None,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Axis-angle and translation (mm) that best explain eye corners and nose with the neutral face, by SQPnP.

    SQPnP is globally optimal and needs no initial guess, while iterations from a zero rotation can end in a wrong
    minimum. It refuses faces that take up less than about half a degree of the view, small ones in large pictures;
    there, where there is next to no perspective, iterations from a frontal pose find theirs. A solution behind the
    camera or facing away, and one of points that all coincide, is replaced by a frontal pose at the right distance.
    `used` excludes muted points, as long as enough remain.
    """
    subset = [index for index in GROUPS["robust"] if used is None or used[index]]
    if len(subset) < FEWEST_POINTS:
        subset = list(GROUPS["robust"])
    frontal = frontal_pose(camera, neutral_head, points)
    if not np.ptp(points[subset], axis=0).any():
        return frontal
    given = (
        np.ascontiguousarray(neutral_head[subset]),
        np.ascontiguousarray(points[subset]),
        camera_matrix(camera),
        np.asarray(camera.distortion, float),
    )
    try:
        found, rotation, translation = cv2.solvePnP(*given, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error:
        rotation, translation = (value[:, None].copy() for value in frontal)
        found, rotation, translation = cv2.solvePnP(*given, rotation, translation, useExtrinsicGuess=True)
    if found:
        rotation, translation = rotation.ravel(), translation.ravel()
        facing = cv2.Rodrigues(rotation)[0][2, 2] > 0.0
        if facing and translation[2] > 0.0 and np.isfinite(np.concatenate([rotation, translation])).all():
            return rotation, translation
    return frontal


def frontal_pose(
    camera: Camera, neutral_head: Float[np.ndarray, "points 3"], points: Float[np.ndarray, "points 2"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Zero rotation, at the position and distance at which the model's points match the spread of the observed ones."""
    spread_mm = np.sqrt(((neutral_head[:, :2] - neutral_head[:, :2].mean(0)) ** 2).sum(1).mean())
    spread_px = np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean())
    focal = np.asarray(camera.focal_px, float)
    depth = focal.mean() * spread_mm / max(spread_px, 1e-6)
    offset_px = points.mean(0) - np.asarray(camera.principal_point_px, float)
    centre = np.append(offset_px / focal * depth, depth)
    return np.zeros(3), centre - np.append(neutral_head[:, :2].mean(0), 0.0)
