"""Messages that describe a face model to the browser: surface, colours, lights, and marks as balls and rods."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.face.dressed_head import DressedHead
from workbench.face.model import FaceModel
from workbench.pictures.background import SLATE
from workbench.pictures.extras import GHOST_COLOR, OUTLINE_COLOR, WET_REGIONS, is_outer
from workbench.pictures.head_picture import bundled_texture
from workbench.pictures.lighting import SKIN_SHINE, STUDIO, WET_SHINE
from workbench.pictures.mesh import neck_opacity, split_seams
from workbench.widgets.worn_message import worn_message

TEXTURE_QUALITY = 90
COLLAR_TILT, COLLAR_MM = 0.25, 600.0
"""The neck is cut by a plane that slopes down to the front, just above the ragged rim of the mesh. The value that marks
the cut goes from 0 to 1 over more than a head's length; it is linear in every triangle, so the cut is straight."""


def surface_message(model: FaceModel, dressed: DressedHead | None = None) -> dict[str, object]:
    """The static data of a head: triangles, texture or colours, lights; see `drawing/mesh.js`.

    Vertices on a texture seam become several points: "order" has the vertex of each point, "drawn" the triangles over
    points, with those of the skin ("outer" of them) before those of eyes and mouth. "triangles" are the model's own.
    "worn" has the parts of a character (`worn_message`), which stand for the model's eyes, teeth and tongue.
    """
    picture = bundled_texture(model) if dressed is None else dressed.skin
    if picture is None:
        order, drawn, uv, texture = np.arange(len(model.neutral)), model.triangles, np.zeros((0, 2)), b""
    else:
        order, uv_index, drawn = split_seams(model.triangles, model.triangles_uv)
        uv = model.uv[uv_index] * [1.0, -1.0] + [0.0, 1.0]
        quality = [cv2.IMWRITE_JPEG_QUALITY, TEXTURE_QUALITY]
        texture = cv2.imencode(".jpg", picture[..., ::-1], quality)[1].tobytes()
    outer = is_outer(model)
    inner = ~outer if dressed is None else ~outer & dressed.shown
    plane = None if dressed is not None and dressed.clothed else collar(model)
    directions = np.array([light.direction for light in STUDIO.lights])
    return {
        "vertices": len(model.neutral),
        "triangles": np.ascontiguousarray(model.triangles, "<u4").tobytes(),
        "drawn": np.concatenate([drawn[outer], drawn[inner]]).astype("<u4").tobytes(),
        "outer": int(outer.sum()),
        "order": np.ascontiguousarray(order, "<u4").tobytes(),
        "uv": np.ascontiguousarray(uv, "<f4").tobytes(),
        "texture": texture,
        "colors": np.ascontiguousarray(model.colors).tobytes(),
        "collar": None if plane is None else plane.tolist(),
        "shown": np.ascontiguousarray(collar_opacity(model, plane), "<f4").tobytes(),
        "wet": (255 * model.in_regions(WET_REGIONS).astype(np.uint8)).tobytes(),
        "lights": {
            "from": (directions / np.linalg.norm(directions, axis=1, keepdims=True)).ravel().tolist(),
            "strength": [light.intensity * part for light in STUDIO.lights for part in light.color],
            "ambient": STUDIO.ambient,
        },
        "shine": [*SKIN_SHINE, *WET_SHINE],
        "ghost": list(GHOST_COLOR),
        "outline": list(OUTLINE_COLOR),
        "ground": list(SLATE),
        "worn": [] if dressed is None else [worn_message(worn) for worn in dressed.worn],
        "width": [] if dressed is None else dressed.scale_vertices[0].tolist(),
    }


def rods_message(
    ends: Float[np.ndarray, "n 2 3"], colors: UInt8[np.ndarray, "n 3"], diameter_mm: float | int
) -> dict[str, object]:
    """Rods with round ends, or balls if both ends coincide; head frame, millimetres."""
    return {"ends": ends.astype("<f4").tobytes(), "colors": colors.tobytes(), "mm": float(diameter_mm)}


def collar(model: FaceModel) -> Float[np.ndarray, "4"] | None:
    """The plane that cuts off the neck, where normal · x > distance (mm); None for a head without a rim."""
    normal = np.array([0.0, 1.0, COLLAR_TILT])
    rim = neck_opacity(model) == 0.0
    return np.append(normal, (model.neutral[rim] @ normal).min() - 1.0) if rim.any() else None


def collar_opacity(model: FaceModel, plane: Float[np.ndarray, "4"] | None) -> Float[np.ndarray, "v"]:
    """Above 0.5 on the head's side of the cutting plane and below 0.5 on the neck's; 1 without a plane."""
    if plane is None:
        return np.ones(len(model.neutral))
    return np.clip(0.5 + (plane[3] - model.neutral @ plane[:3]) / COLLAR_MM, 0.0, 1.0)
