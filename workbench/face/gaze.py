"""Where the eyes of a face model look: how far each blendshape turns them, and the units of the default head's."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from workbench.face.default_head import GAZE_NAMES, load_default_head
from workbench.face.model import FaceModel
from workbench.landmarks.schemes import PUPILS

EYES = ("rightEye", "leftEye")
"""The joints that eyeballs turn about, the person's right one first."""


def eye_turns(model: FaceModel) -> Float[np.ndarray, "4 k"]:
    """Degrees that each blendshape at weight 1 turns the right eye to the subject's left and up, then the left one.

    The model's landmarks have pupils. Zero for all but the eyes' units.
    """
    turns = np.zeros((4, len(model.expression_names)))
    names = [k for k, name in enumerate(model.expression_names) if name in GAZE_NAMES]
    deltas = model.landmarks.of(model.expression_deltas[names])[:, list(PUPILS)]
    rest = model.landmarks.of(model.neutral)[list(PUPILS)] - eye_centres(model)
    turns[:, names] = (directions_deg(rest + deltas) - directions_deg(rest)).reshape(len(names), 4).T
    return turns


def gaze_deg(model: FaceModel, expression: Float[np.ndarray, "k"]) -> Float[np.ndarray, "2 2"]:
    """Where the right and the left eye look with these weights, in the head: degrees to the subject's left and up.

    The model's landmarks have pupils.
    """
    pupils = model.landmarks.of(model.vertices(expression))[list(PUPILS)]
    return directions_deg(pupils - eye_centres(model))


def eye_centres(model: FaceModel) -> Float[np.ndarray, "2 3"]:
    """What the right and the left eye turn about, head frame, millimetres."""
    return np.stack([model.joints[eye] for eye in EYES])


def directions_deg(towards: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Azimuth and elevation of vectors in the head frame, in which the face looks along -z and y points down."""
    x, y, z = np.moveaxis(towards, -1, 0)
    return np.degrees(np.stack([np.arctan2(x, -z), np.arctan2(-y, np.hypot(x, z))], axis=-1))


def angle_between_deg(one: Float[np.ndarray, "*n 2"], other: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """The angle between two directions given as azimuth and elevation, all in degrees."""
    first, second = (_vectors(np.radians(each)) for each in (one, other))
    return np.degrees(np.arccos(np.clip((first * second).sum(axis=-1), -1.0, 1.0)))


def _vectors(angles: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    across, up = np.moveaxis(angles, -1, 0)
    return np.stack([np.sin(across) * np.cos(up), -np.sin(up), -np.cos(across) * np.cos(up)], axis=-1)


def with_eye_units(model: FaceModel) -> FaceModel:
    """The model with the eyes' units of the default head, whose mesh it has; as it is where it has them."""
    if set(GAZE_NAMES) <= set(model.expression_names):
        return model
    full = load_default_head(gaze=True)
    order = {name: place for place, name in enumerate(full.expression_names)}
    added = [name for name in GAZE_NAMES if name not in model.expression_names]
    names, known = (*model.expression_names, *added), set(model.expression_names) <= set(order)
    places = sorted(range(len(names)), key=lambda k: order[names[k]]) if known else range(len(names))
    deltas = np.concatenate([model.expression_deltas, full.expression_deltas[[order[name] for name in added]]])
    limits = np.concatenate([model.weight_range(), np.tile([0.0, 1.0], (len(added), 1))])
    return replace(
        model,
        expression_names=tuple(names[k] for k in places),
        expression_deltas=deltas[list(places)],
        expression_range=None if model.expression_range is None else limits[list(places)],
        fixed_jaw_unit=model.jaw_unit,
    )
