"""Weights on disk: safetensors files whose names are a module's fields, joined by dots as in a PyTorch state dict.

A safetensors file is a table of names, shapes and numbers with nothing to execute in it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import DictKey, KeyEntry, SequenceKey
from safetensors import safe_open
from safetensors.numpy import save

from workbench.errors import ModelError
from workbench.files import atomic_path
from workbench.reading import checked_file, reading, shortened

Module = TypeVar("Module", bound=eqx.Module)

FLOATS = ("float16", "float32")
"""Number formats of weights on disk; networks run in float32."""

ARCHITECTURE = "architecture"
"""Metadata key that says which network the weights are of."""

NAMED_IN_ERRORS = 3
"""So many names are listed where many are wrong."""


@dataclass(frozen=True, eq=False)
class Weights:
    """What a weights file holds."""

    arrays: Mapping[str, np.ndarray]
    metadata: Mapping[str, str]
    origin: str
    """The file's name, for errors."""

    @property
    def architecture(self) -> str | None:
        """Which network these are of, if the file says."""
        return self.metadata.get(ARCHITECTURE)

    def size_of(self, name: str) -> int:
        """How many numbers an array holds; 0 if the file has none of this name."""
        return self.arrays[name].size if name in self.arrays else 0


def read_weights(path: str | Path) -> Weights:
    """All arrays and the metadata of a safetensors file.

    Raises `InputError` for a file that is absent, cut off or not safetensors.
    """
    path = checked_file(
        path, "weights", absent=f"there is no weights file {path}; check the name and the folder.", may_be_empty=True
    )
    remedy = (
        "it is cut off or of another kind; get it again, or make one from a PyTorch checkpoint with: "
        "workbench weights convert FILE"
    )
    with reading(path, "a safetensors file", remedy), safe_open(path, framework="numpy") as file:
        arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (safe_open is no mapping)
        return Weights(arrays, dict(file.metadata() or {}), str(path))


def write_weights(path: str | Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Write a safetensors file, completely or not at all. Raises `OutputError` where that cannot be."""
    packed = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    content = save(packed, metadata=dict(metadata))
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)  # the library's own writer reports a full disk by an error of its own


def named_arrays(module: eqx.Module) -> dict[str, jax.Array]:
    """A module's arrays by name, as `e1.0.weight`.

    The entries of a field that is a dict are named as if they were fields themselves: PyTorch's `add_module("m0", …)`.
    """
    return {_name(path): leaf for path, leaf in jax.tree_util.tree_flatten_with_path(module)[0]}


def fill(empty: Callable[[], Module], weights: Weights) -> Module:
    """The module that `empty` makes, with the arrays of `weights` as float32.

    Every array of the module must be in the file and every array of the file in the module, of the same shape.
    Raises `ModelError` with the first names that are missing, unknown or of another shape.
    """
    wanted = eqx.filter_eval_shape(empty)
    leaves, structure = jax.tree_util.tree_flatten_with_path(wanted)
    shapes = {_name(path): leaf.shape for path, leaf in leaves}
    _check(shapes, weights)
    return jax.tree.unflatten(structure, [jnp.asarray(weights.arrays[name], jnp.float32) for name in shapes])


def save_module(path: str | Path, module: eqx.Module, metadata: Mapping[str, str]) -> None:
    """Write a module's arrays under their names, completely or not at all; `fill` reads them back."""
    write_weights(path, {name: np.asarray(array) for name, array in named_arrays(module).items()}, metadata)


def _check(shapes: Mapping[str, tuple[int, ...]], weights: Weights) -> None:
    missing = [name for name in shapes if name not in weights.arrays]
    unknown = [name for name in weights.arrays if name not in shapes]
    advice = "these are not the weights of this network, or of another version of it"
    if missing:
        raise ModelError(
            f"{weights.origin} lacks {_listed(missing)} of the {len(shapes)} arrays that the network needs: {advice}"
        )
    if unknown:
        raise ModelError(f"{weights.origin} holds {_listed(unknown)}, which the network does not have: {advice}")
    for name, shape in shapes.items():
        array = weights.arrays[name]
        if array.shape != shape:
            raise ModelError(f"{name} in {weights.origin} should have shape {shape}, got {array.shape}: {advice}")
        if array.dtype.name not in FLOATS:
            raise ModelError(
                f"{name} in {weights.origin} holds {array.dtype.name} numbers: weights are {' or '.join(FLOATS)}"
            )
        if not np.isfinite(array).all():
            raise ModelError(f"{name} in {weights.origin} holds numbers that are not finite: get the file again")


def _listed(names: list[str]) -> str:
    shown = shortened(", ".join(names[:NAMED_IN_ERRORS]))
    more = len(names) - NAMED_IN_ERRORS
    return f"{shown} and {more} more" if more > 0 else shown


def _name(path: tuple[KeyEntry, ...]) -> str:
    parts: list[str] = []
    for key in path:
        if isinstance(key, DictKey):
            parts[-1:] = [str(key.key)]
        else:
            parts.append(str(key.idx) if isinstance(key, SequenceKey) else key.name)
    return ".".join(parts)
