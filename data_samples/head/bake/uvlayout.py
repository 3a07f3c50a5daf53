"""Repack the UV islands of the crop, so that one square picture spends its pixels where the face has its detail.

MakeHuman's atlas covers a whole body and gives the face a small strip lying on its side. Here the face island stands
upright (subject's left on the right of the picture) and is stretched where the mesh is dense; the others fill the space
below it.
"""

import numpy as np
from crop import PARTS, Crop
from jaxtyping import Float

EVENNESS = 0.35
"""Share of plain uniform scale in the stretch of the face island; the rest follows the density of the mesh."""

# Left, bottom, right, top; v is up.
BOXES = {
    "face": (0.004, 0.30, 0.996, 0.996),
    "mouth": (0.004, 0.155, 0.15, 0.29),
    "socketR": (0.004, 0.004, 0.07, 0.14),
    "socketL": (0.084, 0.004, 0.15, 0.14),
    "neck": (0.165, 0.004, 0.48, 0.06),
    "teethU": (0.165, 0.19, 0.48, 0.29),
    "teethL": (0.165, 0.075, 0.48, 0.175),
    "tongue": (0.495, 0.004, 0.565, 0.29),
    "eyeR front": (0.58, 0.09, 0.78, 0.29),
    "eyeL front": (0.796, 0.09, 0.996, 0.29),
    "eyeR back": (0.58, 0.004, 0.65, 0.074),
    "eyeL back": (0.926, 0.004, 0.996, 0.074),
}
LYING = ("face", "mouth", "socketR", "socketL")
"""Islands that MakeHuman's atlas shows with the crown to the left."""


def packed_uvs(crop: Crop, vertices: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "u 2"]:
    """New UV coordinates (v up) of the crop's UV points, each island in its own box."""
    packed = np.zeros_like(crop.uvs)
    for island in np.unique(crop.quad_island):
        quads = crop.quad_island == island
        name = _island_name(crop, quads, vertices)
        ids = np.unique(crop.uv_quads[quads])
        points = crop.uvs[ids]
        if name in LYING:
            points = np.stack([points[:, 1], 1 - points[:, 0]], axis=1)
        low, high = np.array(BOXES[name][:2]), np.array(BOXES[name][2:])
        evenness = EVENNESS if name == "face" else 1.0
        spread = np.stack([_spread(points[:, axis], evenness) for axis in (0, 1)], axis=1)
        packed[ids] = spread * (high - low) + low
    return packed


def _island_name(crop: Crop, quads: np.ndarray, vertices: np.ndarray) -> str:
    part = list(PARTS)[crop.quad_part[quads][0]]
    members = np.unique(crop.quads[quads])
    x, _, z = vertices[members].mean(axis=0)
    if part.startswith("eye"):
        return f"{part} {'front' if z < 0 else 'back'}"
    if part != "skin":
        return part
    if crop.mouth_cavity[members].any():
        return "mouth"
    if crop.eye_cavity[members].any():
        return "socketL" if x > 0 else "socketR"
    return "face" if z < 50 else "neck"


def _spread(values: np.ndarray, evenness: float) -> np.ndarray:
    """0..1: a mix of the plain position and the smoothed rank, so that crowded places become wide."""
    plain = (values - values.min()) / np.ptp(values)
    knots = np.linspace(0, 1, 33)
    rank = np.interp(knots, np.sort(plain), np.linspace(0, 1, len(plain)))
    rank = 0.5 * (rank + 1 - rank[::-1]) if evenness < 1 and np.abs(rank + rank[::-1] - 1).max() < 0.02 else rank
    return evenness * plain + (1 - evenness) * np.interp(plain, knots, rank)
