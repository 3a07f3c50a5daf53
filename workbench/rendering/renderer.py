"""The renderer: a triangle mesh under spherical-harmonic light, as a picture that can be differentiated.

Derivatives with respect to vertices, camera, albedo, light and background, forward and reverse. Which triangle is seen
where is found once, outside of the derivative; shading differentiates through interpolation, and contours and the lines
where parts pass through each other through the edge integral of `antialias`. A mesh may use each vertex once only where
it is closed: copies of a vertex along a seam make a border, which is drawn right but costs time.

With one sample per pixel colour and derivative are those of the pixel's centre inside of surfaces: quick, and noisy
where triangles are smaller than pixels. Two per side (`samples=2`) come close to the mean over the pixel.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from workbench.arrays import AnyArray
from workbench.errors import InputError
from workbench.rendering.antialias import blend_shares, contour_change
from workbench.rendering.camera import AnyCamera, ScreenPoints, to_screen
from workbench.rendering.contours import (
    ContourPieces,
    VisibleContours,
    before_something,
    contour_edges,
    cut_into_pieces,
    edge_ends,
    visible_contours,
)
from workbench.rendering.interpolation import Corners, SurfacePoints, Vector, corner_table, only_where, within
from workbench.rendering.intersections import IntersectionPieces, crossing_change, intersection_pieces
from workbench.rendering.lighting import shading
from workbench.rendering.rasteriser import screen_triangles, visible_triangles
from workbench.rendering.texture import Texture, sample_texture
from workbench.rendering.topology import MeshTopology, vertex_normals

ROOM_PER_PX = 24
"""Room for pieces of visible contours, as a multiple of the picture's longer side; a head has about 6."""
CROSSINGS_PER_PX = 4
"""Likewise for pieces of the lines where parts pass through each other."""
STRIP_SAMPLES = 1 << 14
"""Samples that are shaded at a time."""
HIDDEN_SHARE = 4
"""Room for all contours, as a multiple of that for visible ones."""


class Rendering(NamedTuple):
    """A picture and what is seen in it; from `depth` on at the pixel's centre, or the sample right below it."""

    color: Float[Array, "h w 3"]
    coverage: Float[Array, "h w"]
    """Share of each pixel that the mesh covers, differentiable like the colour."""
    depth: Float[Array, "h w"]
    """z in the camera frame, millimetres; infinite where nothing is."""
    normals: Float[Array, "h w 3"]
    """Unit, camera frame; zero where nothing is."""
    triangle: Int[Array, "h w"]
    """−1 where nothing is."""
    barycentric: Float[Array, "h w 3"]
    """On the surface (perspective-correct); zero where nothing is."""
    lost_contours: Int[Array, ""]
    """Contour pieces left out for want of room: 0 but in pictures with extremely many edges."""


def render(
    vertices_camera: Float[AnyArray, "v 3"],
    topology: MeshTopology,
    camera: AnyCamera,
    albedo: Float[AnyArray, "n 3"] | Texture,
    light: Float[AnyArray, "9 3"],
    background: Float[AnyArray, "*hw 3"],
    *,
    size: tuple[int, int],
    samples: int = 1,
    antialias: bool = True,
    cull_backfaces: bool = True,
) -> Rendering:
    """Render camera-frame vertices (millimetres) into a picture of `size` (width, height), in float32.

    `albedo` is one colour per vertex or a `Texture`, `light` nine coefficients per channel (`lighting`). `samples`
    squared points are shaded per pixel. Without `antialias` each sample is its centre's colour, and contours have no
    derivative. Everything but sizes and switches is traced: new values compile nothing, nor do arrays of another
    precision. `jax.vmap` batches. Raises `InputError` for arrays whose shapes do not belong together.
    """
    _check(vertices_camera, topology, albedo, background, size, samples)
    vertices, camera, albedo, light, background = jax.tree.map(
        _single, (vertices_camera, camera, albedo, light, background)
    )
    return _render(vertices, topology, camera, albedo, light, background, size, samples, antialias, cull_backfaces)


@partial(jax.jit, static_argnames=("size", "samples", "antialias", "cull_backfaces"))
def _render(
    vertices: Float[Array, "v 3"],
    topology: MeshTopology,
    camera: AnyCamera,
    albedo: Float[Array, "n 3"] | Texture,
    light: Float[Array, "9 3"],
    background: Float[Array, "*hw 3"],
    size: tuple[int, int],
    samples: int,
    antialias: bool,
    cull_backfaces: bool,
) -> Rendering:
    width, height = size[0] * samples, size[1] * samples
    topology = MeshTopology(*(jnp.asarray(array) for array in topology))
    screen = _finer(to_screen(camera, vertices), samples)
    table, texture = _surface(vertices, topology, screen, albedo)
    seen, contours, crossings = _visibility(
        *lax.stop_gradient((screen, topology)), (width, height), antialias, cull_backfaces
    )
    behind = jnp.broadcast_to(jnp.asarray(background, jnp.float32), (size[1], size[0], 3))
    layers, depth, normal, barycentric = _shade(seen, table, texture, light, behind, samples)
    if contours is not None:
        place, change = _edge_change(contours, crossings, topology, screen, table, texture, light, behind, samples)
        smoothed = layers.reshape(-1, 4).at[place].add(change, mode="drop").reshape(height, width, 4)
        layers = _within_neighbours(smoothed, layers)
    layers = _mean_of_samples(layers, samples)
    # The other outputs show the sample nearest to the pixel's centre.
    one = (slice(samples // 2, None, samples),) * 2
    return Rendering(
        color=layers[..., :3],
        coverage=layers[..., 3],
        depth=depth[one],
        normals=normal[one],
        triangle=seen[one],
        barycentric=barycentric[one],
        lost_contours=jnp.int32(0) if contours is None else contours.lost,
    )


def _single(values: Any) -> Array:
    """Floats in single precision, whole numbers as they are."""
    values = jnp.asarray(values)
    return values.astype(jnp.float32) if jnp.issubdtype(values.dtype, jnp.floating) else values


def _check(vertices, topology, albedo, background, size, samples) -> None:
    """Shapes are known while tracing; a wrong one would broadcast or fail far from its cause."""
    count, height, width = len(topology.faces_of_vertex), size[1], size[0]
    if min(*size, samples) < 1:
        raise InputError(f"A picture has at least one pixel and one sample, got {width} × {height} and {samples}.")
    if vertices.shape != (count, 3):
        raise InputError(f"This mesh has {count} vertices (x, y, z), got an array of shape {vertices.shape}.")
    if isinstance(albedo, Texture):
        if albedo.triangles_uv.shape != topology.triangles.shape:
            raise InputError(
                f"A texture needs coordinates for each of {len(topology.triangles)} triangles, got shape "
                f"{albedo.triangles_uv.shape}; use the UVs of this mesh."
            )
    elif albedo.shape != (count, 3):
        raise InputError(f"Albedo is one RGB colour for each of {count} vertices, got shape {albedo.shape}.")
    if background.shape not in ((3,), (height, width, 3)):
        raise InputError(
            f"The background is one RGB colour or a picture of {width} × {height} pixels, got shape "
            f"{background.shape}; resize it first."
        )


def _shade(seen, table, texture, light, background, samples):
    """Colour with coverage, depth, normal and barycentric coordinates at every sample.

    In strips that fit a processor's cache; strips without any surface cost nothing.
    """
    height, width = seen.shape
    rows = samples * max(1, STRIP_SAMPLES // (width * samples))
    count = -(-height // rows)

    def strips(array, rows):
        padded = jnp.pad(array, ((0, count * rows - len(array)), (0, 0)) + ((0, 0),) * (array.ndim - 2))
        return padded.reshape(count, rows, *array.shape[1:])

    def samples_of(background):
        return jnp.repeat(jnp.repeat(background, samples, axis=0), samples, axis=1).reshape(-1, 3)

    def shade(strip):
        first, triangle, behind = strip
        triangle, behind = triangle.ravel(), samples_of(behind)
        covered = triangle >= 0
        corners = Corners(table, jnp.maximum(triangle, 0))
        place = first + jnp.arange(rows * width, dtype=jnp.int32)
        points = corners.interpolate(only_where(covered, corners.barycentric_at(*_coordinates(place, width))))
        others = [jnp.where(covered, values, 0.0) for values in (*points.normal, *points.barycentric)]
        layers = _over_background(_color(points, texture, light), covered, behind)
        depth = jnp.where(covered, points.depth, jnp.inf)
        return layers, depth, jnp.stack(others[:3], axis=-1), jnp.stack(others[3:], axis=-1)

    def empty(strip):
        behind = samples_of(strip[2])
        layers = jnp.pad(behind, ((0, 0), (0, 1)))
        return layers, jnp.full(rows * width, jnp.inf, jnp.float32), jnp.zeros_like(behind), jnp.zeros_like(behind)

    first = rows * width * jnp.arange(count, dtype=jnp.int32)
    xs = first, strips(seen + 1, rows) - 1, strips(background, rows // samples)
    shaded = lax.map(lambda strip: lax.cond((strip[1] >= 0).any(), shade, empty, strip), xs)
    return tuple(array.reshape(count * rows, width, *array.shape[2:])[:height] for array in shaded)


def _finer(screen: ScreenPoints, samples: int) -> ScreenPoints:
    return screen._replace(pixels=(screen.pixels + 0.5) * samples - 0.5) if samples > 1 else screen


def _within_neighbours(smoothed: Float[Array, "h w 4"], plain: Float[Array, "h w 4"]) -> Float[Array, "h w 4"]:
    """Smoothed pixels between the least and largest of the plain picture around them; derivatives stay as they are.

    Where several edges cross one pixel, as between lid and eyeball, their changes add up beyond every colour there.
    """
    plain, now = lax.stop_gradient((plain, smoothed))
    low, high = plain, plain
    for axis in (0, 1):
        # Each neighbour once; the picture's edge is its own neighbour.
        low = jnp.minimum(low, jnp.minimum(_shifted(low, axis, 1), _shifted(low, axis, -1)))
        high = jnp.maximum(high, jnp.maximum(_shifted(high, axis, 1), _shifted(high, axis, -1)))
    return smoothed + (jnp.clip(now, low, high) - now)


def _shifted(picture: Float[Array, "h w c"], axis: int, by: int) -> Float[Array, "h w c"]:
    """The picture moved by one pixel, its border repeated."""
    count = picture.shape[axis]
    if by > 0:
        parts = [lax.slice_in_dim(picture, 0, 1, axis=axis), lax.slice_in_dim(picture, 0, count - 1, axis=axis)]
    else:
        parts = [lax.slice_in_dim(picture, 1, count, axis=axis), lax.slice_in_dim(picture, count - 1, count, axis=axis)]
    return jnp.concatenate(parts, axis=axis)


def _mean_of_samples(layers: Float[Array, "n m 4"], samples: int) -> Float[Array, "h w 4"]:
    parts = [layers[row::samples, column::samples] for row in range(samples) for column in range(samples)]
    return sum(parts[1:], start=parts[0]) * (1.0 / samples**2)


def _surface(vertices, topology, screen, albedo) -> tuple[Float[Array, "t k"], Float[Array, "th tw 3"] | None]:
    normals = vertex_normals(vertices, topology)
    if isinstance(albedo, Texture):
        texture = jnp.asarray(albedo.picture, jnp.float32)
        attribute = jnp.asarray(albedo.uv, jnp.float32)[jnp.asarray(albedo.triangles_uv)]
    else:
        texture, attribute = None, jnp.asarray(albedo, jnp.float32)[topology.triangles]
    return corner_table(topology.triangles, screen, vertices[:, 2], normals, attribute), texture


def _visibility(
    screen: ScreenPoints, topology: MeshTopology, size: tuple[int, int], antialias: bool, cull_backfaces: bool
) -> tuple[Int[Array, "h w"], VisibleContours | None, IntersectionPieces | None]:
    drawable = screen.drawable[topology.triangles].min(axis=1) > 0.0
    triangles = screen_triangles(topology.triangles, screen, size, cull_backfaces)
    seen, nearest = visible_triangles(triangles, size)
    if not antialias:
        return seen, None, None
    half_edges = contour_edges(topology, triangles, drawable)
    room = ROOM_PER_PX * max(size)
    pieces, lost = cut_into_pieces(half_edges, topology, screen, triangles, size, HIDDEN_SHARE * room)
    pieces, lost = before_something(pieces, lost, nearest, room)
    contours = visible_contours(pieces, lost, triangles, nearest)
    room = CROSSINGS_PER_PX * max(size)
    crossings, unused = intersection_pieces(seen, topology.part, triangles, contours.pieces, room)
    return seen, contours._replace(lost=contours.lost + unused), crossings


def _coordinates(pixel: Int[Array, "n"], width: int) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    return (pixel % width).astype(jnp.float32), (pixel // width).astype(jnp.float32)


def _color(points: SurfacePoints, texture: Float[Array, "th tw 3"] | None, light) -> Vector:
    albedo = points.albedo if texture is None else sample_texture(texture, *points.albedo)
    return tuple(own * lit for own, lit in zip(albedo, shading(light, points.normal), strict=True))


def _over_background(color: Vector, covered, behind) -> Float[Array, "n 4"]:
    """Colour and coverage."""
    channels = [jnp.where(covered, color[k], behind[:, k]) for k in range(3)]
    return jnp.stack([*channels, covered.astype(jnp.float32)], axis=1)


def _edge_change(
    contours: VisibleContours,
    crossings: IntersectionPieces,
    topology,
    screen,
    table,
    texture,
    light,
    background,
    samples,
) -> tuple[Int[Array, "n"], Float[Array, "n 4"]]:
    """Samples that contours or intersection lines cross (beyond the picture for unused entries), and their change."""
    pieces, behind = contours.pieces, contours.behind
    height, width = background.shape[0] * samples, background.shape[1] * samples
    triangle = jnp.concatenate([pieces.half_edge // 3, jnp.maximum(behind, 0), crossings.shown, crossings.other])
    pixel = jnp.concatenate([pieces.pixel, pieces.pixel, crossings.pixel, crossings.pixel])
    middle = jnp.concatenate([pieces.middle, pieces.middle, crossings.middle, crossings.middle])
    column, row = _coordinates(pixel, width)
    # All at once: shading compiles long, so it stands in the program only once for edges of every kind.
    corners = Corners(table, triangle)
    used = jnp.concatenate([pieces.length > 0.0, (pieces.length > 0.0) & (behind >= 0), *[crossings.length > 0.0] * 2])
    place = only_where(used, corners.barycentric_at(column + middle[:, 0], row + middle[:, 1]))
    depth = corners.interpolate(place).depth
    on_edge = _shares_on_edge(pieces, topology, screen)
    count = len(behind)
    place = tuple(jnp.concatenate([own, rest[count:]]) for own, rest in zip(on_edge, within(place), strict=True))
    color = jnp.stack(_color(corners.interpolate(place), texture, light), axis=1)
    bounds = [count, 2 * count, 2 * count + len(crossings.pixel)]
    (inside, outside, here, there), depths = jnp.split(color, bounds), jnp.split(depth, bounds)[2:]
    ends = (screen.pixels[end] for end in edge_ends(pieces.half_edge, topology))
    beyond = background[pieces.pixel // width // samples, pieces.pixel % width // samples]
    outside = jnp.where((behind >= 0)[:, None], outside, beyond)
    inside, outside = jnp.pad(inside, ((0, 0), (0, 1)), constant_values=1.0), jnp.pad(outside, ((0, 0), (0, 1)))
    outside = outside.at[:, 3].set((behind >= 0).astype(jnp.float32))
    change = [contour_change(pieces, blend_shares(pieces, contours.inside, height * width), *ends, inside, outside)]
    # The weight hardly differs within a triangle.
    weight = lax.stop_gradient(screen.weight[topology.triangles[crossings.shown, 0]])
    change.append(crossing_change(crossings, weight, depths, jnp.pad(here - there, ((0, 0), (0, 1)))))
    used = jnp.concatenate([pieces.length, crossings.length]) > 0.0
    place = jnp.where(used, jnp.concatenate([pieces.pixel, crossings.pixel]), height * width)
    return place, jnp.where(used[:, None], jnp.concatenate(change), 0.0)


def _shares_on_edge(pieces: ContourPieces, topology: MeshTopology, screen: ScreenPoints) -> Vector:
    """Barycentric coordinates of the pieces' middles on the triangles in front: the third corner has no share."""
    first, second = (lax.stop_gradient(screen.weight[end]) for end in edge_ends(pieces.half_edge, topology))
    first, second = first * (1.0 - pieces.place), second * pieces.place
    second = second / jnp.maximum(first + second, 1e-20)
    corner = pieces.half_edge % 3
    return tuple(jnp.where(corner == k, 1.0 - second, jnp.where((corner + 1) % 3 == k, second, 0.0)) for k in range(3))
