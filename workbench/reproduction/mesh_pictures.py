"""Meshes over a picture, grey and lit from the camera: all programs' alike, with triangles or without."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import cKDTree

from workbench.pictures.mesh import corner_sum, vertex_normals

GREY, DARKEST = 225.0, 0.25
"""Brightness of a surface that faces the camera, and the share of it that one seen from the side keeps."""
SHARE = 0.9
"""Of the mesh over the picture."""
FINER = 2
"""Panels are drawn larger and reduced."""
NEIGHBOURS = 8
"""Points that a point's normal is taken from."""
BITS = 4


class Square(NamedTuple):
    """A part of a picture."""

    corner: Float[np.ndarray, "2"]
    side: float

    def inside(self, points: Float[np.ndarray, "n c"], pixels: int) -> Float[np.ndarray, "n c"]:
        """Points of the picture in a panel of so many pixels; depth grows alike."""
        scale, moved = pixels / self.side, points.astype(float)
        moved[:, :2] = (points[:, :2] + 0.5 - self.corner) * scale - 0.5
        moved[:, 2:] *= scale
        return moved


def square_around(points: Float[np.ndarray, "n 2"], margin: float, picture: UInt8[np.ndarray, "h w 3"]) -> Square:
    """The square around the middle of points, `margin` times as wide as their box; inside of the picture if it can."""
    low, high = points.min(axis=0), points.max(axis=0)
    side = margin * float((high - low).max())
    corner, room = (low + high) / 2.0 - side / 2.0, np.array(picture.shape[1::-1]) - side
    return Square(np.where(room > 0.0, np.clip(corner, 0.0, room), corner), side)


def photo_panel(picture: UInt8[np.ndarray, "h w 3"], square: Square, pixels: int) -> UInt8[np.ndarray, "s s 3"]:
    """The square of a picture; beyond its edge, the edge's colours go on."""
    scale = pixels / square.side
    place = square.inside(np.zeros((1, 2)), pixels)[0]
    matrix = np.array([[scale, 0.0, place[0]], [0.0, scale, place[1]]])
    return cv2.warpAffine(picture, matrix, (pixels, pixels), flags=cv2.INTER_AREA, borderMode=cv2.BORDER_REPLICATE)


def mesh_panel(
    picture: UInt8[np.ndarray, "h w 3"],
    square: Square,
    pixels: int,
    vertices: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "t 3"] | None,
) -> UInt8[np.ndarray, "s s 3"]:
    """The square with a mesh over it. `vertices` are in the picture (column, row, towards the camera)."""
    photo = photo_panel(picture, square, FINER * pixels)
    placed = square.inside(vertices, FINER * pixels)
    drawn = photo.copy()
    if triangles is None or len(triangles) == 0:
        _draw_points(drawn, placed)
    else:
        _draw_triangles(drawn, placed, triangles)
    mixed = cv2.addWeighted(drawn, SHARE, photo, 1.0 - SHARE, 0.0)
    return cv2.resize(mixed, (pixels, pixels), interpolation=cv2.INTER_AREA)


def _draw_triangles(canvas: UInt8[np.ndarray, "s s 3"], placed, triangles) -> None:
    """From back to front; both sides of a triangle look the same, as programs do not agree on which is outside."""
    normals = vertex_normals(placed, triangles, corner_sum(triangles, len(placed)))
    corners = placed[triangles]
    near = _near_canvas(corners[..., :2].min(axis=1), corners[..., :2].max(axis=1), len(canvas))
    order = np.flatnonzero(near)[np.argsort(corners[near, :, 2].mean(axis=1))]
    shades = _shades(normals[triangles[order]].mean(axis=1)[:, 2])
    polygons = np.rint(corners[order, :, :2] * (1 << BITS)).astype(np.int32)
    for polygon, shade in zip(polygons, shades, strict=True):
        cv2.fillConvexPoly(canvas, polygon, (shade,) * 3, cv2.LINE_8, BITS)


def _draw_points(canvas: UInt8[np.ndarray, "s s 3"], placed) -> None:
    """Discs as wide as the points are apart, lit by the plane through each one's neighbours."""
    distances, nearest = cKDTree(placed).query(placed, min(NEIGHBOURS, len(placed)))
    around = placed[nearest] - placed[nearest].mean(axis=1, keepdims=True)
    normals = np.linalg.eigh(np.einsum("nka,nkb->nab", around, around))[1][..., 0]
    radii = np.ceil(np.clip(distances[:, 1:].mean(axis=1), 1.0, len(canvas) / 50))
    near = _near_canvas(placed[:, :2], placed[:, :2], len(canvas))
    order = np.flatnonzero(near)[np.argsort(placed[near, 2])]
    places = np.rint(placed[order, :2]).astype(int).tolist()
    for place, radius, shade in zip(places, radii[order].astype(int).tolist(), _shades(normals[order, 2]), strict=True):
        cv2.circle(canvas, place, radius, (shade,) * 3, -1)


def _near_canvas(low: Float[np.ndarray, "n 2"], high: Float[np.ndarray, "n 2"], side: int) -> np.ndarray:
    """What meets the canvas; this also keeps far points out of OpenCV's integers."""
    return ((high > 0) & (low < side) & (low > -side) & (high < 2 * side)).all(axis=1)


def _shades(facing: Float[np.ndarray, "n"]) -> list[float]:
    return (GREY * (DARKEST + (1.0 - DARKEST) * np.abs(facing))).tolist()
