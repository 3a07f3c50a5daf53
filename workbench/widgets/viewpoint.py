"""From where a head is looked at: fitted camera, frontal portrait, and what a mouse does to them."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float

from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.head_picture import portrait_view

NEAREST_MM, FURTHEST_MM = 150.0, 6000.0
"""Distances from the target that a mouse wheel can reach."""
PIVOT_MM = 60.0
"""Depth of the middle of a head behind its eyes: there a drag turns it."""
STEEPEST = 0.995
"""Cosine between the line of sight and the up direction at which a drag stops tilting."""


@dataclass(frozen=True)
class Viewpoint:
    """A camera in the head frame (millimetres), looking along the line from position to target."""

    position: Float[np.ndarray, "3"]
    target: Float[np.ndarray, "3"]
    """Where the line of sight passes the head; a drag turns about it."""
    up: Float[np.ndarray, "3"]
    """Unit direction that points up in the picture: (0, -1, 0) for an upright head."""
    camera: Camera
    """Of a picture of the viewer's size."""

    @property
    def pose(self) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Rotation (axis-angle) and translation, head to camera."""
        forward = _unit(self.target - self.position)
        right = _unit(np.cross(forward, self.up))
        matrix = np.stack([right, np.cross(forward, right), forward])
        return cv2.Rodrigues(matrix)[0][:, 0], -matrix @ self.position

    def vertical_fov_deg(self, height_px: int) -> float:
        """Angle that the picture's height subtends, degrees."""
        return float(2 * np.degrees(np.arctan(0.5 * height_px / self.camera.focal_px[1])))


def front_viewpoint(model: FaceModel, size: tuple[int, int]) -> Viewpoint:
    """A portrait from straight ahead, in a picture (width, height)."""
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

    The optical axis goes through the middle of the viewer: WebGL viewers know no other camera. So the viewer's pixel is
    centre + scale · (input pixel − principal point), and a centred input camera gives its picture resized.
    """
    return viewpoint_of_pose(rotation, translation, _contained(camera, image_size, size))


def viewpoint_of_pose(
    rotation: Float[np.ndarray, "3"], translation: Float[np.ndarray, "3"], camera: Camera
) -> Viewpoint:
    """The viewpoint of a head posed before this camera; its target lies on the optical axis, as deep as the head."""
    matrix = cv2.Rodrigues(np.asarray(rotation, float))[0]
    position = -matrix.T @ translation
    distance = max(float(translation[2]) + PIVOT_MM, 1.0)
    return Viewpoint(position, position + distance * matrix[2], -matrix[1], camera)


def orbited(viewpoint: Viewpoint, yaw: float, pitch: float) -> Viewpoint:
    """Turned about the target (radians) as if the head were dragged: yaw > 0 to image right, pitch > 0 downwards."""
    turned = _turned(viewpoint, viewpoint.up, -yaw)
    sight = _unit(turned.target - turned.position)
    tilted = _turned(turned, _unit(np.cross(sight, turned.up)), -pitch)
    new_sight = _unit(tilted.target - tilted.position)
    # The up direction stays: past the pole the picture would flip.
    too_steep = abs(new_sight @ viewpoint.up) > max(STEEPEST, abs(sight @ viewpoint.up))
    return turned if too_steep else replace(tilted, up=viewpoint.up)


def zoomed(viewpoint: Viewpoint, factor: float) -> Viewpoint:
    """Nearer to the target (factor < 1) or further away."""
    sight = viewpoint.target - viewpoint.position
    distance = float(np.clip(np.linalg.norm(sight) * factor, NEAREST_MM, FURTHEST_MM))
    return replace(viewpoint, position=viewpoint.target - distance * _unit(sight))


def panned(viewpoint: Viewpoint, dx_px: float, dy_px: float) -> Viewpoint:
    """Moved sideways, so that the target moves by this many pixels in the picture."""
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
    # From the principal point to the further edge of the picture, on both axes; edges lie half a pixel outside.
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
