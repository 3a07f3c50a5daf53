"""The pictures that a track was made from."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from workbench.errors import InputError
from workbench.frames import IMAGE_SUFFIXES, VIDEO_SUFFIXES, FrameRange, Frames, open_frames
from workbench.tracking import Track


def pictures_of(track: Track, pictures: str | Path | None = None) -> Frames:
    """The frames of the track's input, or of `pictures` in its place; of a part of a clip where it holds one.

    Raises `InputError` where they are not where they were, and for a track of landmarks alone.
    """
    if pictures is not None:
        return tracked_part(open_frames(pictures), track.meta)
    paths = [Path(item["path"]) for item in track.meta.get("inputs", [])]
    if not paths or any(path.suffix.lower() not in (*IMAGE_SUFFIXES, *VIDEO_SUFFIXES, "") for path in paths):
        raise InputError("This track was made from landmarks without pictures; name the pictures with --pictures.")
    missing = [path for path in paths if not path.exists()]
    if missing:
        raise InputError(f"The pictures of this track are no longer at {missing[0]}; name them with --pictures.")
    return tracked_part(open_frames(paths if len(paths) > 1 else paths[0]), track.meta)


def input_files(meta: Mapping[str, Any]) -> list[Path]:
    """What a track was made from, by its metadata: files and folders that nothing may be written over."""
    named = [*meta.get("inputs", []), *filter(None, [meta.get("landmarks")])]
    return [*(Path(item["path"]) for item in named), *(Path(path) for path in (meta.get("views") or {}).values())]


def tracked_part(frames: Frames, meta: Mapping[str, Any]) -> Frames:
    """The frames of an input that a track holds, by its metadata: all of them, or those of `track --frames`."""
    part = meta.get("frames")
    return frames if part is None else FrameRange(frames, *part)
