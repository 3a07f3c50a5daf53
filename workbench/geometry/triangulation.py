"""What several calibrated views say about one point: its epipolar lines and its place. On the host, in NumPy.

Everything here happens in *undistorted* pixels: those of a lens without distortion with the same camera matrix. There
epipolar lines are straight, and a distance is what it would be in the picture to within the lens's local magnification.
"""

import cv2
import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.geometry.camera import Camera
from workbench.geometry.rig import PlacedCamera

UNDISTORT_TOLERANCE_PX = 0.01
REFINEMENT_STEPS = 5
SINGULAR = 1e-13
NO_TURN = np.zeros(3)


def camera_matrix(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """OpenCV's camera matrix, pixels."""
    (fx, fy), (cx, cy) = np.asarray(camera.focal_px, float), np.asarray(camera.principal_point_px, float)
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def undistorted_rays(camera: Camera, points_image: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """x/z and y/z of the rays that the camera sees at these pixels: the inverse of `project`.

    NaN where the distortion lets no ray arrive (it folds over) and where the pixels are NaN.
    """
    pixels = np.array(points_image, float).reshape(-1, 2)
    rays = np.full(pixels.shape, np.nan)
    finite = np.isfinite(pixels).all(axis=1)
    matrix, distortion = camera_matrix(camera), np.array(camera.distortion, float)
    if not distortion.any():
        rays = (pixels - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]
    elif finite.any():
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 500, 1e-13)
        found = cv2.undistortPoints(pixels[finite, None], matrix, distortion, criteria=criteria)[:, 0]
        back, _ = cv2.projectPoints(np.column_stack([found, np.ones(len(found))]), NO_TURN, NO_TURN, matrix, distortion)
        missed = ~(np.abs(back[:, 0] - pixels[finite]).max(axis=1) < UNDISTORT_TOLERANCE_PX)
        rays[finite] = np.where(missed[:, None], np.nan, found)
    return rays.reshape(np.shape(points_image))


def undistorted_pixels(camera: Camera, points_image: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """Where a lens without distortion would have put these pixels; NaN as in `undistorted_rays`."""
    return undistorted_rays(camera, points_image) * np.asarray(camera.focal_px) + np.asarray(camera.principal_point_px)


def fundamental_matrix(a: PlacedCamera, b: PlacedCamera) -> Float[np.ndarray, "3 3"]:
    """F of two views: x_bᵀ·F·x_a = 0 for the undistorted pixels (x, y, 1) of one point."""
    turned = np.asarray(b.rotation_view_reference) @ np.asarray(a.rotation_view_reference).T
    moved = np.asarray(b.translation_view_reference_mm) - turned @ np.asarray(a.translation_view_reference_mm)
    x, y, z = moved
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    inverse_a, inverse_b = (np.linalg.inv(camera_matrix(view.camera)) for view in (a, b))
    return inverse_b.T @ cross @ turned @ inverse_a


def epipolar_distance(
    a: PlacedCamera, b: PlacedCamera, points_a: Float[np.ndarray, "*n 2"], points_b: Float[np.ndarray, "*n 2"]
) -> Float[np.ndarray, "*n"]:
    """Symmetric epipolar distance of pixels that show one point: mean over both pictures of point to line, pixels.

    NaN where a pixel is NaN. Only what lies across the lines counts: an error along them changes the depth instead.
    """
    matrix = fundamental_matrix(a, b)
    homogeneous_a, homogeneous_b = (
        _homogeneous(undistorted_pixels(view.camera, points)) for view, points in ((a, points_a), (b, points_b))
    )
    lines_b, lines_a = homogeneous_a @ matrix.T, homogeneous_b @ matrix
    product = np.abs((homogeneous_b * lines_b).sum(axis=-1))
    return (
        0.5 * product * (1 / np.linalg.norm(lines_a[..., :2], axis=-1) + 1 / np.linalg.norm(lines_b[..., :2], axis=-1))
    )


def triangulate(views: PlacedCamera, points_image: Float[np.ndarray, "v n 2"]) -> Float[np.ndarray, "n 3"]:
    """Points in the reference camera's frame whose projections are nearest to these pixels, millimetres.

    `views` as `Rig.placed`; pixels may be NaN where a view does not show a point. NaN where fewer than two views do.
    The linear solution, refined by Gauss-Newton on the distance in undistorted pixels.
    """
    rotation, translation = np.asarray(views.rotation_view_reference), np.asarray(views.translation_view_reference_mm)
    focal = np.asarray(views.camera.focal_px)[:, None]
    rays = np.stack([undistorted_rays(_camera(views, v), pixels) for v, pixels in enumerate(points_image)])
    seen = np.isfinite(rays).all(axis=2)
    rays = np.where(seen[..., None], rays, 0.0)
    weight = (seen[..., None] * focal)[..., None]

    # x·(R_3·p + t_3) = R_1·p + t_1, and the same for y: two rows per view.
    rows = (rays[..., None] * rotation[:, None, 2:] - rotation[:, None, :2]) * weight
    right = (translation[:, None, :2] - rays * translation[:, None, 2:])[..., None] * weight
    points = _least_squares(rows, right, seen)
    for _ in range(REFINEMENT_STEPS):
        error, derivative = _reprojection(rotation, translation, rays, points)
        points = points - _least_squares(derivative * weight, error[..., None] * weight, seen)
    return points


def reprojection_error(
    views: PlacedCamera, points_reference: Float[np.ndarray, "n 3"], points_image: Float[np.ndarray, "v n 2"]
) -> Float[np.ndarray, "v n"]:
    """Distance of points of the reference camera's frame from these pixels in each view, undistorted pixels."""
    rotation, translation = np.asarray(views.rotation_view_reference), np.asarray(views.translation_view_reference_mm)
    rays = np.stack([undistorted_rays(_camera(views, v), pixels) for v, pixels in enumerate(points_image)])
    error, _ = _reprojection(rotation, translation, rays, points_reference)
    return np.linalg.norm(error * np.asarray(views.camera.focal_px)[:, None], axis=-1)


def _reprojection(
    rotation: AnyArray, translation: AnyArray, rays: AnyArray, points: AnyArray
) -> tuple[Float[np.ndarray, "v n 2"], Float[np.ndarray, "v n 2 3"]]:
    """Error of each view in x/z and y/z, and its derivative by the point."""
    in_view = np.einsum("vij,nj->vni", rotation, points) + translation[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        projected = in_view[..., :2] / in_view[..., 2:]
        derivative = rotation[:, None, :2] - projected[..., None] * rotation[:, None, 2:]
        return projected - rays, derivative / in_view[..., 2, None, None]


def _least_squares(rows: AnyArray, right: AnyArray, seen: AnyArray) -> Float[np.ndarray, "n 3"]:
    """For each point, the p that minimises ‖rows·p − right‖ over all views; NaN where fewer than two see it."""
    normal = np.einsum("vnki,vnkj->nij", rows, rows)
    product = np.einsum("vnki,vnkl->nil", rows, right)
    solved = np.full(product.shape, np.nan)
    # Rays as good as parallel leave the depth open: the determinant against that of a sphere of the same size.
    with np.errstate(invalid="ignore"):
        size = np.trace(normal, axis1=1, axis2=2) / 3.0
        good = (seen.sum(axis=0) >= 2) & (np.linalg.det(normal) > SINGULAR * size**3)
    solved[good] = np.linalg.solve(normal[good], product[good])
    return solved[..., 0]


def _camera(views: PlacedCamera, index: int) -> Camera:
    return Camera(*(np.asarray(values)[index] for values in views.camera))


def _homogeneous(points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)
