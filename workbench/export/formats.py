"""A track exported as what the suffix of the file says."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from workbench.errors import InputError
from workbench.export.clip import check_model, check_rate, make_clip, note_on_rate, track_of_shot
from workbench.export.live_link import write_live_link_csv
from workbench.export.meshes import write_arrays, write_meshes
from workbench.export.report import write_report
from workbench.export.sources import input_files, pictures_of
from workbench.export.suffixes import MESHES, check_shows_character, format_of, place_of
from workbench.export.tables import write_curves, write_parquet
from workbench.export.usd import write_usd
from workbench.face import DressedHead, FaceModel
from workbench.face.dressed_head import check_wears_characters
from workbench.files import check_not_inputs, remove_partial_files
from workbench.frames import RATE_OF_IMAGES, Frames
from workbench.pictures.overlay_files import write_overlay_video
from workbench.tracking import Track
from workbench.tracking.unwatched import silent

Progress = Callable[[str, int, int | None], None]
"""Called with the name of a step, what is done, and how much there is in all."""
LEFT_BEHIND_S = 3600.0
"""Age from which a temporary file of an export is one that a killed program left: none is written to that rarely."""


@dataclass(frozen=True)
class Exported:
    """What an export left behind."""

    path: Path
    """The file, or the folder of the meshes."""
    notes: tuple[str, ...] = field(default=())
    """What a user should know."""


def export_track(
    track: Track,
    model: FaceModel,
    path: str | Path,
    *,
    shot: int | None = None,
    rate: float | int | None = None,
    pictures: str | Path | None = None,
    dressed: DressedHead | None = None,
    progress: Progress | None = None,
) -> Exported:
    """Write a track in the format that the suffix of `path` names (`FORMATS`), completely or not at all.

    `model` is the model that it was fitted with, or the character that it was retargeted to. `shot` takes the frames of
    one shot, `rate` replaces the frames per second, `pictures` stands for an input that was moved. `dressed` shows the
    default head as a character: with that person's face in .glb and .usd, with the fitted one in .mp4 and .html. The
    meshes of .obj and .ply go into a folder of that name without the suffix. Raises `InputError` for what cannot be
    exported, `ModelError` for a character on a model other than the default head, `OutputError` for a file that cannot
    be written or is an input, and `MissingDependencyError` where a format needs a package that is not installed.
    """
    path, kind, progress = Path(path), format_of(path), progress or silent
    given = [] if pictures is None else [Path(pictures)]
    check_not_inputs([path], [*given, *input_files(track.meta)])
    check_model(track, model)
    place = place_of(path)
    with suppress(OSError):  # tidying up is no reason to fail
        remove_partial_files(place.parent, [place.name], LEFT_BEHIND_S)
    if dressed is not None:
        check_shows_character(path, dressed.character.name)
        check_wears_characters(model)
    if shot is not None:
        track = track_of_shot(track, shot)
    check_rate(rate)
    if rate is not None:
        track = replace(track, meta={**track.meta, "rate": float(rate)})
    fps = float(track.meta.get("rate") or RATE_OF_IMAGES)
    if kind == ".arkit.csv":
        write_live_link_csv(track, path, fps)
    elif kind == ".csv":
        write_curves(track, path, fps)
    elif kind == ".parquet":
        write_parquet(track, path, fps)
    elif kind == ".mp4":
        return _film(track, model, path, pictures, dressed, progress)
    elif kind == ".html":
        return _report(track, model, path, pictures, dressed, progress)
    else:
        return _in_3d(track, model, path, kind, dressed, progress)
    return Exported(path, note_on_rate(track))


def _in_3d(track, model, path: Path, kind: str, dressed: DressedHead | None, progress: Progress) -> Exported:
    clip = make_clip(track, model)
    if dressed is not None:
        clip = replace(clip, person=model.personal(dressed.character.identity))
    if kind in MESHES:
        folder = place_of(path)
        write_meshes(clip, folder, kind[1:], lambda done, total: progress("meshes", done, total))
        return Exported(folder, clip.notes)
    if kind == ".npz":
        write_arrays(clip, path)
    elif kind == ".usd":
        write_usd(clip, path, dressed)
    else:
        from workbench.export.gltf import write_gltf  # here: it needs an extra, the other formats do not

        write_gltf(clip, path, dressed)
    return Exported(path, clip.notes)


def _film(track, model, path: Path, pictures, dressed: DressedHead | None, progress: Progress) -> Exported:
    frames = pictures_of(track, pictures)
    rate = track.meta.get("rate") or frames.rate

    def drawn(done: int, total: int) -> None:
        progress("film", done, total)

    note = write_overlay_video(frames, track, model, path, drawn, dressed=dressed, rate=rate)
    return Exported(path, (*([note] if note else []), *(() if rate else note_on_rate(track))))


def _report(track, model, path: Path, pictures, dressed: DressedHead | None, progress: Progress) -> Exported:
    frames: Frames | None = None
    notes: tuple[str, ...] = ()
    try:
        frames = pictures_of(track, pictures)
    except InputError as error:
        if pictures is not None:
            raise
        notes = (f"the report has no pictures of the input: {error}",)

    def drawn(done: int, total: int) -> None:
        progress("report", done, total)

    write_report(track, model, path, frames, progress=drawn, dressed=dressed)
    return Exported(path, notes)
