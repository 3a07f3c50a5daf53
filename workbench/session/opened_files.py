"""What files and folders held when a session opened them: others may be in their place when it saves."""

import threading
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from workbench.errors import InputError
from workbench.reading import content_hash

WAITED_S = 0.5
"""So long opening waits until what is opened is hashed: only large clips take longer."""


class OpenedFiles:
    """Where the existing ones of some files and folders are, and what they hold.

    They are read in a thread of their own, as large clips take seconds and are hardly ever saved at once.
    """

    def __init__(self, paths: Iterable[Path | None], known: Mapping[Path, str] | None = None) -> None:
        """`known`: SHA-256 (`content_hash`) of those that a track names."""
        known = known or {}
        self._places = {path: path.absolute() for path in paths if path is not None and path.exists()}
        self._hashes = {path: known[path] for path in self._places if known.get(path)}
        self._reader = threading.Thread(target=self._read, name="hashes of what was opened", daemon=True)
        if len(self._hashes) < len(self._places):
            self._reader.start()
            self._reader.join(WAITED_S)

    def record(self, path: Path | None) -> dict[str, str] | None:
        """What a track's metadata say of a file or folder (`track_layout.file_record`); None where it was not there."""
        if path not in self._places:
            return None
        if path not in self._hashes:
            self._reader.join()
        sha256 = self._hashes.get(path)
        return None if sha256 is None else {"path": str(self._places[path]), "sha256": sha256}

    def _read(self) -> None:
        for path, place in self._places.items():
            if path not in self._hashes:
                with suppress(InputError, OSError):  # what cannot be read, or has gone meanwhile, is left out
                    self._hashes[path] = content_hash(place)
