"""Cross-validation: what is hidden from a fit, so that the fit can be asked for it.

Each fold hides some landmarks in some frames. They are hidden as detections of confidence 0: masks are data, so a fold
compiles nothing.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool

POINT_FOLDS = 5
FRAME_FOLDS = 3


def point_folds(frames: int) -> Bool[np.ndarray, "f n 68"]:
    """Each fold hides every fifth landmark in all frames: along a lip or a brow, neighbours of a hidden point are seen.

    An eye corner is never hidden together with the other one of its eye.
    """
    hidden = np.arange(68)[None, :] % POINT_FOLDS == np.arange(POINT_FOLDS)[:, None]
    return np.repeat(hidden[:, None], frames, axis=1)


def frame_folds(frames: int) -> Bool[np.ndarray, "f n 68"]:
    """Each fold hides all landmarks of every third frame: both neighbours of a hidden frame are seen."""
    hidden = np.arange(frames)[None, :] % FRAME_FOLDS == np.arange(FRAME_FOLDS)[:, None]
    return np.repeat(hidden[:, :, None], 68, axis=2)


FOLDS: Mapping[str, Callable[[int], Bool[np.ndarray, "f n 68"]]] = MappingProxyType(
    {"points": point_folds, "frames": frame_folds}
)
"""By kind: what each fold hides in a clip of so many frames."""


def folds_of(kinds: tuple[str, ...], frames: int) -> Bool[np.ndarray, "f n 68"]:
    """What every fit hides, the one that hides nothing first, then the folds of these kinds in turn."""
    nothing = np.zeros((1, frames, 68), bool)
    return np.concatenate([nothing, *(FOLDS[kind](frames) for kind in kinds)])
