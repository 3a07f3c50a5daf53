"""Random MakeHuman heads, rigidly aligned, and their principal components.

The generator mixes the macro sliders (ethnicity, gender, age, weight, muscle) with 81 local face sliders. It is a
source of varied heads, not a population model: MakeHuman's sliders are an artist's, not measured.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from crop import Crop
from jaxtyping import Float
from makehuman import MakeHuman

JOINT_CUBES = {
    "jaw": "joint-mouth",
    "head": "joint-head",
    "neck": "joint-neck",
    "leftEye": "joint-l-eye",
    "rightEye": "joint-r-eye",
}
AVERAGE = ((1 / 3, 1 / 3, 1 / 3), 0.5, 0.5, 0.5, 0.5)
DECIMETRES = 100.0

# "name" has the two ends incr/decr; "name:up:down" names its ends; "name:" has one end only. A leading * means one
# target per side (l-name, r-name), always moved together.
SLIDERS = {
    "head": "head-age head-angle:in:out head-back-scale-depth head-fat head-scale-depth head-scale-horiz "
    "head-scale-vert head-diamond: head-invertedtriangular: head-oval: head-rectangular: head-round: head-square: "
    "head-triangular:",
    "forehead": "forehead-nubian forehead-scale-vert forehead-temple forehead-trans:forward:backward",
    "eyebrows": "eyebrows-angle:up:down eyebrows-trans:up:down",
    "eyes": "*eye-scale *eye-trans:out:in *eye-trans:up:down *eye-height1 *eye-height2 *eye-height3 "
    "*eye-corner1:up:down *eye-corner2:up:down *eye-epicanthus:in:out *eye-bag *eye-eyefold:up:down *eye-push1:in:out "
    "*eye-push2:in:out",
    "nose": "nose-flaring nose-greek nose-hump nose-nostrils-width nose-point-width nose-scale-depth nose-scale-horiz "
    "nose-scale-vert nose-septumangle nose-volume nose-width1 nose-width2 nose-width3 nose-base:up:down "
    "nose-compression:compress:uncompress nose-curve:convex:concave nose-nostrils-angle:up:down nose-point:up:down "
    "nose-trans:up:down",
    "mouth": "mouth-angles:up:down mouth-cupidsbow mouth-lowerlip-height mouth-lowerlip-volume mouth-lowerlip-width "
    "mouth-philtrum-volume mouth-scale-depth mouth-scale-horiz mouth-scale-vert mouth-upperlip-height "
    "mouth-upperlip-volume mouth-upperlip-width mouth-trans:up:down mouth-laugh-lines:in:out",
    "cheek": "*cheek-bones *cheek-inner *cheek-volume *cheek-trans:up:down",
    "chin": "chin-bones chin-cleft chin-height chin-jaw-drop chin-prognathism chin-prominent chin-width chin-triangle:",
    "ears": "*ear-scale *ear-wing",
    "neck": "neck-double",
}


def slider_targets(folder: str, slider: str) -> tuple[list[str], list[str]]:
    """Target names of the positive and of the negative end of one slider."""
    name, *ends = slider.lstrip("*").split(":")
    ends = ends or ["incr", "decr"]
    sides = ("l-", "r-") if slider.startswith("*") else ("",)
    targets = [[f"{folder}/{side}{name}{'-' if end else ''}{end}" for side in sides] for end in ends]
    return targets[0], targets[1] if len(targets) > 1 else []


@dataclass(frozen=True)
class Generator:
    """Draws heads in millimetres in our head frame, aligned to the average head."""

    source: MakeHuman
    crop: Crop
    slider_sigma: float = 0.3
    slider_probability: float = 0.5

    @cached_property
    def average(self) -> Float[np.ndarray, "v+5 3"]:
        """The average MakeHuman head: crop vertices, then the five joints."""
        raw = self._gather(self.source.base.vertices + self.source.macro(*AVERAGE))
        return self._to_head_frame(raw, origin=raw[-2:].mean(axis=0))

    @cached_property
    def _align_on(self) -> np.ndarray:
        """The front of the face in our frame (z points away from the camera), used for rigid alignment."""
        body = self.average[: len(self.crop.base_ids)]
        return np.flatnonzero(self.crop.is_part("skin") & (body[:, 2] < 30) & (body[:, 1] < 70))

    def draw(self, rng: np.random.Generator) -> Float[np.ndarray, "v+5 3"]:
        """One random head (crop vertices, then joints), mirror symmetric, aligned to the average without scaling."""
        races = rng.dirichlet([0.6, 0.6, 0.6])
        gender, age = rng.beta(0.6, 0.6), rng.uniform(0.36, 0.95)
        weight, muscle = np.clip(rng.normal(0.5, 0.18, 2), 0, 1)
        vertices = self.source.base.vertices + self.source.macro(races, gender, age, weight, muscle)
        for folder, sliders in SLIDERS.items():
            for slider in sliders.split():
                used, value = rng.random() < self.slider_probability, np.clip(rng.normal(0, self.slider_sigma), -1, 1)
                ends = slider_targets(folder, slider)
                for name in ends[0 if value > 0 else 1] if used else []:
                    vertices = vertices + abs(value) * self.source.shape(name)
        return self.aligned(vertices)

    def aligned(self, vertices: Float[np.ndarray, "b 3"]) -> Float[np.ndarray, "v+5 3"]:
        """The head (crop vertices, then joints) of a base mesh (dm): symmetric, aligned to the average, not scaled."""
        points = self._to_head_frame(self._gather(vertices), origin=np.zeros(3))
        return self.symmetrised(_rigidly_aligned(points, self.average, self._align_on))

    def symmetrised(self, points: Float[np.ndarray, "v+5 3"]) -> Float[np.ndarray, "v+5 3"]:
        """Average with the mirror image; the two eye joints change places, the others lie on the midplane."""
        count = len(self.crop.base_ids)
        mirror = np.concatenate([self.crop.mirror, count + np.array([0, 1, 2, 4, 3])])
        return 0.5 * (points + points[mirror] * [-1.0, 1.0, 1.0])

    def _gather(self, vertices: np.ndarray) -> np.ndarray:
        joints = [self.source.joint(vertices, cube) for cube in JOINT_CUBES.values()]
        return np.vstack([vertices[self.crop.base_ids], joints])

    @staticmethod
    def _to_head_frame(points: np.ndarray, origin: np.ndarray) -> np.ndarray:
        return (points - origin) * DECIMETRES * [1.0, -1.0, -1.0]


def _rigidly_aligned(points: np.ndarray, reference: np.ndarray, on: np.ndarray) -> np.ndarray:
    """Rotate and translate `points` onto `reference`, least squares over the rows `on` (Kabsch)."""
    centre, goal = points[on].mean(axis=0), reference[on].mean(axis=0)
    left, _, right = np.linalg.svd((points[on] - centre).T @ (reference[on] - goal))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return (points - centre) @ (left @ flip @ right) + goal


def principal_components(
    samples: Float[np.ndarray, "n p 3"], count: int
) -> tuple[Float[np.ndarray, "p 3"], Float[np.ndarray, "count p 3"]]:
    """Mean and the leading components, scaled to one standard deviation each; the largest entry is positive."""
    mean = samples.mean(axis=0)
    centred = (samples - mean).reshape(len(samples), -1)
    # Few samples, many coordinates: diagonalise the small Gram matrix.
    variances, vectors = np.linalg.eigh(centred @ centred.T / (len(samples) - 1))
    order = np.argsort(-variances)[:count]
    axes = vectors[:, order].T @ centred
    axes *= np.sqrt(variances[order])[:, None] / np.linalg.norm(axes, axis=1, keepdims=True)
    axes *= np.sign(axes[np.arange(count), np.abs(axes).argmax(axis=1)])[:, None]
    return mean, axes.reshape(count, -1, 3)
