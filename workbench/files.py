"""Files that are either whole or absent: written under a temporary name, then renamed.

All that the workbench writes goes through here: what the system refuses becomes an `OutputError`, one sentence with the
path and what to do.
"""

import errno
import os
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from workbench.errors import OutputError, WorkbenchError
from workbench.reading import reason_of, shortened

PARTIAL = ".partial-"
"""In the names of temporary files, so that what a killed program left can be recognised."""
_LONGEST_STEM = 40
_LEFT_BEHIND = re.compile(rf"\.(.+){re.escape(PARTIAL)}[a-z0-9_]{{8}}(\.\w+)?")

_REMEDIES = {
    errno.ENOSPC: "free some space and repeat",
    errno.EDQUOT: "free some space and repeat",
    errno.EFBIG: "the system allows no larger file there; name another place",
    errno.EROFS: "name a place that can be written to",
    errno.EACCES: "name a place that can be written to",
    errno.EPERM: "name a place that can be written to",
    errno.ENAMETOOLONG: "name a shorter one",
    errno.ENOTDIR: "a file is in the way; name another folder",
    errno.EEXIST: "a file is in the way; name another folder",
    errno.EISDIR: "a folder is in the way; name another file",
}
_CUT_SHORT = re.compile(r"\d+ requested and \d+ written")
"""What NumPy says of an array that found no room; such an error has no number."""


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` (same suffix); rename it to `path` on success, delete it on any error.

    A symbolic link stays, and what it points to is written. Raises `OutputError` for what cannot be written, also where
    a write inside the block fails.
    """
    target = Path(path)
    check_target(target)
    make_folder(target.parent)
    with writing(target):
        place = _pointed_to(target)
        handle, name = tempfile.mkstemp(dir=place.parent, prefix=_partial_prefix(place), suffix=target.suffix)
        os.close(handle)
    temporary = Path(name)
    try:
        with writing_inside(target, temporary):
            yield temporary
        with writing(target):
            # mkstemp makes private files; the result gets the permissions of any newly created file.
            umask = os.umask(0)
            os.umask(umask)
            temporary.chmod(0o666 & ~umask)
            temporary.replace(place)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Turn what the system refuses inside into an `OutputError`: "PATH cannot be written (reason); what to do." """
    try:
        yield
    except WorkbenchError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a name with NUL
        raise _refused(path, error) from error


@contextmanager
def writing_inside(target: Path, temporary: Path) -> Iterator[None]:
    """As `writing`, for a block that fills the `temporary` file or folder and may read others: their errors pass."""
    try:
        yield
    except WorkbenchError:
        raise
    except OSError as error:
        if error.filename is not None and not _is_inside(error.filename, temporary):
            raise
        raise _refused(target, error) from error


def _is_inside(name: str | bytes, folder: Path) -> bool:
    return Path(os.fsdecode(name)).absolute().is_relative_to(folder.absolute())


def make_folder(path: str | Path) -> Path:
    """Make a folder with those above it, unless it is there. Raises `OutputError` where that cannot be."""
    with writing(path):
        Path(path).mkdir(parents=True, exist_ok=True)
    return Path(path)


class NewFiles:
    """What a job writes where nothing was before; a job that fails takes it away again."""

    def __init__(self, folder: Path | None = None) -> None:
        """`folder`: what may be made for them, and goes with them if nothing else has come into it."""
        self._folder = None if folder is None or folder.exists() else folder
        self._paths: set[Path] = set()

    def expect(self, path: Path) -> None:
        """A file is about to be written there; one that is there already stays, whatever happens."""
        if not path.exists():
            self._paths.add(path)

    def discard(self) -> None:
        """Remove them."""
        for path in self._paths:
            path.unlink(missing_ok=True)
        if self._folder is not None:
            with suppress(OSError):  # not empty, or never made
                self._folder.rmdir()


def check_target(path: str | Path) -> None:
    """Raise `OutputError` where no file can be written under this name: a folder, a device, a link to nothing."""
    with writing(path):
        try:
            status = os.stat(path)
        except FileNotFoundError:
            if os.path.islink(path):
                raise OutputError(f"{path} is a link to nothing; remove it or name another file.") from None
            return
    if stat.S_ISDIR(status.st_mode):
        raise OutputError(f"{path} is a folder and cannot be written as a file; name another file.")
    if not stat.S_ISREG(status.st_mode):
        raise OutputError(f"{path} is a pipe or device and cannot be written as a file; name another file.")


def check_writable(path: str | Path) -> None:
    """Raise `OutputError` as `check_target`, and where its folder, or the nearest that exists above, takes no files.

    A temporary file is made there and removed; no folder is made.
    """
    check_target(path)
    with writing(path):
        place = _pointed_to(Path(path))
        folder = next(filter(os.path.lexists, place.parents), place.parent)
        with tempfile.TemporaryFile(dir=folder, prefix=_partial_prefix(place)):
            pass


def _pointed_to(path: Path) -> Path:
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def _partial_prefix(path: Path) -> str:
    return f".{path.stem[:_LONGEST_STEM]}{PARTIAL}"


def check_new(path: Path, remedy: str = "name another (--out), or add --overwrite") -> None:
    """Raise `OutputError` where something is there already; `remedy` is what to do then."""
    if os.path.exists(path):
        raise OutputError(f"{shortened(path)} exists already; {remedy}.")


def check_not_inputs(outputs: Iterable[Path], inputs: Iterable[Path], what: str = "an input") -> None:
    """Raise `OutputError` where a file or folder to be written is one that is read, also through links.

    Of a folder that is read, its files count too, but no folders inside it: these are not read. `what` names the kind
    of what would be lost.
    """
    read = {_place(file): file for path in inputs for file in _with_files(path)}
    for path in outputs:
        if (place := _place(path)) is not None and place in read:
            same = "" if read[place] == path else f" ({shortened(read[place])})"
            raise OutputError(f"{shortened(path)} is {what}{same} and would be overwritten; name another output.")


def _with_files(path: Path) -> Iterator[Path]:
    yield path
    if os.path.isdir(path):
        yield from filter(os.path.isfile, path.iterdir())


def _place(path: Path) -> tuple[int, int] | None:
    """What names of one file have in common; None where nothing is there."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


def remove_partial_files(folder: Path, names: Collection[str] = (), older_than_s: float = 0.0) -> None:
    """Remove the temporary files and folders that a killed program left in a folder: of these names, or of all.

    `older_than_s`: only what has not been written to for so many seconds, where another program may be at work.
    """
    stems = {Path(name).stem[:_LONGEST_STEM] for name in names}
    for path in folder.iterdir() if folder.is_dir() else ():
        left = _LEFT_BEHIND.fullmatch(path.name)
        if left and (not stems or left[1] in stems) and _untouched_s(path) >= older_than_s:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


def _untouched_s(path: Path) -> float:
    """How long ago a file or folder was written to; 0 where it is gone meanwhile."""
    try:
        return max(0.0, time.time() - path.stat().st_mtime)
    except FileNotFoundError:
        return 0.0


def _refused(path: str | Path, error: OSError | ValueError) -> OutputError:
    remedy = _REMEDIES.get(getattr(error, "errno", None) or 0, "name another place")
    if _CUT_SHORT.search(str(error)):
        remedy = "free some space and repeat, or name another place"
    return OutputError(f"{shortened(path)} cannot be written ({reason_of(error)}); {remedy}.")
