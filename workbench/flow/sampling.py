"""Reading fields and pictures between pixels, differentiable in values and places."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from workbench.arrays import AnyArray


def four_neighbours(
    points: Float[AnyArray, "*n 2"], shape: tuple[int, int]
) -> tuple[Int[Array, "*n 4"], Int[Array, "*n 4"], Float[Array, "*n 4"]]:
    """Rows, columns and bilinear weights of the four pixels around each point (x, y), held inside (height, width)."""
    height, width = shape
    x = jnp.clip(points[..., 0], 0.0, width - 1.0)
    y = jnp.clip(points[..., 1], 0.0, height - 1.0)
    left = jnp.clip(jnp.floor(lax.stop_gradient(x)), 0, max(width - 2, 0))
    top = jnp.clip(jnp.floor(lax.stop_gradient(y)), 0, max(height - 2, 0))
    right, down = x - left, y - top
    columns, rows = left.astype(jnp.int32), top.astype(jnp.int32)
    columns2, rows2 = jnp.minimum(columns + 1, width - 1), jnp.minimum(rows + 1, height - 1)
    weights = [(1 - down) * (1 - right), (1 - down) * right, down * (1 - right), down * right]
    return (
        jnp.stack([rows, rows, rows2, rows2], axis=-1),
        jnp.stack([columns, columns2, columns, columns2], axis=-1),
        jnp.stack(weights, axis=-1),
    )


def sample(field: Float[AnyArray, "h w c"], points: Float[AnyArray, "*n 2"]) -> Float[Array, "*n c"]:
    """Bilinear values of a field at points (x, y) in its pixels; the border's values beyond the border."""
    field = jnp.asarray(field)
    rows, columns, weights = four_neighbours(points, field.shape[:2])
    return (field[rows, columns] * weights[..., None].astype(field.dtype)).sum(axis=-2)


def grid(height: int, width: int) -> Float[Array, "h w 2"]:
    """The places (x, y) of all pixels."""
    y, x = jnp.indices((height, width)).astype(jnp.float32)
    return jnp.stack([x, y], axis=-1)


def warp(picture: Float[AnyArray, "h w c"], flow: Float[AnyArray, "h w 2"]) -> Float[Array, "h w c"]:
    """The second picture as seen from the first: each pixel gets what is where the flow points."""
    return sample(picture, grid(*flow.shape[:2]) + flow)


def inside(points: Float[AnyArray, "*n 2"], shape: tuple[int, int]) -> Bool[Array, "*n"]:
    """Whether points (x, y) lie within a picture of (height, width)."""
    height, width = shape
    x, y = points[..., 0], points[..., 1]
    return (x >= 0.0) & (x <= width - 1.0) & (y >= 0.0) & (y <= height - 1.0)
