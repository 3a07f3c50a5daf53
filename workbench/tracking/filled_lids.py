"""Eyelids of filled frames: as far open as the landmark network sees them where flow has put the face.

Flow hardly sees lids close. The network does, but reads them with a bias that differs between people; so what counts is
how far it sees an eye open beside how far it sees the same eye open in a good frame next to the gap.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.face import FaceParameters
from workbench.face.model import BLINKS
from workbench.landmarks.lids import lid_openings, seen_openings
from workbench.landmarks.network_detector import NetworkDetector
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import POINT_COUNT

STEPS = np.linspace(0.0, 1.0, 11)
"""Blink weights at which the model's own lids are looked at."""
OPEN = 0.15
"""Widths of the eye between the lids from which an eye of a good frame tells what open is."""
ALIKE = 0.1
"""Share of that opening by which look and path may differ: the path then stays as it is."""

Place = Callable[[FaceParameters], Float[np.ndarray, "points 2"]]
"""The model's landmarks in the picture, pixels."""


class _Open(NamedTuple):
    """How far the right and the left eye are open in widths of the eye: by the model, and as seen."""

    own: Float[np.ndarray, "*n 2"]
    seen: Float[np.ndarray, "*n 2"]
    shares: Float[np.ndarray, "*n 2"]
    """How much the look counts."""


def free_blinks(names: Sequence[str], free: Bool[np.ndarray, "k"]) -> tuple[int, ...]:
    """Which weights shut the right and the left eye; none where the model has no such weights, or one is held."""
    if not set(BLINKS) <= set(names):
        return ()
    found = tuple(names.index(name) for name in reversed(BLINKS))
    return found if free[list(found)].all() else ()


def with_seen_lids(
    blinks: Sequence[int],
    place: Place,
    known: Sequence[tuple[FaceParameters, UInt8[np.ndarray, "h w 3"]]],
    path: Sequence[FaceParameters],
    pictures: Iterable[UInt8[np.ndarray, "h w 3"]],
) -> list[FaceParameters]:
    """The path through a gap with the weights `blinks` (of the right and the left eye) set by what is seen.

    `known` are the good frames next to the gap, `pictures` those of the gap. Eyes that are shut in all good frames, and
    looks that are unsure, leave the weights as they are.
    """
    good = _Open(*map(np.stack, zip(*(_look(place, at, picture) for at, picture in known), strict=True)))
    telling = (good.shares > 0.0) & (good.seen >= OPEN)
    bias = np.where(telling, good.own / np.where(telling, good.seen, 1.0), 0.0)
    least = ALIKE * (good.own * telling).max(axis=0)
    found = []
    for k, (at, picture) in enumerate(zip(path, pictures, strict=True)):
        # Both ends of the gap count by how near they are.
        near = telling * np.abs(np.array([1.0, 0.0])[: len(known)] - (k + 1) / (len(path) + 1))[:, None]
        here = _look(place, at, picture)
        wanted = here.seen * (near * bias).sum(axis=0) / np.maximum(near.sum(axis=0), 1e-9)
        moved = telling.any(axis=0) & (here.shares > 0.0) & (np.abs(wanted - here.own) > least)
        found.append(_with_openings(place, at, blinks, here.own + here.shares * (wanted - here.own), moved))
    return found


def _look(place: Place, at: FaceParameters, picture: UInt8[np.ndarray, "h w 3"]) -> _Open:
    face = place(at)[:POINT_COUNT]
    return _Open(lid_openings(face), *seen_openings(face, _refine(picture, face)))


def _with_openings(place: Place, at: FaceParameters, blinks, openings, moved) -> FaceParameters:
    """The parameters with blinks by which the model's lids are so far open, for the eyes that are `moved`."""
    if not moved.any():
        return at

    def blinking(weights) -> FaceParameters:
        expression = np.array(at.expression, float)
        expression[list(blinks)] = weights
        return at._replace(expression=expression)

    # From shut to open, for `np.interp`.
    curves = np.array([lid_openings(place(blinking(weight))[:POINT_COUNT]) for weight in STEPS])[::-1]
    curves = np.maximum.accumulate(curves, axis=0)
    weights = [np.interp(openings[eye], curves[:, eye], STEPS[::-1]) for eye in range(len(blinks))]
    return blinking(np.where(moved, weights, np.asarray(at.expression)[list(blinks)]))


def _refine(picture: UInt8[np.ndarray, "h w 3"], face: Float[np.ndarray, "68 2"]) -> Landmarks2D:
    return _network().refine(picture, face)


@cache
def _network() -> NetworkDetector:
    return NetworkDetector()
