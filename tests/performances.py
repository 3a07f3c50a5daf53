"""A short made-up performance as a track, and a second character to play it."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pyvista as pv
from scipy.spatial import cKDTree

from tests.scenes import make_scene
from workbench.export import make_clip
from workbench.face import FaceModel, gaze_deg, in_scheme, load_default_head
from workbench.face.model import Embedding
from workbench.face.obj_folder import linear_model
from workbench.landmarks.schemes import DENSE
from workbench.tracking import Track
from workbench.tracking.records import FrameFit, stack_fits
from workbench.tracking.track_layout import model_record

FRAMES, GAP = 12, 5
"""One frame has no face."""


def performance(head: FaceModel, frames: int = FRAMES, gap: int | None = GAP, rate: float = 25.0, shots: int = 1):
    """A head of its own that turns to its left, opens the mouth, and smiles and blinks on the left side."""
    meta = {"expression_names": list(head.expression_names), "rate": rate, "model": dict(_record(head))}
    return Track(meta=meta, **stack_fits(list(_fits(head, frames, gap, shots))))


_record = lru_cache(maxsize=4)(model_record)


@lru_cache(maxsize=16)
def _fits(head: FaceModel, frames: int, gap: int | None, shots: int) -> tuple[FrameFit, ...]:
    rng = np.random.default_rng(3)
    faces = [rng.normal(0.0, 1.0, len(head.identity_deltas)) for _ in range(shots)]
    fits = []
    for index in range(frames):
        part = index / max(frames - 1, 1)
        weights = {"jawOpen": 0.6 * part, "mouthSmileLeft": part, "eyeBlinkLeft": 1.0 - part, "browInnerUp": 0.4}
        angles = (-30.0 * part, 20.0 * part, 10.0 * part)
        shot = index * shots // frames
        scene = make_scene(head, angles, weights, faces[shot], translation=(40.0 * part, -10.0, 600.0 + 50.0 * part))
        fits.append(_fit(scene, index, shot, index != gap))
    return tuple(fits)


def with_jaw(track: Track) -> Track:
    """The track with a jaw that opens by its joint, swings to both sides, and a head that grows."""
    part = np.linspace(0.0, 1.0, len(track))
    jaw = np.zeros((len(track), 6))
    jaw[:, 0], jaw[:, 1] = np.radians(24.0) * part, np.radians(3.0) * np.sin(9.0 * part)
    jaw[:, 3], jaw[:, 5] = 4.0 * np.cos(5.0 * part), -2.0 * part
    return replace(track, jaw=jaw, scale=1.0 + 0.1 * part)


def looking_aside():
    """A head with all 52 blendshapes that looks to its left and down, more and more."""
    full = load_default_head(gaze=True)
    track, part = performance(full), np.linspace(0.0, 1.0, FRAMES)
    weights = track.expression.copy()
    for unit, most in {"eyeLookOutLeft": 1.0, "eyeLookInRight": 0.9, "eyeLookDownLeft": 0.5}.items():
        weights[:, full.expression_names.index(unit)] = most * part
    return make_clip(replace(track, expression=np.where(track.found[:, None], weights, np.nan)), full)


def gazes(clip, position: int) -> np.ndarray:
    """Azimuth and elevation of the right and the left eye of a fitted head, degrees."""
    return gaze_deg(in_scheme(clip.person, DENSE), clip.track.expression[position])


def other_character(head: FaceModel, identity: np.ndarray, keep: float = 0.5) -> FaceModel:
    """Another person on another mesh: `keep` of the triangles, the blendshapes of the vertices that stay."""
    person = head.personal(identity)
    corners = np.column_stack([np.full(len(person.triangles), 3), person.triangles]).ravel()
    mesh = pv.PolyData(person.neutral, corners)
    mesh.point_data["vertex"] = np.arange(len(person.neutral))
    # Vertices that stay keep their place, so that closed lips are not mixed up, as nearest neighbours would be.
    small = mesh.decimate_pro(1.0 - keep, preserve_topology=True, boundary_vertex_deletion=False)
    kept = small.point_data["vertex"].astype(int)
    vertices, deltas = person.neutral[kept], person.expression_deltas[:, kept]
    triangles = small.faces.reshape(-1, 4)[:, 1:].astype(np.int32)
    _, points = cKDTree(vertices).query(person.landmarks.of(person.neutral))
    landmarks = Embedding(np.repeat(points[:, None], 3, axis=1).astype(np.int32), np.tile([1.0, 0.0, 0.0], (68, 1)))
    made = linear_model("other", vertices, triangles, person.expression_names, deltas, landmarks)
    return replace(made, colors=person.colors[kept])


def _fit(scene, index: int, shot: int, found: bool) -> FrameFit:
    unknown = 1.0 if found else np.nan
    parameters = scene.parameters
    return FrameFit(
        index=index, found=found, shot=shot, source="detected" if found else "none", image_size=(640, 480),
        camera=scene.camera,
        rotation=np.asarray(parameters.rotation) * unknown,
        translation=np.asarray(parameters.translation) * unknown,
        expression=np.asarray(parameters.expression) * unknown,
        identity=np.asarray(parameters.identity) * unknown,
        observed=(scene.points + 0.5) * unknown,
        confidence=np.ones(68) * unknown,
        projected=scene.points * unknown,
        energies=np.zeros((1, 7)), status=np.zeros(1, int), iterations=np.zeros(1, int), milliseconds=np.zeros(3),
    )  # fmt: skip
