"""Light as rooms and skies give it: from all around, less in hollows, and none behind a nose or below a fringe."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from scipy.sparse import csr_matrix, diags

from workbench.face.model import FaceModel
from workbench.pictures.extras import is_outer
from workbench.pictures.lighting import Light, Lighting
from workbench.pictures.mesh import corner_sum, vertex_normals

CELL_MM = 3.0
"""Side of the cells in which the first surface towards a light is looked for."""
HIDDEN_MM = (5.0, 11.0)
"""How far behind the first surface a vertex begins to be, and is, in its shadow."""
SKY_DIRECTIONS = 64
IN_THE_MOUTH = ("teethU", "teethL", "tongue")
"""What open lips let light to. How much of it the depth of the mouth leaves is in their pictures and shades."""
CAST_FROM = 0.12
"""Intensity from which a light casts shadows."""


@dataclass(frozen=True, eq=False)
class Sky:
    """Light from everywhere: colours from six sides, mixed by where a surface looks (an ambient cube)."""

    sides: Float[np.ndarray, "3 2 3"]
    """RGB, 0 to 1, from -x and +x, -y and +y, -z and +z of the camera."""

    def on(self, normals: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v 3"]:
        """RGB that surfaces with these normals (camera frame) are lit with."""
        chosen = (normals > 0).astype(int)
        return np.einsum("va,vac->vc", normals**2, self.sides[np.arange(3), chosen])


class Shader:
    """Shadows and skylight on one head's vertices."""

    def __init__(self, model: FaceModel) -> None:
        self.triangles = model.triangles
        self.sums = corner_sum(model.triangles, len(model.neutral))
        self.outer = model.triangles[is_outer(model)]
        neighbours: csr_matrix = self.sums @ self.sums.T
        self.blur = diags(1.0 / np.maximum(np.asarray(neighbours.sum(axis=1))[:, 0], 1.0)) @ neighbours
        self.openness = self._openness(model.neutral)
        self.in_the_mouth = model.in_regions(IN_THE_MOUTH)
        self.lips = model.in_regions(("lips",))
        self.lips &= self.openness > np.median(self.openness[self.lips])

    def light(
        self,
        points_camera: Float[np.ndarray, "v 3"],
        lighting: Lighting,
        sky: Sky,
        occluders: Sequence[Float[np.ndarray, "_ 3"]] = (),
    ) -> UInt8[np.ndarray, "v 3"]:
        """`Extras.light`: what reaches each vertex, where `lighting` alone would light it without a shadow.

        Camera-frame points in millimetres; `occluders` are points of what else casts shadows. Teeth and tongue get
        what the outer half of the lips gets.
        """
        normals = vertex_normals(points_camera, self.triangles, self.sums)
        skylight = lighting.ambient * self.openness[:, None] * sky.on(normals)
        reached, sent = skylight, np.full((len(normals), 3), lighting.ambient)
        for light in lighting.lights:
            toward = _unit(light)
            direct = light.intensity * np.clip(normals @ toward, 0.0, 1.0)[:, None] * np.asarray(light.color)
            sent = sent + direct
            if light.intensity >= CAST_FROM:
                direct = direct * self.reached(points_camera, toward, occluders)[:, None]
            reached = reached + direct
        share = np.clip(reached / np.maximum(sent, 1e-3), 0.0, 1.0)
        # Found as for the skin, there would be none: a resting head's lips are shut.
        share[self.in_the_mouth] = share[self.lips].mean(axis=0)
        return np.rint(255 * share).astype(np.uint8)

    def reached(
        self,
        points: Float[np.ndarray, "v 3"],
        toward: Float[np.ndarray, "3"],
        occluders: Sequence[Float[np.ndarray, "_ 3"]] = (),
    ) -> Float[np.ndarray, "v"]:
        """1 where a distant light in the direction `toward` reaches a vertex, 0 where something is before it."""
        corners = points[self.outer]
        surface = np.concatenate([
            points[np.unique(self.outer)], corners.mean(axis=1),
            (corners + np.roll(corners, 1, axis=1)).reshape(-1, 3) / 2, *occluders,
        ])  # fmt: skip
        across = np.cross(toward, [0.0, 1.0, 0.0] if abs(toward[1]) < 0.9 else [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across)
        axes = np.stack([across, np.cross(toward, across)], axis=1)
        start = surface.min(axis=0) @ axes - 400.0
        place = ((surface @ axes - start) / CELL_MM).astype(np.int64)
        own = ((points @ axes - start) / CELL_MM).astype(np.int64)
        lowest = np.minimum(place.min(axis=0), own.min(axis=0))
        place, own = place - lowest, own - lowest
        first = np.full(np.maximum(place.max(axis=0), own.max(axis=0)) + 1, -np.inf)
        np.maximum.at(first, (place[:, 0], place[:, 1]), surface @ toward)
        first = np.where(np.isfinite(first), first, cv2.dilate(first, np.ones((3, 3))))
        behind = first[own[:, 0], own[:, 1]] - points @ toward
        lit = np.interp(behind, HIDDEN_MM, (1.0, 0.0))
        return self.blur @ (self.blur @ lit)

    def _openness(self, points: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v"]:
        """Share of the sky above each vertex that it sees, weighted by the cosine."""
        normals = vertex_normals(points, self.triangles, self.sums)
        k = np.arange(SKY_DIRECTIONS) + 0.5  # a spiral of even density (Fibonacci)
        height, turn = 1 - 2 * k / SKY_DIRECTIONS, np.pi * (1 + 5**0.5) * k
        ring = np.sqrt(1 - height**2)
        seen, all_of_it = np.zeros(len(points)), np.zeros(len(points))
        for toward in np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], axis=1):
            weight = np.clip(normals @ toward, 0.0, 1.0)
            seen += weight * self.reached(points, toward)
            all_of_it += weight
        return seen / np.maximum(all_of_it, 1e-6)


def random_sky(rng: np.random.Generator) -> Sky:
    """From even grey to a bright window or ceiling on one side; a middling side is 0.8."""
    spread = rng.uniform(0.05, 0.6)
    grey = np.exp(rng.normal(0, spread, (3, 2, 1)))
    warmth = rng.normal(0, 0.1, (3, 2, 1)) * np.array([1.0, 0.0, -1.0])
    sides = grey * (1 + warmth + rng.normal(0, 0.03, (3, 2, 3)))
    sides[1, 0] *= rng.uniform(1.0, 1.6)  # more comes from above
    return Sky(np.clip(0.8 * sides / np.median(sides), 0.02, 1.0))


def _unit(light: Light) -> Float[np.ndarray, "3"]:
    direction = np.asarray(light.direction, float)
    return direction / max(float(np.linalg.norm(direction)), 1e-9)
