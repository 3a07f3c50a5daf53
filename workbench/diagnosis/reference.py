"""Usual values of a shot: the size of its residuals, the motion of its landmarks, its identity and its lens."""

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from workbench.config import POSE, ROBUST_START, Config, Stage
from workbench.diagnosis.appearance import FaceLook, Pictures, look_of
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, landmark_model
from workbench.geometry import Camera
from workbench.landmarks.alignment import FaceFrame, fit_similarity
from workbench.landmarks.scheme import POINT_COUNT, face_size
from workbench.planning import plan_of
from workbench.runtime import COMPUTING
from workbench.tracking import FaceItFitter, FrameContext, FrameFit, FrameObservation
from workbench.tracking.identity import CalibrationSettings, calibrate_identity

MOST_STEPS = 80
MOST_FRAMES = 24
"""Maximum number of frames of the shot that are used."""
ENOUGH_FRAMES = 4
"""Minimum number of other frames for conclusions about the person or the lens."""
USUAL_PERCENT = (0.7, 1.6)
"""Range to which the usual residual of a landmark is clipped, % of the face's size, so that a shot that is bad
throughout is not taken as normal."""
USUAL_MOTION_PERCENT = (0.6, 2.0)


JOINT_STAGES = (ROBUST_START, Stage(name="pose and expression", free=(*POSE, "expression"), limit=30))
"""The joint solve with all landmarks at full weight, because the misfit gives every landmark full weight."""


def jointly(config: Config) -> Config:
    """The configuration with pose and expression solved as one problem."""
    return config.changed(stages=[stage.model_dump() for stage in JOINT_STAGES])


class ShotReference:
    """Usual values of one shot under one configuration. Make it once per shot; its parts are computed on demand.

    `frames` are the observations of the shot to learn from, evenly spread; the frame under diagnosis may be among them.
    """

    def __init__(self, model: FaceModel, config: Config, shot: Sequence[FrameObservation], fitter: FaceItFitter):
        usable = [observation for observation in shot if observation.landmarks is not None]
        count = min(MOST_FRAMES, len(usable))
        places = np.unique(np.round(np.linspace(0, len(usable) - 1, count)).astype(int)) if count else []
        self.frames = [usable[k] for k in places]
        self.config = config
        self._shot = usable
        # A joint solve with enough iterations: usual values must not depend on the settings under suspicion.
        self._config = jointly(config)
        self._model, self._scheme = model, model.scheme
        self._fitter = copy.copy(fitter)
        self._fitter.configure(plan_of(self._config, self._scheme))
        self._offsets: dict[tuple[int, ...], np.ndarray] = {}
        self._looks: dict[int, FaceLook] = {}

    @property
    def knows_person(self) -> bool:
        """Whether there are enough frames for a calibration."""
        return len(self.frames) >= ENOUGH_FRAMES

    @cached_property
    def identity(self) -> Float[np.ndarray, "i"] | None:
        """The identity calibrated on these frames without outliers; None with too few frames."""
        return self.identity_under(self._config)

    def identity_under(self, config: Config) -> Float[np.ndarray, "i"] | None:
        """The identity calibrated on these frames with another configuration (for example another camera)."""
        return self.identity_of(self._sound_frames, config) if self.knows_person else None

    def identity_of(self, frames: Sequence[FrameObservation], config: Config) -> Float[np.ndarray, "i"]:
        """The identity that a configuration calibrates on these frames."""
        fitter = copy.copy(self._fitter)
        fitter.configure(plan_of(config, self._scheme))
        return fitter.calibrate(frames, config.identity.frames).identity

    @cached_property
    def _sound_frames(self) -> list[FrameObservation]:
        """The frames with mutually similar shapes: one with exchanged sides would spoil the calibration."""
        if not self.frames:
            return []
        shapes = np.stack([observation.landmarks.points for observation in self.frames])[:, 17:POINT_COUNT]
        usual = shapes[0]
        for _ in range(2):
            usual = np.median([fit_similarity(shape, usual).to_image(shape) for shape in shapes], axis=0)
        away = [_percent_from(shape, usual) for shape in shapes]
        limit = max(2.5 * np.median(away), 6.0)
        return [observation for observation, far in zip(self.frames, away, strict=True) if far <= limit]

    def fits(self, identity: Float[np.ndarray, "i"]) -> list[FrameFit]:
        """Independent fits of the frames with this identity."""
        return [self.fit(frame, identity) for frame in self._sound_frames]

    def fit(self, frame: FrameObservation, identity: Float[np.ndarray, "i"]) -> FrameFit:
        """The fit of a frame on its own, by a joint solve."""
        return self._fitter.fit(frame, FrameContext(0, identity, None, None))[0]

    @cached_property
    def usual_fits(self) -> list[FrameFit]:
        """The fits with the identity calibrated here."""
        return self.fits(self.identity) if self.identity is not None else []

    @cached_property
    def residual_percent(self) -> Float[np.ndarray, "points"]:
        """Usual distance of each landmark from the model, % of the face's size."""
        if not self.usual_fits:
            return np.full(len(self._scheme), 1.0)
        each = [100.0 * fit.residuals_px / face_size(fit.observed) for fit in self.usual_fits]
        return np.clip(1.2 * np.median(each, axis=0), *USUAL_PERCENT)

    def offsets_without(self, points: Sequence[int]) -> Float[np.ndarray, "n 2"]:
        """Mean offset of these points from a fit without them in some of the frames, % of the face's size."""
        key = tuple(points)
        if key not in self._offsets:
            indices, offsets = list(key), []
            fits = {fit.index: fit for fit in self.usual_fits}
            for frame in [frame for frame in self._sound_frames if frame.index in fits][::2]:
                places, confidence = frame.landmarks.points, frame.landmarks.confidence.copy()
                confidence[indices] = 0.0
                doubtful = replace(frame, landmarks=replace(frame.landmarks, confidence=confidence))
                fit, _ = self._fitter.fit(doubtful, FrameContext(0, self.identity, None, None))
                offsets.append(100.0 * (places - fit.projected)[indices].mean(axis=0) / face_size(places))
            self._offsets[key] = np.array(offsets).reshape(-1, 2)
        return self._offsets[key]

    @cached_property
    def usual_confidence(self) -> Float[np.ndarray, "points"]:
        """Median of the detector's confidence in each point; 0 with too few frames."""
        each = [frame.landmarks.confidence for frame in self._shot]
        return np.median(each, axis=0) if len(each) >= ENOUGH_FRAMES else np.zeros(len(self._scheme))

    def look(self, frame: FrameObservation, pictures: Pictures) -> FaceLook:
        """How the face of a frame looks in its picture."""
        if frame.index not in self._looks:
            self._looks[frame.index] = look_of(pictures(frame.index), frame.landmarks.points)
        return self._looks[frame.index]

    def steps_of(self, group: str) -> Float[np.ndarray, "n"]:
        """Motion of a group relative to the rest of the face between frames, % of the face's size."""
        return self._steps[:, list(self._scheme.groups[group])].mean(axis=1)

    @cached_property
    def _steps(self) -> Float[np.ndarray, "n points"]:
        points = {observation.index: observation.landmarks.points for observation in self._shot}
        ends = [index for index in points if index - 1 in points]
        ends = ends[:: max(1, len(ends) // MOST_STEPS)]
        steps = [_steps_between(points[k - 1], points[k]) for k in ends]
        return np.array(steps).reshape(-1, len(self._scheme))

    @cached_property
    def jump_percent(self) -> float:
        """Usual distance of the points from the middle of the adjacent frames', % of the face's size."""
        points = {observation.index: observation.landmarks.points for observation in self._shot}
        away = [
            100.0 * np.linalg.norm(now - 0.5 * (points[k - 1] + points[k + 1]), axis=1).mean() / face_size(now)
            for k, now in points.items()
            if k - 1 in points and k + 1 in points
        ]
        return float(np.median(away)) if away else 0.0

    @cached_property
    def motion_percent(self) -> Float[np.ndarray, "points"]:
        """Usual distance of each landmark from the midpoint of the neighbouring frames, with head motion removed."""
        points = {observation.index: observation.landmarks.points for observation in self._shot}
        centres = [index for index in points if index - 1 in points and index + 1 in points]
        centres = centres[:: max(1, len(centres) // 40)]
        if len(centres) < ENOUGH_FRAMES:
            return np.full(len(self._scheme), 1.2)
        away = [
            100.0 * np.linalg.norm(points[k] - between(points[k - 1], points[k + 1], points[k]), axis=1)
            / face_size(points[k])
            for k in centres
        ]  # fmt: skip
        return np.clip(1.5 * np.median(away, axis=0), *USUAL_MOTION_PERCENT)

    @cached_property
    def focal_costs(self) -> dict[float, float] | None:
        """Cost of the best faces and poses by factor on the focal length, ascending; None with too few frames, and for
        a model without an identity basis, whose one face need not have this person's proportions.

        In squared percent of the outer-eye distance; differences of ten and more are significant. Half and twice the
        focal length are tried; if one of these is best, also the values on both sides of it, to bracket the minimum.
        """
        if not self.knows_person or not self._model.has_identities:
            return None
        costs = {factor: self._focal_cost(factor) for factor in (0.5, 1.0, 2.0)}
        best = min(costs, key=costs.get)
        if best != 1.0:
            costs |= {factor: self._focal_cost(factor) for factor in (best**0.5, best**2)}
        return dict(sorted(costs.items()))

    def focal_error_percent(self, cost: float) -> float:
        """The mean distance in x or y that such a cost means, % of the outer-eye distance."""
        frames = min(self.config.identity.frames, len(self._sound_frames))
        weights = self.config.point_weights(self._scheme)
        return float(np.sqrt(cost / (2.0 * frames * max(sum(weights), 1e-9))))

    def _focal_cost(self, factor: float) -> float:
        count = self.config.identity.frames
        frames = self._sound_frames
        chosen = [frames[k] for k in np.unique(np.round(np.linspace(0, len(frames) - 1, count)).astype(int))]
        padding = count - len(chosen)
        fits = {fit.index: fit for fit in self.usual_fits}
        starts, cameras = [], []
        for frame in chosen:
            fit = fits[frame.index]
            focal = np.asarray(fit.camera.focal_px) * factor
            cameras.append(Camera(focal, np.asarray(fit.camera.principal_point_px), np.asarray(fit.camera.distortion)))
            # At `factor` times the distance the head looks approximately the same.
            starts.append(
                FaceParameters(fit.rotation, fit.translation * [1.0, 1.0, factor], fit.expression, fit.identity)
            )
        counts, unseen = plan_of(self.config, self._scheme).counts, [np.zeros(len(self._scheme))]
        weights = np.stack([counts(frame.landmarks.confidence) for frame in chosen] + unseen * padding)
        chosen, starts, cameras = (part + part[-1:] * padding for part in (chosen, starts, cameras))
        used = np.array(self.config.point_weights(self._scheme))
        settings = CalibrationSettings(
            identity=1.0, size=0.0, expression=8.0, limits=(40, 15), landmark_weights=np.stack([used] * 2), sliding=1.0
        )
        with COMPUTING:
            solved = calibrate_identity(
                _stacked(cameras),
                landmark_model(self._model),
                settings,
                _stacked(starts),
                np.stack([frame.landmarks.points for frame in chosen]),
                weights,
            )
        return float(solved.cost)


def between(
    before: Float[np.ndarray, "points 2"], after: Float[np.ndarray, "points 2"], now: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "points 2"]:
    """The midpoints between `before` and `after`, moved to `now` by the similarity that most points follow."""
    middle = 0.5 * (before + after)
    return robust_similarity(middle, now).to_image(middle)


def _steps_between(
    before: Float[np.ndarray, "points 2"], now: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "points"]:
    away = np.linalg.norm(now - robust_similarity(before, now).to_image(before), axis=1)
    return 100.0 * away / face_size(now)


def robust_similarity(source: Float[np.ndarray, "points 2"], target: Float[np.ndarray, "points 2"]) -> FaceFrame:
    """The similarity that maps most of the 68 from `source` to `target`: re-fitted to the closest half, then 66 %."""
    source, target = source[:POINT_COUNT], target[:POINT_COUNT]
    face = fit_similarity(source, target)
    for part in (0.5, 0.5, 0.66):
        away = np.linalg.norm(face.to_image(source) - target, axis=1)
        chosen = np.argsort(away, kind="stable")[: int(part * len(source))]
        face = fit_similarity(source[chosen], target[chosen])
    return face


def _percent_from(shape: Float[np.ndarray, "51 2"], usual: Float[np.ndarray, "51 2"]) -> float:
    away = np.linalg.norm(fit_similarity(shape, usual).to_image(shape) - usual, axis=1).mean()
    return float(100.0 * away / np.linalg.norm(usual[45 - 17] - usual[36 - 17]))


def _stacked(records):
    return type(records[0])(*(np.stack([np.asarray(part) for part in parts]) for parts in zip(*records, strict=True)))


def reference_of(
    model: FaceModel, config: Config, shot: Sequence[FrameObservation], fitter: FaceItFitter | None = None
) -> ShotReference:
    """Usual values of a shot, to be shared by the diagnoses of its frames. Raises `InputError` without landmarks."""
    if not any(observation.landmarks is not None for observation in shot):
        raise InputError("A shot's reference needs landmarks; none of these frames has any.")
    return ShotReference(model, config, shot, fitter or FaceItFitter(model, plan_of(config, model.scheme)))
