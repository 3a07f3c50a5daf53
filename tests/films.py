"""Small films whose every parameter is known: the default head with speckled skin before a plain background."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from workbench.config import Config, preset
from workbench.face import FaceModel, FaceParameters
from workbench.frames import Frame
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, camera_from_fov
from workbench.landmarks.observations import Landmarks2D
from workbench.planning import plan_of
from workbench.rendering import ambient_light, directional_light, render_face, render_model
from workbench.tracking import FaceItFitter, FrameContext, FrameFit, FrameObservation
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.moments import Moment

SIZE = (240, 200)
FOV_DEG = 40.0
DEPTH_MM = 480.0


def film_config(**changes) -> Config:
    """FACE IT! with the films' camera, flow on small cut-outs."""
    sections = {"camera": {"fov_deg": FOV_DEG}, "flow": {"side": 192, "points": 300}}
    for name, values in changes.items():
        sections[name] = {**sections.get(name, {}), **values}
    return preset("joint").changed(**sections)


@dataclass(frozen=True, eq=False)
class Film:
    """Pictures and the fits that a perfect solver would record."""

    pictures: tuple[np.ndarray, ...]
    truth: tuple[FrameFit, ...]

    def moments(self, fits: Sequence[FrameFit] | None = None) -> list[Moment]:
        """The frames as the passes over time take them."""
        fits = self.truth if fits is None else fits
        return [Moment(fit, (picture,)) for fit, picture in zip(fits, self.pictures, strict=True)]

    def frames(self):
        """The pictures as an opened stream."""
        return PictureList(self.pictures)


class PictureList:
    """Pictures in memory as `Frames`."""

    kind, name, rate = "video", "film", 25.0

    def __init__(self, pictures):
        self._pictures = pictures
        self.announced_count, self.notes = len(pictures), []
        self.image_size = pictures[0].shape[1::-1]

    def iterate(self, start: int = 0):
        """As `Frames.iterate`."""
        for index in range(start, len(self._pictures)):
            yield Frame(index, self._pictures[index], index / self.rate, f"film-{index}")


class FilmMaker:
    """Makes films of one head and what a detector and FACE IT! make of them."""

    def __init__(self, head: FaceModel):
        self.head = head
        self.flow = FlowFitter(head, plan_of(film_config()))
        self._frames = FaceItFitter(head, plan_of(film_config()))
        self._model = render_model(head)
        speckles = np.random.default_rng(1).uniform(0.75, 1.25, (len(head.neutral), 1))
        self._albedo = np.clip(np.asarray(self._model.colors) * speckles, 0.0, 1.0).astype(np.float32)

    def film(
        self, frames: int, motion: Callable[[int], tuple[dict[str, float], Sequence[float], Sequence[float]]]
    ) -> Film:
        """`motion` gives of a frame its weights by name, yaw, pitch and roll in degrees, and an offset in mm."""
        states = [self.state(*motion(index)) for index in range(frames)]
        pictures = tuple(self.picture(state) for state in states)
        return Film(pictures, tuple(self.perfect(index, state) for index, state in enumerate(states)))

    def state(self, named: dict[str, float], angles_deg, offset_mm) -> FaceParameters:
        """The head before the camera."""
        expression = np.zeros(len(self.head.expression_names))
        for name, weight in named.items():
            expression[self.head.expression_names.index(name)] = weight
        return FaceParameters(
            axis_angle_from_yaw_pitch_roll(np.asarray(angles_deg, float)),
            np.array([0.0, 20.0, DEPTH_MM]) + offset_mm,
            expression,
            np.zeros(len(self.head.identity_deltas)),
            np.zeros(6),
            np.ones(1),
        )

    def picture(self, state: FaceParameters) -> np.ndarray:
        """The face as a camera sees it."""
        light = ambient_light(0.55) + directional_light((0.3, -0.4, -1.0), 0.45)
        camera = Camera(*(np.asarray(part, np.float32) for part in camera_from_fov(SIZE, FOV_DEG)))
        grey = np.full(3, 0.35, np.float32)
        seen = render_face(self._model, state, camera, self._albedo, light, grey, size=SIZE, samples=2)
        return np.round(255.0 * np.clip(np.asarray(seen.color), 0.0, 1.0)).astype(np.uint8)

    def perfect(self, index: int, state: FaceParameters) -> FrameFit:
        """The record of these parameters, its landmarks the model's own."""
        context = FrameContext(0, state.identity, None, None)
        empty, _ = self._frames.fit(FrameObservation(index, None, SIZE), context)
        like = replace(empty, found=True, source="detected", identity=np.asarray(state.identity, float))
        placed = self.flow.placed(like, state)
        return replace(placed, observed=placed.projected, confidence=np.ones(68))

    def detected(self, fit: FrameFit, noise_px: float, seed: int) -> FrameFit:
        """What FACE IT! makes of a frame's landmarks with a detector's noise."""
        points = fit.observed + np.random.default_rng(seed).normal(0.0, noise_px, (68, 2))
        observation = FrameObservation(fit.index, Landmarks2D(points, np.ones(68), SIZE), SIZE, "detected")
        return self._frames.fit(observation, FrameContext(0, fit.identity, None, None))[0]


def lost(fit: FrameFit) -> FrameFit:
    """The record of a frame in which the detector found nothing."""
    nothing = {
        name: np.full_like(getattr(fit, name), np.nan)
        for name in ("rotation", "translation", "expression", "observed", "confidence", "projected")
    }
    return replace(fit, found=False, source="none", **nothing)


def landmark_error_px(fit: FrameFit, truth: FrameFit) -> float:
    """Mean distance of the landmarks from the true ones."""
    return float(np.linalg.norm(fit.projected - truth.projected, axis=1).mean())
