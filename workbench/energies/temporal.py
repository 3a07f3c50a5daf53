"""E_τ (FACE IT! Eq. 9): second difference of the head pose."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, Scalar
from workbench.energies.context import TermContext
from workbench.face.parameters import FaceParameters

Pose = Float[AnyArray, "6"]
"""[r | t]: axis-angle in radians, translation in millimetres."""


def second_difference(before_last: Pose, last: Pose, pose: Pose, rotation_mm: Scalar) -> Float[Array, "6"]:
    """[r|t]_{t−2} − 2 [r|t]_{t−1} + [r|t]_t with rotations counted as `rotation_mm` millimetres a radian.

    The paper's sum over the landmarks repeats one value 68 times; that factor is absorbed in ω_τ.
    """
    scale = jnp.concatenate([jnp.full(3, 1.0) * rotation_mm, jnp.ones(3)])
    return scale * (before_last - 2.0 * last + pose)


def tau_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "6"]:
    """The second difference where two frames came before, else 0."""
    pose = jnp.concatenate([parameters.rotation, parameters.translation])
    difference = second_difference(context.before_last_pose, context.last_pose, pose, context.constants.rotation_mm)
    return context.history * difference
