"""The frame under test: its fit, fits with changes, and one measure of the evidence that they leave unexplained.

The measure is Σ log(1 + (d/s)²) over the landmarks, with d the distance from the model and s the usual distance in the
shot: the logarithm of a heavy-tailed likelihood, in nats. The same is added for the distance of each landmark from its
position predicted by the motion of the picture (or by neighbouring frames). A landmark that a hypothesis doubts costs
at most a fixed price. All hypotheses are thus comparable: by what they explain minus what they cost. Fits take all
points of the landmark scheme as sessions do; those beyond the 68 count less in the measure (`FURTHER_SHARE`).
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from workbench.config import Config
from workbench.diagnosis.appearance import FaceLook, UsualLook, look_of, near
from workbench.diagnosis.innovation import UsualOffset, jump_of, usual_offsets
from workbench.diagnosis.picture_evidence import Blur, carried_by_flow, directional_blur, gradient_energy
from workbench.diagnosis.records import Change, FrameCase
from workbench.diagnosis.reference import ShotReference, between
from workbench.errors import StoppedError
from workbench.landmarks.scheme import POINT_COUNT, face_size
from workbench.planning import plan_of
from workbench.tracking import FaceItFitter, FrameContext, FrameFit, FrameObservation
from workbench.tracking.unwatched import never

DOUBTED = 3.0
"""Price of a landmark that a hypothesis assumes to be wrong, nats: an offset of about four typical distances."""
PARAMETER = 2.0
"""Price of a free parameter of a hypothesis, nats."""
MOTION_SHARE = 0.5
"""Weight of the evidence from motion, which is not independent because the detector uses motion too."""
SURE = 0.4
"""Usual confidence from which a lower one says something."""
FEWEST_CARRIED = 10
"""Landmarks with a known motion from which the picture's is told."""
FLOW_USUAL = 1.2
"""Factor on the usual motion deviation for points predicted by optical flow."""
FURTHER_SHARE = 0.05
"""What a point beyond the 68 counts beside one of them, as in the preset `dense`: neighbours err together."""


@dataclass(frozen=True, eq=False)
class Finding:
    """A hypothesis that was tested."""

    code: str
    title: str
    evidence: str
    """May name {before} and {after}: the errors that are told beside it, which depend on how the change is tried."""
    change: Change | None
    gain: float
    """Nats that it explains, minus its own price."""
    before_percent: float
    after_percent: float
    specificity: float = 1.0
    """Preference over other hypotheses that explain as much, 0 to 1."""
    direct: float = 0.0
    """Fixed score of conclusive evidence, whatever the fit shows."""
    numbers: dict[str, float] = field(default_factory=dict)
    measure: str = "landmark error"
    doubted: Bool[np.ndarray, "points"] | None = None
    outranks: tuple[str, ...] = ()
    """Codes of less specific hypotheses with the same explanation."""


class Trial:
    """One frame, its fit, and the changes tried on it."""

    def __init__(
        self,
        case: FrameCase,
        fitter: FaceItFitter,
        reference: ShotReference,
        afresh: bool = False,
        cancelled: Callable[[], bool] = never,
    ):
        """`afresh`: also try every fit without the previous frame, which may be wrong itself; the better one counts.

        Every fit raises `StoppedError` once `cancelled` returns true.
        """
        self.case, self._cancelled = case, cancelled
        self._afresh = afresh and case.context.last is not None
        self.reference = reference
        self.names = fitter.model.expression_names
        self.weights_from_0_to_1 = fitter.model.weights_from_0_to_1
        self.scheme = fitter.model.scheme
        self._fitter = copy.copy(fitter)
        self._fitter.configure(plan_of(case.config, self.scheme))
        self.points = case.observation.landmarks.points
        self.shares = shares_of(len(self.points))
        self.face_px = float(face_size(self.points))
        self._others: dict[bytes, tuple[Config, FaceItFitter]] = {}
        self.fit = self._best_fit(self._fitter, case.observation, case.context)

    def with_config(self, config: Config) -> "Trial":
        """The same frame under another configuration."""
        case = replace(self.case, config=config)
        return Trial(case, self._fitter, self.reference, afresh=True, cancelled=self._cancelled)

    # --- fits ---

    def refit(self, change: Change, context: FrameContext | None = None) -> FrameFit:
        """The fit with a change, exactly as a session would apply it."""
        context = change.applied(self.case.context if context is None else context)
        observation = change.moved(self.case.observation)
        return self._best_fit(self.fitter(change.apply_to(self.case.config), context), observation, context)

    def _best_fit(self, fitter: FaceItFitter, observation: FrameObservation, context: FrameContext) -> FrameFit:
        if self._cancelled():
            raise StoppedError(f"The diagnosis of frame {observation.index} was cancelled.")
        fit, _ = fitter.fit(observation, context)
        if not self._afresh or context.last is None:
            return fit
        again, _ = fitter.fit(observation, context._replace(last=None))
        return min(fit, again, key=lambda tried: self.total(self.residual_costs(tried)))

    def fitter(self, config: Config, context: FrameContext) -> FaceItFitter:
        """A fitter for this configuration; one is cached per identity."""
        key = np.asarray(context.identity).tobytes()
        followed, fitter = self._others.get(key, (None, None))
        if followed is not config:
            fitter = copy.copy(self._fitter) if fitter is None else fitter
            fitter.configure(plan_of(config, self.scheme))
            self._others[key] = (config, fitter)
        return fitter

    def lessened(self, group: str, factor: float) -> dict[str, float]:
        """Entries of `landmarks.weights` for a part of a group's weight; what is in it keeps its proportions."""
        config, chosen = self.case.config, set(self.scheme.groups[group])
        groups = {**self.scheme.groups, **config.subsets}
        inside = {
            name: factor * weight
            for name, weight in config.landmarks.weights.items()
            if chosen.issuperset((int(name),) if name.isdigit() else groups.get(name, ()))
        }
        return {group: factor, **inside}

    # --- the measure ---

    def misfit(
        self, fit: FrameFit, doubted: Bool[np.ndarray, "points"] | None = None, past_doubted: bool = False
    ) -> float:
        """Nats left unexplained by a fit; `doubted` landmarks cost at most their price, and those that the detector
        doubts less, whatever the configuration makes of its confidence.

        `past_doubted`: neighbouring frames may have the same fault, so deviating from their motion costs nothing.
        """
        motion = self.motion_costs(fit.observed)
        if past_doubted:
            motion = np.minimum(motion, self.motion_costs(self.points))
        each = self.residual_costs(fit) + MOTION_SHARE * motion
        each = each * np.minimum(self.case.observation.landmarks.confidence * 2.0, 1.0)
        if doubted is not None:
            each = np.where(doubted, np.minimum(each, DOUBTED), each)
        return self.total(each)

    def total(self, each: Float[np.ndarray, "points"] | Bool[np.ndarray, "points"]) -> float:
        """The sum over the landmarks, each by its share; of a mask: the shares of those that it names."""
        return float((self.shares * each).sum())

    def residual_costs(self, fit: FrameFit) -> Float[np.ndarray, "points"]:
        """Nats of each landmark for its distance from the model."""
        return np.log1p((self.percent(fit.residuals_px) / self.reference.residual_percent) ** 2)

    def motion_costs(self, points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points"]:
        """Nats of each landmark for its distance from the position predicted by motion."""
        return np.log1p((self.motion_deviation(points) / self.reference.motion_percent) ** 2)

    def motion_deviation(self, points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points"]:
        """Distance of each landmark from the position predicted by optical flow or by neighbouring frames, in %.

        The smaller of the two if both are known, because each fails in its own way; 0 if neither is.
        """
        found = np.full((2, len(points)), np.inf)
        if self.carried is not None:
            found[0] = np.linalg.norm(points - self.carried, axis=1) / FLOW_USUAL
        if self.case.before is not None and self.case.after is not None:
            found[1] = np.linalg.norm(points - self.middle(points), axis=1)
        least = np.nanmin(np.where(np.isnan(found), np.inf, found), axis=0)
        return np.where(np.isfinite(least), self.percent(least), 0.0)

    def nearest(self, chosen: Sequence[int]) -> Int[np.ndarray, "points"]:
        """Of each point, the chosen one that is nearest on the neutral face, by its place among these."""
        neutral = self._fitter.model.landmarks.of(self._fitter.model.neutral)
        return np.linalg.norm(neutral[:, None] - neutral[None, list(chosen)], axis=2).argmin(axis=1)

    @cached_property
    def unexplained(self) -> float:
        """Nats left unexplained by the fit under diagnosis."""
        return self.misfit(self.fit)

    @property
    def excess(self) -> float:
        """Nats above those of an unremarkable frame."""
        return self.unexplained - self.usual

    @cached_property
    def usual(self) -> float:
        """Nats left by an unremarkable frame of this shot: the minimum that an explanation must reach."""
        fits = self.reference.usual_fits
        if not fits:
            return self.total(np.full(len(self.shares), 0.35))
        usual = self.reference.residual_percent
        each = [np.log1p((100.0 * fit.residuals_px / face_size(fit.observed) / usual) ** 2) for fit in fits]
        return float(min(np.median([self.total(costs) for costs in each]), 0.6 * self.shares.sum()))

    def gain(
        self,
        fit: FrameFit,
        parameters: float = 0.0,
        doubted: Bool[np.ndarray, "points"] | None = None,
        past_doubted: bool = False,
    ) -> float:
        """Nats that a changed fit explains beyond the fit under diagnosis, minus the price of its free parameters."""
        return self.unexplained - self.misfit(fit, doubted, past_doubted) - PARAMETER * parameters

    def percent(self, px):
        """Pixels in percent of the face's size."""
        return 100.0 * px / self.face_px

    def error_percent(self, fit: FrameFit, doubted: Bool[np.ndarray, "points"] | None = None) -> float:
        """Mean error over those of the 68 that are not doubted, % of the outer-eye distance (as `FrameFit.errors`)."""
        believed = np.ones(len(self.points), bool) if doubted is None or doubted.all() else ~doubted
        return float(fit.residuals_percent[:POINT_COUNT][believed[:POINT_COUNT]].mean())

    # --- evidence besides the fit ---

    @cached_property
    def usual_offsets(self) -> dict[str, UsualOffset]:
        """The usual innovation of each group in the shot."""
        return usual_offsets(self._fitter.model, self.reference)

    def jump(self, group: str) -> tuple[Float[np.ndarray, "2"], float] | None:
        """The jump of a group within the last frames, if there is one (`jump_of`)."""
        return jump_of(group, self.scheme, self.case.observation, self.case.seen, self.reference.steps_of(group))

    @cached_property
    def carried(self) -> Float[np.ndarray, "points 2"] | None:
        """The previous frame's landmarks moved by optical flow; NaN where the flow is unreliable."""
        case = self.case
        if case.picture is None or case.previous_picture is None or case.before is None:
            return None
        points = case.before.landmarks.points
        return carried_by_flow(case.previous_picture, case.picture, points, float(face_size(points)))

    @cached_property
    def picture_steps(self) -> Float[np.ndarray, "n 2"] | None:
        """Motion of the picture at the landmarks since the previous frame, pixels; None where it is known at few."""
        if self.carried is None:
            return None
        moved = self.carried - self.case.before.landmarks.points
        known = np.isfinite(moved[:, 0])
        return moved[known] if known.sum() >= FEWEST_CARRIED else None

    def middle(self, points: Float[np.ndarray, "points 2"]) -> Float[np.ndarray, "points 2"]:
        """Landmarks predicted from the previous and next frames, with the head's motion taken from `points`."""
        return between(self.case.before.landmarks.points, self.case.after.landmarks.points, points)

    @cached_property
    def neighbours(self) -> Float[np.ndarray, "points 2"] | None:
        """Landmarks predicted from neighbouring frames without those of this frame: interpolated or copied."""
        before, after = self.case.before, self.case.after
        if before is None and after is None:
            return None
        if before is not None and after is not None:
            return 0.5 * (before.landmarks.points + after.landmarks.points)
        return (before or after).landmarks.points

    @cached_property
    def blur(self) -> Blur | None:
        """The directional blur of the picture; None without a picture."""
        case = self.case
        if case.picture is None:
            return None
        points = self.points if self.neighbours is None else self.neighbours
        energy = gradient_energy(case.picture, points, self.face_px)
        previous = None
        if case.previous_picture is not None and case.before is not None:
            previous = gradient_energy(case.previous_picture, case.before.landmarks.points, self.face_px)
        return directional_blur(energy, previous)

    @cached_property
    def relative_confidence(self) -> Float[np.ndarray, "points"]:
        """The detector's confidence in each point relative to its usual one in the shot; 1 where that is low, too."""
        usual = self.reference.usual_confidence
        now = self.case.observation.landmarks.confidence
        return np.where(usual > SURE, now / np.maximum(usual, SURE), 1.0)

    @cached_property
    def look(self) -> FaceLook | None:
        """How the face looks in the picture; None without a picture."""
        return None if self.case.picture is None else look_of(self.case.picture, self.points)

    @cached_property
    def usual_look(self) -> UsualLook | None:
        """How it looks in the frames around; None without their pictures, or with too few."""
        pictures, frames = self.case.pictures, self.case.shot
        if pictures is None:
            return None
        there = {frame.index: frame for frame in frames if frame.landmarks is not None}
        around = near(self.case.observation.index, list(there))
        usual = UsualLook({index: self.reference.look(there[index], pictures) for index in around})
        return usual if usual.known else None


def shares_of(count: int) -> Float[np.ndarray, "points"]:
    """What each of so many points counts beside one of the 68."""
    return np.where(np.arange(count) < POINT_COUNT, 1.0, FURTHER_SHARE)


def points_change(label: str, points: Float[np.ndarray, "points 2"], chosen: Bool[np.ndarray, "points"]) -> Change:
    """The change that moves the chosen points to their rows of `points`."""
    places = {int(k): (float(points[k, 0]), float(points[k, 1])) for k in np.flatnonzero(chosen)}
    return Change(label, landmarks=places)
