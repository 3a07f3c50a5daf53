"""Some 300 points over the whole face of the default head: the vertices that the landmark scheme `dense` names.

`python -m workbench.training.dense_points` writes the scheme's table.

Chosen by one rule on the mesh at rest, so that nobody has to place them: points of the skin are taken one by one,
always the one that lies farthest from those already taken, where distances count in units of the spacing that its part
of the face should have (lids and lips densely, cheeks and forehead sparsely). Both sides are taken together, and what
lies on the plane of symmetry alone.
"""

import json
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from workbench.face.default_head import load_default_head
from workbench.face.dense_landmarks import EYEBALLS
from workbench.face.model import FaceModel
from workbench.files import atomic_path
from workbench.geometry import camera_from_fov, rotation_matrix
from workbench.geometry.rotations import axis_angle_from_yaw_pitch_roll
from workbench.landmarks.scheme import GROUPS
from workbench.landmarks.schemes import DENSE_TABLE, DensePoints
from workbench.rendering.lighting import ambient_light
from workbench.rendering.renderer import render
from workbench.rendering.topology import mesh_topology

SPACING_MM = {"eyes": 3.4, "mouth": 4.2, "brows": 5.5, "nose": 6.5, "ears": 13.0, "face": 12.0}
"""Distance between neighbouring points by part of the face."""
REACH_MM = {"eyes": 4.5, "mouth": 5.5, "brows": 7.0, "nose": 13.0}
"""How far the part around a group of the 68 landmarks reaches."""
IRIS_POINTS = 8
"""Points on the border of each iris."""
SIGHT_SIDE, SIGHT_FOV_DEG = 512, 12.0
SIGHT_MIDDLE_MM, SIGHT_HEIGHT_MM = 32.7983, 291.6078
"""Of the view: the middle of the head's heights and their range. Fixed, so that the neck has no say in the choice."""
SIGHT_YAWS_DEG = (-80.0, -45.0, 0.0, 45.0, 80.0)
"""Pictures in which a point must be seen."""
BELOW_CHIN_MM = 6.0
"""How far below the chin the face ends."""
BEHIND_EARS_MM = 25.0
"""How far behind the first point of the jaw's contour, which lies before the ear, the face ends."""
EARS_STAND_OUT_MM = 7.0
"""How far out of that point what lies behind is an ear."""


def dense_points(model: FaceModel) -> DensePoints:
    """The dense points of the default head or of a person on it (the choice is the mean head's); needs the eyeballs."""
    group, open_to_view = _parts(model), _shown(model)
    spacing = np.array([SPACING_MM[name] for name in group])
    chosen = _farthest_first(model.neutral, model.mirror, spacing, open_to_view)
    irises = [iris_vertices(model, eye) for eye in EYEBALLS]
    vertices = np.concatenate([chosen, *irises])
    place = {vertex: order for order, vertex in enumerate(vertices.tolist())}
    mirror = np.array([place[vertex] for vertex in model.mirror[vertices].tolist()])
    parts = (*group[chosen].tolist(), *["irises"] * 2 * IRIS_POINTS)
    # The subject's right is where x is negative.
    sides = np.where(model.neutral[vertices, 0] < 0.0, "right", "left")
    sides = np.where(mirror == np.arange(len(mirror)), "middle", sides)
    return DensePoints(vertices, mirror, parts, tuple(sides.tolist()))


def write_table(points: DensePoints, path: Path) -> None:
    """The scheme's table as `landmarks.schemes` reads it."""
    numbers = {"vertices": points.vertices.tolist(), "mirror": points.mirror.tolist()}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps({**numbers, "parts": points.parts, "sides": points.sides}) + "\n")


def iris_vertices(model: FaceModel, eye: str) -> Int[np.ndarray, "8"]:
    """The ring of an eyeball's vertices around its pupil's ring: the iris's border, from the outer side upwards."""
    ball = model.regions[eye]
    ring = ball[np.argsort(model.neutral[ball, 2])[IRIS_POINTS : 2 * IRIS_POINTS]]
    around = model.neutral[ring] - model.neutral[ring].mean(axis=0)
    return ring[np.argsort(np.arctan2(around[:, 1], np.sign(model.neutral[ring[0], 0]) * around[:, 0]))]


def _parts(model: FaceModel) -> np.ndarray:
    """The part of the face that each vertex belongs to, by the 68 landmarks that are near."""
    points, landmarks = model.neutral, model.landmarks.of(model.neutral)
    part = np.full(len(points), "face", object)
    ear = landmarks[0]
    part[(np.abs(points[:, 0]) > abs(ear[0]) - 1.0) & (points[:, 2] > ear[2] - 10.0)] = "ears"
    for name in ("nose", "brows", "mouth", "eyes"):
        near, _ = cKDTree(landmarks[list(GROUPS[name])]).query(points)
        part[near < REACH_MM[name]] = name
    return part


def _shown(model: FaceModel) -> Bool[np.ndarray, "v"]:
    """Skin, lips and brows between hairline, ears and chin that look outwards; not the inside of mouth and nose."""
    landmarks = model.landmarks.of(model.neutral)
    kinds = np.zeros(len(model.neutral), bool)
    kinds[np.concatenate([model.regions[name] for name in ("skin", "lips", "brow")])] = True
    below = model.neutral[:, 1] > landmarks[8, 1] + BELOW_CHIN_MM - 0.55 * np.maximum(
        model.neutral[:, 2] - landmarks[8, 2], 0.0
    )
    behind = model.neutral[:, 2] > landmarks[0, 2] + BEHIND_EARS_MM
    behind &= np.abs(model.neutral[:, 0]) < np.abs(landmarks[0, 0]) + EARS_STAND_OUT_MM
    return kinds & ~below & ~behind & _seen_from_outside(model)


def _seen_from_outside(model: FaceModel) -> Bool[np.ndarray, "v"]:
    """Corners of triangles that some view from the front or a side shows."""
    size, camera = (SIGHT_SIDE, SIGHT_SIDE), camera_from_fov((SIGHT_SIDE, SIGHT_SIDE), SIGHT_FOV_DEG)
    topology, seen = mesh_topology(model.triangles, len(model.neutral)), np.zeros(len(model.neutral), bool)
    away = np.array([0.0, -SIGHT_MIDDLE_MM, 0.6 * SIGHT_HEIGHT_MM / np.tan(np.radians(SIGHT_FOV_DEG) / 2)])
    for yaw in SIGHT_YAWS_DEG:
        rotation = rotation_matrix(axis_angle_from_yaw_pitch_roll(np.array([yaw, 0.0, 0.0])))
        view = render(
            model.neutral @ np.asarray(rotation).T + away,
            topology,
            camera,
            np.ones_like(model.neutral),
            ambient_light(),
            np.zeros(3),
            size=size,
            antialias=False,
        )
        shown = np.unique(np.asarray(view.triangle))
        seen[model.triangles[shown[shown >= 0]]] = True
    return seen


def _farthest_first(
    points: Float[np.ndarray, "v 3"],
    mirror: Int[np.ndarray, "v"],
    spacing_mm: Float[np.ndarray, "v"],
    allowed: Bool[np.ndarray, "v"],
) -> Int[np.ndarray, "n"]:
    """Vertices in the order of the rule, with their mirror images, until all allowed ones are within their spacing."""
    allowed = allowed & allowed[mirror]
    chosen: list[int] = []
    farness = np.where(allowed, np.inf, 0.0)
    following = int(np.flatnonzero(allowed)[np.argmin(points[allowed, 2])])
    while farness[following] >= 1.0:
        pair = list(dict.fromkeys((following, int(mirror[following]))))
        if len(pair) == 2 and np.linalg.norm(points[pair[0]] - points[pair[1]]) < spacing_mm[following]:
            farness[pair] = 0.0  # too close to the plane of symmetry for two, and not on it
        else:
            chosen += pair
            for vertex in pair:
                farness = np.minimum(farness, np.linalg.norm(points - points[vertex], axis=1) / spacing_mm)
        following = int(np.argmax(farness))
    return np.array(chosen)


if __name__ == "__main__":
    write_table(dense_points(load_default_head(gaze=True)), DENSE_TABLE)
