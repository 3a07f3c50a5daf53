"""Flow as colours: direction as hue, length as saturation, on the wheel of Baker et al. (IJCV 2011, "Middlebury")."""

import numpy as np
from jaxtyping import Float, UInt8

SEGMENTS = (("red", "yellow", 15), ("yellow", "green", 6), ("green", "cyan", 4), ("cyan", "blue", 11),
            ("blue", "magenta", 13), ("magenta", "red", 6))  # fmt: skip
"""Arcs of the wheel and their numbers of steps: more where the eye distinguishes more hues."""
CORNERS = {
    "red": (255, 0, 0), "yellow": (255, 255, 0), "green": (0, 255, 0),
    "cyan": (0, 255, 255), "blue": (0, 0, 255), "magenta": (255, 0, 255),
}  # fmt: skip
UNKNOWN_COLOR = (0, 0, 0)
DARKENED = 0.75
"""Brightness of vectors longer than the longest that is shown in full colour."""


def color_wheel() -> Float[np.ndarray, "55 3"]:
    """The 55 fully saturated colours, 0..255, from red on."""
    arcs = []
    for start, end, steps in SEGMENTS:
        share = np.arange(steps)[:, None] / steps
        arcs.append(np.floor(np.asarray(CORNERS[start]) * (1 - share) + np.asarray(CORNERS[end]) * share))
    return np.concatenate(arcs)


def flow_picture(
    flow: Float[np.ndarray, "h w 2"], longest_px: float | int | None = None
) -> UInt8[np.ndarray, "h w 3"]:  # fmt: skip
    """The flow in Baker's colours: white where nothing moves, the wheel's colour at `longest_px`, darker beyond.

    Red is to the right, yellow down, cyan-blue to the left, violet up. `longest_px` is the longest vector by default;
    give one for pictures that are compared. Vectors that are not finite are black.
    """
    flow = np.asarray(flow, np.float64)
    known = np.isfinite(flow).all(axis=-1)
    vectors = np.where(known[..., None], flow, 0.0)
    length = np.linalg.norm(vectors, axis=-1)
    longest = float(length.max(initial=0.0)) if longest_px is None else float(longest_px)
    radius = length / max(longest, 1e-9)
    wheel = color_wheel()
    # As in the reference: angle −π..π from the negative axis, so that red points to the right.
    place = (np.arctan2(-vectors[..., 1], -vectors[..., 0]) / np.pi + 1) / 2 * (len(wheel) - 1)
    first = np.floor(place).astype(int)
    share = (place - first)[..., None]
    color = ((1 - share) * wheel[first] + share * wheel[(first + 1) % len(wheel)]) / 255
    radius = radius[..., None]
    color = np.where(radius <= 1 + 1e-9, 1 - radius * (1 - color), DARKENED * color)
    return np.where(known[..., None], np.floor(255 * np.clip(color, 0, 1)), UNKNOWN_COLOR).astype(np.uint8)


def wheel_picture(side: int = 151) -> UInt8[np.ndarray, "side side 3"]:
    """The key to the colours: a disc whose pixels have the colour of the vector from its middle to them."""
    reach = np.linspace(-1.0, 1.0, side)
    x, y = np.meshgrid(reach, reach)
    picture = flow_picture(np.stack([x, y], axis=-1), 1.0)
    picture[x * x + y * y > 1.0] = 255
    return picture
