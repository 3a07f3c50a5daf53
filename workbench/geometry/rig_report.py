"""A look at a rig before it is used: what each camera sees, how the cameras stand, and what seems wrong."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from workbench.geometry.rig import Rig, View, to_view
from workbench.geometry.triangulation import undistorted_pixels, undistorted_rays

NARROW_DEG, WIDE_DEG = 8.0, 110.0
"""Horizontal fields of view beyond which a focal length is doubted."""
SQUARE_PART = 0.03
"""Part by which the focal lengths in x and y may differ."""
CENTRE_PART = 0.1
"""Part of the picture's diagonal by which the principal point may stand off its middle."""
CORNER_PART = 0.1
"""Part of the diagonal by which distortion may move a corner."""
LEAST_ANGLE_DEG, MOST_ANGLE_DEG = 5.0, 100.0
NEAR_MM, FAR_MM = 200.0, 5000.0
"""Where cameras that film a face look at."""
GAP_PART = 0.15
"""Part of its distance by which axes may pass the place where they meet best."""
ROLL_DEG = 45.0
PARALLEL_DEG = 0.5


@dataclass(frozen=True)
class ViewReport:
    """One camera of a rig, measured; what is relative is relative to the reference view."""

    name: str
    image_size: tuple[int, int]
    focal_px: tuple[float, float]
    fov_deg: tuple[float, float]
    """Horizontal and vertical field of view through the picture's middle, with the lens's distortion."""
    principal_point_px: tuple[float, float]
    principal_offset_px: tuple[float, float]
    """From the middle of the picture."""
    corner_distortion_px: float
    """How far distortion moves the worst corner; NaN where no ray arrives there."""
    baseline_mm: float
    angle_deg: float
    """Between the optical axes, 0 to 180."""
    roll_deg: float
    """How far the picture's content is turned about its axis, clockwise."""
    meeting_mm: float
    """From this camera, along its axis, to where it is nearest to the reference's axis; infinite for parallel axes."""
    gap_mm: float
    """Between the two axes there."""


@dataclass(frozen=True)
class RigReport:
    """A rig, measured."""

    views: tuple[ViewReport, ...]
    meeting_reference_mm: tuple[float, float, float] | None
    """The point nearest to all optical axes, reference frame; None for one view or parallel axes."""
    warnings: tuple[str, ...]
    """What seems wrong, one plain sentence each."""


def rig_report(rig: Rig) -> RigReport:
    """Measure a rig, and warn of what a calibration rarely has: wrong units, folded lenses, axes that do not meet."""
    meeting = axes_meeting_point(rig)
    views = tuple(_view_report(rig, index) for index in range(len(rig)))
    warnings = [warning for view in views for warning in _lens_warnings(view)]
    for index in range(1, len(rig)):
        warnings += _place_warnings(views[0], views[index])
    if meeting is not None:
        warnings += _meeting_warnings(rig, meeting)
    return RigReport(views, None if meeting is None else tuple(meeting.tolist()), tuple(warnings))


def axes_meeting_point(rig: Rig) -> Float[np.ndarray, "3"] | None:
    """The point nearest to all optical axes, reference frame, millimetres; None where the axes are parallel."""
    directions = rig.rotation_view_reference[:, 2]
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    spread = np.degrees(np.arccos(np.clip(directions @ directions.T, -1.0, 1.0)))
    if len(rig) < 2 or not ((spread > PARALLEL_DEG) & (spread < 180.0 - PARALLEL_DEG)).any():
        return None
    return np.linalg.solve(across.sum(axis=0), np.einsum("vij,vj->i", across, rig.position_reference_mm))


def _view_report(rig: Rig, index: int) -> ViewReport:
    view = rig.views[index]
    axis, position = rig.rotation_view_reference[index, 2], rig.position_reference_mm[index]
    meeting, gap = _axes_meet(position, axis)
    # Where the reference's "up" points in this view's picture.
    up = -rig.rotation_view_reference[index][:, 1]
    width, height = view.image_size
    return ViewReport(
        name=view.name,
        image_size=view.image_size,
        focal_px=tuple(view.camera.focal_px.tolist()),
        fov_deg=_field_of_view(view),
        principal_point_px=tuple(view.camera.principal_point_px.tolist()),
        principal_offset_px=tuple((view.camera.principal_point_px - [(width - 1) / 2, (height - 1) / 2]).tolist()),
        corner_distortion_px=_corner_distortion(view),
        baseline_mm=float(np.linalg.norm(position)),
        angle_deg=float(np.degrees(np.arccos(np.clip(axis[2], -1.0, 1.0)))),
        roll_deg=float(np.degrees(np.arctan2(up[0], -up[1]))) + 0.0,  # no -0
        meeting_mm=meeting,
        gap_mm=gap,
    )


def _axes_meet(position: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]) -> tuple[float, float]:
    """Along `axis` from `position` to the place nearest to the reference's axis (0, 0, z), and the distance there."""
    sine_squared = 1.0 - axis[2] ** 2
    if sine_squared < np.sin(np.radians(PARALLEL_DEG)) ** 2:
        return np.inf, float(np.hypot(*position[:2]))
    along = -float(position[:2] @ axis[:2] / sine_squared)
    return along, float(np.hypot(*(position + along * axis)[:2]))


def _field_of_view(view: View) -> tuple[float, float]:
    (x, y), (width, height) = view.camera.principal_point_px, view.image_size
    edges = np.array([[-0.5, y], [width - 0.5, y], [x, -0.5], [x, height - 0.5]])
    left, right, top, bottom = np.degrees(np.arctan(undistorted_rays(view.camera, edges)))
    return float(right[0] - left[0]), float(bottom[1] - top[1])


def _corner_distortion(view: View) -> float:
    width, height = view.image_size
    corners = np.array([[0.0, 0.0], [width - 1, 0.0], [0.0, height - 1], [width - 1, height - 1]])
    return float(np.linalg.norm(undistorted_pixels(view.camera, corners) - corners, axis=1).max())


def _lens_warnings(view: ViewReport) -> list[str]:
    found = []
    diagonal = float(np.hypot(*view.image_size))
    if view.fov_deg[0] < NARROW_DEG or view.fov_deg[0] > WIDE_DEG:  # neither of a lens that folds
        found.append(
            f"a field of view of {view.fov_deg[0]:.0f}° is unusual: is the picture size that of the calibration?"
        )
    fx, fy = view.focal_px
    if abs(fx / fy - 1.0) > SQUARE_PART:
        found.append(f"focal lengths of {fx:.0f} and {fy:.0f} px make pixels that are not square.")
    offset = float(np.hypot(*view.principal_offset_px))
    if offset > CENTRE_PART * diagonal:
        found.append(f"the principal point is {offset:.0f} px off the middle: were the pictures cropped or scaled?")
    moved = view.corner_distortion_px
    if np.isnan(moved):
        found.append("the distortion folds over inside the picture: calibrate with fewer coefficients.")
    elif moved > CORNER_PART * diagonal:
        found.append(f"distortion moves a corner by {moved:.0f} px: are the coefficients in OpenCV's order?")
    return [f"{view.name}: {text}" for text in found]


def _place_warnings(reference: ViewReport, view: ViewReport) -> list[str]:
    found = []
    if abs(view.roll_deg) > ROLL_DEG:
        found.append(f"pictures turned by {view.roll_deg:.0f}° relative to each other: detectors need upright faces.")
    if view.angle_deg > MOST_ANGLE_DEG:
        found.append(f"{view.angle_deg:.0f}° between the axes: hardly any landmark is seen by both.")
    elif np.isinf(view.meeting_mm):
        found.append(f"parallel axes: only the baseline of {view.baseline_mm:.0f} mm gives depth.")
    elif view.angle_deg < LEAST_ANGLE_DEG:
        found.append(f"{view.angle_deg:.1f}° between the axes leave depth uncertain.")
    return [f"{reference.name} and {view.name}: {text}" for text in found]


def _meeting_warnings(rig: Rig, meeting: Float[np.ndarray, "3"]) -> list[str]:
    found = []
    for index, name in enumerate(rig.names):
        x, y, depth = to_view(meeting, rig.placed_view(index))
        aside = np.hypot(x, y)
        if depth <= 0:
            found.append(f"{name}: the axes meet behind this camera: are the poses view_from_world?")
        elif not NEAR_MM <= depth <= FAR_MM:
            found.append(
                f"{name}: the axes meet {depth:.0f} mm in front of it, no place for a face: is the unit right?"
            )
        elif aside > GAP_PART * depth:
            found.append(f"{name}: its axis misses the point where the axes meet by {aside:.0f} mm.")
    return found
