"""What both ways of drawing a head need: points in the camera frame, their pixels, normals, and UV seams."""

import cv2
import numpy as np
from jaxtyping import Float, Int, Integer
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from workbench.errors import InputError
from workbench.face.model import FaceModel
from workbench.geometry import Camera

NECK_FADE_MM = 38.0


def to_camera(
    points_head: Float[np.ndarray, "n 3"], rotation: Float[np.ndarray, "3"], translation: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    """R·x + t: head-frame points in the camera frame, millimetres; the rotation is axis-angle in radians."""
    matrix = cv2.Rodrigues(np.asarray(rotation, float))[0]
    return points_head @ matrix.T + translation


def to_pixels(camera: Camera, points_camera: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
    """The same as `geometry.project`, by OpenCV: a drawing has no derivative and should not wait for JAX's dispatch."""
    matrix = np.eye(3)
    matrix[[0, 1], [0, 1]] = camera.focal_px
    matrix[:2, 2] = camera.principal_point_px
    points = np.ascontiguousarray(points_camera, float).reshape(-1, 1, 3)
    return cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.asarray(camera.distortion, float))[0][:, 0]


def scaled_camera(camera: Camera, scale: float) -> Camera:
    """The camera of the same picture resized by `scale`; pixel centres stay at whole numbers."""
    centre = (np.asarray(camera.principal_point_px, float) + 0.5) * scale - 0.5
    return Camera(np.asarray(camera.focal_px, float) * scale, centre, np.asarray(camera.distortion, float))


def check_scene(
    vertices: np.ndarray, vertex_count: int, rotation: np.ndarray, translation: np.ndarray, camera: Camera
) -> None:
    """Raise `InputError` for another number of vertices and for numbers that are not finite."""
    if vertices.shape != (vertex_count, 3):
        raise InputError(f"This head has {vertex_count} vertices (x, y, z), got an array of shape {vertices.shape}.")
    numbers = (vertices, rotation, translation, camera.focal_px, camera.principal_point_px, camera.distortion)
    if not all(np.isfinite(array).all() for array in numbers):
        raise InputError("A head can only be drawn with finite numbers, got NaN; frames without a face have no pose.")


def face_normals(points: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"]) -> Float[np.ndarray, "t 3"]:
    """Outward normals, twice as long as the triangles' areas."""
    first, second, third = (points[triangles[:, corner]] for corner in range(3))
    return np.cross(second - first, third - first)


def corner_sum(triangles: Integer[np.ndarray, "t 3"], vertex_count: int) -> csr_matrix:
    """Sparse matrix that sums a quantity of the triangles into their corners."""
    rows, columns = triangles.ravel().astype(np.int64), np.repeat(np.arange(len(triangles)), 3)
    return csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(vertex_count, len(triangles)))


def vertex_normals(
    points: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"], sums: csr_matrix
) -> Float[np.ndarray, "v 3"]:
    """Unit normals, averaged over the neighbouring triangles by area. `sums` comes from `corner_sum`."""
    normals = sums @ face_normals(points, triangles)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def neck_opacity(model: FaceModel) -> Float[np.ndarray, "v"]:
    """Opacity of each vertex that lets the open end of the neck fade out: 0 at its rim, 1 from `NECK_FADE_MM` away."""
    edges = np.sort(model.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    pairs, uses = np.unique(edges, axis=0, return_counts=True)
    rim = np.unique(pairs[uses == 1])
    chin = model.landmarks.of(model.neutral)[8, 1]
    rim = rim[model.neutral[rim, 1] > chin]
    if len(rim) == 0:
        return np.ones(len(model.neutral))
    place = np.clip(cKDTree(model.neutral[rim]).query(model.neutral)[0] / NECK_FADE_MM, 0.0, 1.0)
    return place * place * (3.0 - 2.0 * place)


def split_seams(
    triangles: Integer[np.ndarray, "t 3"], triangles_uv: Integer[np.ndarray, "t 3"]
) -> tuple[Int[np.ndarray, "s"], Int[np.ndarray, "s"], Int[np.ndarray, "t 3"]]:
    """Vertices doubled along UV seams: (vertex of each corner, UV of each corner, triangles over corners)."""
    pairs = np.stack([triangles.ravel(), triangles_uv.ravel()], axis=1).astype(np.int64)
    corners, numbering = np.unique(pairs, axis=0, return_inverse=True)
    return corners[:, 0], corners[:, 1], numbering.reshape(-1, 3)
