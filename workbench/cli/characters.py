"""`workbench character`: the person in a tracked clip, as a character that heads are drawn as."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import workbench
from workbench.cli import screen
from workbench.cli.tracking import track_file
from workbench.errors import InputError
from workbench.face.characters import PLAIN, character_names
from workbench.files import check_not_inputs

CHARACTER_HELP = """Make the person in a tracked clip a character: the fitted face, with a skin painted from the clip.

[bold]Examples[/bold]

  workbench track talk.mp4

  workbench character out/talk --out me

  workbench character out/talk --out me --hair short02 --eyes blue

  workbench export out/talk --to talk.glb --character me

Several frames are looked at from all sides; what none of them shows is taken from the most similar of \
the bundled skins. \
Hair, eyes and clothes are those of the ready characters (data_samples/head/people/characters.toml); for an unknown \
style, the error lists those available.
"""
NO_STYLE = "none"


def character(
    run: Annotated[Path, typer.Argument(metavar="TRACK", help="Folder of a run, or its track.npz.")],
    out: Annotated[Path, typer.Option(help="Folder to write: character.toml and the skin.")],
    hair: Annotated[str, typer.Option(help="A style such as short02 or long01, or none.")] = NO_STYLE,
    hair_color: Annotated[
        str | None, typer.Option(help="Mean colour as R,G,B from 0 to 255 (default: as in the clip).")
    ] = None,
    eyes: Annotated[str, typer.Option(help="Colour of the irises, such as blue.")] = "brown",
    clothes: Annotated[str, typer.Option(help="A style such as shirt, or none.")] = "shirt",
    pictures: Annotated[Path | None, typer.Option(help="The pictures, if they have been moved.")] = None,
) -> None:
    """Write the person in a clip as a character."""
    from workbench.export.sources import input_files, pictures_of
    from workbench.pipeline.clip_character import Wardrobe, character_of_clip

    if str(out) in (PLAIN, *character_names()):
        raise InputError(f"--character {out} is a bundled character; name another folder.")
    stored = track_file(run)
    track = workbench.Track.load(stored)
    check_not_inputs([out], [stored, *input_files(track.meta)])
    wardrobe = Wardrobe(
        hair="" if hair == NO_STYLE else hair,
        hair_color=None if hair_color is None else _color(hair_color),
        eyes=eyes,
        clothes="" if clothes == NO_STYLE else clothes,
    )
    with screen.progress_bar() as progress:
        made = character_of_clip(track, pictures_of(track, pictures), out, wardrobe, progress)
    listed = ", ".join(map(str, made.frames))
    screen.console.print(f"{escape(str(made.folder))}  [dim]a character; name it with --character[/dim]")
    screen.console.print(
        f"[dim]{made.seen_share:.0%} of the skin is from frames {listed}, the rest like {made.completed_by}[/dim]"
    )


def _color(text: str) -> tuple[float, float, float]:
    parts = text.split(",")
    try:
        red, green, blue = (float(part) for part in parts)
    except ValueError:
        raise InputError(f"A colour is three numbers from 0 to 255, for example 82,62,46; got {text!r}.") from None
    return red, green, blue
