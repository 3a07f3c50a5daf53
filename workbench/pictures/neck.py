"""The neck between a head and a body that turns less than it does: skin, shirt and long hair bend alike."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from workbench.face.model import FaceModel

BEND_BELOW_CHIN_MM = (3.0, 45.0)
"""Heights below the chin where the head's rotation ends and where the body's begins."""
BODY_SHARE = 0.4
"""Of a head's rotation, how much the body joins in, in films."""


@dataclass(frozen=True)
class Neck:
    """Where a person's neck bends; head frame, millimetres."""

    pivot: Float[np.ndarray, "3"]
    chin: float
    """Height (y) of the chin at rest."""


def neck_of(model: FaceModel, rest: Float[np.ndarray, "v 3"]) -> Neck:
    """The neck of a model with a neck joint; `rest` are the vertices of the person without an expression."""
    return Neck(np.asarray(model.joints["neck"], float), float(model.landmarks.of(rest)[8, 1]))


def bent(
    points: Float[np.ndarray, "n 3"],
    heights: Float[np.ndarray, "n"],
    neck: Neck,
    rotation: Float[np.ndarray, "3"],
    body: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "n 3"]:
    """Head-frame points of which those below the chin turn with the body; `heights` (y) are the points' at rest.

    `rotation` and `body` are axis-angle, to the camera: of the head and of the body. Landmarks lie above and stay.
    """
    first, last = (neck.chin + below for below in BEND_BELOW_CHIN_MM)
    share = np.clip((heights - first) / (last - first), 0.0, 1.0)
    share = share * share * (3.0 - 2.0 * share)
    turning = np.flatnonzero(share)
    relative = cv2.Rodrigues(np.asarray(rotation, float))[0].T @ cv2.Rodrigues(np.asarray(body, float))[0]
    vector = cv2.Rodrigues(relative)[0][:, 0]
    angle = float(np.linalg.norm(vector))
    if not angle or not len(turning):
        return points
    axis, angles = vector / angle, (angle * share[turning])[:, None]
    arms = points[turning] - neck.pivot
    along = (arms @ axis)[:, None] * axis
    moved = np.array(points, float)
    moved[turning] = neck.pivot + along + np.cos(angles) * (arms - along) + np.sin(angles) * np.cross(axis, arms)
    return moved
