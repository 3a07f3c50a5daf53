"""Synthetic truth for several cameras: the default head before a rig, and what a perfect detector sees in each view."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from tests.scenes import FOV_DEG, IMAGE_SIZE, random_expression
from workbench.energies.reprojection import points_head
from workbench.face import FaceModel, FaceParameters, contour_blend, landmark_model, model_landmarks
from workbench.geometry import (
    PlacedCamera,
    Rig,
    View,
    axis_angle_from_yaw_pitch_roll,
    camera_from_fov,
    head_yaw,
    pose_in_view,
    project_to_view,
    rotation_matrix,
)
from workbench.landmarks.files import LandmarkRecord
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures import HeadRenderer

DISTANCE_MM = 600.0
NAMES = ("middle", "side", "third", "fourth")


@dataclass(frozen=True)
class StereoScene:
    """A clip of truth before a rig."""

    rig: Rig
    parameters: tuple[FaceParameters, ...]
    """Per frame, in the reference camera's frame."""
    points: np.ndarray
    """(views, frames, 68, 2): the landmarks in each view's picture, pixels."""

    def records(
        self, view: int, noise_px: float = 0.0, seed: int = 0, missing: Sequence[int] = (), shift: int = 0
    ) -> list[LandmarkRecord]:
        """A view's landmarks as a detector with this noise reports them; none in frames `missing`.

        `shift`: the recording began so many frames late, so that its frame k shows what the truth's frame
        k + shift does.
        """
        size = self.rig.views[view].image_size
        rng = np.random.default_rng(seed + 1000 * view)
        noisy = self.points[view] + rng.normal(0.0, 1.0, self.points[view].shape) * noise_px
        found = [None if k in missing else Landmarks2D(points, np.ones(68), size) for k, points in enumerate(noisy)]
        shown = {k - shift: landmarks for k, landmarks in enumerate(found) if k - shift >= 0}
        name = self.rig.names[view]
        return [LandmarkRecord(k, f"{name}#{k}", landmarks, size) for k, landmarks in sorted(shown.items())]


def make_rig(
    angles_deg: Sequence[float] = (0.0, 30.0),
    distance_mm: float = DISTANCE_MM,
    image_size: tuple[int, int] = IMAGE_SIZE,
    fov_deg: float = FOV_DEG,
    distortion: Sequence[float] = (),
) -> Rig:
    """Cameras on a circle around the world's origin, all looking at it; the first is the reference.

    A camera at 0° sees a head in the world's axes from the front; one at +30° stands to its right (+x) and sees the
    head turned to the image's left.
    """
    coefficients = np.zeros(8)
    coefficients[: len(distortion)] = distortion
    camera = camera_from_fov(image_size, fov_deg)._replace(distortion=coefficients)
    views = []
    for name, angle in zip(NAMES, angles_deg, strict=False):
        turned = np.asarray(rotation_matrix(jnp.array([0.0, np.radians(angle), 0.0])))
        views.append(View(name, image_size, camera, turned, np.array([0.0, 0.0, distance_mm])))
    return Rig(tuple(views))


def make_stereo_scene(
    head: FaceModel,
    rig: Rig | None = None,
    frames: int = 1,
    seed: int = 0,
    identity: np.ndarray | None = None,
    moving: bool = True,
    sliding: bool = False,
) -> StereoScene:
    """A head that turns, shifts and talks about the origin of the rig's world (default: two views 30° apart).

    Expressions come and go smoothly; `moving=False` holds the head where the cameras look, straight towards 0°.
    `sliding` lets the jaw contour follow the yaw *in each view*, as detectors see it; else it is one set of points.
    """
    rig = make_rig() if rig is None else rig
    rng = np.random.default_rng(seed)
    peaks = random_expression(head, rng)
    speeds, phases = rng.uniform(0.15, 0.35, (2, 6)), rng.uniform(0.0, 2 * np.pi, (2, 6))
    identity = np.zeros(len(head.identity_deltas)) if identity is None else identity
    reference = rig.views[0]
    # The world as if it were the reference camera's frame: where the head is in it, the reference camera sees.
    world = PlacedCamera(reference.camera, reference.rotation_view_world, reference.translation_view_world_mm)
    parameters = []
    for k in range(frames):
        swing = np.sin(speeds[0] * k + phases[0]) * moving
        expression = np.zeros(len(head.expression_names))
        for (name, peak), wave in zip(peaks.items(), 0.5 + 0.5 * np.sin(speeds[1] * k + phases[1]), strict=False):
            expression[head.expression_names.index(name)] = peak * wave
        turned = axis_angle_from_yaw_pitch_roll(swing[:3] * [12.0, 8.0, 5.0])
        rotation, translation = pose_in_view(turned, swing[3:] * [25.0, 15.0, 30.0], world)
        pose = jnp.asarray(rotation), jnp.asarray(translation)
        parameters.append(FaceParameters(*pose, jnp.asarray(expression), jnp.asarray(identity, float)))
    projected = [[landmarks_in_view(head, p, rig.placed_view(v), sliding) for p in parameters] for v in range(len(rig))]
    return StereoScene(rig, tuple(parameters), np.array(projected))


def landmarks_in_view(
    head: FaceModel, parameters: FaceParameters, view: PlacedCamera, sliding: bool = False
) -> np.ndarray:
    """The 68 landmarks of a head, given in the reference camera's frame, in the picture of a view, pixels."""
    model = landmark_model(head)
    turned, _ = pose_in_view(np.asarray(parameters.rotation), np.asarray(parameters.translation), view)
    blend = contour_blend(model.contour_yaw, head_yaw(jnp.asarray(turned)), float(sliding))
    points = points_head(model_landmarks(model, blend, parameters.identity), parameters)
    points_reference = points @ rotation_matrix(parameters.rotation).T + parameters.translation
    return np.asarray(jax.jit(project_to_view)(points_reference, view))


def picture_in_view(
    renderer: HeadRenderer, person: FaceModel, parameters: FaceParameters, view: PlacedCamera
) -> np.ndarray:
    """What a view's camera (without distortion) sees of a person whose identity is part of the model."""
    pose = pose_in_view(np.asarray(parameters.rotation), np.asarray(parameters.translation), view)
    return renderer.render(person.vertices(np.asarray(parameters.expression)), view.camera, *pose)
