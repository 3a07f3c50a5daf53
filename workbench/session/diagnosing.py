"""Diagnoses of a session's frames; what a shot is compared with is kept."""

import threading
from dataclasses import replace

from workbench.config import Config
from workbench.diagnosis import Diagnosis, FrameCase, ShotReference, diagnose_frame, reference_of
from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.planning import plan_of
from workbench.session.clip_run import Run
from workbench.session.material import Material
from workbench.session.observed_frames import ObservedFrames
from workbench.tracking import FaceItFitter
from workbench.tracking.fitting import FrameProblem


class Diagnosing:
    """Diagnoses frames one after the other, with a fitter of its own; calls may come from any thread."""

    def __init__(self, model: FaceModel, material: Material, frames: ObservedFrames) -> None:
        self._model, self._material, self._frames = model, material, frames
        self._fitter: FaceItFitter | None = None
        self._reference: tuple[tuple[int, Config], ShotReference] | None = None
        self._lock = threading.Lock()

    def diagnose(self, problem: FrameProblem, config: Config, run: Run | None) -> Diagnosis:
        """Reasons why the fit of a frame may be bad, and why a whole run flags it if it does.

        Raises `InputError` for a frame without landmarks.
        """
        observation, context = problem.observation, problem.context
        frame, frames, pictures = observation.index, self._material.shots[context.shot], self._material.pictures
        shot = [self._frames.observation(k, config) for k in frames]
        previous = pictures[frame - 1] if pictures.real and frame - 1 in frames else None
        case = FrameCase(observation, context, config, shot, pictures[frame] if pictures.real else None, previous)
        with self._lock:
            if self._fitter is None:
                self._fitter = FaceItFitter(self._model, plan_of(config))
            key = (context.shot, config)
            if self._reference is None or self._reference[0] != key:
                self._reference = (key, reference_of(self._model, config, shot, self._fitter))
            found = diagnose_frame(self._model, case, self._fitter, self._reference[1])
        return replace(found, flag="" if run is None else run.flags.text[frame])


def check_diagnosed(config: Config) -> None:
    """Raises `InputError` where the diagnosis has nothing to say of a system."""
    if not config.traits.diagnosed:
        raise InputError(
            "The diagnosis tries changes to FACE IT!; go to a FACE IT! preset for it. What failed under Deep "
            "Energies is named beside the frame, and the film strip shows at which stage."
        )
