"""Viewpoints of a head: fitted camera, frontal portrait, and how the mouse changes them."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float

from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.head_picture import portrait_view

NEAREST_MM, FURTHEST_MM = 150.0, 6000.0
"""Range of distances from the target that the mouse wheel can reach."""
PIVOT_MM = 60.0
"""Depth of the head's centre behind its eyes, about which a drag turns it."""
STEEPEST = 0.995
"""Cosine between the line of sight and the up direction at which a drag stops tilting."""


@dataclass(frozen=True)
class Viewpoint:
    """A camera in the head frame (millimetres), looking along the line from position to target."""

    position: Float[np.ndarray, "3"]
    target: Float[np.ndarray, "3"]
    """The point on the line of sight about which a drag turns."""
    up: Float[np.ndarray, "3"]
    """Unit direction that points up in the picture: (0, -1, 0) for an upright head."""
    camera: Camera
    """Focal lengths for a picture of the viewer's size."""

    @property
    def pose(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Rotation (axis-angle) and translation, head to camera."""
        forward = _unit(self.target - self.position)
        right = _unit(np.cross(forward, self.up))
        matrix = np.stack([right, np.cross(forward, right), forward])
        return cv2.Rodrigues(matrix)[0][:, 0], -matrix @ self.position


def front_viewpoint(model: FaceModel, size: tuple[int, int]) -> Viewpoint:
    """A frontal portrait, in a picture (width, height)."""
    camera, translation = portrait_view(model, size)
    return viewpoint_of_pose(np.zeros(3), translation, camera)


def camera_viewpoint(
    rotation: Float[np.ndarray, "3"],
    translation: Float[np.ndarray, "3"],
    camera: Camera,
    image_size: tuple[int, int],
    size: tuple[int, int],
) -> Viewpoint:
    """The input camera's own view of the posed head, in a picture (width, height) that shows the whole input picture.

    The optical axis passes through the middle of the viewer, as WebGL viewers require. The viewer's pixel is therefore
    centre + scale · (input pixel − principal point), and a centred input camera gives its picture resized.
    """
    return viewpoint_of_pose(rotation, translation, _contained(camera, image_size, size))


def viewpoint_of_pose(
    rotation: Float[np.ndarray, "3"], translation: Float[np.ndarray, "3"], camera: Camera
) -> Viewpoint:
    """The viewpoint for a head posed in front of this camera; its target is on the optical axis at the head's depth."""
    matrix = cv2.Rodrigues(np.asarray(rotation, float))[0]
    position = -matrix.T @ translation
    distance = max(float(translation[2]) + PIVOT_MM, 1.0)
    return Viewpoint(position, position + distance * matrix[2], -matrix[1], camera)


def orbited(viewpoint: Viewpoint, yaw: float, pitch: float) -> Viewpoint:
    """The viewpoint turned about the target (radians) as if dragging the head: yaw > 0 image right, pitch > 0 down."""
    turned = _turned(viewpoint, viewpoint.up, -yaw)
    sight = _unit(turned.target - turned.position)
    tilted = _turned(turned, _unit(np.cross(sight, turned.up)), -pitch)
    new_sight = _unit(tilted.target - tilted.position)
    # The up direction is kept, because the picture would flip past the pole.
    too_steep = abs(new_sight @ viewpoint.up) > max(STEEPEST, abs(sight @ viewpoint.up))
    return turned if too_steep else replace(tilted, up=viewpoint.up)


def zoomed(viewpoint: Viewpoint, factor: float) -> Viewpoint:
    """The viewpoint moved closer to the target (factor < 1) or further away."""
    sight = viewpoint.target - viewpoint.position
    distance = float(np.clip(np.linalg.norm(sight) * factor, NEAREST_MM, FURTHEST_MM))
    return replace(viewpoint, position=viewpoint.target - distance * _unit(sight))


def panned(viewpoint: Viewpoint, dx_px: float, dy_px: float) -> Viewpoint:
    """The viewpoint moved sideways so that the target moves by this many pixels in the picture."""
    sight = viewpoint.target - viewpoint.position
    right = _unit(np.cross(sight, viewpoint.up))
    down = np.cross(_unit(sight), right)
    distance = np.linalg.norm(sight)
    offset = -distance * (dx_px / viewpoint.camera.focal_px[0] * right + dy_px / viewpoint.camera.focal_px[1] * down)
    return replace(viewpoint, position=viewpoint.position + offset, target=viewpoint.target + offset)


def azimuth_deg(viewpoint: Viewpoint) -> float:
    """Angle about the head's vertical axis: 0 from the front, positive from the subject's left."""
    away = viewpoint.position - viewpoint.target
    return float(np.degrees(np.arctan2(away[0], -away[2])))


def _contained(camera: Camera, image_size: tuple[int, int], size: tuple[int, int]) -> Camera:
    principal = np.asarray(camera.principal_point_px, float)
    # From the principal point to the further edge of the picture, on both axes; edges are half a pixel outside.
    reach = np.maximum(principal + 0.5, np.asarray(image_size) - 0.5 - principal)
    scale = float(np.min(0.5 * np.asarray(size) / reach))
    centre = (np.asarray(size, float) - 1) / 2
    return Camera(np.asarray(camera.focal_px, float) * scale, centre, np.asarray(camera.distortion, float))


def _turned(viewpoint: Viewpoint, axis: np.ndarray, angle: float) -> Viewpoint:
    matrix = cv2.Rodrigues(axis * angle)[0]
    away = viewpoint.position - viewpoint.target
    return replace(viewpoint, position=viewpoint.target + matrix @ away)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
