"""A stored track read frame by frame: memory for a few hundred frames, however long it is."""

import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from io import BufferedIOBase
from pathlib import Path
from typing import Any

import numpy as np

from workbench.reading import array_header, checked_arrays, reading
from workbench.tracking.records import DAMAGED, FrameFit, Track, checked_track_file
from workbench.tracking.track_layout import LAYOUT, check_layout, checked_columns, checked_meta, in_todays_layout

BLOCK_FRAMES = 256
MOST_BYTES = 2**40
"""Limit for all frames together; they are never in memory at once."""


class TrackReader:
    """Reads `track.npz` in blocks; every iteration starts at the first frame."""

    def __init__(self, path: str | Path):
        """Raises `InputError` for a missing, damaged or foreign file."""
        self.path = checked_track_file(path)
        with reading(self.path, *DAMAGED):
            with self.path.open("rb") as stream, checked_arrays(stream, MOST_BYTES) as stored:
                self.meta: dict[str, Any] = checked_meta(stored, self.path)
            with ExitStack() as stack:
                layouts = {name: (shape, dtype) for name, (_, shape, dtype) in self._members(stack).items()}
                (self._count,) = layouts["index"][0]
                check_layout(layouts, self._count, self.meta)

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[FrameFit]:
        for block in self.blocks():
            for position in range(len(block)):
                yield block[position]

    def blocks(self) -> Iterator[Track]:
        """Consecutive blocks as separate tracks. Raises `InputError` on reaching damage in the file."""
        last = -1
        with ExitStack() as stack:
            with reading(self.path, *DAMAGED):
                members = self._members(stack)
            for first in range(0, self._count, BLOCK_FRAMES):
                with reading(self.path, *DAMAGED):
                    rows = min(BLOCK_FRAMES, self._count - first)
                    arrays = {name: _rows(rows, *member) for name, member in members.items()}
                    columns = checked_columns(in_todays_layout(arrays, rows), self.meta)
                    if columns["index"][0] <= last:
                        raise ValueError("its frames are not in ascending order")
                    last = columns["index"][-1]
                # Outside the handler: an error raised by the caller is not damage to the file.
                yield Track(meta=self.meta, **columns)

    def _members(self, stack: ExitStack) -> dict[str, tuple[BufferedIOBase, tuple[int, ...], np.dtype]]:
        """For each array: a stream positioned at its first row, its shape and its type."""
        archive = stack.enter_context(zipfile.ZipFile(self.path))
        names = [name for name in LAYOUT if f"{name}.npy" in archive.namelist()]
        members = {name: stack.enter_context(archive.open(f"{name}.npy")) for name in names}
        return {name: (member, *array_header(member, by_rows=True)) for name, member in members.items()}


def _rows(rows: int, member: BufferedIOBase, shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """The next rows of an array."""
    size = rows * int(np.prod(shape[1:], dtype=int)) * dtype.itemsize
    return np.frombuffer(member.read(size), dtype).reshape(rows, *shape[1:])
