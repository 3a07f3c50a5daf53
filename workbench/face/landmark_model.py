"""The part of a face model that a landmark fit needs: its landmarks and how they move, as arrays for the solver."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from workbench.arrays import AnyArray, Scalar
from workbench.face.gaze import EYES, eye_turns
from workbench.face.model import BLINK_SCALE_RANGE, Embedding, FaceModel
from workbench.face.usual_expressions import UsualExpressions, usual_expressions

LEAST_SEEN_MM = 0.1
"""A blendshape is seen if its largest weight moves a landmark this far; detectors err by ten times as much. Of the
default head's, `tongueOut` moves none at all, the next ones (`eyeSquint…`) 3.5 mm, the gaze 1 mm."""


class LandmarkModel(NamedTuple):
    """Head-frame landmarks, millimetres, with the jaw contour at its frontal place (entry 0) and for tabulated yaws.

    The 17 of the contour come first, the others (`inner`) after them.
    """

    inner_neutral: Float[AnyArray, "inner 3"]
    inner_expression: Float[AnyArray, "k inner 3"]
    inner_identity: Float[AnyArray, "i inner 3"]
    contour_neutral: Float[AnyArray, "b 17 3"]
    contour_expression: Float[AnyArray, "b k 17 3"]
    contour_identity: Float[AnyArray, "b i 17 3"]
    contour_yaw: Float[AnyArray, "b"]
    """Yaw of each stored contour, radians; entries from 1 on ascend."""
    expression_scale: Float[AnyArray, "k"]
    """Travel of each blendshape for the mean identity (1 but for blinks)."""
    expression_scale_identity: Float[AnyArray, "i k"]
    """How the travel changes with each identity coefficient."""
    expression_lower: Float[AnyArray, "k"]
    """Least weight of each blendshape where weights are bounded."""
    expression_upper: Float[AnyArray, "k"]
    """Largest one; both are 0 for a blendshape that no landmark sees, which a fit holds there, bounded or not."""
    gaze: Float[AnyArray, "4 k"] | None = None
    """Degrees that each blendshape turns the right eye to the subject's left and upwards, then the left one; None where
    the landmarks show no pupils."""
    usual: UsualExpressions | None = None
    """How the blendshapes usually act, by their names."""

    def personal(self, identity: Float[np.ndarray, "i"]) -> "LandmarkModel":
        """The landmarks of one person: identity and blink travel baked in, no identity basis left."""
        scale = np.clip(self.expression_scale + identity @ self.expression_scale_identity, *BLINK_SCALE_RANGE)
        return LandmarkModel(
            inner_neutral=self.inner_neutral + np.tensordot(identity, self.inner_identity, axes=1),
            inner_expression=self.inner_expression * scale[:, None, None],
            inner_identity=np.zeros((0, *self.inner_neutral.shape)),
            contour_neutral=self.contour_neutral + np.einsum("i,bind->bnd", identity, self.contour_identity),
            contour_expression=self.contour_expression * scale[:, None, None],
            contour_identity=np.zeros((len(self.contour_yaw), 0, 17, 3)),
            contour_yaw=self.contour_yaw,
            expression_scale=np.ones(len(scale)),
            expression_scale_identity=np.zeros((0, len(scale))),
            expression_lower=self.expression_lower,
            expression_upper=self.expression_upper,
            gaze=self.gaze,
            usual=self.usual,
        )

    def frontal_neutral(self) -> Float[np.ndarray, "points 3"]:
        """The points of the neutral face, jaw contour at its frontal place."""
        return np.concatenate([self.contour_neutral[0], self.inner_neutral])


class PointModel(NamedTuple):
    """The landmarks as a linear function of weights and identity, for one place of the jaw contour."""

    neutral: Float[AnyArray, "points 3"]
    expression: Float[AnyArray, "k points 3"]
    identity: Float[AnyArray, "i points 3"]


def seen_shapes(model: FaceModel) -> Bool[np.ndarray, "k"]:
    """Which blendshapes move one of the landmarks, wherever the jaw contour is, by `LEAST_SEEN_MM` or more.

    Nothing in the landmarks says what the others do: fits leave them at 0.
    """
    moved = [model.landmarks.of(model.expression_deltas), model.contour.of(model.expression_deltas)]
    farthest = [np.linalg.norm(part, axis=-1).max(axis=tuple(range(1, part.ndim - 1)), initial=0.0) for part in moved]
    return np.maximum(*farthest) * np.abs(model.weight_range()).max(axis=1) >= LEAST_SEEN_MM


def landmark_model(model: FaceModel) -> LandmarkModel:
    """The landmarks of a face model with their expression and identity offsets."""
    jaw = Embedding(model.landmarks.vertices[:17], model.landmarks.barycentric[:17])
    inner = Embedding(model.landmarks.vertices[17:], model.landmarks.barycentric[17:])
    contours = [jaw] + [
        Embedding(vertices, barycentric)
        for vertices, barycentric in zip(model.contour.vertices, model.contour.barycentric, strict=True)
    ]
    bounds = np.where(seen_shapes(model)[:, None], model.weight_range(), 0.0)
    scale, scale_identity = model.shape_scales()
    return LandmarkModel(
        inner_neutral=inner.of(model.neutral),
        inner_expression=inner.of(model.expression_deltas),
        inner_identity=inner.of(model.identity_deltas),
        contour_neutral=np.stack([place.of(model.neutral) for place in contours]),
        contour_expression=np.stack([place.of(model.expression_deltas) for place in contours]),
        contour_identity=np.stack([place.of(model.identity_deltas) for place in contours]),
        contour_yaw=np.radians(np.concatenate([[0.0], model.contour_yaw_deg])),
        expression_scale=scale,
        expression_scale_identity=scale_identity,
        expression_lower=bounds[:, 0],
        expression_upper=bounds[:, 1],
        gaze=eye_turns(model) if "pupils" in model.scheme.groups and set(EYES) <= set(model.joints) else None,
        usual=usual_expressions(model.expression_names),
    )


def contour_blend(contour_yaw: Float[AnyArray, "b"], yaw: Scalar, sliding: Scalar) -> Float[AnyArray, "b"]:
    """Weights of the stored contours for a head yaw in radians: linear between tabulated yaws, held beyond them.

    `sliding` 1 slides the contour, 0 keeps its frontal place (a traced number: switching compiles nothing).
    """
    count = len(contour_yaw)
    frontal = jnp.zeros(count).at[0].set(1.0)
    if count == 1:
        return frontal
    table = jnp.asarray(contour_yaw)[1:]
    # Hat functions: each entry rises from its left neighbour and falls to its right one.
    passed = (jnp.clip(yaw, table[0], table[-1]) - table[:-1]) / jnp.diff(table)
    one = jnp.ones(1)
    tabulated = jnp.clip(jnp.minimum(jnp.append(one, passed), jnp.append(1.0 - passed, one)), 0.0, 1.0)
    return frontal * (1.0 - sliding) + jnp.concatenate([jnp.zeros(1), tabulated]) * sliding


def model_landmarks(model: LandmarkModel, blend: Float[AnyArray, "b"], identity: Float[AnyArray, "i"]) -> PointModel:
    """The points for one blend of contours, blink travel scaled for this identity."""
    scale = model.expression_scale + identity @ model.expression_scale_identity
    scale = jnp.clip(scale, *BLINK_SCALE_RANGE)
    expression = jnp.concatenate(
        [jnp.tensordot(blend, jnp.asarray(model.contour_expression), axes=1), model.inner_expression], axis=1
    )
    contour_neutral = jnp.tensordot(blend, jnp.asarray(model.contour_neutral), axes=1)
    contour_identity = jnp.tensordot(blend, jnp.asarray(model.contour_identity), axes=1)
    return PointModel(
        neutral=jnp.concatenate([contour_neutral, model.inner_neutral]),
        expression=expression * scale[:, None, None],
        identity=jnp.concatenate([contour_identity, model.inner_identity], axis=1),
    )
