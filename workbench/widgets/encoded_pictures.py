"""Pictures as bytes that a browser shows."""

import cv2
import numpy as np
from jaxtyping import Shaped, UInt8

from workbench.errors import InputError

JPEG_QUALITY = 88
LARGEST_SIDE = 2560
"""Larger pictures are reduced to this side before sending; landmarks stay in pixels of the original."""


def picture_bytes(rgb: UInt8[np.ndarray, "h w 3"]) -> bytes:
    """JPEG of an RGB picture, reduced if it is very large."""
    longest = max(rgb.shape[:2])
    if longest > LARGEST_SIDE:
        scale = LARGEST_SIDE / longest
        size = (max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale)))
        rgb = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    return cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def layer_bytes(rgba: Shaped[np.ndarray, "..."] | None) -> bytes:
    """PNG of a picture with transparency, uint8 (h, w, 4); empty for None. Raises `InputError` for another array."""
    if rgba is None:
        return b""
    if rgba.ndim != 3 or rgba.shape[2] != 4 or rgba.dtype != np.uint8:
        raise InputError(f"a layer must be uint8 of shape (h, w, 4); got {rgba.dtype} of shape {rgba.shape}")
    pixels = cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA)
    return cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()
