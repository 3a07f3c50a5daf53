"""What a track can be exported as: the suffix of the file decides."""

from pathlib import Path

from workbench.errors import InputError

FORMATS = {
    ".glb": "glTF 2.0: blendshapes by name, jaw, camera, animation",
    ".usd": "USD (also .usda, .usdc): the same with UsdSkel",
    ".arkit.csv": "Live Link Face: ARKit's weights, head angles, timecode",
    ".csv": "every curve: pose, weights, errors",
    ".parquet": "the same as Parquet",
    ".npz": "curves, camera, the person's head as NumPy arrays",
    ".obj": "a folder with one mesh per frame",
    ".ply": "a folder with one mesh per frame",
    ".mp4": "pictures with the fit, the 3D face beside them",
    ".html": "a report: pictures, curves, worst frames, settings",
}
"""Suffixes and what is written under them."""
DRESSED = (".glb", ".usd", ".mp4", ".html")
"""Formats that show a character."""
MESHES = (".obj", ".ply")
"""Formats that are a folder."""
SAME = {".usda": ".usd", ".usdc": ".usd", ".htm": ".html"}


def format_of(path: str | Path) -> str:
    """The key of `FORMATS` for a file name.

    Raises `InputError` for any other suffix, and if there is no name before it.
    """
    name = Path(path).name.lower()
    if name in ("", *SAME, *FORMATS):
        raise InputError(
            f"A track is exported as {', '.join(FORMATS)}, with a name in front, such as talk.glb; "
            f"got {name or 'no name'}: name the file."
        )
    for suffix in (".arkit.csv", *SAME, *FORMATS):
        if name.endswith(suffix):
            return SAME.get(suffix, suffix)
    raise InputError(f"A track is exported as {', '.join(FORMATS)}, got {Path(path).name}.")


def place_of(path: str | Path) -> Path:
    """The file that an export writes, or the folder of its meshes. Raises `InputError` as `format_of`."""
    return Path(path).with_suffix("") if format_of(path) in MESHES else Path(path)


def check_free(folder: Path) -> None:
    """Raise `InputError` where a folder of meshes already exists: it may hold frames of another export."""
    if folder.exists():
        raise InputError(f"{folder} already exists; name another folder for the meshes.")


def pictures_folder(stage: Path) -> Path:
    """The folder beside a stage of USD with the pictures of a character."""
    return stage.parent / f"{stage.name}_textures"


def check_shows_character(path: str | Path, name: str) -> None:
    """Raise `InputError` where the format of `path` cannot show a character."""
    if format_of(path) not in DRESSED:
        raise InputError(f"{path} cannot show the character {name}; name a file ending in {', '.join(DRESSED)}.")
