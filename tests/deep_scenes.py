"""Truth for Deep Energies: what the network sees in the model's own render, so that a perfect solve leaves nothing."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from workbench.config import Config, Stage, preset
from workbench.face import FaceModel, FaceParameters
from workbench.geometry import axis_angle_from_yaw_pitch_roll
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import LandmarkScheme
from workbench.planning import plan_of
from workbench.tracking import FrameContext, FrameObservation
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.deep_solver import predict
from workbench.tracking.deep_target import LOOKS
from workbench.tracking.deep_views import holding

IMAGE_SIZE = (720, 540)
FOV_DEG = 40.0
DEEP = preset("deep").changed(camera={"fov_deg": FOV_DEG}, deep={"appearance": "model", "network": "heat-maps"})
POINTS = DEEP.changed(deep={"energy": "points"})
POSE_ONLY = (Stage(name="pose", free=("rotation", "translation"), limit=20),)


@dataclass(frozen=True)
class DeepScene:
    """One frame of truth, in the frame of the reference camera."""

    parameters: FaceParameters
    landmarks: tuple[Landmarks2D | None, ...]

    def observation(self, index: int = 0) -> FrameObservation:
        """The frame as a tracker brings it."""
        return FrameObservation(index, self.landmarks[0], IMAGE_SIZE, others=self.landmarks[1:])

    def context(self) -> FrameContext:
        """What is known of the person."""
        return FrameContext(0, np.asarray(self.parameters.identity), None, None)


def make_parameters(
    head: FaceModel,
    angles_deg=(0.0, 0.0, 0.0),
    translation=(0.0, 0.0, 650.0),
    weights: dict[str, float] | None = None,
    jaw_deg: float = 0.0,
    seed: int | None = None,
) -> FaceParameters:
    """Parameters of both systems; a `seed` makes a person who is not the mean."""
    expression = np.zeros(len(head.expression_names))
    for name, weight in (weights or {}).items():
        expression[head.expression_names.index(name)] = weight
    count = len(head.identity_deltas)
    identity = np.zeros(count) if seed is None else np.random.default_rng(seed).normal(0.0, 0.7, count)
    parts = (
        axis_angle_from_yaw_pitch_roll(np.asarray(angles_deg, float)),
        np.asarray(translation, float),
        expression,
        identity,
        np.array([np.radians(jaw_deg), 0.0, 0.0, 0.0, 0.0, 0.0]),
        np.ones(1),
    )
    return FaceParameters(*(jnp.asarray(part) for part in parts))


def make_deep_scene(fitter: DeepFitter, parameters: FaceParameters) -> DeepScene:
    """What the fitter itself would predict of these parameters, by its energy and in all its views, as detections."""
    count = 1 if fitter.rig is None else len(fitter.rig)
    scheme = fitter.model.scheme
    nowhere = _detected(np.zeros((len(scheme), 2)), scheme)
    blank = FrameObservation(0, nowhere, IMAGE_SIZE, others=(nowhere,) * (count - 1))
    context = FrameContext(0, np.asarray(parameters.identity), None, None)
    views, scene = fitter.views(blank, context), fitter.scene(None)
    seen = predict(scene, views, parameters).points
    for _ in range(LOOKS if views[0].crop is not None else 0):  # a photo's crop lies about what was seen in it
        observation = replace(blank, landmarks=_detected(seen[0], scheme))
        seen = predict(scene, holding(fitter.views(observation, context), scene, parameters), parameters).points
    return DeepScene(parameters, tuple(_detected(points, scheme) for points in seen))


def _detected(points: np.ndarray, scheme: LandmarkScheme) -> Landmarks2D:
    """By a sure detector: where it tells covariances, one of a pixel."""
    covariance = np.tile(np.eye(2), (len(points), 1, 1)) if scheme.has_covariances else None
    return Landmarks2D(points, np.ones(len(points)), IMAGE_SIZE, covariance)


def fitter_with(fitter: DeepFitter, config: Config) -> DeepFitter:
    """The shared fitter under another configuration."""
    fitter.configure(plan_of(config, fitter.model.scheme))
    return fitter


def rotation_error_deg(found: FaceParameters, true: FaceParameters) -> float:
    """Angle between two rotations."""
    found, true = (Rotation.from_rotvec(np.array(each.rotation)) for each in (found, true))
    return float(np.degrees((found.inv() * true).magnitude()))


def flat(parameters: FaceParameters) -> np.ndarray:
    """All numbers in one row, as `StageProblem` counts them."""
    return np.asarray(jax.flatten_util.ravel_pytree(parameters)[0])
