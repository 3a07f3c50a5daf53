"""Why a fit should not be used: the single definition for infill, refinement, reports, pictures and the panel."""

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from workbench.landmarks.scheme import POINT_COUNT
from workbench.tracking.records import FrameFit, Track, stack_fits
from workbench.tracking.track_layout import FAILURES

NO_FACE = "no face"
_NUMBERS = ("rotation", "translation", "expression", "identity", "projected")


def failure_of_residuals(
    percent: Float[np.ndarray, "n points"], largest_error: float, largest_disagreement: float = np.inf
) -> Int[np.ndarray, "n"]:
    """Index in `FAILURES` for the residuals of each frame (or view), 0 for none (Deep Energies Sec. 8.2).

    Both limits are in the unit of `percent`: the first applies to the mean over all points, the second to the
    difference between the means over the jaw line and over the inner points. The 68 points count.
    """
    percent = percent[:, :POINT_COUNT]
    disagreement = np.abs(percent[:, :17].mean(1) - percent[:, 17:].mean(1))
    shown = [~np.isfinite(percent).all(1), disagreement > largest_disagreement, percent.mean(1) > largest_error]
    codes = [FAILURES.index(name) for name in ("not finite", "jaw and face disagree", "large error")]
    return np.select(shown, codes, 0)


def failures_of(track: Track, largest_error: float = np.inf) -> Shaped[np.ndarray, "n"]:
    """Why the fit of each frame should not be used: `NO_FACE` or one of `FAILURES`, empty for a usable fit.

    A failure recorded by the fit itself takes precedence. An error is large if its mean over the 68 landmarks exceeds
    `largest_error` % of the outer-eye distance; frames that this view did not see have no error.
    """
    percent = np.where(track.seen[:, None], track.residuals_percent, 0.0)
    finite = np.stack([_finite(getattr(track, name)) for name in _NUMBERS]).all(0)
    shown = np.where(finite, failure_of_residuals(percent, largest_error), FAILURES.index("not finite"))
    codes = np.where(track.failure != 0, track.failure, shown)
    return np.where(track.found, np.array(FAILURES)[codes], NO_FACE)


def _finite(numbers: Float[np.ndarray, "n *rest"]) -> Bool[np.ndarray, "n"]:
    return np.isfinite(numbers).all(axis=tuple(range(1, numbers.ndim)))


def why_failed(fit: FrameFit, largest_error: float = np.inf) -> str:
    """`failures_of` for one frame."""
    return str(failures_of(Track(meta={}, **stack_fits([fit])), largest_error)[0])
