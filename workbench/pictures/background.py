"""What is behind a rendered head."""

import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import InputError

SLATE = (58, 64, 72)


def background_picture(
    background: UInt8[np.ndarray, "h w 3"] | tuple[int, int, int] | None, size: tuple[int, int]
) -> UInt8[np.ndarray, "h w 3"]:
    """A new picture (width, height): plain slate for None, one RGB colour, or a copy of a picture of this size.

    Raises `InputError` for a picture of another size.
    """
    width, height = size
    if isinstance(background, np.ndarray):
        if background.shape != (height, width, 3) or background.dtype != np.uint8:
            raise InputError(
                f"The background needs {width} × {height} pixels, 8-bit RGB, got {background.dtype} of shape "
                f"{background.shape}; resize it first."
            )
        return background.copy()
    return np.full((height, width, 3), SLATE if background is None else background, np.uint8)


def composite(rgba: UInt8[np.ndarray, "h w 4"], background: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Picture over background, where the picture's colours are already multiplied by its alpha."""
    picture = rgba[..., :3].copy()
    alpha = rgba[..., 3]
    picture[alpha == 0] = background[alpha == 0]
    edge = (alpha > 0) & (alpha < 255)
    behind: Float[np.ndarray, "n 3"] = background[edge] * (1.0 - alpha[edge, None] / 255.0)
    picture[edge] = np.clip(np.rint(picture[edge] + behind), 0, 255).astype(np.uint8)
    return picture
