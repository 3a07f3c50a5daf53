"""The outline of a head: the edges where its surface turns away from the camera."""

import cv2
import numpy as np
from jaxtyping import Float, Integer, UInt8

from workbench.geometry import Camera
from workbench.pictures.extras import OUTLINE_COLOR
from workbench.pictures.mesh import to_pixels

NEAREST_MM = 1.0
FARTHEST_PX = 30_000
"""Farther points do not fit into OpenCV's integers."""
SHIFT = 4
"""Fractional bits of a drawn place."""


def outline_of(
    points_camera: Float[np.ndarray, "v 3"], triangles: Integer[np.ndarray, "t 3"], camera: Camera
) -> Float[np.ndarray, "n 2 2"]:
    """Ends of the edges that belong to a single one of the triangles that face the camera, pixels."""
    if points_camera[:, 2].min() <= NEAREST_MM:
        return np.zeros((0, 2, 2))
    pixels = to_pixels(camera, points_camera)
    first, second = (pixels[triangles[:, k]] - pixels[triangles[:, 0]] for k in (1, 2))
    facing = triangles[first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0] < 0]
    edges, counts = np.unique(np.sort(facing[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0, return_counts=True)
    return pixels[edges[counts == 1]]


def paint_outline(
    picture: UInt8[np.ndarray, "h w 3"],
    points_camera: Float[np.ndarray, "v 3"],
    triangles: Integer[np.ndarray, "t 3"],
    camera: Camera,
) -> None:
    """Draw the outline into a picture, over what is there."""
    segments = outline_of(points_camera, triangles, camera)
    segments = segments[np.abs(segments).max(axis=(1, 2), initial=0.0) < FARTHEST_PX]
    places = np.rint(segments * (1 << SHIFT)).astype(np.int32)
    cv2.polylines(picture, list(places), False, OUTLINE_COLOR, 1, cv2.LINE_AA, SHIFT)
