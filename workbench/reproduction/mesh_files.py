"""Meshes that other programs made of a picture, as they are in their files: 3DDFA, PRNet, VRN and the like.

OBJ files hold vertices and faces. PRNet's `_mesh.mat` has `vertices` (n × 3) and `triangles` counted from 0, 3DDFA's
`.mat` has `vertex` (3 × n) alone, and `.npy` files are arrays of vertices.
"""

import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from workbench.errors import InputError, ModelError, WorkbenchError
from workbench.face.checking import check_indices, check_numbers, whole_numbers
from workbench.face.formats.matlab import matlab_arrays
from workbench.face.formats.obj import read_obj
from workbench.reading import array_header, check_numbers_held, checked_content, checked_file, reading, shortened

KIND = "a mesh"
VERTICES, TRIANGLES = ("vertices", "vertex"), ("triangles", "tri")
"""Names of variables in MATLAB's files."""
SUFFIXES = (".obj", ".mat", ".npy")
FEWEST = 4
"""Vertices of a mesh."""
KNOWN_SHAPES = {
    (200, 192, 192): "VRN's volume; make an OBJ of it with VRN's raw2obj.py",
    (256, 256, 3): "PRNet's position map; save the vertices that PRNet's get_vertices makes of it",
}
"""Arrays that these programs also write."""


class OtherMesh(NamedTuple):
    """A mesh in the coordinates of its file."""

    vertices: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "t 3"] | None
    """None where the file has none."""


@dataclass(frozen=True)
class FoundMesh:
    """A mesh of a folder."""

    program: str
    """The folder that it is in."""
    frame: int
    path: Path
    mesh: OtherMesh


def read_mesh(path: str | Path) -> OtherMesh:
    """The mesh of an OBJ, MAT or NPY file. Raises `ModelError` for a file without one, `InputError` for other files."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path} is not an OBJ, MAT or NPY file; other kinds of meshes are not read.")
    checked_file(path, KIND, ModelError)
    with reading(path, KIND, "write it again", ModelError):
        if suffix == ".obj":
            mesh = read_obj(path)
            return OtherMesh(mesh.vertices, mesh.triangles.astype(np.int64))
        return _from_mat(path) if suffix == ".mat" else OtherMesh(_rows_of_three(path, _array(path)), None)


def read_mesh_folder(folder: Path, frames: Collection[int]) -> tuple[tuple[FoundMesh, ...], tuple[str, ...]]:
    """The meshes below a folder, each program's in a folder of its name, and a sentence for every other file.

    Their names begin with that of the picture, `frame_N`. Of several files of a frame the first with triangles counts.
    Raises `InputError` if there is no such folder.
    """
    if not folder.exists():
        raise InputError(f"The folder of meshes {folder} does not exist; check the name.")
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; name the one that holds a folder of meshes for each program.")
    found: dict[tuple[str, int], FoundMesh] = {}
    problems = []
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            problems += _read_program(path, frames, found)
        elif path.suffix.lower() in SUFFIXES:
            problems.append(f"{path} belongs to no program; put it into a folder with the program's name.")
    return tuple(found.values()), tuple(problems)


def _read_program(folder: Path, frames: Collection[int], found: dict[tuple[str, int], FoundMesh]) -> list[str]:
    problems, others = [], []
    for path in sorted(folder.iterdir()):
        named = re.match(r"frame_(\d+)(?!\d)", path.name)
        if path.suffix.lower() not in SUFFIXES:
            others.append(path.name)
        elif named is None or int(named[1]) not in frames:
            names = ", ".join(f"frame_{frame}" for frame in sorted(frames))
            problems.append(f"{path} belongs to no picture here; its name should begin with one of {names}.")
        else:
            key = folder.name, int(named[1])
            try:
                mesh = read_mesh(path)
            except WorkbenchError as error:
                problems.append(str(error))
                continue
            if key not in found or (found[key].mesh.triangles is None and mesh.triangles is not None):
                found[key] = FoundMesh(*key, path, mesh)
    if others:
        problems.append(
            f"{folder} has files that are not OBJ, MAT or NPY and were left out: {shortened(', '.join(others))}."
        )
    return problems


def _from_mat(path: Path) -> OtherMesh:
    stored = matlab_arrays(checked_content(path, KIND, ModelError), (*VERTICES, *TRIANGLES))
    vertices = next((stored[name] for name in VERTICES if name in stored), None)
    if vertices is None:
        raise ModelError(f"{path} has neither {' nor '.join(VERTICES)} among its variables; save the vertices as one.")
    rows = _rows_of_three(path, vertices)
    triangles = next((stored[name] for name in TRIANGLES if name in stored), None)
    return OtherMesh(rows, None if triangles is None else _from_zero(path, triangles, len(rows)))


def _array(path: Path) -> np.ndarray:
    with path.open("rb") as stream:
        shape, dtype = array_header(stream)
        if dtype.hasobject:
            raise ModelError(f"{path} holds Python objects, which are not read; save an array of vertices.")
        check_numbers_held(path.name, shape, dtype, path.stat().st_size)
        stream.seek(0)
        return np.load(stream, allow_pickle=False)


def _rows_of_three(path: Path, array: np.ndarray) -> Float[np.ndarray, "n 3"]:
    """One vertex per row, whichever way round the file stores them."""
    if array.shape in KNOWN_SHAPES:
        raise ModelError(f"{path} holds {KNOWN_SHAPES[array.shape]}.")
    if array.ndim == 2 and array.shape[0] == 3 and array.shape[1] != 3:
        array = array.T
    if array.ndim != 2 or array.shape[1] != 3 or len(array) < FEWEST:
        raise ModelError(
            f"{path} holds an array of the shape {shortened(array.shape)}, expected vertices, n × 3 or 3 × n."
        )
    check_numbers(path, "the array of vertices", array, array.shape)
    return array.astype(float)


def _from_zero(path: Path, array: np.ndarray, count: int) -> Int[np.ndarray, "t 3"]:
    """One triangle per row, vertices counted from 0; MATLAB's programs count from 1."""
    if array.ndim == 2 and array.shape[0] == 3 and array.shape[1] != 3:
        array = array.T
    triangles = whole_numbers(path, "the array of triangles", array)
    if triangles.size and triangles.min() > 0 and triangles.max() == count:
        triangles = triangles - 1
    check_indices(path, "the array of triangles", triangles, (None, 3), count)
    return triangles
