"""A face model with the landmarks of another scheme."""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from workbench.errors import ModelError
from workbench.face.default_head import load_default_head
from workbench.face.model import Embedding, FaceModel
from workbench.landmarks.scheme import IBUG68, POINT_COUNT, LandmarkScheme
from workbench.landmarks.schemes import DENSE, DENSE_POINTS

EYEBALLS = ("eyeR", "eyeL")
"""The regions of the pupils, the person's right one first."""
_PUPIL_RING = 8


def in_scheme(model: FaceModel, scheme: LandmarkScheme) -> FaceModel:
    """The model with the landmarks of this scheme; the jaw joint keeps its unit.

    Raises `ModelError` for a scheme whose points are not known on this model: the dense ones are those of the default
    head's mesh, in any shape.
    """
    if scheme is model.scheme:
        return model
    first = Embedding(model.landmarks.vertices[:POINT_COUNT], model.landmarks.barycentric[:POINT_COUNT])
    landmarks = first if scheme is IBUG68 else _joined(first, _dense_embedding(model))
    return replace(model, landmarks=landmarks, fixed_jaw_unit=model.jaw_unit)


def pupil_vertices(model: FaceModel) -> Int[np.ndarray, "2 p"]:
    """The ring of each eyeball's foremost vertices, the person's right one first, whose middle is the pupil's."""
    balls = (model.regions[name] for name in EYEBALLS)
    return np.stack([ball[np.argsort(model.neutral[ball, 2])[:_PUPIL_RING]] for ball in balls])


def _dense_embedding(model: FaceModel) -> Embedding:
    """The points of `dense` after the 68."""
    if not np.array_equal(model.triangles, load_default_head().triangles):
        raise ModelError(
            f"The landmarks of the scheme {DENSE.name!r} are known on the default head's mesh, not on {model.name!r}; "
            "use its 68 (another landmarks.detector), or the default head."
        )
    pupils = _joined(*(_middle(model, ring) for ring in pupil_vertices(model)))
    alone = np.tile([1.0, 0.0, 0.0], (len(DENSE_POINTS), 1))
    return _joined(pupils, Embedding(np.repeat(DENSE_POINTS.vertices[:, None], 3, axis=1), alone))


def _middle(model: FaceModel, ring: Int[np.ndarray, "p"]) -> Embedding:
    """The middle of a pupil: of the two vertices of its ring that are farthest apart."""
    apart = np.linalg.norm(model.neutral[ring[:, None]] - model.neutral[ring[None]], axis=2)
    first, second = ring[list(np.unravel_index(np.argmax(apart), apart.shape))]
    return Embedding(np.array([[first, second, second]]), np.array([[0.5, 0.5, 0.0]]))


def _joined(*parts: Embedding) -> Embedding:
    vertices = np.concatenate([part.vertices for part in parts]).astype(parts[0].vertices.dtype)
    return Embedding(vertices, np.concatenate([part.barycentric for part in parts]))
