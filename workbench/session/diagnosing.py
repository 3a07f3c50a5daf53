"""Diagnoses of a session's frames; the reference values of a shot are cached."""

import threading
from dataclasses import replace

from workbench.config import Config
from workbench.diagnosis import Diagnosis, FrameCase, ShotReference, diagnose_frame, reference_of
from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.planning import camera_plan, plan_of
from workbench.session.clip_run import Run
from workbench.session.material import Cancelled, Material, Progress
from workbench.session.observed_frames import ObservedFrames
from workbench.tracking import FaceItFitter
from workbench.tracking.fitting import FrameProblem
from workbench.tracking.unwatched import never, silent


class Diagnosing:
    """Diagnoses frames one at a time with its own fitter. Thread-safe."""

    def __init__(self, model: FaceModel, material: Material, frames: ObservedFrames) -> None:
        self._model, self._material, self._frames = model, material, frames
        self._fitter: FaceItFitter | None = None
        self._reference: tuple[tuple[int, Config, str], ShotReference] | None = None
        self._lock = threading.Lock()

    def diagnose(
        self,
        problem: FrameProblem,
        config: Config,
        run: Run | None,
        progress: Progress | None = None,
        cancelled: Cancelled = never,
    ) -> Diagnosis:
        """Reasons why the fit of a frame may be bad, and why the run flags it, if it does.

        Raises `InputError` for a frame without landmarks, and `StoppedError` if cancelled.
        """
        observation, context = problem.observation, problem.context
        frame, frames, pictures = observation.index, self._material.shots[context.shot], self._material.pictures
        shot = [self._frames.observation(k, config) for k in frames]
        previous = pictures[frame - 1] if pictures.real and frame - 1 in frames else None
        case = FrameCase(observation, context, config, shot)
        if pictures.real:
            case = replace(case, picture=pictures[frame], previous_picture=previous, pictures=pictures.__getitem__)
        with self._lock:
            if self._fitter is None:
                self._fitter = FaceItFitter(self._model, plan_of(config, self._model.scheme))
            key = (context.shot, config, camera_plan(config).of_rig)
            if self._reference is None or self._reference[0] != key:
                self._reference = (key, reference_of(self._model, config, case.shot, self._fitter))
            found = diagnose_frame(self._model, case, self._fitter, self._reference[1], progress or silent, cancelled)
        return replace(found, flag="" if run is None else run.flags.text[frame])


def check_diagnosed(config: Config) -> Config:
    """The configuration. Raises `InputError` if the diagnosis does not support its system."""
    if not config.traits.diagnosed:
        raise InputError(
            "Diagnosis tries changes to FACE IT! only; choose a FACE IT! preset to use it. For Deep Energies, the "
            "failure is shown next to the frame, and the film strip shows the stage at which it happened."
        )
    return config
