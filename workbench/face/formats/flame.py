"""FLAME 2020 and 2023 (Li et al. 2017): .pkl of Python 2 or 3, or .npz, with the published landmark embeddings.

Arrays as the public loaders use them: `v_template` (V, 3) metres, `f` (T, 3), `shapedirs` (V, 3, 400) of which 300 are
identity and 100 expression (older and cut files: 20, ten of each), `J_regressor` (5, V) with the joints root, neck,
jaw, left eye, right eye, `weights` (V, 5) for skinning, `posedirs` (V, 3, 36). Axes: +x subject's left, +y up, +z out
of the face. FLAME opens the mouth by its jaw joint alone, so that `jawOpen`, `jawLeft`, `jawRight` are made from it.
"""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.errors import ModelError
from workbench.face.checking import check_embedding, check_numbers, index_beyond, whole_numbers
from workbench.face.formats.pickled_arrays import array_of, read_arrays
from workbench.face.formats.raw import (
    STATISTICAL_RANGE,
    Y_UP,
    Place,
    RawModel,
    check_mesh,
    places_of,
    ranges,
    statistical_names,
)
from workbench.face.jaw_unit import USUAL_JAW
from workbench.face.model import Embedding

BASES = {400: (300, 300), 20: (10, 10)}
"""By the number of shape directions: where identity ends and expression begins."""
JOINTS = ("root", "neck", "jaw", "leftEye", "rightEye")
JAW = JOINTS.index("jaw")
JAW_TURNS_DEG = {
    "jawOpen": (USUAL_JAW.open_deg, 0.0, 0.0),
    "jawLeft": (0.0, 6.0, 0.0),
    "jawRight": (0.0, -6.0, 0.0),
}
"""What weight 1 turns the jaw by, about +x and +y of FLAME's axes; `jawOpen` as the default head's joint does."""
CONTOUR_YAWS = (-39, -30, -20, -10, 0, 10, 20, 30, 39)
COMPANIONS = ("landmark_embedding*.npy", "flame_static_embedding*", "flame_dynamic_embedding*.npy")
INDEX_KEYS = ("full_lmk_faces_idx", "lmk_face_idx", "lmk_faces_idx", "static_lmk_faces_idx")
WEIGHT_KEYS = ("full_lmk_bary_coords", "lmk_b_coords", "lmk_bary_coords", "static_lmk_bary_coords")


def is_flame(arrays: dict[str, Any]) -> bool:
    """Whether the arrays are a FLAME model's."""
    return {"v_template", "shapedirs"} <= set(arrays)


def flame_model(
    path: Path, arrays: dict[str, Any], identity: int | None, expressions: int | None, embeddings: list[Path]
) -> RawModel:
    """FLAME as it is stored, with at most this many components. Raises `ModelError` if parts are missing."""
    vertices = array_of(arrays, "v_template", path).astype(float)
    triangles = whole_numbers(path, "f", array_of(arrays, "f", path))
    directions = array_of(arrays, "shapedirs", path)
    if directions.ndim != 3 or directions.shape[-1] not in BASES:
        raise ModelError(
            f"{path}: shapedirs has shape {directions.shape}, FLAME's is (5023, 3, 400); supply the file as published."
        )
    first, second = BASES[directions.shape[-1]]
    basis = np.moveaxis(directions, -1, 0).astype(float)
    identity_deltas, deltas = basis[:first][:identity], basis[second:][:expressions]
    check_mesh(path, vertices, triangles, {"shapedirs": basis})
    names, bounds = statistical_names(len(deltas)), ranges(len(deltas), STATISTICAL_RANGE)
    joints, joint_deltas, jaw_weights = {}, {}, None
    if "J_regressor" in arrays:
        regressor = _regressor(path, arrays, len(vertices))
        moved = np.einsum("jv,ivd->jid", regressor, identity_deltas)
        order = _subjects_sides(regressor @ vertices)
        joints = dict(zip(order, regressor @ vertices, strict=True))
        joint_deltas = dict(zip(order, moved, strict=True))
        if "weights" in arrays:
            jaw_weights = _skinning(path, arrays, len(vertices))[:, JAW]
            opened = _jaw_shapes(path, arrays, vertices, joints["jaw"], jaw_weights)
            deltas = np.concatenate([deltas, np.stack(list(opened.values()))])
            names, bounds = (*names, *opened), np.concatenate([bounds, ranges(len(opened))])
    landmarks, yaws, contour = _embeddings(embeddings, triangles, vertices)
    return RawModel(
        name=path.stem,
        vertices=vertices,
        triangles=triangles,
        expression_names=names,
        expression_deltas=deltas,
        expression_range=bounds,
        identity_deltas=identity_deltas,
        landmarks=landmarks,
        contour_yaw_deg=yaws,
        contour=contour,
        joints=joints,
        identity_joint_deltas=joint_deltas,
        jaw_weights=jaw_weights,
        axes=Y_UP,
    )


def companions(path: Path) -> list[Path]:
    """The landmark embeddings that lie beside a model, under the names of their publication."""
    return [found for pattern in COMPANIONS for found in sorted(path.parent.glob(pattern))]


def _subjects_sides(joints: np.ndarray) -> tuple[str, ...]:
    """Names of the joints, the left eye being the one at the subject's left, +x."""
    return JOINTS if joints[3, 0] > joints[4, 0] else (*JOINTS[:3], "rightEye", "leftEye")


def _regressor(path: Path, arrays: dict[str, Any], count: int) -> np.ndarray:
    regressor = array_of(arrays, "J_regressor", path).astype(float)
    if regressor.shape != (len(JOINTS), count):
        raise ModelError(f"{path}: J_regressor has shape {regressor.shape}, expected ({len(JOINTS)}, {count}).")
    check_numbers(path, "J_regressor", regressor, regressor.shape)
    return regressor


def _skinning(path: Path, arrays: dict[str, Any], count: int) -> np.ndarray:
    weights = array_of(arrays, "weights", path).astype(float)
    if weights.shape != (count, len(JOINTS)):
        raise ModelError(f"{path}: weights has shape {weights.shape}, expected ({count}, {len(JOINTS)}).")
    check_numbers(path, "weights", weights, weights.shape)
    return weights


def _jaw_shapes(path, arrays, vertices, joint, weights) -> dict[str, np.ndarray]:
    """Offsets of the vertices when the jaw turns: linear blend skinning with FLAME's pose correctives."""
    count = len(vertices)
    correctives = np.zeros((count, 3, 9))
    if "posedirs" in arrays:
        stored = array_of(arrays, "posedirs", path).astype(float)
        if stored.shape != (count, 3, 9 * (len(JOINTS) - 1)):
            raise ModelError(f"{path}: posedirs has shape {stored.shape}, expected ({count}, 3, 36).")
        check_numbers(path, "posedirs", stored, stored.shape)
        # Nine numbers R − I a joint, the root left out.
        correctives = stored[:, :, 9 * (JAW - 1) : 9 * JAW]
    shapes = {}
    for name, degrees in JAW_TURNS_DEG.items():
        rotation = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
        shaped = vertices + correctives @ (rotation - np.eye(3)).ravel()
        turned = (shaped - joint) @ rotation.T + joint
        shapes[name] = (1.0 - weights[:, None]) * shaped + weights[:, None] * turned - vertices
    return shapes


def _embeddings(
    paths: list[Path], triangles: np.ndarray, vertices: np.ndarray
) -> tuple[dict[int, Place], Float[np.ndarray, "b"] | None, Embedding | None]:
    landmarks: dict[int, Place] = {}
    yaws, contour = None, None
    for path in paths:
        stored = read_arrays(path)
        index_key = next((key for key in INDEX_KEYS if isinstance(stored.get(key), np.ndarray)), None)
        weight_key = next((key for key in WEIGHT_KEYS if isinstance(stored.get(key), np.ndarray)), None)
        if index_key is None or weight_key is None:
            raise ModelError(f"{path} holds no landmark embedding (lmk_face_idx, lmk_b_coords); remove or replace it.")
        embedding = _embedding(path, array_of(stored, index_key, path), array_of(stored, weight_key, path), triangles)
        check_embedding(path, "the embedding", embedding, embedding.vertices.shape[:-1], len(vertices))
        count = len(embedding.vertices)
        if embedding.vertices.ndim == 3 and embedding.vertices.shape[:2] == (79, 17):
            yaws, contour = _contour(embedding, vertices)
        elif embedding.vertices.ndim == 2 and count in (51, 68):
            landmarks |= places_of(embedding, 68 - count)
        else:
            raise ModelError(f"{path} embeds {count} landmarks, expected 51, 68 or 79 contours of 17.")
    if contour is not None and 0 not in landmarks:
        frontal = CONTOUR_YAWS.index(0)
        landmarks |= places_of(Embedding(contour.vertices[frontal], contour.barycentric[frontal]))
    return landmarks, yaws, contour


def _embedding(path: Path, faces: np.ndarray, weights: np.ndarray, triangles: np.ndarray) -> Embedding:
    faces = whole_numbers(path, "the list of triangles", faces)
    faces, weights = (faces[0], weights[0]) if faces.ndim == 2 and len(faces) == 1 else (faces, weights)
    worst = index_beyond(faces, len(triangles))
    if weights.shape != (*faces.shape, 3) or worst is not None:
        named = faces.max(initial=0) if worst is None else worst
        raise ModelError(
            f"{path} names triangle {named} with weights {weights.shape}, the model has "
            f"{len(triangles)} triangles; take the embedding that belongs to it."
        )
    return Embedding(triangles[faces].astype(np.int32), np.asarray(weights, float))


def _contour(table: Embedding, vertices: np.ndarray) -> tuple[Float[np.ndarray, "b"], Embedding]:
    """The published table by our yaws. Entry a is a turn by a degrees, entry 39 + a one by −a, up to 39 degrees.

    The public loaders disagree on the sign of the turn, so that the table tells it itself: the side that a head turns
    away slides towards the nose. Our yaw > 0 turns the nose to the subject's right, so that points 0 to 7 slide there.
    """
    depth = table.of(vertices)[..., 2]
    sign = 1 if depth[39, :8].mean() > depth[78, :8].mean() else -1
    entries = [turn if turn >= 0 else 39 - turn for turn in (sign * yaw for yaw in CONTOUR_YAWS)]
    return np.array(CONTOUR_YAWS, float), Embedding(table.vertices[entries], table.barycentric[entries])
