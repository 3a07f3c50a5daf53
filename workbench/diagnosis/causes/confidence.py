"""The detector's own doubts: a part of the face, or all of it, of which it is less sure than elsewhere in the shot."""

from collections.abc import Iterator

import numpy as np

from workbench.diagnosis.causes.groups import SIDES, TRIED, mask_of, muted, title_of
from workbench.diagnosis.reference import robust_similarity
from workbench.diagnosis.trial import Finding, Trial, points_change

UNSURE = 0.5
"""Confidence relative to the usual one below which a part is in doubt."""
CLEARLY_LESS = 0.3
"""How much lower it must be there than elsewhere in the face for the part to be named."""


def doubted_part(trial: Trial) -> Iterator[Finding]:
    """The detector is unsure of a part of which it is sure in the shot's other frames."""
    relative = np.minimum(trial.relative_confidence, 1.0)
    named = {name: mask_of(trial, name) for name in (*TRIED, *SIDES)}
    name = max(named, key=lambda part: relative[~named[part]].mean() - relative[named[part]].mean())
    mask, title = named[name], title_of(name)
    here, elsewhere = float(relative[mask].mean()), float(relative[~mask].mean())
    if here > UNSURE:
        return
    if elsewhere - here < CLEARLY_LESS:
        mask, title = np.ones(len(relative), bool), "whole face"
    index, usual = trial.case.observation.index, trial.reference.usual_confidence
    others = [
        frame
        for frame in trial.case.shot
        if frame.landmarks is not None and frame.landmarks.confidence[mask].mean() > 0.8 * usual[mask].mean()
    ]
    nearest = min(others, key=lambda frame: abs(frame.index - index), default=None)
    if nearest is None or nearest.index == index:
        # With the whole face muted there would be nothing to fit to: its worst part is named.
        mask, title, change = named[name], title_of(name), muted(trial, name)
    else:
        source = nearest.landmarks.points
        places = source if mask.all() else robust_similarity(source, trial.points).to_image(source)
        change = points_change(f"Take the points of the {title} from frame {nearest.index}", places, mask)
    sure, usual = trial.case.observation.landmarks.confidence[mask], usual[mask]
    here = float(relative[mask].mean())
    fit, muted_points = trial.refit(change), mask if change.config else None
    yield Finding(
        code="doubted_part",
        title=f"The detector doubts the {title}",
        evidence=f"Its confidence there is {sure.mean():.2f}, against {usual.mean():.2f} in most frames of the shot: "
        "covered, blurred, or an expression that it does not know.",
        change=change,
        gain=trial.gain(fit, doubted=mask),
        before_percent=trial.error_percent(trial.fit, muted_points),
        after_percent=trial.error_percent(fit, muted_points),
        doubted=muted_points,
        direct=float(np.interp(here, [0.0, UNSURE], [0.7, 0.4])),
        numbers={"confidence": float(sure.mean()), "usual_confidence": float(usual.mean()), "relative": here},
        outranks=("group_biased", "jaw_disagrees"),
    )
