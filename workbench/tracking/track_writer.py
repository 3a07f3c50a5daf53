"""A track written while it grows: finished parts on disk, one file at the end, memory flat in its length."""

import io
import json
import shutil
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.tracking.records import ARRAYS, FrameFit, Track, meta_array, stack_fits

PART_FRAMES = 256


class TrackWriter:
    """Collects fits in parts of 256 frames under `<path>.parts/` and joins them to one .npz at the end.

    Each part is whole or absent and carries the tracker's state behind its last frame, so that an interrupted run
    goes on from there. `fingerprint` says what the run depends on; parts of another run are discarded.
    """

    def __init__(self, path: str | Path, meta: dict[str, Any], fingerprint: str, resume: bool = False):
        self.path = Path(path)
        self.parts_folder = self.path.with_name(self.path.name + ".parts")
        self.meta = meta
        self._buffer: list[FrameFit] = []
        self._count = 0
        self._open_part: tuple[int, Track | None] = (0, None)
        if resume and self._matches(fingerprint):
            self._count = sum(
                int(json.loads(path.with_suffix(".json").read_text())["frames"]) for path in self._parts()
            )
        else:
            shutil.rmtree(self.parts_folder, ignore_errors=True)
            self.parts_folder.mkdir(parents=True)
            (self.parts_folder / "fingerprint").write_text(fingerprint)

    def state(self) -> dict[str, np.ndarray]:
        """State stored with the newest part; empty if there is none."""
        parts = self._parts()
        if not parts:
            return {}
        with np.load(parts[-1], allow_pickle=False) as stored:
            prefix = "state/"
            return {name.removeprefix(prefix): stored[name] for name in stored.files if name.startswith(prefix)}

    def add(self, fit: FrameFit) -> None:
        """Take the next frame."""
        self._buffer.append(fit)

    def wants_part(self) -> bool:
        """Whether enough frames have come for another part."""
        return len(self._buffer) >= PART_FRAMES

    def write_part(self, state: dict[str, np.ndarray]) -> None:
        """Store the frames so far as a part, with the state that the next frame depends on."""
        if not self._buffer:
            return
        number = len(self._parts())
        part = self.parts_folder / f"{number:06d}.npz"
        with atomic_path(part.with_suffix(".json")) as temporary:
            temporary.write_text(json.dumps({"frames": len(self._buffer)}))
        with atomic_path(part) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(
                stream, **stack_fits(self._buffer), **{f"state/{name}": value for name, value in state.items()}
            )
        self._count += len(self._buffer)
        self._buffer = []

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, position: int) -> FrameFit:
        """A frame of a finished part; frames that follow each other read each part once."""
        if not 0 <= position < self._count:
            raise IndexError(position)
        first, track = self._open_part
        if track is None or not first <= position < first + len(track):
            first = 0
            for track in self.tracks():
                if position < first + len(track):
                    break
                first += len(track)
            self._open_part = (first, track)
        return track[position - first]

    @property
    def index(self) -> Int[np.ndarray, "n"]:
        """Frame indices of the finished parts: a run takes every frame of its input, from 0."""
        return np.arange(self._count)

    def tracks(self) -> Iterator[Track]:
        """Each finished part as a track of its own."""
        for part in self._parts():
            with np.load(part, allow_pickle=False) as stored:
                yield Track(meta=self.meta, **{name: stored[name] for name in ARRAYS})

    def close(self) -> None:
        """Join the parts to the track file and remove them. Raises `InputError` if there is no frame."""
        if not self._count:
            shutil.rmtree(self.parts_folder, ignore_errors=True)
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
        shutil.rmtree(self.parts_folder)

    def discard(self) -> None:
        """Remove everything that was written."""
        shutil.rmtree(self.parts_folder, ignore_errors=True)

    def _join(self, name: str, member: io.IOBase) -> None:
        # One array at a time and one part at a time: the header needs only the total length.
        for number, part in enumerate(self._parts()):
            with np.load(part, allow_pickle=False) as stored:
                array = stored[name]
            if number == 0:
                shape = (self._count, *array.shape[1:])
                header = {"descr": np.lib.format.dtype_to_descr(array.dtype), "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_2_0(member, header)
            member.write(np.ascontiguousarray(array).tobytes())

    def _parts(self) -> list[Path]:
        return sorted(self.parts_folder.glob("*.npz"))

    def _matches(self, fingerprint: str) -> bool:
        stored = self.parts_folder / "fingerprint"
        return stored.is_file() and stored.read_text() == fingerprint
