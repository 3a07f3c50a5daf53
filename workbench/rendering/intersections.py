"""Lines where two parts of a mesh pass through each other: an eyeball that dips into its lid, a tooth in the gum.

No edge of the mesh runs along such a line, yet the picture jumps there, and the line moves when either part does. In
every pixel that shows one part beside a pixel that shows another, and that no contour crosses, the line is where the
planes of the two triangles are equally near. Parts are what no edge connects, or the two marked sides of a slit; other
self-intersections are not found.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from workbench.rendering.antialias import half_plane_in_square
from workbench.rendering.compaction import indices_of
from workbench.rendering.contours import ContourPieces
from workbench.rendering.rasteriser import ScreenTriangles
from workbench.rendering.topology import may_cross

NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0))
"""(rows, columns) to the pixels beside one."""
GENTLEST_SLOPE = 0.1
"""Millimetres per pixel: where two surfaces part more slowly, the speed of their line is damped instead of infinite."""
SLACK_PX = 1.0
"""How far outside of a triangle, whose neighbour goes on, a line may lie."""


class IntersectionPieces(NamedTuple):
    """Pieces of intersection lines, at most one per pixel; `length` is 0 for unused entries."""

    pixel: Int[Array, "n"]
    """row · width + column."""
    shown: Int[Array, "n"]
    """The triangle at the pixel's centre."""
    other: Int[Array, "n"]
    """The triangle beyond the line."""
    middle: Float[Array, "n 2"]
    """A point of the line, relative to the pixel's centre."""
    length: Float[Array, "n"]
    """Pixels."""
    beyond: Float[Array, "n"]
    """Share of the pixel on the other side."""
    slope: Float[Array, "n"]
    """By how much nearness changes from one triangle to the other, per pixel across the line."""


def intersection_pieces(
    seen: Int[Array, "h w"], part: Int[Array, "t"], triangles: ScreenTriangles, contours: ContourPieces, capacity: int
) -> tuple[IntersectionPieces, Int[Array, ""]]:
    """The intersection lines between what the pixels show, and the number of pixels that found no room."""
    height, width = seen.shape
    crossed = jnp.zeros(height * width, bool)
    crossed = crossed.at[jnp.where(contours.length > 0.0, contours.pixel, height * width)].set(True, mode="drop")
    parts = jnp.pad(jnp.where(seen >= 0, part[jnp.maximum(seen, 0)], -1), 1, constant_values=-1)
    own = parts[1:-1, 1:-1]
    wanted = jnp.zeros((height, width), bool)
    for down, right in NEIGHBOURS:
        beside = parts[1 + down : height + 1 + down, 1 + right : width + 1 + right]
        wanted |= may_cross(beside, own) & (beside >= 0)
    wanted = (wanted & (own >= 0)).ravel() & ~crossed
    pixel, used, lost = indices_of(wanted, capacity)
    shown = jnp.maximum(seen.ravel()[pixel], 0)
    column, row = pixel % width, pixel // width
    beside = [
        jnp.clip(row + down, 0, height - 1) * width + jnp.clip(column + right, 0, width - 1)
        for down, right in NEIGHBOURS
    ]
    other = seen.ravel()[jnp.stack(beside)]
    apart = used & (other >= 0) & may_cross(part[shown], part[jnp.maximum(other, 0)])
    other = jnp.maximum(other, 0)
    line = _line(triangles, *(jnp.tile(array, len(NEIGHBOURS)) for array in (shown, column, row)), other.ravel())
    line = _Line(*(array.reshape(len(NEIGHBOURS), capacity, *array.shape[1:]) for array in line))
    # Of the lines towards the four neighbours the one nearest to the centre; most pixels have one at most.
    rank = jnp.where(line.valid & apart, 1.0 + line.beyond, 0.0)
    best = rank.argmax(axis=0), jnp.arange(capacity)
    found = rank[best] > 0.0
    line = _Line(*(array[best] for array in line))
    # Finite numbers also where there is no line: zero times infinity would spoil reverse derivatives.
    length, beyond = (jnp.where(found, values, 0.0) for values in (line.length, line.beyond))
    slope = jnp.where(found, line.slope, 1.0)
    middle = jnp.where(found[:, None], line.middle, 0.0)
    return IntersectionPieces(pixel, shown, other[best], middle, length, beyond, slope), lost


def crossing_change(
    pieces: IntersectionPieces, weight: Float[Array, "n"], depths: list[Float[Array, "n"]], jump: Float[Array, "n c"]
) -> Float[Array, "n c"]:
    """What each piece adds to its pixel, from the depths of both triangles at its middle, which alone move.

    `jump` is the colour here less that beyond, `weight` as in `ScreenPoints`.
    """
    # Where the one comes nearer than the other by d, the line moves by d/slope.
    slope = pieces.slope / jnp.maximum(weight * weight, 1e-20)
    gap = depths[1] - depths[0]
    displacement = (gap - lax.stop_gradient(gap)) * slope / (slope * slope + GENTLEST_SLOPE**2)
    return (pieces.length * displacement)[:, None] * lax.stop_gradient(jump) - pieces.beyond[:, None] * jump


class _Line(NamedTuple):
    middle: Float[Array, "n 2"]
    length: Float[Array, "n"]
    beyond: Float[Array, "n"]
    slope: Float[Array, "n"]
    valid: Bool[Array, "n"]


def _line(triangles: ScreenTriangles, shown, column, row, other) -> _Line:
    """Where the planes of two triangles are equally near, in one pixel each."""
    place = jnp.stack([column, row], axis=1)
    (first, first_inside), (second, second_inside) = (_planes_at(triangles, index, place) for index in (shown, other))
    difference = first - second
    gradient = difference[:, :2]
    slope = jnp.maximum(jnp.linalg.norm(gradient, axis=1), 1e-20)
    distance = difference[:, 2] / slope
    normal = -gradient / slope[:, None]
    share, length = half_plane_in_square(normal, distance)
    middle = normal * distance[:, None]
    inside = (_at(first_inside, middle) >= 0.0).all(axis=1) & (_at(second_inside, middle) >= 0.0).all(axis=1)
    # The shown triangle is the nearer one at the centre, and the line crosses the pixel.
    valid = inside & (distance >= 0.0) & (share < 1.0) & (jnp.abs(middle) <= 0.5 + 1e-3).all(axis=1)
    return _Line(middle, length, 1.0 - share, slope, valid)


def _planes_at(triangles: ScreenTriangles, index, place) -> tuple[Float[Array, "n 3"], Float[Array, "n 3 3"]]:
    """Nearness, and the three functions that are ≥ 0 up to `SLACK_PX` outside, relative to pixels' centres."""
    planes = lax.optimization_barrier(triangles.planes[index])
    offset = (place - triangles.origin[index]).astype(jnp.float32)
    planes = planes[:, :12].reshape(-1, 4, 3)
    constant = (planes[..., :2] * offset[:, None, :]).sum(axis=2) + planes[..., 2]
    planes = jnp.concatenate([planes[..., :2], constant[..., None]], axis=2)
    inside = planes[:, :3]
    slack = SLACK_PX * jnp.linalg.norm(inside[..., :2], axis=2)
    return planes[:, 3], inside.at[..., 2].add(slack)


def _at(planes, point):
    return (planes[..., :2] * point[:, None, :]).sum(axis=2) + planes[..., 2]
