"""`workbench landmarks`: faces and their points in photos or in the frames of a video, each on its own."""

import shlex
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.markup import escape
from rich.table import Table

import workbench
from workbench.cli import screen
from workbench.cli.tracking import (
    DETECTOR_HELP,
    FACE_HELP,
    LANDMARKER_HELP,
    NO_FACE,
    print_licence_notice,
    wanted_face,
    with_landmarker,
)
from workbench.config import DEFAULT_PRESET, preset
from workbench.errors import InputError
from workbench.files import NewFiles, check_new, check_not_inputs
from workbench.landmarks.scheme import outer_eye_distance

LANDMARKS_HELP = """Find faces and their landmarks, with a confidence for every point; no face model is fitted.

Every picture is treated independently, even in a video. The CSV file is one that [bold]workbench track[/bold] reads. \
Drawn pictures of an earlier call are replaced only with --overwrite.

[bold]Examples[/bold]

  workbench landmarks portrait.jpg              landmarks.csv, and a picture

  workbench landmarks photos/ --out found.csv   a folder; pictures in found/

  workbench landmarks talk.mp4 --no-pictures    a video, without landmarks.mp4

  workbench landmarks us.jpg --face 320,180     this face instead of the largest

  workbench track photos/ --stills --landmarks found.csv
"""

OUT = Path("landmarks.csv")
"""The table's name if a call gives none."""
DRAWN = "[0-9][0-9][0-9][0-9]*-*.jpg"
"""What the names of drawn pictures have in common: they begin with the frame's number."""
OVERWRITE_HELP = f"Replace what --out does not name: {OUT} and drawn pictures."
UNSURE = 0.5
"""Confidence below which a point is counted as unsure."""
LISTED = 20
"""Up to this many pictures, and as many without a face, are named one by one."""
NAMED_IN_HINT = 3
"""The next command is shown for at most this many inputs."""
RATE_WITHOUT_CLOCK = 25.0
"""Frames per second of the drawn video if the input's header has none."""

Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Found:
    """What one picture gave."""

    index: int
    name: str
    landmarks: "workbench.Landmarks2D | None"
    milliseconds: float

    @property
    def confidence(self) -> float:
        """The median over the points of a face."""
        return float(np.median(self.landmarks.confidence))


def landmarks(
    inputs: Annotated[list[Path], typer.Argument(help="Photos, a folder or a video.")],
    out: Annotated[Path | None, typer.Option(help=f"CSV file for the landmarks (default: {OUT}).")] = None,
    detector: Annotated[str, typer.Option(help=DETECTOR_HELP)] = "auto",
    face_landmarker: Annotated[Path | None, typer.Option(help=LANDMARKER_HELP)] = None,
    face: Annotated[str | None, typer.Option(help=FACE_HELP)] = None,
    pictures: Annotated[bool, typer.Option(help="Draw the points, coloured by confidence.")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite", help=OVERWRITE_HELP)] = False,
) -> None:
    """Find faces and landmarks in pictures."""
    named, out = out is not None, out or OUT
    if out.suffix.lower() != ".csv":
        raise InputError(f"Landmarks are written as .csv, got {out}; name another file.")
    for path in inputs:
        if workbench.pipeline.is_landmark_file(path):
            raise InputError(f"{path} holds landmarks, not a picture to find them in; `workbench track` reads it.")
    settings = preset(DEFAULT_PRESET).changed(landmarks={"detector": detector, "face": wanted_face(face)})
    if face_landmarker is not None:
        settings = with_landmarker(settings, face_landmarker)
    source = workbench.pipeline.open_source(inputs, settings, None)
    drawn = _drawings(source.frames, out) if pictures else None
    # Of a folder the pictures: it may hold the landmarks of an earlier call.
    read = source.frames.paths if isinstance(source.frames, workbench.frames.ImageFrames) else inputs
    check_not_inputs([out] if drawn is None else [out, drawn, *_files_in(drawn)], read)
    if not overwrite:
        _check_new(out, drawn, named)
    with screen.progress_bar() as progress:
        try:
            found = _find(source, out, drawn, progress)
        except KeyboardInterrupt:
            screen.errors.print(f"[yellow]interrupted[/yellow]: {escape(str(out))} was not written")
            raise typer.Exit(130) from None
    _tell(found, source, inputs, out, drawn)
    if all(item.landmarks is None for item in found):
        screen.print_error(settings.landmarks.missed_face or NO_FACE)
        raise typer.Exit(1)


def _drawings(frames: "workbench.frames.Frames", out: Path) -> Path:
    """Where the drawn pictures go: a video for a video, else a folder."""
    return out.with_suffix(".mp4") if frames.kind == "video" else out.with_suffix("")


def _files_in(drawn: Path, names: str = "*") -> list[Path]:
    return sorted(drawn.glob(names)) if drawn.is_dir() else []


def _check_new(out: Path, drawn: Path | None, named: bool) -> None:
    """Raise `OutputError` where a file would be replaced that the command line does not name."""
    if not named:
        check_new(out)
    if drawn is not None:
        for path in _files_in(drawn, DRAWN) if drawn.is_dir() else [drawn]:
            check_new(path, "name another table (--out), leave the pictures out (--no-pictures), or add --overwrite")


def _find(source: "workbench.pipeline.PictureSource", out: Path, drawn: Path | None, progress: Progress) -> list[Found]:
    files, draw, found = workbench.landmarks.files, workbench.pictures.draw_landmarks, []
    with (
        _kept_together(drawn) as new,
        files.LandmarkCsvWriter(out, scheme=source.scheme) as table,
        ExitStack() as opened,
    ):
        film = None
        if drawn is not None and source.frames.kind == "video":
            new.expect(drawn)
            rate = source.frames.rate or RATE_WITHOUT_CLOCK
            film = opened.enter_context(workbench.frames.VideoWriter(drawn, rate=rate))
        for frame, observation in source.stills():
            points = observation.landmarks
            table.write(files.LandmarkRecord(frame.index, frame.name, points, observation.image_size))
            if film is not None:
                film.write(draw(frame.picture, points, frame.name))
            elif drawn is not None:
                path = drawn / _picture_name(frame)
                new.expect(path)
                workbench.frames.write_picture(path, draw(frame.picture, points, frame.name))
            found.append(Found(frame.index, frame.name, points, sum(observation.milliseconds)))
            progress("landmarks", len(found), source.count)
    return found


@contextmanager
def _kept_together(drawn: Path | None) -> Iterator[NewFiles]:
    """What is drawn beside the table: if that is not written, what is new of it is removed."""
    new = NewFiles(drawn)
    try:
        yield new
    except BaseException:
        new.discard()
        raise


def _picture_name(frame: "workbench.frames.Frame") -> str:
    return f"{frame.index:04d}-{Path(frame.name).stem}.jpg"


def _tell(
    found: list[Found], source: "workbench.pipeline.PictureSource", inputs: list[Path], out: Path, drawn: Path | None
) -> None:
    if source.frames.kind == "images" and len(found) <= LISTED:
        _print_each(found)
    faces = [item for item in found if item.landmarks is not None]
    table = Table(show_header=False, box=None)
    table.add_row("[bold]pictures[/bold]", f"{len(faces)} of {len(found)} with a face")
    without = [item.name for item in found if item.landmarks is None]
    if without:
        more = f" and {len(without) - LISTED} more" if len(without) > LISTED else ""
        table.add_row("[bold]no face[/bold]", escape(", ".join(without[:LISTED])) + more)
    if faces:
        least = min(faces, key=lambda item: item.confidence)
        middle = np.median([item.confidence for item in faces])
        lowest = f"; lowest {least.confidence:.2f} in {escape(least.name)}" if len(faces) > 1 else ""
        table.add_row("[bold]confidence[/bold]", f"median {middle:.2f}{lowest}")
    time = np.median([item.milliseconds for item in found])
    table.add_row("[bold]detector[/bold]", f"{source.detector}, median {time:.0f} ms per picture")
    layout = f"one row per picture: {len(source.scheme)} points, then confidences"
    table.add_row("[bold]files[/bold]", f"{escape(str(out))}  [dim]{layout}[/dim]")
    if drawn is not None:
        table.add_row("", f"{escape(str(drawn))}  [dim]the points, yellow where sure, violet where guessed[/dim]")
    screen.console.print(table)
    if faces and len(inputs) <= NAMED_IN_HINT:
        command = escape(_next_command(source.frames, inputs, out))
        screen.console.print(f" [bold]next[/bold]        {command}", soft_wrap=True)  # one line, to be copied
    for note in source.notes():
        screen.console.print(f"[yellow]note:[/yellow] {escape(note)}")
    print_licence_notice(source.detector)


def _print_each(found: list[Found]) -> None:
    numbers = ("frame", "confidence", "unsure points", "eye distance")
    table = screen.table("frame", "picture", *numbers[1:], right=numbers)
    for item in found:
        if item.landmarks is None:
            table.add_row(str(item.index), escape(item.name), "[yellow]no face[/yellow]", "", "")
            continue
        unsure = int((item.landmarks.confidence < UNSURE).sum())
        distance = f"{outer_eye_distance(item.landmarks.points):.0f} px"
        table.add_row(str(item.index), escape(item.name), f"{item.confidence:.2f}", str(unsure), distance)
    screen.console.print(table)
    screen.console.print()


def _next_command(frames: "workbench.frames.Frames", inputs: list[Path], out: Path) -> str:
    stills = ["--stills"] if frames.kind == "images" and frames.announced_count != 1 else []
    return shlex.join(["workbench", "track", *map(str, inputs), *stills, "--landmarks", str(out)])
