"""Pickles read as data: nothing in them is imported, called or run.

A pickle is a program for a stack machine that may call anything. Here that program is followed by the small machine
below, which knows lists, dicts, numbers and texts. A name of a class or function is only a name; what would be called
on it becomes whatever the reader of a format makes of name and arguments, at most an inert `Record`.
"""

import codecs
import struct
import zipfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from io import BufferedIOBase
from pickletools import code2op
from typing import Any, NamedTuple


class UnreadableError(Exception):
    """Why a file cannot be followed; the reader of its format says so to the user."""


UNREADABLE = (
    UnreadableError,
    *(ValueError, IndexError, KeyError, TypeError, AttributeError, OverflowError, EOFError, struct.error),
    *(zipfile.BadZipFile, NotImplementedError, RuntimeError),
)
"""What goes wrong where a broken file is followed; `zipfile` and `pickletools` name no common base."""


class Name(NamedTuple):
    """A class or function that the file names; never looked up."""

    module: str
    name: str


@dataclass
class Record:
    """What calling a name would have made."""

    name: Any
    arguments: Any = ()
    state: Any = field(default=None)


def no_objects(identifier: Any) -> Any:
    """Refuses objects that lie outside the pickle."""
    raise UnreadableError("its pickle refers to something outside it")


def unpickled(
    stream: BufferedIOBase, made: Callable[[Any, Any], Any] = Record, persistent: Callable[[Any], Any] = no_objects
) -> Any:
    """The value that the next pickle of a stream describes.

    `made(name, arguments)` decides what stands for a call; `persistent(identifier)` what stands for an object outside
    the pickle. Raises one of `UNREADABLE`.
    """
    machine = _Machine(made, persistent)
    for code, argument in _opcodes(stream):
        if code == "STOP":
            return machine.stack.pop()
        machine.step(code, argument)
    raise UnreadableError("its pickle has no end")


def named(pairs: Iterable[tuple[Any, Any]]) -> dict[str | int, Any]:
    """The entries that have a name or number: data have no others, and other keys may be endless to hash."""
    return {name: value for name, value in pairs if isinstance(name, str | int)}


_MARK = object()
_LITERALS = frozenset(
    [
        *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4", "FLOAT", "BINFLOAT"),
        *("STRING", "BINSTRING", "SHORT_BINSTRING", "UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
        *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
    ]
)
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
# A set stays a list: its entries may be endless to hash.
_EMPTY: dict[str, Callable[[], Any]] = {
    "EMPTY_DICT": dict,
    "EMPTY_LIST": list,
    "EMPTY_TUPLE": tuple,
    "EMPTY_SET": list,
}
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_IGNORED = frozenset(["PROTO", "FRAME"])


def _opcodes(stream: BufferedIOBase) -> Iterator[tuple[str, Any]]:
    """Names and arguments of the opcodes up to the end of the pickle or of the stream."""
    while code := stream.read(1):
        opcode = code2op.get(code.decode("latin-1"))
        if opcode is None:
            raise UnreadableError(f"it begins with or holds {code!r}, which is not an opcode of a pickle")
        # `pickletools` reads these texts as ASCII; Python 2 wrote the bytes of arrays into them.
        reader = _quoted if opcode.name == "STRING" else opcode.arg.reader if opcode.arg else lambda _: None
        yield opcode.name, reader(stream)


def _quoted(stream: BufferedIOBase) -> str:
    line = stream.readline()
    text = line.rstrip(b"\r\n")
    if not line.endswith(b"\n") or len(text) < 2 or text[:1] not in b"'\"" or text[:1] != text[-1:]:
        raise UnreadableError("a text in its pickle has no quotes: it was changed by a transfer as text")
    return codecs.escape_decode(text[1:-1])[0].decode("latin-1")


class _Machine:
    """Follows a pickle's opcodes as the pickle protocol defines them, up to names and calls."""

    def __init__(self, made: Callable[[Any, Any], Any], persistent: Callable[[Any], Any]) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self._made, self._persistent = made, persistent

    def step(self, code: str, argument: Any) -> None:
        """One opcode."""
        stack = self.stack
        if code in _LITERALS:
            stack.append(argument)
        elif code in _CONSTANTS:
            stack.append(_CONSTANTS[code])
        elif code in _EMPTY:
            stack.append(_EMPTY[code]())
        elif code == "MARK":
            stack.append(_MARK)
        elif code in ("PUT", "BINPUT", "LONG_BINPUT"):
            self.memo[argument] = stack[-1]
        elif code == "MEMOIZE":
            self.memo[len(self.memo)] = stack[-1]
        elif code in ("GET", "BINGET", "LONG_BINGET"):
            stack.append(self.memo[argument])
        elif code not in _IGNORED:
            self._compose(code, argument)

    def _compose(self, code: str, argument: Any) -> None:
        """The opcodes that make one value of several."""
        stack = self.stack
        if code in _TUPLES:
            stack.append(tuple(self._popped(_TUPLES[code])))
        elif code == "TUPLE":
            stack.append(tuple(self._since_mark()))
        elif code == "LIST":
            stack.append(self._since_mark())
        elif code == "DICT":
            values = self._since_mark()
            stack.append(named(zip(values[::2], values[1::2], strict=True)))
        elif code == "APPEND":
            self._extend([stack.pop()])
        elif code in ("APPENDS", "ADDITEMS"):
            self._extend(self._since_mark())
        elif code == "SETITEM":
            self._update(self._popped(2))
        elif code == "SETITEMS":
            self._update(self._since_mark())
        elif code == "GLOBAL":
            stack.append(Name(*argument.split(" ", 1)))
        elif code == "STACK_GLOBAL":
            stack.append(Name(*self._popped(2)))
        elif code == "BINPERSID":
            stack.append(self._persistent(stack.pop()))
        elif code in ("REDUCE", "NEWOBJ"):
            name, arguments = self._popped(2)
            stack.append(self._made(name, arguments))
        elif code == "BUILD":
            state = stack.pop()
            if isinstance(stack[-1], Record):
                stack[-1].state = state
        else:
            raise UnreadableError(f"its pickle holds the opcode {code}, which no file of this kind needs")

    def _popped(self, count: int) -> list[Any]:
        if len(self.stack) < count:
            raise UnreadableError("its pickle is broken: nothing on the stack")
        values = self.stack[-count:]
        del self.stack[-count:]
        return values

    def _since_mark(self) -> list[Any]:
        values = []
        while (value := self.stack.pop()) is not _MARK:
            values.append(value)
        return values[::-1]

    def _extend(self, values: list[Any]) -> None:
        if isinstance(self.stack[-1], list):
            self.stack[-1].extend(values)

    def _update(self, values: list[Any]) -> None:
        if isinstance(self.stack[-1], dict):
            self.stack[-1].update(named(zip(values[::2], values[1::2], strict=True)))
