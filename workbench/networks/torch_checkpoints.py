"""PyTorch checkpoints read as data: nothing in them is imported, called or run, and PyTorch is not needed.

A checkpoint describes its tensors by a pickle, a program that may call anything. `workbench.inert_pickle` follows it
without calling: whatever would be called on a class or function becomes an inert record, and tensors hidden in such a
record are found but nothing happens. (`torch.load` and `torch.jit.load` of a file from elsewhere run code of that file,
except `torch.load(weights_only=True)`, which refuses TorchScript.)

Three formats are known: the zip files of `torch.save`, the older stream of `torch.save` (published in 2018 as
`.pth.tar`, though it is no tar), and the zip files of `torch.jit.save` (TorchScript).
"""

import hashlib
import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from workbench.inert_pickle import UNREADABLE, Name, Record, UnreadableError, named, unpickled
from workbench.networks.weights import Weights, read_weights
from workbench.reading import MOST_UNPACKED_BYTES, checked_file, reading

STORAGE_TYPES = {
    "DoubleStorage": np.dtype("<f8"),
    "FloatStorage": np.dtype("<f4"),
    "HalfStorage": np.dtype("<f2"),
    "LongStorage": np.dtype("<i8"),
    "IntStorage": np.dtype("<i4"),
    "ShortStorage": np.dtype("<i2"),
    "CharStorage": np.dtype("i1"),
    "ByteStorage": np.dtype("u1"),
    "BoolStorage": np.dtype("?"),
}
LEGACY_MAGIC = 0x1950A86A20F9469CFC6C
"""First number of the stream that `torch.save` wrote before version 1.6."""
DEEPEST, MOST = 40, 100_000
"""Levels and entries beyond which a file is not a state dict but a trap."""


def read_checkpoint(path: str | Path) -> Weights:
    """All arrays of a checkpoint by their dotted names; the metadata hold the file's name and SHA-256.

    `path` is a state dict (also one under the key "state_dict", also with names behind "module."), a TorchScript
    archive, or a safetensors file, which comes back as it is. Raises `InputError` for anything else.
    """
    path = checked_file(
        path, "weights", absent=f"there is no weights file {path}; check the name and the folder.", may_be_empty=True
    )
    remedy = (
        "supply a state dict (.pth, .pth.tar) or TorchScript archive (.zip, .pt) as it was published, whole, or a "
        "converted .safetensors file"
    )
    with reading(path, "a PyTorch checkpoint", remedy):
        if (size := path.stat().st_size) > MOST_UNPACKED_BYTES:
            raise UnreadableError(f"it has {size / 1e9:.1f} GB, the limit is {MOST_UNPACKED_BYTES / 1e9:.1f} GB")
        content = path.read_bytes()
        if content[8:9] == b"{":  # safetensors: eight bytes of length, then JSON
            return read_weights(path)
        loaded, storages = _read_zip(content) if content.startswith(b"PK") else _read_stream(content)
        arrays = {name: _array(tensor, storages) for name, tensor in _tensors(loaded).items()}
    return Weights(arrays, {"source": path.name, "source_sha256": hashlib.sha256(content).hexdigest()}, str(path))


class _Storage(NamedTuple):
    key: str
    dtype: np.dtype
    size: int


class _Tensor(NamedTuple):
    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    stride: tuple[int, ...]


def _read_zip(content: bytes) -> tuple[Any, Mapping[str, bytes]]:
    """The pickled structure of a zip archive of `torch.save` or `torch.jit.save`, and its storages by key."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        # What PyTorch stores without compression; a TorchScript archive's code is compressed, and left alone.
        listed = [info for info in archive.infolist() if info.compress_type == zipfile.ZIP_STORED]
        if sum(info.file_size for info in listed) > len(content):
            raise UnreadableError("its entries overlap")
        entries = {info.filename: archive.read(info) for info in listed}
    roots = [name.removesuffix("data.pkl") for name in entries if name.endswith("/data.pkl") and name.count("/") == 1]
    if len(roots) != 1:
        raise UnreadableError("it is a zip file without the data.pkl of PyTorch 1.4 or later")
    if entries.get(f"{roots[0]}byteorder", b"little") != b"little":
        raise UnreadableError("it was written on a big-endian machine")
    folder = f"{roots[0]}data/"
    storages = {name.removeprefix(folder): data for name, data in entries.items() if name.startswith(folder)}
    return unpickled(io.BytesIO(entries[f"{roots[0]}data.pkl"]), _made, _storage), storages


def _read_stream(content: bytes) -> tuple[Any, Mapping[str, bytes]]:
    """The structure and storages of the older format: five pickles (magic, version, system, structure, keys), data."""
    stream = io.BytesIO(content)
    try:
        magic = unpickled(stream, _made, _storage)
    except UNREADABLE:
        magic = None
    if magic != LEGACY_MAGIC:
        tar = content[257:262] == b"ustar"
        raise UnreadableError("it is a tar archive: unpack it first" if tar else f"it begins with {content[:12]!r}")
    _version, _system, loaded, keys = (unpickled(stream, _made, _storage) for _ in range(4))
    sizes = {tensor.storage.key: tensor.storage.dtype.itemsize for tensor in _tensors(loaded).values()}
    storages = {}
    for key in keys if isinstance(keys, list) else []:
        count = int.from_bytes(stream.read(8), "little")
        if key not in sizes:
            raise UnreadableError("it holds numbers that belong to no tensor of a state dict")
        storages[key] = stream.read(count * sizes[key])
    return loaded, storages


def _tensors(loaded: Any) -> dict[str, _Tensor]:
    """The tensors of a state dict or TorchScript module by dotted names."""
    if isinstance(loaded, dict) and isinstance(loaded.get("state_dict"), dict):
        loaded = loaded["state_dict"]
    found: dict[str, _Tensor] = {}
    steps = 0

    def visit(value: Any, names: tuple[str, ...]) -> None:
        nonlocal steps
        steps += 1
        if len(names) > DEEPEST or steps > MOST:
            raise UnreadableError("it is nested without end")
        if isinstance(value, Record):
            value = value.state
        if isinstance(value, _Tensor):
            found[".".join(names)] = value
        elif isinstance(value, dict):
            for name, entry in value.items():
                visit(entry, (*names, str(name)))

    visit(loaded, ())
    if not found:
        raise UnreadableError("it holds no tensors by name")
    prefix = "module."  # of torch.nn.DataParallel
    strip = all(name.startswith(prefix) for name in found)
    return {name.removeprefix(prefix) if strip else name: tensor for name, tensor in found.items()}


def _array(tensor: _Tensor, storages: Mapping[str, bytes]) -> np.ndarray:
    """The tensor's numbers, after a check that they lie within its storage."""
    storage, shape, stride = tensor.storage, tensor.shape, tensor.stride
    data = storages.get(storage.key)
    if data is None or len(data) != storage.size * storage.dtype.itemsize:
        held = "is missing" if data is None else f"has {len(data)} bytes"
        raise UnreadableError(f"storage {storage.key} of {storage.size} numbers {held}: it is cut off")
    counts = (tensor.offset, *shape, *stride)
    if len(shape) != len(stride) or not all(isinstance(count, int) and count >= 0 for count in counts):
        raise UnreadableError("a tensor has an invalid shape")
    last = tensor.offset + sum((length - 1) * step for length, step in zip(shape, stride, strict=True))
    numbers = int(np.prod(shape, dtype=object))
    if numbers > storage.size or (numbers and last >= storage.size):
        raise UnreadableError(f"a tensor of shape {shape} reaches beyond its storage of {storage.size} numbers")
    flat = np.frombuffer(data, storage.dtype)[tensor.offset :] if numbers else np.empty(0, storage.dtype)
    strides = [step * storage.dtype.itemsize for step in stride]
    return np.array(np.lib.stride_tricks.as_strided(flat, shape, strides))


def _storage(identifier: Any) -> _Storage:
    """The storage of a persistent id ("storage", type, key, device, count[, view])."""
    match identifier:
        case ("storage", Name("torch" | "torch.cuda", str(kind)), str(key), _, int(count), *view) if view in (
            [],
            [None],
        ):
            if kind not in STORAGE_TYPES:
                raise UnreadableError(f"it holds numbers of the kind {kind}")
            return _Storage(key, STORAGE_TYPES[kind], count)
    raise UnreadableError("its pickle refers to something that is not the storage of a tensor")


def _made(name: Any, arguments: Any) -> Any:
    """The few things that are understood without calling anything; a record of the rest."""
    match name, arguments:
        case Name("collections", "OrderedDict"), ():
            return {}
        case Name("collections", "OrderedDict"), (list(pairs),):  # as Python 2 wrote it
            return named(pairs)
        case Name("torch._utils", "_rebuild_tensor_v2" | "_rebuild_tensor"), (
            _Storage() as storage,
            int(offset),
            tuple(shape),
            tuple(stride),
            *_,
        ):
            return _Tensor(storage, offset, shape, stride)
        case Name("torch._utils", "_rebuild_parameter"), (_Tensor() as tensor, *_):
            return tensor
    return Record(name, arguments)
