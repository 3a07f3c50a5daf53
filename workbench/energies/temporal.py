"""E_τ (FACE IT! Eq. 9): second difference of the head pose."""

import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray, Scalar

Pose = Float[AnyArray, "6"]
"""[r | t]: axis-angle in radians, translation in millimetres."""


def tau_residual(before_last: Pose, last: Pose, pose: Pose, rotation_mm: Scalar) -> Float[AnyArray, "6"]:
    """[r|t]_{t−2} − 2 [r|t]_{t−1} + [r|t]_t with rotations counted as `rotation_mm` millimetres a radian.

    The paper's sum over the landmarks repeats one value 68 times; that factor is absorbed in ω_τ.
    """
    return tau_scale(rotation_mm) * (before_last - 2.0 * last + pose)


def tau_scale(rotation_mm: Scalar) -> Float[AnyArray, "6"]:
    """∂ of the residual with respect to the pose: a diagonal."""
    return jnp.concatenate([jnp.full(3, 1.0) * rotation_mm, jnp.ones(3)])
