"""From the records of the tracker to what objectives look at."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.spatial.transform import Rotation

from workbench.diagnosis.picture_evidence import carried_by_flow
from workbench.face import Embedding, FaceModel
from workbench.face.model import BLINKS
from workbench.landmarks.observations import of_ibug68
from workbench.landmarks.scheme import POINT_COUNT, face_size
from workbench.objectives.records import FittedClip, ObservedClip, Truth
from workbench.tracking import FrameObservation, Track

SURFACE_POINTS = 400
"""Vertices that stand for the mesh, evenly over their numbers."""


def observed_clip(observations: Sequence[FrameObservation], truth: Truth = Truth()) -> ObservedClip:  # noqa: B008
    """The 68 landmarks of consecutive frames of a clip, in whatever scheme they were seen."""
    points, confidence = np.full((len(observations), 68, 2), np.nan), np.zeros((len(observations), 68))
    follows = np.zeros(len(observations), bool)
    for k, observation in enumerate(observations):
        follows[k] = k > 0 and not observation.cut and observation.index == observations[k - 1].index + 1
        if observation.landmarks is not None:
            seen = of_ibug68(observation.landmarks)
            points[k], confidence[k] = seen.points, seen.confidence
    return ObservedClip(points, confidence, follows, truth)


def without_hidden(observation: FrameObservation, hidden: Bool[np.ndarray, "points"]) -> FrameObservation:
    """The observation with weight 0 for the hidden landmarks."""
    if observation.landmarks is None or not hidden.any():
        return observation
    confidence = np.where(hidden, 0.0, observation.landmarks.confidence)
    return replace(observation, landmarks=replace(observation.landmarks, confidence=confidence))


def flow_of_pictures(pictures: Sequence[UInt8[np.ndarray, "h w 3"]], clip: ObservedClip) -> Float[np.ndarray, "n 68 2"]:
    """How far each picture moved at the landmarks since the one before (Lucas–Kanade), pixels; NaN where unknown."""
    flow = np.full(clip.points.shape, np.nan)
    for k in range(1, len(clip.points)):
        before = clip.points[k - 1]
        if clip.follows[k] and not np.isnan(before).any():
            flow[k] = carried_by_flow(pictures[k - 1], pictures[k], before, float(face_size(before))) - before
    return flow


def fitted_clip(track: Track, model: FaceModel, surface: bool = False) -> FittedClip:
    """The fits of a track; `surface`: with the points of the mesh."""
    numbers = (track.rotation, track.translation, track.expression, track.identity)
    return FittedClip(
        rotation=track.rotation,
        translation=track.translation,
        expression=track.expression,
        projected=track.projected,
        inner_camera=inner_landmarks(model, *numbers),
        iterations=np.where(track.found, track.iterations.sum(1), np.nan),
        surface=surface_points(model, *numbers) if surface else None,
    )


def inner_landmarks(
    model: FaceModel,
    rotation: Float[np.ndarray, "n 3"],
    translation: Float[np.ndarray, "n 3"],
    expression: Float[np.ndarray, "n k"],
    identity: Float[np.ndarray, "n i"],
) -> Float[np.ndarray, "n 51 3"]:
    """The landmarks without the jaw contour in the camera frame, millimetres; NaN for frames without a fit."""
    inner = Embedding(model.landmarks.vertices[17:POINT_COUNT], model.landmarks.barycentric[17:POINT_COUNT])
    return _placed(model, inner, rotation, translation, expression, identity)


def surface_points(
    model: FaceModel,
    rotation: Float[np.ndarray, "n 3"],
    translation: Float[np.ndarray, "n 3"],
    expression: Float[np.ndarray, "n k"],
    identity: Float[np.ndarray, "n i"],
) -> Float[np.ndarray, "n v 3"]:
    """`SURFACE_POINTS` vertices in the camera frame, millimetres; NaN for frames without a fit."""
    chosen = np.unique(np.linspace(0, len(model.neutral) - 1, SURFACE_POINTS).round().astype(int))
    vertices = Embedding(np.repeat(chosen[:, None], 3, axis=1), np.tile([1.0, 0.0, 0.0], (len(chosen), 1)))
    return _placed(model, vertices, rotation, translation, expression, identity)


def _placed(model: FaceModel, places: Embedding, rotation, translation, expression, identity):
    """Points on the mesh in the camera frame, by frame."""
    neutral, deltas, shapes = (
        places.of(each) for each in (model.neutral, model.expression_deltas, model.identity_deltas)
    )
    found = np.full((len(rotation), *neutral.shape), np.nan)
    known = np.isfinite(rotation).all(1)
    for person in np.unique(identity[known], axis=0):
        of_person = known & (identity == person).all(1)
        scale = np.ones(len(deltas))
        for side, travel in zip(BLINKS, model.blink_scale_for(person), strict=True):
            if side in model.expression_names:
                scale[model.expression_names.index(side)] = travel
        weights = expression[of_person] * scale
        head = neutral + np.tensordot(person, shapes, axes=1) + np.tensordot(weights, deltas, axes=1)
        turns = Rotation.from_rotvec(rotation[of_person]).as_matrix()
        found[of_person] = np.einsum("nij,nvj->nvi", turns, head) + translation[of_person][:, None]
    return found
