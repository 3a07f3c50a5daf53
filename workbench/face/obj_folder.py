"""A face model from a folder of OBJ targets in vertex correspondence."""

import tomllib
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Int

from workbench.errors import ModelError
from workbench.face.alignment import align_targets
from workbench.face.blendshapes import targets_to_deltas
from workbench.face.model import Embedding, FaceModel


def read_obj_folder(
    folder: str | Path, neutral: str = "neutral", align_on: Int[np.ndarray, "m"] | None = None
) -> FaceModel:
    """Face model of `folder`: `neutral.obj`, one OBJ a blendshape (named by its file) and `landmarks.toml`.

    The OBJ files share one vertex order and one list of faces; lengths are millimetres in the head frame (+x image
    right, +y down, +z away from the camera). `landmarks.toml` holds `vertices`, 68 vertex numbers counted from 0, or
    68 triples of them with `barycentric`. With `align_on`, targets are first aligned rigidly to the neutral on these
    vertices (FACE IT! Eq. 4). Raises `ModelError` where a part is missing or out of correspondence.
    """
    folder = Path(folder)
    neutral_path = folder / f"{neutral}.obj"
    if not neutral_path.is_file():
        raise ModelError(f"A model folder needs {neutral}.obj, none in {folder}; export the neutral face there.")
    paths = sorted(path for path in folder.glob("*.obj") if path != neutral_path)
    if not paths:
        raise ModelError(f"{folder} holds no blendshape targets beside {neutral}.obj; add one OBJ a blendshape.")
    base = _read_obj(neutral_path)
    targets = [_read_obj(path) for path in paths]
    for path, target in zip(paths, targets, strict=True):
        _check_correspondence(path, target, neutral_path, base)
    vertices = np.asarray(base.vertices, float)
    stacked = np.stack([np.asarray(target.vertices, float) for target in targets])
    if align_on is not None:
        stacked = align_targets(vertices, stacked, align_on)
    return linear_model(
        name=folder.name,
        neutral=vertices,
        triangles=np.asarray(base.faces, np.int32),
        expression_names=tuple(path.stem for path in paths),
        expression_deltas=targets_to_deltas(vertices, stacked),
        landmarks=_read_landmarks(folder / "landmarks.toml", len(vertices)),
    )


def linear_model(name, neutral, triangles, expression_names, expression_deltas, landmarks) -> FaceModel:
    """A face model of blendshapes alone: no identity basis, no sliding contour, no jaw joint, one colour."""
    count = len(neutral)
    return FaceModel(
        name=name,
        neutral=neutral,
        triangles=triangles,
        expression_names=expression_names,
        expression_deltas=expression_deltas,
        identity_deltas=np.zeros((0, count, 3)),
        landmarks=landmarks,
        contour_yaw_deg=np.zeros(0),
        contour=Embedding(np.zeros((0, 17, 3), np.int32), np.zeros((0, 17, 3))),
        colors=np.full((count, 3), 190, np.uint8),
        regions={"skin": np.arange(count)},
        joints={},
        jaw_weights=np.zeros(count),
        uv=np.zeros((1, 2)),
        triangles_uv=np.zeros((len(triangles), 3), np.int32),
        mirror=np.arange(count),
        identity_joint_deltas={},
        blink_scale=np.ones(2),
        blink_scale_identity=np.zeros((0, 2)),
    )


def _read_obj(path: Path) -> trimesh.Trimesh:
    try:
        # Without `process=False` trimesh merges and reorders vertices, which breaks the correspondence.
        mesh = trimesh.load(path, process=False, maintain_order=True, force="mesh")
    except Exception as error:
        raise ModelError(f"{path} cannot be read as OBJ ({error}); export it again.") from error
    if len(mesh.vertices) == 0 or len(mesh.faces) == 0:
        raise ModelError(f"{path} holds no mesh; export it again with its faces.")
    return mesh


def _check_correspondence(path, target, neutral_path, base) -> None:
    if len(target.vertices) != len(base.vertices):
        raise ModelError(
            f"{path.name} has {len(target.vertices)} vertices and {neutral_path.name} {len(base.vertices)}; "
            "all targets must come from one mesh."
        )
    if not np.array_equal(target.faces, base.faces):
        raise ModelError(f"{path.name} lists other faces than {neutral_path.name}; export without reordering vertices.")


def _read_landmarks(path: Path, vertex_count: int) -> Embedding:
    if not path.is_file():
        raise ModelError(f"A model folder needs landmarks.toml with the 68 points, none at {path}.")
    with path.open("rb") as stream:
        try:
            stored = tomllib.load(stream)
        except tomllib.TOMLDecodeError as error:
            raise ModelError(f"{path} is not valid TOML: {error}.") from error
    vertices = np.asarray(stored.get("vertices", []), int)
    if vertices.shape == (68,):
        vertices = np.repeat(vertices[:, None], 3, axis=1)
        barycentric = np.tile([1.0, 0.0, 0.0], (68, 1))
    else:
        barycentric = np.asarray(stored.get("barycentric", []), float)
    if vertices.shape != (68, 3) or barycentric.shape != (68, 3):
        raise ModelError(f"{path} needs 68 vertex numbers, or 68 triples with barycentric, got {vertices.shape}.")
    if vertices.min() < 0 or vertices.max() >= vertex_count:
        raise ModelError(f"{path} names vertex {vertices.max()}, the mesh has {vertex_count}, counted from 0.")
    return Embedding(vertices.astype(np.int32), barycentric)
