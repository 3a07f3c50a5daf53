"""The border at the neck: where MakeHuman's body was cut off, brought down to an even line.

Only the vertices of the border move, straight down, so that no triangle turns over and everything above stays.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linprog

BELOW_CHIN_MM = 15.0
"""From there down an open edge is the neck's, not that of an eye or of the mouth."""
WAVES = 2
"""Of the line around the neck: front, back and shoulders may be at heights of their own."""


def even_border(
    neutral: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"], chin: float
) -> Float[np.ndarray, "v 3"]:
    """The head (millimetres, y down) with the border of its neck on the lowest even line that is nowhere above it.

    `chin` is the chin's height, y. The line is a Fourier series of the way around, symmetric as the head is.
    """
    border = neck_border(neutral, triangles, chin)
    points = neutral[border]
    x, z = points[:, 0], points[:, 2] - points[:, 2].mean()
    waves = np.cos(np.arange(WAVES + 1) * np.arctan2(x / np.ptp(x), -z / np.ptp(z))[:, None])
    best = linprog(waves.sum(axis=0), A_ub=-waves, b_ub=-points[:, 1], bounds=(None, None))
    even = neutral.copy()
    even[border, 1] = waves @ best.x
    return even


def neck_border(
    neutral: Float[np.ndarray, "v 3"], triangles: Int[np.ndarray, "t 3"], chin: float
) -> Int[np.ndarray, "b"]:
    """The vertices of the open edge below the chin."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    single, count = np.unique(edges, axis=0, return_counts=True)
    open_edge = np.unique(single[count == 1])
    return open_edge[neutral[open_edge, 1] > chin + BELOW_CHIN_MM]
