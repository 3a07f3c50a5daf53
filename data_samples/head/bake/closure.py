"""How far lips and lids are open, and the corrections that make them just close.

An opening is measured in columns across the mouth or the eye: the highest edge of the lower lip or lid minus the lowest
edge of the upper one, as seen from the front. Negative means overlap.
"""

from dataclasses import dataclass

import numpy as np
from crop import Crop
from jaxtyping import Float, Int

LIP_MARGIN_MM = 0.5
"""Overlap asked of the resting lips: the principal components keep the closed lips only roughly, and heads tilt."""
LIP_FRACTIONS = np.linspace(-0.75, 0.75, 13)
LID_MARGIN_MM = 0.15
LID_FRACTIONS = np.linspace(-0.7, 0.7, 15)
MOST_MOUTH_CLOSE = 0.12
CORNER_BASE_ID = 7203
"""base.obj vertex on the edge of the lower lip, just inside the left corner."""
CORNER_SEAL_MM, CORNER_RADIUS_MM = 0.8, 3.5
CORNER_DROP_MM = 12.2
"""How far jawOpen lowers the very corner of the mouth: less is upper lip, more is lower lip."""


@dataclass(frozen=True)
class Slit:
    """The two edge sets that face each other across an opening, and the rim that gives its width."""

    upper: Int[np.ndarray, "e 2"]
    lower: Int[np.ndarray, "f 2"]
    rim: Int[np.ndarray, "k"]

    def opening(self, vertices: Float[np.ndarray, "v 3"], fractions: Float[np.ndarray, "c"]) -> Float[np.ndarray, "c"]:
        """Gap (mm) at columns given as fractions -1..1 of the half width; columns without both edges are -inf."""
        x = vertices[self.rim, 0]
        columns = x.min() + (fractions + 1) / 2 * (x.max() - x.min())
        gap = -_highest(-_heights(vertices, self.lower, columns)) - _highest(_heights(vertices, self.upper, columns))
        return np.where(np.isfinite(gap), gap, -np.inf)

    def closing_weights(
        self, vertices: np.ndarray, displacement: np.ndarray, fractions: np.ndarray, margin: float
    ) -> Float[np.ndarray, "c"]:
        """Per column, the smallest weight in 0..2 of `displacement` whose overlap reaches `margin` mm, else 2."""
        weights = np.linspace(0, 2, 21)
        gaps = np.stack([self.opening(vertices + weight * displacement, fractions) for weight in weights])
        closed = gaps <= -margin
        first = np.argmax(closed, axis=0)
        before = np.maximum(first - 1, 0)
        column = np.arange(len(fractions))
        high, low = gaps[before, column] + margin, gaps[first, column] + margin
        share = np.where(first > 0, high / np.where(high == low, 1.0, high - low), 0.0)
        return np.where(closed.any(axis=0), weights[before] + share * (weights[first] - weights[before]), 2.0)


def mouth_slit(crop: Crop, triangles: np.ndarray, vertices: np.ndarray, jaw_open: np.ndarray) -> Slit:
    """Lips and the front of the mouth cavity; what jawOpen carries down is the lower lip."""
    near = ((crop.lip_mask > 0.2) | crop.mouth_cavity) & (vertices[:, 2] < -10)
    drop = jaw_open[:, 1]
    edges = _edges(triangles)
    upper, lower = near & (drop < 8), near & (drop > 15)
    return Slit(edges[upper[edges].all(axis=1)], edges[lower[edges].all(axis=1)], crop.lip_seam)


def lid_slit(crop: Crop, triangles: np.ndarray, vertices: np.ndarray, seam: np.ndarray) -> Slit:
    """The lid rims and one ring of skin around them, split at the line through the corners of the eye."""
    edges = _edges(triangles)
    ring = np.union1d(seam, edges[np.isin(edges, seam).any(axis=1)])
    ring = ring[crop.outer[ring]]
    inner, outer = seam[vertices[seam, 0].argmin()], seam[vertices[seam, 0].argmax()]
    line = np.interp(vertices[:, 0], vertices[[inner, outer], 0], vertices[[inner, outer], 1])
    member = np.zeros(len(vertices), bool)
    member[ring] = True
    upper, lower = member & (vertices[:, 1] <= line), member & (vertices[:, 1] >= line)
    return Slit(edges[upper[edges].all(axis=1)], edges[lower[edges].all(axis=1)], seam)


def resting_mouth_close(slit: Slit, vertices: np.ndarray, mouth_close: np.ndarray) -> float:
    """The share of mouthClose that just closes the lips of one head, at most MOST_MOUTH_CLOSE."""
    weights = slit.closing_weights(vertices, mouth_close, LIP_FRACTIONS, LIP_MARGIN_MM)
    return float(min(weights.max(), MOST_MOUTH_CLOSE))


def corner_seal(crop: Crop, vertices: np.ndarray, jaw_open: np.ndarray) -> np.ndarray:
    """Displacement (v, 3) that presses the lips together beside the mouth corners, where mouthClose does nothing."""
    corner = vertices[np.searchsorted(crop.base_ids, CORNER_BASE_ID)]
    distance = np.linalg.norm(vertices * [1.0, 1.0, 0.6] - corner * [1.0, 1.0, 0.6], axis=1)
    side = np.clip((CORNER_DROP_MM - jaw_open[:, 1]) / 2, -1, 1)
    mouth = crop.is_part("skin") & ((crop.lip_mask > 0.05) | crop.mouth_cavity)
    seal = np.zeros_like(vertices)
    seal[:, 1] = CORNER_SEAL_MM * side * np.exp(-((distance / CORNER_RADIUS_MM) ** 2)) * mouth
    return seal + crop.mirrored(seal)


def levelled_blink(slit: Slit, vertices: np.ndarray, blink: np.ndarray) -> np.ndarray:
    """The blink rescaled column by column, so that at weight 1 the whole slit of this head closes at once.

    The raw unit closes the outer third of the slit at weight 0.7 and the inner third only at 0.9.
    """
    weights = slit.closing_weights(vertices, blink, LID_FRACTIONS, LID_MARGIN_MM)
    x = vertices[slit.rim, 0]
    centre, half = (x.min() + x.max()) / 2, (x.max() - x.min()) / 2
    quadratic = np.polynomial.Polynomial.fit(LID_FRACTIONS, weights, 2)
    factor = quadratic(np.clip((vertices[:, 0] - centre) / half, LID_FRACTIONS[0], LID_FRACTIONS[-1]))
    return blink * factor[:, None]


def blink_scale(slit: Slit, vertices: np.ndarray, blink: np.ndarray) -> float:
    """The weight of `blink` at which the last column of the slit of one head closes."""
    return float(slit.closing_weights(vertices, blink, LID_FRACTIONS, LID_MARGIN_MM).max())


def _edges(triangles: np.ndarray) -> np.ndarray:
    return np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)


def _heights(vertices: np.ndarray, edges: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """y of every edge at every column, nan where it does not reach, (c, e)."""
    start, end = vertices[edges[:, 0]], vertices[edges[:, 1]]
    run = end[:, 0] - start[:, 0]
    share = (columns[:, None] - start[:, 0]) / np.where(np.abs(run) < 1e-9, np.inf, run)
    inside = (share >= 0) & (share <= 1) & (np.abs(run) >= 1e-9)
    return np.where(inside, start[:, 1] + share * (end[:, 1] - start[:, 1]), np.nan)


def _highest(values: np.ndarray) -> np.ndarray:
    return np.where(np.isnan(values), -np.inf, values).max(axis=1)
