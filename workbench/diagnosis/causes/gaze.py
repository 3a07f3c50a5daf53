"""A pupil that is not where the other eye looks: on a reflection, on the rim of glasses, on a shadow."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from workbench.diagnosis.records import Change
from workbench.diagnosis.trial import Finding, Trial, points_change
from workbench.landmarks.lids import EYES
from workbench.landmarks.schemes import PUPILS

STRAY_PERCENT, FAR_PERCENT = 4.5, 8.0
"""Distance from the other eye's look at which a pupil is taken for a stray one, and at which it surely is; 4.5 % of the
eye distance is a turn of some 20°, and more than half of the way to the border of the iris."""
UNUSUAL = 2.5
"""How many times its usual distance in the shot it must be away: eyeballs are not as large as the head's."""
SEEN = 0.3
"""Confidence of a pupil below which its eye counts as shut, or as not seen."""


class _Without(NamedTuple):
    """What a fit that looks where the other eye looks says of a pupil."""

    points: Bool[np.ndarray, "points"]
    """The pupil, and the border of its iris where the scheme has one: the fit leaves them out."""
    away_px: Float[np.ndarray, "2"]
    """How far they are from where this fit puts them, along the line of the eye's corners.

    Not across it: lids that close are taken for a look downwards where no pupil says otherwise.
    """
    usual_percent: float
    """The distance in the shot's other frames, % of the face's size; 0 if not known."""


def stray_pupil(trial: Trial) -> Iterator[Finding]:
    """The eyes look apart: one pupil lies to a side of where the other eye's look puts it."""
    if "pupils" not in trial.scheme.groups or trial.case.observation.landmarks.confidence[list(PUPILS)].min() < SEEN:
        return
    # Left out, a stray pupil is farther from the rest than a good one is from a stray one and all priors.
    tried = [_without(trial, side) for side in range(2)]
    side = int(np.argmax([np.linalg.norm(each.away_px) for each in tried]))
    points, away_px, usual = tried[side]
    name, away = ("right", "left")[side], float(trial.percent(np.linalg.norm(away_px)))
    if away < max(STRAY_PERCENT, UNUSUAL * usual):
        return
    change = points_change(f"Put the {name} pupil where the other eye looks", trial.points - away_px, points)
    missed = trial.refit(change).projected[PUPILS[side]] - (trial.points[PUPILS[side]] - away_px)
    yield Finding(
        code="stray_pupil",
        title=f"The {name} pupil is not where the other eye looks",
        evidence=f"It lies {away:.1f} % of the eye distance to the side of where the look of the other eye puts it "
        f"({usual:.1f} % in the shot), and eyes do not look so far apart: a reflection, the rim of glasses, a shadow.",
        change=change,
        gain=0.0,
        before_percent=away,
        after_percent=float(trial.percent(np.linalg.norm(missed))),
        direct=float(np.interp(away, [STRAY_PERCENT, FAR_PERCENT], [0.5, 0.85])),
        numbers={"away_percent": away, "usual_percent": usual, "pupil": float(PUPILS[side])},
        measure="distance from the other eye's look",
    )


def _without(trial: Trial, side: int) -> _Without:
    points = trial.scheme.group_mask("irises") & (trial.nearest(PUPILS) == side)
    chosen = np.flatnonzero(points)
    fit = trial.refit(Change("", config={"landmarks": {"weights": {str(point): 0.0 for point in chosen}}}))
    first, second = trial.points[list(EYES[side][0])]
    along = (second - first) / max(np.linalg.norm(second - first), 1e-9)
    offset = (trial.points - fit.projected)[chosen].mean(axis=0)
    usual = np.linalg.norm(trial.reference.offsets_without(chosen), axis=1) if trial.reference.knows_person else []
    return _Without(points, (offset @ along) * along, float(np.median(usual)) if len(usual) else 0.0)
