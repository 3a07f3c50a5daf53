"""What a face model must be before anything is computed with it, whatever file it came from.

Arrays that belong together have the shapes that they should, every number is finite, every index names something.
"""

from collections.abc import Sequence

import numpy as np

from workbench.errors import ModelError
from workbench.face.model import Embedding, FaceModel
from workbench.reading import shortened

FARTHEST = 1e9
"""Coordinates beyond it are damage in any unit: a head of micrometres has 1e5."""
LARGEST_INDEX = 2**31 - 1
WEIGHT_SUM_TOLERANCE = 0.01
WEIGHTS_WITHIN = (-1.0, 2.0)
"""Barycentric weights of a point that is not far outside its triangle."""
Shape = tuple[int | None, ...]
"""Expected lengths; None where any will do."""


def check_face_model(path: object, model: FaceModel) -> FaceModel:
    """The model as it is. Raises `ModelError` where its parts do not belong together or hold damaged numbers."""
    count, shapes, people = len(model.neutral), len(model.expression_names), len(model.identity_deltas)
    check_names(path, "expression_names", model.expression_names)
    yaws = len(model.contour_yaw_deg)
    numbers: dict[str, tuple[np.ndarray, Shape]] = {
        "neutral": (model.neutral, (count, 3)),
        "expression_deltas": (model.expression_deltas, (shapes, count, 3)),
        "identity_deltas": (model.identity_deltas, (people, count, 3)),
        "contour_yaw_deg": (model.contour_yaw_deg, (yaws,)),
        "colors": (model.colors, (count, 3)),
        "jaw_weights": (model.jaw_weights, (count,)),
        "uv": (model.uv, (None, 2)),
        "blink_scale": (model.blink_scale, (2,)),
        "blink_scale_identity": (model.blink_scale_identity, (people, 2)),
        "expression_range": (model.weight_range(), (shapes, 2)),
        **{f"joint {name}": (joint, (3,)) for name, joint in model.joints.items()},
        **{f"joint offsets {name}": (model.identity_joint_deltas.get(name), (people, 3)) for name in model.joints},
    }
    for label, (array, shape) in numbers.items():
        check_numbers(path, label, array, shape)
    indices: dict[str, tuple[np.ndarray, Shape, int]] = {
        "triangles": (model.triangles, (None, 3), count),
        "triangles_uv": (model.triangles_uv, (len(model.triangles), 3), len(model.uv)),
        "mirror": (model.mirror, (count,), count),
        **{f"region {name}": (region, (None,), count) for name, region in model.regions.items()},
    }
    for label, (array, shape, most) in indices.items():
        check_indices(path, label, array, shape, most)
    check_embedding(path, "landmarks", model.landmarks, (68,), count)
    check_embedding(path, "contour", model.contour, (yaws, 17), count)
    if np.any(np.diff(model.contour_yaw_deg) <= 0.0):
        raise ModelError(f"{path}: the yaws of the jaw contour do not ascend; the file is damaged.")
    if np.any(np.diff(model.weight_range(), axis=1) < 0.0):
        raise ModelError(f"{path}: a blendshape's largest weight is below its smallest; the file is damaged.")
    return model


def check_names(path: object, label: str, names: Sequence[object]) -> None:
    """Raise `ModelError` for names that are not texts, empty, or given twice."""
    if isinstance(names, str):
        raise ModelError(f"{path}: {label} is a single text, expected a list of names; the file is damaged.")
    for name in names:
        if not isinstance(name, str) or not name:
            raise ModelError(f"{path}: {label} holds {shortened(name)!r}, expected names; the file is damaged.")
    if len(set(names)) < len(names):
        twice = next(name for k, name in enumerate(names) if name in names[:k])
        raise ModelError(f"{path}: {label} holds {shortened(twice)!r} twice; give each its own name.")


def check_numbers(path: object, label: str, array: object, shape: Shape, largest: float | int = FARTHEST) -> None:
    """Raise `ModelError` for an array of another shape, and for numbers that are not finite or beyond `largest`."""
    array = _shaped(path, label, array, shape, "biuf")
    # A comparison with NaN is false.
    if array.size and not (array.min() >= -largest and array.max() <= largest):
        raise ModelError(f"{path}: {label} holds numbers that are not finite or beyond {largest:.0e}; it is damaged.")


def check_indices(path: object, label: str, array: object, shape: Shape, count: int) -> None:
    """Raise `ModelError` for an array of another shape, and for indices beyond the `count` things that they name."""
    array = _shaped(path, label, array, shape, "iu")
    if (worst := index_beyond(array, count)) is not None:
        raise ModelError(f"{path}: {label} names number {worst} of {count}, counted from 0; the file is damaged.")


def index_beyond(indices: np.ndarray, count: int) -> int | None:
    """One of the indices that name none of `count` things; None where all name one."""
    if not indices.size or 0 <= indices.min() <= indices.max() < count:
        return None
    return int(indices.min() if indices.min() < 0 else indices.max())


def check_embedding(path: object, label: str, embedding: Embedding, shape: Shape, count: int) -> None:
    """Raise `ModelError` for barycentric points that are not on a mesh of `count` vertices."""
    check_indices(path, f"{label} (vertices)", embedding.vertices, (*shape, 3), count)
    weights = embedding.barycentric
    check_numbers(path, f"{label} (barycentric)", weights, (*shape, 3))
    low, high = WEIGHTS_WITHIN
    inside = np.all((low <= weights) & (weights <= high))
    if not inside or np.any(np.abs(weights.sum(-1) - 1.0) > WEIGHT_SUM_TOLERANCE):
        raise ModelError(f"{path}: {label} needs barycentric weights that sum to 1; the file is damaged.")


def whole_numbers(path: object, label: str, array: np.ndarray) -> np.ndarray:
    """Indices as int64, also where a file stores them as floating-point numbers.

    Raises `ModelError` for fractions and for what 32 bits do not hold.
    """
    check_numbers(path, label, array, array.shape, LARGEST_INDEX)
    if array.dtype.kind not in "iu" and not np.array_equal(array, np.rint(array)):
        raise ModelError(f"{path}: {label} holds numbers that are not whole; the file is damaged.")
    return array.astype(np.int64)


def _shaped(path: object, label: str, array: object, shape: Shape, kinds: str) -> np.ndarray:
    if not isinstance(array, np.ndarray) or array.dtype.kind not in kinds:
        kind = array.dtype if isinstance(array, np.ndarray) else type(array).__name__
        raise ModelError(f"{path}: {label} holds {kind}, expected an array of numbers; the file is damaged.")
    fits = len(array.shape) == len(shape) and all(
        expected is None or length == expected for length, expected in zip(array.shape, shape, strict=True)
    )
    if not fits:
        expected = "(" + ", ".join("n" if length is None else str(length) for length in shape) + ")"
        raise ModelError(f"{path}: {label} has shape {array.shape}, expected {expected}; the file is damaged.")
    return array
