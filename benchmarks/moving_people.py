"""Short films of people whose every parameter is known, for the benchmarks of infill and refinement.

The people are those of `workbench.reproduction.people`, drawn by another renderer than the workbench's own. The solver
is given each one's shape, as the paper gives the actor's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from workbench.config import Config, preset
from workbench.face import FaceModel, FaceParameters, load_default_head
from workbench.geometry import axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import outer_eye_distance
from workbench.planning import plan_of
from workbench.reproduction.people import FilmStudio, Motion
from workbench.tracking import FrameFit
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.fitting import FrameContext
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.observation import FrameObservation

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
        self._studio = FilmStudio(self.head, camera_from_fov(SIZE, FOV_DEG), SIZE)
        self.fitter = FlowFitter(self.head, plan_of(config()))
        self._frames = FaceItFitter(self.head, plan_of(config()))

    def film(self, seed: int, motion: Callable[[float], tuple], frames: int = FRAMES) -> Film:
        """A random person who moves as `motion` says for a time in frames from `EVENT`."""
        rng = np.random.default_rng(seed)
        who = self._studio.person(rng)
        moved = [motion(float(index - EVENT)) for index in range(frames)]
        expression = np.zeros((frames, len(self.head.expression_names)))
        for row, (named, _, _) in zip(expression, moved, strict=True):
            for name, weight in named.items():
                row[self.head.expression_names.index(name)] = weight
        rotation = axis_angle_from_yaw_pitch_roll(np.array([angles for _, angles, _ in moved]))
        place = np.array([place for _, _, place in moved])
        pictures = list(self._studio.film(who, Motion(rotation, place, expression), rng))
        truth = [
            self.record(k, FaceParameters(rotation[k], place[k], expression[k], who.identity, np.zeros(6), np.ones(1)))
            for k in range(frames)
        ]
        return Film(pictures, truth, who.identity)

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
        eyes = outer_eye_distance(fit.observed)
        points = fit.observed + rng.normal(0.0, 0.01 * noise_percent * eyes, (68, 2))
        observation = FrameObservation(fit.index, Landmarks2D(points, np.ones(68), SIZE), SIZE)
        return self._frames.fit(observation, FrameContext(0, fit.identity, None, None))[0]

    def close(self) -> None:
        """Give the GL context back."""
        self._studio.close()


def landmark_error(fit: FrameFit, truth: FrameFit) -> float:
    """Mean distance of the 68 landmarks from the true ones, percent of the outer-eye distance."""
    eyes = outer_eye_distance(truth.projected)
    return float(100.0 * np.linalg.norm(fit.projected - truth.projected, axis=1).mean() / eyes)
