"""Move MakeHuman's brows up to where people's are: their middle line on landmarks 17 to 26.

As they come they lie about a centimetre lower, in the eye's socket.
"""

from collections.abc import Callable

import numpy as np
from anchoring import Ties
from clothes import Clothes
from jaxtyping import Float, Int
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicSpline
from texture import rasterise

from workbench.face.seen_from_front import seen_from_front

ABOVE_SKIN_MM = 0.8
"""Of the strands' cards: their triangles cut corners of the skin's."""
SOLID = 0.4
"""Opacity from which a texel is hair."""
COLUMN_MM = 1.0
"""Width of the columns of hair whose middles make the line."""
EDGES = (0.05, 0.95)
"""Quantiles of the hair in a column that count as its upper and its lower edge."""
CURVE = 3
"""Degree, along the brow, of the way up: it bends a brow and leaves its outline alone."""


def raised_brows(
    clothes: Clothes,
    points: Float[np.ndarray, "n 3"],
    alpha: Float[np.ndarray, "h h"],
    landmarks: Float[np.ndarray, "68 3"],
    head: Float[np.ndarray, "v 3"],
    skin: Int[np.ndarray, "t 3"],
) -> tuple[Ties, Float[np.ndarray, "n 3"]]:
    """Ties of a pair of brows to the triangles of skin that they lie before, and their vertices (millimetres) there.

    `points` are the vertices where MakeHuman has them, `alpha` the opacity of the texture.
    """
    raised = points.copy()
    for side, line in ((points[:, 0] < 0, landmarks[17:22]), (points[:, 0] > 0, landmarks[22:27])):
        columns, middle = middle_line(clothes, points, alpha, side)
        within = (columns > line[0, 0]) & (columns < line[-1, 0])
        columns, middle = columns[within], middle[within]
        way = Polynomial.fit(columns, curve_through(line)(columns) - middle, CURVE)
        raised[side, 1] += way(np.clip(points[side, 0], columns[0], columns[-1]))
    corners, share, normals = seen_from_front(raised[:, :2], head, skin)
    return Ties(corners, share), np.einsum("nk,nkd->nd", share, head[corners]) + ABOVE_SKIN_MM * normals


def middle_line(
    clothes: Clothes, points: Float[np.ndarray, "n 3"], alpha: Float[np.ndarray, "h h"], side: np.ndarray
) -> tuple[Float[np.ndarray, "c"], Float[np.ndarray, "c"]]:
    """The line midway between the upper and the lower edge of the hair of one brow: x and y."""
    own = side[clothes.triangles].all(axis=1)
    raster = rasterise(clothes.uvs, clothes.triangles_uv[own], len(alpha))
    hair = raster.gathered(points, clothes.triangles[own])[alpha.ravel()[raster.texel] >= SOLID]
    column = np.rint(hair[:, 0] / COLUMN_MM)
    columns = np.unique(column)
    edges = [np.quantile(hair[column == here, 1], EDGES) for here in columns]
    return columns * COLUMN_MM, np.mean(edges, axis=1)


def curve_through(line: Float[np.ndarray, "k 3"]) -> Callable[[np.ndarray], np.ndarray]:
    """y as a function of x, smooth, through points in the order of x, and level beyond the first and the last."""
    curve = CubicSpline(line[:, 0], line[:, 1])
    return lambda x: curve(np.clip(x, line[0, 0], line[-1, 0]))
