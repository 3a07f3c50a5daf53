"""The one walk over frames: what each frame starts from, and what it hands to the next.

Command line, sessions, live panel, workers and benchmarks fit frames by it, so that all of them get the same numbers.
"""

import numpy as np
from jaxtyping import Float

from workbench.landmarks.scheme import outer_eye_distance
from workbench.tracking.fitting import Calibrated, Continuation, Fitter, FrameContext, FrameObservation
from workbench.tracking.records import FrameFit

JUMP = 0.5
"""Mean landmark motion between frames, in outer-eye distances, that restarts the pose."""


class Walk:
    """Frame after frame through a fitter, shot after shot. What the frames of a shot share is handed in."""

    def __init__(self, fitter: Fitter):
        self.fitter = fitter
        self.shot = -1
        """Number of the present shot."""
        self.calibrated = Calibrated(fitter.mean_identity(), {})
        """What the frames of the present shot share."""
        self.last: Continuation | None = None
        """What the last frame handed on."""

    def begin_shot(self, calibrated: Calibrated | None = None) -> None:
        """The next frame is the first one of a shot; its person is the model's mean face if none is given."""
        self.shot, self.last = self.shot + 1, None
        self.calibrated = Calibrated(self.fitter.mean_identity(), {}) if calibrated is None else calibrated

    def context(self, observation: FrameObservation) -> FrameContext:
        """What the next frame is fitted from."""
        return context_of(observation, self.shot, self.calibrated, self.last)

    def step(self, observation: FrameObservation) -> tuple[FrameFit, FrameContext]:
        """The fit of the next frame, and the context that it was fitted in."""
        context = self.context(observation)
        return self.fit(observation, context), context

    def fit(self, observation: FrameObservation, context: FrameContext) -> FrameFit:
        """The fit of the next frame, whose context is known already."""
        found, self.last = self.fitter.fit(observation, context)
        return found


def context_of(
    observation: FrameObservation, shot: int, calibrated: Calibrated, last: Continuation | None
) -> FrameContext:
    """What a frame is fitted from, where the frame before left `last`: nothing of it after a gap or a jump."""
    lost = observation.landmarks is None or (last is not None and jumped(last.points, observation.landmarks.points))
    start = calibrated.starts.get(observation.index)
    return FrameContext(shot, calibrated.identity, start, None if lost else last, calibrated.appearance)


def jumped(before: Float[np.ndarray, "68 2"], now: Float[np.ndarray, "68 2"]) -> bool:
    """Whether the landmarks moved so far between two frames that the pose starts afresh."""
    return bool(np.linalg.norm(now - before, axis=1).mean() > JUMP * outer_eye_distance(before))
