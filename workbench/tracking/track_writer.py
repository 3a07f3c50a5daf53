"""A track written while it grows: finished parts on disk, one file at the end, memory flat in its length."""

import io
import shutil
import time
import zipfile
from bisect import bisect_right
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from workbench.errors import InputError
from workbench.files import atomic_path, make_folder
from workbench.tracking.records import ARRAYS, FrameFit, Track, meta_array, stack_fits

FINGERPRINT = "fingerprint"
PART_FRAMES = 256
PART_SECONDS = 10.0
"""A killed run loses no more work than this, or no more frames than `PART_FRAMES`."""


class TrackWriter:
    """Collects fits in parts under `<path>.parts/` and joins them to one .npz at the end.

    Each part is one file with checksums, whole or absent (of one growing HDF5 file, a cut or a flipped bit may lose all
    frames or go unnoticed), and carries the tracker's state behind its last frame, so that an interrupted run goes on
    from there. `fingerprint` says what the run depends on; parts of another run are discarded, and so are damaged ones
    with all behind them. Raises `OutputError` for what cannot be written.
    """

    def __init__(self, path: str | Path, meta: dict[str, Any], fingerprint: str, resume: bool = False):
        self.path = Path(path)
        self.parts_folder = _parts_folder(self.path)
        self.meta = meta
        self._buffer: list[FrameFit] = []
        self._parts: list[Path] = []
        self._firsts: list[int] = []
        self._count = 0
        self._open_part: tuple[int, Track | None] = (-1, None)
        self._stored_at = time.monotonic()
        if resume and has_parts(self.path, fingerprint):
            self._keep_sound_parts()
            return
        shutil.rmtree(self.parts_folder, ignore_errors=True)
        make_folder(self.parts_folder)
        with atomic_path(self.parts_folder / FINGERPRINT) as temporary:
            temporary.write_text(fingerprint)

    def state(self) -> dict[str, np.ndarray]:
        """State stored with the newest part; empty if there is none."""
        if not self._parts:
            return {}
        with np.load(self._parts[-1], allow_pickle=False) as stored:
            prefix = "state/"
            return {name.removeprefix(prefix): stored[name] for name in stored.files if name.startswith(prefix)}

    def add(self, fit: FrameFit) -> None:
        """Take the next frame."""
        self._buffer.append(fit)

    def wants_part(self) -> bool:
        """Whether enough frames have come, or enough time has passed, for another part."""
        waited = time.monotonic() - self._stored_at > PART_SECONDS
        return len(self._buffer) >= PART_FRAMES or (waited and len(self._buffer) > 0)

    def write_part(self, state: dict[str, np.ndarray]) -> None:
        """Store the frames so far as a part, with the state that the next frame depends on."""
        if not self._buffer:
            return
        part = self._part(len(self._parts))
        with atomic_path(part) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(
                stream, **stack_fits(self._buffer), **{f"state/{name}": value for name, value in state.items()}
            )
        self._take(part, len(self._buffer))
        self._buffer, self._stored_at = [], time.monotonic()

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, position: int) -> FrameFit:
        """A frame of a finished part; frames that follow each other read each part once."""
        if not 0 <= position < self._count:
            raise IndexError(position)
        number = bisect_right(self._firsts, position) - 1
        if self._open_part[0] != number:
            self._open_part = (number, self._track(self._parts[number]))
        return self._open_part[1][position - self._firsts[number]]

    @property
    def index(self) -> Int[np.ndarray, "n"]:
        """Frame indices of the finished parts: a run takes every frame of its input, from 0."""
        return np.arange(self._count)

    def tracks(self) -> Iterator[Track]:
        """Each finished part as a track of its own."""
        return map(self._track, self._parts)

    def close(self) -> None:
        """Join the parts to the track file and remove them. Raises `InputError` if there is no frame."""
        if not self._count:
            self.discard()
            raise InputError("There was no frame to track; check that the input holds pictures.")
        with (
            atomic_path(self.path) as temporary,
            zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive,
        ):
            for name in ARRAYS:
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    self._join(name, member)
            with archive.open("meta.npy", "w") as member:
                np.lib.format.write_array(member, meta_array(self.meta), allow_pickle=False)
        self.discard()

    def discard(self) -> None:
        """Remove the parts."""
        shutil.rmtree(self.parts_folder, ignore_errors=True)

    def _join(self, name: str, member: io.IOBase) -> None:
        # One array at a time and one part at a time: the header needs only the total length.
        for number, part in enumerate(self._parts):
            with np.load(part, allow_pickle=False) as stored:
                array = stored[name]
            if number == 0:
                shape = (self._count, *array.shape[1:])
                header = {"descr": np.lib.format.dtype_to_descr(array.dtype), "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_2_0(member, header)
            member.write(np.ascontiguousarray(array).tobytes())

    def _track(self, part: Path) -> Track:
        with np.load(part, allow_pickle=False) as stored:
            return Track(meta=self.meta, **{name: stored[name] for name in ARRAYS})

    def _take(self, part: Path, frames: int) -> None:
        self._parts.append(part)
        self._firsts.append(self._count)
        self._count += frames

    def _part(self, number: int) -> Path:
        return self.parts_folder / f"{number:06d}.npz"

    def _keep_sound_parts(self) -> None:
        """Go on behind the last part that is whole, and remove everything else."""
        for part in map(self._part, count()):
            frames = _frames_of(part, self._count)
            if not frames:
                break
            self._take(part, frames)
        for path in self.parts_folder.iterdir():
            if path not in (*self._parts, self.parts_folder / FINGERPRINT):
                path.unlink()


def has_parts(path: Path, fingerprint: str) -> bool:
    """Whether an interrupted run with this fingerprint left something at a track's path."""
    stored = _parts_folder(path) / FINGERPRINT
    return stored.is_file() and stored.read_bytes() == fingerprint.encode()


def _parts_folder(path: Path) -> Path:
    return path.with_name(path.name + ".parts")


def _frames_of(part: Path, first: int) -> int:
    """How many frames a part holds, from frame `first` on; 0 for one that is missing or damaged."""
    try:
        # Opened here, because NumPy leaves a damaged archive open.
        with part.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}  # reading checks the sums of all
        whole = {len(arrays[name]) for name in ARRAYS} == {len(arrays["index"])}
        in_place = np.array_equal(arrays["index"], np.arange(first, first + len(arrays["index"])))
        return len(arrays["index"]) if whole and in_place else 0
    except Exception:  # damage shows in many ways, and each means: do it again
        return 0
