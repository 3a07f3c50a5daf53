"""The Basel Face Model: 2009 (.mat of MATLAB), 2017 and 2019 (.h5 of scalismo).

2009: `shapeMU` (3V, 1), `shapePC` (3V, 199) orthonormal, `shapeEV` standard deviations, `texMU` 0 to 255, `tl` (T, 3)
counted from 1 and wound the other way round; micrometres; no expressions. 2017 and 2019: groups `shape`, `expression`
and `color`, each with `model/mean` (3V), `model/pcaBasis` (3V, n) orthonormal and `model/pcaVariance` (n);
`shape/representer/cells` and `points`; millimetres; named points in `metadata/landmarks/json`. Axes of all: +x
subject's left, +y up, +z out of the face.
"""

import json
from pathlib import Path

import h5py
import numpy as np
import scipy.io
from scipy.spatial import cKDTree

from workbench.errors import ModelError
from workbench.face.formats.raw import (
    STATISTICAL_RANGE,
    Y_UP,
    Place,
    RawModel,
    check_mesh,
    ranges,
    statistical_names,
    vertex_place,
)

MAT_KEYS = ("shapeMU", "shapePC", "shapeEV", "tl")
VERTICES_2009 = 53490
LANDMARKS_2009 = {
    **{17: 38792, 19: 40087, 21: 40514, 22: 41091, 24: 41511, 26: 42825, 30: 8319, 33: 8334, 36: 2088, 39: 5959},
    **{42: 10603, 45: 14472, 48: 5006, 51: 8344, 54: 11714, 57: 8374, 62: 8354, 66: 8366},
}
"""Vertices of the 2009 mesh for iBUG points, as the library eos maps them (share/ibug_to_bfm.txt, Apache-2.0)."""
LANDMARK_NAMES = {
    "center.chin.tip": 8,
    "center.nose.tip": 30,
    "right.eye.corner_outer": 36,
    "right.eye.corner_inner": 39,
    "left.eye.corner_inner": 42,
    "left.eye.corner_outer": 45,
    "right.lips.corner": 48,
    "center.lips.upper.outer": 51,
    "left.lips.corner": 54,
    "center.lips.lower.outer": 57,
    "center.lips.upper.inner": 62,
    "center.lips.lower.inner": 66,
}
"""iBUG points among the named points of the 2017 and 2019 files."""


def read_basel_mat(path: Path, identity: int | None) -> RawModel:
    """The model of 2009. Raises `ModelError` for another file."""
    stored = _mat(path)
    missing = [key for key in MAT_KEYS if key not in stored]
    if missing:
        raise ModelError(
            f"{path} is no Basel Face Model of 2009: {missing[0]} is missing; supply 01_MorphableModel.mat."
        )
    vertices = _points(path, "shapeMU", stored["shapeMU"])
    basis = _basis(path, "shapePC", stored["shapePC"], np.ravel(stored["shapeEV"]), len(vertices), identity)
    triangles = np.asarray(stored["tl"], np.int64)[:, ::-1] - 1
    check_mesh(path, vertices, triangles, {"shapePC": basis})
    known = {point: vertex_place(vertex) for point, vertex in LANDMARKS_2009.items()}
    return RawModel(
        name=path.stem,
        vertices=vertices,
        triangles=triangles,
        expression_names=(),
        expression_deltas=np.zeros((0, len(vertices), 3)),
        expression_range=ranges(0),
        identity_deltas=basis,
        landmarks=known if len(vertices) == VERTICES_2009 else {},
        colors=_colors(path, stored["texMU"], len(vertices)) if "texMU" in stored else None,
        axes=Y_UP,
        notes=("The Basel Face Model of 2009 has no expressions: only pose and identity can be fitted.",),
    )


def read_basel_h5(path: Path, identity: int | None, expressions: int | None) -> RawModel:
    """A model of 2017 or 2019. Raises `ModelError` for another file."""
    try:
        with h5py.File(path, "r") as stored:
            return _from_h5(path, stored, identity, expressions)
    except OSError as error:
        raise ModelError(f"{path} cannot be read as HDF5 ({error}); download it again.") from error


def _from_h5(path: Path, stored: h5py.File, identity: int | None, expressions: int | None) -> RawModel:
    vertices = _points(path, "shape/model/mean", _dataset(path, stored, "shape/model/mean"))
    count = len(vertices)
    basis = _h5_basis(path, stored, "shape", count, identity)
    deltas = np.zeros((0, count, 3))
    if "expression" in stored:
        deltas = _h5_basis(path, stored, "expression", count, expressions)
        # The mean expression of the scans is an offset; the neutral face of the fit holds it.
        offset = _points(path, "expression/model/mean", _dataset(path, stored, "expression/model/mean"))
        vertices = vertices + offset
    cells = np.asarray(_dataset(path, stored, "shape/representer/cells"), np.int64)
    triangles = cells.T if cells.shape[0] == 3 and cells.shape[1:] != (3,) else cells
    check_mesh(path, vertices, triangles, {"shape basis": basis, "expression basis": deltas})
    colors = _colors(path, stored["color/model/mean"][()], count) if "color/model/mean" in stored else None
    return RawModel(
        name=path.stem,
        vertices=vertices,
        triangles=triangles,
        expression_names=statistical_names(len(deltas)),
        expression_deltas=deltas,
        expression_range=ranges(len(deltas), STATISTICAL_RANGE),
        identity_deltas=basis,
        landmarks=_named_points(path, stored, vertices),
        colors=colors,
        axes=Y_UP,
    )


def _mat(path: Path) -> dict[str, np.ndarray]:
    try:
        stored = scipy.io.loadmat(path, variable_names=[*MAT_KEYS, "texMU"])
        return {key: value for key, value in stored.items() if isinstance(value, np.ndarray)}
    except NotImplementedError:  # MATLAB 7.3 is HDF5, with transposed arrays
        with h5py.File(path, "r") as stored:
            return {key: np.asarray(stored[key]).T for key in (*MAT_KEYS, "texMU") if key in stored}
    except Exception as error:
        raise ModelError(f"{path} cannot be read as a MATLAB file ({error}); download it again.") from error


def _dataset(path: Path, stored: h5py.File, key: str) -> np.ndarray:
    if key not in stored or not isinstance(stored[key], h5py.Dataset):
        raise ModelError(f"{path} is no Basel Face Model of 2017 or 2019: {key} is missing.")
    return stored[key][()]


def _h5_basis(path: Path, stored: h5py.File, part: str, count: int, most: int | None) -> np.ndarray:
    variance = np.ravel(_dataset(path, stored, f"{part}/model/pcaVariance"))
    basis = _dataset(path, stored, f"{part}/model/pcaBasis")
    return _basis(path, f"{part}/model/pcaBasis", basis, np.sqrt(np.maximum(variance, 0.0)), count, most)


def _points(path: Path, key: str, flat: np.ndarray) -> np.ndarray:
    if flat.size == 0 or flat.size % 3:
        raise ModelError(f"{path}: {key} holds {flat.size} numbers, expected three a vertex; the file is damaged.")
    return np.asarray(flat, float).reshape(-1, 3)


def _basis(path: Path, key: str, basis: np.ndarray, deviation: np.ndarray, count: int, most: int | None) -> np.ndarray:
    if basis.ndim != 2 or basis.shape[0] != 3 * count or basis.shape[1] != len(deviation):
        raise ModelError(
            f"{path}: {key} has shape {basis.shape}, expected ({3 * count}, {len(deviation)}); the file is damaged."
        )
    scaled = basis[:, :most].astype(float) * deviation[:most]
    return np.ascontiguousarray(scaled.T).reshape(-1, count, 3)


def _colors(path: Path, mean: np.ndarray, count: int) -> np.ndarray:
    colors = _points(path, "the mean colour", mean)
    if len(colors) != count:
        raise ModelError(f"{path}: {len(colors)} colours for {count} vertices; the file is damaged.")
    scale = 255.0 if colors.max() <= 1.5 else 1.0
    return np.clip(np.round(colors * scale), 0, 255).astype(np.uint8)


def _named_points(path: Path, stored: h5py.File, vertices: np.ndarray) -> dict[int, Place]:
    if "metadata/landmarks/json" not in stored:
        return {}
    text = np.ravel(np.asarray(stored["metadata/landmarks/json"][()], object))[0]
    try:
        points = json.loads(text)
        found = {point["id"]: np.array(point["coordinates"], float) for point in points}
    except (ValueError, TypeError, KeyError) as error:
        raise ModelError(f"{path}: metadata/landmarks/json is not the list of points of the publication.") from error
    # The points lie on the reference mesh, whose vertices correspond to the mean's.
    reference = vertices
    if "shape/representer/points" in stored:
        reference = np.asarray(stored["shape/representer/points"][()], float)
        reference = reference.T if reference.shape[0] == 3 and reference.shape[1:] != (3,) else reference
    if reference.shape != vertices.shape:
        raise ModelError(f"{path}: the reference has {len(reference)} vertices, the mean {len(vertices)}.")
    tree = cKDTree(reference)
    return {
        number: vertex_place(int(tree.query(found[name])[1]))
        for name, number in LANDMARK_NAMES.items()
        if name in found
    }
