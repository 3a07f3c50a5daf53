"""Where people have their brows: lower than the head's landmarks, mostly, and more bent; the landmarks on them; and how
thick they are."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Integer, UInt8

from workbench.face.model import Embedding, FaceModel
from workbench.face.parts import Part
from workbench.face.seen_from_front import seen_from_front

BROW_STATIONS = (0.05, 0.27, 0.5, 0.73, 0.95)
"""Where the five landmarks of a brow are, of its length."""
BROW_HEIGHT = 0.3
"""How far below its upper edge they are, of its thickness there."""
SOLID = 100
"""Alpha from which a texel of a brow is hair."""
ABOVE_SKIN_MM = 0.8
"""Of the strands' cards: their triangles cut corners of the skin's."""
SKIN = ("skin", "brow", "scalp")
BROWS = slice(17, 27)
MOST_LOWER_MM, MOST_IN_ALL_MM = 10.0, 13.0
"""From there on brows would lie on the lids."""


@dataclass(frozen=True)
class BrowPlace:
    """By how much brows lie below the head's landmarks, millimetres, and how thick they are."""

    lower_mm: float = 0.0
    """From end to end."""
    outer_mm: float = 0.0
    """More of it at the outer ends; from the inner end outwards it grows with the square."""
    thickness: float = 1.0
    """Of worn brows, as a multiple of their style's."""

    def of(self, x: Float[np.ndarray, "n"], line: Float[np.ndarray, "10 3"]) -> Float[np.ndarray, "n"]:
        """How much lower brows lie at these places of the head frame; `line`: the head's landmarks of both brows."""
        outer, inner = np.abs(line[[0, -1], 0]).mean(), np.abs(line[[4, 5], 0]).mean()
        outwards = np.clip((np.abs(x) - inner) / (outer - inner), 0.0, 1.2)
        return np.clip(self.lower_mm + self.outer_mm * outwards**2, -3.0, MOST_IN_ALL_MM)


USUAL = BrowPlace(3.0, 4.0)
"""Where a brow would be that cannot be seen."""


def random_brow_place(rng: np.random.Generator) -> BrowPlace:
    """Of a random person."""
    lower = np.clip(rng.normal(USUAL.lower_mm, 4.0), -3.0, MOST_LOWER_MM)
    outer = np.clip(rng.normal(USUAL.outer_mm, 3.0), -2.0, MOST_LOWER_MM)
    return BrowPlace(float(lower), float(outer), float(np.exp(rng.uniform(np.log(0.8), np.log(1.8)))))


def brow_landmarks(model: FaceModel, place: BrowPlace) -> Embedding:
    """Landmarks 17 to 26 on the skin, where brows at this place have them."""
    line = model.landmarks.of(model.neutral)[BROWS]
    lowered = line[:, :2] + np.column_stack([np.zeros(len(line)), place.of(line[:, 0], line)])
    corners, shares, _ = seen_from_front(lowered, model.neutral, _skin(model))
    return Embedding(corners, shares)


def brows_at(part: Part, model: FaceModel, place: BrowPlace) -> Part:
    """Worn brows, moved there along the skin of the default head, and as thick."""
    line, points = model.landmarks.of(model.neutral)[BROWS], part.on(model.neutral)
    middle = np.interp(points[:, 0], line[:, 0], line[:, 1])
    points[:, 1] = middle + place.thickness * (points[:, 1] - middle) + place.of(points[:, 0], line)
    corners, shares, normals = seen_from_front(points[:, :2], model.neutral, _skin(model))
    return replace(part, anchors=corners, weights=shares, offsets=ABOVE_SKIN_MM * normals)


def denser(picture: UInt8[np.ndarray, "h w 4"], layers: float) -> UInt8[np.ndarray, "h w 4"]:
    """Brows of so many layers of the hair in this picture (RGBA): what one lets through, the next may hide."""
    through = (1.0 - picture[..., 3:] / 255.0) ** layers
    return np.concatenate([picture[..., :3], np.rint(255.0 * (1.0 - through)).astype(np.uint8)], axis=2)


def line_of_brows(part: Part, picture: UInt8[np.ndarray, "h w 4"], head: Float[np.ndarray, "v 3"]) -> Embedding:
    """Landmarks 17 to 26 on the vertices of a style of brows: along the hair, a little below its upper edge."""
    height, width = picture.shape[:2]
    vertices, places, shares = part.on(head), [], []
    for corners, at in zip(part.triangles, part.uv[part.triangles_uv], strict=True):
        pixels = np.stack([at[:, 0] * width - 0.5, (1 - at[:, 1]) * height - 0.5], axis=1)
        low, high = np.floor(pixels.min(axis=0)).astype(int), np.ceil(pixels.max(axis=0)).astype(int)
        x, y = (axis.ravel() for axis in np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True))))
        edges = np.column_stack([pixels[1] - pixels[0], pixels[2] - pixels[0]])
        if abs(np.linalg.det(edges)) < 1e-6:
            continue
        second, third = np.linalg.solve(edges, np.stack([x, y]) - pixels[0][:, None])
        share = np.stack([1 - second - third, second, third], axis=1)
        inside = (share >= 0).all(axis=1) & (x >= 0) & (x < width) & (y >= 0) & (y < height)
        hair = inside & (picture[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1), 3] >= SOLID)
        shares.append(share[hair])
        places.append(np.tile(corners, (int(hair.sum()), 1)))
    corners, barycentric = np.concatenate(places), np.concatenate(shares)
    points = np.einsum("nk,nkc->nc", barycentric, vertices[corners])
    chosen = []
    for side in (points[:, 0] < 0, points[:, 0] > 0):
        start, end = np.quantile(points[side, 0], (0.005, 0.995))
        for station in BROW_STATIONS:
            x = start + station * (end - start)
            column = np.flatnonzero(side & (np.abs(points[:, 0] - x) < 0.06 * (end - start)))
            upper, lower = np.quantile(points[column, 1], (0.05, 0.95))
            wanted = np.array([x, upper + BROW_HEIGHT * (lower - upper)])
            chosen.append(column[np.argmin(np.linalg.norm(points[column, :2] - wanted, axis=1))])
    return Embedding(corners[chosen].astype(np.int32), barycentric[chosen])


def _skin(model: FaceModel) -> Integer[np.ndarray, "t 3"]:
    """Triangles of the skin."""
    member = np.zeros(len(model.neutral), bool)
    member[np.concatenate([model.regions[name] for name in SKIN])] = True
    return model.triangles[member[model.triangles].all(axis=1)]
