"""What lies at each texel of a mesh's texture."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_matrix

from workbench.errors import InputError
from workbench.face import FaceModel

Numbers = Float[np.ndarray, "v"] | Float[np.ndarray, "v d"]
ROUNDING = 1e-9
AT_ONCE = 200_000
"""Texels that are looked at together: some megabytes."""


@dataclass(frozen=True, eq=False)
class UVMap:
    """Triangle and barycentric coordinates of every texel; beside the islands, those of the nearest one inside."""

    triangle: Int[np.ndarray, "s s"]
    barycentric: Float[np.ndarray, "s s 3"]
    inside: Bool[np.ndarray, "s s"]
    """Texels whose centres lie in a triangle."""
    vertices: Int[np.ndarray, "s s 3"]
    """The triangle's corners."""

    def of(self, values: Numbers) -> Float[np.ndarray, "s s *d"]:
        """Numbers of the vertices, interpolated to the texels."""
        return np.einsum("rcj,rcj...->rc...", self.barycentric, values[self.vertices])

    def corners(self, chosen: Bool[np.ndarray, "s s"], vertex_count: int) -> csr_matrix:
        """Barycentric coordinates of the chosen texels: texels × vertices."""
        count = int(chosen.sum())
        rows = np.repeat(np.arange(count), 3)
        return csr_matrix(
            (self.barycentric[chosen].ravel(), (rows, self.vertices[chosen].ravel())), shape=(count, vertex_count)
        )


def uv_map(model: FaceModel, size: int) -> UVMap:
    """The map of a model's texture of `size` × `size` texels, first row on top. Raises `InputError` without UVs."""
    if len(model.uv) < 2:
        raise InputError(
            f"The model {model.name} has no texture coordinates; use one that has them, such as the default head."
        )
    drawn, barycentric = drawn_triangles(model.uv[model.triangles_uv], size)
    nearest = tuple(distance_transform_edt(drawn < 0, return_distances=False, return_indices=True))
    triangle = drawn[nearest]
    return UVMap(
        triangle=triangle,
        barycentric=barycentric[nearest],
        inside=drawn >= 0,
        vertices=model.triangles[triangle].astype(np.int64),
    )


def drawn_triangles(
    uv: Float[np.ndarray, "t 3 2"], size: int
) -> tuple[Int[np.ndarray, "s s"], Float[np.ndarray, "s s 3"]]:
    """Which triangle covers each texel's centre, the last of several, and where in it; −1 and zeros beside them all."""
    corners = (uv * [1.0, -1.0] + [0.0, 1.0]) * size - 0.5
    drawn, barycentric = np.full((size, size), -1, np.int64), np.zeros((size, size, 3))
    first = np.clip(np.ceil(corners.min(axis=1)), 0, size).astype(int)
    extent = np.clip(np.floor(corners.max(axis=1)) + 1, first, size).astype(int) - first
    for triangle, texel in _in_boxes(first, extent):
        shares = _barycentric(corners[triangle], texel)
        within = (shares >= -ROUNDING).all(axis=1)
        column, row = texel[within].T
        # Of texels that come several times, the last counts.
        drawn[row, column], barycentric[row, column] = triangle[within], shares[within]
    return drawn, barycentric


def _in_boxes(
    first: Int[np.ndarray, "t 2"], extent: Int[np.ndarray, "t 2"]
) -> Iterator[tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n 2"]]]:
    """The texels (column, row) in the box about each triangle, with its number, about `AT_ONCE` at a time."""
    counts = extent.prod(axis=1)
    cuts = np.searchsorted(np.cumsum(counts), np.arange(AT_ONCE, counts.sum(), AT_ONCE))
    for numbers in np.split(np.arange(len(counts)), cuts):
        triangle = np.repeat(numbers, counts[numbers])
        begins = np.cumsum(counts[numbers]) - counts[numbers]
        place = np.arange(len(triangle)) - np.repeat(begins, counts[numbers])
        row, column = np.divmod(place, extent[triangle, 0])
        yield triangle, first[triangle] + np.stack([column, row], axis=1)


def _barycentric(corners: Float[np.ndarray, "n 3 2"], points: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    first, second, third = np.moveaxis(corners - points[:, None], 1, 0)
    areas = np.stack([_cross(second, third), _cross(third, first), _cross(first, second)], axis=-1)
    total = areas.sum(axis=-1, keepdims=True)
    return np.divide(areas, total, out=np.full_like(areas, -1.0), where=np.abs(total) > ROUNDING)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
