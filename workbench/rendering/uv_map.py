"""What lies at each texel of a mesh's texture."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt
from scipy.sparse import csr_matrix

from workbench.errors import InputError
from workbench.face import FaceModel

Numbers = Float[np.ndarray, "v"] | Float[np.ndarray, "v d"]
ROUNDING = 1e-9


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
        raise InputError(f"The model {model.name} has no texture coordinates; use one that has, as the default head.")
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
    last = np.clip(np.floor(corners.max(axis=1)) + 1, 0, size).astype(int)
    for number, (corner, (left, top), (right, bottom)) in enumerate(zip(corners, first, last, strict=True)):
        rows, columns = np.mgrid[top:bottom, left:right]
        shares = _barycentric(corner, np.stack([columns, rows], axis=-1).astype(float))
        within = (shares >= -ROUNDING).all(axis=-1)
        drawn[top:bottom, left:right][within] = number
        barycentric[top:bottom, left:right][within] = shares[within]
    return drawn, barycentric


def _barycentric(corners: Float[np.ndarray, "3 2"], points: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w 3"]:
    first, second, third = np.moveaxis(corners - points[..., None, :], 2, 0)
    areas = np.stack([_cross(second, third), _cross(third, first), _cross(first, second)], axis=-1)
    total = areas.sum(axis=-1, keepdims=True)
    return np.divide(areas, total, out=np.full_like(areas, -1.0), where=np.abs(total) > ROUNDING)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
