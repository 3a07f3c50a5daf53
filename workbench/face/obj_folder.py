"""A face model from a folder of OBJ targets in vertex correspondence, taken as it is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from workbench.face.alignment import align_targets
from workbench.face.formats.obj import LANDMARKS_FILE, read_landmarks_toml, read_obj_targets
from workbench.face.formats.raw import check_raw, embedding_of
from workbench.face.model import Embedding, FaceModel


def read_obj_folder(
    folder: str | Path, neutral: str = "neutral", align_on: Int[np.ndarray, "m"] | None = None
) -> FaceModel:
    """Face model of `folder`: `neutral.obj`, one OBJ per blendshape (named by its file) and `landmarks.toml`.

    The OBJ files share one vertex order and one list of faces; lengths are millimetres in the head frame (+x image
    right, +y down, +z away from the camera): nothing is recognised, fitted or renamed, as `load_face_model` does.
    `landmarks.toml` holds `vertices`, 68 vertex numbers counted from 0, or 68 triples of them with `barycentric`. With
    `align_on`, targets are first aligned rigidly to the neutral on these vertices (FACE IT! Eq. 4). Raises `ModelError`
    if a part is missing or out of correspondence.
    """
    folder = Path(folder)
    raw = read_obj_targets(folder, neutral)
    places = read_landmarks_toml(folder / LANDMARKS_FILE, len(raw.vertices))
    if align_on is not None:
        aligned = align_targets(raw.vertices, raw.vertices + raw.expression_deltas, align_on)
        raw = replace(raw, expression_deltas=aligned - raw.vertices)
    check_raw(folder, raw)
    model = linear_model(
        name=raw.name,
        neutral=raw.vertices,
        triangles=raw.triangles.astype(np.int32),
        expression_names=raw.expression_names,
        expression_deltas=raw.expression_deltas,
        landmarks=embedding_of(places),
    )
    if raw.uv is None or raw.triangles_uv is None:
        return model
    return replace(model, uv=raw.uv, triangles_uv=raw.triangles_uv.astype(np.int32))


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
