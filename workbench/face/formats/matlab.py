"""Arrays of numbers from MATLAB files of level 5 (what `save` writes up to MATLAB 7.2), followed without native code.

`scipy.io.loadmat` believes the sizes and types that such a file declares: one changed byte ends the process. Of the
format only what face models need is known here, so that every size is compared with the bytes that are there: a header
of 128 bytes, then elements of type, size and data in steps of 8 bytes; an array is an element of elements (flags,
lengths, name, numbers), and may stand in an element of its own that zlib compressed.
"""

import math
import zlib
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from workbench.reading import MOST_UNPACKED_BYTES

HEADER_BYTES = 128
LEVEL_5, LEVEL_73 = 0x0100, 0x0200
COMPRESSED, ARRAY = 15, 14
STORED = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Types of numbers in the file, by their number in a tag."""
CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
"""Types of arrays in MATLAB, by class number; the others are cells, structures, texts and sparse matrices."""
COMPLEX = 0x0800
BEGINNING = 1024
"""Bytes of a compressed array that hold its flags, lengths and name."""


class _Element(NamedTuple):
    kind: int
    data: memoryview


class _Start(NamedTuple):
    """What stands before the numbers of an array."""

    name: str
    array_class: int
    complex: bool
    lengths: tuple[int, ...]
    numbers: memoryview


def is_level_73(content: bytes) -> bool:
    """Whether the file is of MATLAB 7.3 or later, which is HDF5."""
    return _level(content) == LEVEL_73


def matlab_arrays(content: bytes, wanted: Collection[str]) -> dict[str, np.ndarray]:
    """The wanted variables that the file has.

    Raises ValueError or `zlib.error` where it is damaged, ValueError where one of them holds no numbers.
    """
    if _level(content) != LEVEL_5:
        raise ValueError("it is not a level 5 MATLAB file; save it with -v7")
    order, place = _order(content), HEADER_BYTES
    arrays: dict[str, np.ndarray] = {}
    while place < len(content):
        element, place = _element(memoryview(content), place, order)
        left = MOST_UNPACKED_BYTES - sum(array.nbytes for array in arrays.values())
        start = _start(element.data, order) if element.kind == ARRAY else _unpacked(element, order, wanted, left)
        if start is not None and start.name in wanted:
            arrays[start.name] = _numbers(start, order, left)
    return arrays


def _order(content: bytes) -> str:
    return ">" if content[126:128] == b"MI" else "<"


def _level(content: bytes) -> int:
    if len(content) < HEADER_BYTES or content[126:128] not in (b"IM", b"MI"):
        raise ValueError("it does not begin as a MATLAB file does")
    return int(np.frombuffer(content, _order(content) + "u2", 1, 124)[0])


def _element(data: memoryview, place: int, order: str, padded: bool = False) -> tuple[_Element, int]:
    """The element at `place` and the place behind it; elements of an array are `padded` to 8 bytes."""
    if place + 8 > len(data):
        raise ValueError("it is cut off")
    kind, size = (int(number) for number in np.frombuffer(data, order + "u4", 2, place))
    if small := kind >> 16:  # up to four bytes of data stand in the tag, whose first half holds size and type
        if small > 4:
            raise ValueError(f"an element in a tag declares {small} bytes")
        return _Element(kind & 0xFFFF, data[place + 4 : place + 4 + small]), place + 8
    if place + 8 + size > len(data):
        raise ValueError(f"an element declares {size} bytes, {len(data) - place - 8} are left")
    return _Element(kind, data[place + 8 : place + 8 + size]), place + 8 + size + (-size % 8 if padded else 0)


def _unpacked(element: _Element, order: str, wanted: Collection[str], left: int) -> _Start | None:
    """The array in a compressed element, if it is wanted: only then more than its beginning is unpacked."""
    if element.kind != COMPRESSED:
        return None
    beginning = zlib.decompressobj().decompress(element.data, BEGINNING)
    if len(beginning) < 8:
        raise ValueError("a compressed array is cut off")
    kind, size = (int(number) for number in np.frombuffer(beginning, order + "u4", 2))
    if kind != ARRAY or _start(memoryview(beginning)[8:], order).name not in wanted:
        return None
    if size > left:
        raise ValueError(f"its arrays unpack to more than {MOST_UNPACKED_BYTES / 1e9:.1f} GB")
    unpacked = zlib.decompressobj().decompress(element.data, 8 + size)
    if len(unpacked) < 8 + size:
        raise ValueError(f"an array of {size} bytes unpacks to {len(unpacked) - 8}")
    return _start(memoryview(unpacked)[8:], order)


def _start(body: memoryview, order: str) -> _Start:
    flags, place = _element(body, 0, order, padded=True)
    lengths, place = _element(body, place, order, padded=True)
    name, place = _element(body, place, order, padded=True)
    flag = int(np.frombuffer(flags.data, order + "u4", 1)[0])
    shape = tuple(np.frombuffer(lengths.data, order + "i4").tolist())
    if min(shape, default=-1) < 0:
        raise ValueError(f"it holds an array of the shape {shape[:8]}")
    return _Start(bytes(name.data).decode("ascii"), flag & 0xFF, bool(flag & COMPLEX), shape, body[place:])


def _numbers(start: _Start, order: str, left: int) -> np.ndarray:
    if start.array_class not in CLASSES or start.complex:
        raise ValueError(f"{start.name} is not an array of real numbers")
    element, _ = _element(start.numbers, 0, order, padded=True)
    if element.kind not in STORED:
        raise ValueError(f"{start.name} holds no numbers")
    # Whole numbers are stored as bytes where these suffice, whatever their class.
    stored, made = np.dtype(order + STORED[element.kind]), np.dtype(CLASSES[start.array_class])
    count = math.prod(start.lengths)
    if count * stored.itemsize != len(element.data) or count * made.itemsize > left:
        raise ValueError(f"{start.name} of shape {start.lengths[:8]} has {len(element.data)} bytes")
    return np.frombuffer(element.data, stored).astype(made).reshape(start.lengths, order="F")
