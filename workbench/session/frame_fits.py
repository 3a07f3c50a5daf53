"""Fits of single frames, each in the context of the last whole run."""

import threading
from collections.abc import Callable

import numpy as np
from jaxtyping import UInt8

from workbench.config import Config
from workbench.errors import StoppedError
from workbench.face import FaceModel
from workbench.pictures.deep_strip import stage_strip
from workbench.planning import plan_of
from workbench.session.calibrations import Calibrations
from workbench.session.dependence import frame_key
from workbench.session.material import Cancelled, Material
from workbench.session.observed_frames import ObservedFrames
from workbench.tracking import FrameFit, StageTrace
from workbench.tracking.deep_solution import DeepSolution
from workbench.tracking.fitting import Continuation, FrameProblem, FrameSolution, with_face
from workbench.tracking.systems import configured, make_fitter
from workbench.tracking.unwatched import never
from workbench.tracking.walk import context_of


class FrameFits:
    """Fits frames of a material, one at a time and in any order; `last` gives the state to continue a frame from.

    One fitter serves all calls, from any thread, and follows the configuration of each call. If solutions hold renders,
    the latest is cached, because a panel asks for its fit, its path and its pictures.
    """

    def __init__(
        self,
        model: FaceModel,
        material: Material,
        config: Config,
        frames: ObservedFrames,
        calibrations: Calibrations,
        last: Callable[[int], Continuation | None],
    ) -> None:
        self._material, self._frames, self._calibrations, self._last = material, frames, calibrations, last
        self._fitter, self._fitter_config = make_fitter(model, plan_of(config, model.scheme)), config
        self._solution: tuple[tuple, FrameSolution] | None = None
        self._lock = threading.RLock()

    def fit(self, frame: int, config: Config, coarse: bool = False, cancelled: Cancelled = never) -> FrameFit:
        """The fit of one frame; `coarse` accepts an identity that an earlier configuration calibrated on the shot.

        Raises `StoppedError` if cancelled.
        """
        with self._lock:
            solution = self._solved(self.problem(frame, config, coarse), cancelled=cancelled)
            return self._fitter.record(solution)

    def explain(self, frame: int, config: Config) -> tuple[FrameFit, tuple[StageTrace, ...]]:
        """The fit with every iteration kept. Raises `InputError` for a frame without landmarks."""
        with self._lock:
            solution = self._traced(frame, config)
            return self._fitter.record(solution), self._fitter.traces(solution)

    def stopped(self, frame: int, config: Config, steps: int) -> FrameFit:
        """The fit after `steps` iterations of all stages. Raises `InputError` for a frame without landmarks."""
        with self._lock:
            solution = self._traced(frame, config)
            return self._fitter.record(self._fitter.stopped(solution, steps))

    def solve(self, frame: int, config: Config) -> DeepSolution | None:
        """The result of each Deep Energies stage on a frame; None under FACE IT! or without a face."""
        with self._lock:
            problem = self.problem(frame, config, coarse=True)
            if not self._fitter.renders or problem.observation.landmarks is None:
                return None
            return self._solved(problem)

    def stage_strip(self, frame: int, config: Config) -> UInt8[np.ndarray, "h w 3"] | None:
        """The Deep Energies stages on a frame as a film strip; None if there is nothing to draw."""
        with self._lock:
            solution, pictures = self.solve(frame, config), self._material.pictures
            if solution is None or not pictures.real:
                return None
            return stage_strip(pictures[frame], self._fitter, solution)

    def problem(self, frame: int, config: Config, coarse: bool = False) -> FrameProblem:
        """The solver's input for a frame, continued from the previous frame of the last complete run."""
        with self._lock:
            observation = self._frames.linked_observation(frame, config)
            shot = next(number for number, frames in enumerate(self._material.shots) if frame in frames)
            # The file that a rig is read from may change under the same configuration.
            if self._fitter_config is not config or config.camera.rig:
                plan = plan_of(config, self._fitter.model.scheme)
                self._fitter, self._fitter_config = configured(self._fitter, plan), config
            calibrated = self._calibrations.of_shot(shot, config, self._fitter, coarse)
            return self._fitter.problem(observation, context_of(observation, shot, calibrated, self._last(frame)))

    def _traced(self, frame: int, config: Config) -> FrameSolution:
        """A frame solved with every iteration kept. Raises `InputError` for one without landmarks."""
        problem = self.problem(frame, config, coarse=True)
        with_face(problem.observation)
        return self._solved(problem, traced=True)

    def _solved(self, problem: FrameProblem, traced: bool = False, cancelled: Cancelled = never) -> FrameSolution:
        observation, context = problem.observation, problem.context
        if not self._fitter.renders or observation.landmarks is None:
            return self._unless(cancelled, self._fitter.solve(problem, traced, cancelled))
        points, identity = observation.landmarks.points.tobytes(), context.identity.tobytes()
        last = () if context.last is None else [np.asarray(part).tobytes() for part in context.last.parameters]
        settings = (frame_key(self._fitter_config), self._fitter.plan.camera.of_rig)
        key = (observation.index, *settings, identity, points, *last)
        if self._solution is None or self._solution[0] != key:
            self._solution = (key, self._unless(cancelled, self._fitter.solve(problem, cancelled=cancelled)))
        return self._solution[1]

    @staticmethod
    def _unless(cancelled: Cancelled, solution: FrameSolution) -> FrameSolution:
        """A solution, unless it was cancelled and so may have stopped halfway."""
        if cancelled():
            index = solution.problem.observation.index
            raise StoppedError(f"The fit of frame {index} was cancelled; what is shown is from before.")
        return solution
