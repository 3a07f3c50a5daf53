"""The files that a run reads, watched for changes: they are opened by their paths more than once."""

import os
from collections.abc import Iterable
from pathlib import Path

from workbench.errors import InputError
from workbench.reading import content_hash


class WatchedFiles:
    """Files as they are when a run begins."""

    def __init__(self, files: Iterable[Path]) -> None:
        self._seen: dict[Path, tuple[tuple[int, int, int] | None, str]] = {}
        self.add(files)

    def add(self, files: Iterable[Path]) -> None:
        """Watch these too."""
        self._seen |= {path: (_state(path), content_hash(path)) for path in files}

    def check(self) -> None:
        """Raise `InputError` where a file holds something else by now.

        One that is gone counts as unchanged: what was read of it is what it held.
        """
        for path, (state, sha256) in self._seen.items():
            if _state(path) not in (None, state) and content_hash(path) != sha256:
                raise InputError(
                    f"{path} was changed while this run read it; once the file stays as it is, repeat the run with "
                    "--overwrite."
                )


def _state(path: Path) -> tuple[int, int, int] | None:
    """Size and times of a file; None for one that is gone."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns
