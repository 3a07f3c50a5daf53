"""From hypotheses to a short ranked list of reasons.

A reason's score is the fraction of the unexplained evidence that its change explains, times the specificity of its
evidence. Conclusive evidence, such as a face cut off by the picture's edge, has a fixed score. A less specific
hypothesis with the same explanation is ranked below the one that outranks it.
"""

from collections.abc import Iterable

import numpy as np

from workbench.diagnosis.records import Reason
from workbench.diagnosis.trial import Finding, Trial

LEAST_SCORE = 0.3
LEAST_GAIN = 12.0
"""Minimum nats that a change must explain to be listed; noise alone gives about half of it."""
LEAST_SHARE = 0.25
DEMOTED = 0.5
CLOSE = 0.7
"""A more specific hypothesis demotes a less specific one whose score is not much better."""
MOST_REASONS = 6


def ranked(scored: Iterable[tuple[float, Finding]]) -> tuple[Reason, ...]:
    """The reasons worth listing, best first and one per code, from scored hypotheses."""
    scored = sorted(scored, key=lambda pair: -pair[0])
    best: dict[str, tuple[float, Finding]] = {}
    for value, finding in scored:
        best.setdefault(finding.code, (value, finding))
    kept = [(_demoted(value, finding, best), finding) for value, finding in best.values()]
    kept = sorted((pair for pair in kept if pair[0] >= LEAST_SCORE), key=lambda pair: -pair[0])
    return tuple(reason_of(finding, value) for value, finding in kept[:MOST_REASONS])


def score(trial: Trial, finding: Finding) -> float:
    """Score of a single hypothesis, 0 to 1."""
    unexplained = max(trial.excess, finding.gain, 1e-9)
    share = float(np.clip(finding.gain / unexplained, 0.0, 1.0))
    by_fit = 0.0
    if finding.gain >= LEAST_GAIN and share >= LEAST_SHARE:
        by_fit = finding.specificity * share * (1.0 - float(np.exp(-finding.gain / LEAST_GAIN)))
    return max(by_fit, finding.direct)


def reason_of(finding: Finding, value: float) -> Reason:
    """The reason made from a finding."""
    told = {"before": f"{finding.before_percent:.1f}", "after": f"{finding.after_percent:.1f}"}
    return Reason(
        code=finding.code,
        title=finding.title,
        evidence=finding.evidence.format(**told),
        score=value,
        numbers={**finding.numbers, "gain_nats": finding.gain},
        change=finding.change,
        before_percent=finding.before_percent,
        after_percent=finding.after_percent,
        measure=finding.measure,
    )


def _demoted(value: float, finding: Finding, best: dict[str, tuple[float, Finding]]) -> float:
    for other_value, other in best.values():
        if finding.code in other.outranks and other_value >= max(CLOSE * value, LEAST_SCORE):
            return min(DEMOTED * value, 0.9 * other_value)
    return value
