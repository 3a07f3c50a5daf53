"""`workbench infill`, `refine` and `reestimate`: what uses time, on stored tracks."""

from pathlib import Path
from typing import Annotated, Any, get_args

import typer

import workbench
from workbench.cli import screen
from workbench.cli.tracking import OVERWRITE_HELP, face_model, frame_range, named_views, print_result, track_file
from workbench.config import InfillConfig, RefinementConfig
from workbench.errors import ConfigError

INFILL_HELP = """Fill frames without a usable fit from their neighbours; the result is a new track.

[bold]Examples[/bold]

  workbench infill out/talk                          by optical flow, into out/talk-infill

  workbench infill out/talk --frames 120-131         frames that were found but fitted badly

  workbench infill out/talk --method spline          without looking at the pictures
"""
REFINE_HELP = """Stabilise a track; the result is a new one.

[bold]Examples[/bold]

  workbench refine out/talk                          averaging, then the pictures' flow, into out/talk-refine

  workbench refine out/talk --method plate --sweeps 3 --order gauss-seidel

  workbench refine out/talk --reestimate 1           and re-fit the expression with the steadied pose
"""
REESTIMATE_HELP = """Re-fit the expressions of a track with fixed poses; the result is a new track.

[bold]Example[/bold]

  workbench reestimate out/talk-refine
"""


def _choices(section: type, key: str) -> list[str]:
    return [choice for choice in get_args(section.model_fields[key].annotation) if choice != "none"]


NO_GAP = "every frame has a usable fit; --frames A-B names frames that look wrong."
NO_NEIGHBOUR = "the frames named have no usable fit next to them to fill from; name fewer."
TOO_LONG = "there is no gap, or none is short enough; try a larger --longest, or name frames with --frames A-B."
INFILL_METHODS, REFINEMENT_METHODS = _choices(InfillConfig, "method"), _choices(RefinementConfig, "method")

Run = Annotated[Path, typer.Argument(metavar="TRACK", help="Folder of a run, or its track.npz.")]
Out = Annotated[Path | None, typer.Option(help="Folder for the results (default: TRACK's, with the command's name).")]
Model = Annotated[Path | None, typer.Option(help="The face model of the track, if not the default head.")]
Clip = Annotated[Path | None, typer.Option("--clip", help="The pictures, if they have been moved.")]
View = Annotated[list[str] | None, typer.Option(help="Clip of another view, if moved, as NAME=CLIP.")]
Rig = Annotated[Path | None, typer.Option(help="The rig of the track, if moved.")]
Estimator = Annotated[str | None, typer.Option(help="dis, farneback, network, or a file of weights.")]
Renders = Annotated[str | None, typer.Option(help="Flow of the renders: exact, estimated, or network.")]
Pictures = Annotated[bool, typer.Option(help="Write the overlay video.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help=OVERWRITE_HELP)]


def infill(
    run: Run,
    out: Out = None,
    frames: Annotated[
        list[str] | None,
        typer.Option(help="Fill these too: a frame of the track, or first and last as A-B; may be repeated."),
    ] = None,
    method: Annotated[str, typer.Option(help=f"One of: {', '.join(INFILL_METHODS)}.")] = "flow",
    estimator: Estimator = None,
    renders: Renders = None,
    longest: Annotated[
        int | None, typer.Option(min=1, help="Leave gaps longer than this many frames unfilled.")
    ] = None,
    model: Model = None,
    clip: Clip = None,
    view: View = None,
    rig: Rig = None,
    pictures: Pictures = True,
    overwrite: Overwrite = False,
) -> None:
    """Fill frames without a usable fit from their neighbours; the result is a new track."""
    _check(method, INFILL_METHODS)
    wanted = [frame_range(text) for text in frames or []]
    _check_range(wanted, run)
    section: dict[str, Any] = {"method": method, "frames": wanted}
    if longest is not None:
        section["longest"] = longest
    changes = {"infill": section, "flow": _flow(estimator, renders)}
    options = {"clip": clip, "rig": rig, "pictures": pictures, "overwrite": overwrite}
    result = _work(run, out, "infill", changes, ["infill"], model, view, **options)
    if not result.summary["frames_filled"]:
        screen.print_error("Nothing was filled: " + (TOO_LONG if longest else NO_NEIGHBOUR if wanted else NO_GAP))
        raise typer.Exit(1)


def refine(
    run: Run,
    out: Out = None,
    method: Annotated[str, typer.Option(help=f"One of: {', '.join(REFINEMENT_METHODS)}.")] = "hybrid",
    sweeps: Annotated[int | None, typer.Option(min=1, max=20, help="How often every frame is solved.")] = None,
    order: Annotated[str | None, typer.Option(help="jacobi or gauss-seidel.")] = None,
    prior: Annotated[
        float | None, typer.Option(min=0.0, help="Weight of keeping each pose near its value before the pass.")
    ] = None,
    reestimate: Annotated[int, typer.Option(min=0, max=10, help="Number of expression re-fits.")] = 0,
    estimator: Estimator = None,
    renders: Renders = None,
    model: Model = None,
    clip: Clip = None,
    view: View = None,
    rig: Rig = None,
    pictures: Pictures = True,
    overwrite: Overwrite = False,
) -> None:
    """Stabilise a track; the result is a new one."""
    _check(method, REFINEMENT_METHODS)
    given = {"sweeps": sweeps, "order": order, "prior": prior}
    section = {"method": method, "reestimate": reestimate} | {k: v for k, v in given.items() if v is not None}
    steps = ["refine", *(["reestimate"] if reestimate else [])]
    changes = {"refinement": section, "flow": _flow(estimator, renders)}
    options = {"clip": clip, "rig": rig, "pictures": pictures, "overwrite": overwrite}
    _work(run, out, "refine", changes, steps, model, view, **options)


def reestimate(
    run: Run,
    out: Out = None,
    model: Model = None,
    clip: Clip = None,
    view: View = None,
    rig: Rig = None,
    pictures: Pictures = True,
    overwrite: Overwrite = False,
) -> None:
    """Re-fit the expressions of a track with fixed poses; the result is a new track."""
    changes = {"refinement": {"reestimate": 1}}
    options = {"clip": clip, "rig": rig, "pictures": pictures, "overwrite": overwrite}
    _work(run, out, "reestimate", changes, ["reestimate"], model, view, **options)


def _check(method: str, known: list[str]) -> None:
    if method not in known:
        raise ConfigError(f"The method is one of {', '.join(known)}, got {method!r}.")


def _check_range(wanted: list[tuple[int, int]], run: Path) -> None:
    count = len(workbench.tracking.TrackReader(track_file(run)))
    for first, last in wanted:
        if first >= count:
            asked = f"{first}" if first == last else f"{first}-{last}"
            raise ConfigError(f"The track has frames 0 to {count - 1}, got --frames {asked}; name frames of the track.")


def _flow(estimator: str | None, renders: str | None) -> dict[str, str]:
    given = {"estimator": estimator, "renders": renders}
    return {name: value for name, value in given.items() if value is not None}


def _work(run: Path, out: Path | None, name: str, changes, steps, model_path, view, rig: Path | None, **options):
    """The result of these steps on a run's track, told."""
    stored = track_file(run)
    if rig is not None:
        changes = {**changes, "camera": {"rig": str(rig)}}
    config = workbench.pipeline.config_of(workbench.tracking.TrackReader(stored).meta).changed(**changes)
    model = face_model(model_path)
    home = stored.parent if stored.parent.name not in ("", "..") else stored.resolve().parent
    folder = out or home.with_name(f"{home.name}-{name}")
    workbench.pipeline.check_inputs_kept(folder, [] if model_path is None else [model_path])
    clips = named_views(view or [])
    with screen.progress_bar() as progress:
        try:
            result = workbench.pipeline.retrack(
                stored, folder, model, config, steps, views=clips, progress=progress, **options
            )
        except KeyboardInterrupt:
            # Its tables may be there, when it was cut while its film was drawn.
            begun = any((folder / written).exists() for written in workbench.pipeline.OUTPUTS)
            again = "repeat the command with --overwrite" if begun else "repeat the command"
            screen.errors.print(f"[yellow]interrupted[/yellow]: the new track was not written; {again}")
            raise typer.Exit(130) from None
    print_result(result)
    return result
