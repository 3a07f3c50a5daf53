"""Lights for pictures of heads, in the camera frame (+x image right, +y down, +z away from the camera)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Light:
    """A distant light."""

    direction: tuple[float, float, float]
    """From where the light comes: (-1, -1, -1) is from the upper left, on the camera's side."""
    intensity: float
    """1 shows a surface that faces the light in its full colour."""
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """RGB, 0 to 1."""


@dataclass(frozen=True)
class Lighting:
    """Several lights, and what a surface shows without any light."""

    lights: tuple[Light, ...]
    ambient: float
    """Share of the surface colour that is seen without any light."""


STUDIO = Lighting(
    lights=(
        Light((-0.55, -0.65, -1.0), 0.62, (1.0, 0.97, 0.92)),
        Light((0.9, -0.1, -0.8), 0.26, (0.86, 0.92, 1.0)),
        Light((0.5, -0.7, 0.9), 0.30, (1.0, 1.0, 1.0)),
    ),
    ambient=0.24,
)
"""Warm key from the upper left, cool fill from the right, and a rim from behind that lifts the head off its ground."""
SKIN_SHINE, WET_SHINE = (0.10, 14.0), (0.55, 70.0)
"""(strength, exponent) of the highlights on skin, and on eyes, teeth and tongue."""
