"""Where a sweep keeps its files: a folder, or a place that a URL names (a shared folder, an object store).

A file is whole or absent: it is written under another name and then renamed, and it begins with the hash of the rest,
so that one that was torn all the same is recognised and counts as absent.
"""

import hashlib
import json
import shutil
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from workbench.errors import InputError, OutputError
from workbench.extras import needs
from workbench.files import PARTIAL, atomic_path, writing
from workbench.reading import checked_arrays, reason_of
from workbench.runtime import cache_folder

_MARK = b"workbench sweep 1 "
_VERSIONS = {
    *("etag", "contentmd5", "digest", "sha", "generation"),
    *("mtime", "lastmodified", "last_modified", "modificationtime", "last_write_time", "updated", "created"),
}
"""What file systems of fsspec call the tag or the date of a file, in lower case without hyphens."""


def is_url(place: str) -> bool:
    """Whether a text names a place by URL rather than by path."""
    return "://" in place


def anywhere(place: str) -> str:
    """A place as it is named in any folder; URLs, and no place at all, as they are."""
    return place if not place or is_url(place) else str(Path(place).absolute())


@dataclass(frozen=True)
class Storage:
    """A folder by path or URL; made where it is missing."""

    place: str

    def read(self, name: str) -> bytes | None:
        """The content of a file that was written whole; None for one that is absent or torn.

        Raises `InputError` for a place that cannot be reached.
        """
        try:
            stored = (
                self._file_system().cat_file(self._path(name)) if is_url(self.place) else self._local(name).read_bytes()
            )
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{self.place} cannot be read ({reason_of(error)}); check the address.") from error
        head, content = stored[: len(_MARK) + 64], stored[len(_MARK) + 64 :]
        return content if head == _MARK + _digest(content) else None

    def write(self, name: str, content: bytes) -> None:
        """Write a file. Raises `OutputError` for a place that takes no more."""
        whole = _MARK + _digest(content) + content
        if not is_url(self.place):
            with atomic_path(self._local(name)) as temporary:
                temporary.write_bytes(whole)
            return
        system, path = self._file_system(), self._path(name)
        with writing(f"{self.place}/{name}"):
            system.makedirs(str(PurePosixPath(path).parent), exist_ok=True)
            temporary = f"{path}{PARTIAL}{uuid.uuid4().hex[:8]}"
            system.pipe_file(temporary, whole)
            system.mv(temporary, path)

    def remove(self, name: str) -> None:
        """Remove a file. Raises `OutputError` where that cannot be done."""
        with writing(f"{self.place}/{name}"):
            if is_url(self.place):
                self._file_system().rm_file(self._path(name))
            else:
                self._local(name).unlink()

    def holds(self, name: str) -> bool:
        """Whether a file of this name was written whole."""
        return self.read(name) is not None

    def _local(self, name: str) -> Path:
        return Path(self.place) / name

    def _file_system(self) -> Any:
        with needs("cluster"):
            import fsspec
        try:
            return fsspec.core.url_to_fs(self.place)[0]
        except (ImportError, ValueError) as error:
            raise OutputError(f"{self.place} cannot be opened ({reason_of(error)}); check the address.") from error

    def _path(self, name: str) -> str:
        import fsspec

        return f"{fsspec.core.url_to_fs(self.place)[1].rstrip('/')}/{name}"


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()


def local_file(place: str) -> Path:
    """A path for an input that a path or URL names; what a URL names is kept, and fetched again once it has changed.

    Without a mark of its version, as from a server that tells neither tag nor date, it is fetched at each call. Raises
    `InputError` for a URL that cannot be fetched.
    """
    if not is_url(place):
        return Path(place)
    with needs("cluster"):
        import fsspec
    folder = cache_folder() / "inputs" / hashlib.sha256(place.encode()).hexdigest()[:24]
    target = folder / PurePosixPath(place).name
    note = folder / f"{target.name}.version"
    try:
        system, path = fsspec.core.url_to_fs(place)
        system.invalidate_cache(path)  # an earlier listing does not know what has changed
        version = _version_of(system.info(path))
        known = note.read_text(encoding="utf-8") if note.exists() and target.exists() else ""
        if not version or version != known:
            with system.open(path, "rb") as source, atomic_path(target) as temporary, temporary.open("wb") as copy:
                shutil.copyfileobj(source, copy)
            with atomic_path(note) as temporary:
                temporary.write_text(version, encoding="utf-8")
    except (ImportError, ValueError) as error:
        raise InputError(f"{place} cannot be opened ({reason_of(error)}); check the address.") from error
    except OSError as error:
        if isinstance(error, OutputError):
            raise
        raise InputError(f"{place} cannot be fetched ({reason_of(error)}); check the address.") from error
    return target


def _version_of(info: Mapping[str, Any]) -> str:
    """What fsspec knows of a file that changes with its content; empty if nothing does."""
    marks = {name: str(value) for name, value in info.items() if name.lower().replace("-", "") in _VERSIONS and value}
    return json.dumps({**marks, "size": info.get("size")}, sort_keys=True) if marks else ""


def packed(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Arrays as the bytes of an .npz file; the same bytes for the same arrays."""
    stream = BytesIO()
    # NumPy dates every entry 1980, so that equal arrays make equal files.
    np.savez_compressed(stream, **{name: np.ascontiguousarray(array) for name, array in sorted(arrays.items())})
    return stream.getvalue()


def unpacked(content: bytes) -> dict[str, np.ndarray]:
    """The arrays of `packed`."""
    with checked_arrays(BytesIO(content)) as stored:
        return {name: stored[name] for name in stored.files}
