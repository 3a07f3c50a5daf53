"""Synthetic truth: a head with known pose and weights, and the landmarks that a perfect detector would give."""

from dataclasses import dataclass
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from workbench.energies import project_landmarks
from workbench.face import FaceModel, FaceParameters, contour_blend, landmark_model, model_landmarks
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov, head_yaw
from workbench.landmarks.observations import Landmarks2D
from workbench.session import Material
from workbench.session.material import PictureStore
from workbench.tracking import FrameObservation

IMAGE_SIZE = (640, 480)
FOV_DEG = 45.0


@dataclass(frozen=True)
class Scene:
    """One frame of truth."""

    camera: Camera
    parameters: FaceParameters
    angles_deg: np.ndarray
    points: np.ndarray

    def observation(self, index: int = 0, noise_px: float = 0.0, seed: int = 0, cut: bool = False) -> FrameObservation:
        """The landmarks as a detector with this noise would report them."""
        points = self.points + np.random.default_rng(seed + 1000 * index).normal(0.0, 1.0, (68, 2)) * noise_px
        return FrameObservation(index, Landmarks2D(points, np.ones(68), IMAGE_SIZE), IMAGE_SIZE, cut=cut)


def make_scene(
    head: FaceModel,
    angles_deg=(0.0, 0.0, 0.0),
    weights: dict[str, float] | None = None,
    identity: np.ndarray | None = None,
    translation=(0.0, 0.0, 600.0),
    sliding: bool = False,
) -> Scene:
    """Landmarks of the head in this pose, with these blendshape weights by name and this identity."""
    camera = camera_from_fov(IMAGE_SIZE, FOV_DEG)
    expression = np.zeros(len(head.expression_names))
    for name, weight in (weights or {}).items():
        expression[head.expression_names.index(name)] = weight
    identity = np.zeros(len(head.identity_deltas)) if identity is None else identity
    parameters = FaceParameters(
        jnp.asarray(axis_angle_from_yaw_pitch_roll(np.asarray(angles_deg, float))),
        jnp.asarray(translation, float),
        jnp.asarray(expression),
        jnp.asarray(identity, float),
    )
    points = _projected(camera, _landmark_model(head), parameters, float(sliding))
    return Scene(camera, parameters, np.asarray(angles_deg, float), np.asarray(points))


@jax.jit
def _projected(camera, model, parameters, sliding):
    blend = contour_blend(model.contour_yaw, head_yaw(parameters.rotation), sliding)
    return project_landmarks(camera, model_landmarks(model, blend, parameters.identity), parameters)


_landmark_model = lru_cache(maxsize=4)(landmark_model)


def turning_clip(head: FaceModel, frames: int, first_yaw_deg: float) -> Material:
    """A clip without pictures: the head turns by 2° a frame, and the mouth opens."""
    scenes = [make_scene(head, (first_yaw_deg + 2.0 * k, 0, 0), {"jawOpen": 0.05 * k}) for k in range(frames)]
    observations = tuple(scene.observation(k, noise_px=0.4) for k, scene in enumerate(scenes))
    return Material("clip", observations, PictureStore(None, [IMAGE_SIZE] * frames), stills=False)


def random_expression(head: FaceModel, rng: np.random.Generator, active: int = 5) -> dict[str, float]:
    """A few random blendshapes between 0.2 and 0.9."""
    names = rng.choice(head.expression_names, active, replace=False)
    return {str(name): float(rng.uniform(0.2, 0.9)) for name in names}
