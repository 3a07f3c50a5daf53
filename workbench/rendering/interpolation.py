"""Points on triangles and the attributes there, differentiable in all vertices and in the camera."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from workbench.rendering.camera import ScreenPoints

Vector = tuple[Float[Array, "n"], ...]
"""One array per component: a last axis of two or three would keep a processor's vector units idle."""


THIN_PX = 0.1
"""Width below which a triangle's derivative is damped."""


class SurfacePoints(NamedTuple):
    """Points of the surface that are seen in the picture."""

    barycentric: Vector
    """On the surface (perspective-correct)."""
    depth: Float[Array, "n"]
    """z in the camera frame, millimetres."""
    normal: Vector
    """Unit, camera frame."""
    albedo: Vector
    """Colour, or texture coordinates."""


def corner_table(
    triangles: Int[Array, "t 3"], screen: ScreenPoints, depth: Float[Array, "v"], normals: Float[Array, "v 3"],
    albedo: Float[Array, "t 3 c"],
) -> Float[Array, "t k"]:  # fmt: skip
    """What each triangle's corners have, in one row that one gather fetches: x, y, weight, depth, normal, albedo."""
    per_vertex = jnp.concatenate([screen.pixels, screen.weight[:, None], depth[:, None], normals], axis=1)
    per_corner = jnp.concatenate([per_vertex[triangles], albedo], axis=2)
    return jnp.swapaxes(per_corner, 1, 2).reshape(len(triangles), -1)


class Corners:
    """The corners of the triangles at n points."""

    def __init__(self, table: Float[Array, "t k"], triangle: Int[Array, "n"]) -> None:
        # Fetched once: fused into the arithmetic, every component would be fetched by itself.
        rows = lax.optimization_barrier(table[triangle])
        self._columns = [rows[:, k] for k in range(rows.shape[1])]

    def barycentric_at(self, x: Float[Array, "n"], y: Float[Array, "n"]) -> Vector:
        """Perspective-correct barycentric coordinates of the surface points that appear at pixels (x, y).

        They extend beyond the triangle. With the triangle held fixed they slide as the vertices move; on a triangle
        thinner than `THIN_PX` more slowly than they would, because one point is no measure of what happens across it.
        """
        # Relative to the point: products of large coordinates would cost digits.
        dx, dy = [value - x for value in self._corner(0)], [value - y for value in self._corner(1)]
        areas = [dx[k - 2] * dy[k - 1] - dy[k - 2] * dx[k - 1] for k in range(3)]
        weighted = [area * weight for area, weight in zip(areas, self._corner(2), strict=True)]
        total = weighted[0] + weighted[1] + weighted[2]
        # Where a triangle is seen edge-on nothing is drawn; zero there keeps infinity out of derivatives.
        flat = jnp.abs(total) < 1e-12
        inverse = jnp.where(flat, 0.0, 1.0 / jnp.where(flat, 1.0, total))
        squares = [(dx[k - 1] - dx[k]) ** 2 + (dy[k - 1] - dy[k]) ** 2 for k in range(3)]
        longest = jnp.sqrt(jnp.maximum(jnp.maximum(squares[0], squares[1]), jnp.maximum(squares[2], 1e-12)))
        thin = lax.stop_gradient(jnp.minimum(jnp.abs(areas[0] + areas[1] + areas[2]) / (THIN_PX * longest), 1.0))
        moving = [share * inverse for share in weighted]
        return tuple(lax.stop_gradient(share) * (1.0 - thin) + share * thin for share in moving)

    def interpolate(self, barycentric: Vector) -> SurfacePoints:
        """Attributes at barycentric coordinates."""
        first, second, third = barycentric
        values = []
        for k in range(3, len(self._columns) // 3):
            corner = self._corner(k)
            values.append(first * corner[0] + second * corner[1] + third * corner[2])
        depth, x, y, z, *albedo = values
        inverse = 1.0 / jnp.sqrt(jnp.maximum(x * x + y * y + z * z, 1e-20))
        return SurfacePoints(barycentric, depth, (x * inverse, y * inverse, z * inverse), tuple(albedo))

    def _corner(self, attribute: int) -> list[Float[Array, "n"]]:
        return self._columns[3 * attribute : 3 * attribute + 3]


def only_where(used: Bool[Array, "n"], barycentric: Vector) -> Vector:
    """Barycentric coordinates of the first corner where a point is not used.

    Far beyond a triangle attributes may overflow, and zero times infinity would spoil reverse derivatives.
    """
    return tuple(jnp.where(used, share, 1.0 if k == 0 else 0.0) for k, share in enumerate(barycentric))


def within(barycentric: Vector) -> Vector:
    """Barycentric coordinates held inside their triangle."""
    first, second, third = (jnp.maximum(share, 0.0) for share in barycentric)
    inverse = 1.0 / jnp.maximum(first + second + third, 1e-12)
    return first * inverse, second * inverse, third * inverse
