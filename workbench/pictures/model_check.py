"""A picture to check a face model by: the face from front and side with its 68 landmarks, and one expression."""

import cv2
import numpy as np
from jaxtyping import UInt8

from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.landmarks.scheme import GROUPS
from workbench.pictures.head_picture import head_painter, portrait_view
from workbench.pictures.lettering import write_text
from workbench.pictures.mesh import to_camera, to_pixels

SIDE_YAW_DEG = 55.0
COLORS = {
    "jaw": (240, 190, 60),
    "brows": (90, 200, 120),
    "nose": (235, 100, 90),
    "eyes": (70, 170, 240),
    "mouth": (235, 110, 200),
}
SHOWN_EXPRESSIONS = ("jawOpen", "mouthSmileLeft")
MARGIN_PX = 12


def model_check_picture(model: FaceModel, side: int = 560) -> UInt8[np.ndarray, "h w 3"]:
    """Front, side (the subject's left towards the camera) and, where the model has any, one expression.

    Points are coloured by group; point 36 is the outer corner of the subject's right eye, at the picture's left.
    """
    camera, translation = portrait_view(model, (side, side))
    turned = np.array([0.0, np.radians(SIDE_YAW_DEG), 0.0])
    panels = []
    with head_painter(model, (side, side)) as painter:
        for name, rotation, vertices in (
            ("front, identity 0", np.zeros(3), model.neutral),
            ("side", turned, model.neutral),
            *_expression(model),
        ):
            sideways = to_camera(vertices, rotation, np.zeros(3))[:, 0]
            centred = translation - [0.5 * (sideways.min() + sideways.max()), 0.0, 0.0]
            picture = painter.render(vertices, camera, rotation, centred).copy()
            _mark(picture, model, vertices, camera, rotation, centred)
            write_text(picture, name, (MARGIN_PX, side - MARGIN_PX), (235, 235, 235), 16)
            panels.append(picture)
    return np.concatenate(panels, axis=1)


def _expression(model: FaceModel) -> list[tuple[str, np.ndarray, np.ndarray]]:
    if not model.expression_names:
        return []
    name = next((name for name in SHOWN_EXPRESSIONS if name in model.expression_names), model.expression_names[0])
    weights = np.zeros(len(model.expression_names))
    column = model.expression_names.index(name)
    weights[column] = model.weight_range()[column, 1]
    return [(f"{name} = {weights[column]:g}", np.zeros(3), model.vertices(weights))]


def _mark(
    picture: np.ndarray, model: FaceModel, vertices: np.ndarray, camera: Camera, rotation: np.ndarray, translation
) -> None:
    points_head = model.landmarks.of(vertices)
    pixels = to_pixels(camera, to_camera(points_head, rotation, translation))
    # Turned by a positive yaw, the subject's right half is behind the face.
    seen = points_head[:, 0] > -8.0 if rotation[1] > 0.0 else np.ones(68, bool)
    for group, color in COLORS.items():
        for point in GROUPS[group]:
            if seen[point]:
                centre = tuple(np.rint(pixels[point] * 16).astype(int).tolist())
                cv2.circle(picture, centre, 5 * 16, (20, 20, 20), -1, cv2.LINE_AA, 4)
                cv2.circle(picture, centre, 3 * 16 + 8, color, -1, cv2.LINE_AA, 4)
