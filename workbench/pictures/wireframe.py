"""The plain picture of a head: shaded triangles painted from back to front, with NumPy and OpenCV alone."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.background import background_picture
from workbench.pictures.lighting import STUDIO, Lighting
from workbench.pictures.mesh import check_scene, face_normals, to_camera, to_pixels

SHIFT = 4
"""OpenCV draws with coordinates in sixteenths of a pixel."""
NEAREST_MM = 1.0


def draw_wireframe(
    model: FaceModel,
    size: tuple[int, int],
    vertices: Float[np.ndarray, "v 3"],
    camera: Camera,
    rotation: Float[np.ndarray, "3"],
    translation: Float[np.ndarray, "3"],
    background: UInt8[np.ndarray, "h w 3"] | tuple[int, int, int] | None = None,
    lighting: Lighting = STUDIO,
) -> tuple[UInt8[np.ndarray, "h w 3"], UInt8[np.ndarray, "h w"]]:
    """Flat-shaded head in its vertex colours, without GL: (RGB picture, mask of 0 and 255).

    `vertices` in the head frame, millimetres; `size` is (width, height). Triangles are sorted by depth (painter's
    algorithm), so parts that interpenetrate may show wrongly. Raises `InputError` as `HeadRenderer.render`.
    """
    check_scene(vertices, len(model.neutral), rotation, translation, camera)
    picture = background_picture(background, size)
    mask = np.zeros(picture.shape[:2], np.uint8)
    points_camera = to_camera(vertices, rotation, translation)
    pixels = to_pixels(camera, np.where(points_camera[:, 2:] > NEAREST_MM, points_camera, [0.0, 0.0, NEAREST_MM]))
    corners = pixels[model.triangles]
    depth = points_camera[:, 2][model.triangles]
    seen = (depth.min(1) > NEAREST_MM) & _near_picture(corners, size) & _facing(corners)
    order = np.flatnonzero(seen)[np.argsort(-depth[seen].mean(1))]
    colors = _shaded(model, points_camera, lighting)[order].tolist()
    polygons = np.round(corners[order] * (1 << SHIFT)).astype(np.int32)
    for polygon, color in zip(polygons, colors, strict=True):
        cv2.fillConvexPoly(picture, polygon, color, cv2.LINE_8, SHIFT)
    for polygon in polygons:
        cv2.fillConvexPoly(mask, polygon, 255, cv2.LINE_8, SHIFT)
    return picture, mask


def _facing(corners: Float[np.ndarray, "t 3 2"]) -> np.ndarray:
    """Triangles that turn their outside to the camera: clockwise in a picture whose y points down."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0


def _near_picture(corners: Float[np.ndarray, "t 3 2"], size: tuple[int, int]) -> np.ndarray:
    """Triangles whose box meets the picture; this also keeps far points out of OpenCV's integers."""
    return ((corners.max(1) >= 0) & (corners.min(1) < size)).all(1) & (np.abs(corners).max((1, 2)) < 30_000)


def _shaded(model: FaceModel, points_camera: Float[np.ndarray, "v 3"], lighting: Lighting) -> Float[np.ndarray, "t 3"]:
    """Colour of each triangle: Lambert's law for every light."""
    normals = face_normals(points_camera, model.triangles)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    light = np.full(normals.shape, lighting.ambient)
    for source in lighting.lights:
        direction = np.asarray(source.direction) / np.linalg.norm(source.direction)
        light += np.maximum(normals @ direction, 0.0)[:, None] * source.intensity * np.asarray(source.color)
    colors = model.colors[model.triangles].mean(1)
    return np.clip(colors * light, 0, 255)
