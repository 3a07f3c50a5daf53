"""`workbench export`: a track as animation, tables, meshes, a film or a report."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import workbench
from workbench.cli import screen
from workbench.cli.tracking import track_file
from workbench.errors import InputError
from workbench.export.suffixes import FORMATS, MESHES, check_free, check_shows_character, format_of, place_of
from workbench.face.characters import PLAIN, character_names, is_character
from workbench.files import check_not_inputs

EXPORT_HELP = (
    """Export a track for other programs; the file's suffix decides the format.

[bold]Examples[/bold]

  workbench export out/talk --to talk.glb          for Blender, Unity, three.js

  workbench export out/talk --to talk.arkit.csv    as Live Link Face writes it

  workbench export out/talk --to talk.csv --to report.html

  workbench export out/talk --to talk.glb --character mei

  workbench export out/talk --to hero.glb --character hero/

  workbench export out/talk --to hero.mp4 --character hero/ --map hero.toml

[bold]Formats[/bold]

"""
    + "\n\n".join(f"  {suffix:11} {told}" for suffix, told in FORMATS.items())
    + "\n"
)

CHARACTER_HELP = (
    "A ready character such as mei (.glb, .usd, .mp4, .html), or another face model that plays the performance."
)
MOST_NAMES = 6
"""Blendshapes that are named where some have no counterpart."""


def export(
    run: Annotated[Path, typer.Argument(metavar="TRACK", help="Folder of a run, or its track.npz.")],
    to: Annotated[list[Path], typer.Option("--to", help="File to write; may be given several times.")],
    shot: Annotated[int | None, typer.Option(help="Only the frames of this shot, counted from 0.")] = None,
    fps: Annotated[float | None, typer.Option(help="Frames per second instead of the input's.")] = None,
    character: Annotated[str | None, typer.Option(help=CHARACTER_HELP)] = None,
    mapping: Annotated[Path | None, typer.Option("--map", help="How its blendshapes follow from ours (TOML).")] = None,
    surface: Annotated[
        bool, typer.Option("--surface", help="Match the character's surface, not the names; needs the same mesh.")
    ] = False,
    model: Annotated[Path | None, typer.Option(help="The face model of the track, if not the default head.")] = None,
    pictures: Annotated[Path | None, typer.Option(help="The pictures, if they have been moved.")] = None,
) -> None:
    """Write a track as what other programs read."""
    from workbench.pipeline.output_folder import check_results_kept

    stored = track_file(run)
    character = None if character == PLAIN else character
    dress = character if character is not None and is_character(character) else None
    _check_targets(to, dress)
    player = None if dress or character is None else Path(character)
    if player is not None and not player.exists():
        ready = ", ".join(character_names())
        raise InputError(f"{character} is neither a ready character ({ready}) nor the path of a face model.")
    if player is None and (mapping is not None or surface):
        if dress:
            raise InputError(
                f"--map and --surface are for another face model; {dress} is a character of the default head."
            )
        raise InputError("--map and --surface say how a character is moved; name it with --character.")
    given = [path for path in (model, player, mapping) if path is not None]
    track = workbench.Track.load(stored)
    check_not_inputs(to, [stored, *given, *workbench.export.input_files(track.meta)])
    check_results_kept(stored, to)
    head, notes = model_of_track(track, model)
    dressed = None if dress is None else workbench.face.dressed_as(dress, head)
    if player is not None:
        other = workbench.load_face_model(player)
        track, more = _played(track, head, other, mapping, surface)
        head, notes = other, [*notes, *more]
    with screen.progress_bar() as progress:
        for path in to:
            try:
                done = workbench.export_track(
                    track, head, path, shot=shot, rate=fps, pictures=pictures, dressed=dressed, progress=progress
                )
            except KeyboardInterrupt:
                screen.errors.print(f"[yellow]interrupted[/yellow]: {escape(str(path))} was not written")
                raise typer.Exit(130) from None
            told = FORMATS[format_of(path)]
            screen.console.print(f"{escape(str(done.path))}  [dim]{told}[/dim]", soft_wrap=True)
            notes += [note for note in done.notes if note not in notes]
    for note in notes:
        screen.console.print(f"[yellow]note:[/yellow] {escape(note)}", soft_wrap=True)


def _check_targets(to: list[Path], character: str | None) -> None:
    """Raise `InputError`, before anything is written, for a suffix, a character or a place that one cannot have."""
    taken: dict[Path, Path] = {}
    for path in to:
        place = place_of(path)
        other = taken.setdefault(place.absolute(), path)
        if other is not path:
            raise InputError(f"{other} and {path} would both be written to {place}; give each its own name.")
        if format_of(path) in MESHES:
            check_free(place)
        if character is not None:
            check_shows_character(path, character)


def model_of_track(track: "workbench.Track", path: Path | None) -> tuple["workbench.FaceModel", list[str]]:
    """The model that a track was fitted with, from a file or the default head, and what is odd about it.

    Raises `InputError` for a track of a model other than the default head without its file.
    """
    from workbench.tracking.track_layout import scheme_of

    stored = track.meta.get("model") or {}
    if path is not None:
        model = workbench.load_face_model(path)
        if model.expression_names != track.expression_names:
            # Runs give a model the scheme of the landmarks, and with it the eyes' units.
            model = workbench.face.in_scheme(model, scheme_of(track.meta))
    else:
        if stored.get("name", "default-head") != "default-head":
            raise InputError(f"This track was fitted with the model {stored['name']}; name its file with --model.")
        full = workbench.load_default_head(gaze=True)
        model = full if track.expression_names == full.expression_names else workbench.load_default_head()
    if stored.get("sha256") is not None and not workbench.face.fits_as(model, stored["sha256"]):
        return model, [f"the track was fitted with another edition of {model.name}; the face may differ a little"]
    return model, []


def _played(
    track, performer: "workbench.FaceModel", character: "workbench.FaceModel", mapping: Path | None, surface: bool
):
    """The track on a character, and which blendshapes have no counterpart."""
    if surface:
        if mapping is not None:
            raise InputError("Give --map or --surface, not both: --surface needs no names.")
        return workbench.export.retarget_surface(track, performer, character), []
    if mapping is None:
        found = workbench.export.mapping_of_track(track, character)
    else:
        found = workbench.export.read_mapping(mapping, track.expression_names, character.expression_names)
    notes = []
    if found.unused:
        notes.append(f"{_some(found.unused)} of the track move nothing on the character")
    if found.still:
        notes.append(f"{_some(found.still)} of the character stay at rest")
    return workbench.export.retarget(track, character, found), notes


def _some(names: tuple[str, ...]) -> str:
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return f"the blendshapes {', '.join(names[:MOST_NAMES])}{more}"
