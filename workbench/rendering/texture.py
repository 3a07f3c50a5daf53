"""Albedo as a picture on the surface."""

import functools
import operator
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from workbench.arrays import AnyArray
from workbench.rendering.interpolation import Vector


class Texture(NamedTuple):
    """A picture, and where each corner of each triangle is on it."""

    picture: Float[AnyArray, "th tw 3"]
    """First row on top, values as the albedo of vertices."""
    uv: Float[AnyArray, "u 2"]
    """OBJ convention: 0 to 1, v up."""
    triangles_uv: Int[AnyArray, "t 3"]


def sample_texture(texture: Float[Array, "th tw 3"], u: Float[Array, "n"], v: Float[Array, "n"]) -> Vector:
    """Bilinear look-up, texel centres at (k + 0.5)/size, held at the borders; differentiable in all arguments."""
    rows, columns = texture.shape[:2]
    x, y = jnp.clip(u * columns - 0.5, 0.0, columns - 1.0), jnp.clip((1.0 - v) * rows - 0.5, 0.0, rows - 1.0)
    x0, y0 = (lax.stop_gradient(jnp.floor(value)).astype(jnp.int32) for value in (x, y))
    right, down = x - x0, y - y0
    flat = texture.reshape(-1, 3)
    x1, y1 = jnp.minimum(x0 + 1, columns - 1), jnp.minimum(y0 + 1, rows - 1)
    texels = [lax.optimization_barrier(flat[row * columns + column]) for row in (y0, y1) for column in (x0, x1)]
    shares = [(1.0 - right) * (1.0 - down), right * (1.0 - down), (1.0 - right) * down, right * down]
    return tuple(
        functools.reduce(operator.add, [share * texel[:, k] for share, texel in zip(shares, texels, strict=True)])
        for k in range(3)
    )
