"""Short films of people whose every parameter is known, for the benchmarks of infill and refinement.

The film is painted by another renderer (VTK, with a skin texture, hair and shine) than the workbench's own, on a still
background, with the camera's noise and JPEG's losses; the face is that of a random person, whose shape the solver is
given, as the paper gives the actor's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.config import Config, preset
from workbench.face import FaceModel, FaceParameters, load_default_head
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures.extras import Extras
from workbench.pictures.head_scene import HeadScene
from workbench.pictures.mesh import to_camera
from workbench.planning import plan_of
from workbench.tracking import FrameFit
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.fitting import FrameContext, FrameObservation
from workbench.tracking.flow_fitter import FlowFitter
from workbench.training.accessories import hair
from workbench.training.scenes import random_lighting
from workbench.training.skin import skin_painter

SIZE = (480, 360)
FOV_DEG = 40.0
DEPTH_MM = 620.0
MOTIONS = ("mouth", "blink", "nod")
EVENT = 12
"""Frame about which each film's sudden motion happens."""
FRAMES = 24


@dataclass(frozen=True, eq=False)
class Film:
    """A person's film and its truth."""

    pictures: list[UInt8[np.ndarray, "h w 3"]]
    truth: list[FrameFit]
    """Every frame as a perfect fit would record it."""
    identity: Float[np.ndarray, "i"]


def config() -> Config:
    """What the films are solved with: FACE IT!, the camera known."""
    return preset("joint").changed(camera={"fov_deg": FOV_DEG})


def weights_at(motion: str, time: float) -> tuple[dict[str, float], Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Blendshapes, yaw, pitch and roll in degrees and place in millimetres; time in frames from the event."""
    sway = np.array([6.0 * np.sin(0.21 * time), 2.0 * np.sin(0.16 * time + 1.0), 2.0 * np.sin(0.12 * time)])
    place = np.array([8.0 * np.sin(0.15 * time), 5.0 * np.sin(0.11 * time + 0.5), DEPTH_MM + 6.0 * np.sin(0.1 * time)])
    weights = {"mouthSmileLeft": 0.15 + 0.1 * np.sin(0.2 * time), "mouthSmileRight": 0.15 + 0.1 * np.sin(0.2 * time)}
    if motion == "mouth":  # held open, then shut within two frames
        open_ = float(np.interp(time, [0.0, 1.0, 2.0], [1.0, 0.2, 0.0]))
        weights |= {"jawOpen": 0.6 * open_, "mouthFunnel": 0.25 * open_}
    if motion == "blink":  # two frames down, one closed, two up
        closed = float(np.clip(1.5 - abs(time) / 1.5, 0.0, 1.0))
        weights |= {"eyeBlinkLeft": closed, "eyeBlinkRight": closed}
    if motion == "nod":  # down and up again within seven frames
        sway[1] -= 14.0 * float(np.exp(-0.5 * (time / 1.6) ** 2))
    return weights, sway, place


def talking_at(time: float) -> tuple[dict[str, float], Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Ordinary speech: as `weights_at`, without a sudden event."""
    _, sway, place = weights_at("", time)
    return (
        {
            "jawOpen": 0.22 + 0.2 * np.sin(0.75 * time),
            "mouthFunnel": 0.15 + 0.15 * np.sin(0.43 * time + 1.0),
            "mouthSmileLeft": 0.2 + 0.15 * np.sin(0.31 * time),
            "mouthSmileRight": 0.2 + 0.15 * np.sin(0.29 * time),
            "browInnerUp": 0.2 + 0.2 * np.sin(0.17 * time),
        },
        sway,
        place,
    )


class MovingPeople:
    """Makes films; owns a GL context, so it is used in one thread."""

    def __init__(self, head: FaceModel | None = None):
        self.head = load_default_head() if head is None else head
        self.camera = Camera(*(np.asarray(part, float) for part in camera_from_fov(SIZE, FOV_DEG)))
        blank = np.full((8, 8, 3), 255, np.uint8)
        self._scene = HeadScene(self.head, SIZE, blank, supersampling=1.6, fade_neck=False)
        self._painter = skin_painter(self.head)
        self.fitter = FlowFitter(self.head, plan_of(config()))
        self._frames = FaceItFitter(self.head, plan_of(config()))

    def film(self, seed: int, motion: Callable[[float], tuple], frames: int = FRAMES) -> Film:
        """A random person who moves as `motion` says for a time in frames from `EVENT`."""
        rng = np.random.default_rng(seed)
        identity = rng.normal(0.0, 0.8, len(self.head.identity_deltas))
        person = self.head.personal(identity)
        albedo, hair_color = self._painter.paint(rng)
        mesh = hair(person.neutral, self.head, hair_color, rng)
        self._scene.set_texture(albedo)
        self._scene.set_shine(rng.uniform(0.0, 0.2), rng.uniform(6, 40))
        lighting, background = random_lighting(rng), _background(rng)
        pictures, truth = [], []
        for index in range(frames):
            named, angles, place = motion(float(index - EVENT))
            expression = np.zeros(len(self.head.expression_names))
            for name, weight in named.items():
                expression[self.head.expression_names.index(name)] = weight
            rotation = axis_angle_from_yaw_pitch_roll(angles)
            points = to_camera(person.vertices(expression), rotation, place)
            rgba = self._scene.render(points, self.camera, lighting, Extras(meshes=(mesh,)), (rotation, place))
            pictures.append(_photo(rgba, background, rng))
            parameters = FaceParameters(rotation, place, expression, identity, np.zeros(6), np.ones(1))
            truth.append(self.record(index, parameters))
        return Film(pictures, truth, identity)

    def record(self, index: int, parameters: FaceParameters) -> FrameFit:
        """A fit that says these parameters, its landmarks the model's own."""
        empty, _ = self._frames.fit(
            FrameObservation(index, None, SIZE), FrameContext(0, parameters.identity, None, None)
        )
        like = FrameFit(
            **{**vars(empty), "identity": np.asarray(parameters.identity, float), "found": True, "source": "given"}
        )
        placed = self.fitter.placed(like, parameters)
        return FrameFit(**{**vars(placed), "observed": placed.projected, "confidence": np.ones(68)})

    def detected(self, fit: FrameFit, noise_percent: float, rng: np.random.Generator) -> FrameFit:
        """FACE IT!'s own fit to the true landmarks with a detector's noise, percent of the eye distance."""
        eyes = np.linalg.norm(fit.observed[45] - fit.observed[36])
        points = fit.observed + rng.normal(0.0, 0.01 * noise_percent * eyes, (68, 2))
        observation = FrameObservation(fit.index, Landmarks2D(points, np.ones(68), SIZE), SIZE)
        return self._frames.fit(observation, FrameContext(0, fit.identity, None, None))[0]

    def close(self) -> None:
        """Give the GL context back."""
        self._scene.close()


def landmark_error(fit: FrameFit, truth: FrameFit) -> float:
    """Mean distance of the 68 landmarks from the true ones, percent of the outer-eye distance."""
    eyes = np.linalg.norm(truth.projected[45] - truth.projected[36])
    return float(100.0 * np.linalg.norm(fit.projected - truth.projected, axis=1).mean() / eyes)


def _background(rng: np.random.Generator) -> Float[np.ndarray, "h w 3"]:
    coarse = rng.uniform(0.1, 0.9, (5, 7, 3)).astype(np.float32)
    return cv2.resize(coarse, SIZE, interpolation=cv2.INTER_CUBIC).clip(0.0, 1.0)


def _photo(rgba, background, rng: np.random.Generator) -> UInt8[np.ndarray, "h w 3"]:
    seen = rgba[..., :3] / 255.0 + (1.0 - rgba[..., 3:] / 255.0) * background
    seen = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), 0.6) + rng.normal(0.0, 0.012, seen.shape)
    pixels = np.round(255.0 * np.clip(seen, 0.0, 1.0)).astype(np.uint8)
    _, stored = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    return cv2.imdecode(stored, cv2.IMREAD_COLOR_RGB)
