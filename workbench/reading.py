"""The door of every reader: a file from outside becomes checked data, or one sentence that says what is wrong with it.

A reader follows bytes that somebody else wrote, so anything may go wrong on the way. Three things happen here, once for
all formats: what is no regular file is refused before it is opened (`checked_file`); sizes, depths and numbers that a
file declares are compared with its own size and the limits below before anything is allocated (`checked_json`,
`checked_toml`, `checked_arrays`); and whatever a library still raises becomes the project's error (`reading`).
"""

import hashlib
import json
import math
import os
import re
import stat
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from io import BufferedIOBase
from pathlib import Path
from typing import IO, Any

import numpy as np

from workbench.errors import InputError, WorkbenchError

MOST_PIXELS = 100_000_000
"""Pixels of one picture."""
MOST_UNPACKED_BYTES = 2 * 1024**3
"""Bytes of all arrays of a face model or track, unpacked."""
MOST_NESTED = 100
"""Depth of lists and tables in JSON and TOML."""
MOST_DIGITS = 20
"""Digits of a whole number: more than any index, count or coordinate has."""
LONGEST_REASON = 160

Kind = type[WorkbenchError]
# Every text matches up to its end, also one that is never closed: a failed match would be tried again at each quote.
_JSON_TOKENS = re.compile(r'"(?:[^"\\]|\\.?)*"?|(?P<opening>[\[{])|(?P<closing>[\]}])', re.DOTALL)
_TOML_TOKENS = re.compile(
    r'"""(?:[^\\]|\\.?)*?(?:"""|\Z)' + r"|'{3}.*?(?:'{3}|\Z)" + r'|"(?:[^"\\\n]|\\.?)*"?|' + r"'[^'\n]*'?|#[^\n]*"
    r"|(?P<opening>[\[{])|(?P<closing>[\]}])|(?P<digits>(?<![\w.])\d[\d_]{20,}(?![\w.]))",
    re.DOTALL,
)
_TOML_LONG_KEY = re.compile(rf"(?<![\w-])(?:[\w-]+\s*\.\s*){{{MOST_NESTED}}}")


@contextmanager
def reading(path: str | Path, kind: str, remedy: str, error: Kind = InputError) -> Iterator[None]:
    """Turn whatever goes wrong inside into `error`: "PATH cannot be read as KIND (reason); REMEDY."

    The project's own errors pass: they say more. Interruptions pass too.
    """
    try:
        yield
    except WorkbenchError:
        raise
    except MemoryError as cause:
        raise error(f"{path} cannot be read as {kind} (it asks for more memory than there is); {remedy}.") from cause
    except Exception as cause:
        raise error(f"{path} cannot be read as {kind} ({reason_of(cause)}); {remedy}.") from cause


def reason_of(cause: BaseException) -> str:
    """The first line of an exception's text, shortened; its kind where it has none."""
    text = (cause.strerror if isinstance(cause, OSError) else None) or str(cause)
    line = next((line.strip() for line in text.splitlines() if line.strip()), type(cause).__name__)
    return line if len(line) <= LONGEST_REASON else f"{line[:LONGEST_REASON]} …"


def checked_file(
    path: str | Path, kind: str, error: Kind = InputError, absent: str = "", may_be_empty: bool = False
) -> Path:
    """The path of a regular file with something in it. Raises `error` for anything else, without opening it.

    A pipe would wait for ever, and a device may be endless. `absent` is the sentence for a file that does not exist.
    """
    path = Path(path)
    try:
        status = os.stat(path)
    except FileNotFoundError:
        raise error(absent or f"{path} does not exist; check the name and the folder.") from None
    except (OSError, ValueError) as cause:
        raise error(f"{shortened(path)} cannot be opened ({reason_of(cause)}); check the name.") from cause
    if stat.S_ISDIR(status.st_mode):
        raise error(f"{path} is a folder, expected {kind}; name a file.")
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{path} is a pipe or device, expected {kind}; name a regular file.")
    if status.st_size == 0 and not may_be_empty:
        raise error(f"{path} is empty (0 bytes), expected {kind}; copy or download it again.")
    return path


def checked_content(path: str | Path, kind: str, error: Kind = InputError) -> bytes:
    """The bytes of a regular file of at most `MOST_UNPACKED_BYTES`. Raises `error` for anything else."""
    path = checked_file(path, kind, error)
    size = path.stat().st_size
    if size > MOST_UNPACKED_BYTES:
        raise error(
            f"{path} has {size / 1e9:.1f} GB, the limit for {kind} is {MOST_UNPACKED_BYTES / 1e9:.1f} GB; "
            "supply the file as it was published."
        )
    with reading(path, kind, "check that you may read it", error):
        return path.read_bytes()


def natural_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Order by the numbers inside a name: frame2 before frame10; equal numbers (2, 02) by the plain name."""
    parts = re.split(r"([0-9]+)", path.name.casefold())
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts], path.name


def shortened(value: object, longest: int = LONGEST_REASON) -> str:
    """A value for a message: printable, and not longer than a line."""
    text = str(value)
    text = text if text.isprintable() else ascii(text)
    return text if len(text) <= longest else f"{text[:longest]} …"


def checked_json(text: str | bytes) -> Any:
    """The value of a JSON text. Raises ValueError for damage and for what is beyond the limits."""
    text = text.decode("utf-8-sig") if isinstance(text, bytes) else text
    _check_depth(_JSON_TOKENS, text)
    return json.loads(text, parse_int=_whole_number)


def checked_toml(text: str | bytes) -> dict[str, Any]:
    """The tables of a TOML text. Raises ValueError for damage and for what is beyond the limits."""
    text = text.decode("utf-8-sig") if isinstance(text, bytes) else text
    _check_depth(_TOML_TOKENS, text)
    if _TOML_LONG_KEY.search(text):
        raise ValueError(f"a key has more than {MOST_NESTED} parts")
    return tomllib.loads(text)


def toml_tables(path: Path, error: Kind = InputError) -> dict[str, Any]:
    """The tables of a TOML file. Raises `error` with the line where it is damaged."""
    try:
        return checked_toml(path.read_bytes())
    except ValueError as cause:
        raise error(f"{path} is not valid TOML: {reason_of(cause)}.") from cause


def _check_depth(tokens: re.Pattern[str], text: str) -> None:
    depth = 0
    for token in tokens.finditer(text):
        if token.lastgroup == "digits":
            raise ValueError(f"a number has more than {MOST_DIGITS} digits")
        depth += {"opening": 1, "closing": -1}.get(token.lastgroup or "", 0)
        if depth > MOST_NESTED:
            raise ValueError(f"its entries are nested more than {MOST_NESTED} deep")


def _whole_number(digits: str) -> int:
    if len(digits.lstrip("-")) > MOST_DIGITS:
        raise ValueError(f"a number has more than {MOST_DIGITS} digits")
    return int(digits)


@contextmanager
def checked_arrays(stream: BufferedIOBase, most_bytes: int = MOST_UNPACKED_BYTES) -> Iterator[np.lib.npyio.NpzFile]:
    """The arrays of an .npz, each read when asked for, after every declared size was checked.

    Raises ValueError (or what `zipfile` raises) where an array's header asks for more than its member holds, all
    together unpack to more than `most_bytes`, or an array holds Python objects.
    """
    with zipfile.ZipFile(stream) as archive:
        for member in checked_members(archive, most_bytes):
            with archive.open(member) as content:
                _check_header(member.filename, content, member.file_size)
    stream.seek(0)
    with np.load(stream, allow_pickle=False) as stored:
        yield stored


def checked_members(archive: zipfile.ZipFile, most_bytes: int = MOST_UNPACKED_BYTES) -> list[zipfile.ZipInfo]:
    """What an archive holds. Raises ValueError where all together unpack to more than `most_bytes`."""
    members = archive.infolist()
    total = sum(member.file_size for member in members)
    if total > most_bytes:
        raise ValueError(f"its arrays unpack to {total / 1e9:.1f} GB, the limit is {most_bytes / 1e9:.1f} GB")
    return members


def _check_header(name: str, content: IO[bytes], size: int) -> None:
    shape, dtype = array_header(content)
    if dtype.hasobject:
        raise ValueError(f"{name} holds Python objects")
    check_numbers_held(name, shape, dtype, size)


def check_numbers_held(name: str, shape: tuple[int, ...], dtype: np.dtype, size: int) -> None:
    """Raise ValueError where an array of this shape and type has more numbers than `size` bytes hold."""
    count = math.prod(shape)
    # Items of zero bytes fit into any file, but take memory once they are converted.
    if count * max(dtype.itemsize, 1) > size:
        raise ValueError(f"{name} declares {count} numbers and holds {size} bytes")


def array_header(content: IO[bytes] | BufferedIOBase, by_rows: bool = False) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type that an .npy stream declares; the stream is then at its data.

    Raises ValueError for damage and, if asked for an array `by_rows`, for one that is stored by columns.
    """
    version = np.lib.format.read_magic(content)
    readers: dict[tuple[int, int], Callable[..., Any]] = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    if version not in readers:
        raise ValueError(f"it holds an array of the unknown layout {version}")
    shape, by_columns, dtype = readers[version](content)
    if by_rows and by_columns and len(shape) > 1:
        raise ValueError("it holds an array that is stored by columns")
    if any(not isinstance(length, int) or length < 0 for length in shape):
        raise ValueError(f"it holds an array of the shape {shape}")
    return shape, dtype


def content_hash(path: Path) -> str:
    """SHA-256 of a file, or of the files of a folder in order. Raises `InputError` for one that may not be read.

    Of a folder without what file managers leave in it. An unchanged file is read once in a process: clips are large.
    """
    digest = hashlib.sha256()
    files = sorted(file for file in path.iterdir() if not _left_behind(file.name)) if path.is_dir() else [path]
    for file in files:
        if file.is_file():
            with reading(file, "an input", "check that you may read it"):
                state = file.stat()
                digest.update(_file_digest(file.absolute(), state.st_size, state.st_mtime_ns, state.st_ctime_ns))
    return digest.hexdigest()


def _left_behind(name: str) -> bool:
    return name.startswith(".") or name.casefold() in ("thumbs.db", "desktop.ini")


@lru_cache(maxsize=1 << 14)
def _file_digest(path: Path, _size: int, _mtime_ns: int, _ctime_ns: int) -> bytes:
    """SHA-256 of a file in this state. Its times are two because a copy may bring that of its content along."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").digest()


def is_as_hashed(path: Path, sha256: str) -> bool:
    """Whether a file or folder holds what was hashed (`content_hash`), or nobody knows what that was."""
    return not sha256 or content_hash(path) == sha256


def place_now(named: str, sha256: str) -> Path:
    """Where a file or folder is that a track names: there, or under the current folder, where the end of its path is.

    So a folder that was moved or copied, with clips and runs in it, can still be worked in.
    """
    path, brought = Path(named), brought_along(named, sha256)
    return path if not brought or (os.path.exists(path) and is_as_hashed(path, sha256)) else brought[0]


def brought_along(named: str, sha256: str) -> list[Path]:
    """What is under the current folder where the end of a path is, and holds the same as what a track names by it."""
    path = Path(named)
    ends = [Path(*path.parts[first:]) for first in range(1, len(path.parts))]
    there = [end for end in ends if os.path.exists(end) and not (os.path.exists(path) and end.samefile(path))]
    return [end for end in there if is_as_hashed(end, sha256)]
