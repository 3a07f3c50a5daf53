"""Where a shot ends: thumbnails of consecutive pictures that have little in common."""

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

THUMBNAIL = 32


def thumbnail_of(picture: UInt8[np.ndarray, "h w 3"]) -> Float32[np.ndarray, "s s"]:
    """A tiny grey picture; taking every k-th pixel first makes its cost that of any size."""
    step = max(1, min(picture.shape[:2]) // 144)
    small = cv2.resize(
        np.ascontiguousarray(picture[::step, ::step]), (THUMBNAIL, THUMBNAIL), interpolation=cv2.INTER_AREA
    )
    return cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float32)


def correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Normalised correlation of two thumbnails; grey levels within a deviation of 2 count as equal (dark pictures)."""
    a, b = first - first.mean(), second - second.mean()
    floor = a.size * 2.0**2
    return float(((a * b).sum() + floor) / (np.sqrt((a * a).sum() * (b * b).sum()) + floor))
