"""A clip as a sweep sees it: the landmarks of its frames, and the parts of it that are fitted."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from workbench.errors import ConfigError
from workbench.landmarks.observations import scheme_of_faces
from workbench.landmarks.scheme import LandmarkScheme
from workbench.objectives import SecondView, Truth
from workbench.tracking import FrameObservation

WINDOW = 20
"""Frames in a row where a budget chooses: jitter and E_τ need neighbours."""
PART = 256
"""Frames of a part, so that tasks stay small; a longer shot is a part of its own, for state goes through it."""


@dataclass(frozen=True, eq=False)
class SweptClip:
    """The observations of a clip, with what else its objectives need."""

    name: str
    digest: str
    """SHA-256 of what the observations and the rest were made from."""
    observations: tuple[FrameObservation, ...]
    stills: bool
    truth: Truth = field(default_factory=Truth)
    flow: np.ndarray | None = None
    """As `ObservedClip.flow`, for all frames."""
    second: SecondView | None = None

    @cached_property
    def scheme(self) -> LandmarkScheme:
        """What its points are called."""
        return scheme_of_faces(seen.landmarks for seen in self.observations)

    @cached_property
    def shots(self) -> tuple[range, ...]:
        """The frames of each shot, as the tracker divides them."""
        starts = [k for k, item in enumerate(self.observations) if k == 0 or item.cut or self.stills]
        return tuple(range(*pair) for pair in zip(starts, [*starts[1:], len(self.observations)], strict=True))


def chosen_windows(shots: Sequence[range], budget: int | None) -> tuple[range, ...]:
    """The frames that are fitted, in runs inside shots: all of them, or `budget` frames spread over the clip.

    Each run starts from scratch, as a shot does. Raises `ConfigError` for a budget below one frame.
    """
    if budget is None:
        return tuple(shots)
    if budget < 1:
        raise ConfigError(f"A budget has at least one frame, got {budget}.")
    total = sum(map(len, shots))
    if budget >= total:
        return tuple(shots)
    pieces = [
        range(start, min(start + WINDOW, shot.stop)) for shot in shots for start in range(shot.start, shot.stop, WINDOW)
    ]
    # Short ends of shots hold few frames for a second difference; they fill what the others leave.
    chosen = _filled([piece for piece in pieces if len(piece) == WINDOW], budget)
    short = [piece for piece in pieces if len(piece) < WINDOW]
    chosen += _filled(short, budget - sum(map(len, chosen)))
    return tuple(sorted(chosen, key=lambda piece: piece.start))


def _filled(pieces: Sequence[range], budget: int) -> list[range]:
    """Pieces that hold so many frames together, evenly spread, the last one cut; all if they hold no more."""
    if not pieces or budget < 1:
        return []
    lengths = np.array([len(piece) for piece in pieces])
    wanted = -(-budget // int(lengths.max()))
    while wanted < len(pieces) and lengths[_spread(len(pieces), wanted)].sum() < budget:
        wanted += 1
    chosen, left = [], budget
    for k in _spread(len(pieces), wanted):
        chosen.append(pieces[k][:left])
        left -= len(chosen[-1])
    return [piece for piece in chosen if len(piece)]


def _spread(count: int, wanted: int) -> list[int]:
    """So many of the numbers below `count`, evenly spread; all if there are no more."""
    wanted = min(count, wanted)
    return [int((2 * k + 1) * count // (2 * wanted)) for k in range(wanted)]


def parts_of(windows: Sequence[range]) -> tuple[tuple[range, ...], ...]:
    """Windows in groups of about `PART` frames: no state crosses from one group to another."""
    parts: list[list[range]] = []
    for window in windows:
        if not parts or sum(map(len, parts[-1])) + len(window) > PART:
            parts.append([])
        parts[-1].append(window)
    return tuple(map(tuple, parts))


def frames_of(clip: SweptClip, windows: Sequence[range]) -> tuple[FrameObservation, ...]:
    """The observations of some windows in a row; each begins with a cut."""
    return tuple(replace(clip.observations[k], cut=k == window.start) for window in windows for k in window)
