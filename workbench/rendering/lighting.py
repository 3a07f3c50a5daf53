"""Light as nine spherical-harmonic coefficients per colour channel (Ramamoorthi and Hanrahan 2001).

The coefficients L_lm describe the radiance that arrives from each direction of the camera frame. A matte (Lambert)
surface of albedo ρ and unit normal n shows ρ/π · Σ A_l L_lm Y_lm(n) with A = π, 2π/3, π/4: of the light's detail it
keeps bands 0 to 2 only, so nine numbers per channel are enough. Colours are in the encoding of the albedo: estimated
from a picture, in that picture's own values.
"""

from itertools import product

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.errors import InputError

BANDS = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2])
"""The band l of each of the nine functions; within a band m ascends from −l."""
LAMBERT = np.array([1.0, 2.0 / 3.0, 1.0 / 4.0])[BANDS]
"""A_l/π: what a matte surface keeps of each function."""
Numbers = Float[AnyArray, "*n"] | float
SAMPLED = np.array([direction for direction in product((-1.0, 0.0, 1.0), repeat=3) if any(direction)])
SAMPLED /= np.linalg.norm(SAMPLED, axis=1, keepdims=True)
"""26 unit directions. What a light sends from them fixes all of its nine coefficients."""


def spherical_harmonics(x: Numbers, y: Numbers, z: Numbers) -> tuple[Numbers, ...]:
    """The nine real functions Y_lm, l ≤ 2, of unit directions (x, y, z); orthonormal on the sphere."""
    c0, c1, c2, c3 = (float(np.sqrt(number / np.pi)) for number in (0.25, 0.75, 3.75, 0.3125))
    return (
        *(c0 + 0.0 * x, c1 * y, c1 * z, c1 * x),
        *(c2 * x * y, c2 * y * z, c3 * (3.0 * z * z - 1.0), c2 * x * z, 0.5 * c2 * (x * x - y * y)),
    )


def shading(light: Float[AnyArray, "9 c"], normal: tuple[Numbers, Numbers, Numbers]) -> tuple[Numbers, ...]:
    """What a white matte surface with these unit normals shows in each channel: Σ (A_l/π) L_lm Y_lm(n), not clipped."""
    kept = jnp.asarray(LAMBERT, jnp.float32)[:, None] * jnp.asarray(light, jnp.float32)
    functions = spherical_harmonics(*normal)
    return tuple(
        sum(kept[k, channel] * functions[k] for k in range(1, 9)) + kept[0, channel] * functions[0]
        for channel in range(kept.shape[1])
    )


def turned_light(light: Float[AnyArray, "9 c"], rotation: Float[AnyArray, "3 3"]) -> Float[np.ndarray, "9 c"]:
    """The same light in the frame of another camera, x_other = rotation · x: what a rig's other views are lit by.

    Exact, as a rotation mixes the functions of a band among themselves only.
    """
    there, here = (_functions(directions) for directions in (SAMPLED, SAMPLED @ np.asarray(rotation, float)))
    return np.linalg.lstsq(there, here @ np.asarray(light, float))[0]


def ambient_light(color: tuple[float, float, float] | float = 1.0) -> Float[np.ndarray, "9 3"]:
    """Light from everywhere alike, under which a surface shows its albedo times `color`."""
    light = np.zeros((9, 3))
    light[0] = np.sqrt(4.0 * np.pi) * np.broadcast_to(np.asarray(color, float), 3)
    return light


def directional_light(
    direction: tuple[float, float, float], color: tuple[float, float, float] | float = 1.0
) -> Float[np.ndarray, "9 3"]:
    """Distant light from a direction of the camera frame: (-1, -1, -1) is from the upper left, on the camera's side.

    A surface that faces it would show its albedo times `color`; nine functions reproduce max(0, n·d) within 0.1.
    Raises `InputError` for the zero vector.
    """
    towards = np.asarray(direction, float)
    if not np.linalg.norm(towards) > 0.0:
        raise InputError("A light comes from a direction other than (0, 0, 0).")
    functions = np.array(spherical_harmonics(*(towards / np.linalg.norm(towards))))
    return np.pi * functions[:, None] * np.broadcast_to(np.asarray(color, float), 3)


def _functions(directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 9"]:
    return np.stack(spherical_harmonics(*directions.T), axis=1)
