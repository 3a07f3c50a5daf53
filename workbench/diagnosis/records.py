"""Input and results of a diagnosis: the case of a frame, changes, reasons, pulls of groups, flags."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.config import Config, Stage
from workbench.diagnosis.appearance import Pictures
from workbench.tracking import FrameContext, FrameFit, FrameObservation
from workbench.tracking.fitting import corrected


@dataclass(frozen=True, eq=False)
class FrameCase:
    """One frame under diagnosis: its observation, the context of its fit, and its neighbours."""

    observation: FrameObservation
    context: FrameContext
    config: Config
    shot: Sequence[FrameObservation] = ()
    """Observations of the shot around the frame, in time order; empty for a photo. More frames give more evidence."""
    picture: UInt8[np.ndarray, "h w 3"] | None = None
    """RGB; without it some causes cannot be tested."""
    previous_picture: UInt8[np.ndarray, "h w 3"] | None = None
    """RGB picture of the previous frame."""
    pictures: Pictures | None = None
    """The pictures of the shot, with which this one's sharpness, light and colours are compared."""

    @property
    def before(self) -> FrameObservation | None:
        """The previous frame, if the shot contains it with landmarks."""
        return self.observation_at(self.observation.index - 1)

    @property
    def after(self) -> FrameObservation | None:
        """The next frame, if the shot contains it with landmarks."""
        return self.observation_at(self.observation.index + 1)

    @cached_property
    def seen(self) -> dict[int, FrameObservation]:
        """The frames of the shot with landmarks, by index."""
        return {observation.index: observation for observation in self.shot if observation.landmarks is not None}

    def observation_at(self, index: int) -> FrameObservation | None:
        """A frame of the shot, if that contains it with landmarks."""
        return self.seen.get(index)


@dataclass(frozen=True, eq=False)
class Change:
    """A proposed change, which can be applied and undone in one click.

    Applied are the configuration, which holds in all frames, and the points of this frame. `calibrate` and `identity`
    tell a trial what a session's own calibration makes of the configuration.
    """

    label: str
    """Imperative label for a button, such as "Mute the jaw points"."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Sections for `Config.changed`; {} leaves the configuration unchanged."""
    landmarks: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    """New positions of points of this frame, pixels, with full confidence; {} leaves the landmarks unchanged."""
    limits: Mapping[str, int] = field(default_factory=dict)
    """New iteration limits of stages by name."""
    calibrate: bool = False
    """Whether the changed configuration calibrates the identity of the shot again."""
    identity: Float[np.ndarray, "i"] | None = None
    """The identity from that calibration, if `calibrate` is set."""

    def apply_to(self, config: Config) -> Config:
        """The changed configuration; landmark factors come after the existing ones, for later entries win."""
        sections = dict(self.config)
        if "landmarks" in sections and "weights" in sections["landmarks"]:
            added = sections["landmarks"]["weights"]
            kept = {name: factor for name, factor in config.landmarks.weights.items() if name not in added}
            sections["landmarks"] = {**sections["landmarks"], "weights": {**kept, **added}}
        if self.limits:
            stages: Sequence[Stage] = config.stages
            sections["stages"] = [
                {**stage.model_dump(), "limit": self.limits.get(stage.name, stage.limit)} for stage in stages
            ]
        return config.changed(**sections) if sections else config

    def moved(self, observation: FrameObservation) -> FrameObservation:
        """The observation with this change's points at their new positions, as if corrected by hand."""
        return corrected(observation, self.landmarks)

    def applied(self, context: FrameContext) -> FrameContext:
        """The context with this change's identity; a new identity or camera restarts the pose."""
        if self.identity is not None:
            context = context._replace(identity=self.identity)
        if self.calibrate:
            context = context._replace(last=None, start=None)
        return context


def moved_to(observation: FrameObservation, points: Float[np.ndarray, "points 2"]) -> FrameObservation:
    """The observation with other points."""
    return replace(observation, landmarks=replace(observation.landmarks, points=points))


@dataclass(frozen=True, eq=False)
class Reason:
    """Why a frame may be bad, with evidence and the change that was tried."""

    code: str
    title: str
    """Short title for users."""
    evidence: str
    """One or two plain sentences with numbers."""
    score: float
    """0 to 1: the fraction of the unexplained evidence that the change explains, times the evidence's specificity."""
    numbers: Mapping[str, float]
    change: Change | None
    before_percent: float
    """Mean distance (`measure`) without the change, in percent of the outer-eye distance."""
    after_percent: float
    """The same with the change, from an actual fit."""
    measure: str = "landmark error"
    """Meaning of the two numbers: "landmark error" over the points still trusted, or another distance."""


@dataclass(frozen=True, eq=False)
class GroupPull:
    """The effect of one landmark group: the fit without it compared with the full fit."""

    group: str
    rotation_deg: float
    """Angle between the two head rotations."""
    translation_mm: float
    """Distance between the two head positions."""
    weights: tuple[tuple[str, float], ...]
    """The largest changes of blendshape weights when the group is left out, by name."""
    distance_percent: float
    """Mean distance of the group's points from their prediction by the others, % of the outer-eye distance."""
    offset_percent: Float[np.ndarray, "2"]
    """Mean offset vector (right, down) of the group from that prediction, in the same unit."""
    error_without_percent: float
    """Mean error over the other points in the fit without the group."""
    error_with_percent: float
    """Mean error over the other points in the fit with the group."""


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """How well landmarks and priors determine pose and weights (posterior of the linearised problem)."""

    names: tuple[str, ...]
    """pitch, yaw, roll, x, y, depth, then the blendshapes."""
    covariance: Float[np.ndarray, "n n"]
    """Covariance of axis-angle (radians), translation (mm) and weights; zero rows for weights at a bound."""
    scatter: Float[np.ndarray, "n n"]
    """Covariance of fits to the same face with other landmark noise. Priors pull the fits together, so it is smaller
    than `covariance`."""
    noise_percent: float
    """Standard deviation of a landmark coordinate estimated from the residual, % of the outer-eye distance."""
    rotation_deg: Float[np.ndarray, "3"]
    """Standard deviations about the camera axes x, y, z (pitch, yaw, roll), degrees."""
    translation_mm: Float[np.ndarray, "3"]
    """Standard deviations along the camera axes."""
    weights: Float[np.ndarray, "k"]
    """Standard deviation of each blendshape weight; 0 if it is at a bound."""
    on_bound: Bool[np.ndarray, "k"]
    condition: float
    """Condition number of H (data and priors) over the free unknowns in units of 0.1 rad, 10 mm, 0.3 of a weight."""
    pairs: tuple[tuple[str, str, float], ...]
    """Unknowns that trade off against each other, |correlation| > 0.9, strongest first."""


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
    """Why `flag_frames` flagged the frame in its clip, in a few words; empty if it did not or was not run."""

    @property
    def summary(self) -> str:
        """A one-line summary."""
        if self.reasons:
            return self.reasons[0].title
        if self.flag:
            return f"None of the causes tried explains why the frame was flagged: {self.flag}"
        return "No reason found: the frame is unremarkable"


@dataclass(frozen=True, eq=False)
class FrameFlags:
    """The result of screening a track for frames that deserve a diagnosis."""

    flagged: Bool[np.ndarray, "n"]
    severity: Float[np.ndarray, "n"]
    """0 (not flagged) to 1."""
    text: tuple[str, ...]
    """Why a frame is flagged, in a few words; empty if it is not."""
