"""What a diagnosis takes and what it leaves: the case of a frame, changes, reasons, pulls of groups, flags."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.config import Config, Stage
from workbench.landmarks.observations import Landmarks2D
from workbench.tracking import FrameContext, FrameFit, FrameObservation


@dataclass(frozen=True, eq=False)
class FrameCase:
    """One frame under diagnosis: what was observed, what it was fitted from, and what surrounds it."""

    observation: FrameObservation
    context: FrameContext
    config: Config
    shot: Sequence[FrameObservation] = ()
    """Observations of the shot around the frame, in order of time; empty for a photo. More frames say more."""
    picture: UInt8[np.ndarray, "h w 3"] | None = None
    """RGB; without it the diagnosis says less."""
    previous_picture: UInt8[np.ndarray, "h w 3"] | None = None
    """RGB picture of the frame before."""

    @property
    def before(self) -> FrameObservation | None:
        """The frame before, if the shot has it with landmarks."""
        return self._neighbour(-1)

    @property
    def after(self) -> FrameObservation | None:
        """The frame after, if the shot has it with landmarks."""
        return self._neighbour(+1)

    @cached_property
    def _by_index(self) -> dict[int, FrameObservation]:
        return {observation.index: observation for observation in self.shot}

    def _neighbour(self, step: int) -> FrameObservation | None:
        found = self._by_index.get(self.observation.index + step)
        return found if found is not None and found.landmarks is not None else None


@dataclass(frozen=True, eq=False)
class Change:
    """A proposed change, complete: apply it in one click, take it back by going to what was before."""

    label: str
    """An imperative for a button, as "Mute the jaw points"."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Sections for `Config.changed`; {} leaves the configuration."""
    landmarks: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    """New places of points of this frame, pixels, believed from now on; {} leaves the landmarks."""
    limits: Mapping[str, int] = field(default_factory=dict)
    """New iteration limits of stages by name."""
    calibrate: bool = False
    """Whether the identity of the shot must be calibrated again with the changed configuration."""
    identity: Float[np.ndarray, "i"] | None = None
    """The identity that was found so, where `calibrate` is set."""

    def apply_to(self, config: Config) -> Config:
        """The changed configuration; factors of landmarks are added to those that are there."""
        sections = dict(self.config)
        if "landmarks" in sections and "weights" in sections["landmarks"]:
            weights = {**config.landmarks.weights, **sections["landmarks"]["weights"]}
            sections["landmarks"] = {**sections["landmarks"], "weights": weights}
        if self.limits:
            stages: Sequence[Stage] = config.stages
            sections["stages"] = [
                {**stage.model_dump(), "limit": self.limits.get(stage.name, stage.limit)} for stage in stages
            ]
        return config.changed(**sections) if sections else config

    def moved(self, observation: FrameObservation) -> FrameObservation:
        """The observation with this change's points at their new places, with confidence 1."""
        if not self.landmarks:
            return observation
        points, confidence = observation.landmarks.points.copy(), observation.landmarks.confidence.copy()
        for index, place in self.landmarks.items():
            points[index], confidence[index] = place, 1.0
        return replace(observation, landmarks=Landmarks2D(points, confidence, observation.landmarks.image_size))

    def applied(self, context: FrameContext) -> FrameContext:
        """The context with this change's identity; a new identity or camera starts the pose afresh."""
        if self.identity is not None:
            context = context._replace(identity=self.identity)
        if self.calibrate:
            context = context._replace(last=None, start=None)
        return context


def moved_to(observation: FrameObservation, points: Float[np.ndarray, "68 2"]) -> FrameObservation:
    """The observation with other points."""
    landmarks = observation.landmarks
    return replace(observation, landmarks=Landmarks2D(points, landmarks.confidence, landmarks.image_size))


@dataclass(frozen=True, eq=False)
class Reason:
    """Why a frame may be bad, with evidence, and the change that was tried against it."""

    code: str
    title: str
    """Short, for users."""
    evidence: str
    """One or two plain sentences with numbers."""
    score: float
    """0 to 1: the share of what is unexplained that the change explains, times how specific the evidence is."""
    numbers: Mapping[str, float]
    change: Change | None
    before_percent: float
    """Mean distance (`measure`) without the change, in percent of the outer-eye distance."""
    after_percent: float
    """The same with the change, by a fit that was really made."""
    measure: str = "landmark error"
    """What the two numbers are: "landmark error" over the points that are still believed, or another distance."""


@dataclass(frozen=True, eq=False)
class GroupPull:
    """What one group of landmarks does to the fit: the fit without it, compared with the fit."""

    group: str
    rotation_deg: float
    """Angle between the two head rotations."""
    translation_mm: float
    """Distance between the two head positions."""
    weights: tuple[tuple[str, float], ...]
    """The largest changes of blendshape weights when the group is left out, by name."""
    distance_percent: float
    """Mean distance of the group's points from where the others predict them, % of the outer-eye distance."""
    offset_percent: Float[np.ndarray, "2"]
    """Mean offset vector (right, down) of the group from that prediction, in the same unit."""
    error_without_percent: float
    """Mean error over the other points in the fit without the group."""
    error_with_percent: float
    """Mean error over the other points in the fit with the group."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How well the landmarks and the priors fix pose and weights (posterior of the linearised problem)."""

    names: tuple[str, ...]
    """pitch, yaw, roll, x, y, depth, then the blendshapes."""
    covariance: Float[np.ndarray, "n n"]
    """Of axis-angle (radians), translation (mm) and weights; zero rows for weights that rest on a bound."""
    scatter: Float[np.ndarray, "n n"]
    """How fits of the same face with other landmark noise would scatter: priors draw the fits together, so this is
    less than the covariance."""
    noise_percent: float
    """Standard deviation of a landmark coordinate estimated from the residual, % of the outer-eye distance."""
    rotation_deg: Float[np.ndarray, "3"]
    """Standard deviations about the camera axes x, y, z (pitch, yaw, roll), degrees."""
    translation_mm: Float[np.ndarray, "3"]
    """Standard deviations along the camera axes."""
    weights: Float[np.ndarray, "k"]
    """Standard deviation of each blendshape weight; 0 where it rests on a bound."""
    on_bound: Bool[np.ndarray, "k"]
    condition: float
    """Condition number of JᵀJ (data and priors) over the free unknowns in units of 0.1 rad, 10 mm, 0.3 of a weight."""
    pairs: tuple[tuple[str, str, float], ...]
    """Unknowns that trade against each other, |correlation| > 0.9, strongest first."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything found about one frame."""

    reasons: tuple[Reason, ...]
    """Most convincing first; empty for an unremarkable frame."""
    leave_group_out: tuple[GroupPull, ...]
    uncertainty: Uncertainty
    fit: FrameFit
    """The fit under diagnosis."""
    flag: str = ""
    """Why `flag_frames` flagged the frame in its clip, in a few words; empty if it did not, or if none was run."""

    @property
    def summary(self) -> str:
        """One line."""
        if self.reasons:
            return self.reasons[0].title
        if self.flag:
            return f"None of the causes that were tried explains why the frame was flagged: {self.flag}"
        return "No reason found: the frame is unremarkable"


@dataclass(frozen=True, eq=False)
class FrameFlags:
    """A screen over a track: which frames deserve a diagnosis."""

    flagged: Bool[np.ndarray, "n"]
    severity: Float[np.ndarray, "n"]
    """0 (nothing) to 1."""
    text: tuple[str, ...]
    """Why, in a few words; empty where nothing is flagged."""
