"""The four calls that fit a frame, the same for both systems: problem, solve, record, hand on.

A fitter knows nothing of the order of frames: the previous frame enters through the context (`walk.py`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters
from workbench.geometry import Camera
from workbench.rendering import Appearance
from workbench.tracking.observation import FrameObservation
from workbench.tracking.plan import Plan
from workbench.tracking.records import FrameFit
from workbench.tracking.unwatched import never

BY_HAND_PX = 1.0
"""Standard deviation of a point that somebody put in its place."""


class Continuation(NamedTuple):
    """The state that one frame hands to the next."""

    parameters: FaceParameters
    pose: Float[AnyArray, "6"]
    last_pose: Float[AnyArray, "6"]
    frames: int
    """Frames since the restart, including this one."""
    points: Float[np.ndarray, "points 2"]


class FrameContext(NamedTuple):
    """Everything that a frame is fitted from, besides its observation."""

    shot: int
    identity: Float[np.ndarray, "i"]
    start: FaceParameters | None
    """Result of the calibration for this frame, if it was used there."""
    last: Continuation | None
    """State of the previous frame; None at the start of a shot and after a gap or a jump."""
    appearance: Appearance | None = None
    """Colours and light of the shot, for renders."""


class Calibrated(NamedTuple):
    """Identity of a shot, and the calibration's result for each frame that it used."""

    identity: Float[np.ndarray, "i"]
    starts: dict[int, FaceParameters]
    """By frame index."""
    appearance: Appearance | None = None


class StageTrace(NamedTuple):
    """Every iteration of one stage; row 0 is the start."""

    stage: str
    energies: Float[np.ndarray, "steps t"]
    """Weighted energy of each term of the plan (`Plan.terms`)."""
    residuals_px: Float[np.ndarray, "steps points"]
    """Distance of each model landmark from the observed one."""


@dataclass(frozen=True)
class FrameProblem:
    """A frame ready to be solved; each system's subclass adds the input of its solver."""

    observation: FrameObservation
    context: FrameContext


@dataclass(frozen=True)
class FrameSolution:
    """The solution of a problem; each system's subclass adds the results of its stages."""

    problem: FrameProblem


class Fitter(ABC):
    """Fits frames in their context. Holds the arrays of one model and one plan, but no state between frames."""

    renders: ClassVar[bool]
    """Whether a solution holds every step of every stage with its renders, so that one solve gives fit, path and
    pictures."""
    model: FaceModel
    plan: Plan

    @abstractmethod
    def configure(self, plan: Plan) -> None:
        """Use another plan from now on."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the energy's terms."""
        return self.plan.terms

    @property
    @abstractmethod
    def links_frames(self) -> bool:
        """Whether a frame depends on the previous one."""

    @property
    @abstractmethod
    def calibrates(self) -> bool:
        """Whether a shot is calibrated before its frames are fitted."""

    @abstractmethod
    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera of the (reference) view for pictures of this size."""

    @abstractmethod
    def calibrate(self, observations: Sequence[FrameObservation], frames: int) -> Calibrated:
        """The data shared by a shot, from up to `frames` of these. Raises `InputError` if none has landmarks."""

    @abstractmethod
    def neutral_observation(self, image_size: tuple[int, int]) -> FrameObservation:
        """A perfect detector's observation of the neutral face in front of this camera."""

    @abstractmethod
    def warm_up(self, image_size: tuple[int, int], trace: bool = False) -> None:
        """Compile (or load from the cache) the programs of a fit, and those of `explain` if asked for."""

    @abstractmethod
    def problem(self, observation: FrameObservation, context: FrameContext) -> FrameProblem:
        """The solver's input for a frame."""

    @abstractmethod
    def solve(self, problem: Any, traced: bool = False, cancelled: Callable[[], bool] = never) -> FrameSolution:
        """Run all stages in order. `traced` keeps every iteration; `cancelled` is checked where a solver can stop."""

    @abstractmethod
    def record(self, solution: Any) -> FrameFit:
        """The solution as a record for tables, pictures and exports."""

    @abstractmethod
    def hand_on(self, solution: Any) -> Continuation | None:
        """The state that a solved frame hands to the next one; None if frames are not linked."""

    @abstractmethod
    def traces(self, solution: Any) -> tuple[StageTrace, ...]:
        """The iterations of a traced solution, by stage."""

    @abstractmethod
    def stopped(self, solution: Any, steps: int) -> FrameSolution:
        """A traced solution after `steps` iterations, counted across all stages."""

    def appearance(
        self, observations: Sequence[FrameObservation], identity: Float[np.ndarray, "i"]
    ) -> Appearance | None:
        """Colours and light of a shot for renders; None if nothing is rendered."""
        return None

    def mean_identity(self) -> Float[np.ndarray, "i"]:
        """The identity used if none is calibrated."""
        return np.zeros(len(self.model.identity_deltas))

    def fit(
        self, observation: FrameObservation, context: FrameContext, cancelled: Callable[[], bool] = never
    ) -> tuple[FrameFit, Continuation | None]:
        """The fit of a frame, and the state for the next one."""
        solution = self.solve(self.problem(observation, context), cancelled=cancelled)
        return self.record(solution), self.hand_on(solution)

    def explain(self, observation: FrameObservation, context: FrameContext) -> tuple[FrameFit, tuple[StageTrace, ...]]:
        """The fit with every iteration of every stage kept. Raises `InputError` for a frame without landmarks."""
        solution = self.solve(self.problem(with_face(observation), context), traced=True)
        return self.record(solution), self.traces(solution)


def landmarks_of_others(observation: FrameObservation) -> Float[np.ndarray, "o 68 3"]:
    """The other views' landmarks as a record holds them: x and y in pixels, and confidence; 0 without a face."""
    found = np.zeros((len(observation.others), 68, 3))
    for row, landmarks in zip(found, observation.others, strict=True):
        if landmarks is not None:
            row[:, :2], row[:, 2] = landmarks.points, landmarks.confidence
    return found


def check_scheme(observation: FrameObservation, model: FaceModel) -> None:
    """Raise `InputError` if a frame's landmarks are of another scheme than the model's."""
    if observation.landmarks is None or observation.landmarks.scheme is model.scheme:
        return
    found = observation.landmarks.scheme
    raise InputError(
        f"The landmarks of frame {observation.index} are the {len(found)} of {found.name!r}, those of the face model "
        f"the {len(model.scheme)} of {model.scheme.name!r}; pass face.in_scheme(model, landmarks.scheme)."
    )


def with_face(observation: FrameObservation) -> FrameObservation:
    """The observation. Raises `InputError` if it has no landmarks."""
    if observation.landmarks is None:
        raise InputError(f"Frame {observation.index} has no landmarks; choose a frame with a face.")
    return observation


def corrected(observation: FrameObservation, moved: Mapping[int, tuple[float, float]]) -> FrameObservation:
    """The observation with manually corrected detections, by point; these get full confidence (`BY_HAND_PX`)."""
    if not moved or observation.landmarks is None:
        return observation
    points, confidence = observation.landmarks.points.copy(), observation.landmarks.confidence.copy()
    moved = {point: place for point, place in moved.items() if point < len(points)}
    for point, place in moved.items():
        points[point], confidence[point] = place, 1.0
    covariance = observation.landmarks.covariance
    if covariance is not None:
        covariance = covariance.copy()
        covariance[list(moved)] = BY_HAND_PX**2 * np.eye(2)
    moved_there = replace(observation.landmarks, points=points, confidence=confidence, covariance=covariance)
    return replace(observation, landmarks=moved_there)


def continued(
    parameters: FaceParameters,
    pose: Float[AnyArray, "6"],
    last: Continuation | None,
    points: Float[np.ndarray, "points 2"],
) -> Continuation:
    """The state that a fitted frame hands to the next one; `last` is the state it received."""
    before = pose if last is None else last.pose
    return Continuation(parameters, pose, before, 1 if last is None else last.frames + 1, points)
