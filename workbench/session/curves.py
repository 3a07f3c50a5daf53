"""One number per frame of a clip, for charts."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from workbench.geometry import yaw_pitch_roll_deg
from workbench.tracking import FrameFit

ANGLES, PLACES = ("yaw", "pitch", "roll"), ("x", "y", "z")


def curve(fits: Sequence[FrameFit], quantity: str, names: Sequence[str] = ()) -> Float[np.ndarray, "n"]:
    """One number per frame: yaw, pitch or roll in degrees, x, y or z in mm, or the weight of a blendshape.

    `names` are the blendshape names. NaN in frames without a face.
    """
    if quantity in ANGLES:
        rotations = np.stack([np.asarray(fit.rotation, float) for fit in fits])
        angles = np.full((len(fits), 3), np.nan)
        known = np.isfinite(rotations).all(axis=1)
        if known.any():
            angles[known] = yaw_pitch_roll_deg(rotations[known])
        return angles[:, ANGLES.index(quantity)]
    if quantity in PLACES:
        return np.array([float(fit.translation[PLACES.index(quantity)]) for fit in fits])
    column = list(names).index(quantity)
    return np.array([float(fit.expression[column]) for fit in fits])


def moving_weights(fits: Sequence[FrameFit], names: Sequence[str], count: int) -> list[str]:
    """The `count` blendshapes whose weights vary most."""
    weights = np.stack([fit.expression for fit in fits if fit.found] or [np.zeros(len(names))])
    return [names[k] for k in np.argsort(-weights.std(axis=0), kind="stable")[:count]]
