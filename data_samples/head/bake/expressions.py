"""The 52 ARKit units on the crop, made mirror symmetric."""

import numpy as np
from crop import Crop
from jaxtyping import Float
from makehuman import MakeHuman


def face_units(source: MakeHuman, crop: Crop) -> dict[str, Float[np.ndarray, "v 3"]]:
    """Displacements (mm, our head frame) by ARKit name, sorted.

    Left/right pairs (including jawLeft/jawRight and mouthLeft/mouthRight) are made exact mirror images by averaging
    each with the mirror of the other; units without a partner are made symmetric. The files differ by up to 2 mm.
    """
    raw = {name: source.unit(name)[crop.base_ids] * [100.0, -100.0, -100.0] for name in source.unit_names}
    return {name: 0.5 * (raw[name] + crop.mirrored(raw[partner(name)])) for name in sorted(raw)}


def partner(name: str) -> str:
    """The unit on the other side of the face; a unit without a side is its own partner."""
    for side, other in (("Left", "Right"), ("Right", "Left")):
        if name.endswith(side):
            return name.removesuffix(side) + other
    return name
