"""Other colours for the pictures on a head: hair and brows by their lightness, skins by a shift in CIE Lab."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

SOLID = 128
"""Alpha from which a texel counts for a picture's own mean."""
BRIGHTEST = 240.0
SCALP_SHARE = 0.75
DARK = 30.0
"""Lightness (L) below which a skin is shifted less."""
LUMINANCE = np.array([0.299, 0.587, 0.114])


def tinted(picture: UInt8[np.ndarray, "h w 4"], color: tuple[float, float, float] | None) -> UInt8[np.ndarray, "h w 4"]:
    """The picture (RGBA) in shades of one colour, RGB, which becomes its mean; None leaves it as it is.

    Contrast shrinks towards black and white: fair hair has shadows that dark hair has not.
    """
    if color is None:
        return picture
    light = picture[..., :3] @ LUMINANCE
    solid = picture[..., 3] >= SOLID
    mean = max(float(light[solid].mean()) if solid.any() else 128.0, 1.0)
    # Dark textures are relatively more contrasty; shades of a fair colour would clip.
    ratio = (light / mean) ** min(1.0, (mean / max(float(np.mean(color)), 1.0)) ** 0.6)
    ratio /= max(float(ratio[solid].mean()) if solid.any() else 1.0, 1e-6)
    # Highlights approach white, they do not run into it.
    most = BRIGHTEST / max(*color, 1.0)
    ratio = (1.0 - np.exp(-ratio / most)) / (1.0 - np.exp(-1.0 / most))
    shades = np.clip(ratio[..., None] * np.asarray(color, float), 0, 255)
    return np.dstack([np.rint(shades).astype(np.uint8), picture[..., 3]])


def with_scalp(
    skin: UInt8[np.ndarray, "h w 3"], scalp: Float[np.ndarray, "h w"], color: tuple[float, float, float]
) -> UInt8[np.ndarray, "h w 3"]:
    """The skin (RGB) with its scalp, 0 to 1, drawn to the colour of the hair, which it shows between."""
    light = skin @ LUMINANCE
    mean = max(float((light * scalp).sum() / max(float(scalp.sum()), 1e-6)), 1.0)
    roots = np.clip(0.5 * (1.0 + light / mean)[..., None] * np.asarray(color, float), 0, 255)
    return np.rint(skin + SCALP_SHARE * scalp[..., None] * (roots - skin)).astype(np.uint8)


def shifted(picture: UInt8[np.ndarray, "h w 3"], shift: tuple[float, float, float]) -> UInt8[np.ndarray, "h w 3"]:
    """The picture (RGB) with (L, a, b) added in CIE Lab (L of 0 to 100), less and less where it is dark."""
    if not any(shift):
        return picture
    lab: Float[np.ndarray, "h w 3"] = cv2.cvtColor(picture.astype(np.float32) / 255.0, cv2.COLOR_RGB2LAB)
    share = np.clip(lab[..., :1] / DARK, 0.0, 1.0)  # a shifted black, as deep in the mouth, would be a colour
    moved = cv2.cvtColor((lab + share * np.asarray(shift, np.float32)).astype(np.float32), cv2.COLOR_LAB2RGB)
    return np.rint(np.clip(moved, 0.0, 1.0) * 255.0).astype(np.uint8)
