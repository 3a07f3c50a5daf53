"""The bundled head: MakeHuman's CC0 base mesh with 52 ARKit units, read from `data_samples/head/head.npz`."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from workbench.errors import ModelError
from workbench.face.checking import check_face_model, check_names, check_numbers, whole_numbers
from workbench.face.jaw_unit import JawUnit
from workbench.face.model import Embedding, FaceModel
from workbench.reading import checked_arrays, checked_file, reading
from workbench.samples import sample

GAZE_NAMES = tuple(f"eyeLook{way}{side}" for way in ("Down", "In", "Out", "Up") for side in ("Left", "Right"))
"""The eight units that turn the eyes: no landmark sees them, so FACE IT!'s D = 44 leaves them out."""


EARLIER_EDITIONS = {
    "7334a89b1cdb67eae19353110b94000ae985a0dc1c5b4cee3b94072e363be4d8": False,
    "a32ef3e22c5d7290cb9773c525c5977ae7d5d7e2d8d7dae567599cbf0f636e3e": True,
    "f44f5be12f2de9f415a53b28d3e3eae3c8a1d9ecc30d862abe131fe9d72e3cc7": False,
    "5746c6c67b2324b82a1950591fd0b8b170512d8426c33e5df02c9c88a6fe798a": True,
}
"""Fingerprints of the heads whose smile had a ridge and whose neck ended in scallops, and whether they have gaze units:
their landmarks are the same."""


def fits_as(model: FaceModel, fingerprint: str) -> bool:
    """Whether fits with the model of a fingerprint are valid for this one: its own, or the default head as it was."""
    gaze = EARLIER_EDITIONS.get(fingerprint)
    now = fingerprint if gaze is None else load_default_head(gaze=gaze).fingerprint()
    return now == model.fingerprint()


def load_default_head(path: Path | None = None, gaze: bool = False) -> FaceModel:
    """The default head with FACE IT!'s 44 blendshapes, or all 52 with `gaze`; `path` is another baked head.

    Raises `ModelError` if the file is missing a part or damaged.
    """
    return _bundled_head(gaze) if path is None else _read_head(path, gaze)


@lru_cache(maxsize=2)
def _bundled_head(gaze: bool) -> FaceModel:
    return _read_head(sample("head"), gaze)


def _read_head(path: Path, gaze: bool) -> FaceModel:
    path = checked_file(path, "a baked head", ModelError)
    with (
        reading(path, "a baked head", "bake it again or reinstall", ModelError),
        path.open("rb") as stream,
        checked_arrays(stream) as stored,
    ):
        arrays = {name: stored[name] for name in stored.files}
        try:
            model = check_face_model(path, _from_arrays(path, arrays))
        except KeyError as error:
            raise ModelError(f"The head file {path} has no {error.args[0]}; bake it again or reinstall.") from error
    if gaze:
        return model
    return model.with_expressions(tuple(name for name in model.expression_names if name not in GAZE_NAMES))


def _from_arrays(path: Path, arrays: dict[str, np.ndarray]) -> FaceModel:
    region_names = arrays["region_names"].tolist()
    joint_names = arrays["joint_names"].tolist()
    check_names(path, "region_names", region_names)
    check_names(path, "joint_names", joint_names)
    if arrays["colors"].dtype != np.uint8:
        raise ModelError(f"{path}: colors holds {arrays['colors'].dtype}, expected uint8; the file is damaged.")

    def indices(name: str) -> np.ndarray:
        return whole_numbers(path, name, arrays[name]).astype(np.int32)

    return FaceModel(
        name="default-head",
        neutral=arrays["neutral"].astype(float),
        triangles=indices("triangles"),
        expression_names=tuple(arrays["expression_names"].tolist()),
        expression_deltas=arrays["expression_deltas"] * float(arrays["expression_step_mm"]),
        identity_deltas=arrays["identity_deltas"] * float(arrays["identity_step_mm"]),
        landmarks=Embedding(indices("landmark_vertices"), arrays["landmark_barycentric"].astype(float)),
        contour_yaw_deg=arrays["contour_yaw_deg"].astype(float),
        contour=Embedding(indices("contour_vertices"), arrays["contour_barycentric"].astype(float)),
        colors=arrays["colors"],
        regions={name: np.flatnonzero(arrays["regions"] == k) for k, name in enumerate(region_names)},
        joints=dict(zip(joint_names, arrays["joints"].astype(float), strict=True)),
        jaw_weights=arrays["jaw_weights"].astype(float),
        uv=arrays["uv"].astype(float),
        triangles_uv=indices("triangles_uv"),
        mirror=indices("mirror"),
        identity_joint_deltas={
            name: arrays["identity_joint_deltas"][:, k].astype(float) for k, name in enumerate(joint_names)
        },
        blink_scale=arrays["blink_scale_mean"].astype(float),
        blink_scale_identity=arrays["blink_scale_identity"].astype(float),
        fixed_jaw_unit=_jaw_unit(path, arrays["jaw_unit"]) if "jaw_unit" in arrays else None,
    )


def _jaw_unit(path: Path, stored: np.ndarray) -> JawUnit:
    check_numbers(path, "jaw_unit", stored, (3,))
    if not (stored > 0.0).all():
        raise ModelError(f"{path}: jaw_unit holds {stored.tolist()}, expected an angle and two lengths above 0.")
    return JawUnit(*stored.astype(float).tolist())
