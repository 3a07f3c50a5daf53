"""Visibility: which triangle is nearest at each pixel centre. Not differentiated: it changes in steps."""

import functools
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Shaped, UInt

from workbench.rendering.camera import ScreenPoints

TILE = 4
"""Triangles are tested on blocks of TILE × TILE pixels."""
CHUNK = 2048
"""Blocks that are tested at a time."""
TOLERANCE_PX = 2e-4
"""A pixel centre this far outside still counts as inside, so that rounding opens no gap between two triangles."""


class ScreenTriangles(NamedTuple):
    """Triangles in the picture, with what tests of points against them need."""

    origin: Int[Array, "t 2"]
    """A pixel (column, row) near each triangle; points are given relative to it, which saves digits."""
    lower: Float[Array, "t 2"]
    """Smallest x and y, pixels."""
    upper: Float[Array, "t 2"]
    planes: Float[Array, "t 14"]
    """Four linear functions a·x + b·y + c of a point relative to `origin`: three are ≥ 0 together inside the triangle,
    the fourth is its nearness; then the least and the largest nearness of its corners."""
    front: Bool[Array, "t"]
    """Its outside is seen."""
    drawn: Bool[Array, "t"]


def screen_triangles(
    triangles: Int[Array, "t 3"], screen: ScreenPoints, size: tuple[int, int], cull_backfaces: bool
) -> ScreenTriangles:
    """Set up triangles for a picture (width, height)."""
    # One array per component: a last axis of two or three would keep a processor's vector units idle.
    x, y, nearness = (
        [values[triangles[:, corner]] for corner in range(3)] for values in (*screen.pixels.T, screen.nearness)
    )  # fmt: skip
    drawable = functools.reduce(jnp.minimum, [screen.drawable[triangles[:, corner]] for corner in range(3)]) > 0.0
    lower, upper = ([functools.reduce(pick, values) for values in (x, y)] for pick in (jnp.minimum, jnp.maximum))
    # Clipped before the conversion: a number beyond the integers would be undefined.
    origin = [jnp.floor(jnp.clip(values, 0.0, limit)) for values, limit in zip(lower, size, strict=True)]
    x, y = ([value - start for value in values] for values, start in zip((x, y), origin, strict=True))
    sides = [(x[k - 1] - x[k - 2], y[k - 1] - y[k - 2]) for k in range(3)]
    area = sides[2][0] * sides[1][1] * -1.0 + sides[2][1] * sides[1][0]
    # x to the right and y down: an outside that faces the camera turns the other way round.
    front = drawable & (area < 0.0)
    longest = jnp.sqrt(functools.reduce(jnp.maximum, [dx * dx + dy * dy for dx, dy in sides]))
    drawn = (front if cull_backfaces else drawable) & (jnp.abs(area) > TOLERANCE_PX * longest)
    inverse = 1.0 / jnp.where(drawn, area, 1.0)
    barycentric = []
    for k, (dx, dy) in enumerate(sides):
        across, down = -dy * inverse, dx * inverse
        barycentric.append((across, down, -(across * x[k - 2] + down * y[k - 2])))
    depth_plane = [sum(nearness[k] * barycentric[k][part] for k in range(3)) for part in range(3)]
    inside = [(a, b, c + TOLERANCE_PX * jnp.sqrt(a * a + b * b)) for a, b, c in barycentric]
    bounds = [functools.reduce(pick, nearness) for pick in (jnp.minimum, jnp.maximum)]
    planes = jnp.stack([*inside[0], *inside[1], *inside[2], *depth_plane, *bounds], axis=1)
    origin, lower, upper = (jnp.stack(values, axis=1) for values in (origin, lower, upper))
    return ScreenTriangles(origin.astype(jnp.int32), lower, upper, planes, front, drawn)


def pixel_boxes(
    triangles: ScreenTriangles, size: tuple[int, int], margin_px: float
) -> tuple[Int[Array, "t 2"], Int[Array, "t 2"]]:
    """First and last column and row whose centres lie within a margin of a triangle's box, inside the picture."""
    limit = jnp.asarray(size, jnp.float32)
    low = jnp.ceil(jnp.clip(triangles.lower - margin_px, 0.0, limit))
    high = jnp.floor(jnp.clip(triangles.upper + margin_px, -1.0, limit - 1.0))
    return low.astype(jnp.int32), high.astype(jnp.int32)


class Blocks(NamedTuple):
    """A chunk of pairs of a triangle and a block of p pixels."""

    triangle: Int[Array, "n"]
    origin: Int[Array, "n 2"]
    planes: Float[Array, "n 14"]
    columns: Int[Array, "n p"]
    rows: Int[Array, "n p"]
    inside: Bool[Array, "n p"]
    """Whether the pixel belongs to the triangle's box; the block may reach beyond it."""

    def covered(self, x: Float[Array, "n p"], y: Float[Array, "n p"]) -> tuple[Bool[Array, "n p"], Float[Array, "n p"]]:
        """Whether the triangles cover points relative to `origin`, and how near they are there."""
        plane = [self.planes[:, k : k + 1] for k in range(14)]
        first, second, third, nearness = (plane[k] * x + plane[k + 1] * y + plane[k + 2] for k in (0, 3, 6, 9))
        # Clipped: on a sliver the tolerance would reach far along its depth.
        return (first >= 0.0) & (second >= 0.0) & (third >= 0.0), jnp.clip(nearness, plane[12], plane[13])


def for_each_block(
    triangles: ScreenTriangles, boxes: tuple[Int[Array, "t 2"], Int[Array, "t 2"]], wanted: Bool[Array, "t"],
    step, state, chunk: int = CHUNK,
):  # fmt: skip
    """Fold `state = step(state, blocks)` over all pixels of the wanted triangles' boxes, however many there are."""
    low, high = boxes
    extent = jnp.where(wanted[:, None], jnp.maximum(high - low + 1, 0), 0)
    across = -(-extent // TILE)
    ends = jnp.cumsum(across[:, 0] * across[:, 1], dtype=jnp.int32)
    starts = ends - across[:, 0] * across[:, 1]
    table = jnp.concatenate([low, high, triangles.origin, across[:, :1], starts[:, None]], axis=1)
    right, down = (jnp.asarray(steps.reshape(1, -1), jnp.int32) for steps in np.indices((TILE, TILE))[::-1])

    def body(loop):
        first, state = loop
        item = first + jnp.arange(chunk, dtype=jnp.int32)
        triangle = jnp.minimum(jnp.searchsorted(ends, item, side="right"), len(ends) - 1).astype(jnp.int32)
        row = table[triangle]
        block, wide = item - row[:, 7], jnp.maximum(row[:, 6], 1)
        corner = row[:, :2] + TILE * jnp.stack([block % wide, block // wide], axis=1)
        # Worked out once per block: fused into what follows it would be done again for every pixel.
        row, corner, planes = lax.optimization_barrier((row, corner, triangles.planes[triangle]))
        columns, rows = corner[:, :1] + right, corner[:, 1:] + down
        inside = (columns <= row[:, 2:3]) & (rows <= row[:, 3:4]) & (item < ends[-1])[:, None]
        return first + chunk, step(state, Blocks(triangle, row[:, 4:6], planes, columns, rows, inside))

    return lax.while_loop(lambda loop: loop[0] < ends[-1], body, (jnp.int32(0), state))[1]


def visible_triangles(
    triangles: ScreenTriangles, size: tuple[int, int]
) -> tuple[Int[Array, "h w"], Float[Array, "h w"]]:
    """Index and nearness of the nearest triangle at each pixel centre; −1 and −∞ where there is none.

    Of triangles that are equally near the first one counts.
    """
    width, height = size

    def step(keys, blocks):
        local = blocks.columns - blocks.origin[:, :1], blocks.rows - blocks.origin[:, 1:]
        covered, nearness = blocks.covered(*(array.astype(jnp.float32) for array in local))
        place = jnp.where(blocks.inside & covered, blocks.rows * width + blocks.columns, width * height)
        key = order_key(nearness, blocks.triangle[:, None])
        return scatter_max(keys, place, key)

    boxes = pixel_boxes(triangles, size, TOLERANCE_PX)
    keys = for_each_block(triangles, boxes, triangles.drawn, step, jnp.zeros(width * height, jnp.uint64))
    return index_of_key(keys).reshape(height, width), value_of_key(keys).reshape(height, width)


def scatter_max(
    target: Shaped[Array, "m"], place: Int[Array, "n p"], values: Shaped[Array, "n p"]
) -> Shaped[Array, "m"]:
    """`target` with the largest of its own and the values for each place; places beyond its end are left out.

    In two halves, because a loop takes finished arrays: else XLA works the values out one by one as it scatters.
    """
    half = len(place) // 2

    def scatter(k, target):
        part = (lax.dynamic_slice_in_dim(array, k * half, half).ravel() for array in (place, values))
        return target.at[next(part)].max(next(part), mode="drop")

    return lax.fori_loop(0, 2, scatter, target)


def order_key(value: Float[Array, "*#n"], index: Int[Array, "*#n"]) -> UInt[Array, "*#n"]:
    """An integer that is larger for larger values and, among equal ones, for lower indices; never 0."""
    bits = lax.bitcast_convert_type(value, jnp.uint32)
    # IEEE floats ascend like integers if the sign is flipped, and all bits of negative ones are.
    ascending = jnp.where(bits >> 31 == 1, ~bits, bits | jnp.uint32(1 << 31))
    return ascending.astype(jnp.uint64) << 32 | (~index.astype(jnp.uint32)).astype(jnp.uint64)


def index_of_key(keys: UInt[Array, "*n"]) -> Int[Array, "*n"]:
    """The index in a key, −1 for key 0."""
    return jnp.where(keys == 0, -1, (~keys.astype(jnp.uint32)).astype(jnp.int32))


def value_of_key(keys: UInt[Array, "*n"]) -> Float[Array, "*n"]:
    """The value in a key, −∞ for key 0."""
    ascending = (keys >> 32).astype(jnp.uint32)
    bits = jnp.where(ascending >> 31 == 1, ascending ^ jnp.uint32(1 << 31), ~ascending)
    return jnp.where(keys == 0, -jnp.inf, lax.bitcast_convert_type(bits, jnp.float32))
