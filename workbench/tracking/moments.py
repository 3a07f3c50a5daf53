"""Fits with their pictures as a stream, which the temporal passes read and write window by window."""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from workbench.errors import InputError
from workbench.frames import Frames
from workbench.geometry import Rig
from workbench.tracking.observation import Pictures
from workbench.tracking.records import FrameFit

MEMORY_BYTES = 64 * 2**20
"""Pictures of a gap beyond this size are held on disk."""


class Moment(NamedTuple):
    """One frame: its fit, and its picture in every view."""

    fit: FrameFit
    pictures: Pictures


def moments(fits: Iterable[FrameFit], views: Sequence[Frames]) -> Iterator[Moment]:
    """The fits with the pictures of each view, in order; `fits` are all frames of the views from 0 on.

    Raises `InputError` if there are fewer pictures than fits, and for one of the first view that is not as large as the
    one that was tracked.
    """
    streams = [frames.iterate() for frames in views]
    for fit in fits:
        pictures = tuple(frame.picture for stream in streams if (frame := next(stream, None)) is not None)
        if len(pictures) < len(views):
            raise InputError(
                f"The track has a frame {fit.index}, but its pictures end earlier; pass the pictures it was made from."
            )
        if pictures and pictures[0].shape[1::-1] != tuple(fit.image_size):
            (height, width), (tracked_width, tracked_height) = pictures[0].shape[:2], fit.image_size
            raise InputError(
                f"Frame {fit.index} is {width}x{height} in the pictures, and was {tracked_width}x{tracked_height} when "
                "it was tracked; name the tracked pictures."
            )
        yield Moment(fit, pictures)


def view_sizes(fit: FrameFit, rig: Rig | None, pictures: Pictures) -> tuple[tuple[int, int], ...]:
    """(width, height) of a fit's pictures in each view of a rig; without them, scaled like the reference view's."""
    if pictures or rig is None:
        return tuple(picture.shape[1::-1] for picture in pictures)
    reference, *others = (np.array(view.image_size) for view in rig.views)
    scale = np.array(fit.image_size) / reference
    return tuple(tuple(np.rint(size * scale).astype(int).tolist()) for size in (reference, *others))


class PictureSpool:
    """Pictures held for later, in memory up to 64 MB and on disk beyond that; read by position."""

    def __init__(self) -> None:
        self._file: tempfile.SpooledTemporaryFile | None = None
        self._places: list[list[tuple[int, tuple[int, ...]]]] = []

    def append(self, pictures: Pictures) -> None:
        """Add the pictures of the next frame."""
        if self._file is None:
            self._file = tempfile.SpooledTemporaryFile(max_size=MEMORY_BYTES)  # noqa: SIM115 - closed by `close`
        self._file.seek(0, 2)
        places = []
        for picture in pictures:
            places.append((self._file.tell(), picture.shape))
            self._file.write(np.ascontiguousarray(picture).tobytes())
        self._places.append(places)

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, position: int) -> Pictures:
        found = []
        for place, shape in self._places[position]:
            self._file.seek(place)
            found.append(np.frombuffer(self._file.read(int(np.prod(shape))), np.uint8).reshape(shape))
        return tuple(found)

    def close(self) -> None:
        """Discard all pictures."""
        if self._file is not None:
            self._file.close()
