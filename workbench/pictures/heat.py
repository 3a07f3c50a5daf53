"""What the landmark network sees, as a layer over the picture: where it looked, and where it takes landmarks to be."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

from workbench.landmarks.network_detector import CROP_SIDE, NetworkLook

LARGEST_SIDE = 1280
"""Longest side of the layer in pixels."""
HEAT, FRAME = (30, 120, 255), (255, 255, 255)
"""Colours of the heat and of the crop's outline."""


def heat_layer(look: NetworkLook, points: Sequence[int] = ()) -> UInt8[np.ndarray, "h w 4"]:
    """The heat maps of these landmarks (of all of them if none is named), and the outline of the crop.

    A layer for the whole picture, reduced if that is very large. Each landmark's map is opaque at its maximum and
    shows the square root of the probability beside it: else the flanks, which tell doubt, would not be seen.
    """
    width, height = look.landmarks.image_size
    scale = min(1.0, LARGEST_SIDE / max(width, height))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    maps = look.probability[list(points)] if len(points) else look.probability
    share = np.sqrt(maps / maps.max(axis=(1, 2), keepdims=True)).max(axis=0)
    stride = CROP_SIDE / share.shape[-1]
    # Where the map's pixels (0, 0), (1, 0) and (0, 1) lie.
    origin, right, down = _in_layer(look, stride * np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]]) - 0.5, scale)
    matrix = np.column_stack([right - origin, down - origin, origin])
    alpha = cv2.warpAffine(share.astype(np.float32), matrix, size, flags=cv2.INTER_LINEAR)
    layer = np.empty((size[1], size[0], 4), np.uint8)
    layer[..., :3], layer[..., 3] = HEAT, np.rint(255 * np.clip(alpha, 0, 1))
    ends = CROP_SIDE * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - 0.5
    corners = np.rint(_in_layer(look, ends, scale)).astype(np.int32)
    cv2.polylines(layer, [corners], True, (*FRAME, 160), max(1, round(max(size) / 640)), cv2.LINE_AA)
    return layer


def _in_layer(look: NetworkLook, places: np.ndarray, scale: float) -> np.ndarray:
    """Pixels of the crop as pixels of the layer."""
    return (look.to_image.to_image(places) + 0.5) * scale - 0.5
