"""Blendshapes and a jaw joint for formats that apply them one after the other: first the shapes, then the joints."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from workbench.export.clip import Clip
from workbench.face import JawJoint, JawUnit

CORRECTIVES = ("jawCorrective", "jawCorrective2", "jawCorrective3", "jawCorrectiveYaw", "jawCorrectiveRoll")
"""Shapes that a turned jaw adds; their weights are in `corrective_weights`."""
SAMPLES = 7


class Shapes(NamedTuple):
    """Morph targets of a clip."""

    names: tuple[str, ...]
    deltas: Float[np.ndarray, "k v 3"]
    """Head frame, millimetres."""
    weights: Float[np.ndarray, "n k"]


def clip_shapes(clip: Clip) -> Shapes:
    """The person's blendshapes, and where the jaw joint moves what it adds to its hinge."""
    person, track = clip.person, clip.track
    if not clip.moves_jaw:
        return Shapes(person.expression_names, person.expression_deltas, track.expression)
    most = np.abs(track.jaw[track.found, :3]).max(0)
    deltas = np.concatenate([person.expression_deltas, corrective_shapes(clip.joint, most)])
    weights = np.concatenate([track.expression, corrective_weights(track.jaw, clip.joint.unit)], axis=1)
    return Shapes((*person.expression_names, *CORRECTIVES), deltas, weights)


def corrective_weights(jaw: Float[np.ndarray, "n _"], unit: JawUnit) -> Float[np.ndarray, "n 5"]:
    """a, a², a³, a·y, a·z: a the angle about x counted in the unit's, y and z the other two in radians."""
    amount = jaw[:, :1] / np.radians(unit.open_deg)
    return np.concatenate([amount, amount**2, amount**3, amount * jaw[:, 1:3]], axis=1)


def corrective_shapes(joint: JawJoint, most: Float[np.ndarray, "3"]) -> Float[np.ndarray, "5 v 3"]:
    """Shapes that the joint turns into the corrective of `move_jaw`, which is added after the joint.

    A vertex that hangs on the jaw by w is turned by M = (1 − w)·1 + w·R, so that the shape must be M⁻¹·a·c for the
    corrective a·c. Over turns up to `most` (axis-angle, radians) that is a sum of five shapes to a few hundredths of a
    millimetre: least squares over a grid of turns.
    """
    grids = np.meshgrid(np.linspace(0.0, 1.0, SAMPLES) * max(most[0], 1e-3), *(np.array([-m, 0, m]) for m in most[1:]))
    jaws = np.stack([grid.ravel() for grid in grids], axis=1)
    turns = Rotation.from_rotvec(jaws).as_matrix()
    moving = np.flatnonzero(np.abs(joint.corrective).max(1) > 0.0)
    weights, corrective = np.asarray(joint.weights)[moving, None, None], np.asarray(joint.corrective)[moving]
    design = corrective_weights(jaws, joint.unit)
    wanted = np.stack(
        [np.linalg.solve((1.0 - weights) * np.eye(3) + weights * turn, a * corrective[:, :, None])
         for a, turn in zip(design[:, 0], turns, strict=True)]
    )  # fmt: skip
    found = np.zeros((len(CORRECTIVES), len(joint.weights), 3))
    found[:, moving] = np.linalg.lstsq(design, wanted.reshape(len(jaws), -1), rcond=None)[0].reshape(5, -1, 3)
    return found
