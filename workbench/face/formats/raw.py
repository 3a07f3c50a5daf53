"""What the reader of a format hands over: a face model in its file's own unit, axes and order."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Integer, UInt8

from workbench.errors import ModelError
from workbench.face.checking import Shape, check_embedding, check_indices, check_names, check_numbers, index_beyond
from workbench.face.model import Embedding
from workbench.reading import shortened

Y_UP = np.diag([1.0, -1.0, -1.0])
"""From +x subject's left, +y up, +z out of the face (FLAME, Basel, ICT, glTF) to the head frame."""
STATISTICAL_RANGE = (-3.0, 3.0)
"""Weights of a component of unit variance."""
COMPONENT = "expression_"
"""What a component without a name of its own is called, before its number."""

Place = tuple[Integer[np.ndarray, "3"], Float[np.ndarray, "3"]]
"""A point of a mesh: three vertices and their barycentric weights."""


@dataclass(frozen=True)
class RawModel:
    """A face model as it is stored. Points of one kind share the file's frame and unit; sides are the subject's."""

    name: str
    vertices: Float[np.ndarray, "v 3"]
    triangles: Integer[np.ndarray, "t 3"]
    expression_names: tuple[str, ...]
    expression_deltas: Float[np.ndarray, "k v 3"]
    expression_range: Float[np.ndarray, "k 2"]
    identity_deltas: Float[np.ndarray, "i v 3"] | None = None
    """Components of unit variance."""
    landmarks: Mapping[int, Place] = field(default_factory=dict)
    """What the format says of the 68 points, by iBUG number; the others are fitted."""
    contour_yaw_deg: Float[np.ndarray, "b"] | None = None
    """Head yaws in our sign, ascending, where the format tabulates a sliding jaw contour."""
    contour: Embedding | None = None
    joints: Mapping[str, Float[np.ndarray, "3"]] = field(default_factory=dict)
    """Among them leftEye, rightEye (centres) and jaw, where the format knows them."""
    identity_joint_deltas: Mapping[str, Float[np.ndarray, "i 3"]] = field(default_factory=dict)
    jaw_weights: Float[np.ndarray, "v"] | None = None
    eye_weights: Float[np.ndarray, "v 2"] | None = None
    """Shares of the vertices that turn with rightEye and leftEye, where the format has joints for them."""
    colors: UInt8[np.ndarray, "v 3"] | None = None
    regions: Mapping[str, Integer[np.ndarray, "_"]] | None = None
    mirror: Integer[np.ndarray, "v"] | None = None
    uv: Float[np.ndarray, "u 2"] | None = None
    triangles_uv: Integer[np.ndarray, "t 3"] | None = None
    axes: Float[np.ndarray, "3 3"] | None = None
    """Rotation from the file's axes to the head frame's, where the format defines it."""
    notes: tuple[str, ...] = ()

    def people(self) -> Float[np.ndarray, "i v 3"]:
        """The identity components, none where the file has none."""
        return np.zeros((0, len(self.vertices), 3)) if self.identity_deltas is None else self.identity_deltas


def vertex_place(vertex: int) -> Place:
    """A landmark that is a vertex."""
    return np.array([vertex] * 3, np.int32), np.array([1.0, 0.0, 0.0])


def places_of(embedding: Embedding, first: int = 0) -> dict[int, Place]:
    """Landmarks of consecutive numbers from `first` on."""
    pairs = zip(embedding.vertices, embedding.barycentric, strict=True)
    return {first + k: (vertices, weights) for k, (vertices, weights) in enumerate(pairs)}


def embedding_of(places: Mapping[int, Place]) -> Embedding:
    """The 68 landmarks as arrays. Raises `ModelError` where one is missing."""
    missing = [point for point in range(68) if point not in places]
    if missing:
        raise ModelError(f"The model has no landmark {missing[0]} of the 68; give all of them in landmarks.toml.")
    vertices, weights = zip(*(places[point] for point in range(68)), strict=True)
    return Embedding(np.stack(vertices).astype(np.int32), np.stack(weights).astype(float))


def statistical_names(count: int) -> tuple[str, ...]:
    """Names of the components of an expression basis that has none."""
    return tuple(f"{COMPONENT}{k:03d}" for k in range(count))


def is_statistical(name: str) -> bool:
    """Whether a name is one of `statistical_names`."""
    return name.startswith(COMPONENT) and name.removeprefix(COMPONENT).isdecimal()


def ranges(count: int, bounds: tuple[float, float] = (0.0, 1.0)) -> Float[np.ndarray, "k 2"]:
    """The same range for `count` shapes."""
    return np.tile(np.array(bounds, float), (count, 1))


def check_mesh(path: object, vertices: np.ndarray, triangles: np.ndarray, deltas: Mapping[str, np.ndarray]) -> None:
    """Raise `ModelError` where arrays of a file do not belong together."""
    count = len(vertices) if vertices.ndim == 2 else 0
    if vertices.shape != (count, 3) or count == 0 or triangles.ndim != 2 or triangles.shape[1:] != (3,):
        raise ModelError(f"{path} holds no triangle mesh: vertices {vertices.shape}, triangles {triangles.shape}.")
    if (worst := index_beyond(triangles, count)) is not None:
        raise ModelError(f"{path}: a triangle names vertex {worst}, the mesh has {count}; the file is damaged.")
    for label, basis in deltas.items():
        if basis.ndim != 3 or basis.shape[1:] != (count, 3):
            raise ModelError(f"{path}: {label} has shape {basis.shape}, expected (n, {count}, 3); the file is damaged.")
    for label, array in {"vertices": vertices, **deltas}.items():
        check_numbers(path, label, array, array.shape)


def check_raw(path: object, raw: RawModel) -> RawModel:
    """What a reader hands over, as it is. Raises `ModelError` where parts are damaged or do not belong together."""
    people, count = raw.people(), len(raw.vertices)
    check_mesh(path, raw.vertices, raw.triangles, {"blendshapes": raw.expression_deltas, "identity basis": people})
    check_names(path, "the list of blendshapes", raw.expression_names)
    shapes = len(raw.expression_deltas)
    numbers: dict[str, tuple[np.ndarray | None, Shape]] = {
        "the list of blendshapes": (np.arange(len(raw.expression_names)), (shapes,)),
        "the range of weights": (raw.expression_range, (shapes, 2)),
        "the jaw's weights": (raw.jaw_weights, (count,)),
        "the eyes' weights": (raw.eye_weights, (count, 2)),
        "the colours": (raw.colors, (count, 3)),
        "texture coordinates": (raw.uv, (None, 2)),
        **{f"joint {shortened(name)}": (joint, (3,)) for name, joint in raw.joints.items()},
        **{
            f"offsets of joint {shortened(name)}": (moved, (len(people), 3))
            for name, moved in raw.identity_joint_deltas.items()
        },
    }
    for label, (array, shape) in numbers.items():
        if array is not None:
            check_numbers(path, label, array, shape)
    indices: dict[str, tuple[np.ndarray | None, Shape, int]] = {
        "the mirror": (raw.mirror, (count,), count),
        "texture triangles": (
            raw.triangles_uv,
            (len(raw.triangles), 3),
            0 if raw.uv is None else len(raw.uv),
        ),
        **{f"region {shortened(name)}": (region, (None,), count) for name, region in (raw.regions or {}).items()},
    }
    for label, (array, shape, most) in indices.items():
        if array is not None:
            check_indices(path, label, array, shape, most)
    for point, (vertices, weights) in raw.landmarks.items():
        check_embedding(path, f"landmark {point}", Embedding(np.asarray(vertices), np.asarray(weights)), (), count)
    if raw.contour is not None and raw.contour_yaw_deg is not None:
        check_embedding(path, "the jaw contour", raw.contour, (len(raw.contour_yaw_deg), 17), count)
    return raw
