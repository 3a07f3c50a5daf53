"""Why one frame fails: every cause is tried on it, and the reasons are ranked by how much their changes improve."""

from collections.abc import Callable
from dataclasses import replace

from workbench.config import Config
from workbench.diagnosis.causes import INPUT_CAUSES, SCHEDULE_CAUSES
from workbench.diagnosis.causes.configuration import RELAXED_TAU
from workbench.diagnosis.group_pull import leave_one_group_out as pulls_of
from workbench.diagnosis.ranking import LEAST_SCORE, ranked, score
from workbench.diagnosis.records import Diagnosis, FrameCase, GroupPull
from workbench.diagnosis.reference import ShotReference, jointly
from workbench.diagnosis.trial import Finding, Trial
from workbench.diagnosis.uncertainty import estimate_uncertainty
from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.planning import plan_of
from workbench.tracking import FaceItFitter
from workbench.tracking.unwatched import never, silent


def diagnose_frame(
    model: FaceModel,
    case: FrameCase,
    fitter: FaceItFitter | None = None,
    reference: ShotReference | None = None,
    progress: Callable[[str, int, int], object] = silent,
    cancelled: Callable[[], bool] = never,
) -> Diagnosis:
    """Ranked reasons why a frame's fit is bad, each with a change that was tried; none for an unremarkable frame.

    Pass a `fitter` of the same model to save setting one up; it is not modified. `reference` (`reference_of`) holds the
    usual values of the shot; share one between several frames, else it is made from the case's shot without this frame.
    `progress(step, done, total)` is called after each cause, and `cancelled` is asked before each fit. Raises
    `InputError` for a frame without landmarks, and `StoppedError` if cancelled.
    """
    trial = start_trial(model, case, fitter, reference, cancelled)
    # A stuck schedule, or a pose held by bad previous frames, would hide what is wrong with the input.
    patient = trial.with_config(patient_config(case.config))
    causes = [(cause, trial) for cause in SCHEDULE_CAUSES] + [(cause, patient) for cause in INPUT_CAUSES]
    scored = []
    for done, (cause, at) in enumerate(causes, start=1):
        for finding in cause(at):
            value = score(at, finding)
            again = at is patient and value >= LEAST_SCORE
            scored.append((value, retried(trial, finding) if again else finding))
        progress("diagnose", done, len(causes))
    return Diagnosis(
        reasons=ranked(scored),
        leave_group_out=pulls_of(trial),
        uncertainty=estimate_uncertainty(model, case.config, case.context, trial.fit),
        fit=trial.fit,
    )


def leave_one_group_out(model: FaceModel, case: FrameCase, fitter: FaceItFitter | None = None) -> tuple[GroupPull, ...]:
    """The effect of each landmark group on the fit of a frame, measured by fits without it.

    Raises `InputError` for a frame without landmarks.
    """
    return pulls_of(start_trial(model, case, fitter, None))


def start_trial(
    model: FaceModel,
    case: FrameCase,
    fitter: FaceItFitter | None = None,
    reference: ShotReference | None = None,
    cancelled: Callable[[], bool] = never,
) -> Trial:
    """The frame with its fit, ready for testing hypotheses. Raises `InputError` for a frame without landmarks."""
    observation = case.observation
    if observation.landmarks is None:
        raise InputError(
            f"A diagnosis needs landmarks, but frame {observation.index} has none; choose a frame with a face."
        )
    fitter = fitter or FaceItFitter(model, plan_of(case.config, model.scheme))
    if reference is None:
        others = [other for other in case.shot if other.index != observation.index]
        reference = ShotReference(model, case.config, others, fitter)
    return Trial(case, fitter, reference, cancelled=cancelled)


def patient_config(config: Config) -> Config:
    """The configuration with a joint solve, enough iterations, and almost no influence of previous frames."""
    return jointly(config).changed(weights={"tau": config.weights.tau * RELAXED_TAU})


def retried(trial: Trial, finding: Finding) -> Finding:
    """A finding of the patient solve, with its change tried again under the configuration of the case."""
    if finding.change is None or finding.measure != "landmark error":
        return finding
    fit = trial.refit(finding.change)
    return replace(
        finding,
        before_percent=trial.error_percent(trial.fit, finding.doubted),
        after_percent=trial.error_percent(fit, finding.doubted),
    )
