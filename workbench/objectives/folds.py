"""Cross-validation: what is hidden from a fit, so that the fit can be asked for it.

Each fold hides some landmarks in some frames. They are hidden as detections of confidence 0: masks are data, so a fold
compiles nothing.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool

from workbench.landmarks.scheme import IBUG68, LandmarkScheme

PARTS = ("jaw", "brows", "nose", "eyes", "mouth")
POINT_FOLDS = 5
FRAME_FOLDS = 3


def point_folds(frames: int, scheme: LandmarkScheme = IBUG68) -> Bool[np.ndarray, "f n points"]:
    """Each fold hides every fifth landmark in all frames: along a lip or a brow, neighbours of a hidden point are seen.

    An eye corner is never hidden together with the other one of its eye.
    """
    hidden = np.arange(len(scheme))[None, :] % POINT_FOLDS == np.arange(POINT_FOLDS)[:, None]
    return np.repeat(hidden[:, None], frames, axis=1)


def part_folds(frames: int, scheme: LandmarkScheme = IBUG68) -> Bool[np.ndarray, "f n points"]:
    """Each fold hides a whole part of the face in all frames, eyes with their irises: no neighbour of a hidden point is
    seen, except those of cheeks and forehead that a scheme may have."""
    with_irises = {"eyes": ("eyes", *({"irises"} & set(scheme.groups)))}
    hidden = np.array([scheme.group_mask(*with_irises.get(part, (part,))) for part in PARTS])
    return np.repeat(hidden[:, None], frames, axis=1)


def frame_folds(frames: int, scheme: LandmarkScheme = IBUG68) -> Bool[np.ndarray, "f n points"]:
    """Each fold hides all landmarks of every third frame: both neighbours of a hidden frame are seen."""
    hidden = np.arange(frames)[None, :] % FRAME_FOLDS == np.arange(FRAME_FOLDS)[:, None]
    return np.repeat(hidden[:, :, None], len(scheme), axis=2)


FOLDS: Mapping[str, Callable[..., Bool[np.ndarray, "f n points"]]] = MappingProxyType(
    {"points": point_folds, "parts": part_folds, "frames": frame_folds}
)
"""By kind: what each fold hides in a clip with this many frames, of the 68 or of another scheme's points."""


def folds_of(kinds: tuple[str, ...], frames: int, scheme: LandmarkScheme = IBUG68) -> Bool[np.ndarray, "f n points"]:
    """What every fit hides, the one that hides nothing first, then the folds of these kinds in turn."""
    nothing = np.zeros((1, frames, len(scheme)), bool)
    return np.concatenate([nothing, *(FOLDS[kind](frames, scheme) for kind in kinds)])
