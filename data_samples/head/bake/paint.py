"""Procedural paint: a colour for every point of the neutral surface.

One function serves the texture (evaluated at every texel) and the vertex colours (evaluated at every vertex). Positions are
millimetres in the head frame (x subject's left, y down, z away), so the paint is anatomical and independent of the UVs.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

SKIN = np.array([205.0, 160.0, 135.0])
LIP = np.array([168.0, 89.0, 80.0])
HAIR = np.array([50.0, 38.0, 30.0])
MOUTH = np.array([92.0, 32.0, 32.0])
SCLERA = np.array([236.0, 233.0, 229.0])
GUM = np.array([176.0, 92.0, 92.0])
TOOTH = np.array([228.0, 221.0, 205.0])
TONGUE = np.array([178.0, 92.0, 92.0])


@dataclass(frozen=True)
class Surface:
    """Points to paint."""

    points: Float[np.ndarray, "n 3"]
    region: Int[np.ndarray, "n"]
    """0 skin, 1 eyeball, 2 upper teeth, 3 lower teeth, 4 tongue, 5 mouth cavity, 6 eye socket."""
    lip: Float[np.ndarray, "n"]
    """Lip coverage 0..1."""


def brow_coverage(points: Float[np.ndarray, "n 3"], scale: float) -> Float[np.ndarray, "n"]:
    """Soft brow arc 9-47 mm from the midline (of a head with 57.8 mm between the eyes; `scale` adapts it)."""
    x, y = np.abs(points[:, 0]) / scale, -points[:, 1] / scale
    centre = np.interp(x, [6, 12, 20, 30, 38, 47], [14.5, 15.5, 18, 20, 19.3, 14.5])
    half = np.interp(x, [6, 12, 25, 38, 47], [2.2, 3.2, 3.2, 2.2, 1.0])
    ends = np.clip((x - 9) / 4, 0, 1) * np.clip((47.5 - x) / 4, 0, 1)
    return np.clip(1.6 - np.abs(y - centre) / half, 0, 1) * ends * (points[:, 2] < 0)


def scalp_coverage(points: Float[np.ndarray, "n 3"], scale: float) -> Float[np.ndarray, "n"]:
    """Hair above a line that runs over the forehead, around the ears and down to the nape."""
    y, depth = -points[:, 1] / scale, -points[:, 2] / scale
    line = np.interp(depth, [-140, -95, -60, -25, 0, 20], [-60, -45, 5, 42, 56, 62])
    return np.clip((y - line) / 8, 0, 1) * ((y > 30) | (np.abs(points[:, 0]) < 75 * scale))


def paint(surface: Surface, eyes: Float[np.ndarray, "2 3"], scale: float) -> Float[np.ndarray, "n 3"]:
    """RGB 0..255 of every point; `eyes` are the eyeball centres, left first."""
    points, region = surface.points, surface.region
    skin = _blend(np.tile(SKIN, (len(points), 1)), LIP, surface.lip)
    skin = _blend(skin, HAIR, 0.8 * brow_coverage(points, scale))
    skin = _blend(skin, HAIR, scalp_coverage(points, scale))
    colour = np.where((region == 0)[:, None], skin, 0.0)
    colour[region == 1] = _eyeball(points[region == 1], eyes)
    colour[(region == 2) | (region == 3)] = TOOTH
    colour[region == 4] = TONGUE
    colour[region == 5] = MOUTH
    colour[region == 6] = 0.75 * SKIN
    return np.clip(colour, 0, 255)


def _blend(under: np.ndarray, over: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    return under + coverage[:, None] * (over - under)


def _eyeball(points: np.ndarray, eyes: np.ndarray) -> np.ndarray:
    offset = points - eyes[np.where(points[:, 0] > 0, 0, 1)]
    radius = np.where(offset[:, 2] < 0, np.hypot(offset[:, 0], offset[:, 1]), np.inf)
    colour = np.tile(SCLERA, (len(points), 1))
    colour[radius < 6.4] = (80, 60, 40)
    colour[radius < 2.5] = (12, 10, 10)
    return colour
