"""Procedural paint: a colour for every point of the neutral surface.

One function serves the texture (evaluated at every texel) and the vertex colours (evaluated at every vertex).
Positions are in the head frame (x subject's left, y down, z away) divided by `Sitter.scale`, so the paint is
anatomical, independent of the UVs and, because only |x| is used, mirror symmetric.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from noise import noise
from paint_inside import paint_eyeball, paint_teeth
from scipy.spatial import KDTree

SKIN = np.array([208.0, 163.0, 138.0])
FLUSH = np.array([200.0, 122.0, 104.0])
SHADE = np.array([168.0, 117.0, 98.0])
LIP = np.array([178.0, 104.0, 95.0])
HAIR = np.array([52.0, 39.0, 31.0])
LASH = np.array([46.0, 33.0, 29.0])
MOUTH = np.array([92.0, 32.0, 32.0])
TONGUE = np.array([184.0, 98.0, 96.0])

SKIN_REGION, EYE_REGION, UPPER_TEETH, LOWER_TEETH, TONGUE_REGION, MOUTH_REGION, SOCKET_REGION = range(7)


@dataclass(frozen=True)
class Surface:
    """Points to paint."""

    points: Float[np.ndarray, "n 3"]
    region: Int[np.ndarray, "n"]
    """One of the *_REGION / *_TEETH codes."""
    lip: Float[np.ndarray, "n"]
    """Lip coverage 0..1."""
    detail: float
    """1 for a texture; 0 for vertex colours, which are too coarse for strokes and pores."""


@dataclass(frozen=True)
class Sitter:
    """The places on one mirror-symmetric head that the paint refers to, mm in the head frame."""

    scale: float
    """Size of this head relative to MakeHuman's average; all measures of the paint are for that average."""
    eye_pole: Float[np.ndarray, "3"]
    """Front pole of the left eyeball."""
    upper_lid: Float[np.ndarray, "a 3"]
    lower_lid: Float[np.ndarray, "b 3"]
    """Rims of the left eye, densely sampled."""
    lip_seam: Float[np.ndarray, "c 3"]


def paint(surface: Surface, sitter: Sitter) -> Float[np.ndarray, "n 3"]:
    """RGB 0..255 of every point."""
    points = surface.points / sitter.scale
    points[:, 0] = np.abs(points[:, 0])
    region, detail = surface.region, surface.detail
    colour = np.zeros((len(points), 3))
    where = region == SKIN_REGION
    colour[where] = _skin(points[where], surface.lip[where], sitter, detail)
    where = region == EYE_REGION
    colour[where] = paint_eyeball(points[where], sitter.eye_pole / sitter.scale, detail)
    for code in (UPPER_TEETH, LOWER_TEETH):
        where = region == code
        colour[where] = paint_teeth(points[where], upper=code == UPPER_TEETH, detail=detail)
    where = region == TONGUE_REGION
    furrow = np.exp(-((points[where, 0] / 1.2) ** 2)) * 0.12
    colour[where] = mixed(np.tile(TONGUE, (where.sum(), 1)), MOUTH, furrow)
    depth = np.clip((points[region == MOUTH_REGION, 2] + 25) / 50, 0, 1)
    colour[region == MOUTH_REGION] = mixed(np.tile(MOUTH, (len(depth), 1)), 0.45 * MOUTH, depth)
    colour[region == SOCKET_REGION] = 0.5 * (SHADE + FLUSH)
    return np.clip(colour, 0, 255)


def mixed(under: np.ndarray, over: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """`over` laid on `under` with the given coverage 0..1."""
    return under + coverage[:, None] * (over - under)


def brow_coverage(points: Float[np.ndarray, "n 3"], detail: float) -> Float[np.ndarray, "n"]:
    """Brow hair 9-47 mm from the midline, in the frame of the average head with x >= 0; strokes fan outwards."""
    x, y = points[:, 0], -points[:, 1]
    centre = np.interp(x, [6, 12, 20, 30, 38, 47], [14.5, 15.5, 18, 20, 19.3, 14.5])
    half = np.interp(x, [6, 12, 25, 38, 48], [2.6, 3.4, 3.3, 2.3, 0.8])
    across = (y - centre) / half
    ends = smooth((x - 7.5) / 5) * smooth((48.5 - x) / 6)
    body = smooth(1.55 - np.abs(across)) * ends * (points[:, 2] < 5)
    # Hairs stand up at the inner end and lie along the arc at the outer end: shear the stroke coordinate accordingly.
    lean = np.interp(x, [8, 16, 30, 45], [0.25, 0.8, 1.6, 2.4])
    root = x - lean * (y - centre)
    strokes = noise(np.stack([root / 0.75, (y - centre) / 4.0], axis=1), 1)
    fine = noise(np.stack([root / 0.35, (y - centre) / 2.5], axis=1), 2)
    hairs = smooth(body * 1.9 - 1.7 * (0.6 * strokes + 0.4 * fine))
    return (1 - detail) * 0.8 * body + detail * (0.3 * body + 0.58 * hairs)


def scalp_coverage(points: Float[np.ndarray, "n 3"], detail: float) -> Float[np.ndarray, "n"]:
    """Short hair above a line over the forehead, around the ears and down to the nape, with a ragged edge."""
    x, y, depth = points[:, 0], -points[:, 1], -points[:, 2]
    line = np.interp(depth, [-140, -95, -60, -25, 0, 20], [-60, -45, 5, 42, 56, 62])
    strand = np.stack([x, depth, y], axis=1)
    ragged = 5 * noise(strand / [1.0, 3.0, 3.0], 3) + 5 * noise(strand / [9.0, 14.0, 14.0], 8) - 5
    return smooth((y - line + ragged * detail) / 11) * ((y > 30) | (x < 75))


def smooth(value: np.ndarray) -> np.ndarray:
    """Smooth step from 0 at 0 to 1 at 1."""
    value = np.clip(value, 0, 1)
    return value * value * (3 - 2 * value)


def _skin(points: np.ndarray, lip: np.ndarray, sitter: Sitter, detail: float) -> np.ndarray:
    """Skin tone, flush, lips, lids, brows and hair, in that order; points in the frame of the average head."""
    x, y, z = points.T

    def spot(centre: tuple[float, float, float], radius: float) -> np.ndarray:
        squared = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + (z - centre[2]) ** 2
        return np.exp(-squared / radius**2)

    flush = 0.38 * spot((38, 35, -15), 19) + 0.34 * spot((0, 36, -40), 13) + 0.2 * spot((0, 98, -15), 16)
    flush += 0.4 * smooth((x - 70) / 8)
    mottle = noise(points / 9.0, 4) - 0.5
    colour = mixed(np.tile(SKIN, (len(points), 1)), FLUSH, np.clip(flush + 0.12 * mottle * detail, 0, 1))
    tone = 7 * mottle + 5 * (noise(points / 2.6, 5) - 0.5)
    colour = colour + detail * tone[:, None]
    lids = KDTree(np.vstack([sitter.upper_lid, sitter.lower_lid]) / sitter.scale)
    rim, _ = lids.query(points)
    colour = mixed(colour, SHADE, 0.45 * np.exp(-((rim / 7.0) ** 2)))
    colour = mixed(colour, FLUSH, 0.5 * np.exp(-((rim / 1.3) ** 2)))

    creases = 1 - 0.08 * detail * noise(np.stack([x / 0.8, y / 4], axis=1), 6)
    lips = LIP * creases[:, None]
    seam, _ = KDTree(sitter.lip_seam / sitter.scale).query(points)
    lips = mixed(lips, MOUTH, 0.85 * np.exp(-((seam / 3.2) ** 2)))
    colour = mixed(colour, lips, smooth((lip - 0.15) / 0.6))
    colour = mixed(colour, 0.8 * SHADE, 0.75 * spot((21.7, 67.2, -21.5), 2.8))

    upper, _ = KDTree(sitter.upper_lid / sitter.scale).query(points)
    colour = mixed(colour, LASH, 0.85 * smooth(1.5 - upper / 1.0))
    lower, _ = KDTree(sitter.lower_lid / sitter.scale).query(points)
    colour = mixed(colour, LASH, 0.4 * smooth(1.4 - lower / 0.7) * (upper > lower))

    colour = mixed(colour, HAIR, brow_coverage(points, detail))
    strands = noise(np.stack([x / 0.9, y / 5, z / 5], axis=1), 7) - 0.5
    hair = HAIR * (1 + 0.4 * detail * strands)[:, None]
    return mixed(colour, hair, 0.93 * scalp_coverage(points, detail))
