"""The parts of a clip: what is learned on, what chooses the step to stop at, and what only reports."""

import re
from dataclasses import dataclass
from itertools import pairwise

from workbench.errors import ConfigError, InputError

_PART = re.compile(r"(\d+):(\d+)")
LENGTH = 12
"""Frames of a stretch: what is learned on and what is watched need one at least."""
SHORTEST = 3 * LENGTH
"""Frames of the shortest clip that has a stretch for each part."""
SHARES = (0.6, 0.8)
"""Where a clip is cut if nothing is said: after what is learned on, and after what is watched."""


@dataclass(frozen=True)
class Parts:
    """Frames by what they are used for. No frame is in two parts."""

    train: range
    held_out: range
    """Reports; nothing is chosen by it."""
    watch: range | None = None
    """Chooses the step whose values are kept; None: the last step's are."""

    @property
    def named(self) -> dict[str, range]:
        """The parts by name."""
        found = {"train": self.train, "watch": self.watch, "held_out": self.held_out}
        return {name: frames for name, frames in found.items() if frames is not None}


def read_frames(text: str) -> range:
    """The frames that A:B names, without B. Raises `ConfigError` for anything else."""
    found = _PART.fullmatch(text.strip())
    if found is None or int(found[1]) >= int(found[2]):
        raise ConfigError(f"A part of a clip is FIRST:END, without the frame END, got {text!r}; for example 0:300.")
    return range(int(found[1]), int(found[2]))


def usual_cuts(frames: int) -> tuple[int, int]:
    """Where a clip is cut if nothing is said: at its shares, or earlier, so that the last two parts have a stretch."""
    first, second = (round(share * frames) for share in SHARES)
    if frames < SHORTEST:
        return first, second
    return min(first, frames - 2 * LENGTH), min(second, frames - LENGTH)


def parts_of_clip(
    frames: int, train: range | None = None, watch: range | None = None, held_out: range | None = None
) -> Parts:
    """The parts of a clip with this many frames: three fifths, one fifth and one fifth if none is given.

    Of a short clip the last two are longer, so that each has a stretch. Raises `InputError` for a clip that is too
    short for three parts, for parts outside the clip or that overlap, and if one of train and held-out is missing, or
    both while watch is given.
    """
    if train is None and held_out is None and watch is None:
        first, second = usual_cuts(frames)
        train, watch, held_out = range(first), range(first, second), range(second, frames)
        if not (train and watch and held_out):
            raise InputError(f"The clip is too short to tune on: {frames} frame(s); choose a longer one.")
    if train is None or held_out is None:
        raise InputError(
            "A part to learn on needs a part that reports: give --train and --held-out, with or without --watch, or "
            "none of them."
        )
    parts = Parts(train, held_out, watch)
    in_order = sorted(parts.named.items(), key=lambda part: part[1].start)
    for name, part in in_order:
        if not (len(part) and part.stop <= frames):
            raise InputError(
                f"The part {name} is frames {part.start}:{part.stop}, and the clip has 0:{frames}; choose within it."
            )
    for (name, part), (other, later) in pairwise(in_order):
        if later.start < part.stop:
            raise InputError(f"The parts {name} and {other} share frame {later.start}; no frame may be in two parts.")
    return parts
