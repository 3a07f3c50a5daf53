"""Paint of eyeballs and teeth. Points are in the frame of the average head, mm, x >= 0."""

import numpy as np
from jaxtyping import Float
from noise import noise

SCLERA = np.array([236.0, 232.0, 227.0])
VEIN = np.array([214.0, 160.0, 150.0])
IRIS = np.array([98.0, 72.0, 48.0])
IRIS_RIM = np.array([38.0, 27.0, 20.0])
PUPIL = np.array([12.0, 10.0, 10.0])
IRIS_RADIUS_MM, PUPIL_RADIUS_MM = 5.9, 2.2

TOOTH = np.array([230.0, 222.0, 204.0])
GAP = np.array([120.0, 86.0, 72.0])
GUM = np.array([180.0, 98.0, 96.0])
# Widths along the arch from the midline outwards, mm.
UPPER_WIDTHS = (8.6, 6.8, 7.8, 7.0, 7.0, 10.0, 10.0)
LOWER_WIDTHS = (5.6, 6.0, 7.0, 7.0, 7.2, 10.5, 10.5)
ARCH_CENTRE_Z, ARCH_RADIUS = 12.0, 29.0
UPPER_GUM_Y, LOWER_GUM_Y = 54.6, 70.6
SCALLOP_MM = 1.8


def paint_eyeball(points: Float[np.ndarray, "n 3"], pole: Float[np.ndarray, "3"], detail: float) -> np.ndarray:
    """Sclera, iris with fibres and a dark limbal ring, pupil; `pole` is the front pole of the left eye."""
    offset = points - pole
    radius = np.hypot(offset[:, 0], offset[:, 1])
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    front = offset[:, 2] < 12
    colour = SCLERA + np.clip((radius - 7) / 9, 0, 1)[:, None] * 0.6 * (VEIN - SCLERA)
    fibres = noise(np.stack([angle * 9, radius / 3], axis=1), 11)
    share = np.clip((radius - PUPIL_RADIUS_MM) / (IRIS_RADIUS_MM - PUPIL_RADIUS_MM), 0, 1)
    iris = IRIS * (0.75 + detail * 0.5 * fibres + (1 - detail) * 0.25 + 0.15 * (1 - share))[:, None]
    iris = iris + (np.clip((share - 0.72) / 0.28, 0, 1) ** 2)[:, None] * (IRIS_RIM - iris)
    colour = colour + (front * _inside(radius, IRIS_RADIUS_MM, 0.35))[:, None] * (iris - colour)
    return colour + (front * _inside(radius, PUPIL_RADIUS_MM, 0.25))[:, None] * (PUPIL - colour)


def paint_teeth(points: Float[np.ndarray, "n 3"], upper: bool, detail: float) -> np.ndarray:
    """Teeth separated by soft dark lines along the arch, under a scalloped gum line."""
    along = ARCH_RADIUS * np.arctan2(points[:, 0], ARCH_CENTRE_Z - points[:, 2])
    edges = np.cumsum([0.0, *(UPPER_WIDTHS if upper else LOWER_WIDTHS)])
    index = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, len(edges) - 2)
    place = np.clip((along - edges[index]) / np.diff(edges)[index], 0, 1)
    to_gap = np.minimum(along - edges[index], edges[index + 1] - along)
    gap = detail * 0.75 * np.exp(-((to_gap / 0.35) ** 2))
    height = (UPPER_GUM_Y - points[:, 1]) if upper else (points[:, 1] - LOWER_GUM_Y)
    gum = 1 / (1 + np.exp(-(height + SCALLOP_MM * (4 * (place - 0.5) ** 2 - 0.5)) / 0.25))
    # Lights of a viewer do not know that the cheeks shade the back of the mouth.
    shading = 1 - 0.12 * detail * (2 * np.abs(place - 0.5)) ** 3 - 0.6 * np.clip((points[:, 2] + 12) / 24, 0, 1) ** 1.5
    tooth = TOOTH * shading[:, None]
    tooth = tooth + gap[:, None] * (GAP - tooth)
    return tooth + gum[:, None] * (GUM - tooth)


def _inside(radius: np.ndarray, limit: float, soft: float) -> np.ndarray:
    """1 inside a disc, 0 outside, with a soft edge of about `soft` mm."""
    return np.clip((limit - radius) / soft + 0.5, 0, 1)
