"""Causes in the configuration: too few iterations, a dominant prior, weights at their bounds, stuck alternation."""

from collections.abc import Iterator

import numpy as np

from workbench.diagnosis.group_pull import between_poses
from workbench.diagnosis.records import Change
from workbench.diagnosis.reference import jointly
from workbench.diagnosis.trial import Finding, Trial
from workbench.solvers import Status

MORE_ITERATIONS = 20
LARGEST_LIMIT = 500
RELAXED_TAU = 1e-3
"""Factor on ω_τ that shows how much it holds back."""
PULLING_TAU = 0.2
"""Ratio of E_τ to the data term above which it distorts the pose."""
FEWEST_AT_BOUND = 3
JOINT_LIMIT = 60
LEAST_POSE_DEG, LEAST_POSE_MM = 1.0, 3.0
LEAST_STUCK_PERCENT = 2.0
"""Error below which a frame is fine, because alternation always leaves a small error."""


def not_converged(trial: Trial) -> Iterator[Finding]:
    """A stage stops at its limit (ρ or ε) although more iterations would help."""
    stages, best = trial.case.config.running(start=True), None
    for stage, ended in zip(stages, trial.fit.status, strict=True):
        if ended != Status.ITERATION_LIMIT.value:
            continue
        more = min(stage.limit + MORE_ITERATIONS, LARGEST_LIMIT)
        one_more, many_more = (
            trial.refit(Change(f"Raise the limit of “{stage.name}” to {limit}", limits={stage.name: limit}))
            for limit in (min(stage.limit + 1, LARGEST_LIMIT), more)
        )
        gain = trial.gain(many_more)
        if best is None or gain > best[0]:
            best = gain, stage, more, one_more, many_more
    if best is None or best[0] <= 0.0:
        return
    gain, stage, more, one_more, many_more = best
    before, once, after = (trial.error_percent(fit) for fit in (trial.fit, one_more, many_more))
    yield Finding(
        code="not_converged",
        title=f"The stage “{stage.name}” has too few iterations",
        evidence=f"The stage ends at its limit of {stage.limit}: one more iteration changes the error from "
        f"{before:.1f} to {once:.1f}, {MORE_ITERATIONS} more to {after:.1f} % of the eye distance.",
        change=Change(f"Raise the limit of “{stage.name}” to {more}", limits={stage.name: more}),
        gain=gain,
        before_percent=before,
        after_percent=after,
        specificity=1.0 if stage.limit <= 5 else 0.9,
        numbers={"limit": float(stage.limit), "one_more_percent": once, "more_percent": after},
        outranks=("pose_expression_tradeoff", "weights_at_bounds"),
    )


def tau_fights_data(trial: Trial) -> Iterator[Finding]:
    """E_τ keeps the pose at constant velocity while the landmarks accelerate."""
    weights = trial.case.config.weights
    last = trial.case.context.last
    if last is None or last.frames < 2 or weights.tau * weights.prior == 0.0:
        return
    relaxed = weights.tau * RELAXED_TAU
    change = Change(f"Lower ω_τ from {weights.tau:g} to {relaxed:g}", config={"weights": {"tau": relaxed}})
    fit = trial.refit(change)
    if _tau_share(trial) > PULLING_TAU:
        # Previous frames were held back too, so this one may not converge from their result.
        fit = min(fit, trial.refit(change, trial.case.context._replace(last=None)), key=trial.misfit)
    gain = trial.gain(fit)
    if gain <= 0.0:
        return
    before, after = trial.error_percent(trial.fit), trial.error_percent(fit)
    degrees, millimetres = between_poses(trial.fit, fit)
    yield Finding(
        code="tau_fights_data",
        title="The smoothness of the pose (ω_τ) works against the landmarks",
        evidence=f"With ω_τ = {relaxed:g} instead of {weights.tau:g} the pose moves by {degrees:.1f}° and "
        f"{millimetres:.0f} mm and the error falls from {before:.1f} to {after:.1f} % of the eye distance.",
        change=change,
        gain=gain,
        before_percent=before,
        after_percent=after,
        numbers={"tau": weights.tau, "pose_deg": degrees, "pose_mm": millimetres},
        outranks=("pose_expression_tradeoff", "jaw_disagrees", "group_biased", "occluded"),
    )


def _tau_share(trial: Trial) -> float:
    """E_τ relative to the data term, in the stage where it is largest."""
    energies = dict(zip(trial.case.config.terms, np.nan_to_num(trial.fit.energies).T, strict=True))
    return float((energies["tau"] / np.maximum(energies["landmarks"], 1e-9)).max())


def weights_at_bounds(trial: Trial) -> Iterator[Finding]:
    """Blendshape weights press against 1: the expression exceeds the model's range.

    Not of statistical components, which the range term would pull into [0, 1].
    """
    if not (trial.case.config.solver.bounded and trial.weights_from_0_to_1):
        return
    pressing = trial.fit.expression >= 1.0 - 1e-6
    count = int(pressing.sum())
    if count < FEWEST_AT_BOUND:
        return
    config = {"solver": {"bounded": False}, "weights": {"range": max(trial.case.config.weights.range, 5.0)}}
    change = Change("Let weights leave [0, 1] with a quadratic penalty", config=config)
    fit = trial.refit(change)
    names = [name for name, at in zip(trial.names, pressing, strict=True) if at]
    before, after = trial.error_percent(trial.fit), trial.error_percent(fit)
    yield Finding(
        code="weights_at_bounds",
        title=f"{count} blendshape weights press against their bound",
        evidence=f"{', '.join(names[:4])}{' and others' if count > 4 else ''} are at 1; without the bound the error "
        f"goes from {before:.1f} to {after:.1f} % of the eye distance.",
        change=change,
        gain=trial.gain(fit, 0.5 * count),
        before_percent=before,
        after_percent=after,
        specificity=0.7,
        numbers={"count": float(count), "largest_free": float(fit.expression.max())},
    )


def pose_expression_tradeoff(trial: Trial) -> Iterator[Finding]:
    """Solved in turn, pose and expression block each other, while a joint solve finds a better pair."""
    config = trial.case.config
    if any("expression" in stage.free and len(stage.free) > 1 for stage in config.stages):
        return
    patient = {
        stage.name: JOINT_LIMIT
        for stage in config.running(trial.case.context.last is None)
        if stage.limit < JOINT_LIMIT
    }
    alternated = trial.refit(Change("", limits=patient))
    stages = [stage.model_dump() for stage in jointly(config).stages]
    change = Change("Solve pose and expression together", config={"stages": stages})
    joint = trial.refit(change)
    # Only a result that alternation cannot reach with enough iterations is evidence for the joint solve.
    gain = min(trial.gain(joint), trial.misfit(alternated) - trial.misfit(joint))
    degrees, millimetres = between_poses(trial.fit, joint)
    if gain <= 0.0 or (degrees < LEAST_POSE_DEG and millimetres < LEAST_POSE_MM):
        return
    before, after = trial.error_percent(trial.fit), trial.error_percent(joint)
    if before < LEAST_STUCK_PERCENT:
        return
    strongest = int(np.argmax(np.abs(joint.expression - trial.fit.expression)))
    then, now = trial.fit.expression[strongest], joint.expression[strongest]
    yield Finding(
        code="pose_expression_tradeoff",
        title="Pose and expression trade against each other",
        evidence=f"Solved together, the pose moves by {degrees:.1f}° and {millimetres:.0f} mm, "
        f"{trial.names[strongest]} from {then:.2f} to {now:.2f}, and the error falls from {before:.1f} to {after:.1f} "
        "% of the eye distance.",
        change=change,
        gain=gain,
        before_percent=before,
        after_percent=after,
        specificity=0.75,
        numbers={"pose_deg": degrees, "pose_mm": millimetres},
    )
