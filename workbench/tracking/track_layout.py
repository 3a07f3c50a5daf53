"""The layout of a stored track: names, types and sizes of its arrays, and the keys of its metadata."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from workbench.errors import InputError
from workbench.face import USUAL_JAW, FaceModel, JawUnit
from workbench.landmarks.scheme import IBUG68, LandmarkScheme
from workbench.landmarks.schemes import SCHEMES, scheme_named
from workbench.reading import checked_json, content_hash, shortened

FORMAT = "face-energy-workbench-track"
FORMAT_VERSION = 4
OF_IBUG68 = 3
"""The version of tracks with the 68 points, which older workbenches read too."""
FAILURES = ("", "jaw and face disagree", "large error", "not finite")
"""Why a fit is unusable although there was a face (Deep Energies Sec. 8.2); stored as an index."""
SOURCES = ("none", "detected", "tracked", "given", "filled")
"""Source of a frame's landmarks (filled: by infill from its neighbours); stored as an index."""

LAYOUT: Mapping[str, tuple[str, tuple[int | str, ...]]] = {
    "index": ("iu", ()),
    "found": ("b", ()),
    "shot": ("iu", ()),
    "source": ("iu", ()),
    "image_size": ("iu", (2,)),
    "focal_px": ("f", (2,)),
    "principal_point_px": ("f", (2,)),
    "distortion": ("f", (8,)),
    "rotation": ("f", (3,)),
    "translation": ("f", (3,)),
    "expression": ("f", ("blendshapes",)),
    "identity": ("f", ("identity components",)),
    "observed": ("f", ("landmarks", 2)),
    "confidence": ("f", ("landmarks",)),
    "projected": ("f", ("landmarks", 2)),
    "energies": ("f", ("stages", "energies")),
    "status": ("iu", ("stages",)),
    "iterations": ("iu", ("stages",)),
    "milliseconds": ("f", (3,)),
    "jaw": ("f", (6,)),
    "scale": ("f", ()),
    "failure": ("iu", ()),
    "others": ("f", ("other views", 68, 3)),
    "covariance": ("f", ("covariances", 2, 2)),
}
"""Kind of number (NumPy's letter) and sizes per frame; sizes with the same name must be equal."""
LATER = ("jaw", "scale", "failure", "others", "covariance")
"""Arrays that older workbenches did not write."""
MOST_NAMED = 10_000
"""Maximum number of blendshapes, identity components, stages, energies or views."""
LARGEST = 1e30
"""Largest magnitude of any number in a fit, because they are also used in 32-bit computations."""
FITTED = (
    *("focal_px", "principal_point_px", "distortion", "rotation", "translation", "expression", "identity"),
    *("observed", "confidence", "projected", "jaw", "scale", "others"),
)
"""Arrays that must be finite in a frame with a face."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="allow", strict=True, allow_inf_nan=False)


class _File(_Section):
    path: Annotated[str, Field(min_length=1, pattern=r"^[^\x00]*$")]
    sha256: str = ""


Positive = Annotated[float, Field(gt=0.0)]


class _JawUnit(_Section):
    open_deg: Positive
    sideways_mm: Positive
    forward_mm: Positive


class _Model(_Section):
    name: str = ""
    sha256: str | None = None
    jaw_unit: _JawUnit | None = None
    expression_range: list[Annotated[list[float], Field(min_length=2, max_length=2)]] | None = None


class _Metadata(_Section):
    """The metadata that is used; there may be more."""

    expression_names: list[str]
    scheme: Literal[tuple(SCHEMES)] = IBUG68.name
    stages: list[str] = []
    steps: list[str] = []
    config: dict[str, Any] | None = None
    inputs: list[_File] = []
    views: dict[str, str] | None = None
    landmarks: _File | None = None
    files: list[_File] = []
    detector: str | None = None
    names: list[str] = []
    stills: bool = False
    frames: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)] | None = None
    rate: Annotated[float, Field(gt=0.0, le=1e6)] | None = None
    camera_guessed: bool = True
    model: _Model | None = None
    retargeted_from: _Model | None = None
    versions: dict[str, Any] = {}
    live: dict[str, Any] | None = None


def checked_meta(stored: Mapping[str, np.ndarray], path: Path) -> dict[str, Any]:
    """The metadata of a track's arrays.

    Raises `InputError` for a foreign file, a file from a newer workbench, and invalid keys.
    """
    text = stored["meta"].item()
    meta = checked_json(text) if isinstance(text, str) else None
    if not isinstance(meta, dict) or meta.get("format") != FORMAT:
        raise InputError(f"{path} is not a workbench track; pass the track.npz of a run.")
    version = meta.get("format_version", 0)
    if not isinstance(version, int) or version > FORMAT_VERSION:
        raise InputError(f"{path} was written by a newer workbench; upgrade to read it.")
    try:
        _Metadata.model_validate(meta)
    except ValidationError as error:
        problem = error.errors()[0]
        place = shortened(".".join(str(part) for part in problem["loc"]))
        told = f"{place}: {problem['msg']}, got {shortened(repr(problem['input']))}"
        raise InputError(f"{path} has damaged metadata ({told}); run the tracking again.") from error
    return meta


def meta_array(meta: dict[str, Any]) -> np.ndarray:
    """The metadata as the scalar text array that is stored in the file."""
    version = FORMAT_VERSION if "scheme" in meta else OF_IBUG68
    return np.array(json.dumps({"format": FORMAT, "format_version": version, **meta}))


def scheme_record(scheme: LandmarkScheme) -> dict[str, str]:
    """What the metadata says of the landmarks; of the 68 nothing, as before there were others."""
    return {} if scheme is IBUG68 else {"scheme": scheme.name}


def scheme_of(meta: Mapping[str, Any]) -> LandmarkScheme:
    """The landmark scheme that the metadata of a track name."""
    return scheme_named(meta.get("scheme", IBUG68.name))


def file_record(path: Path) -> dict[str, str]:
    """What the metadata says of a file or folder: its place, from every folder the same, and what it holds."""
    return {"path": str(path.absolute()), "sha256": content_hash(path)}


def model_record(model: FaceModel) -> dict[str, Any]:
    """The key `model` of a track's metadata."""
    record = {"name": model.name, "sha256": model.fingerprint(), "jaw_unit": asdict(model.jaw_unit)}
    if not model.weights_from_0_to_1:
        record["expression_range"] = model.weight_range().tolist()
    return record


def expression_range_of(meta: Mapping[str, Any], count: int) -> Float[np.ndarray, "k 2"]:
    """Least and largest value of each of a track's `count` weights; 0 and 1 where its metadata name no others."""
    stored = (meta.get("model") or {}).get("expression_range")
    if stored is None or len(stored) != count:
        return np.tile([0.0, 1.0], (count, 1))
    return np.array(stored, float)


def jaw_unit_of(meta: Mapping[str, Any]) -> JawUnit:
    """The unit of the jaw joint in a track's model; the default head's where an older workbench did not write it."""
    stored = (meta.get("model") or {}).get("jaw_unit")
    if stored is None:
        return USUAL_JAW
    return JawUnit(**{name: float(stored[name]) for name in asdict(USUAL_JAW)})


def in_todays_layout(stored: Mapping[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """All arrays of a track of `count` frames; arrays missing from older versions get the values implied then."""
    old = {
        "jaw": np.zeros((count, 6)),
        "scale": np.ones(count),
        "failure": np.zeros(count, np.int8),
        "others": np.zeros((count, 0, 68, 3)),
        "covariance": np.zeros((count, 0, 2, 2)),
    }
    return {name: stored[name] if name in stored or name not in LATER else old[name] for name in LAYOUT}


def checked_columns(columns: Mapping[str, np.ndarray], meta: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The unchanged arrays of a track (or of consecutive frames of one) with these metadata, after checks.

    Raises ValueError if types, sizes or numbers are invalid for a track: different lengths, frames out of order,
    unknown sources, non-finite numbers in a fitted face.
    """
    count = len(columns["index"])
    check_layout({name: (columns[name].shape, columns[name].dtype) for name in LAYOUT}, count, meta)
    _check_numbers(columns)
    return {name: columns[name] for name in LAYOUT}


def check_layout(layouts: Mapping[str, tuple[tuple[int, ...], np.dtype]], count: int, meta: Mapping[str, Any]) -> None:
    """Raise ValueError unless these shapes and types are valid for a track of `count` frames."""
    if not count:
        raise ValueError("it contains no frames")
    scheme = scheme_of(meta)
    named = {"blendshapes": len(meta["expression_names"]), "landmarks": len(scheme)}
    named["covariances"] = len(scheme) if scheme.has_covariances else 0
    for name, (kinds, expected) in LAYOUT.items():
        if name not in layouts and name in LATER:
            continue
        shape, dtype = layouts[name]
        if dtype.kind not in kinds or (dtype.kind == "f" and dtype.itemsize not in (4, 8)):
            raise ValueError(f"{name} holds {dtype} numbers")
        if len(shape) == 1 + len(expected):
            for size, length in zip(expected, shape[1:], strict=True):
                if isinstance(size, str):
                    named.setdefault(size, length)
        wanted = (count, *(named.get(size, 0) if isinstance(size, str) else size for size in expected))
        if shape != wanted or max(named.values()) > MOST_NAMED:
            raise ValueError(f"{name} has the shape {shape}, expected {wanted}")


def _check_numbers(columns: Mapping[str, np.ndarray]) -> None:
    index, found = columns["index"], columns["found"]
    if index[0] < 0 or (np.diff(index.astype(float)) <= 0).any():
        raise ValueError("its frames are not in ascending order")
    for name, entries in (("source", SOURCES), ("failure", FAILURES)):
        if not ((columns[name] >= 0) & (columns[name] < len(entries))).all():
            raise ValueError(f"{name} goes beyond the {len(entries)} there are")
    if (columns["image_size"] < 1).any():
        raise ValueError("a picture has no pixels")
    fitted = found & (columns["failure"] != FAILURES.index("not finite"))
    for name in FITTED:
        if not _usable(columns[name][fitted]).all():
            raise ValueError(f"{name} of a frame with a face is not finite")
    if (columns["focal_px"][fitted] <= 0).any() or (columns["scale"][fitted] <= 0).any():
        raise ValueError("a focal length or scale is not positive")


def _usable(numbers: Float[np.ndarray, "..."]) -> Bool[np.ndarray, "..."]:
    return np.abs(numbers) < LARGEST  # False for NaN
