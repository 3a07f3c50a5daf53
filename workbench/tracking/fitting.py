"""The four calls that fit a frame, the same for both systems: problem, solve, record, hand on.

A fitter knows of no order of frames. What came before a frame reaches it by the frame's context (`walk.py`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from workbench.arrays import AnyArray
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters
from workbench.geometry import Camera
from workbench.landmarks.observations import Landmarks2D
from workbench.rendering import Appearance
from workbench.tracking.plan import Plan
from workbench.tracking.records import FrameFit


@dataclass(frozen=True)
class FrameObservation:
    """What a frame brings to the tracker."""

    index: int
    landmarks: Landmarks2D | None
    image_size: tuple[int, int]
    source: str = "given"
    cut: bool = False
    """Whether this frame starts a new shot."""
    milliseconds: tuple[float, float] = (0.0, 0.0)
    """Time that detection and landmarks took."""
    picture: UInt8[np.ndarray, "h w 3"] | None = None
    """RGB, where the fit wants it: Deep Energies takes colours and light from one."""
    others: tuple[Landmarks2D | None, ...] = ()
    """Landmarks in the other views of a rig, in its order; None where that view found no face."""

    @property
    def faces(self) -> bool:
        """Whether any view shows a face."""
        return any(landmarks is not None for landmarks in (self.landmarks, *self.others))


class Continuation(NamedTuple):
    """What one frame hands to the next."""

    parameters: FaceParameters
    pose: Float[AnyArray, "6"]
    last_pose: Float[AnyArray, "6"]
    frames: int
    """Frames since the restart, this one included."""
    points: Float[np.ndarray, "68 2"]


class FrameContext(NamedTuple):
    """What a frame is fitted from, besides its observation."""

    shot: int
    identity: Float[np.ndarray, "i"]
    start: FaceParameters | None
    """Where the calibration left this frame, if it was one of its frames."""
    last: Continuation | None
    """The frame before; None where a shot, or the face after a gap or a jump, begins."""
    appearance: Appearance | None = None
    """Colours and light of the shot, for renders."""


class Calibrated(NamedTuple):
    """Identity of a shot, and where its calibration left the frames that it used."""

    identity: Float[np.ndarray, "i"]
    starts: dict[int, FaceParameters]
    """By frame index."""
    appearance: Appearance | None = None


class StageTrace(NamedTuple):
    """Every iteration of one stage; row 0 is the start."""

    stage: str
    energies: Float[np.ndarray, "steps t"]
    """Weighted energy of each term of the plan (`Plan.terms`)."""
    residuals_px: Float[np.ndarray, "steps 68"]
    """Distance of each model landmark from the observed one."""


@dataclass(frozen=True)
class FrameProblem:
    """A frame ready to be solved; each system's own adds what its solver takes."""

    observation: FrameObservation
    context: FrameContext


@dataclass(frozen=True)
class FrameSolution:
    """What the stages made of a problem; each system's own adds their results."""

    problem: FrameProblem


def never() -> bool:
    """Nobody cancels."""
    return False


class Fitter(ABC):
    """Fits frames in their context. Holds the arrays of one model and one plan, no order of frames."""

    renders: ClassVar[bool]
    """Whether a solution holds every step of every stage with its renders, so that one solve serves fit, path and
    pictures."""
    model: FaceModel
    plan: Plan

    @abstractmethod
    def configure(self, plan: Plan) -> None:
        """Follow another plan from now on."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the energy's terms."""
        return self.plan.terms

    @property
    @abstractmethod
    def links_frames(self) -> bool:
        """Whether a frame depends on the one before."""

    @property
    @abstractmethod
    def calibrates(self) -> bool:
        """Whether a shot is looked at before its frames are fitted."""

    @abstractmethod
    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera of the (reference) view for pictures of this size."""

    @abstractmethod
    def calibrate(self, observations: Sequence[FrameObservation], frames: int) -> Calibrated:
        """What a shot's frames share, from up to `frames` of these. Raises `InputError` if none has landmarks."""

    @abstractmethod
    def neutral_observation(self, image_size: tuple[int, int]) -> FrameObservation:
        """What a perfect detector would see of the neutral face in front of this camera."""

    @abstractmethod
    def warm_up(self, image_size: tuple[int, int], trace: bool = False) -> None:
        """Compile (or load from the cache) the programs of a fit, and those of `explain` if asked for."""

    @abstractmethod
    def problem(self, observation: FrameObservation, context: FrameContext) -> FrameProblem:
        """What the solver is given of a frame."""

    @abstractmethod
    def solve(self, problem: Any, traced: bool = False, cancelled: Callable[[], bool] = never) -> FrameSolution:
        """All stages in order. `traced` keeps every iteration; `cancelled` is asked where a solver can stop."""

    @abstractmethod
    def record(self, solution: Any) -> FrameFit:
        """A solution as what tables, pictures and exports read."""

    @abstractmethod
    def hand_on(self, solution: Any) -> Continuation | None:
        """What a solved frame leaves to the next one; None where nothing links them."""

    @abstractmethod
    def traces(self, solution: Any) -> tuple[StageTrace, ...]:
        """The iterations of a traced solution, by stage."""

    @abstractmethod
    def stopped(self, solution: Any, steps: int) -> FrameSolution:
        """A traced solution as it stood after `steps` iterations, counted through all stages."""

    def appearance(
        self, observations: Sequence[FrameObservation], identity: Float[np.ndarray, "i"]
    ) -> Appearance | None:
        """Colours and light of a shot for renders; None where nothing is rendered."""
        return None

    def mean_identity(self) -> Float[np.ndarray, "i"]:
        """The identity used where none is calibrated."""
        return np.zeros(len(self.model.identity_deltas))

    def fit(
        self, observation: FrameObservation, context: FrameContext, cancelled: Callable[[], bool] = never
    ) -> tuple[FrameFit, Continuation | None]:
        """The fit of a frame, and what it hands to the next one."""
        solution = self.solve(self.problem(observation, context), cancelled=cancelled)
        return self.record(solution), self.hand_on(solution)

    def explain(self, observation: FrameObservation, context: FrameContext) -> tuple[FrameFit, tuple[StageTrace, ...]]:
        """The fit with every iteration of every stage kept. Raises `InputError` for a frame without landmarks."""
        solution = self.solve(self.problem(with_face(observation), context), traced=True)
        return self.record(solution), self.traces(solution)


def with_face(observation: FrameObservation) -> FrameObservation:
    """The observation. Raises `InputError` if it has no landmarks."""
    if observation.landmarks is None:
        raise InputError(f"Frame {observation.index} has no landmarks; explain a frame with a face.")
    return observation


def corrected(observation: FrameObservation, moved: Mapping[int, tuple[float, float]]) -> FrameObservation:
    """The observation with the detections that were put right by hand, by point; these count as certain."""
    if not moved or observation.landmarks is None:
        return observation
    points, confidence = observation.landmarks.points.copy(), observation.landmarks.confidence.copy()
    for point, place in moved.items():
        points[point], confidence[point] = place, 1.0
    return replace(observation, landmarks=replace(observation.landmarks, points=points, confidence=confidence))


def continued(
    parameters: FaceParameters,
    pose: Float[AnyArray, "6"],
    last: Continuation | None,
    points: Float[np.ndarray, "68 2"],
) -> Continuation:
    """What a fitted frame hands to the next one; `last` is what it was handed itself."""
    before = pose if last is None else last.pose
    return Continuation(parameters, pose, before, 1 if last is None else last.frames + 1, points)
