"""A judge of what readers make of damaged files.

A `Reader` has a small valid file (or folder) and a function that reads it and uses what was read; `fuzzing_damage`
damages the file. A `Judge` reads in a process of its own, so that a crash, endless work or an allocation beyond the
limit is a verdict like any other.
"""

import gc
import multiprocessing
import resource
import shutil
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from workbench.errors import WorkbenchError

LONGEST_S = 10.0
MOST_BYTES = 2 * 1024**3
LONGEST_MESSAGE = 600
LARGE_PACKAGES = ["jax", "equinox", "scipy.optimize", "scipy.sparse.linalg", "scipy.spatial.transform", "cv2"]

ACCEPTED, CLEAR = "accepted", "clear error"
UNCLEAR, LEAKED, GARBAGE = "unclear error", "leaked", "garbage"
CRASH, HANG, MEMORY = "crash", "hang", "memory"
GOOD = (ACCEPTED, CLEAR)
VERDICTS = (*GOOD, UNCLEAR, LEAKED, GARBAGE, CRASH, HANG, MEMORY)

Files = Mapping[str, bytes]
"""Contents by path below a folder."""


@dataclass(frozen=True)
class Reader:
    """One row of the table in `fuzz_readers`; `make` and `read` are functions of a module, so that they can be sent."""

    name: str
    make: Callable[[Path], None]
    """Writes a small valid file, or several, into an empty folder."""
    read: Callable[[Path], None]
    """Reads what lies in the folder and uses it; `AssertionError` where what was read makes no sense."""
    share: float = 1.0
    """Of the inputs, against other readers: less for a slow one."""

    def valid_files(self, folder: Path) -> dict[str, bytes]:
        """The contents of the valid files, made in a new folder."""
        folder.mkdir()
        self.make(folder)
        return {
            str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
        }


@dataclass(frozen=True)
class Verdict:
    """How a reader took an input."""

    kind: str
    said: str = ""
    """The error, or what else was seen."""

    @property
    def good(self) -> bool:
        """Whether a user is served well: the thing itself, or one sentence."""
        return self.kind in GOOD


class Judge:
    """Reads files in another process, which is replaced when it dies or hangs; used in a `with` block."""

    def __init__(self, folder: Path, longest_s: float = LONGEST_S) -> None:
        self._folder, self._longest_s = folder, longest_s
        self._process: multiprocessing.process.BaseProcess | None = None

    def __enter__(self) -> "Judge":
        return self

    def __exit__(self, *_) -> None:
        self._stop()

    def verdict(self, read: Callable[[Path], None], files: Files) -> Verdict:
        """What `read` makes of a folder with these files."""
        shutil.rmtree(self._folder, ignore_errors=True)
        for name, content in files.items():
            path = self._folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return self._judged(read)

    def warm_up(self, read: Callable[[Path], None], files: Files) -> None:
        """Read valid files without a limit in time: what is imported and compiled then is ready. Fails if refused."""
        longest, self._longest_s = self._longest_s, 300.0
        try:
            verdict = self.verdict(read, files)
        finally:
            self._longest_s = longest
        assert verdict.kind == ACCEPTED, f"the valid file of this reader is refused: {verdict}"

    def _judged(self, read: Callable[[Path], None]) -> Verdict:
        if self._process is None:
            self._start()
            # What the reader imports is no part of its time.
            self._connection.send((read, None))
            self._connection.recv()
        self._connection.send((read, self._folder))
        if not self._connection.poll(self._longest_s):
            self._stop()
            return Verdict(HANG, f"no answer in {self._longest_s:g} s")
        try:
            return self._connection.recv()
        except EOFError:
            process = self._process
            process.join()
            self._stop()
            return Verdict(CRASH, f"exit code {process.exitcode}")

    def _start(self) -> None:
        # A process that has imported the large packages stands ready to be forked when one dies. Not the workbench: it
        # starts the threads of JAX, and those are lost in a fork.
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(LARGE_PACKAGES)
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self._process.start()
        theirs.close()

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._connection.close()
            self._process = None


def _serve(connection) -> None:
    with suppress(EOFError):
        while True:
            read, folder = connection.recv()
            connection.send(_judged_here(read, folder) if folder else None)


def _judged_here(read: Callable[[Path], None], folder: Path) -> Verdict:
    _limit_memory()
    try:
        read(folder)
    except WorkbenchError as error:
        return _verdict_on(error)
    except AssertionError as error:
        return Verdict(GARBAGE, str(error).partition("\n")[0])
    except MemoryError as error:
        return Verdict(MEMORY, str(error))
    except Exception as error:
        return Verdict(LEAKED, f"{type(error).__name__}: {str(error)[:300]}")
    return Verdict(ACCEPTED)


def _verdict_on(error: WorkbenchError) -> Verdict:
    text = str(error)
    if _asked_for_too_much(error):
        return Verdict(MEMORY, text)
    if "\n" in text or not text or len(text) > LONGEST_MESSAGE:
        return Verdict(UNCLEAR, f"{len(text)} characters: {text[:300]!r}")
    return Verdict(CLEAR, text)


def _asked_for_too_much(error: BaseException | None) -> bool:
    """Whether a refusal came only after the limit of memory was met."""
    return error is not None and (
        isinstance(error, MemoryError)
        or "Insufficient memory" in str(error)
        or _asked_for_too_much(error.__cause__ or error.__context__)
    )


def _limit_memory() -> None:
    """Let this process have so much more than it has."""
    gc.collect(0)
    with suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + MOST_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, resource.RLIM_INFINITY))


class Tally:
    """Verdicts by reader, and inputs kept for a closer look."""

    def __init__(self, inputs: int) -> None:
        self.inputs = inputs
        """Over all readers."""
        self.counts: dict[str, Counter[str]] = {}

    def share_of(self, reader: Reader, readers: Sequence[Reader]) -> int:
        """How many inputs this reader gets."""
        return max(1, round(self.inputs * reader.share / sum(other.share for other in readers)))

    def add(self, reader: Reader, verdict: Verdict) -> None:
        """Count a verdict."""
        self.counts.setdefault(reader.name, Counter())[verdict.kind] += 1

    def table(self) -> str:
        """The counts as text."""
        rows = [(name, found.total(), *(found[kind] for kind in VERDICTS)) for name, found in self.counts.items()]
        rows.append(("all", *(sum(column) for column in list(zip(*rows, strict=True))[1:])))
        return "\n".join(_line(row) for row in (("reader", "tried", *VERDICTS), *rows))


def _line(row: Sequence[object]) -> str:
    return f"{row[0]:<28}" + "".join(f"{cell:>15}" for cell in row[1:])
