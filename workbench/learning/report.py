"""How much better learned settings are, with the interval that a bootstrap over frames gives."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

RUN = 10
"""Frames that a bootstrap draws in a row: neighbours are alike, and one by one would make the interval too narrow."""
DRAWS = 2000
SURE_PERCENT = 95.0


class Change(NamedTuple):
    """The relative change of a mean, in percent; below 0 is better."""

    percent: float
    low: float
    high: float
    """Of the interval that holds 95 % of the bootstrap's draws."""

    def __str__(self) -> str:
        return f"{self.percent:+.1f} % ({self.low:+.1f} to {self.high:+.1f})"


def change_of(before: Float[np.ndarray, "n"], after: Float[np.ndarray, "n"], seed: int = 0) -> Change:
    """The change from one value a frame to another; frames without both do not count."""
    known = ~np.isnan(before) & ~np.isnan(after)
    before, after = before[known], after[known]
    if not len(before):
        return Change(np.nan, np.nan, np.nan)
    run = min(RUN, len(before))
    count = -(-len(before) // run)
    starts = np.random.default_rng(seed).integers(0, len(before) - run + 1, (DRAWS, count))
    drawn = (starts[..., None] + np.arange(run)).reshape(DRAWS, -1)
    shares = after[drawn].mean(1) / before[drawn].mean(1)
    outside = 0.5 * (100.0 - SURE_PERCENT)
    low, high = np.percentile(shares, [outside, 100.0 - outside])
    whole = after.mean() / before.mean()
    return Change(*(round(100.0 * (float(share) - 1.0), 2) for share in (whole, low, high)))
