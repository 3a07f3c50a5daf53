"""The folder of a run: what it holds afterwards, who is writing to it now, and that nothing in it is lost."""

import errno
import os
import re
import socket
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import IO

from workbench.errors import OutputError
from workbench.files import check_not_inputs, check_target, make_folder, remove_partial_files, writing
from workbench.tracking.track_writer import FINGERPRINT, PARTS_SUFFIX, UNREFINED

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None
    import msvcrt

OUTPUTS = {
    "track.npz": "everything, for the notebooks (`workbench.Track.load`)",
    "summary.json": "errors, times, camera",
    "parameters.csv": "one row per frame: pose, every weight, errors",
    "landmarks.csv": "one row per frame: the detected points",
    "config.toml": "the configuration used",
    "overlay.mp4": "the landmarks on the picture, the 3D face beside it (overlay/ with pictures for stills)",
}
DEEP_OUTPUTS = {"stages": "what each stage made of some frames, and of those that failed"}
"""What a Deep Energies run writes in addition."""
TIME_OUTPUTS = {UNREFINED: "the fits of single frames, before infill and refinement"}
"""What a run with infill or refinement writes in addition."""
LOCK = "run.lock"
FILES = (*OUTPUTS, *TIME_OUTPUTS, "overlay.png")
PICTURE_FOLDERS = ("overlay", *DEEP_OUTPUTS)
DRAWN = re.compile(r"\d{4,}[-.]")
"""How the names of pictures begin that a run draws: with the frame's number."""
TRACKS = ("track.npz", UNREFINED)
"""Tracks that a run writes, each in parts."""
PARTS = tuple(f"{name}{PARTS_SUFFIX}" for name in TRACKS)
LOCKED_BYTE = 4096
"""Windows locks single bytes, which then cannot be read: one behind the owner's name."""


@contextmanager
def run_folder(
    folder: Path, inputs: Iterable[Path], resume: bool, overwrite: bool, resumable: bool = True
) -> Iterator[None]:
    """Make a folder and keep it for one run; what killed runs left half written in it is removed.

    Raises `OutputError`, before anything is written, where an output is one of the `inputs`, where another run is at
    work, and where results would be replaced without `overwrite` or `resume`; of `resume` it speaks to a `resumable`
    run alone. A folder that stays empty is removed.
    """
    check_inputs_kept(folder, inputs)
    for name in FILES:
        check_target(folder / name)
    with locked(folder):
        _check_free(folder, resume, overwrite, resumable)
        remove_partial_files(folder, FILES)
        for name in PICTURE_FOLDERS:
            remove_partial_files(folder / name)
        yield


def check_inputs_kept(folder: Path, inputs: Iterable[Path]) -> None:
    """Raise `OutputError` if a run into this folder would overwrite one of these files or folders."""
    # os.path answers about any name, also about one that cannot be.
    subfolders = [folder / name for name in PICTURE_FOLDERS if os.path.isdir(folder / name)]
    drawn = [path for subfolder in subfolders for path in subfolder.iterdir()]
    check_not_inputs([folder, *(folder / name for name in FILES), *drawn], inputs)


def check_results_kept(track: Path, outputs: Iterable[Path]) -> None:
    """Raise `OutputError` if one of these files would replace a result of the run that wrote this track beside it."""
    if track.name in TRACKS:
        check_not_inputs(outputs, [track.with_name(name) for name in FILES], "a result of the run")


def check_no_results(folder: Path, names: Iterable[str], what: str, remedy: str = "--overwrite") -> None:
    """Raise `OutputError` where one of these files is in a folder already: `what` is, and `remedy` would replace it."""
    if any((folder / name).exists() for name in names):
        raise OutputError(f"{folder} already holds {what}; name another folder, or replace it with {remedy}.")


def drawn_in(folder: Path) -> list[Path]:
    """The pictures of frames that a run drew."""
    return [
        path for name in PICTURE_FOLDERS for path in sorted((folder / name).glob("*.jpg")) if DRAWN.match(path.name)
    ]


def remove_earlier(folder: Path, made: Iterable[Path]) -> None:
    """Remove what an earlier run left in a folder, but for the files that a run `made`; others of the user's stay."""
    drawn = drawn_in(folder)
    for path in {*map(folder.joinpath, FILES), *drawn} - set(made):
        with writing(path):
            path.unlink(missing_ok=True)
    for subfolder in {path.parent for path in drawn}:
        with suppress(OSError):  # not empty
            subfolder.rmdir()


def _holds_parts(folder: Path) -> bool:
    """Whether an interrupted run left parts in a folder."""
    return any((folder / name).is_dir() for name in PARTS)


def keeps_frames(folder: Path) -> bool:
    """Whether an interrupted run left frames in a folder that `resume` continues after."""
    return any(path.name != FINGERPRINT for name in PARTS for path in (folder / name).glob("[!.]*"))


def _check_free(folder: Path, resume: bool, overwrite: bool, resumable: bool) -> None:
    there = [name for name in FILES if (folder / name).exists()]
    begun = _holds_parts(folder)
    if overwrite or (resume and (begun or "track.npz" in there)) or not (there or begun):
        return
    if begun and resumable:
        raise OutputError(
            f"{folder} holds an interrupted run; continue it with --resume, or replace it with --overwrite."
        )
    check_no_results(folder, PARTS, "an interrupted run")
    check_no_results(folder, there, "a finished run" if "track.npz" in there else f"a file {there[0]}")


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder, which is made for it, against other runs and trainings.

    The system lets go of the lock when a process ends, however it ends: a lock file that was left says nothing.
    """
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    make_folder(folder)
    stream = _lock(folder / LOCK)
    try:
        yield
    finally:
        _unlock(folder / LOCK, stream)
        with suppress(OSError):  # not empty
            for path in made:
                path.rmdir()


def _lock(path: Path) -> IO[str]:
    while True:
        with writing(path):
            stream = path.open("a+", encoding="utf-8")
        if not _taken(stream):
            stream.seek(0)
            owner = stream.read(LOCKED_BYTE).strip()
            stream.close()
            raise OutputError(f"Another run writes into {path.parent} ({owner}); wait for it or name another folder.")
        if path.exists() and os.path.samestat(os.fstat(stream.fileno()), path.stat()):
            break
        stream.close()  # the run that held it removed it in between
    owner = f"process {os.getpid()} on {socket.gethostname()} since {datetime.now():%Y-%m-%d %H:%M}\n"
    with suppress(OSError):  # a full disk: the lock holds without a name
        os.truncate(stream.fileno(), 0)
        os.write(stream.fileno(), owner.encode())
    return stream


def _taken(stream: IO[str]) -> bool:
    """Take the lock of an open file; False where another process or thread has it."""
    try:
        if fcntl is None:
            stream.seek(LOCKED_BYTE)
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # Some network folders know no locks: a run in one of them has to do without.
        return error.errno not in (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
    return True


def _unlock(path: Path, stream: IO[str]) -> None:
    if fcntl is None:
        stream.close()  # Windows removes no open file
    with suppress(OSError):
        path.unlink()  # while it is held: afterwards it might be another run's
    stream.close()
