"""`workbench sweep`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import workbench
from workbench.cli import screen
from workbench.cli.tracking import base_config, named_view
from workbench.errors import ConfigError

SWEEP_HELP = """Try many settings on many clips at once, and see which are best.

[bold]Examples[/bold]

  workbench sweep talk.mp4 --set "weights.tau=log(1e-3,10,13)"

  workbench sweep talk.mp4 --set "weights.tau=log(1e-3,10,9)" --set "weights.range=log(0.01,100,9)" --frames 200

  workbench sweep a.mp4 b.mp4 --set "preset=joint,calibrated,face-it" --workers 2

  workbench sweep a.csv --set "weights.tau=log(1e-3,10)" --set "camera.fov_deg=lin(25,65)" --sample sobol:64

  workbench sweep a.csv --set "stages.pose and expression.limit=1..30" --objective error --objective jitter

  workbench sweep left.mp4 --rig rig.toml --view right=right.mp4 --objective second-view --set "weights.tau=0.1,1"

  workbench sweep s3://films/a.mp4 --set "weights.tau=log(1e-3,10,13)" --out s3://films/sweep --scheduler tcp://host:8786

  workbench sweep talk.mp4 --set "weights.tau=log(1e-3,10,13)" --resume
"""
INPUT, SPACE, RUNNING, RESULTS = "Input", "Space", "Running", "Results"
SET_HELP = "A setting and its values: log(A,B,N), lin(A,B,N), 1..30, or a list. May be given more than once."
SAMPLE_HELP = "How points are chosen: grid, random:N or sobol:N."
OBJECTIVE_HELP = "What is measured; may be given more than once (`--objective list` names all)."
FRAMES_HELP = "Budget of frames in each clip, in short runs spread over it (default: all)."
TRUTH_HELP = "Ground truth for a clip (.npz, a track, a landmark file); one for each clip, in order."
LANDMARKS_HELP = "Landmark file instead of a detector; one for each clip, in order."
RIG_HELP = "Calibration of several cameras, for the objective second-view; the clip is its first view."
VIEW_HELP = "Clip of another view of the rig as NAME=CLIP, used only to judge the fits; one for each clip, in order."
WORKERS_HELP = "Processes on this machine: a Dask cluster if Dask is installed, else a pool."
SCHEDULER_HELP = "Address of a Dask scheduler, for example tcp://host:8786; paths must be the same on its workers."
BACKEND_HELP = "What runs the processes: auto, pool or dask."
OUT_HELP = "Folder or URL for the results (default: out/sweep-NAME)."
RESUME_HELP = "Continue an interrupted sweep, or add points to one: name all values, old and new."
BEST_HELP = (
    "Objective or weighted sum that best.toml minimises, for example 'jitter + 0.5*error' (default: first objective)."
)


def sweep(
    clips: Annotated[list[str] | None, typer.Argument(help="Videos, photos or landmark files, by path or URL.")] = None,
    landmarks: Annotated[list[str] | None, typer.Option(help=LANDMARKS_HELP, rich_help_panel=INPUT)] = None,
    truth: Annotated[list[str] | None, typer.Option(help=TRUTH_HELP, rich_help_panel=INPUT)] = None,
    rig: Annotated[str, typer.Option(help=RIG_HELP, rich_help_panel=INPUT)] = "",
    view: Annotated[list[str] | None, typer.Option(help=VIEW_HELP, rich_help_panel=INPUT)] = None,
    frames: Annotated[int | None, typer.Option(min=1, help=FRAMES_HELP, rich_help_panel=INPUT)] = None,
    stills: Annotated[bool, typer.Option("--stills", help="Unrelated photos.", rich_help_panel=INPUT)] = False,
    settings: Annotated[list[str] | None, typer.Option("--set", help=SET_HELP, rich_help_panel=SPACE)] = None,
    sample: Annotated[str | None, typer.Option(help=SAMPLE_HELP, rich_help_panel=SPACE)] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the samples.", rich_help_panel=SPACE)] = 0,
    preset_name: Annotated[str | None, typer.Option("--preset", help="Preset that all points start from.",
                                                    rich_help_panel=SPACE)] = None,
    config: Annotated[Path | None, typer.Option(help="Configuration that all points start from.",
                                                rich_help_panel=SPACE)] = None,
    model: Annotated[str, typer.Option(help="Face model by path or URL.", rich_help_panel=SPACE)] = "",
    objective: Annotated[list[str] | None, typer.Option(help=OBJECTIVE_HELP, rich_help_panel=RESULTS)] = None,
    best: Annotated[str | None, typer.Option(help=BEST_HELP, rich_help_panel=RESULTS)] = None,
    out: Annotated[str | None, typer.Option(help=OUT_HELP, rich_help_panel=RESULTS)] = None,
    resume: Annotated[bool, typer.Option("--resume", help=RESUME_HELP, rich_help_panel=RESULTS)] = False,
    workers: Annotated[int, typer.Option(min=1, max=1024, help=WORKERS_HELP, rich_help_panel=RUNNING)] = 1,
    scheduler: Annotated[str | None, typer.Option(help=SCHEDULER_HELP, rich_help_panel=RUNNING)] = None,
    backend: Annotated[str, typer.Option(help=BACKEND_HELP, rich_help_panel=RUNNING)] = "auto",
) -> None:  # fmt: skip
    """Sweep settings over clips."""
    if "list" in (objective or ()):
        _list_objectives()
        return
    if backend not in ("auto", "pool", "dask"):
        raise ConfigError(f"--backend is auto, pool or dask, got {backend!r}.")
    sweeps = workbench.sweeps
    base = base_config(config, preset_name)
    least = workbench.objectives.read_sum(best) if best else None
    views = [named_view(text) for text in view or []]
    wanted = sweeps.Sweep(
        sources=sweeps.sources_of(clips or [], landmarks or [], truth or [], stills, views=views, rig=rig),
        axes=tuple(sweeps.read_axis(text) for text in settings or []),
        base=sweeps.in_first_view(base, rig) if rig else base,
        sampling=sweeps.read_sampling(sample, seed),
        objectives=_measured(objective or sweeps.USUAL_OBJECTIVES, least),
        frames=frames,
        model=model,
    )
    wanted.checked()
    place = out or str(Path("out") / f"sweep-{wanted.names[0]}")
    with screen.at_work(workers, scheduler, backend) as staff:
        try:
            with screen.progress_bar("frames/s") as progress:
                result = sweeps.run_sweep(wanted, place, staff, resume, progress)
            written = sweeps.write_outcome(result, place, least)
        except KeyboardInterrupt:
            message = "[yellow]interrupted[/yellow]: finished results are kept; --resume continues from there"
            screen.errors.print(message)
            raise typer.Exit(130) from None
    _print(result, least)
    screen.console.print(f"\n{', '.join(written)} in {place}", markup=False, soft_wrap=True)
    for clip, reason in result.failures.items():
        screen.print_error(f"{clip}: {reason}")
    if result.failures:
        raise typer.Exit(1)


def _measured(objectives: Sequence[str], least) -> tuple[str, ...]:
    """Each objective once, and those of the sum that the best point is chosen by."""
    return tuple(dict.fromkeys([*objectives, *(() if least is None else least.names)]))


def _list_objectives() -> None:
    table = screen.table("objective", "what it measures", "what it cannot see", whole=("objective",))
    for name, row in workbench.objectives.TABLE.items():
        table.add_row(name, f"{row.says}{', ' if row.unit else ''}{row.unit}", row.blind)
    screen.console.print(table)


def _print(result, wanted) -> None:
    """The best point of each objective, and of the sum if one was asked for; each setting in a line of its own."""
    settings = "settings (in 95 % of draws)" if any(axis.numeric for axis in result.axes) else "settings"
    table = screen.table("lowest", "value", "point", settings, right=("value", "point"))

    def add(label: str, value: str, number: int, rule) -> None:
        table.add_row(label, value, str(number), escape(_settings(result, number, rule)))

    rules = workbench.sweeps
    for name in result.objectives:
        if (number := result.best(name)) is not None:
            digits = workbench.objectives.TABLE[name].digits
            add(name, f"{result.means(name)[number]:.{digits}f}", number, rules.least(name))
    if wanted is not None and (number := result.best(wanted)) is not None:
        add(str(wanted), "", number, rules.least(wanted))
    if (number := result.steadiest()) is not None:
        add("jitter at equal error", f"{result.means('jitter')[number]:.3f}", number, rules.steadiest())
    screen.console.print(table)


def _settings(result, number: int, rule) -> str:
    """The settings of a point, with how sure its choice by a rule is."""
    lines = []
    for axis, (path, value) in zip(result.axes, result.points[number].values, strict=True):
        interval = result.interval(axis, rule)
        sure = "" if interval is None else " ({:.3g} to {:.3g})".format(*interval)
        lines.append(f"{path} = {workbench.sweeps.shown(value)}{sure}")
    return "\n".join(lines) or "as configured"
