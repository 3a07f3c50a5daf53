"""Colours and light of a shot for Deep Energies, from its most neutral and frontal picture (Sec. 3)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, UInt8
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters
from workbench.geometry import yaw_pitch_roll_deg
from workbench.rendering import (
    Appearance,
    CharacterLook,
    RenderModel,
    estimate_appearance,
    hidden_pixels,
    known_appearance,
    vertex_colors,
)
from workbench.tracking.records import FrameFit

NEUTRAL_YAW_DEG = 25.0
"""For choosing the appearance frame, a blendshape weight of 1 counts as much as this yaw."""


def most_neutral_appearance(
    pictures: Sequence[UInt8[np.ndarray, "h w 3"]],
    fits: Sequence[FrameFit],
    person: FaceModel,
    model: RenderModel,
    look: CharacterLook | None = None,
) -> Appearance | None:
    """The appearance in the picture whose fit is the most neutral, None where the face is too small.

    With a look the colours are the character's, and the light comes from what its hair leaves of the face. `person`
    is the face model with the fits' identity, `model` the one without.
    """
    best = min(range(len(fits)), key=lambda k: _unfitness(fits[k]))
    picture, fit = pictures[best], fits[best]
    vertices = person.vertices(fit.expression)
    from_head = Rotation.from_rotvec(np.array(fit.rotation)).apply(vertices) + fit.translation
    seen = (picture, person, from_head, fit.camera)
    try:
        if look is None:
            return estimate_appearance(*seen)
        return known_appearance(*seen, vertex_colors(look.texture, person), _hidden(look, fit, model, picture))
    except InputError:
        return None  # the face is too small: use the model's own colours


def _hidden(
    look: CharacterLook, fit: FrameFit, model: RenderModel, picture: UInt8[np.ndarray, "h w 3"]
) -> Bool[np.ndarray, "h w"] | None:
    if look.cover is None:
        return None
    parameters = FaceParameters(fit.rotation, fit.translation, fit.expression, fit.identity, np.zeros(6), np.ones(1))
    return np.asarray(hidden_pixels(look.cover, model, parameters, fit.camera, size=picture.shape[1::-1]))


def _unfitness(fit: FrameFit) -> float:
    yaw, pitch, _ = yaw_pitch_roll_deg(fit.rotation)
    return float((abs(yaw) + abs(pitch)) / NEUTRAL_YAW_DEG + np.abs(fit.expression).sum() + fit.errors[1] / 5.0)
