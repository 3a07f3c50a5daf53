"""How what a character wears takes the light, in every way of drawing it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finish:
    """How a kind of part takes the light."""

    shine: tuple[float, float]
    """Strength and exponent of the highlights."""
    roundness: float = 0.0
    """How far normals point away from the head's middle, 0 to 1: cards of hair are lit as the ball that they cover."""


FINISHES = {
    "eyes": Finish((0.10, 20.0)),
    "corneas": Finish((1.0, 120.0)),
    "teeth": Finish((0.40, 40.0)),
    "tongue": Finish((0.35, 22.0)),
    "brows": Finish((0.0, 1.0)),
    "lashes": Finish((0.0, 1.0)),
    "clothes": Finish((0.0, 1.0)),
    "hair": Finish((0.14, 12.0), roundness=0.6),
}
