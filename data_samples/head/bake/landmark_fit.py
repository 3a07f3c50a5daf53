"""Fit points on the head's surface to 2D detections in many pictures of known geometry.

No ray casting: a candidate point is scored by the mean of min(reprojection error / eye distance, 0.25) over all
pictures, which survives occlusion and false detections. Mirror symmetry is built in: the score of (landmark, point) is
added to that of (mirror landmark, mirror point), and midline landmarks stay on the midline.
"""

from dataclasses import dataclass, field

import numpy as np
from crop import Crop
from jaxtyping import Float, Int
from landmarks import MIRROR, Embedding
from render import View
from scipy import sparse

CAP = 0.25
GRID = 6
MIDLINE_MM = 0.05
CONTOUR_YAW = np.arange(-40.0, 41.0, 10.0)
CONTOUR_HALF_WIDTH = 7.0


@dataclass(frozen=True)
class Sighting:
    """One rendered head with the points a detector found on it."""

    vertices: Float[np.ndarray, "v 3"]
    camera: View
    yaw: float
    pitch: float
    detected: Float[np.ndarray, "68 2"]

    @property
    def eye_distance(self) -> float:
        """Unforeshortened distance between the eye centres in pixels, the unit of all errors."""
        return self.camera.focal * 63.0 / self.camera.translation[2]


@dataclass(frozen=True)
class Mesh:
    """What the fit needs to know of the head besides the pictures."""

    crop: Crop
    neutral: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "t 3"]
    _memo: dict = field(default_factory=dict)

    def candidates(self, landmark: int) -> Int[np.ndarray, "k"]:
        """Vertices where a landmark may lie: lids at their seam, inner lips near theirs, jaw line below the hair."""
        crop, neutral = self.crop, self.neutral
        outer = np.flatnonzero(crop.outer)
        if landmark < 17:
            return outer[(neutral[outer, 1] > -44) & (neutral[outer, 2] < 120)]
        if landmark < 36:
            return outer[neutral[outer, 2] < 65]
        if landmark < 48:
            return np.intersect1d(self._grown(np.union1d(crop.lid_seam_left, crop.lid_seam_right), 1), outer)
        if landmark < 60:
            return np.intersect1d(self._grown(np.flatnonzero(crop.lip_mask > 0.15), 2), outer)
        return np.intersect1d(self._grown(crop.lip_seam, 2), outer)

    def triangles_at(self, vertex: int) -> Int[np.ndarray, "k 3"]:
        """Skin triangles whose corners are the vertex and its neighbours."""
        near = np.isin(self.triangles, self._grown(np.array([vertex]), 1)).all(axis=1)
        return self.triangles[near & self.crop.outer[self.triangles].all(axis=1)]

    def _grown(self, vertices: np.ndarray, rings: int) -> np.ndarray:
        if "edges" not in self._memo:
            pairs = self.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
            graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(self.neutral),) * 2).tocsr()
            self._memo["edges"] = graph + graph.T
        member = np.zeros(len(self.neutral), bool)
        member[vertices] = True
        for _ in range(rings):
            member |= (self._memo["edges"] @ member) > 0
        return np.flatnonzero(member)


def errors(points: Float[np.ndarray, "n k 3"], sightings: list[Sighting], landmark: int) -> Float[np.ndarray, "n k"]:
    """Reprojection error over eye distance of candidate points (n pictures, k candidates) for one landmark."""
    pixels = np.stack([s.camera.project(p) for s, p in zip(sightings, points, strict=True)])
    target = np.stack([s.detected[landmark] for s in sightings])[:, None]
    scale = np.array([s.eye_distance for s in sightings])[:, None]
    return np.linalg.norm(pixels - target, axis=-1) / scale


def fit_pair(
    mesh: Mesh, landmark: int, seen: list[Sighting], other: int, seen_other: list[Sighting], midline: bool
) -> tuple[Int[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Best triangle and weights for `landmark` in `seen`, jointly with its mirror image `other` in `seen_other`."""

    def score(vertex_ids: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Total cost of the points weights @ vertices[vertex_ids]; vertex_ids (k, m), weights (k, m)."""
        total = np.zeros(len(vertex_ids))
        for ids, sightings, name in ((vertex_ids, seen, landmark), (mesh.crop.mirror[vertex_ids], seen_other, other)):
            points = np.stack([np.einsum("km,kmd->kd", weights, s.vertices[ids]) for s in sightings])
            total += np.minimum(errors(points, sightings, name), CAP).mean(axis=0)
        return total

    vertices = mesh.candidates(landmark)
    if midline:
        vertices = vertices[np.abs(mesh.neutral[vertices, 0]) < MIDLINE_MM]
    best = vertices[score(vertices[:, None], np.ones((len(vertices), 1))).argmin()]
    triangles = mesh.triangles_at(best)
    steps = [(i, j, GRID - i - j) for i in range(GRID + 1) for j in range(GRID + 1 - i)]
    ids = np.repeat(triangles, len(steps), axis=0)
    weights = np.tile(np.array(steps) / GRID, (len(triangles), 1))
    if midline:
        on_axis = np.abs(np.einsum("km,km->k", weights, mesh.neutral[ids, 0])) < MIDLINE_MM
        ids, weights = ids[on_axis], weights[on_axis]
    chosen = score(ids, weights).argmin()
    return ids[chosen], weights[chosen]


def fit_embedding(mesh: Mesh, sightings: list[Sighting]) -> Embedding:
    """All 68 points and the contour by yaw, in crop vertex ids, mirror symmetric."""
    inner = [s for s in sightings if abs(s.yaw) <= 30 and abs(s.pitch) <= 18]
    frontal = [s for s in sightings if abs(s.yaw) <= 12]
    vertices, weights = np.zeros((68, 3), int), np.zeros((68, 3))
    for landmark, other in enumerate(MIRROR):
        if landmark <= other:
            seen = frontal if landmark < 17 else inner
            vertices[landmark], weights[landmark] = fit_pair(
                mesh, landmark, seen, other, seen, midline=landmark == other
            )
    contour, contour_weights = np.zeros((len(CONTOUR_YAW), 17, 3), int), np.zeros((len(CONTOUR_YAW), 17, 3))
    for row, yaw in enumerate(CONTOUR_YAW):
        if yaw > 0:
            continue
        seen = [s for s in sightings if abs(s.yaw - yaw) <= CONTOUR_HALF_WIDTH]
        opposite = [s for s in sightings if abs(s.yaw + yaw) <= CONTOUR_HALF_WIDTH]
        for landmark in range(17 if yaw < 0 else 9):
            # Only in the frontal bin is the chin point its own mirror image.
            contour[row, landmark], contour_weights[row, landmark] = fit_pair(
                mesh, landmark, seen, 16 - landmark, opposite, midline=yaw == 0 and landmark == 8
            )
    return Embedding(vertices, weights, CONTOUR_YAW, contour, contour_weights).symmetrised(mesh.crop.mirror)


def embedded(embedding: Embedding, vertices: Float[np.ndarray, "v 3"], yaw: float | None) -> Float[np.ndarray, "68 3"]:
    """The 68 points on posed vertices; with a yaw, the jaw line comes from the nearest contour bin."""
    points = np.einsum("lk,lkd->ld", embedding.weights, vertices[embedding.vertices])
    if yaw is not None:
        row = np.abs(embedding.contour_yaw - yaw).argmin()
        contour = vertices[embedding.contour_vertices[row]]
        points[:17] = np.einsum("lk,lkd->ld", embedding.contour_weights[row], contour)
    return points
