"""The pictures that a track was made from."""

import os
from collections.abc import Generator, Iterable, Mapping
from pathlib import Path
from typing import Any

from workbench.config import config_of_track
from workbench.errors import InputError
from workbench.frames import Frame, FrameRange, Frames, open_frames
from workbench.geometry import read_rig
from workbench.landmarks.files import is_landmark_file
from workbench.reading import brought_along, is_as_hashed, place_now
from workbench.tracking import Track


def pictures_of(track: Track, pictures: str | Path | None = None) -> Frames:
    """The frames of the track's input, or of `pictures` in its place; of a part of a clip where it holds one.

    Of several cameras those of the rig's first view. Raises `InputError` where they are no longer, or others are, for
    a track of landmarks alone, and, as it is read, for a frame of a different size from the one that was tracked.
    """
    if pictures is not None:
        return TrackedFrames(tracked_part(open_frames(pictures), track.meta), track, pictures)
    paths = reference_inputs(track.meta)
    if not paths or any(map(is_landmark_file, paths)):
        raise InputError("This track was made from landmarks without pictures; name the pictures with --pictures.")
    for told in gone_pictures(track.meta, paths).values():
        raise InputError(f"{told}; name them with --pictures.")
    return TrackedFrames(tracked_part(open_frames(paths if len(paths) > 1 else paths[0]), track.meta), track, paths[0])


def reference_inputs(meta: Mapping[str, Any]) -> list[Path]:
    """What a track's own frames come from, by its metadata: its inputs without the clips of a rig's other cameras.

    Raises `InputError` as `view_clips` does.
    """
    paths = _inputs(meta)
    return paths[: len(paths) - len(view_clips(meta))]


def view_clips(meta: Mapping[str, Any]) -> dict[str, Path]:
    """The clips of a rig's other cameras by the views' names, from a track's metadata; they are its last inputs.

    Older tracks do not name them: theirs are in the order of the rig. Raises `InputError` if that rig cannot be read.
    """
    if meta.get("views") is not None:
        return {name: place_now(path, _hashes(meta).get(path, "")) for name, path in meta["views"].items()}
    paths = _inputs(meta)
    config = config_of_track(meta) if len(paths) > 1 else None
    names = read_rig(config.camera.rig).names[1:] if config is not None and config.camera.rig else ()
    return dict(zip(names, paths[-len(names) :], strict=True)) if len(paths) > len(names) > 0 else {}


def _inputs(meta: Mapping[str, Any]) -> list[Path]:
    return [place_now(item["path"], item.get("sha256", "")) for item in meta.get("inputs", [])]


def input_files(meta: Mapping[str, Any]) -> list[Path]:
    """What a track was made from, by its metadata: files and folders that nothing may be written over.

    For a folder that was copied, both the copies and the originals.
    """
    named = filter(None, [*meta.get("inputs", []), meta.get("landmarks")])
    return [
        place for item in named for place in (Path(item["path"]), *brought_along(item["path"], item.get("sha256", "")))
    ]


def landmark_file(meta: Mapping[str, Any]) -> Path | None:
    """The file that a track's landmarks come from, by its metadata; None where a detector found them."""
    named = meta.get("landmarks")
    return None if named is None else place_now(named["path"], named.get("sha256", ""))


def input_hashes(meta: Mapping[str, Any]) -> dict[Path, str]:
    """SHA-256 of what a track was made from, by where that is now; empty where it is not known."""
    named = filter(None, [*meta.get("inputs", []), meta.get("landmarks")])
    return {place_now(item["path"], sha256 := item.get("sha256", "")): sha256 for item in named}


def gone_pictures(meta: Mapping[str, Any], paths: Iterable[Path]) -> dict[Path, str]:
    """Those of a track's inputs that are no longer where they were, or others than they were, and how that is said."""
    hashes, told = _hashes(meta), {}
    for path in paths:
        if not os.path.exists(path):
            told[path] = f"The pictures of this track are no longer at {path}"
        elif not _holds(path, hashes.get(str(path), "")):
            told[path] = f"The pictures of this track are no longer at {path}, where another file is now"
    return told


def _hashes(meta: Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 of a track's inputs by the places that its metadata name; empty where it is not known."""
    return {item["path"]: item.get("sha256", "") for item in meta.get("inputs", [])}


def _holds(path: Path, sha256: str) -> bool:
    """Whether a file is the one that was hashed. A folder counts as such: what came into it later may be no picture."""
    return not path.is_file() or is_as_hashed(path, sha256)


def tracked_part(frames: Frames, meta: Mapping[str, Any]) -> Frames:
    """The frames of an input that a track holds, by its metadata: all of them, or those of `track --frames`."""
    part = meta.get("frames")
    return frames if part is None else FrameRange(frames, *part)


class TrackedFrames:
    """Pictures of a track, each as large as the one that was tracked: fits are pixels of those."""

    def __init__(self, frames: Frames, track: Track, path: str | Path) -> None:
        """`path` is what an error names."""
        self._frames, self._path = frames, path
        self._sizes = dict(zip(track.index.tolist(), map(tuple, track.image_size.tolist()), strict=True))
        self.kind, self.name, self.rate, self.image_size = frames.kind, frames.name, frames.rate, frames.image_size
        self.announced_count = frames.announced_count

    @property
    def notes(self) -> list[str]:
        """Those of the stream."""
        return self._frames.notes

    def iterate(self, start: int = 0) -> Generator[Frame]:
        """Yield the frames from index `start` on. Raises `InputError` for one of another size."""
        for frame in self._frames.iterate(start):
            height, width = frame.picture.shape[:2]
            tracked_width, tracked_height = self._sizes.get(frame.index, (width, height))
            if (width, height) != (tracked_width, tracked_height):
                raise InputError(
                    f"The pictures of {self._path} are {width}x{height} ({frame.name}), those that were tracked "
                    f"{tracked_width}x{tracked_height}; name the tracked ones with --pictures."
                )
            yield frame
