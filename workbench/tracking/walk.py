"""The single walk over frames: what each frame starts from, and what it hands to the next.

The command line, sessions, the live panel, workers and benchmarks all use it, so that they get the same numbers.
"""

import numpy as np
from jaxtyping import Float

from workbench.landmarks.scheme import error_unit
from workbench.tracking.fitting import Calibrated, Continuation, Fitter, FrameContext
from workbench.tracking.observation import FrameObservation
from workbench.tracking.records import FrameFit

JUMP = 0.5
"""Mean landmark motion between frames, in outer-eye distances, that restarts the pose."""


class Walk:
    """Fits frame after frame, shot after shot. The calibration of a shot is passed in."""

    def __init__(self, fitter: Fitter):
        self.fitter = fitter
        self.shot = -1
        """Number of the current shot."""
        self.calibrated = Calibrated(fitter.mean_identity(), {})
        """Calibration of the current shot."""
        self.last: Continuation | None = None
        """State handed on by the last frame."""

    def begin_shot(self, calibrated: Calibrated | None = None) -> None:
        """Start a new shot with the next frame; without a calibration, its identity is the model's mean face."""
        self.shot, self.last = self.shot + 1, None
        self.calibrated = Calibrated(self.fitter.mean_identity(), {}) if calibrated is None else calibrated

    def context(self, observation: FrameObservation) -> FrameContext:
        """The context of the next frame."""
        return context_of(observation, self.shot, self.calibrated, self.last)

    def step(self, observation: FrameObservation) -> tuple[FrameFit, FrameContext]:
        """The fit of the next frame, and the context used for it."""
        context = self.context(observation)
        return self.fit(observation, context), context

    def fit(self, observation: FrameObservation, context: FrameContext) -> FrameFit:
        """The fit of the next frame, with a known context."""
        found, self.last = self.fitter.fit(observation, context)
        return found


def context_of(
    observation: FrameObservation, shot: int, calibrated: Calibrated, last: Continuation | None
) -> FrameContext:
    """The context of a frame whose predecessor left `last`, which is dropped after a gap or a jump."""
    lost = observation.landmarks is None or (last is not None and jumped(last.points, observation.landmarks.points))
    start = calibrated.starts.get(observation.index)
    return FrameContext(shot, calibrated.identity, start, None if lost else last, calibrated.appearance)


def jumped(before: Float[np.ndarray, "points 2"], now: Float[np.ndarray, "points 2"]) -> bool:
    """Whether the landmarks moved so far between two frames that the pose must be restarted."""
    return bool(np.linalg.norm(now - before, axis=1).mean() > JUMP * error_unit(before))
