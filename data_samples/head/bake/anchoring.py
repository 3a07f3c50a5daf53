"""Tie the vertices of eyes, teeth, lashes, brows and hair to vertices of the head.

Vertex = Σ_j weight_j · head[anchor_j] + offset, weights summing to 1. MakeHuman's own ties are of that form, but some
are to helpers that the head lacks or that stand still where they should not, and offsets do not turn with a jaw. So
each kind gets ties of its own that give the same shape at rest.
"""

from dataclasses import dataclass

import numpy as np
from clothes import Clothes
from crop import Crop
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.spatial import cKDTree

FRAME_POINTS = 8
"""Vertices that tell how a rigid piece, an eyeball or a row of teeth, has moved."""
NEAREST = 4
"""Vertices of the skin that a strand of hair is tied to where MakeHuman's helper is missing."""

LID_RINGS = 2


@dataclass(frozen=True)
class Ties:
    """Anchors are vertices of the head; what ties leave over at rest is in `offsets`, millimetres."""

    anchors: Int[np.ndarray, "n k"]
    weights: Float[np.ndarray, "n k"]

    def offsets(self, points: Float[np.ndarray, "n 3"], head: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "n 3"]:
        """What the ties leave over of the vertices' places at rest."""
        return points - np.einsum("nj,njd->nd", self.weights, head[self.anchors])


def rigid_ties(points: Float[np.ndarray, "n 3"], head: Float[np.ndarray, "v 3"], members: Int[np.ndarray, "m"]) -> Ties:
    """Ties by which a piece moves as its members do: turned, shifted and scaled along with them.

    A few far-apart members are taken, and of all weights that reach a point the smallest.
    """
    chosen = members[_far_apart(head[members], FRAME_POINTS)]
    weights = np.linalg.pinv(_homogeneous(head[chosen]).T) @ _homogeneous(points).T
    return Ties(np.tile(chosen, (len(points), 1)), weights.T)


def lid_edges(crop: Crop, head: Float[np.ndarray, "v 3"], seam: Int[np.ndarray, "r"]) -> list[Int[np.ndarray, "e"]]:
    """Front edges of the upper and the lower lid, from the inner to the outer corner or back (by x).

    The seam is the inner edge; lids are two rings of vertices thick.
    """
    edges = np.concatenate([crop.quads[:, [k, (k + 1) % 4]] for k in range(4)])
    edges = np.concatenate([edges, edges[:, ::-1]])
    inner, ring = seam, seam
    for _ in range(LID_RINGS):
        reached = np.unique(edges[np.isin(edges[:, 0], ring), 1])
        inner, ring = np.union1d(inner, ring), reached[crop.outer[reached] & ~np.isin(reached, np.union1d(inner, ring))]
    order = ring[np.argsort(head[ring, 0])]
    line = np.interp(head[order, 0], head[order[[0, -1]], 0], head[order[[0, -1]], 1])
    corners = np.zeros(len(order), bool)
    corners[[0, -1]] = True
    return [order[corners | (head[order, 1] < line)], order[corners | (head[order, 1] > line)]]


def lid_ties(
    points: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "t 3"],
    head: Float[np.ndarray, "v 3"],
    lids: list[Int[np.ndarray, "e"]],
    eyeball: Int[np.ndarray, "m"],
) -> tuple[Ties, Float[np.ndarray, "n 3"]]:
    """Ties of the lashes of one eye, and their vertices, shifted so that each strip is rooted at its lid's front edge.

    Lashes stand away from the eyeball's centre, so they turn around it as their lid does.
    """
    centre = rigid_ties(head[eyeball].mean(axis=0)[None], head, eyeball)
    middle = (centre.weights @ head[centre.anchors[0]])[0]
    anchors = np.zeros((len(points), 2 + FRAME_POINTS), int)
    weights, moved = np.zeros(anchors.shape), points.copy()
    for strip in _pieces(triangles, len(points)):
        distance = [np.median(cKDTree(head[lid]).query(points[strip])[0]) for lid in lids]
        lid = lids[int(np.argmin(distance))]
        place = np.interp(points[strip, 0], head[lid, 0], np.arange(len(lid)))
        first = np.minimum(place.astype(int), len(lid) - 2)
        share = np.stack([first + 1 - place, place - first], axis=1)
        edge = lid[first[:, None] + [0, 1]]
        root = np.einsum("nj,njd->nd", share, head[edge])
        roots = np.argsort(np.linalg.norm(points[strip] - middle, axis=1))[: len(strip) // 4]
        moved[strip] = points[strip] + np.median((root - points[strip])[roots], axis=0)
        outwards = root - middle
        length = np.einsum("nd,nd->n", moved[strip] - root, outwards) / np.einsum("nd,nd->n", outwards, outwards)
        anchors[strip] = np.hstack([edge, np.tile(centre.anchors, (len(strip), 1))])
        weights[strip] = np.hstack([share * (1 + length[:, None]), -length[:, None] * centre.weights])
    return Ties(anchors, weights), moved


def own_ties(clothes: Clothes, crop: Crop) -> Ties:
    """MakeHuman's ties, of a piece whose anchors the head has."""
    return Ties(np.searchsorted(crop.base_ids, clothes.anchors), clothes.weights)


def nearest_ties(
    points: Float[np.ndarray, "n 3"], head: Float[np.ndarray, "v 3"], allowed: Bool[np.ndarray, "v"]
) -> Ties:
    """Ties to the nearest allowed vertices, the nearer the stronger."""
    members = np.flatnonzero(allowed)
    distance, nearest = cKDTree(head[members]).query(points, k=NEAREST)
    weights = 1.0 / np.maximum(distance, 1.0)
    return Ties(members[nearest], weights / weights.sum(axis=1, keepdims=True))


def stacked(parts: list[tuple[Bool[np.ndarray, "n"], Ties]], count: int) -> Ties:
    """The ties of a mesh from those of its pieces, each given with the vertices that it is for."""
    width = max(ties.anchors.shape[1] for _, ties in parts)
    anchors, weights = np.zeros((count, width), int), np.zeros((count, width))
    for rows, ties in parts:
        anchors[rows, : ties.anchors.shape[1]] = ties.anchors
        weights[rows, : ties.anchors.shape[1]] = ties.weights
    return Ties(anchors, weights)


def _homogeneous(points: np.ndarray) -> np.ndarray:
    """(x, y, z, 1); millimetres are brought to the order of 1, so that the sum of the weights is met as well."""
    return np.hstack([points, np.full((len(points), 1), 30.0)])


def _far_apart(points: np.ndarray, count: int) -> np.ndarray:
    """Indices of points, each the farthest from those before it."""
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    distance = np.linalg.norm(points - points[chosen[0]], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def _pieces(triangles: np.ndarray, count: int) -> list[np.ndarray]:
    """Vertices of each connected piece that has triangles."""
    edges = triangles[:, [0, 1, 1, 2]].reshape(-1, 2)
    graph = sparse.coo_matrix((np.ones(len(edges)), edges.T), shape=(count, count))
    label = sparse.csgraph.connected_components(graph, directed=False)[1]
    return [np.flatnonzero(label == piece) for piece in np.unique(label[triangles])]
