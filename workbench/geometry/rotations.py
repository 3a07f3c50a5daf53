"""Axis-angle rotations for the solvers, and yaw, pitch, roll for people.

Yaw, pitch and roll follow 300W-LP and AFLW2000, so that numbers compare with the head-pose literature:
`R_camera_head = Rx(-pitch) · Ry(yaw) · Rz(roll)` in this package's frames. As seen in the picture,

* yaw > 0: the nose moves to the image's left (the subject turns to the own right),
* pitch > 0: the nose moves up,
* roll > 0: the head tilts clockwise.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.arrays import AnyArray


def rotation_matrix(axis_angle: Float[AnyArray, "3"]) -> Float[AnyArray, "3 3"]:
    """Rotation matrix of an axis-angle vector in radians (Rodrigues), differentiable at zero.

    Below 1e-4 rad the series replace sin θ/θ and (1 − cos θ)/θ², whose derivatives are 0/0 at zero.
    """
    theta_squared = jnp.sum(axis_angle * axis_angle)
    small = theta_squared < 1e-8
    theta = jnp.sqrt(jnp.where(small, 1.0, theta_squared))
    sine = jnp.where(small, 1.0 - theta_squared / 6.0, jnp.sin(theta) / theta)
    versine = jnp.where(small, 0.5 - theta_squared / 24.0, (1.0 - jnp.cos(theta)) / (theta * theta))
    x, y, z = axis_angle
    zero = jnp.zeros_like(x)
    cross = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    outer = axis_angle[:, None] * axis_angle[None, :]
    return (1.0 - versine * theta_squared) * jnp.eye(3, dtype=axis_angle.dtype) + sine * cross + versine * outer


def head_yaw(rotation: Float[AnyArray, "3"]) -> Float[AnyArray, ""]:
    """Yaw in radians of an axis-angle rotation, traceable."""
    return yaw_of(rotation_matrix(rotation))


def yaw_of(matrix: Float[AnyArray, "3 3"]) -> Float[AnyArray, ""]:
    """Yaw in radians of a rotation matrix, traceable."""
    return jnp.arcsin(jnp.clip(matrix[0, 2], -1.0, 1.0))


def yaw_pitch_roll_deg(axis_angle: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Yaw, pitch, roll in degrees (see the module's convention) of head rotations given as axis-angle, radians."""
    axis_angle = np.asarray(axis_angle, float)
    flat = axis_angle.reshape(-1, 3)
    angles = np.full(flat.shape, np.nan)
    finite = np.isfinite(flat).all(1)
    if finite.any():
        about_x, about_y, about_z = Rotation.from_rotvec(flat[finite]).as_euler("XYZ", degrees=True).T
        angles[finite] = np.stack([about_y, -about_x, about_z], axis=1)
    return angles.reshape(axis_angle.shape)


def axis_angle_from_yaw_pitch_roll(angles_deg: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Axis-angle in radians of yaw, pitch, roll in degrees; the inverse of `yaw_pitch_roll_deg` for |yaw| < 90°."""
    angles_deg = np.asarray(angles_deg, float)
    yaw, pitch, roll = np.moveaxis(angles_deg.reshape(-1, 3), 1, 0)
    rotations = Rotation.from_euler("XYZ", np.stack([-pitch, yaw, roll], axis=1), degrees=True)
    return rotations.as_rotvec().reshape(angles_deg.shape)
