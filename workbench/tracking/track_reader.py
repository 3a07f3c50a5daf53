"""A stored track frame by frame: memory for some hundred frames, however long it is."""

import zipfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.tracking.records import ARRAYS, FrameFit, Track, checked_meta, in_todays_layout

BLOCK_FRAMES = 256


class TrackReader:
    """Reads `track.npz` in blocks; iterating again starts again."""

    def __init__(self, path: str | Path):
        """Raises `InputError` for a missing, damaged or foreign file."""
        self.path = Path(path)
        if not self.path.is_file():
            raise InputError(f"The track {self.path} does not exist; `workbench track INPUT` writes track.npz.")
        try:
            # Opened here, because NumPy leaves a damaged archive open.
            with self.path.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
                self.meta: dict[str, Any] = checked_meta(stored, self.path)
            with zipfile.ZipFile(self.path) as archive, archive.open("index.npy") as member:
                self._count = _header(member)[0][0]
        except (zipfile.BadZipFile, KeyError, ValueError, OSError, EOFError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"{self.path} is damaged or no workbench track ({error}); run the tracking again."
            ) from error

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[FrameFit]:
        for block in self.blocks():
            for position in range(len(block)):
                yield block[position]

    def blocks(self) -> Iterator[Track]:
        """Consecutive pieces as tracks of their own."""
        with ExitStack() as stack:
            archive = stack.enter_context(zipfile.ZipFile(self.path))
            names = [name for name in ARRAYS if f"{name}.npy" in archive.namelist()]
            members = {name: stack.enter_context(archive.open(f"{name}.npy")) for name in names}
            layouts = {name: _header(member) for name, member in members.items()}
            for first in range(0, self._count, BLOCK_FRAMES):
                rows = min(BLOCK_FRAMES, self._count - first)
                arrays = {}
                for name, member in members.items():
                    (_, *shape), dtype = layouts[name]
                    size = rows * int(np.prod(shape, dtype=int)) * dtype.itemsize
                    arrays[name] = np.frombuffer(member.read(size), dtype).reshape(rows, *shape)
                yield Track(meta=self.meta, **in_todays_layout(arrays, rows))


def _header(member) -> tuple[tuple[int, ...], np.dtype]:
    version = np.lib.format.read_magic(member)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(member)
    return shape, dtype
