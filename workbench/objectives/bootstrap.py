"""Bootstrap over runs of frames: how sure a mean is, or a choice that was made by means."""

import numpy as np
from jaxtyping import Bool, Float

LONGEST_RUN = 10
"""Frames that a draw takes in a row: neighbours are alike, and one by one would make intervals too narrow."""
FEWEST_RUNS = 5
"""A draw joins at least this many runs: draws of only a few are too much alike."""
FEWEST_FRAMES = 5
"""With fewer, nothing is known of how sure a mean is."""
DRAWS = 2000
MOST_AT_ONCE = 2**20
"""Sums of runs that are looked at together: 8 MB."""
SURE_PERCENT = 95.0


def drawn_means(values: Float[np.ndarray, "m n"], seed: int = 0, draws: int = DRAWS) -> Float[np.ndarray, "d m"]:
    """The mean of each row over the frames of every draw; NaN does not count, and rows are drawn alike.

    All NaN with fewer than `FEWEST_FRAMES`. After the last frame a run goes on with the first one, so that every frame
    is drawn as often as every other (circular block bootstrap; Politis and Romano 1992).
    """
    frames = values.shape[1]
    if frames < FEWEST_FRAMES:
        return np.full((draws, len(values)), np.nan)
    run = min(LONGEST_RUN, max(1, frames // FEWEST_RUNS))
    count = -(-frames // run)
    starts = np.random.default_rng(seed).integers(0, frames, (draws, count))
    known = np.isfinite(values)
    at_once = max(1, MOST_AT_ONCE // max(1, count * len(values)))
    sums, counts = (
        np.concatenate([runs[starts[first : first + at_once]].sum(1) for first in range(0, draws, at_once)])
        for runs in (_in_runs(part, run) for part in (np.where(known, values, 0.0), known))
    )
    return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)


def interval_of(drawn: Float[np.ndarray, "d"], of_drawn: bool = False) -> tuple[float, float]:
    """The interval that holds 95 % of the draws, NaN if they are; `of_drawn`: the ends are values that were drawn."""
    outside = 0.5 * (100.0 - SURE_PERCENT)
    method = "inverted_cdf" if of_drawn else "linear"
    low, high = np.percentile(drawn, [outside, 100.0 - outside], method=method)
    return float(low), float(high)


def _in_runs(values: Float[np.ndarray, "m n"] | Bool[np.ndarray, "m n"], run: int) -> Float[np.ndarray, "s m"]:
    """Sums of `run` frames from each on, the first frames following the last one."""
    around = np.concatenate([values, values[:, : run - 1]], axis=1)
    before = np.concatenate([np.zeros((len(values), 1)), np.cumsum(around, axis=1)], axis=1)
    return (before[:, run:] - before[:, :-run]).T
