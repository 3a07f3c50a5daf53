"""Why one frame fails: every cause is tried on it, and the reasons are ranked by how much their changes improve."""

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


def diagnose_frame(
    model: FaceModel,
    case: FrameCase,
    fitter: FaceItFitter | None = None,
    reference: ShotReference | None = None,
) -> Diagnosis:
    """Ranked reasons why a frame's fit is bad, each with a change that was tried; none for an unremarkable frame.

    Pass a `fitter` of the same model to save setting one up; it is not modified. `reference` (`reference_of`) holds the
    usual values of the shot; share one between several frames, else it is made from the case's shot without this frame.
    Raises `InputError` for a frame without landmarks.
    """
    trial = start_trial(model, case, fitter, reference)
    scored = [(score(trial, finding), finding) for cause in SCHEDULE_CAUSES for finding in cause(trial)]
    # A stuck schedule, or a pose held by bad previous frames, would hide what is wrong with the input.
    patient = trial.with_config(patient_config(case.config))
    for cause in INPUT_CAUSES:
        for finding in cause(patient):
            value = score(patient, finding)
            scored.append((value, retried(trial, finding) if value >= LEAST_SCORE else finding))
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
    model: FaceModel, case: FrameCase, fitter: FaceItFitter | None = None, reference: ShotReference | None = None
) -> Trial:
    """The frame with its fit, ready for testing hypotheses. Raises `InputError` for a frame without landmarks."""
    observation = case.observation
    if observation.landmarks is None:
        raise InputError(
            f"A diagnosis needs landmarks, but frame {observation.index} has none; choose a frame with a face."
        )
    fitter = fitter or FaceItFitter(model, plan_of(case.config))
    if reference is None:
        others = [other for other in case.shot if other.index != observation.index]
        reference = ShotReference(model, case.config, others, fitter)
    return Trial(case, fitter, reference)


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
