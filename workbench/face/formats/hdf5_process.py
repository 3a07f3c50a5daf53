"""Reads arrays of an HDF5 file in a process of its own, which may end or be ended without harm.

`python hdf5_process.py MOST_BYTES SECONDS FILE KEY …` writes an .npz to the standard output, or a reason to the
standard error with the exit code `REFUSED`. It is run by `hdf5.py` and imports nothing of the workbench, which would
take seconds.

Of the file only plain data sets of numbers and single texts are read, by what they declare: a link may lead to any
file, a data set may take its numbers from other files or name a library that unpacks it, and declared lengths cost
nothing.
"""

import faulthandler
import math
import os
import sys
from typing import Any

import h5py
import numpy as np

REFUSED = 3
FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32", 32000: "lzf"}
"""What may have packed the numbers; the HDF5 library would load code from outside for others."""
MOST_LINKS = 10
"""Links within the file on the way to one data set."""
MOST_PACKED = 1100
"""Bytes of numbers for each byte in the file: gzip cannot pack more than 1032 into one."""


def read(path: str, wanted: list[str], most_bytes: int) -> dict[str, np.ndarray]:
    """The wanted data sets that the file has, texts as bytes. Raises ValueError, or what h5py raises, for damage."""
    arrays: dict[str, np.ndarray] = {}
    size = os.path.getsize(path)
    with h5py.File(path, "r") as stored:
        for key in wanted:
            entry = _entry(stored, key)
            if entry is not None:
                left = most_bytes - sum(array.nbytes for array in arrays.values())
                arrays[key] = _value(key, entry, min(left, MOST_PACKED * size), size)
    return arrays


def _entry(stored: h5py.File, key: str) -> h5py.Dataset | None:
    """A data set that lies in groups of this very file; None where there is none."""
    entry: Any = stored
    steps, followed = key.split("/"), 0
    while steps:
        if not isinstance(entry, h5py.Group):
            raise ValueError(f"{key} is in something that is not a group")
        name = steps.pop(0)
        link = entry.get(name, getlink=True)
        if link is None:
            return None
        if isinstance(link, h5py.SoftLink) and followed < MOST_LINKS:
            followed += 1
            entry = stored if link.path.startswith("/") else entry
            steps = [step for step in link.path.split("/") if step not in ("", ".")] + steps
        elif isinstance(link, h5py.HardLink):
            entry = entry[name]
        else:
            raise ValueError(f"{key} is a link out of the file or to itself")
    if not isinstance(entry, h5py.Dataset):
        raise ValueError(f"{key} is not a data set")
    return entry


def _value(key: str, entry: h5py.Dataset, most_bytes: int, file_size: int) -> np.ndarray:
    _check_origin(key, entry)
    text = h5py.check_string_dtype(entry.dtype)
    if text is not None and entry.shape is not None and math.prod(entry.shape) == 1 and (text.length or 0) <= file_size:
        value = np.ravel(np.asarray(entry[()], object))[0]
        return np.frombuffer(value.encode() if isinstance(value, str) else value, np.uint8)
    if entry.shape is None or entry.dtype.kind not in "biuf" or entry.dtype.subdtype is not None:
        raise ValueError(f"{key} holds {entry.dtype}, expected numbers")
    declared, held = math.prod(entry.shape) * entry.dtype.itemsize, entry.id.get_storage_size()
    chunk = math.prod(entry.chunks) * entry.dtype.itemsize if entry.chunks else 0
    if max(declared, chunk) > most_bytes or declared > held * (MOST_PACKED if entry.chunks else 1):
        raise ValueError(f"{key} of shape {entry.shape} declares {declared} bytes and holds {held}")
    return np.asarray(entry[()])


def _check_origin(key: str, entry: h5py.Dataset) -> None:
    """Raise ValueError for numbers that lie elsewhere or are packed by something unknown."""
    if entry.is_virtual or entry.external:
        raise ValueError(f"{key} is in another file")
    creation = entry.id.get_create_plist()
    used = [creation.get_filter(number)[0] for number in range(creation.get_nfilters())]
    if unknown := [number for number in used if number not in FILTERS]:
        raise ValueError(f"{key} is compressed by the unknown filter {unknown[0]}")


def _limit_memory(most_bytes: int) -> None:
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    # Numbers, what they are unpacked from, and the archive of them; libraries take a part of the address space.
    resource.setrlimit(resource.RLIMIT_AS, (4 * most_bytes, 4 * most_bytes))


def main() -> None:
    """See the module."""
    most_bytes, seconds, path, *wanted = sys.argv[1:]
    _limit_memory(int(most_bytes))
    # Ends the process from a thread of its own, also where the library never comes back.
    faulthandler.dump_traceback_later(float(seconds), exit=True)
    try:
        arrays = read(path, wanted, int(most_bytes))
        np.savez(sys.stdout.buffer, **arrays)
    except Exception as error:
        print(str(error) or type(error).__name__, file=sys.stderr)
        sys.exit(REFUSED)


if __name__ == "__main__":
    main()
