"""GNM Head 3 (Google, Generative aNthropometric Model): `gnm_head.npz`.

Arrays as the public loader names them: `template_vertex_positions` (V, 3) metres, `vertex_identity_basis` (I, V, 3) and
`expression_basis` (E, V, 3) of unit variance, `expression_names`, `triangles` (T, 3), `template_joint_positions` (J,
3), `joint_identity_basis` (I, J, 3), `joint_names`, `vertex_groups` (G, V), `vertex_group_names`, `mirror_indices`.
The components of eyes, mouth, teeth and tongue stand one group after the other; the largest are kept. Landmarks are not
in the file. The axes are not documented: eyes, head and neck tell them.
"""

from pathlib import Path
from typing import Any

import numpy as np

from workbench.errors import ModelError
from workbench.face.checking import check_indices, check_numbers, whole_numbers
from workbench.face.formats.pickled_arrays import array_of
from workbench.face.formats.raw import STATISTICAL_RANGE, RawModel, check_mesh, ranges


def is_gnm(arrays: dict[str, Any]) -> bool:
    """Whether the arrays are a GNM model's."""
    return {"template_vertex_positions", "vertex_identity_basis"} <= set(arrays)


def gnm_model(path: Path, arrays: dict[str, Any], identity: int | None, expressions: int | None) -> RawModel:
    """GNM Head with at most this many components. Raises `ModelError` if parts are missing."""
    vertices = array_of(arrays, "template_vertex_positions", path).astype(float)
    triangles = whole_numbers(path, "triangles", array_of(arrays, "triangles", path))
    people = array_of(arrays, "vertex_identity_basis", path)
    faces = array_of(arrays, "expression_basis", path)
    check_mesh(path, vertices, triangles, {"vertex_identity_basis": people, "expression_basis": faces})
    names = _texts(path, arrays, "expression_names", len(faces))
    kept_people, kept_faces = _largest(people, identity), _largest(faces, expressions)
    joints, joint_deltas = _joints(path, arrays, kept_people, len(people))
    mirror = arrays.get("mirror_indices")
    if not isinstance(mirror, np.ndarray) or mirror.shape != (len(vertices),):
        mirror = None
    else:
        check_indices(path, "mirror_indices", mirror, mirror.shape, len(vertices))
    return RawModel(
        name=path.stem,
        vertices=vertices,
        triangles=triangles,
        expression_names=tuple(names[k] for k in kept_faces),
        expression_deltas=faces[kept_faces].astype(float),
        expression_range=ranges(len(kept_faces), STATISTICAL_RANGE),
        identity_deltas=people[kept_people].astype(float),
        joints=joints,
        identity_joint_deltas=joint_deltas,
        regions=_groups(path, arrays, len(vertices)),
        mirror=None if mirror is None else mirror.astype(np.int32),
    )


def _largest(basis: np.ndarray, most: int | None) -> np.ndarray:
    """Indices of the components that move the mesh most, in the file's order."""
    energy = np.einsum("kvd,kvd->k", basis, basis, dtype=float)
    return np.sort(np.argsort(-energy, kind="stable")[:most])


def _texts(path: Path, arrays: dict[str, Any], key: str, count: int) -> list[str]:
    texts = np.ravel(arrays[key]).tolist() if isinstance(arrays.get(key), np.ndarray) else arrays.get(key)
    if not isinstance(texts, list) or len(texts) != count or not all(isinstance(text, str) for text in texts):
        raise ModelError(f"{path}: {key} needs {count} names; supply gnm_head.npz as it was published.")
    return texts


def _joints(path: Path, arrays: dict[str, Any], kept: np.ndarray, people: int):
    places = array_of(arrays, "template_joint_positions", path).astype(float)
    moved = array_of(arrays, "joint_identity_basis", path).astype(float)
    check_numbers(path, "template_joint_positions", places, (None, 3))
    names = _texts(path, arrays, "joint_names", len(places))
    if moved.shape != (people, len(places), 3):
        raise ModelError(
            f"{path}: joint_identity_basis has shape {moved.shape}, expected ({people}, {len(places)}, 3)."
        )
    common = {name: _common_joint(name) for name in names}
    joints = {common[name]: places[k] for k, name in enumerate(names)}
    return joints, {common[name]: moved[kept, k] for k, name in enumerate(names)}


def _common_joint(name: str) -> str:
    """leftEye and rightEye for the eyes, however they are spelt."""
    lowered = name.lower()
    if "eye" in lowered and ("left" in lowered or "right" in lowered):
        return "leftEye" if "left" in lowered else "rightEye"
    return name


def _groups(path: Path, arrays: dict[str, Any], count: int) -> dict[str, np.ndarray] | None:
    weights = arrays.get("vertex_groups")
    if not isinstance(weights, np.ndarray) or weights.ndim != 2 or weights.shape[1] != count:
        return None
    names = _texts(path, arrays, "vertex_group_names", len(weights))
    return {name: np.flatnonzero(row > 0.5) for name, row in zip(names, weights, strict=True)}
