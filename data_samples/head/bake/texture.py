"""Bake the paint into a picture: rasterise the UV triangles, paint every texel, pad the seams."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import ndimage

SIZE, OVERSAMPLING, PADDING = 1024, 2, 12


@dataclass(frozen=True)
class Raster:
    """Covered texels of a square picture, row by row from the top."""

    texel: Int[np.ndarray, "n"]
    """Flat index of each covered texel."""
    triangle: Int[np.ndarray, "n"]
    weights: Float[np.ndarray, "n 3"]

    def gathered(self, values: np.ndarray, triangles: Int[np.ndarray, "t 3"]) -> np.ndarray:
        """Per-vertex values interpolated at the covered texels."""
        corners = values[triangles[self.triangle]]
        return np.einsum("nk,nk...->n...", self.weights, corners)


def rasterise(uvs: Float[np.ndarray, "u 2"], triangles: Int[np.ndarray, "t 3"], size: int) -> Raster:
    """Find the triangle and barycentric weights at the centre of every covered texel (v up, row 0 on top)."""
    pixels = np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1) * size - 0.5
    owner = np.full((size, size), -1)
    weights = np.zeros((size, size, 3))
    for index, corners in enumerate(pixels[triangles]):
        low = np.clip(np.ceil(corners.min(axis=0)).astype(int), 0, size - 1)
        high = np.clip(np.floor(corners.max(axis=0)).astype(int), 0, size - 1)
        if (high < low).any():
            continue
        basis = np.vstack([corners.T, np.ones(3)])
        if abs(np.linalg.det(basis)) < 1e-9:
            continue
        columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        share = np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size)], axis=1) @ np.linalg.inv(basis).T
        inside = (share >= -1e-6).all(axis=1)
        owner[rows.ravel()[inside], columns.ravel()[inside]] = index
        weights[rows.ravel()[inside], columns.ravel()[inside]] = share[inside]
    texel = np.flatnonzero(owner.ravel() >= 0)
    return Raster(texel, owner.ravel()[texel], weights.reshape(-1, 3)[texel])


@dataclass(frozen=True)
class Padding:
    """What each texel of a picture shows: itself where it is covered, else the nearest covered one."""

    rows: Int[np.ndarray, "s s"]
    columns: Int[np.ndarray, "s s"]
    far: Bool[np.ndarray, "s s"]
    """Texels so far from the islands that nothing is ever sampled there."""


def padding(raster: Raster, size: int) -> Padding:
    """The nearest covered texel of every texel."""
    covered = np.zeros(size * size, bool)
    covered[raster.texel] = True
    distance, (rows, columns) = ndimage.distance_transform_edt(~covered.reshape(size, size), return_indices=True)
    return Padding(rows, columns, distance > PADDING * OVERSAMPLING)


def assembled(
    raster: Raster, colours: Float[np.ndarray, "n 3"], size: int, around: Padding | None = None
) -> UInt8[np.ndarray, "s s 3"]:
    """The picture (RGB), padded by the nearest covered texel around each island and reduced by OVERSAMPLING.

    `around` spares finding those texels again for a second picture of the same raster.
    """
    around = around or padding(raster, size)
    picture = np.zeros((size * size, 3))
    picture[raster.texel] = colours
    filled = picture.reshape(size, size, 3)[around.rows, around.columns]
    # One flat colour where nothing is sampled keeps the file small.
    filled[around.far] = np.median(colours, axis=0)
    small = cv2.resize(filled, (size // OVERSAMPLING,) * 2, interpolation=cv2.INTER_AREA)
    return np.rint(small).astype(np.uint8)


def encoded_png(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """PNG bytes of an RGB picture at the strongest compression."""
    done, data = cv2.imencode(".png", picture[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise RuntimeError("OpenCV could not encode the texture as PNG")
    return data.tobytes()
