"""The surface of a head where a camera straight in front of it sees it."""

import numpy as np
from jaxtyping import Float, Integer


def seen_from_front(
    places: Float[np.ndarray, "n 2"], head: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"]
) -> tuple[Integer[np.ndarray, "n 3"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Corners of the triangle that is seen at each place, their shares there, and the unit normal.

    `places` are x and y in the head frame, millimetres, as `head`. Raises `ValueError` where no triangle is.
    """
    a, b, c = (head[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    at_vertex = np.zeros_like(head)
    for k in range(3):
        np.add.at(at_vertex, triangles[:, k], normal)
    seen = np.flatnonzero(normal[:, 2] < 0)
    first, edges = a[seen, :2], np.stack([b - a, c - a], axis=2)[seen, :2]
    local = np.einsum("tij,ntj->nti", np.linalg.inv(edges), places[:, None] - first)
    share = np.concatenate([1 - local.sum(axis=2, keepdims=True), local], axis=2)
    depth = np.einsum("ntk,tk->nt", share, head[triangles[seen], 2])
    depth = np.where((share >= -1e-9).all(axis=2), depth, np.inf)
    if np.isinf(missed := depth.min(axis=1)).any():
        raise ValueError(f"there is no skin in front of (x, y) = {places[np.isinf(missed)][0].round(1)} mm")
    hit = np.argmin(depth, axis=1)
    corners, share = triangles[seen[hit]], share[np.arange(len(places)), hit]
    normals = np.einsum("nk,nkd->nd", share, at_vertex[corners])
    return corners, share, normals / np.linalg.norm(normals, axis=1, keepdims=True)
