"""Materials of what a character wears, for every format with materials."""

from dataclasses import dataclass

STILL_MM = 0.005
"""Parts that a blendshape moves less do not have it."""


@dataclass(frozen=True)
class Look:
    """A material. Cards whose order nobody sorts are cut out at `cutoff`; what is thin or clear is blended."""

    roughness: float
    alpha: bool = False
    """Whether the picture's alpha counts."""
    cutoff: float = 0.0
    """What is less opaque is cut out; 0: it is blended."""
    both_sides: bool = False
    opacity: float = 1.0


SKIN = Look(0.65)
LOOKS = {
    "tongue": Look(0.45),
    "teeth": Look(0.3),
    "eyes": Look(0.5),
    "corneas": Look(0.05, opacity=0.08),
    "brows": Look(0.9, alpha=True, both_sides=True),
    "lashes": Look(0.9, alpha=True, both_sides=True),
    "clothes": Look(0.9, alpha=True, cutoff=0.5, both_sides=True),
    "hair": Look(0.7, alpha=True, cutoff=0.35, both_sides=True),
}
"""By kind of part."""
