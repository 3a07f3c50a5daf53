"""The ridge beside a full smile: MakeHuman's unit pushes a few vertices beside the mouth's corner out of the cheek.

They are laid between their neighbours where no landmark is: all 68 points, the jaw's contour at every yaw and the dense
points stay where the unit has them, so that a fit to any of these has the same numbers as before.
"""

import numpy as np
from crop import REGIONS
from jaxtyping import Bool, Float, Int
from landmarks import Embedding
from scipy.sparse import coo_matrix, csr_array, diags_array
from scipy.sparse.linalg import spsolve

from workbench.landmarks.schemes import DENSE_POINTS

CENTRE_MM, RADIUS_MM = (39.0, 69.0, -13.0), 26.0
"""Where the ridge is on the left side of the mean head."""
KEEP = 0.02
"""Weight of the unit's own offsets against smooth ones in the middle; it grows to 1 at the radius."""


def softened_smile(
    smile: Float[np.ndarray, "v 3"],
    neutral: Float[np.ndarray, "v 3"],
    triangles: Int[np.ndarray, "t 3"],
    regions: Int[np.ndarray, "v"],
    embedding: Embedding,
) -> Float[np.ndarray, "v 3"]:
    """The unit of the left side, smooth beside the mouth (millimetres).

    Least squares of the offsets' differences to their neighbours' means, and of their change.
    """
    away = np.linalg.norm(neutral - CENTRE_MM, axis=1) / RADIUS_MM
    free = (away < 1.0) & (regions == REGIONS.index("skin")) & ~_landmarks(embedding, len(neutral))
    smooth = _differences_to_neighbours(neutral, triangles)
    system = (smooth.T @ smooth).tocsr()
    own = diags_array(KEEP + away[free] ** 4)
    softened = smile.copy()
    softened[free] = spsolve(
        (system[free][:, free] + own).tocsc(), own @ smile[free] - system[free][:, ~free] @ smile[~free]
    )
    return softened


def _landmarks(embedding: Embedding, count: int) -> Bool[np.ndarray, "v"]:
    held = np.zeros(count, bool)
    for vertices in (embedding.vertices, embedding.contour_vertices, DENSE_POINTS.vertices):
        held[vertices.ravel()] = True
    return held


def _differences_to_neighbours(neutral: np.ndarray, triangles: np.ndarray) -> csr_array:
    """Each vertex minus the mean of its neighbours, near ones counting more: v × v."""
    count = len(neutral)
    edges = np.unique(np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    near = 1.0 / np.linalg.norm(neutral[edges[:, 0]] - neutral[edges[:, 1]], axis=1)
    both = np.concatenate([edges, edges[:, ::-1]])
    weights = csr_array(coo_matrix((np.concatenate([near, near]), both.T), shape=(count, count)))
    return diags_array(np.ones(count)) - diags_array(1.0 / weights.sum(axis=1)) @ weights
