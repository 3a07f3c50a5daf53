"""`workbench diagnose`: which frames of a track stand out, and why one frame fails."""

import shlex
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.padding import Padding

import workbench
from workbench.cli import diagnosis_files, screen
from workbench.cli.exporting import model_of_track
from workbench.cli.tracking import track_file
from workbench.config import config_of_track
from workbench.errors import InputError
from workbench.files import check_not_inputs

MOST_FRAMES = 20
MOST_WEIGHTS = 8
MOST_CHANGES = 3
MOST_PAIRS = 8

DIAGNOSE_HELP = """Find out where and why a track fails: the frames that stand out, or the reasons for one frame.

Each reason comes with the change that was tried against it, and the error before and after. \
Pictures are used if they are still where they were tracked.

[bold]Examples[/bold]

  workbench diagnose out/talk                    the frames that stand out

  workbench diagnose out/talk --frame 52         why frame 52 fails

  workbench diagnose out/talk --csv flags.csv    all that stand out, as a table

  workbench diagnose out/talk --frame 52 --json why.json
"""


def diagnose(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or its track.npz.")],
    frame: Annotated[int | None, typer.Option(help="Explain this frame.")] = None,
    every: Annotated[bool, typer.Option("--all", help=f"List all frames that stand out, not {MOST_FRAMES}.")] = False,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write everything to this file.")] = None,
    csv_file: Annotated[Path | None, typer.Option("--csv", help="Write the frames or reasons as a table.")] = None,
    model: Annotated[Path | None, typer.Option(help="The face model of the track, if not the default head.")] = None,
) -> None:
    """Frames of a track that stand out, or the reasons for one."""
    from workbench.pipeline.output_folder import check_results_kept

    if frame is not None and every:
        raise InputError("Give --frame or --all, not both: --all lists the frames that stand out.")
    track = workbench.Track.load(track_file(run))
    files = [path for path in (json_file, csv_file) if path is not None]
    check_not_inputs(files, [track_file(run), *workbench.export.input_files(track.meta)])
    check_results_kept(track_file(run), files)
    if frame is None:
        record = _flags(track)
        _print_flags(record, run, every, config_of_track(track.meta).traits.diagnosed)
        rows = record["flagged"]
    else:
        record = _diagnosis(track, frame, model)
        _print_diagnosis(record)
        rows = diagnosis_files.reason_rows(record)
    if json_file is not None:
        diagnosis_files.write_json(record, json_file)
    if csv_file is not None:
        columns = diagnosis_files.FLAG_COLUMNS if frame is None else diagnosis_files.REASON_COLUMNS
        diagnosis_files.write_csv(rows, columns, csv_file)
    for path in filter(None, (json_file, csv_file)):
        screen.console.print(f"wrote {escape(str(path))}", soft_wrap=True)


def _flags(track: "workbench.Track") -> dict:
    flags = workbench.diagnosis.flag_frames(track, config_of_track(track.meta))
    return diagnosis_files.flags_record(track, flags)


def _diagnosis(track: "workbench.Track", frame: int, path: Path | None) -> dict:
    _check_diagnosed(track)  # before a fit of the whole clip
    model, notes = model_of_track(track, path)
    for note in notes:
        screen.console.print(f"[yellow]note:[/yellow] {escape(note)}")
    session = workbench.open_session(track, model=model)
    session.observation(frame)  # refused before the whole clip is fitted
    with screen.progress_bar() as progress:
        session.fit_clip(progress)
        progress("diagnose", 0, None)
        diagnosis = session.diagnose(frame)
    names, pictures = session.model.expression_names, session.material.pictures.real
    return diagnosis_files.diagnosis_record(diagnosis, names, len(session), pictures)


def _check_diagnosed(track: "workbench.Track") -> None:
    """Raise `InputError` for a run whose frames are not diagnosed."""
    if track.meta.get("views"):
        raise InputError(
            "Runs of several cameras are not diagnosed frame by frame; track the first view's clip alone with a "
            "FACE IT! preset, for example --preset joint, and diagnose that run."
        )
    from workbench.session.diagnosing import check_diagnosed  # here: it imports JAX, and --help does without

    check_diagnosed(config_of_track(track.meta))


def _print_flags(record: dict, run: Path, every: bool, diagnosed: bool) -> None:
    """The frames that stand out, and where such runs are `diagnosed`, the command that tells why."""
    flagged, frames = record["flagged"], f"{record['frames']} frame{'' if record['frames'] == 1 else 's'}"
    if not flagged:
        told = f"no frame stands out ({frames}, {record['frames_with_face']} with a face)"
        screen.console.print(told if record["frames_with_face"] else f"no frame has a face ({frames})")
        return
    shown = flagged if every else flagged[:MOST_FRAMES]
    table = screen.table("frame", "severity", "why", right=("frame", "severity"))
    for item in shown:
        table.add_row(str(item["frame"]), f"{item['severity']:.2f}", escape(item["why"]))
    screen.console.print(table)
    rest = "" if len(shown) == len(flagged) else f"; these are the worst {len(shown)}, --all lists the others"
    stand = "stands" if len(flagged) == 1 else "stand"
    screen.console.print(f"{len(flagged)} of {frames} {stand} out{rest}")
    if not diagnosed:
        return
    command = escape(shlex.join(["workbench", "diagnose", str(run), "--frame", str(flagged[0]["frame"])]))
    screen.console.print(f"[dim]{command}  tells why[/dim]", soft_wrap=True)


def _print_diagnosis(record: dict) -> None:
    inner, every = record["error"]["inner_51_percent"], record["error"]["all_68_percent"]
    errors = f"error inner 51: {inner:.2f} %, all 68: {every:.2f} % of the eye distance"
    screen.console.print(f"[bold]frame {record['frame']}[/bold] of {record['frames']}, {errors}")
    if not record["pictures"]:
        told = "from the landmarks alone; the run had no pictures, or they were moved or changed"
        screen.console.print(f"[yellow]note:[/yellow] {told}")
    if record["flagged"]:
        screen.console.print(f"flagged: {escape(record['flagged'])}")
    if not record["reasons"]:
        screen.console.print(f"\n{escape(record['summary'])}")
    for number, reason in enumerate(record["reasons"], 1):
        screen.console.print(f"\n[bold]{number}. {escape(reason['title'])}[/bold]  (score {reason['score']:.2f})")
        change = reason["change"]
        proposal = "no change was found" if change is None else f"→ {change['label']}"
        numbers = f"{reason['measure']} {reason['before_percent']:.2f} → {reason['after_percent']:.2f} %"
        for line in (escape(reason["evidence"]), f"[green]{escape(proposal)}[/green]: {escape(numbers)}"):
            screen.console.print(Padding(line, (0, 0, 0, 3)))
    _print_pulls(record["leave_group_out"])
    _print_uncertainty(record["uncertainty"])


def _print_pulls(pulls: list[dict]) -> None:
    columns = ("left out", "turns", "moves", "lies off", "others' error")
    table = screen.table(*columns, "weights change", right=columns[1:], whole=columns[:1])
    for pull in pulls:
        changes = list(pull["weights"].items())[:MOST_CHANGES]
        table.add_row(
            pull["group"],
            f"{pull['rotation_deg']:.1f}°",
            f"{_short(pull['translation_mm'])} mm",
            f"{_short(pull['distance_percent'])} %",
            f"{pull['error_with_percent']:.2f} → {pull['error_without_percent']:.2f} %",
            ", ".join(f"{name} {change:+.2f}" for name, change in changes),
        )
    screen.console.print("\n[bold]The fit without one group of landmarks[/bold]")
    screen.console.print(table)


def _short(number: float) -> str:
    """A few digits also where a fit without a group ran away."""
    return f"{number:.1f}" if abs(number) < 1000.0 else f"{number:.0e}"


def _print_uncertainty(found: dict) -> None:
    weights = sorted(found["weights"].items(), key=lambda item: -item[1]["deviation"])[:MOST_WEIGHTS]
    lines = [
        "pitch ± {:.1f}°, yaw ± {:.1f}°, roll ± {:.1f}°".format(*found["rotation_deg"]),
        "right ± {:.1f} mm, down ± {:.1f} mm, depth ± {:.1f} mm".format(*found["translation_mm"]),
        ", ".join(f"{name} {weight['value']:.2f} ± {weight['deviation']:.2f}" for name, weight in weights),
        *(f"{first} and {second} trade off ({value:+.2f})" for first, second, value in found["pairs"][:MOST_PAIRS]),
    ]
    noise = f"from a landmark noise of {found['noise_percent']:.2f} % of the eye distance"
    screen.console.print(f"\n[bold]What is least certain[/bold] ({noise})")
    for line in lines:
        screen.console.print(line)
