"""Compiling what a panel can request before it is requested."""

from workbench.config import Config
from workbench.errors import StoppedError
from workbench.face import FaceModel
from workbench.planning import plan_of
from workbench.session.material import Cancelled
from workbench.tracking import FaceItFitter


def get_ready(session, cancelled: Cancelled) -> None:
    """Compile every solver of a `TuningSession`, with and without its trace, and a diagnosis.

    Raises `StoppedError` if cancelled between two of them.
    """
    if not session.base.traits.real_time:
        session.fit_frame(0, cancelled=cancelled)
        return
    observations = session.material.observations
    compile_solvers(session.model, session.base, observations[0].image_size, cancelled)
    seen = next((k for k, observation in enumerate(observations) if observation.landmarks is not None), None)
    if seen is not None and session.config.traits.diagnosed:  # which may have changed meanwhile
        session.diagnose(seen, cancelled=cancelled)


def compile_solvers(model: FaceModel, config: Config, image_size: tuple[int, int], cancelled: Cancelled) -> None:
    """Compile every solver that a panel offers for FACE IT!, with and without its trace, and the calibrations.

    Raises `StoppedError` if cancelled between two of them.
    """
    for method in ("lm", "optimistix-lm"):  # "optimistix-dogleg" is the same program as "optimistix-lm"
        if cancelled():
            raise StoppedError("Getting ready was cancelled: the first moves may be slower.")
        fitter = FaceItFitter(model, plan_of(config.changed(solver={"method": method, "bounded": False}), model.scheme))
        fitter.warm_up(image_size, trace=True)
    for frames in {1, config.identity.frames}:
        fitter.calibrate([fitter.neutral_observation(image_size)], frames)
