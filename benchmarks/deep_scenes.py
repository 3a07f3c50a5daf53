"""Photos of people whose pose, jaw and expression are known, for the benchmark of Deep Energies.

A solve is given the person's own shape and nearly his colours, as the paper gives the actor's. All else is as in life:
the photo has other light than the solver believes, a background, unsharpness, noise and JPEG's losses; it is rendered
whole and supersampled while the solver renders crops; the landmarks come from the detector and the network.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from workbench.config import preset
from workbench.face import FaceModel, FaceParameters
from workbench.geometry import Camera, Rig, View, camera_from_fov
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.surroundings import seen_around
from workbench.rendering import (
    Appearance,
    RenderModel,
    ambient_light,
    directional_light,
    face_vertices,
    render,
    render_model,
    turned_light,
)
from workbench.tracking import FrameContext, FrameObservation
from workbench.tracking.deep_target import energy_network, photo_landmarks

NETWORK = preset("deep").deep.network
"""N of the photos."""
IMAGE_SIZE = (720, 540)
FOV_DEG = 40.0
START_MM = 650.0
"""Where the frontal start stands."""
ANGLE_DEG, OFFSET_PX = 25.0, 40.0
"""How far from the frontal start the truth is."""
LARGEST_DEG = (25.0, 12.0, 10.0)
"""Yaw, pitch and roll are drawn within these in proportion, then stretched to `ANGLE_DEG` in all."""
STEREO_DEG = 30.0
LIGHT_ERROR_DEG = 15.0


@dataclass(frozen=True)
class DeepTruth:
    """One frame: what is true, the photo of each view, and what a solve is given."""

    parameters: FaceParameters
    pictures: tuple[UInt8[np.ndarray, "h w 3"], ...]
    landmarks: tuple[Landmarks2D | None, ...]
    """N(F*) in every view; None where the detector found no face."""
    appearance: Appearance
    """As the solver believes it: tint, direction and strength of the light are somewhat wrong."""

    def observation(self, index: int = 0, views: int = 1) -> FrameObservation:
        """The frame as a tracker would bring it, with the landmarks of so many views."""
        around = tuple(map(seen_around, self.pictures[:views], self.landmarks[:views]))
        return FrameObservation(
            index, self.landmarks[0], IMAGE_SIZE, others=self.landmarks[1:views], surroundings=around
        )

    def context(self, identity: Float[np.ndarray, "i"] | None = None) -> FrameContext:
        """What the solve is given of the person: his own identity unless another is passed."""
        known = np.asarray(self.parameters.identity, float) if identity is None else identity
        return FrameContext(0, known, None, None, self.appearance)


class DeepScenes:
    """Makes frames of one model; each seed is another person."""

    def __init__(self, head: FaceModel):
        self.head = head
        self.camera = camera_from_fov(IMAGE_SIZE, FOV_DEG)
        self._model: RenderModel = render_model(head)
        self._detector = NetworkDetector()

    def frame(
        self, seed: int, jaw_deg: tuple[float, float] = (0.0, 18.0), views_deg: tuple[float, ...] = (0.0,)
    ) -> DeepTruth:
        """A person 25° and 40 px off the start, his jaw open by an angle within `jaw_deg`, three shapes of the mouth
        and one of brows, eyes, cheeks or nose; seen by cameras at these angles about the start."""
        rng = np.random.default_rng(seed)
        parameters = self._parameters(rng, jaw_deg)
        albedo = np.clip(np.asarray(self._model.colors) * rng.uniform(0.85, 1.1, 3), 0.0, 1.0)
        direction, strength, ambient = _light_of(rng)
        light = ambient_light(ambient) + directional_light(tuple(direction), strength)
        pictures = []
        for view in make_rig(views_deg).views if len(views_deg) > 1 else (None,):
            vertices, turned = face_vertices(self._model, parameters), np.eye(3)
            if view is not None:
                turned = view.rotation_view_world
                vertices = vertices @ turned.T.astype(np.float32) + view.translation_view_world_mm.astype(np.float32)
            pictures.append(self._photo(vertices, albedo, turned_light(light, turned), rng))
        believed = Appearance(
            (albedo * rng.normal(1.0, 0.03, 3)).clip(0.0, 1.0).astype(np.float32),
            _believed_light(direction, strength, ambient, rng),
            np.ones(len(albedo)),
            0.0,
        )
        return DeepTruth(parameters, tuple(pictures), tuple(self._seen(picture) for picture in pictures), believed)

    def _parameters(self, rng: np.random.Generator, jaw_deg: tuple[float, float]) -> FaceParameters:
        turn = rng.uniform(-1.0, 1.0, 3) * np.radians(LARGEST_DEG)
        rotation = (Rotation.from_euler("y", turn[0]) * Rotation.from_euler("xz", turn[1:])).as_rotvec()
        rotation *= np.radians(ANGLE_DEG) / np.linalg.norm(rotation)
        depth = rng.uniform(550.0, 750.0)
        offset = rng.normal(size=2)
        offset *= OFFSET_PX / np.linalg.norm(offset) * depth / float(self.camera.focal_px[0])
        names = np.array(self.head.expression_names)
        in_mouth = np.char.startswith(names, "mouth")
        expression = np.zeros(len(names))
        expression[rng.choice(np.flatnonzero(in_mouth), 3, replace=False)] = rng.uniform(0.1, 0.6, 3)
        close = list(names).index("mouthClose")
        jaw = np.zeros(6)
        jaw[0] = np.radians(rng.uniform(*jaw_deg))
        expression[close] = min(
            expression[close], jaw[0] / self.head.jaw_unit.vector[0]
        )  # it closes what the jaw opens
        upper = np.flatnonzero(~in_mouth & ~np.char.startswith(names, "jaw"))
        expression[rng.choice(upper)] = rng.uniform(0.0, 0.5)
        parts = (rotation, np.append(offset, depth), expression, rng.normal(0.0, 0.8, len(self.head.identity_deltas)))
        return FaceParameters(*(jnp.asarray(part, float) for part in (*parts, jaw, np.ones(1))))

    def _photo(self, vertices, albedo, light, rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
        seen = render(
            vertices,
            self._model.topology,
            Camera(*(jnp.asarray(part, jnp.float32) for part in self.camera)),
            jnp.asarray(albedo, jnp.float32),
            jnp.asarray(light, jnp.float32),
            jnp.asarray(_background(rng), jnp.float32),
            size=IMAGE_SIZE,
            samples=3,
        )
        picture = cv2.GaussianBlur(np.asarray(seen.color, np.float32), (0, 0), rng.uniform(0.5, 1.2))
        picture = picture + rng.normal(0.0, rng.uniform(0.005, 0.02), picture.shape)
        pixels = np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)
        _, stored = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(70, 95))])
        return cv2.imdecode(stored, cv2.IMREAD_COLOR)

    def _seen(self, picture: UInt8[np.ndarray, "h w 3"]) -> Landmarks2D | None:
        faces = self._detector.detect_faces(picture)
        if not faces:
            return None
        return photo_landmarks(energy_network(NETWORK), picture, self._detector.align(picture, faces[0].box))


@cache
def make_rig(angles_deg: tuple[float, ...]) -> Rig:
    """Cameras on a circle about the frontal start; the world's frame is that of a camera at 0°."""
    camera = camera_from_fov(IMAGE_SIZE, FOV_DEG)
    middle = np.array([0.0, 0.0, START_MM])
    views = []
    for angle in angles_deg:
        turned = Rotation.from_euler("y", angle, degrees=True).as_matrix()
        views.append(View(f"at {angle:g}°", IMAGE_SIZE, camera, turned, middle - turned @ middle))
    return Rig(tuple(views))


def rotation_error_deg(found: Float[np.ndarray, "3"], true: Float[np.ndarray, "3"]) -> float:
    """Angle between two rotations."""
    turn = Rotation.from_rotvec(np.array(found, float)).inv() * Rotation.from_rotvec(np.array(true, float))
    return float(np.degrees(turn.magnitude()))


def rotation_as_seen(parameters: FaceParameters) -> Float[np.ndarray, "3"]:
    """The rotation against the ray to the head instead of the camera's axis: what a parallel view can tell."""
    ray = np.asarray(parameters.translation, float)
    axis = np.cross(ray, [0.0, 0.0, 1.0])
    sine = np.linalg.norm(axis) / np.linalg.norm(ray)
    upright = Rotation.from_rotvec(axis / max(np.linalg.norm(axis), 1e-12) * np.arcsin(sine))
    return (upright * Rotation.from_rotvec(np.array(parameters.rotation, float))).as_rotvec()


def _light_of(rng: np.random.Generator) -> tuple[np.ndarray, float, float]:
    """Direction, its strength and the ambient part of a light from the camera's side."""
    direction = rng.normal(0.0, 1.0, 3) * (0.7, 0.4, 0.2) + (0.0, -0.3, -1.0)
    return direction, float(rng.uniform(0.25, 0.5)), float(rng.uniform(0.45, 0.65))


def _believed_light(direction, strength: float, ambient: float, rng) -> Float[np.ndarray, "9 3"]:
    axis = rng.normal(size=3)
    wrong = Rotation.from_rotvec(np.radians(LIGHT_ERROR_DEG) * axis / np.linalg.norm(axis)).apply(direction)
    ambient, strength = ambient * rng.uniform(0.9, 1.1), strength * rng.uniform(0.8, 1.2)
    return ambient_light(ambient) + directional_light(tuple(wrong), strength)


def _background(rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    """Soft coloured blotches of three sizes."""
    width, height = IMAGE_SIZE
    made = np.zeros((height, width, 3))
    for cells in (3, 8, 24):
        coarse = rng.normal(0.0, 1.0, (cells, cells, 3)).astype(np.float32)
        made += cv2.resize(coarse, IMAGE_SIZE, interpolation=cv2.INTER_CUBIC)
    return np.clip(rng.uniform(0.2, 0.7, 3) + 0.07 * made, 0.0, 1.0)
