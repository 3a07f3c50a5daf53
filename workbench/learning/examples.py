"""Stretches of a clip to learn from, each with what its objectives look at."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool

from workbench.arrays import AnyArray
from workbench.config import Config
from workbench.errors import InputError
from workbench.face import FaceParameters
from workbench.learning.chain import Stretch
from workbench.learning.parts import LENGTH
from workbench.objectives import ObservedClip
from workbench.sweeps.clips import SweptClip
from workbench.sweeps.results import clip_in
from workbench.sweeps.solving import ChainJob, ClipSolver
from workbench.tracking import FrameObservation
from workbench.tracking.walk import jumped

SETTLING = 4
"""Frames at its beginning that no objective counts: it is fitted from scratch, and E_τ begins with its third frame."""
PARTS_IN_WORDS = {
    "train": ("The frames to learn on", "choose more of them (--train, with --held-out)"),
    "watch": (
        "The frames that choose the step",
        "choose more of them (--watch, with --train and --held-out), or give --train and --held-out alone: then the "
        "last step is kept",
    ),
}
"""What a part without a stretch is called, and what to do."""


class Example(NamedTuple):
    """A stretch of a clip, with what objectives look at in it."""

    stretches: Stretch
    """As each fit sees it, stacked: first everything, then what the folds of cross-validation see."""
    clip: ObservedClip
    counted: Bool[AnyArray, "n"]
    """Frames that objectives count."""


def example_of(
    solver: ClipSolver, config: Config, clip: SweptClip, frames: range, kinds: tuple[str, ...] = ()
) -> Example:
    """The example of some frames in a row; `kinds` are the folds that its objectives look at.

    Identities are those that the configuration calibrates; they do not move with what is learned.
    """
    jobs = [job for job, _ in solver.jobs(config, clip, [frames], kinds)]
    stretches = jax.tree.map(lambda *leaves: np.stack([*map(np.asarray, leaves)]), *map(_stretch_of, jobs))
    counted = np.arange(len(frames)) >= min(SETTLING, len(frames) - 1)
    return Example(stretches, clip_in(clip, [frames], config), counted)


def _stretch_of(job: ChainJob) -> Stretch:
    frames = job.frames
    start = FaceParameters(frames.rotation[0], frames.translation[0], frames.expression[0], np.zeros(0))
    measured = frames.measured
    return Stretch(measured[..., :2], measured[..., 2], start, job.person, job.setting.numbers, frames.whitening)


def stretches_in(clip: SweptClip, frames: range, part: str) -> list[range]:
    """The frames of a part, "train" or "watch", in stretches. Raises `InputError` for a part without any."""
    found = runs_in(clip.observations, frames)
    if not found:
        what, remedy = PARTS_IN_WORDS[part]
        where = f"{frames.start}:{frames.stop}"
        raise InputError(f"{what}, {where}, have no run of {LENGTH} with a face and without a cut; {remedy}.")
    return found


def runs_in(observations: Sequence[FrameObservation], frames: range) -> list[range]:
    """Frames in stretches, each with a face throughout, without a cut, a gap or a jump between them."""
    found, run = [], 0
    for k in frames:
        now = observations[k].landmarks
        if now is None:
            run = 0
            continue
        goes_on = run and not observations[k].cut
        run = run + 1 if goes_on and not jumped(observations[k - 1].landmarks.points, now.points) else 1
        if run == LENGTH:
            found.append(range(k + 1 - LENGTH, k + 1))
            run = 0
    return found


def size_of(clip: SweptClip, stretches: Sequence[range]) -> tuple[int, int]:
    """(width, height) of the pictures of some stretches. Raises `InputError` where they differ."""
    sizes = {clip.observations[k].image_size for stretch in stretches for k in stretch}
    if len(sizes) > 1:
        raise InputError(
            f"The pictures of {clip.name} differ in size, and a gradient goes through one camera; learn on frames of "
            "one size (--train), or search (--search)."
        )
    return sizes.pop()


def spread(stretches: Sequence[range], count: int) -> list[range]:
    """Up to `count` of the stretches, evenly over them."""
    count = min(count, len(stretches))
    return [stretches[(2 * k + 1) * len(stretches) // (2 * count)] for k in range(count)]
