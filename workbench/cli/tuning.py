"""`workbench tune`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

import workbench
from workbench.cli import screen
from workbench.cli.tracking import base_config, face_model, named_view
from workbench.config import differences, write_config
from workbench.files import check_new, check_not_inputs

TUNE_HELP = """Let a clip choose settings: by gradients through the solver (--learn), by search (--search), or \
by both: search first, then gradients from its best result.

One part of the clip is learned from, a second chooses the step to stop at, and a third, used for nothing else, \
gives the reported error.

[bold]Examples[/bold]

  workbench tune talk.mp4 --objective left-out-points --learn weights.sigma_smooth

  workbench tune talk.mp4 --objective jitter+error --learn weights.tau --train 0:300 --held-out 300:400

  workbench tune left.mp4 --rig rig.toml --view right=right.mp4 --objective second-view --learn weights.sigma_smooth

  workbench tune talk.csv --objective left-out-points --search "stages.pose and expression.limit=1..30" --trials 30

  workbench tune talk.mp4 --objective left-out-points --learn weights.tau --resume

Ctrl-C keeps the best so far. The result is a configuration: workbench track --config talk-learned.toml
"""
RIG_HELP = "Calibration of several cameras, for the objective second-view; the clip is its first view."
VIEW_HELP = "Clip of another view of the rig as NAME=CLIP, used only to judge the fits."
INPUT, TUNING, RESULTS = "Input", "Tuning", "Results"


def tune(
    clip: Annotated[str, typer.Argument(help="A video or a landmark file.")],
    objective: Annotated[str, typer.Option(help="What to minimise (`workbench sweep --objective list`), or a sum.")],
    learn: Annotated[
        list[str] | None, typer.Option(help="Setting with a gradient; may be repeated.", rich_help_panel=TUNING)
    ] = None,
    search: Annotated[
        list[str] | None, typer.Option(help="Setting and values to search.", rich_help_panel=TUNING)
    ] = None,
    landmarks: Annotated[str, typer.Option(help="Landmark file instead of a detector.", rich_help_panel=INPUT)] = "",
    truth: Annotated[str, typer.Option(help="Ground truth for the clip.", rich_help_panel=INPUT)] = "",
    rig: Annotated[str, typer.Option(help=RIG_HELP, rich_help_panel=INPUT)] = "",
    view: Annotated[str | None, typer.Option(help=VIEW_HELP, rich_help_panel=INPUT)] = None,
    train: Annotated[
        str | None, typer.Option(help="Frames to learn on, FIRST:END; needs --held-out.", rich_help_panel=INPUT)
    ] = None,
    watch: Annotated[str | None, typer.Option(help="Frames used to choose the step.", rich_help_panel=INPUT)] = None,
    held_out: Annotated[
        str | None, typer.Option(help="Frames used only for the reported error.", rich_help_panel=INPUT)
    ] = None,
    preset_name: Annotated[str | None, typer.Option("--preset", help="Preset to start from.")] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration to start from.")] = None,
    model: Annotated[Path | None, typer.Option(help="Face model (default: the default head).")] = None,
    steps: Annotated[int, typer.Option(min=1, max=1000, help="Steps of the gradient.", rich_help_panel=TUNING)] = 24,
    trials: Annotated[int, typer.Option(min=1, max=10_000, help="Trials of a search.", rich_help_panel=TUNING)] = 40,
    out: Annotated[Path | None, typer.Option(help="The result (default: NAME-learned.toml).")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue an interrupted tuning.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an earlier result, and start again.")] = False,
) -> None:
    """Tune settings on a clip."""
    learning, sweeps = workbench.learning, workbench.sweeps
    base = base_config(config, preset_name)
    base = sweeps.in_first_view(base, rig) if rig else base
    views = [named_view(view)] if view else []
    sums = workbench.objectives.read_sum(objective)
    path = out or Path(f"{Path(clip).stem}-learned.toml")
    inputs = (clip, landmarks, truth, config, rig, *(place for _, place in views))
    check_not_inputs([path], [Path(name) for name in inputs if name])
    if not (overwrite or resume):
        check_new(path)
        for stored in learning.kept_beside(path):
            check_new(stored, "continue that tuning (--resume), or start again (--overwrite)")
    head = face_model(model)
    parts = [None if text is None else learning.read_frames(text) for text in (train, watch, held_out)]
    (source,) = sweeps.sources_of(
        [clip],
        [landmarks] if landmarks else [],
        [truth] if truth else [],
        flow="flow" in sums.names,
        views=views,
        rig=rig,
    )
    sweeps.check_sources([source], sums.names)
    with _telling_interruptions(path):
        seen = learning.observed(source, base, head)
    wanted = learning.Wanted(
        objectives=sums,
        parts=learning.parts_of_clip(len(seen.observations), *parts),
        learn=tuple(learn or ()),
        search=tuple(sweeps.read_axis(text) for text in search or ()),
        steps=steps,
        trials=trials,
    )
    with _telling_interruptions(path), screen.progress_bar("steps/s") as progress:

        def tell(what: str, done: int, total: int, value: float, watched: float | None) -> None:
            progress(what, done, total, f"{value if watched is None else watched:.4g}")

        found = learning.tuned(head, base, seen, wanted, tell, path, resume, learning.inputs_of(source))
    write_config(found.config, path)
    _print(found, path, bool(learn), steps)


@contextmanager
def _telling_interruptions(path: Path) -> Iterator[None]:
    """Say what is left of a tuning that is interrupted before there is a best to write, and end the command."""
    try:
        yield
    except KeyboardInterrupt:
        begun = any(stored.exists() for stored in workbench.learning.kept_beside(path))
        kept = "what was tuned so far is kept; --resume continues it"
        screen.errors.print(f"[yellow]interrupted[/yellow]: {kept if begun else 'nothing was tuned yet'}")
        raise typer.Exit(130) from None


def _print(found, path: Path, learns: bool, steps: int) -> None:
    table = screen.table("frames", "before", "after", right=("before", "after"))
    for name, before in found.config.provenance.before.items():
        table.add_row(name.replace("_", "-"), f"{before:.4g}", f"{found.config.provenance.after[name]:.4g}")
    screen.console.print(table)
    screen.console.print(f"held-out change, with its 95 % interval: {found.change}")
    if found.search is not None and found.search.interrupted:
        unlearned = ", so nothing was learned yet" if learns else ""
        screen.console.print(f"The search was interrupted{unlearned}; --resume continues it.")
    elif found.search is not None and found.search.config == found.base:
        screen.console.print("No trial was better than the start.")
    if found.learning is not None and len(found.learning.values) < steps:
        done = len(found.learning.values)
        screen.console.print(f"The learning was interrupted after {done} of {steps} steps; --resume continues it.")
    elif found.learning is not None and found.learning.best and found.learning.best_step == 0:
        screen.console.print("No step was better than the start on the frames that choose it: nothing was learned.")
    shown = [str(item) for item in differences(found.base, found.config)]
    for line in shown[:8]:
        screen.console.print(f"  {line}", markup=False, soft_wrap=True)
    more = f" ({len(shown) - 8} more changes)" if len(shown) > 8 else ""
    screen.console.print(f"{path} written{more}", markup=False, soft_wrap=True)
