"""Contours: the mesh edges where the picture jumps, cut into one piece per pixel, and what is behind each piece.

A contour edge has the mesh on one side only, as seen by the camera: an outline, the rim of the nose before a cheek, a
lip before the teeth, the border of an open mesh. Nothing here is differentiated; `antialias` turns the pieces into
colours and derivatives.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from workbench.rendering.camera import ScreenPoints
from workbench.rendering.compaction import indices_of
from workbench.rendering.rasteriser import (
    ScreenTriangles,
    for_each_block,
    index_of_key,
    order_key,
    pixel_boxes,
    scatter_max,
    value_of_key,
)
from workbench.rendering.topology import MeshTopology

TESTED_PER_PIXEL = 3
"""Pieces in one pixel that are tested for being hidden, the longest first; shorter ones share the longest's fate."""
CHUNK = 512
"""Blocks of pixels in which pieces are tested at a time."""
CELL = 4
"""Only triangles near contours are tested against them; nearness is judged on cells of CELL × CELL pixels."""
BIAS_MM = 0.02
"""A surface hides a contour if it is nearer by more than this."""


class ContourPieces(NamedTuple):
    """Pieces of contour edges, each inside one pixel; `length` is 0 for unused entries."""

    half_edge: Int[Array, "n"]
    """3·triangle + corner of the triangle in front: the edge runs from this corner to the next."""
    place: Float[Array, "n"]
    """The piece's middle along the edge in the picture, 0 to 1."""
    length: Float[Array, "n"]
    """Pixels."""
    middle: Float[Array, "n 2"]
    """Relative to the pixel's centre."""
    outward: Float[Array, "n 2"]
    """Unit normal in the picture, away from the mesh in front."""
    pixel: Int[Array, "n"]
    """row · width + column."""
    nearness: Float[Array, "n"]
    bias: Float[Array, "n"]
    """`BIAS_MM` as nearness."""


class VisibleContours(NamedTuple):
    """The pieces that are seen."""

    pieces: ContourPieces
    behind: Int[Array, "n"]
    """The triangle seen just outside of each piece, −1 for the background."""
    inside: Bool[Array, "n"]
    """Whether the centre of the piece's pixel shows the surface in front rather than the one behind."""
    lost: Int[Array, ""]
    """Pieces beyond the capacity: their pixels are not smoothed, and their derivative is missing."""


def contour_edges(topology: MeshTopology, triangles: ScreenTriangles, drawable: Bool[Array, "t"]) -> Int[Array, "e"]:
    """For each edge of the mesh, its half-edge with the mesh on one side only; −1 for other edges."""
    first, second = topology.edges[:, 0], topology.edges[:, 1]
    border = second < 0
    front_first, front_second = triangles.front[first // 3], triangles.front[second // 3] & ~border
    drawn = triangles.drawn[first // 3] | (triangles.drawn[second // 3] & ~border)
    contour = jnp.where(border, drawable[first // 3], front_first != front_second) & drawn
    return jnp.where(contour, jnp.where(front_first | border, first, second), -1)


def cut_into_pieces(
    half_edges: Int[Array, "e"], topology: MeshTopology, screen: ScreenPoints, triangles: ScreenTriangles,
    size: tuple[int, int], capacity: int,
) -> tuple[ContourPieces, Int[Array, ""]]:  # fmt: skip
    """Cut edges at the borders of the pixels; also the number of pieces that found no room.

    An edge is cut into slabs, one per pixel column (row, if it is steep). Within a slab it crosses at most one row
    (column) border: two pieces per slab.
    """
    start, end = edge_ends(half_edges, topology)
    a, b = screen.pixels[start], screen.pixels[end]
    steep = jnp.abs(b - a)[:, 1] > jnp.abs(b - a)[:, 0]
    limit = jnp.where(steep, size[1], size[0])
    low, high = (
        jnp.where(steep, corner[:, 1], corner[:, 0]) for corner in (jnp.minimum(a, b), jnp.maximum(a, b))
    )  # fmt: skip
    first = jnp.floor(jnp.clip(low + 0.5, 0.0, limit.astype(jnp.float32))).astype(jnp.int32)
    last = jnp.floor(jnp.clip(high + 0.5, -1.0, limit.astype(jnp.float32) - 1.0)).astype(jnp.int32)
    across = jnp.where(steep, size[0], size[1]).astype(jnp.float32)
    beside = jnp.where(steep, jnp.maximum(a, b)[:, 0], jnp.maximum(a, b)[:, 1]) < -0.5
    beyond = jnp.where(steep, jnp.minimum(a, b)[:, 0], jnp.minimum(a, b)[:, 1]) > across - 0.5
    slabs = jnp.where((half_edges >= 0) & ~beside & ~beyond, jnp.maximum(last - first + 1, 0), 0)
    ends = jnp.cumsum(slabs, dtype=jnp.int32)
    item = jnp.arange(capacity // 2, dtype=jnp.int32)
    edge = jnp.minimum(jnp.searchsorted(ends, item, side="right"), len(ends) - 1).astype(jnp.int32)
    used = item < ends[-1]
    slab = (first[edge] + item - (ends - slabs)[edge]).astype(jnp.float32)
    pieces = _pieces_of_slabs(edge, slab, used, a, b, steep, size)
    half_edge, length, place, middle, pixel = pieces
    along = b - a
    normal = jnp.stack([-along[:, 1], along[:, 0]], axis=1)
    normal = normal / jnp.maximum(jnp.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    # A back of a triangle at an open border turns the other way round.
    normal = jnp.where(triangles.front[jnp.maximum(half_edges, 0) // 3][:, None], normal, -normal)
    edge = half_edge
    near = screen.nearness[start][edge] * (1.0 - place) + screen.nearness[end][edge] * place
    weight = screen.weight[start][edge] * (1.0 - place) + screen.weight[end][edge] * place
    bias = BIAS_MM * weight * weight
    pieces = ContourPieces(half_edges[edge], place, length, middle, normal[edge], pixel, near, bias)
    return pieces, jnp.maximum(ends[-1] - capacity // 2, 0)


def edge_ends(half_edges: Int[Array, "n"], topology: MeshTopology) -> tuple[Int[Array, "n"], Int[Array, "n"]]:
    """The vertices from and to which half-edges run."""
    triangle, corner = jnp.maximum(half_edges, 0) // 3, jnp.maximum(half_edges, 0) % 3
    corners = topology.triangles
    return corners[triangle, corner], corners[triangle, (corner + 1) % 3]


def _pieces_of_slabs(edge, slab, used, a, b, steep, size):
    """Two pieces for each (edge, slab): (edge, length, place, middle, pixel), both halves concatenated."""
    a, b, steep = a[edge], b[edge], steep[edge]
    a_major, b_major = (jnp.where(steep, point[:, 1], point[:, 0]) for point in (a, b))
    a_minor, b_minor = (jnp.where(steep, point[:, 0], point[:, 1]) for point in (a, b))
    run = b_major - a_major
    run = jnp.where(jnp.abs(run) < 1e-9, 1e-9, run)
    entry, exit_ = (jnp.clip((slab + side - a_major) / run, 0.0, 1.0) for side in (-0.5, 0.5))
    rise = b_minor - a_minor
    rows = [jnp.floor(a_minor + rise * t + 0.5) for t in (entry, exit_)]
    border = jnp.maximum(*rows) - 0.5
    crossing = jnp.clip((border - a_minor) / jnp.where(jnp.abs(rise) < 1e-9, 1e-9, rise), *_sorted(entry, exit_))
    split = jnp.where(rows[0] == rows[1], exit_, crossing)
    halves = []
    for begin, finish, row in ((entry, split, rows[0]), (split, exit_, rows[1])):
        place = 0.5 * (begin + finish)
        column, line = jnp.where(steep, row, slab), jnp.where(steep, slab, row)
        inside = used & (column >= 0) & (column < size[0]) & (line >= 0) & (line < size[1])
        length = jnp.where(inside, jnp.abs(finish - begin) * jnp.linalg.norm(b - a, axis=1), 0.0)
        middle = a + (b - a) * place[:, None] - jnp.stack([column, line], axis=1)
        pixel = jnp.where(inside, line * size[0] + column, 0.0).astype(jnp.int32)
        halves.append((edge, length, place, middle, pixel))
    return [jnp.concatenate(parts) for parts in zip(*halves, strict=True)]


def _sorted(one, other):
    return jnp.minimum(one, other), jnp.maximum(one, other)


def before_something(
    pieces: ContourPieces, lost: Int[Array, ""], nearest: Float[Array, "h w"], capacity: int
) -> tuple[ContourPieces, Int[Array, ""]]:
    """Only the pieces that can be seen: something farther away shows in their pixel or one around it.

    `nearest` is the nearness of what each pixel centre shows. Most pieces lie deep inside the head.
    """
    padded = jnp.pad(nearest, 1, mode="edge")
    for axis in (0, 1):
        steps = [jnp.take(padded, jnp.arange(k, k + nearest.shape[axis]), axis=axis) for k in range(3)]
        padded = jnp.minimum(jnp.minimum(steps[0], steps[1]), steps[2])
    kept = (pieces.length > 0.0) & (padded.ravel()[pieces.pixel] < pieces.nearness - pieces.bias)
    index, used, unplaced = indices_of(kept, capacity)
    compact = ContourPieces(*(array[index] for array in pieces))
    return compact._replace(length=jnp.where(used, compact.length, 0.0)), lost + unplaced


def visible_contours(
    pieces: ContourPieces, lost: Int[Array, ""], triangles: ScreenTriangles, nearest: Float[Array, "h w"]
) -> VisibleContours:
    """Drop the pieces that something hides, and find what is seen behind the others, exactly at their middles."""
    height, width = nearest.shape
    size = width, height
    count = len(pieces.length)
    boxes = pixel_boxes(triangles, size, 0.5)
    places = jnp.stack([*pieces.middle.T, pieces.nearness, pieces.bias], axis=1)
    owner = pieces.half_edge // 3

    def examine_longest(_, loop):
        left, hidden, behind = loop
        layer = _longest(pieces, left, width * height)
        wanted = triangles.drawn & _near(jnp.where(left, pieces.pixel, -1), *boxes, size)

        def step(state, blocks):
            hidden, behind = state
            piece = layer[jnp.where(blocks.inside, blocks.rows * width + blocks.columns, 0)]
            tested = blocks.inside & (piece >= 0)
            place = places[jnp.maximum(piece, 0)]
            # The edge's own triangle ends at the piece: it neither hides it nor lies behind it.
            tested &= owner[jnp.maximum(piece, 0)] != blocks.triangle[:, None]
            x, y = blocks.columns - blocks.origin[:, :1], blocks.rows - blocks.origin[:, 1:]
            covered, nearness = blocks.covered(x + place[..., 0], y + place[..., 1])
            ahead = nearness - place[..., 2] > place[..., 3]
            hides = jnp.where(tested & covered & ahead, piece, count)
            follows = jnp.where(tested & covered & ~ahead, piece, count)
            hidden = scatter_max(hidden, hides, jnp.ones_like(hides))
            return hidden, scatter_max(behind, follows, order_key(nearness, blocks.triangle[:, None]))

        hidden, behind = for_each_block(triangles, boxes, wanted, step, (hidden, behind), CHUNK)
        return left & (layer[pieces.pixel] != jnp.arange(count)), hidden, behind

    present = pieces.length > 0.0
    start = present, jnp.zeros(count, jnp.int32), jnp.zeros(count, jnp.uint64)
    left, hidden, behind = lax.fori_loop(0, TESTED_PER_PIXEL, examine_longest, start)
    longest = jnp.maximum(_longest(pieces, present, width * height)[pieces.pixel], 0)
    hidden, behind = (jnp.where(left, array[longest], array) for array in (hidden, behind))
    pieces = pieces._replace(length=jnp.where(hidden > 0, 0.0, pieces.length))
    inside = nearest.ravel()[pieces.pixel] > 0.5 * (pieces.nearness + value_of_key(behind))
    return VisibleContours(pieces, index_of_key(behind), inside, lost)


def _longest(pieces: ContourPieces, chosen: Bool[Array, "n"], pixel_count: int) -> Int[Array, "p"]:
    """The index of the longest of the chosen pieces in each pixel, −1 where there is none."""
    key = order_key(pieces.length, jnp.arange(len(chosen), dtype=jnp.int32))
    keys = jnp.zeros(pixel_count, jnp.uint64)
    return index_of_key(keys.at[jnp.where(chosen, pieces.pixel, pixel_count)].max(key, mode="drop"))


def _near(pixels: Int[Array, "n"], low: Int[Array, "t 2"], high: Int[Array, "t 2"], size) -> Bool[Array, "t"]:
    """Whether boxes touch a cell with one of these pixels (−1: none), by a summed-area table."""
    columns, rows = -(-size[0] // CELL), -(-size[1] // CELL)
    cell = (pixels // size[0] // CELL) * columns + pixels % size[0] // CELL
    cells = jnp.zeros(rows * columns, jnp.int32).at[jnp.where(pixels < 0, rows * columns, cell)].set(1, mode="drop")
    table = jnp.cumsum(jnp.cumsum(cells.reshape(rows, columns), axis=0), axis=1)
    table = jnp.pad(table, ((1, 0), (1, 0))).astype(jnp.int32)
    x0, y0, x1, y1 = low[:, 0] // CELL, low[:, 1] // CELL, high[:, 0] // CELL + 1, high[:, 1] // CELL + 1
    total = table[y1, x1] - table[y0, x1] - table[y1, x0] + table[y0, x0]
    return (total > 0) & (high >= low).all(axis=1)
