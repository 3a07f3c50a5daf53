"""The exact flow of two states of a mesh: where the surface point seen by a pixel is in the second picture.

Two forms. *Dense*: one vector for each pixel of the first picture. *Sparse*: at surface points that were chosen once,
as cheap to differentiate as landmarks.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Integer

from workbench.arrays import AnyArray
from workbench.errors import InputError
from workbench.face import FaceParameters
from workbench.face.model import BLINK_SCALE_RANGE
from workbench.flow.sampling import four_neighbours
from workbench.rendering.camera import AnyCamera, to_screen
from workbench.rendering.head import RenderModel, face_vertices, model_at
from workbench.rendering.interpolation import Corners, only_where
from workbench.rendering.rasteriser import screen_triangles, visible_triangles

HIDDEN_MM = 1.5
"""A surface point this much farther than what the other picture shows at its place is hidden there."""


class SeenSurface(NamedTuple):
    """Which point of a mesh each pixel's centre shows."""

    triangle: Int[Array, "h w"]
    """−1 where nothing is."""
    barycentric: Float[Array, "h w 3"]
    """On the surface; as the mesh moves, it slides under the pixel (differentiable). Zero where nothing is."""
    depth: Float[Array, "h w"]
    """z in the camera frame, millimetres; infinite where nothing is."""


class GeometricFlow(NamedTuple):
    """The flow of a mesh from a first to a second picture."""

    flow: Float[Array, "h w 2"]
    """Pixels; zero where the first picture shows no mesh."""
    seen: Bool[Array, "h w"]
    """The first picture shows the mesh here."""
    visible: Bool[Array, "h w"]
    """The same surface point is seen in the second picture too: neither hidden nor beyond the border."""


class SurfacePoints(NamedTuple):
    """Chosen points of a face's surface, with only as much of the face as they need."""

    model: RenderModel
    """Its vertices are the three corners of point 0, those of point 1, ...; its topology is the whole head's."""
    barycentric: Float[AnyArray, "n 3"]


@partial(jax.jit, static_argnames=("size", "cull_backfaces"))
def seen_surface(
    vertices_camera: Float[AnyArray, "v 3"],
    triangles: Int[AnyArray, "t 3"],
    camera: AnyCamera,
    *,
    size: tuple[int, int],
    cull_backfaces: bool = True,
) -> SeenSurface:
    """What each pixel of a picture of `size` (width, height) shows of camera-frame vertices, in float32.

    Which triangle that is has no derivative; the place on it and its depth have.
    """
    vertices, triangles = jnp.asarray(vertices_camera, jnp.float32), jnp.asarray(triangles)
    width, height = size
    screen = to_screen(camera, vertices)
    seen, _ = visible_triangles(
        screen_triangles(triangles, lax.stop_gradient(screen), size, cull_backfaces), size
    )  # fmt: skip
    covered, chosen = (seen >= 0).ravel(), jnp.maximum(seen, 0).ravel()
    per_vertex = jnp.concatenate([screen.pixels, screen.weight[:, None]], axis=1)
    table = jnp.swapaxes(per_vertex[triangles], 1, 2).reshape(len(triangles), 9)
    y, x = (place.ravel().astype(jnp.float32) for place in jnp.indices((height, width)))
    shares = only_where(covered, Corners(table, chosen).barycentric_at(x, y))
    barycentric = jnp.stack(shares, axis=-1)
    depth = (vertices[triangles[chosen], 2] * barycentric).sum(axis=-1)
    return SeenSurface(
        triangle=seen,
        barycentric=jnp.where(covered[:, None], barycentric, 0.0).reshape(height, width, 3),
        depth=jnp.where(covered, depth, jnp.inf).reshape(height, width),
    )


@partial(jax.jit, static_argnames=("size", "cull_backfaces"))
def geometric_flow(
    first_camera: Float[AnyArray, "v 3"],
    second_camera: Float[AnyArray, "v 3"],
    triangles: Int[AnyArray, "t 3"],
    camera: AnyCamera,
    *,
    size: tuple[int, int],
    cull_backfaces: bool = True,
) -> GeometricFlow:
    """Dense flow of a mesh whose camera-frame vertices move from the first to the second array, in float32.

    Exact at pixel centres. Differentiable in both arrays and the camera; occlusion is held fixed in the derivative.
    """
    options = {"size": size, "cull_backfaces": cull_backfaces}
    seen = seen_surface(first_camera, triangles, camera, **options)
    other = lax.stop_gradient(seen_surface(second_camera, triangles, camera, **options))
    return flow_of_seen(seen, second_camera, triangles, camera, other)


def flow_of_seen(
    seen: SeenSurface,
    second_camera: Float[AnyArray, "v 3"],
    triangles: Int[AnyArray, "t 3"],
    camera: AnyCamera,
    other: SeenSurface,
) -> GeometricFlow:
    """As `geometric_flow`, of surfaces already found: `seen` in the first picture, `other` in the second."""
    height, width = seen.triangle.shape
    here = seen.triangle >= 0
    second = jnp.asarray(second_camera, jnp.float32)
    corners = second[jnp.asarray(triangles)[jnp.maximum(seen.triangle, 0)]]
    points = (corners * seen.barycentric[..., None]).sum(axis=-2)
    points = jnp.where(here[..., None], points, second[0])
    target = to_screen(camera, points.reshape(-1, 3)).pixels.reshape(height, width, 2)
    y, x = jnp.indices((height, width)).astype(jnp.float32)
    flow = jnp.where(here[..., None], target - jnp.stack([x, y], axis=-1), 0.0)
    return GeometricFlow(flow, here, here & shown_at(other, target, points[..., 2]))


def shown_at(surface: SeenSurface, places: Float[AnyArray, "*n 2"], depth: Float[AnyArray, "*n"]) -> Bool[Array, "*n"]:
    """Whether a picture shows points that lie at these places in it, this far from its camera (millimetres)."""
    height, width = surface.depth.shape
    inside = ((places >= 0.0) & (places <= jnp.asarray([width - 1, height - 1], jnp.float32))).all(axis=-1)
    rows, columns, _ = four_neighbours(lax.stop_gradient(places), (height, width))
    # Of four pixels the farthest: a slanted surface does not hide itself.
    return inside & (depth <= surface.depth[rows, columns].max(axis=-1) + HIDDEN_MM)


def surface_points(
    model: RenderModel, triangle: Integer[np.ndarray, "n"], barycentric: Float[np.ndarray, "n 3"]
) -> SurfacePoints:
    """The points at these barycentric coordinates of these triangles of a face.

    Raises `InputError` for triangles that the face does not have, such as the −1 of pixels that show no face.
    """
    triangles = np.asarray(model.topology.triangles)
    triangle = np.asarray(triangle)
    if len(triangle) and not 0 <= triangle.min() <= triangle.max() < len(triangles):
        raise InputError(
            f"Surface points lie on triangles 0 to {len(triangles) - 1} of this head, got {triangle.min()} to "
            f"{triangle.max()}; leave out pixels that show no head (−1)."
        )
    corners = triangles[triangle].ravel()
    return SurfacePoints(model_at(model, corners), jnp.asarray(barycentric, jnp.float32))


def personal_points(points: SurfacePoints, identity: Float[np.ndarray, "i"]) -> SurfacePoints:
    """The points of one person: identity, blink travel and the jaw's pivot baked in, no identity basis left."""
    model, identity = points.model, np.asarray(identity, float)
    scale = np.asarray(model.expression_scale) + identity @ np.asarray(model.expression_scale_identity)
    scale = np.clip(scale, *BLINK_SCALE_RANGE)
    baked = {
        "neutral": model.neutral + np.tensordot(identity, model.identity, axes=1),
        "expression": model.expression * scale[:, None, None],
        "identity": np.zeros((0, *model.neutral.shape)),
        "expression_scale": np.ones(len(scale)),
        "expression_scale_identity": np.zeros((0, len(scale))),
    }
    pivot = {"joint": model.jaw.joint + identity @ model.jaw.joint_identity, "joint_identity": np.zeros((0, 3))}
    jaw = model.jaw._replace(**{name: np.asarray(part, np.float32) for name, part in pivot.items()})
    person = {name: np.asarray(part, np.float32) for name, part in baked.items()}
    return points._replace(model=model._replace(**person, jaw=jaw))


# By themselves one program each; inlined, part of any other as if they were written there.
@partial(jax.jit, inline=True)
def points_in_camera(points: SurfacePoints, parameters: FaceParameters) -> Float[Array, "n 3"]:
    """Where the surface points are for these parameters: camera frame, millimetres, float32."""
    corners = face_vertices(points.model, parameters).reshape(-1, 3, 3)
    return (corners * points.barycentric[..., None]).sum(axis=1)


@partial(jax.jit, inline=True)
def point_flow(
    points: SurfacePoints, first: FaceParameters, second: FaceParameters, camera: AnyCamera
) -> tuple[Float[Array, "n 2"], Float[Array, "n 2"]]:
    """Where the points are in the first picture, and their flow to the second; pixels, float32.

    Differentiable in both. Visibility is the caller's: choose points that are seen (`choose_points`).
    """
    start, end = (to_screen(camera, points_in_camera(points, state)).pixels for state in (first, second))
    return start, end - start


def choose_points(
    seen: SeenSurface, wanted: Bool[np.ndarray, "t"] | None = None, step: int = 4
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n 3"], Int[np.ndarray, "n 2"]]:
    """Every `step`-th pixel that shows the mesh (only `wanted` triangles): triangle, barycentric, pixel (x, y)."""
    triangle = np.asarray(seen.triangle)
    start = step // 2
    grid = triangle[start::step, start::step]
    shown = grid >= 0
    if wanted is not None:
        shown &= wanted[np.maximum(grid, 0)]
    rows, columns = np.nonzero(shown)
    rows, columns = rows * step + start, columns * step + start
    barycentric = np.asarray(seen.barycentric, np.float64)[rows, columns]
    barycentric = np.clip(barycentric, 0.0, None)
    barycentric /= np.maximum(barycentric.sum(axis=1, keepdims=True), 1e-12)
    return triangle[rows, columns], barycentric, np.stack([columns, rows], axis=1).astype(np.int32)
