"""The Basel Face Model: 2009 (.mat of MATLAB), 2017 and 2019 (.h5 of scalismo).

2009: `shapeMU` (3V, 1), `shapePC` (3V, 199) orthonormal, `shapeEV` standard deviations, `texMU` 0 to 255, `tl` (T, 3)
counted from 1 and wound the other way round; micrometres; no expressions. 2017 and 2019: groups `shape`, `expression`
and `color`, each with `model/mean` (3V), `model/pcaBasis` (3V, n) orthonormal and `model/pcaVariance` (n);
`shape/representer/cells` and `points`; millimetres; named points in `metadata/landmarks/json`. Axes of all: +x
subject's left, +y up, +z out of the face.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from workbench.errors import ModelError
from workbench.face.checking import whole_numbers
from workbench.face.formats.hdf5 import hdf5_arrays
from workbench.face.formats.matlab import is_level_73, matlab_arrays
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
from workbench.reading import checked_content, checked_file, checked_json, reading

REMEDY = "supply the file as it was published"
MAT_KEYS = ("shapeMU", "shapePC", "shapeEV", "tl")
COLOR_KEY = "texMU"
H5_PARTS = ("shape", "expression")
H5_KEYS = (
    *(f"{part}/model/{key}" for part in H5_PARTS for key in ("mean", "pcaBasis", "pcaVariance")),
    *("shape/representer/cells", "shape/representer/points", "color/model/mean"),
)
LANDMARKS_KEY = "metadata/landmarks/json"
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
    content = checked_content(path, "a Basel Face Model", ModelError)
    with reading(path, "a MATLAB file", REMEDY, ModelError):
        keys = (*MAT_KEYS, COLOR_KEY)
        if is_level_73(content):  # HDF5, with transposed arrays
            return _from_mat(path, {key: array.T for key, array in hdf5_arrays(path, keys).items()}, identity)
        return _from_mat(path, matlab_arrays(content, keys), identity)


def _from_mat(path: Path, stored: Mapping[str, np.ndarray], identity: int | None) -> RawModel:
    missing = [key for key in MAT_KEYS if key not in stored]
    if missing:
        raise ModelError(
            f"{path} is not a Basel Face Model of 2009: {missing[0]} is missing; supply 01_MorphableModel.mat."
        )
    vertices = _points(path, "shapeMU", stored["shapeMU"])
    basis = _basis(path, "shapePC", stored["shapePC"], np.ravel(stored["shapeEV"]), len(vertices), identity)
    triangles = np.atleast_2d(whole_numbers(path, "tl", stored["tl"]))[:, ::-1] - 1
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
        colors=_colors(path, stored[COLOR_KEY], len(vertices)) if COLOR_KEY in stored else None,
        axes=Y_UP,
        notes=("The Basel Face Model of 2009 has no expressions: only pose and identity can be fitted.",),
    )


def read_basel_h5(path: Path, identity: int | None, expressions: int | None) -> RawModel:
    """A model of 2017 or 2019. Raises `ModelError` for another file."""
    checked_file(path, "a Basel Face Model", ModelError)
    with reading(path, "HDF5", REMEDY, ModelError):
        return _from_h5(path, hdf5_arrays(path, (*H5_KEYS, LANDMARKS_KEY)), identity, expressions)


def _from_h5(path: Path, stored: Mapping[str, np.ndarray], identity: int | None, expressions: int | None) -> RawModel:
    vertices = _points(path, "shape/model/mean", _stored(path, stored, "shape/model/mean"))
    count = len(vertices)
    basis = _h5_basis(path, stored, "shape", count, identity)
    deltas = np.zeros((0, count, 3))
    if any(key.startswith("expression/") for key in stored):
        deltas = _h5_basis(path, stored, "expression", count, expressions)
        # The mean expression of the scans is an offset; the neutral face of the fit holds it.
        offset = _points(path, "expression/model/mean", _stored(path, stored, "expression/model/mean"))
        vertices = vertices + offset
    cells = whole_numbers(path, "shape/representer/cells", _stored(path, stored, "shape/representer/cells"))
    triangles = cells.T if len(np.atleast_1d(cells)) == 3 and cells.shape[1:] != (3,) else cells
    check_mesh(path, vertices, triangles, {"shape basis": basis, "expression basis": deltas})
    colors = _colors(path, stored["color/model/mean"], count) if "color/model/mean" in stored else None
    return RawModel(
        name=path.stem,
        vertices=vertices,
        triangles=triangles,
        expression_names=statistical_names(len(deltas)),
        expression_deltas=deltas,
        expression_range=ranges(len(deltas), STATISTICAL_RANGE),
        identity_deltas=basis,
        landmarks=_named_points(path, stored, vertices) if LANDMARKS_KEY in stored else {},
        colors=colors,
        axes=Y_UP,
    )


def _stored(path: Path, stored: Mapping[str, np.ndarray], key: str) -> np.ndarray:
    if key not in stored:
        raise ModelError(f"{path} is not a Basel Face Model of 2017 or 2019: {key} is missing.")
    return stored[key]


def _h5_basis(path: Path, stored: Mapping[str, np.ndarray], part: str, count: int, most: int | None) -> np.ndarray:
    variance = np.ravel(_stored(path, stored, f"{part}/model/pcaVariance"))
    basis = _stored(path, stored, f"{part}/model/pcaBasis")
    return _basis(path, f"{part}/model/pcaBasis", basis, np.sqrt(np.maximum(variance, 0.0)), count, most)


def _points(path: Path, key: str, flat: np.ndarray) -> np.ndarray:
    if flat.size == 0 or flat.size % 3:
        raise ModelError(f"{path}: {key} holds {flat.size} numbers, expected three per vertex; the file is damaged.")
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
    if len(colors) != count or not np.isfinite(colors).all():
        raise ModelError(f"{path}: {len(colors)} colours for {count} vertices, or not finite; the file is damaged.")
    scale = 255.0 if colors.max() <= 1.5 else 1.0
    return np.clip(np.round(colors * scale), 0, 255).astype(np.uint8)


def _named_points(path: Path, stored: Mapping[str, np.ndarray], vertices: np.ndarray) -> dict[int, Place]:
    try:
        points = checked_json(stored[LANDMARKS_KEY].tobytes())
        found = {str(point["id"]): np.array(point["coordinates"], float).reshape(3) for point in points}
    except (ValueError, TypeError, KeyError) as error:
        raise ModelError(f"{path}: {LANDMARKS_KEY} is not the list of points of the publication.") from error
    # The points lie on the reference mesh, whose vertices correspond to the mean's.
    reference = np.asarray(stored.get("shape/representer/points", vertices), float)
    reference = reference.T if len(reference) == 3 and reference.shape[1:] != (3,) else reference
    if reference.shape != vertices.shape:
        raise ModelError(f"{path}: the reference has {len(reference)} vertices, the mean {len(vertices)}.")
    tree = cKDTree(reference)
    return {
        number: vertex_place(int(tree.query(found[name])[1]))
        for name, number in LANDMARK_NAMES.items()
        if name in found
    }
