"""A fit as a 3D head: vertices, landmarks, observed landmarks lifted to 3D, and values spread over the surface."""

import threading

import numpy as np
from jaxtyping import Float

from workbench.face import FaceModel, posed_vertices
from workbench.geometry import rotation_matrix
from workbench.pictures.mesh import to_camera, to_pixels
from workbench.tracking import FrameFit

SPREAD_MM = 12.0
"""Distance over which a landmark's value fades out on the surface."""


class FittedHead:
    """The parts of a fit that viewers show. The personal model is cached between fits. Thread-safe."""

    def __init__(self, model: FaceModel):
        self.model = model
        self._lock = threading.Lock()
        self._identity: np.ndarray | None = None
        self._personal = model
        self._basis = _basis(model)
        self._spread = _spread(model)

    def personal(self, identity: Float[np.ndarray, "i"]) -> FaceModel:
        """The model of one person; the latest is cached."""
        return self._person(identity)[0]

    def vertices(self, fit: FrameFit) -> Float[np.ndarray, "v 3"]:
        """Head frame, millimetres, in single precision to halve the memory read for each picture."""
        personal, basis = self._person(fit.identity)
        moved = fit.expression.astype(np.float32) @ basis
        vertices = personal.neutral + moved.reshape(-1, 3)
        if np.any(fit.jaw) or fit.scale != 1.0:
            return posed_vertices(personal, fit.expression, fit.jaw, fit.scale)
        return vertices

    def _person(self, identity: Float[np.ndarray, "i"]) -> tuple[FaceModel, Float[np.ndarray, "k c"]]:
        """The model of one person and its basis, which belong together whatever other threads ask for."""
        with self._lock:
            if self._identity is None or not np.array_equal(identity, self._identity):
                self._personal, self._identity = self.model.personal(identity), np.array(identity)
                self._basis = _basis(self._personal)
            return self._personal, self._basis

    def landmarks(self, fit: FrameFit) -> Float[np.ndarray, "points 3"]:
        """The model's landmarks on the surface, head frame; the jaw contour at its frontal position."""
        return self.model.landmarks.of(self.vertices(fit))

    def observed(self, fit: FrameFit, landmarks: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points 3"]:
        """The observed landmarks in 3D: each image residual is lifted to the depth of its landmark.

        Contour landmarks slide on the surface, so residuals are added to the stored landmarks, not the projected ones.
        """
        points_camera = to_camera(landmarks, fit.rotation, fit.translation)
        millimetres = points_camera[:, 2:] / np.asarray(fit.camera.focal_px, float)
        moved = np.column_stack([(fit.observed - fit.projected) * millimetres, np.zeros(len(landmarks))])
        return landmarks + moved @ np.asarray(rotation_matrix(np.asarray(fit.rotation, float)))

    def surface_values(self, values: Float[np.ndarray, "points"]) -> Float[np.ndarray, "v"]:
        """One value per landmark, spread over the face; NaN far from all landmarks."""
        weights = self._spread
        total = weights.sum(axis=1)
        spread = weights @ values / np.maximum(total, 1e-12)
        return np.where(total > 0.05, spread, np.nan)

    def displacement(self, fit: FrameFit, shape: str) -> Float[np.ndarray, "v"]:
        """How far a blendshape moves each vertex at weight 1, millimetres."""
        model = self.personal(fit.identity)
        return np.linalg.norm(model.expression_deltas[model.expression_names.index(shape)], axis=1)

    def wire(self, fit: FrameFit) -> Float[np.ndarray, "n 2 2"]:
        """Edges of the triangles that face the camera, pixels."""
        points_camera = to_camera(self.vertices(fit), fit.rotation, fit.translation)
        if points_camera[:, 2].min() <= 1.0:
            return np.zeros((0, 2, 2))
        corners = to_pixels(fit.camera, points_camera)[self.model.triangles]
        first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        facing = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0
        edges = np.sort(self.model.triangles[facing][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
        return to_pixels(fit.camera, points_camera)[np.unique(edges, axis=0)]


def _basis(model: FaceModel) -> Float[np.ndarray, "k c"]:
    return np.ascontiguousarray(model.expression_deltas.reshape(len(model.expression_names), -1), np.float32)


def _spread(model: FaceModel) -> Float[np.ndarray, "v points"]:
    landmarks = model.landmarks.of(model.neutral)
    distance = np.linalg.norm(model.neutral[:, None] - landmarks[None], axis=2)
    return np.exp(-0.5 * (distance / SPREAD_MM) ** 2)
