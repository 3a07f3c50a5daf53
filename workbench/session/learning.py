"""Tuning inside a session: its frames choose settings of its configuration."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from workbench.config import Config
from workbench.face import FaceModel
from workbench.learning import Tuned, Wanted, parts_of_clip, read_frames, tuned
from workbench.learning.tuning import STEPS, TRIALS, Tell, silent
from workbench.objectives import read_sum
from workbench.session.material import Cancelled
from workbench.session.sweeping import SessionSweeps
from workbench.sweeps import SweptClip, read_axis
from workbench.sweeps.stored_clips import packed_clip
from workbench.tracking.unwatched import never


def tune_material(
    sweeps: SessionSweeps,
    model: FaceModel,
    config: Config,
    objective: str,
    learn: Sequence[str] = (),
    search: Sequence[str] = (),
    train: str | None = None,
    watch: str | None = None,
    held_out: str | None = None,
    steps: int = STEPS,
    trials: int = TRIALS,
    truth: str | Path | None = None,
    place: str | Path | None = None,
    resume: bool = False,
    progress: Tell = silent,
    cancelled: Cancelled = never,
) -> Tuned:
    """The configuration that an objective likes best, learned by gradient or searched.

    Parts are frames as "0:300"; `place` keeps what `resume` continues from; `cancelled` stops learning
    after a step, and keeps what it had found. Raises `ConfigError` and `InputError` for
    what cannot be tuned.
    """
    objectives = read_sum(objective)
    clip = sweeps.clip(objectives.names, truth)
    clip = replace(clip, digest=_digest(clip))
    given = [None if text is None else read_frames(text) for text in (train, watch, held_out)]
    parts = parts_of_clip(len(clip.observations), *given)
    wanted = Wanted(objectives, parts, tuple(learn), tuple(map(read_axis, search)), steps, trials)
    stored = None if place is None else Path(place)
    return tuned(model, config, clip, wanted, progress, stored, resume, stopped=cancelled)


def _digest(clip: SweptClip) -> str:
    """SHA-256 of what is known of a clip, so that only a tuning on the same clip is continued."""
    return hashlib.sha256(packed_clip(clip)).hexdigest()
