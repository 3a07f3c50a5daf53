"""JAX's cache of compiled programs: what is wrong with it is said in one line, and what is damaged is made again."""

import re
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import TextIO

_BEGINNING = "Error (?P<doing>reading|writing) persistent compilation cache entry for '"
_COMPLAINT = re.compile(
    rf"{_BEGINNING}(?P<program>.*?)': \w+: (?P<system>\[\w+ \d+\] )?"
    r"(?P<reason>[^\n]*?)(?:: '[^\n]*)?(?:\n.*)?\Z",
    re.DOTALL,
)
"""What JAX warns of at each program that it cannot take from its cache or put there; the file has the program's name
and a hash."""


class CacheComplaints:
    """Stands for `warnings.showwarning`: of JAX's warnings about its cache it makes one line a process.

    JAX never replaces an entry, also one that it cannot read or that was cut off on a full disk. From the workbench's
    own folder such entries are removed, so that they are written anew; a folder that the user has set is left alone.
    """

    def __init__(self, jax: ModuleType, own: Path, usual: Callable[..., None]) -> None:
        """`own`: the workbench's folder; `usual`: what shows all other warnings."""
        self._jax, self._own, self._usual = jax, own, usual
        self._lock = threading.Lock()
        self._began = time.time()
        self._said = False
        self._removed: set[str] = set()

    def __call__(
        self,
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        complaint = _COMPLAINT.match(str(message))
        if complaint is None:
            self._usual(message, category, filename, lineno, file, line)
            return
        folder = self._jax.config.jax_compilation_cache_dir
        own = folder == str(self._own)
        with self._lock, suppress(OSError):
            if own:
                self._remove(complaint["program"], complaint["doing"] == "writing")
            if not self._said:
                self._said = True
                print(_sentence(complaint, folder, own), file=file or sys.stderr)

    def _remove(self, program: str, written: bool) -> None:
        """Remove the entries of a name that this process has written, or once all that were there before."""
        if not written and program in self._removed:
            return
        named = re.compile(re.escape(program) + "-[0-9a-f]+-cache")
        with suppress(OSError):
            for entry in self._own.iterdir():
                if named.fullmatch(entry.name) and (not written or entry.stat().st_mtime >= self._began):
                    entry.unlink(missing_ok=True)
        if not written:
            self._removed.add(program)


def _sentence(complaint: re.Match[str], folder: str, own: bool) -> str:
    if complaint["doing"] == "reading" and complaint["system"] is None:
        then = "are compiled again" if own else "are compiled again at every start; empty that folder"
        return f"Some compiled programs in {folder} are damaged ({complaint['reason']}) and {then}."
    variable = "WORKBENCH_CACHE" if own else "JAX_COMPILATION_CACHE_DIR"
    return (
        f"The folder of compiled programs, {folder}, cannot be used ({complaint['reason']}), so that every start "
        f"compiles them again; see that it can be written to and has room, or name another by {variable}."
    )


def watch_cache(jax: ModuleType, own: Path) -> None:
    """Let JAX's complaints about its cache be one line; `own` is the workbench's folder."""
    if not isinstance(warnings.showwarning, CacheComplaints):
        warnings.showwarning = CacheComplaints(jax, own, warnings.showwarning)
        # Each of them, though Python shows a text once: programs share names. Filters of the user's go before.
        warnings.filterwarnings("always", _BEGINNING, append=True)
