"""A track written as it grows: finished parts on disk, one file at the end, memory independent of its length."""

import io
import json
import shutil
import time
import zipfile
from bisect import bisect_right
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from workbench.errors import InputError
from workbench.files import atomic_path, make_folder
from workbench.tracking.records import ARRAYS, FrameFit, Track, meta_array, stack_fits

UNREFINED = "unrefined.npz"
"""The fits of single frames of a run with infill or refinement, beside its track."""
PARTS_SUFFIX = ".parts"
"""Behind a track's name: the folder of its parts, while it grows."""
FINGERPRINT = "fingerprint"
"""Beside the parts: what identifies their run, in the first line, and its metadata."""
PART_FRAMES = 256
PART_SECONDS = 10.0
"""A killed run loses at most this much work, or at most `PART_FRAMES` frames."""


class TrackWriter:
    """Collects fits in parts under `<path>.parts/` and joins them to one .npz at the end.

    Each part is one file with checksums, either complete or absent. (In one growing HDF5 file, truncation or a flipped
    bit could lose all frames or go unnoticed.) It also stores the tracker's state after its last frame, so that an
    interrupted run can continue from there. `fingerprint` identifies what the run depends on; parts of other runs are
    discarded, and so are damaged parts with all that follow. `check` is called before each part is written, and what
    it raises keeps the part from being so. Raises `OutputError` if a file cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        meta: dict[str, Any],
        fingerprint: str,
        resume: bool = False,
        check: Callable[[], None] = lambda: None,
    ):
        self.path, self._check = Path(path), check
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
            temporary.write_text(f"{fingerprint}\n{json.dumps(meta)}", encoding="utf-8")

    def state(self) -> dict[str, np.ndarray]:
        """State stored with the latest part; empty if there is none."""
        if not self._parts:
            return {}
        with np.load(self._parts[-1], allow_pickle=False) as stored:
            prefix = "state/"
            return {name.removeprefix(prefix): stored[name] for name in stored.files if name.startswith(prefix)}

    def add(self, fit: FrameFit) -> None:
        """Add the next frame."""
        self._buffer.append(fit)

    def wants_part(self) -> bool:
        """Whether enough frames or enough time have accumulated for another part."""
        waited = time.monotonic() - self._stored_at > PART_SECONDS
        return len(self._buffer) >= PART_FRAMES or (waited and len(self._buffer) > 0)

    def write_part(self, state: dict[str, np.ndarray]) -> None:
        """Store the frames so far as a part, with the state that the next frame depends on."""
        if not self._buffer:
            return
        self._check()
        part = self._part(len(self._parts))
        with atomic_path(part) as temporary, temporary.open("wb") as stream:
            # Compressed only in the track itself, once.
            np.savez(stream, **stack_fits(self._buffer), **{f"state/{name}": value for name, value in state.items()})
        self._take(part, len(self._buffer))
        self._buffer, self._stored_at = [], time.monotonic()

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, position: int) -> FrameFit:
        """A frame of a finished part; for consecutive frames each part is read once."""
        if not 0 <= position < self._count:
            raise IndexError(position)
        number = bisect_right(self._firsts, position) - 1
        if self._open_part[0] != number:
            self._open_part = (number, self._track(self._parts[number]))
        return self._open_part[1][position - self._firsts[number]]

    @property
    def index(self) -> Int[np.ndarray, "n"]:
        """Frame indices of the finished parts: a run has every frame of its input, from 0."""
        return np.arange(self._count)

    def tracks(self) -> Iterator[Track]:
        """Each finished part as a separate track."""
        return map(self._track, self._parts)

    def close(self) -> None:
        """Join the parts into the track file and remove them. Raises `InputError` if there are no frames."""
        if not self._count:
            self.discard()
            raise InputError("There was no frame to track; check that the input contains pictures.")
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
        # Arrays and parts are read one at a time: the header needs only the total length.
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
        """Continue after the last intact part, and remove everything beyond it."""
        for part in map(self._part, count()):
            frames = _frames_of(part, self._count)
            if not frames:
                break
            self._take(part, frames)
        for path in self.parts_folder.iterdir():
            if path not in (*self._parts, self.parts_folder / FINGERPRINT):
                path.unlink()


def has_parts(path: Path, fingerprint: str) -> bool:
    """Whether an interrupted run with this fingerprint left parts at a track's path."""
    begun = begun_run(path)
    return begun is not None and begun[0] == fingerprint


def begun_run(path: Path) -> tuple[str, dict[str, Any]] | None:
    """Fingerprint and metadata of the interrupted run that left parts at a track's path; None where none did.

    Without the metadata of a run, as in parts of an older workbench, these are empty.
    """
    stored = _parts_folder(path) / FINGERPRINT
    if not stored.is_file():
        return None
    fingerprint, _, text = stored.read_text(encoding="utf-8", errors="replace").partition("\n")
    with suppress(ValueError):
        meta = json.loads(text)
        if isinstance(meta, dict) and {"config", "detector"} <= meta.keys():
            return fingerprint, meta
    return fingerprint, {}


def _parts_folder(path: Path) -> Path:
    return path.with_name(path.name + PARTS_SUFFIX)


def _frames_of(part: Path, first: int) -> int:
    """The number of frames in a part that starts at frame `first`; 0 if it is missing or damaged."""
    try:
        # Opened here, because NumPy leaves a damaged archive open.
        with part.open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}  # reading verifies all checksums
        whole = {len(arrays[name]) for name in ARRAYS} == {len(arrays["index"])}
        in_place = np.array_equal(arrays["index"], np.arange(first, first + len(arrays["index"])))
        return len(arrays["index"]) if whole and in_place else 0
    except Exception:  # damage can raise many errors; in each case the part is redone
        return 0
