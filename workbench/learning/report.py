"""How much better learned settings are, with the interval that a bootstrap over frames gives."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.objectives import drawn_means, interval_of


class Change(NamedTuple):
    """The relative change of a mean, in percent; below 0 is better. NaN where there is none."""

    percent: float
    low: float
    high: float
    """Of the interval that holds 95 % of the bootstrap's draws; NaN where there are too few frames for one."""

    def __str__(self) -> str:
        if np.isnan(self.percent):
            return "unknown, because no frame has a value before and after, or the mean before is 0"
        if np.isnan(self.low):
            return f"{self.percent:+.1f} % (too few frames for an interval)"
        return f"{self.percent:+.1f} % ({self.low:+.1f} to {self.high:+.1f})"


def change_of(before: Float[np.ndarray, "n"], after: Float[np.ndarray, "n"], seed: int = 0) -> Change:
    """The change from one value per frame to another; frames without both do not count.

    NaN if no frame has both, or if the mean before is 0.
    """
    known = ~np.isnan(before) & ~np.isnan(after)
    before, after = before[known], after[known]
    if not len(before) or before.mean() == 0.0:
        return Change(np.nan, np.nan, np.nan)
    means = drawn_means(np.stack([before, after]), seed)
    means = means[means[:, 0] != 0.0]
    low, high = interval_of(means[:, 1] / means[:, 0])
    whole = after.mean() / before.mean()
    return Change(*(round(100.0 * (float(share) - 1.0), 2) for share in (whole, low, high)))
