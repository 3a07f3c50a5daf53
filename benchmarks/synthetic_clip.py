"""A seeded clip of landmarks for the benchmarks: the default head's 68 points, a moving head, smooth expressions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.config import preset
from workbench.face import FaceModel, landmark_model, load_default_head, seen_shapes
from workbench.geometry import Camera, camera_from_fov, project
from workbench.landmarks.observations import Landmarks2D
from workbench.tracking import FrameObservation

IMAGE_SIZE = (640, 480)
RATE = 25.0
NOISE_PX = 0.5


@dataclass(frozen=True)
class Clip:
    """Landmarks of consecutive frames, and the linear face model behind them."""

    head: FaceModel
    camera: Camera
    neutral: Float[np.ndarray, "68 3"]
    """Neutral landmarks of the mean identity, frontal contour, millimetres."""
    shapes: Float[np.ndarray, "43 68 3"]
    """Blendshape offsets of the landmarks, millimetres. Without the tongue: our solver holds it, Ceres would not."""
    points: Float[np.ndarray, "n 68 2"]
    """Pixels."""

    def observation(self, index: int) -> FrameObservation:
        """One frame as the tracker takes it."""
        return FrameObservation(index, Landmarks2D(self.points[index], np.ones(68), IMAGE_SIZE), IMAGE_SIZE)


def synthetic_clip(frames: int = 300, seed: int = 0) -> Clip:
    """A clip whose head turns, nods and comes nearer while about a third of the blendshapes are active at a time."""
    whole = load_default_head()
    seen = seen_shapes(whole)
    head = whole.with_expressions(tuple(np.array(whole.expression_names)[seen].tolist()))
    model = landmark_model(head).personal(np.zeros(len(head.identity_deltas)))
    camera = camera_from_fov(IMAGE_SIZE, preset("face-it").camera.fov_deg)
    random = np.random.default_rng(seed)
    times = np.arange(frames) / RATE
    weights = np.clip(_waves(times, len(seen), random) - 0.4, 0.0, 1.0)[:, seen]
    rotations = _waves(times, 3, random) * np.array([0.15, 0.35, 0.12])
    translations = _waves(times, 3, random) * np.array([40.0, 25.0, 50.0]) + np.array([0.0, 0.0, 600.0])
    neutral = model.frontal_neutral()
    shapes = np.concatenate([model.contour_expression[0], model.inner_expression], axis=1)
    points_head = neutral + np.tensordot(weights, shapes, axes=1)
    matrices = Rotation.from_rotvec(rotations).as_matrix()
    points_camera = points_head @ matrices.transpose(0, 2, 1) + translations[:, None]
    points = np.asarray(project(camera, points_camera)) + random.normal(0.0, NOISE_PX, (frames, 68, 2))
    return Clip(head, camera, neutral, shapes, points)


def _waves(times: Float[np.ndarray, "n"], count: int, random: np.random.Generator) -> Float[np.ndarray, "n count"]:
    # Two slow sines each: smooth, within [-1, 1], and never the same twice in a clip.
    frequencies = random.uniform(0.1, 0.6, (2, count))
    phases = random.uniform(0.0, 2.0 * np.pi, (2, count))
    return np.sin(2.0 * np.pi * times[:, None, None] * frequencies + phases).mean(1)
