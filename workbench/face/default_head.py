"""The bundled head: MakeHuman's CC0 base mesh with 52 ARKit units, read from `data_samples/head/head.npz`."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from workbench.errors import ModelError
from workbench.face.model import Embedding, FaceModel
from workbench.samples import sample

GAZE_NAMES = tuple(f"eyeLook{way}{side}" for way in ("Down", "In", "Out", "Up") for side in ("Left", "Right"))
"""The eight units that turn the eyes: no landmark sees them, so FACE IT!'s D = 44 leaves them out."""


@lru_cache(maxsize=4)
def load_default_head(path: Path | None = None, gaze: bool = False) -> FaceModel:
    """The default head with FACE IT!'s 44 blendshapes, or all 52 with `gaze`.

    Raises `ModelError` if the file is missing a part.
    """
    path = sample("head") if path is None else path
    with np.load(path, allow_pickle=False) as stored:
        try:
            model = _from_arrays({name: stored[name] for name in stored.files})
        except KeyError as error:
            raise ModelError(f"The head file {path} has no {error.args[0]}; bake it again or reinstall.") from error
    if gaze:
        return model
    return model.with_expressions(tuple(name for name in model.expression_names if name not in GAZE_NAMES))


def _from_arrays(arrays: dict[str, np.ndarray]) -> FaceModel:
    region_names = arrays["region_names"].tolist()
    joint_names = arrays["joint_names"].tolist()
    return FaceModel(
        name="default-head",
        neutral=arrays["neutral"].astype(float),
        triangles=arrays["triangles"].astype(np.int32),
        expression_names=tuple(arrays["expression_names"].tolist()),
        expression_deltas=arrays["expression_deltas"] * float(arrays["expression_step_mm"]),
        identity_deltas=arrays["identity_deltas"] * float(arrays["identity_step_mm"]),
        landmarks=Embedding(arrays["landmark_vertices"].astype(np.int32), arrays["landmark_barycentric"].astype(float)),
        contour_yaw_deg=arrays["contour_yaw_deg"].astype(float),
        contour=Embedding(arrays["contour_vertices"].astype(np.int32), arrays["contour_barycentric"].astype(float)),
        colors=arrays["colors"],
        regions={name: np.flatnonzero(arrays["regions"] == k) for k, name in enumerate(region_names)},
        joints=dict(zip(joint_names, arrays["joints"].astype(float), strict=True)),
        jaw_weights=arrays["jaw_weights"].astype(float),
        uv=arrays["uv"].astype(float),
        triangles_uv=arrays["triangles_uv"].astype(np.int32),
        mirror=arrays["mirror"].astype(np.int32),
        identity_joint_deltas={
            name: arrays["identity_joint_deltas"][:, k].astype(float) for k, name in enumerate(joint_names)
        },
        blink_scale=arrays["blink_scale_mean"].astype(float),
        blink_scale_identity=arrays["blink_scale_identity"].astype(float),
    )
