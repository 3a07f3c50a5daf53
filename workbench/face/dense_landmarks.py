"""A face model with the landmarks of another scheme."""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from workbench.errors import ModelError
from workbench.face.default_head import load_default_head
from workbench.face.gaze import with_eye_units
from workbench.face.model import Embedding, FaceModel
from workbench.landmarks.scheme import IBUG68, POINT_COUNT, LandmarkScheme
from workbench.landmarks.schemes import DENSE, DENSE_POINTS

EYEBALLS = ("eyeR", "eyeL")
"""The default head's regions of the pupils, the person's right one first."""
_PUPIL_RING = 8


def in_scheme(model: FaceModel, scheme: LandmarkScheme) -> FaceModel:
    """The model with the landmarks of this scheme; the jaw joint keeps its unit.

    The default head without the eyes' units, which none of the 68 shows, has them in a scheme with pupils. The dense
    points are vertices of the default head. On another mesh they are placed by laying the default head on its surface.
    Raises `ModelError` if it does not fit.
    """
    if scheme is model.scheme:
        return model
    known = model.landmarks
    if len(scheme) > len(known.vertices):
        known = _joined(_first(known, POINT_COUNT), _dense_embedding(model))
    made = replace(model, landmarks=_first(known, len(scheme)), fixed_jaw_unit=model.jaw_unit)
    if scheme is IBUG68:
        return made
    return with_eye_units(made) if np.array_equal(model.triangles, load_default_head().triangles) else made


def pupil_vertices(model: FaceModel) -> Int[np.ndarray, "2 p"]:
    """The ring of each eyeball's foremost vertices, the person's right one first, whose middle is the pupil's.

    The model has the default head's mesh.
    """
    regions = load_default_head().regions
    balls = (regions[name] for name in EYEBALLS)
    return np.stack([ball[np.argsort(model.neutral[ball, 2])[:_PUPIL_RING]] for ball in balls])


def _dense_embedding(model: FaceModel) -> Embedding:
    """The points of `dense` after the 68."""
    if not np.array_equal(model.triangles, load_default_head().triangles):
        return _carried_over(model)
    pupils = _joined(*(_middle(model, ring) for ring in pupil_vertices(model)))
    alone = np.tile([1.0, 0.0, 0.0], (len(DENSE_POINTS), 1))
    return _joined(pupils, Embedding(np.repeat(DENSE_POINTS.vertices[:, None], 3, axis=1), alone))


def _carried_over(model: FaceModel) -> Embedding:
    """The same points of another mesh: the default head is laid on it, held by the model's own 68 landmarks."""
    from workbench.face.formats.landmark_fit import centre_of_motion, fit_landmarks

    head = in_scheme(load_default_head(), DENSE)
    known = dict(enumerate(zip(model.landmarks.vertices, model.landmarks.barycentric, strict=True)))
    eyes = {name: model.joints[name] for name in ("leftEye", "rightEye") if name in model.joints}
    moved = zip(model.expression_names, model.expression_deltas, strict=True)
    motions = {name: centre_of_motion(offsets) @ model.neutral for name, offsets in moved if np.any(offsets)}
    places = model.landmarks.of(model.neutral), head.landmarks.of(head.neutral)[:POINT_COUNT]
    own, usual = (np.linalg.norm(points - points.mean(axis=0)) for points in places)
    fit = fit_landmarks(model.neutral, model.triangles, known, eyes, motions, own / usual, head)
    if not fit.lies_on_it(own / usual):
        raise ModelError(
            f"The landmarks of the scheme {DENSE.name!r} could not be placed on {model.name!r}: the default head does "
            f"not lie on its surface ({100 * fit.covered:.0f} % of the face found it, median distance "
            f"{fit.distance_mm:.1f} mm); use its 68 (another landmarks.detector)."
        )
    return Embedding(fit.landmarks.vertices[POINT_COUNT:], fit.landmarks.barycentric[POINT_COUNT:])


def _middle(model: FaceModel, ring: Int[np.ndarray, "p"]) -> Embedding:
    """The middle of a pupil: of the two vertices of its ring that are farthest apart."""
    apart = np.linalg.norm(model.neutral[ring[:, None]] - model.neutral[ring[None]], axis=2)
    first, second = ring[list(np.unravel_index(np.argmax(apart), apart.shape))]
    return Embedding(np.array([[first, second, second]]), np.array([[0.5, 0.5, 0.0]]))


def _first(landmarks: Embedding, count: int) -> Embedding:
    return Embedding(landmarks.vertices[:count], landmarks.barycentric[:count])


def _joined(*parts: Embedding) -> Embedding:
    vertices = np.concatenate([part.vertices for part in parts]).astype(parts[0].vertices.dtype)
    return Embedding(vertices, np.concatenate([part.barycentric for part in parts]))
