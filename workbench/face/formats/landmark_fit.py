"""Landmarks of a mesh that has none: the default head is fitted to its surface and its landmarks are carried over.

1. The default head starts where the known points of the file put it (`placing`).
2. Its pose, size and 50 identity coefficients follow the surface: iterated closest points, point to plane, only where
   normals agree; known landmarks and eye centres hold it, and the places that blendshapes of ARKit's names move pull.
3. The 68 landmarks and the jaw contour for nine yaws go to the nearest points of the surface with agreeing normals.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from workbench.extras import needs
from workbench.face.formats.raw import Place
from workbench.face.model import Embedding, FaceModel

ITERATIONS = 14
REACH_MM = (30.0, 8.0)
"""How far the surface may be from the default head at first and at last."""
NORMALS_AGREE = 0.5
FACE_BOX = ((-75.0, -70.0, -60.0), (75.0, 105.0, 45.0))
"""The part of the default head that is laid on the surface, head frame, millimetres."""
IDENTITY_WEIGHT, LANDMARK_WEIGHT, MOTION_WEIGHT, POINT_WEIGHT = 2.0, 60.0, 6.0, 0.02
WORST_MM, LEAST_COVERED = 4.0, 0.4
"""A fit of the default head that is worse than this found no face."""
WIDE = ("jaw", "eyeLook", "tongue")
"""Beginnings of the names of shapes whose motion is too wide, or inside the head, to tell a place of the face."""
NEIGHBOURS = 30


class LandmarkFit(NamedTuple):
    """What the fitted default head tells about a mesh."""

    landmarks: Embedding
    contour: Embedding
    vertices: Float[np.ndarray, "u 3"]
    """The default head on the mesh, millimetres in the head frame."""
    distance_mm: float
    """Median distance of its face from the surface."""
    covered: float
    """Part of its face that found the surface."""

    def lies_on_it(self, size: float) -> bool:
        """Whether the head lies on the mesh, which is of `size` times the default head's size."""
        return bool(self.covered >= LEAST_COVERED and self.distance_mm <= WORST_MM * size)


class _Surface(NamedTuple):
    vertices: Float[np.ndarray, "v 3"]
    triangles: Integer[np.ndarray, "t 3"]
    normals: Float[np.ndarray, "v 3"]
    used: Integer[np.ndarray, "w"]
    """Vertices that have a triangle."""
    tree: cKDTree
    """Of the used vertices."""


def outward(vertices: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"]) -> bool:
    """Whether triangles are counter-clockwise seen from outside: what is in front of the eyes looks at the camera."""
    corners = vertices[triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return bool(areas[corners.mean(1)[:, 2] < 0.0, 2].sum() <= 0.0)


def fit_landmarks(
    vertices: Float[np.ndarray, "v 3"],
    triangles: Integer[np.ndarray, "t 3"],
    known: Mapping[int, Place],
    eyes: Mapping[str, Float[np.ndarray, "3"]],
    motions: Mapping[str, Float[np.ndarray, "3"]],
    size: float,
    head: FaceModel,
) -> LandmarkFit:
    """Fit the default head to a mesh in the head frame, millimetres, of `size` times the default head's size.

    `motions` are the centres of motion of blendshapes by ARKit's name.
    """
    used = np.unique(triangles)
    surface = _Surface(vertices, triangles, vertex_normals(vertices, triangles), used, cKDTree(vertices[used]))
    low, high = (np.array(corner) for corner in FACE_BOX)
    front = np.flatnonzero(np.all((head.neutral > low) & (head.neutral < high), axis=1))
    outer = np.concatenate([head.regions[name] for name in ("skin", "lips", "brow") if name in head.regions])
    sample = np.intersect1d(front, outer)
    state = _State(np.eye(3), size, np.zeros(3), np.zeros(len(head.identity_deltas)))
    held = _held(head, known, eyes, motions, vertices)
    for step in range(ITERATIONS):
        reach = size * np.interp(step, (0, ITERATIONS - 3), REACH_MM)
        state, distance, covered = _step(state, head, sample, surface, held, reach)
    fitted = state.vertices(head)
    normals = vertex_normals(fitted, head.triangles)
    landmarks, contour = (
        _on_surface(surface, embedding.of(fitted), embedding.of(normals))
        for embedding in (head.landmarks, head.contour)
    )
    return LandmarkFit(landmarks, contour, fitted, distance, covered)


def vertex_normals(
    vertices: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"]
) -> Float[np.ndarray, "v 3"]:
    """Unit normals weighted by area; zero where a vertex has no triangle."""
    corners = vertices[triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(sums, triangles[:, corner], areas)
    return sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-12)


class _State(NamedTuple):
    """x = scale · rotation · (N + Σ b D) + translation."""

    rotation: np.ndarray
    scale: float
    translation: np.ndarray
    identity: np.ndarray

    def place(self, points: np.ndarray) -> np.ndarray:
        return self.scale * points @ self.rotation.T + self.translation

    def vertices(self, head: FaceModel) -> np.ndarray:
        return self.place(head.neutral + np.tensordot(self.identity, head.identity_deltas, axes=1))


class _Held(NamedTuple):
    """Points of the default head, their offsets by identity, and where the file has them."""

    points: np.ndarray
    identity: np.ndarray
    targets: np.ndarray
    weights: np.ndarray


def centre_of_motion(deltas: Float[np.ndarray, "v 3"]) -> Float[np.ndarray, "v"]:
    """Weights of the vertices whose mean is the place that a blendshape moves; zero for one that moves nothing."""
    squares = (deltas**2).sum(1)
    return squares / max(squares.sum(), 1e-300)


def _held(
    head: FaceModel,
    known: Mapping[int, Place],
    eyes: Mapping[str, np.ndarray],
    motions: Mapping[str, np.ndarray],
    vertices: np.ndarray,
) -> _Held:
    neutral, moved = head.landmarks.of(head.neutral), head.landmarks.of(head.identity_deltas)
    numbers = sorted(known)
    points, identity = [neutral[numbers]], [moved[:, numbers]]
    targets = [weights @ vertices[corners] for corners, weights in (known[number] for number in numbers)]
    for eye, place in eyes.items():
        points.append(head.joints[eye][None])
        identity.append(head.identity_joint_deltas[eye][:, None])
        targets.append(place)
    for name, place in motions.items():
        if name in head.expression_names and not name.startswith(WIDE):
            centre = centre_of_motion(head.expression_deltas[head.expression_names.index(name)])
            points.append((centre @ head.neutral)[None])
            identity.append((head.identity_deltas.swapaxes(1, 2) @ centre)[:, None])
            targets.append(place)
    weights = np.full(len(targets), MOTION_WEIGHT)
    weights[: len(known) + len(eyes)] = LANDMARK_WEIGHT
    return _Held(np.concatenate(points), np.concatenate(identity, axis=1), np.reshape(targets, (-1, 3)), weights)


def _step(state: _State, head: FaceModel, sample, surface: _Surface, held: _Held, reach: float):
    """One Gauss–Newton step on the pairs that are close and face the same way."""
    local = head.neutral[sample] + np.tensordot(state.identity, head.identity_deltas[:, sample], axes=1)
    x = state.place(local)
    normals = vertex_normals(state.vertices(head), head.triangles)[sample]
    distance, nearest = surface.tree.query(x)
    nearest = surface.used[nearest]
    agree = np.einsum("pd,pd->p", normals, surface.normals[nearest]) > NORMALS_AGREE
    used = agree & (distance < reach)
    if used.sum() < 50:
        return state, float("inf"), float(used.mean())
    difference = x[used] - surface.vertices[nearest[used]]
    plane = surface.normals[nearest[used]]
    jacobian = _jacobian(state, x[used], head.identity_deltas[:, sample[used]])
    across = np.einsum("pd,pdu->pu", plane, jacobian)
    off_plane = np.einsum("pd,pd->p", plane, difference)
    # Pairs far from the surface are often no pairs: weights fall as the Cauchy estimator's.
    weight = 1.0 / (1.0 + (off_plane / (0.3 * reach)) ** 2)
    matrix = (across * weight[:, None]).T @ across
    gradient = across.T @ (weight * off_plane)
    flat = jacobian.reshape(-1, jacobian.shape[-1])
    matrix += POINT_WEIGHT * flat.T @ flat
    gradient += POINT_WEIGHT * flat.T @ difference.ravel()
    if len(held.points):
        at = state.place(held.points + np.tensordot(state.identity, held.identity, axes=1))
        pull = _jacobian(state, at, held.identity).reshape(-1, jacobian.shape[-1])
        each = np.repeat(held.weights, 3)
        matrix += (pull * each[:, None]).T @ pull
        gradient += pull.T @ (each * (at - held.targets).ravel())
    prior = np.concatenate([np.zeros(7), np.full(len(state.identity), IDENTITY_WEIGHT * used.sum() / 100.0)])
    gradient += prior * np.concatenate([np.zeros(7), state.identity])
    change = -np.linalg.solve(matrix + np.diag(prior + 1e-9 * matrix.trace()), gradient)
    moved = _State(
        _rotation(change[:3]) @ state.rotation,
        state.scale * np.exp(change[6]),
        state.translation + change[3:6],
        state.identity + change[7:],
    )
    return moved, float(np.median(np.abs(off_plane))), float(used.mean())


def _jacobian(state: _State, x: np.ndarray, identity: np.ndarray) -> np.ndarray:
    """Change of placed points by rotation (about the origin), translation, log scale and identity, (p, 3, 7 + i)."""
    moved = x - state.translation
    columns = np.zeros((len(x), 3, 7 + len(identity)))
    for axis in range(3):
        columns[:, :, axis] = np.cross(np.eye(3)[axis], moved)
    columns[:, :, 3:6] = np.eye(3)
    columns[:, :, 6] = moved
    columns[:, :, 7:] = state.scale * np.einsum("de,ipe->pdi", state.rotation, identity)
    return columns


def _rotation(vector: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(vector).as_matrix()


def _on_surface(surface: _Surface, points: np.ndarray, normals: np.ndarray) -> Embedding:
    """The nearest points of the surface that face the same way, as barycentric points."""
    with needs("formats"):
        import trimesh

    shape = points.shape[:-1]
    points, normals = points.reshape(-1, 3), normals.reshape(-1, 3)
    around = _triangles_around(surface)
    vertices, weights = [], []
    near = surface.tree.query(points, k=min(NEIGHBOURS, len(surface.used)))[1].reshape(len(points), -1)
    for point, normal, ring in zip(points, normals, near, strict=True):
        chosen = np.unique(np.concatenate([around[vertex] for vertex in surface.used[ring]]))
        corners = surface.triangles[chosen]
        facing = surface.normals[corners].mean(1) @ normal > 0.3 * np.linalg.norm(normal)
        corners = corners[facing] if facing.any() else corners
        found = trimesh.triangles.closest_point(surface.vertices[corners], np.tile(point, (len(corners), 1)))
        best = np.argmin(np.linalg.norm(found - point, axis=1))
        inside = trimesh.triangles.points_to_barycentric(surface.vertices[corners[best]][None], found[best][None])[0]
        inside = np.clip(inside, 0.0, 1.0)
        vertices.append(corners[best])
        weights.append(inside / inside.sum())
    return Embedding(np.reshape(vertices, (*shape, 3)).astype(np.int32), np.reshape(weights, (*shape, 3)).astype(float))


def _triangles_around(surface: _Surface) -> list[np.ndarray]:
    """Numbers of the triangles at each vertex."""
    order = np.argsort(surface.triangles.ravel(), kind="stable")
    counts = np.bincount(surface.triangles.ravel(), minlength=len(surface.vertices))
    return np.split(order // 3, np.cumsum(counts)[:-1])
