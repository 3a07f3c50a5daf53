"""The pinhole camera π with OpenCV's distortion. Pixel (0, 0) is the centre of the top-left pixel."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.errors import InputError

DISTORTION_COUNTS = (0, 4, 5, 8)
PADDED_COUNTS = (12, 14)
"""OpenCV fills the rational model's eight coefficients up with zeros for thin prisms and a tilted sensor."""


class Camera(NamedTuple):
    """Intrinsic parameters as arrays, so that a new focal length compiles nothing."""

    focal_px: Float[AnyArray, "2"]
    """Focal lengths in x and y, pixels."""
    principal_point_px: Float[AnyArray, "2"]
    """Where the optical axis meets the picture, pixels."""
    distortion: Float[AnyArray, "8"]
    """OpenCV's k1, k2, p1, p2, k3, k4, k5, k6."""


def camera_from_fov(
    image_size: tuple[int, int], fov_deg: float, distortion: Float[np.ndarray, "n"] | None = None
) -> Camera:
    """Camera of a picture (width, height) whose *longer* side spans `fov_deg`; centred, square pixels.

    The longer side, so that a picture and the same picture turned by 90° get one focal length. It spans so much without
    the distortion, which is as in `camera_from_matrix`. Raises `InputError` unless 0 < fov_deg < 180, and for
    coefficients that cannot be used.
    """
    if not 0.0 < fov_deg < 180.0:
        raise InputError(f"A field of view lies between 0 and 180 degrees, got {fov_deg:g}; 30 to 70 is usual.")
    width, height = image_size
    focal = 0.5 * max(width, height) / np.tan(0.5 * np.radians(fov_deg))
    return Camera(np.full(2, focal), np.array([(width - 1) / 2, (height - 1) / 2]), _coefficients(distortion))


def camera_from_matrix(matrix: Float[np.ndarray, "_ _"], distortion: Float[np.ndarray, "n"] | None = None) -> Camera:
    """Camera of an OpenCV calibration: 3 × 3 matrix in pixels and 0, 4, 5 or 8 distortion coefficients.

    Of 12 or 14, as OpenCV stores its rational model, those after the eighth are 0. Raises `InputError` for another
    shape, skew, another last row than 0 0 1, a focal length that is not positive, and thin-prism or tilt terms.
    """
    matrix = np.asarray(matrix, float)
    if matrix.shape != (3, 3):
        raise InputError(f"A camera matrix is 3 × 3, got shape {matrix.shape}; pass OpenCV's camera matrix.")
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0) or abs(matrix[0, 1]) > 1e-6 * abs(matrix[0, 0]):
        raise InputError("A camera matrix has positive focal lengths and no skew; check the order of its entries.")
    below = np.array([*matrix[2], matrix[1, 0]])
    if not np.allclose(below, [0.0, 0.0, 1.0, 0.0], rtol=0.0, atol=1e-6):
        raise InputError(
            "A camera matrix holds 0 below its diagonal, and its last row is 0 0 1; transpose a matrix from MATLAB, "
            "which has "
            "the principal point there."
        )
    return Camera(matrix[[0, 1], [0, 1]], matrix[:2, 2], _coefficients(distortion))


def _coefficients(distortion: Float[np.ndarray, "n"] | None) -> Float[np.ndarray, "8"]:
    """OpenCV's distortion as eight coefficients; raises `InputError` for those that have another meaning."""
    coefficients = np.zeros(0) if distortion is None else np.asarray(distortion, float).ravel()
    if len(coefficients) in PADDED_COUNTS:
        if coefficients[8:].any():
            raise InputError(
                "The thin-prism and tilt terms of OpenCV's distortion are not supported; calibrate with "
                "cv2.calibrateCamera's default or rational model."
            )
        coefficients = coefficients[:8]
    if len(coefficients) not in DISTORTION_COUNTS:
        raise InputError(
            f"OpenCV's distortion has 0, 4, 5 or 8 coefficients, got {len(coefficients)}; "
            "calibrate with cv2.calibrateCamera's default or rational model."
        )
    padded = np.zeros(8)
    padded[: len(coefficients)] = coefficients
    return padded


def horizontal_fov_deg(camera: Camera, image_size: tuple[int, int]) -> float:
    """Horizontal field of view in degrees of an undistorted camera for a picture (width, height)."""
    return float(2 * np.degrees(np.arctan(0.5 * image_size[0] / float(camera.focal_px[0]))))


def project(camera: Camera, points_camera: Float[AnyArray, "*n 3"]) -> Float[AnyArray, "*n 2"]:
    """π: camera-frame points in millimetres to pixels (OpenCV's pinhole with radial and tangential distortion)."""
    points = jnp.asarray(points_camera)
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    return _to_pixels(camera, *_distort(camera.distortion, x, y))


def project_with_derivative(
    camera: Camera, points_camera: Float[AnyArray, "n 3"]
) -> tuple[Float[AnyArray, "n 2"], Float[AnyArray, "n 2 3"]]:
    """π and ∂π/∂(x, y, z) of each point, written out because it is in the innermost loop of every solve."""
    x_camera, y_camera, z_camera = points_camera[:, 0], points_camera[:, 1], points_camera[:, 2]
    inverse_z = 1.0 / z_camera
    x, y = x_camera * inverse_z, y_camera * inverse_z
    k1, k2, p1, p2, k3, k4, k5, k6 = camera.distortion
    r2 = x * x + y * y
    numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = numerator / denominator
    slope = (k1 + r2 * (2 * k2 + 3 * r2 * k3) - radial * (k4 + r2 * (2 * k5 + 3 * r2 * k6))) / denominator
    pixels = _to_pixels(camera, x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
                        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)  # fmt: skip
    cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    dxx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    dyy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    fx, fy = camera.focal_px[0] * inverse_z, camera.focal_px[1] * inverse_z
    row_x = jnp.stack([fx * dxx, fx * cross, -fx * (dxx * x + cross * y)], axis=-1)
    row_y = jnp.stack([fy * cross, fy * dyy, -fy * (cross * x + dyy * y)], axis=-1)
    return pixels, jnp.stack([row_x, row_y], axis=1)


def _distort(distortion, x, y):
    k1, k2, p1, p2, k3, k4, k5, k6 = distortion
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    distorted_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return distorted_x, distorted_y


def _to_pixels(camera, x, y):
    return jnp.stack([x, y], axis=-1) * jnp.asarray(camera.focal_px) + jnp.asarray(camera.principal_point_px)
