"""How good a flow is: end-point error against the truth, and consistency forward and backward without it."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

CONSISTENT_SHARE, CONSISTENT_PX2 = 0.01, 0.5
"""A round trip may miss by this share of the squared lengths of both flows, plus this many square pixels."""


@dataclass(frozen=True)
class EndPointError:
    """Distances between estimated and true flow vectors, in pixels, and how many are counted."""

    mean: float
    median: float
    p90: float
    over_3px: float
    """Share of the pixels that are wrong by more than three pixels."""
    count: int


def end_point_error(
    flow: Float[np.ndarray, "h w 2"], truth: Float[np.ndarray, "h w 2"], where: Bool[np.ndarray, "h w"] | None = None
) -> EndPointError:
    """The error where the mask says (everywhere without one); NaN where nothing is counted."""
    return error_statistics(end_point_errors(flow, truth)[slice(None) if where is None else where].ravel())


def end_point_errors(
    flow: Float[np.ndarray, "*n 2"], truth: Float[np.ndarray, "*n 2"]
) -> Float[np.ndarray, "*n"]:  # fmt: skip
    """Length of the difference of each vector, pixels."""
    return np.linalg.norm(np.asarray(flow) - np.asarray(truth), axis=-1)


def error_statistics(errors: Float[np.ndarray, "n"]) -> EndPointError:
    """A summary of many errors."""
    if not errors.size:
        return EndPointError(*(float("nan"),) * 4, 0)
    median, p90 = np.quantile(errors, [0.5, 0.9])
    return EndPointError(
        float(errors.mean()), float(median), float(p90), float((errors > 3).mean()), int(errors.size)
    )  # fmt: skip


def round_trip(forward: Float[np.ndarray, "h w 2"], backward: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w 2"]:
    """Where each pixel of the first picture comes back to after forward and backward flow, relative to itself.

    Zero for a consistent pair of flows; beyond the border the border's backward flow is taken.
    """
    return forward + _at_target(backward, forward)


def occluded(
    forward: Float[np.ndarray, "h w 2"],
    backward: Float[np.ndarray, "h w 2"],
    share: float = CONSISTENT_SHARE,
    px2: float = CONSISTENT_PX2,
) -> Bool[np.ndarray, "h w"]:
    """Pixels of the first picture that the second does not show, judging by the flows alone.

    |w + w'|² > share·(|w|² + |w'|²) + px2 with w' the backward flow at the target (Sundaram, Brox & Keutzer, ECCV
    2010), or a target beyond the border.
    """
    back = _at_target(backward, forward)
    allowed = share * (_squared_length(forward) + _squared_length(back)) + px2
    height, width = forward.shape[:2]
    x, y = np.moveaxis(forward + _places(height, width), -1, 0)
    beyond = (x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)
    return (_squared_length(forward + back) > allowed) | beyond


def _squared_length(vectors: Float[np.ndarray, "h w 2"]) -> Float[np.ndarray, "h w"]:
    """By component: NumPy takes several times as long for a sum over an axis of two."""
    x, y = np.moveaxis(vectors, -1, 0)
    return x**2 + y**2


def _places(height: int, width: int) -> Float[np.ndarray, "h w 2"]:
    y, x = np.indices((height, width)).astype(np.float32)
    return np.stack([x, y], axis=-1)


def _at_target(field, flow):
    height, width = flow.shape[:2]
    target = (flow + _places(height, width)).astype(np.float32)
    return cv2.remap(
        np.ascontiguousarray(field, np.float32), target, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
