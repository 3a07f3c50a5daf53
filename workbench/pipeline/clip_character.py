"""The person in a clip as a character: the fitted face, with a skin painted from the clip's own frames."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from workbench.errors import InputError
from workbench.face import (
    Character,
    FaceModel,
    dress,
    load_default_head,
    posed_vertices,
    read_skin,
    skin_names,
)
from workbench.face.characters import CHARACTER_FILE, MOST_SIGMA
from workbench.files import atomic_path, make_folder
from workbench.frames import Frames
from workbench.landmarks.scheme import GROUPS, error_unit
from workbench.pictures.mesh import scaled_camera, to_camera
from workbench.rendering import render
from workbench.rendering.skin_texture import SkinView, completed_skin, painted_skin
from workbench.rendering.topology import mesh_topology
from workbench.tracking import FrameFit, Track
from workbench.tracking.unwatched import silent

YAWS_DEG = (-22.0, -8.0, 8.0, 22.0)
"""Views are taken from each of the ranges between these."""
CANDIDATES, VIEWS = 6, 2
"""Frames of a range that are looked at, and those of them that are used."""
LARGEST_EYES_PX = 350.0
"""Outer-eye distance beyond which pictures are reduced: the texture holds no more."""
SHARPNESS_PX = 96
"""Side at which the sharpness of faces is compared."""
ERROR_SHARE = 0.3
"""Landmark error in percent, against one blendshape of weight 1, that speaks as much against a frame."""
SKIN_FILE, SKIN_QUALITY = "skin.webp", 92

Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Wardrobe:
    """What the clip does not show: names of styles, as in `characters.toml`."""

    hair: str = ""
    """Empty: none."""
    hair_color: tuple[float, float, float] | None = None
    """Mean colour, RGB of 0 to 255; None: as the clip shows it."""
    eyes: str = "brown"
    clothes: str = "shirt"
    """Empty: none."""
    teeth: str = "teeth_base"
    lashes: str = "eyelashes01"


@dataclass(frozen=True)
class ClipCharacter:
    """A character that was written."""

    folder: Path
    """What `head.character` and `--character` name."""
    frames: tuple[int, ...]
    """Whose pictures the skin is painted from."""
    seen_share: float
    """Part of the texture that they show."""
    completed_by: str
    """The skin that the rest is taken from."""


def character_of_clip(
    track: Track,
    frames: Frames,
    folder: str | Path,
    wardrobe: Wardrobe = Wardrobe(),
    progress: Progress | None = None,
) -> ClipCharacter:
    """Write the tracked person as a character: a folder with `character.toml` and the skin.

    The identity is that of the longest shot. Brows come with the skin. Raises `InputError` for a track of another model
    than the default head, without usable frames, or whose faces are too small, and for a colour beyond 0 to 255,
    `ModelError` for styles that are not there.
    """
    folder, progress = Path(folder), progress or silent
    model = _model(track)
    fits = usable_fits(track)
    _check_styles(wardrobe, fits[0].identity)
    views, used = _views(fits, frames, model, progress)
    progress("skin", 0, None)
    painted = painted_skin(views, model)
    skin, name = completed_skin(painted, model, {name: read_skin(name) for name in skin_names()})
    color = wardrobe.hair_color
    if wardrobe.hair and color is None:
        color = scalp_color(views, model)
    make_folder(folder)
    _write_webp(folder / SKIN_FILE, skin)
    told = _toml(wardrobe, color, fits[0].identity)
    with atomic_path(folder / CHARACTER_FILE) as temporary:
        temporary.write_text(told, encoding="utf-8")
    return ClipCharacter(folder, used, painted.share, name)


def _check_styles(wardrobe: Wardrobe, identity: np.ndarray) -> None:
    """Raise `ModelError` for a style and `InputError` for a colour that cannot be, before minutes are spent."""
    color = wardrobe.hair_color
    if color is not None and not (len(color) == 3 and all(0.0 <= value <= 255.0 for value in color)):
        raise InputError(
            f"A colour is three numbers from 0 to 255, for example 82,62,46; got {', '.join(map(str, color))}."
        )
    styles = {name: getattr(wardrobe, name) for name in ("hair", "eyes", "clothes", "teeth", "lashes")}
    dress(Character("person", "", skin=skin_names()[0], brows="", identity=identity, **styles))


def usable_fits(track: Track) -> list[FrameFit]:
    """The fits of the longest shot to a face that was seen, without failure. Raises `InputError` if there are none."""
    usable = np.asarray(track.found, bool) & (np.asarray(track.failure) == 0) & track.seen
    if not usable.any():
        raise InputError("No frame of this track has a usable face, so there is no person to make a character of.")
    shots, counts = np.unique(track.shot[usable], return_counts=True)
    chosen = usable & (track.shot == shots[counts.argmax()])
    return [track[int(position)] for position in np.flatnonzero(chosen)]


def candidates(fits: Sequence[FrameFit]) -> list[list[FrameFit]]:
    """The calmest and best fitted frames of each range of yaw, at most `CANDIDATES` of each, apart in time."""
    yaw = np.array([fit.angles_deg[0] for fit in fits])
    unrest = np.array([float((fit.expression**2).sum()) + ERROR_SHARE * fit.errors[1] for fit in fits])
    ranges = np.digitize(yaw, YAWS_DEG)
    chosen = []
    for number in range(len(YAWS_DEG) + 1):
        members = np.flatnonzero(ranges == number)
        # The best of each stretch of the range: neighbours in time show the same.
        stretches = np.array_split(members, min(CANDIDATES, len(members))) if len(members) else []
        chosen.append([fits[stretch[unrest[stretch].argmin()]] for stretch in stretches])
    return [group for group in chosen if group]


def _views(
    fits: Sequence[FrameFit], frames: Frames, model: FaceModel, progress: Progress
) -> tuple[list[SkinView], tuple[int, ...]]:
    groups = candidates(fits)
    wanted = {fit.index: (number, fit) for number, group in enumerate(groups) for fit in group}
    found: list[list[tuple[float, int, SkinView]]] = [[] for _ in groups]
    person = model.personal(fits[0].identity)
    for done, (index, picture) in enumerate(_pictures(frames, set(wanted))):
        number, fit = wanted[index]
        found[number].append((sharpness(picture, fit), index, _view(picture, fit, person)))
        # No more pictures are held than may be used.
        found[number] = sorted(found[number], key=lambda entry: -entry[0])[:VIEWS]
        progress("pictures", done + 1, len(wanted))
    kept = [entry for group in found for entry in group]
    if not kept:
        raise InputError("None of the track's frames is in the pictures; name those that were tracked.")
    sharpest = max(entry[0] for entry in kept)
    views = [SkinView(v.picture, v.vertices_camera, v.camera, share / sharpest) for share, _, v in kept]
    return views, tuple(sorted(index for _, index, _ in kept))


def _pictures(frames: Frames, wanted: set[int]) -> Iterator[tuple[int, UInt8[np.ndarray, "h w 3"]]]:
    last = max(wanted)
    for frame in frames.iterate(min(wanted)):
        if frame.index in wanted:
            yield frame.index, frame.picture
        if frame.index >= last:
            return


def sharpness(picture: UInt8[np.ndarray, "h w 3"], fit: FrameFit) -> float:
    """Mean square of the Laplacian of the face, brought to one size."""
    height, width = picture.shape[:2]
    inner = fit.observed[list(GROUPS["inner"])]
    low = np.clip(np.floor(inner.min(axis=0)), 0, [width - 2, height - 2]).astype(int)
    high = np.clip(np.ceil(inner.max(axis=0)) + 1, low + 2, [width, height]).astype(int)
    face = cv2.cvtColor(picture[low[1] : high[1], low[0] : high[0]], cv2.COLOR_RGB2GRAY)
    same = cv2.resize(face, (SHARPNESS_PX, SHARPNESS_PX), interpolation=cv2.INTER_AREA)
    return float((cv2.Laplacian(same, cv2.CV_64F) ** 2).mean()) + 1e-6


def _view(picture: UInt8[np.ndarray, "h w 3"], fit: FrameFit, person: FaceModel) -> SkinView:
    vertices = posed_vertices(person, fit.expression, fit.jaw, fit.scale)
    placed, camera = to_camera(vertices, fit.rotation, fit.translation), fit.camera
    factor = LARGEST_EYES_PX / float(error_unit(fit.observed))
    if factor < 1.0:
        size = (round(factor * picture.shape[1]), round(factor * picture.shape[0]))
        picture, camera = cv2.resize(picture, size, interpolation=cv2.INTER_AREA), scaled_camera(camera, factor)
    return SkinView(picture, placed, camera)


def scalp_color(views: Sequence[SkinView], model: FaceModel) -> tuple[float, float, float]:
    """The median colour of what lies over the scalp, RGB of 0 to 255: hair, where there is any."""
    scalp = np.zeros(len(model.neutral), bool)
    scalp[model.regions["scalp"]] = True
    inside = np.append(scalp[model.triangles].all(axis=1), False)
    topology, colors = mesh_topology(model.triangles, len(model.neutral)), []
    for view in views:
        height, width = view.picture.shape[:2]
        seen = np.asarray(
            render(
                view.vertices_camera, topology, view.camera, model.colors / 255.0, np.zeros((9, 3)), np.zeros(3),
                size=(width, height), antialias=False,
            ).triangle
        )  # fmt: skip
        shown = cv2.erode(inside[seen].astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
        colors.append(view.picture[shown])
    together = np.concatenate(colors)
    return tuple(np.median(together, axis=0).tolist()) if len(together) else (80.0, 64.0, 52.0)


def _model(track: Track) -> FaceModel:
    stored = track.meta.get("model") or {}
    if stored.get("name", "default-head") != "default-head":
        raise InputError(
            f"Characters are for the default head, but this track was fitted with {stored['name']}; track without "
            "--model."
        )
    full = load_default_head(gaze=True)
    return full if track.expression_names == full.expression_names else load_default_head()


def _write_webp(path: Path, picture: UInt8[np.ndarray, "h w 3"]) -> None:
    encoded = cv2.imencode(".webp", picture[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, SKIN_QUALITY])[1]
    with atomic_path(path) as temporary:
        temporary.write_bytes(encoded.tobytes())


def _toml(wardrobe: Wardrobe, hair_color: tuple[float, float, float] | None, identity: np.ndarray) -> str:
    lines = [
        "[person]",
        'words = "the person in a clip"',
        f'skin = "{SKIN_FILE}"',
        f'eyes = "{wardrobe.eyes}"',
        'brows = ""',
        f'lashes = "{wardrobe.lashes}"',
        f'teeth = "{wardrobe.teeth}"',
        f'hair = "{wardrobe.hair}"',
        f'clothes = "{wardrobe.clothes}"',
    ]
    if wardrobe.hair and hair_color is not None:
        lines.append(f"hair_color = {[round(float(value), 1) for value in hair_color]}")
    lines.append(f"identity = {[round(float(value), 4) for value in np.clip(identity, -MOST_SIGMA, MOST_SIGMA)]}")
    return "\n".join(lines) + "\n"
