"""Stretches of a clip to learn from, each with what its objectives look at."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from workbench.arrays import AnyArray
from workbench.config import Config
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, landmark_model
from workbench.learning.chain import Stretch
from workbench.objectives import FOLDS, ObservedClip, Truth, observed_clip
from workbench.planning import plan_of
from workbench.tracker import calibration_window
from workbench.tracking import FaceItFitter, FrameObservation
from workbench.tracking.face_it_solution import solve_settings
from workbench.tracking.fitting import corrected
from workbench.tracking.initial_pose import initial_pose
from workbench.tracking.walk import jumped

LENGTH = 12
"""Frames of a stretch."""
SETTLING = 4
"""Frames at its beginning that no objective counts: it is fitted afresh, and E_τ begins with its third frame."""


class Example(NamedTuple):
    """A stretch of a clip, with what objectives look at in it."""

    stretch: Stretch
    clip: ObservedClip
    hidden: Bool[AnyArray, "f n 68"]
    """What each fit hides; the first hides nothing."""
    counted: Bool[AnyArray, "n"]
    """Frames that objectives count."""


def part_of_clip(clip: ObservedClip, frames: slice | range) -> ObservedClip:
    """Some frames of a clip in a row; the first follows none."""
    chosen = slice(frames.start, frames.stop)
    truth = Truth(*(None if part is None else part[chosen] for part in clip.truth))
    follows = np.array(clip.follows[chosen])
    follows[:1] = False
    return clip._replace(
        points=clip.points[chosen],
        confidence=clip.confidence[chosen],
        follows=follows,
        truth=truth,
        flow=None if clip.flow is None else clip.flow[chosen],
        second=None if clip.second is None else clip.second._replace(points=clip.second.points[chosen]),
    )


def stretches_in(observations: Sequence[FrameObservation], frames: range, length: int = LENGTH) -> list[range]:
    """The frames of a part in runs of `length` with a face throughout, without a cut, a gap or a jump between them."""
    found, run = [], 0
    for k in frames:
        now, before = observations[k], observations[k - 1] if run else None
        if now.landmarks is None:
            run = 0
            continue
        broken = before is not None and (now.cut or jumped(before.landmarks.points, now.landmarks.points))
        run = 1 if broken else run + 1
        if run == length:
            found.append(range(k + 1 - length, k + 1))
            run = 0
    return found


def spread(stretches: Sequence[range], count: int) -> list[range]:
    """Up to `count` of the stretches, evenly over them."""
    count = min(count, len(stretches))
    return [stretches[(2 * k + 1) * len(stretches) // (2 * count)] for k in range(count)]


class Examples:
    """Makes examples of a clip under the configuration that learning starts from: its identities are held."""

    def __init__(
        self, model: FaceModel, config: Config, observations: Sequence[FrameObservation], clip: ObservedClip
    ) -> None:
        self.observations = [corrected(each, config.moved_points(each.index)) for each in observations]
        self.plan = plan_of(config)
        self._config, self._clip, self._model = config, clip, model
        self._landmarks = landmark_model(model)
        self._fitter = FaceItFitter(model, self.plan)
        self._identities: dict[int, np.ndarray] = {}

    def of(self, frames: range, kinds: tuple[str, ...]) -> Example:
        """The example of some frames in a row; `kinds` are the folds that its objectives look at."""
        person = self._landmarks.personal(self._identity(frames.start))
        observed = [self.observations[k] for k in frames]
        camera = self.camera
        points = np.stack([each.landmarks.points for each in observed])
        counts = np.stack([self.plan.counts(each.landmarks.confidence) for each in observed])
        rotation, translation = initial_pose(camera, person.frontal_neutral(), points[0], self.plan.point_weights > 0.0)
        start = FaceParameters(rotation, translation, np.zeros(len(self._model.expression_names)), np.zeros(0))
        hidden = np.concatenate([np.zeros((1, len(frames), 68), bool), *(FOLDS[kind](len(frames)) for kind in kinds)])
        return Example(
            Stretch(points, counts, start, person, solve_settings(self.plan)),
            part_of_clip(self._clip, frames),
            hidden,
            np.arange(len(frames)) >= min(SETTLING, len(frames) - 1),
        )

    @property
    def camera(self):
        """The camera of the clip."""
        return self._fitter.camera(self.observations[0].image_size)

    def _identity(self, frame: int) -> Float[np.ndarray, "i"]:
        if not self.plan.identity.calibrate:
            return self._fitter.mean_identity()
        first = next((k for k in range(frame, -1, -1) if self.observations[k].cut), 0)
        if first not in self._identities:
            end = next((k for k in range(frame + 1, len(self.observations)) if self.observations[k].cut), None)
            window = calibration_window(self.observations[first:end], self._config.identity.window)
            self._identities[first] = self._fitter.calibrate(window, self._config.identity.frames).identity
        return self._identities[first]


def check_frames(frames: range, count: int, part: str) -> range:
    """The frames of a part. Raises `InputError` unless the clip has them."""
    if not 0 <= frames.start < frames.stop <= count:
        raise InputError(
            f"The part {part} is frames {frames.start}:{frames.stop}, but the clip has 0:{count}; choose within it."
        )
    return frames


def observed_all(observations: Sequence[FrameObservation], config: Config, truth: Truth) -> ObservedClip:
    """What objectives look at in a whole clip, with the detections that the configuration moves."""
    return observed_clip([corrected(each, config.moved_points(each.index)) for each in observations], truth)
