"""Arrays of pickles, .npz and .npy files, read without executing anything (`workbench.inert_pickle`).

Known are NumPy arrays and scalars as Python 2 and 3 write them, SciPy's sparse matrices, and the wrappers of chumpy
that only hold, select or reshape an array. A call of anything else is refused by its name.
"""

import re
import zipfile
from io import BufferedIOBase, BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse

from workbench.errors import ModelError
from workbench.inert_pickle import Name, Record, UnreadableError, named, unpickled
from workbench.reading import array_header, check_numbers_held, checked_content, checked_members, reading, shortened

DEEPEST = 30
"""Levels beyond which a structure is not a model but a trap."""
SPARSE = {"csc_matrix": scipy.sparse.csc_matrix, "csr_matrix": scipy.sparse.csr_matrix}
NAMED_BY_MODELS = re.compile(
    r"numpy((\._?core)?\.(multiarray|numeric))?\.(_reconstruct|scalar|dtype|ndarray|_frombuffer)"
    r"|scipy\.sparse(\.\w+)*\.(csc|csr|coo)_(matrix|array)"
    r"|chumpy(\.\w+)*\.\w+"
    r"|torch\._utils\._rebuild_\w+|torch\.storage\._load_from_bytes|torch\.\w*Storage"
)
"""What published models call; none of it is called here, and what is not an array stays an inert record."""


def read_arrays(path: str | Path) -> dict[str, Any]:
    """The named arrays of a .pkl, .npz or .npy file; texts and numbers stay as they are, the rest inert records.

    Raises `ModelError` for a file that is damaged, holds no dictionary, or calls what no model needs.
    """
    path = Path(path)
    content = checked_content(path, "arrays", ModelError)
    with reading(path, "arrays", "supply the file as it was published", ModelError):
        if content.startswith(b"PK"):
            return _read_npz(BytesIO(content))
        if content.startswith(b"\x93NUMPY"):
            loaded = _read_npy(BytesIO(content), "it", len(content))
        else:
            loaded = _values(unpickled(BytesIO(content), _made))
    # np.save keeps a dictionary as an array of one object.
    loaded = loaded[0] if isinstance(loaded, list) and len(loaded) == 1 else loaded
    if not isinstance(loaded, dict):
        raise ModelError(f"{path} holds no named arrays but {_kind(loaded)}; supply the file as it was published.")
    return loaded


def array_of(arrays: dict[str, Any], key: str, path: object) -> np.ndarray:
    """One array by its name. Raises `ModelError` if there is none, or something else under that name."""
    value = arrays.get(key)
    if isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        return value
    kind = "is missing" if key not in arrays else f"is {_kind(value)}, not an array"
    raise ModelError(f"{path}: {key} {kind}; supply the file as it was published.")


def _kind(value: Any) -> str:
    called = isinstance(value, Record) and isinstance(value.name, Name)
    return shortened(".".join(value.name)) if called else type(value).__name__


def _read_npz(stream: BufferedIOBase) -> dict[str, Any]:
    with zipfile.ZipFile(stream) as archive:
        members = [member for member in checked_members(archive) if member.filename.endswith(".npy")]
        arrays = {}
        for member in members:
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as content:
                arrays[name] = _read_npy(content, name, member.file_size)
    if not arrays:
        raise UnreadableError("it is a zip file without arrays")
    # An array of one object is the object.
    return {name: value[0] if isinstance(value, list) and len(value) == 1 else value for name, value in arrays.items()}


def _read_npy(stream: BufferedIOBase, name: str, size: int) -> Any:
    shape, dtype = array_header(stream)
    if dtype.hasobject:
        return _values(unpickled(BytesIO(stream.read()), _made))
    check_numbers_held(name, shape, dtype, size)
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)


# --- what the calls of a pickle stand for ---------------------------------------------------------------------------


def _made(name: Any, arguments: Any) -> Any:
    match name, arguments:
        case Name("_codecs", "encode"), (str(text), "latin1" | "latin-1"):
            return text.encode("latin-1")
        case Name("__builtin__" | "builtins", "bytearray"), (bytes(data),):
            return data
        case Name("__builtin__" | "builtins", "bytes"), ():
            return b""
        case Name("__builtin__" | "builtins", "set" | "frozenset"), ([*entries],):
            return entries
        case Name("collections", "OrderedDict"), ():
            return {}
        case Name("collections", "OrderedDict"), (list(pairs),):
            return named(pairs)
        case Name("copy_reg" | "copyreg", "_reconstructor"), (Name() as made, *_):
            return _record(made, ())
        case Name() as called, _:
            return _record(called, arguments)
    raise UnreadableError("it calls something that has no name, which no face model needs; nothing of it was run")


def _record(name: Name, arguments: Any) -> Record:
    if NAMED_BY_MODELS.fullmatch(f"{name.module}.{name.name}") is None:
        raise UnreadableError(
            f"it calls {name.module}.{name.name}, which no face model needs; the file may be malicious, "
            "and nothing of it was run"
        )
    return Record(name, arguments)


def _values(loaded: Any) -> Any:
    """The structure with records of arrays replaced by the arrays."""
    known: dict[int, Any] = {}

    def value(entry: Any, level: int) -> Any:
        if level > DEEPEST:
            raise UnreadableError("it is nested without end")
        if not isinstance(entry, Record | dict | list | tuple):
            return entry
        if id(entry) not in known:
            # Marks the entry while it is built: one that holds itself is nested without end.
            known[id(entry)] = _Unfinished
            known[id(entry)] = built(entry, level)
        if known[id(entry)] is _Unfinished:
            raise UnreadableError("it is nested without end")
        return known[id(entry)]

    def built(entry: Any, level: int) -> Any:
        if isinstance(entry, dict):
            return {name: value(part, level + 1) for name, part in entry.items()}
        if isinstance(entry, Record):
            return _object(entry, lambda part: value(part, level + 1))
        return [value(part, level + 1) for part in entry]

    return value(loaded, 0)


class _Unfinished:
    """Stands for an entry that is being built."""


def _object(record: Record, value: Any) -> Any:
    module, name = record.name
    if module.startswith("numpy"):
        return _numpy_object(record, value)
    state = record.state if isinstance(record.state, dict) else {}
    if module.startswith("scipy.sparse") and name in SPARSE:
        return _sparse(SPARSE[name], {key: value(part) for key, part in state.items()})
    if module == "chumpy.ch" and name == "Ch" and "x" in state:
        return value(state["x"])
    if module == "chumpy.reordering" and "a" in state:
        inner = value(state["a"])
        if name == "Select" and isinstance(inner, np.ndarray) and "idxs" in state:
            chosen = inner.ravel()[np.asarray(value(state["idxs"]), int)]
            return chosen.reshape(value(state["preferred_shape"])) if "preferred_shape" in state else chosen
        if name == "Reshape" and isinstance(inner, np.ndarray) and "newshape" in state:
            return inner.reshape(value(state["newshape"]))
    return record


def _numpy_object(record: Record, value: Any) -> Any:
    match record.name.name, record.arguments, record.state:
        case "_reconstruct", _, (_, tuple(shape), Record() as dtype, bool(fortran) | int(fortran), data):
            if isinstance(data, list):
                return [value(part) for part in data]
            return _array(data, _dtype(dtype), shape, "F" if fortran else "C")
        case "_frombuffer", (data, Record() as dtype, tuple(shape), str(order)), _:
            return _array(data, _dtype(dtype), shape, "F" if order == "F" else "C")
        case "scalar", (Record() as dtype, data), _:
            return _array(data, _dtype(dtype), (), "C")
    return record


def _dtype(record: Record) -> np.dtype:
    match record.name.name, record.arguments, record.state:
        case "dtype", (str(code), *_), state if re.fullmatch("[biuf][0-9]{1,2}", code):
            order = state[1] if isinstance(state, tuple) and len(state) > 1 and state[1] in ("<", ">") else ""
            return np.dtype(order + code)
    raise UnreadableError("it holds an array of something other than numbers")


def _array(data: Any, dtype: np.dtype, shape: tuple, order: str) -> np.ndarray:
    if isinstance(data, str):  # as Python 2 wrote it
        data = data.encode("latin-1")
    if not isinstance(data, bytes | bytearray) or not all(isinstance(length, int) and length >= 0 for length in shape):
        raise UnreadableError("it holds an array without its numbers")
    if len(data) != int(np.prod(shape, dtype=object)) * dtype.itemsize:
        raise UnreadableError(f"an array of shape {shape} has {len(data)} bytes: it is cut off or damaged")
    flat = np.frombuffer(bytes(data), dtype)
    return np.array(flat.reshape(shape, order=order), dtype.newbyteorder("="))


def _sparse(kind: type, state: dict[str, Any]) -> np.ndarray:
    shape = state.get("_shape", state.get("shape"))
    made = kind((state["data"], state["indices"], state["indptr"]), shape=tuple(int(length) for length in shape))
    made.check_format(full_check=True)
    if made.shape[0] * made.shape[1] > 100_000_000:
        raise UnreadableError(f"a sparse matrix of shape {made.shape} is not part of a face model")
    return made.toarray()
