"""Checkpoints as `torch.save` of PyTorch 0.2 wrote them under Python 2, made without PyTorch."""

import pickle
from collections.abc import Mapping
from pathlib import Path

import numpy as np

MAGIC, PROTOCOL = 0x1950A86A20F9469CFC6C, 1001


def write_old_checkpoint(path: Path, arrays: Mapping[str, np.ndarray]) -> Path:
    """The stream {"epoch": 0, "state_dict": arrays, "best_EPE": 1e10}; every array has a storage of its own."""
    keys = [str(key) for key in range(len(arrays))]
    state = b"".join(_entry(key, *item) for key, item in zip(keys, arrays.items(), strict=True))
    ordered = b"ccollections\nOrderedDict\n((l" + state + b"tR"
    structure = b"}S'epoch'\nI0\nsS'state_dict'\n" + ordered + b"sS'best_EPE'\nF1e10\ns."
    system = {"little_endian": True, "protocol_version": PROTOCOL, "type_sizes": {"int": 4, "long": 8, "short": 2}}
    data = b"".join(array.size.to_bytes(8, "little") + array.astype("<f4").tobytes() for array in arrays.values())
    heads = b"".join(pickle.dumps(value, protocol=2) for value in (MAGIC, PROTOCOL, system))
    path.write_bytes(heads + structure + pickle.dumps(keys, protocol=2) + data)
    return path


def _entry(key: str, name: str, array: np.ndarray) -> bytes:
    """[name, tensor] in pickle's text opcodes."""
    storage = f"(S'storage'\nctorch\nFloatStorage\nS'{key}'\nS'cpu'\nI{array.size}\nNtQ"
    strides = [step // array.itemsize for step in np.empty(array.shape, array.dtype).strides]
    tensor = f"ctorch._utils\n_rebuild_tensor\n({storage}I0\n{_tuple(array.shape)}{_tuple(strides)}tR"
    return f"(S'{name}'\n{tensor}la".encode()


def _tuple(numbers) -> str:
    return "(" + "".join(f"I{number}\n" for number in numbers) + "t"
