"""Ways in which a file is damaged, by its suffix, as Hypothesis strategies over its bytes.

The damage knows the format: JSON and TOML stay JSON and TOML while their values change, the arrays of an .npz take
other shapes, types and numbers, headers lie. Any bytes are changed, cut and doubled besides.
"""

import io
import json
import math
import struct
import tomllib
import warnings
import zipfile
from collections.abc import Callable, Iterator, Mapping
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
import tomlkit
from hypothesis import strategies as st

Damage = Callable[[bytes], st.SearchStrategy[bytes]]

DEEP, DIGITS = "@deep@", "@digits@"
"""Stand in a tree for what its library would refuse to write: nesting without end, a number of 5,000 digits."""
ODD_VALUES = (
    *(True, False, 0, 1, -1, 7, 255, 2**31, 2**53, 2**63, 10**19, 10**25, 0.5, -0.0, 1e-320, 1e300, -1e300),
    *(
        math.nan,
        math.inf,
        -math.inf,
        "",
        "1",
        "nan",
        "x" * 5000,
        "é\0\n</script>[bold]",
        "../../etc/passwd",
        DEEP,
        DIGITS,
    ),
    *([], {}, [[]], {"": {}}, [1, 2, 3], [0.0] * 9, ["a", 1, None], {"a": {"b": [1]}}, [[1.0, 2.0]] * 68),
)
WORDS = (0, 1, 2, 127, 128, 255, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**40, 2**62, 2**63, 2**64 - 1)
ODD_NUMBERS = (math.nan, math.inf, -math.inf, -1, 0, 127, 255, 2**31, -(2**31), 1e20, -1e20, 1e300, 1e-300)
FEW = st.sampled_from((1, 1, 1, 2, 3))
DTYPES = ("?", "i1", "u1", "<i2", "<i4", ">i4", "<u8", "<f2", "<f4", ">f8", "<c16", "U8", "S3", "<M8[s]", "V4", "i1,f8")
ODD_CELLS = (
    "",
    " ",
    "nan",
    "inf",
    "-1",
    "1e400",
    "9" * 5000,
    "0x10",
    "1.5",
    "é",
    '"',
    '""',
    "a,b",
    "x" * 140_000,
    "\0",
)


# --- any bytes ---


@st.composite
def damaged_bytes(draw: st.DrawFn, content: bytes) -> bytes:
    """One to three of: bytes changed, overwritten by a number, removed, doubled, zeroed or put in, the rest cut off."""
    for _ in range(draw(FEW)):
        start = draw(st.integers(0, max(len(content) - 1, 0)))
        length = draw(st.one_of(st.integers(1, 16), st.integers(1, max(len(content) // 2, 1))))
        content = _CHANGES_OF_BYTES[draw(st.sampled_from(sorted(_CHANGES_OF_BYTES)))](draw, content, start, length)
    return content


def _flipped(draw: st.DrawFn, content: bytes, start: int, length: int) -> bytes:
    return content[:start] + bytes([draw(st.integers(0, 255))]) + content[start + 1 :]


def _overwritten(draw: st.DrawFn, content: bytes, start: int, length: int) -> bytes:
    size, order = draw(st.sampled_from((1, 2, 4, 8))), draw(st.sampled_from(("little", "big")))
    word = (draw(st.sampled_from(WORDS)) % 2 ** (8 * size)).to_bytes(size, order)
    return content[:start] + word + content[start + size :]


def _filled(draw: st.DrawFn, content: bytes, start: int, length: int) -> bytes:
    return content[:start] + draw(st.binary(min_size=1, max_size=16)) + content[start:]


_CHANGES_OF_BYTES: dict[str, Callable[[st.DrawFn, bytes, int, int], bytes]] = {
    "flipped": _flipped,
    "flipped too": _flipped,
    "overwritten": _overwritten,
    "filled": _filled,
    "cut": lambda draw, content, start, length: content[:start],
    "removed": lambda draw, content, start, length: content[:start] + content[start + length :],
    "doubled": lambda draw, content, start, length: content[: start + length] + content[start:],
    "zeroed": lambda draw, content, start, length: content[:start] + bytes(length) + content[start + length :],
}


# --- trees of JSON and TOML ---


@st.composite
def damaged_tree(draw: st.DrawFn, tree: Any) -> Any:
    """One to three changes of entries: to something near or odd, removed, doubled, wrapped, renamed, added."""
    tree = deepcopy(tree)
    for _ in range(draw(FEW)):
        places = list(_places(tree))
        if not places:
            return deepcopy(draw(st.sampled_from(ODD_VALUES)))
        holder, key = draw(st.sampled_from(places))
        _change_entry(draw, holder, key)
    return tree


def _change_entry(draw: st.DrawFn, holder: dict | list, key: Any) -> None:
    change = draw(
        st.sampled_from(("near", "near", "odd", "odd", "removed", "wrapped", "elsewhere", "renamed", "added"))
    )
    odd = deepcopy(draw(st.sampled_from(ODD_VALUES)))
    if change == "odd":
        holder[key] = odd
    elif change == "near":
        holder[key] = draw(st.sampled_from(_near(holder[key])))
    elif change == "removed":
        del holder[key]
    elif change == "wrapped":
        holder[key] = draw(st.sampled_from(([holder[key]], {"a": holder[key]}, [holder[key], deepcopy(holder[key])])))
    elif change == "elsewhere":
        holder[key] = deepcopy(
            holder[draw(st.sampled_from(list(holder) if isinstance(holder, dict) else range(len(holder))))]
        )
    elif isinstance(holder, list):
        holder.insert(key, odd)
    elif change == "renamed":
        holder[f"{key}x"] = holder.pop(key)
    else:
        holder[draw(st.sampled_from(("", "extra", "name", "k" * 5000, "é\n")))] = odd


def _near(value: Any) -> tuple[Any, ...]:
    if isinstance(value, bool):
        return (not value, int(value))
    if isinstance(value, int | float):
        return (0, -value, value + 1, value - 1, 2 * value, 1000 * value, value / 7, value + 0.5, str(value))
    if isinstance(value, str):
        return (value[1:], value[:-1], value.upper(), value * 2, f" {value}", [value])
    if isinstance(value, list):
        return (value[1:], value[:-1], value[::-1], value * 2)
    return (None, {})


def _places(tree: Any) -> Iterator[tuple[dict | list, Any]]:
    if isinstance(tree, dict | list):
        for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
            yield tree, key
            yield from _places(value)


def _spelled(text: str, opening: str, closing: str) -> str:
    text = text.replace(f'"{DIGITS}"', "9" * 5000)
    return text.replace(f'"{DEEP}"', opening * 100_000 + "1" + closing * 100_000)


def damaged_json(content: bytes) -> st.SearchStrategy[bytes]:
    """JSON that stays JSON."""
    spelled = st.sampled_from((("[", "]"), ('{"a":', "}")))
    trees = damaged_tree(json.loads(content))
    return st.builds(lambda tree, pair: _spelled(json.dumps(tree), *pair).encode(), trees, spelled)


def damaged_toml(content: bytes) -> st.SearchStrategy[bytes]:
    """TOML that stays TOML, some with a key of very many parts."""
    spelled = st.sampled_from((("[", "]"), ("{a=", "}")))
    trees = damaged_tree(tomllib.loads(content.decode()))
    tails = st.sampled_from(
        (*("",) * 30, "\n[" + "a." * 50_000 + "a]", "\n" + "b." * 50_000 + "b = 1", "\nc = 1979-05-27")
    )
    return st.builds(lambda tree, pair, tail: _as_toml(tree, pair, tail).encode(), trees, spelled, tails)


def _as_toml(tree: Any, pair: tuple[str, str], tail: str) -> str:
    tree = _without_none(tree if isinstance(tree, dict) else {"a": tree})
    return _spelled(tomlkit.dumps(tree), *pair) + tail


def _without_none(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _without_none(value) for key, value in tree.items() if value is not None}
    return [_without_none(value) for value in tree if value is not None] if isinstance(tree, list) else tree


# --- text in rows and cells ---


@st.composite
def damaged_rows(draw: st.DrawFn, content: bytes, separator: str = ",") -> bytes:
    """One to three cells replaced by something odd, rows removed, doubled or exchanged."""
    rows = [line.split(separator) for line in content.decode().splitlines()]
    for _ in range(draw(FEW)):
        row = draw(st.integers(0, len(rows) - 1))
        change = draw(st.sampled_from(("cell", "cell", "cell", "more", "removed", "doubled", "first")))
        if change == "cell":
            rows[row][draw(st.integers(0, len(rows[row]) - 1))] = draw(st.sampled_from(ODD_CELLS))
        elif change == "more":
            rows[row].append(draw(st.sampled_from(ODD_CELLS)))
        elif change == "removed":
            rows[row] = [""]
        elif change == "doubled":
            rows.insert(row, list(rows[row]))
        else:
            rows.insert(0, rows.pop(row))
    return "\n".join(separator.join(row) for row in rows).encode()


# --- zip archives and arrays ---


def members_of(content: bytes) -> dict[str, bytes]:
    """The members of a zip archive."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def archive_of(members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip archive of these members."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


@st.composite
def damaged_members(draw: st.DrawFn, content: bytes) -> bytes:
    """A zip archive that is whole, one of its members damaged, exchanged, renamed or removed."""
    members = members_of(content)
    name = draw(st.sampled_from(sorted(members)))
    change = draw(st.sampled_from(("bytes", "bytes", "removed", "renamed", "exchanged", "emptied")))
    if change == "bytes":
        members[name] = draw(damaged_bytes(members[name]))
    elif change == "exchanged":
        members[name] = members[draw(st.sampled_from(sorted(members)))]
    elif change == "emptied":
        members[name] = b""
    else:
        kept = members.pop(name)
        members |= {f"other-{name}": kept} if change == "renamed" else {}
    return archive_of(members, draw(st.sampled_from((zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED))))


@st.composite
def damaged_arrays(draw: st.DrawFn, content: bytes) -> bytes:
    """An .npz whose arrays take other shapes, types and numbers, or whose headers lie."""
    members = members_of(content)
    for _ in range(draw(st.integers(1, 2))):
        name = draw(st.sampled_from(sorted(members)))
        try:
            array = np.load(io.BytesIO(members[name]), allow_pickle=False)
        except (ValueError, TypeError, EOFError, OSError, OverflowError, MemoryError):  # its header lies already
            continue
        members[name] = draw(damaged_array(array))
    return archive_of(members)


@st.composite
def damaged_npy(draw: st.DrawFn, content: bytes) -> bytes:
    """An .npy of another shape or type or with odd numbers, or whose header lies."""
    return draw(damaged_array(np.load(io.BytesIO(content), allow_pickle=False)))


@st.composite
def damaged_array(draw: st.DrawFn, array: np.ndarray) -> bytes:
    """The .npy bytes of an array that was changed, or whose header lies about it."""
    if array.dtype.kind == "U" and array.ndim == 0 and array.item()[:1] == "{" and draw(st.integers(0, 9)):
        return npy(np.array(draw(damaged_json(array.item().encode())).decode()))
    change = draw(st.sampled_from((*("array",) * 5, "header", "objects")))
    if change == "objects":
        return npy(np.array([{"a": 1}, None], object))
    if change == "header":
        return _lying(draw, array)
    return npy(draw(other_array(array)))


@st.composite
def other_array(draw: st.DrawFn, array: np.ndarray) -> np.ndarray:
    """An array of another shape or type, or with an odd number in it."""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        change = draw(st.sampled_from(("number", "number", "shape", "shape", "type")))
        if change == "number":
            return _with_odd_number(draw, array)
        return _reshaped(draw, array) if change == "shape" else _retyped(draw, array)


def npy(array: np.ndarray, shape: tuple | None = None, descr: str | None = None, order: bool = False) -> bytes:
    """An array as .npy, with another shape and type in its header where these are given."""
    stream = io.BytesIO()
    if shape is None and descr is None:
        np.lib.format.write_array(stream, array, allow_pickle=True)
        return stream.getvalue()
    header = {"descr": descr or array.dtype.str, "fortran_order": order, "shape": shape or array.shape}
    np.lib.format.write_array_header_2_0(stream, header)
    return stream.getvalue() + array.tobytes()


def _with_odd_number(draw: st.DrawFn, array: np.ndarray) -> np.ndarray:
    array = array.copy()
    number = draw(st.sampled_from(ODD_NUMBERS))
    if array.size == 0 or array.dtype.kind not in "fiub":
        return np.full(3, number)
    if array.dtype.kind in "iu":
        limits = np.iinfo(array.dtype)
        number = int(np.clip(np.nan_to_num(number), max(limits.min, -(2**62)), min(limits.max, 2**62)))
    place = draw(st.integers(0, array.size - 1))
    if draw(st.booleans()):
        array.flat[place] = number
    else:
        array.flat[place:] = number
    return array


def _reshaped(draw: st.DrawFn, array: np.ndarray) -> np.ndarray:
    rows = array if array.ndim else array.reshape(1)
    return draw(
        st.sampled_from(
            (
                rows[:-1],
                rows[:0],
                np.concatenate([rows, rows]),
                np.concatenate([rows, rows[-1:]]),
                rows.ravel()[:1].reshape(()) if rows.size else np.zeros(()),
                rows.ravel(),
                rows.T,
                rows[..., :-1],
                rows[..., :0],
                rows[None],
                rows[..., None],
                np.zeros((0, 0)),
            )
        )
    )


def _retyped(draw: st.DrawFn, array: np.ndarray) -> np.ndarray:
    dtype = np.dtype(draw(st.sampled_from(DTYPES)))
    try:
        return array.astype(dtype)
    except (ValueError, TypeError):
        return np.zeros(array.shape, dtype)


def _lying(draw: st.DrawFn, array: np.ndarray) -> bytes:
    shape = draw(
        st.sampled_from(
            (
                (*array.shape, 1000),
                (10**12, *array.shape[1:]),
                (2**40, 2**40),
                (-1, *array.shape[1:]),
                (1.5, *array.shape[1:]),
                (True, *array.shape[1:]),
                (10**30,),
                (3,) * 70,
                array.shape[::-1],
            )
        )
    )
    descr = draw(st.sampled_from((array.dtype.str, array.dtype.str, "|O", "<f8", "|V0", "<U100000000", "nonsense")))
    return npy(array, shape, descr, draw(st.booleans()))


# --- face models ---


@st.composite
def damaged_glb(draw: st.DrawFn, content: bytes) -> bytes:
    """A .glb whose JSON stays JSON, and whose chunks have their lengths."""
    size = struct.unpack_from("<I", content, 12)[0]
    text = draw(damaged_json(content[20 : 20 + size]))
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + content[20 + size :]
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@st.composite
def damaged_matlab(draw: st.DrawFn, content: bytes) -> bytes:
    """A .mat with another array, or something else, under one of its names."""
    variables = {name: array for name, array in scipy.io.loadmat(io.BytesIO(content)).items() if name[0] != "_"}
    name = draw(st.sampled_from(sorted(variables)))
    array = draw(other_array(variables[name]))
    odd = (
        array
        if array.dtype.kind in "biufc"
        else draw(st.sampled_from(("text", {"a": 1.0}, np.array([1, "a"], object))))
    )
    stream = io.BytesIO()
    scipy.io.savemat(stream, variables | {name: odd}, do_compression=draw(st.booleans()))
    return stream.getvalue()


@st.composite
def damaged_hdf5(draw: st.DrawFn, content: bytes) -> bytes:
    """An HDF5 file with another array or another kind of entry under one of its names."""
    stream = io.BytesIO(content)
    with h5py.File(stream, "a") as stored:
        names: list[str] = []
        stored.visit(names.append)
        name = draw(st.sampled_from(names))
        array = stored[name][()] if isinstance(stored[name], h5py.Dataset) else np.zeros(3)
        del stored[name]
        change = draw(
            st.sampled_from(("array", "array", "array", "removed", "group", "link", "text", "lengths", "far"))
        )
        if change == "array" and array.dtype.kind in "iuf":
            array = draw(other_array(array))
            stored[name] = array if array.dtype.kind in "iufb" else np.zeros(2, "S3")
        elif change == "group":
            stored.create_group(name)
        elif change == "link":
            stored[name] = h5py.SoftLink(f"/{draw(st.sampled_from(names))}")
        elif change == "far":
            stored[name] = h5py.ExternalLink("/etc/passwd", "/a")
        elif change == "text":
            stored[name] = draw(st.sampled_from(("", "text", "[" * 5000)))
        elif change == "lengths":
            stored.create_dataset(name, shape=(2**20, 2**20), dtype="f4", chunks=draw(st.sampled_from((None, True))))
    return stream.getvalue()


# --- weights of networks ---


@st.composite
def damaged_safetensors(draw: st.DrawFn, content: bytes) -> bytes:
    """A file whose table of arrays says something else, of the length that the file says it has or of another."""
    length = int.from_bytes(content[:8], "little")
    table = draw(damaged_json(content[8 : 8 + length]))
    told = draw(st.sampled_from((len(table), len(table), len(table), *WORDS)))
    return (told % 2**64).to_bytes(8, "little") + table + content[8 + length :]


def damaged_checkpoint(content: bytes) -> st.SearchStrategy[bytes]:
    """A checkpoint of PyTorch: a zip archive, or a stream of pickles."""
    return damaged_members(content) if content.startswith(b"PK") else damaged_bytes(content)


# --- by suffix ---

BY_SUFFIX: dict[str, tuple[Damage, ...]] = {
    ".json": (damaged_json, damaged_json),
    ".toml": (damaged_toml, damaged_toml),
    ".csv": (damaged_rows, damaged_rows),
    ".npy": (damaged_npy, damaged_npy),
    ".npz": (damaged_arrays, damaged_arrays, damaged_members),
    ".glb": (damaged_glb, damaged_glb),
    ".mat": (damaged_matlab,),
    ".h5": (damaged_hdf5,),
    ".safetensors": (damaged_safetensors, damaged_safetensors),
    ".pth": (damaged_checkpoint, damaged_checkpoint),
    ".obj": (partial(damaged_rows, separator=" "),),
}
"""Beside damage of any bytes; twice is twice as often."""


def damaged(name: str, content: bytes) -> st.SearchStrategy[bytes]:
    """Damage to a file of this name."""
    kinds = (damaged_bytes, *BY_SUFFIX.get(Path(name).suffix.lower(), ()))
    return st.one_of([kind(content) for kind in kinds])


@st.composite
def damaged_files(draw: st.DrawFn, valid: Mapping[str, bytes]) -> dict[str, bytes]:
    """Files by path with one of them damaged, or absent where there are several."""
    name = draw(st.sampled_from(sorted(valid)))
    if len(valid) > 1 and draw(st.integers(0, 19)) == 0:
        return {other: content for other, content in valid.items() if other != name}
    return {**valid, name: draw(damaged(name, valid[name]))}
