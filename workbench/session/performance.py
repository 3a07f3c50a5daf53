"""The performance of a session as a track that can be exported, and the commands that make the same file."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from workbench.config import Config
from workbench.session.clip_run import Run, described_track
from workbench.session.exports import model_words
from workbench.session.material import Cancelled, Progress
from workbench.session.tuning import TuningSession
from workbench.tracking import Track
from workbench.tracking.records import stack_fits
from workbench.tracking.unwatched import never


def performance_track(
    session: TuningSession,
    progress: Progress | None = None,
    cancelled: Cancelled = never,
    config: Config | None = None,
) -> Track | None:
    """The clip under the current configuration, or `config`, infilled and refined if configured; None if cancelled."""
    config = session.config if config is None else config
    fits = session.temporal.fits_by(config, progress, cancelled)
    if fits is None:
        return None
    run = Run(config, Track(meta={}, **stack_fits(list(fits))), ())
    return described_track(run, session.model, session.material)


def performance_commands(
    session: TuningSession, settings: str | Path, file: str | Path, options: Sequence[str] = ()
) -> str:
    """The two command lines that track a session's material by saved settings, and export the track to a file."""
    run = Path("out") / session.material.name
    export = ["workbench", "export", run, "--to", file, *options, *model_words(session.model)]
    return f"{session.command(settings)} --out {shlex.quote(str(run))}\n{shlex.join(map(str, export))}"
