"""Take the photographed skins' own brows away: shaved, but with a shadow left that shows below the worn brows.

From above the worn brow to the upper lid, what is darker than a blend of the colours at both ends is brightened to it;
pores stay.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from brows import curve_through
from jaxtyping import Float, Int
from scipy import ndimage

CELL_MM, SOFT_MM = 0.5, 2.5
"""Of the grid that colours are averaged on, and its smoothing (standard deviation)."""
BROW, UPPER_LID = slice(22, 27), slice(42, 46)
"""Landmarks, left."""
ABOVE_BROW_MM, ABOVE_LID_MM = 6.0, 3.0
"""Of the band's upper end from the brow's line, and of its lower end from the lid's edge."""
INSIDE_MM, OUTSIDE_MM = (6.0, 15.0), (52.0, 64.0)
"""From the middle of the face: where the change sets in, and where it ends."""
TOWARDS_LID = 4.0
"""Exponent of the share of the colour below: lids are dark near their edge alone."""
MOST = 1.6
"""Largest factor of a colour."""


@dataclass(frozen=True)
class Band:
    """The texels of the skin between brows and lids."""

    texels: Int[np.ndarray, "n"]
    """Their numbers among those of the canvas."""
    places: Float[np.ndarray, "n 2"]
    """x and y on the neutral head, millimetres."""
    inside: Int[np.ndarray, "m"]
    """Entries that are changed; the others tell the colours around."""
    above: Float[np.ndarray, "m"]
    """y of the upper end of each one's column."""
    below: Float[np.ndarray, "m"]
    amount: Float[np.ndarray, "m"]


def brow_band(
    points: Float[np.ndarray, "n 3"], seen: Int[np.ndarray, "k"], landmarks: Float[np.ndarray, "68 3"]
) -> Band:
    """The band on texels at these points, of which `seen` are skin that faces the front."""
    brow, lid = curve_through(landmarks[BROW]), curve_through(landmarks[UPPER_LID])
    x, y = np.abs(points[seen, 0]), points[seen, 1]
    around = (x < OUTSIDE_MM[1] + SOFT_MM) & (np.abs(y - landmarks[24, 1]) < 2 * abs(landmarks[24, 1]))
    texels, x, y = seen[around], x[around], y[around]
    above, below = brow(x) - ABOVE_BROW_MM, lid(x) - ABOVE_LID_MM
    amount = _ramp(x, INSIDE_MM) * (1 - _ramp(x, OUTSIDE_MM))
    inside = np.flatnonzero((y > above) & (y < below) & (amount > 0))
    return Band(texels, points[texels, :2], inside, above[inside], below[inside], amount[inside])


def without_brows(colour: Float[np.ndarray, "n 3"], band: Band) -> Float[np.ndarray, "n 3"]:
    """The texels' colours (RGB), bare in the band."""
    low = band.places.min(axis=0)
    cells = ((band.places - low) / CELL_MM)[:, ::-1]
    size = tuple(np.ceil(cells.max(axis=0)).astype(int) + 1)
    total = np.zeros((*size, 4))
    np.add.at(total, tuple(np.rint(cells).astype(int).T), np.column_stack([colour[band.texels], np.ones(len(cells))]))
    spread = cv2.GaussianBlur(total, (0, 0), SOFT_MM / CELL_MM)
    smooth = spread[..., :3] / np.maximum(spread[..., 3:], 1e-6)

    def at(y: np.ndarray) -> np.ndarray:
        rows = (y - low[1]) / CELL_MM
        place = [rows, cells[band.inside, 1]]
        return np.stack(
            [ndimage.map_coordinates(c, place, order=1, mode="nearest") for c in smooth.T.swapaxes(1, 2)], 1
        )

    y = band.places[band.inside, 1]
    share = (((y - band.above) / (band.below - band.above)) ** TOWARDS_LID)[:, None]
    wanted = (1 - share) * at(band.above) + share * at(band.below)
    factor = np.clip(wanted / np.maximum(at(y), 1.0), 1.0, MOST)
    bare = colour.copy()
    bare[band.texels[band.inside]] *= 1 + band.amount[:, None] * (factor - 1)
    return bare


def _ramp(x: np.ndarray, ends: tuple[float, float]) -> np.ndarray:
    share = np.clip((x - ends[0]) / (ends[1] - ends[0]), 0, 1)
    return share * share * (3 - 2 * share)
