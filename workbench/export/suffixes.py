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
SAME = {".usda": ".usd", ".usdc": ".usd", ".htm": ".html"}


def format_of(path: str | Path) -> str:
    """The key of `FORMATS` for a file name. Raises `InputError` for a suffix that is none of them."""
    name = Path(path).name.lower()
    for suffix in (".arkit.csv", *SAME, *FORMATS):
        if name.endswith(suffix) and len(name) > len(suffix):
            return SAME.get(suffix, suffix)
    raise InputError(f"A track is exported as {', '.join(FORMATS)}, got {Path(path).name}.")
