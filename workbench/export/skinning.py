"""Blendshapes and joints for formats that apply them one after the other: first the shapes, then the joints."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from workbench.export.clip import Clip
from workbench.face import GAZE_NAMES, FaceModel, JawJoint, JawUnit
from workbench.face.gaze import EYES
from workbench.face.parts import Part

CORRECTIVES = ("jawCorrective", "jawCorrective2", "jawCorrective3", "jawCorrectiveYaw", "jawCorrectiveRoll")
"""Shapes that a turned jaw adds; their weights are in `corrective_weights`."""
SAMPLES = 7
EYEBALL = 0.5
"""Parts of a mesh that lie within this share of the distance between the eyes about one of them are its eyeball."""
FRONT = 0.7
"""Cosine of the angle from straight ahead up to which an eyeball is its front."""
BESIDE = 0.5
"""Cosine of the angle from straight ahead from which on a vertex lies beside the joint."""


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


class Joint(NamedTuple):
    """What turns a part of a head, as a child of the head's own joint."""

    name: str
    place: Float[np.ndarray, "3"]
    """Head frame, millimetres."""
    holds: Float[np.ndarray, "v"]
    """Share of each vertex that moves with it."""
    turns: Float[np.ndarray, "n 3"] | None
    """Axis-angle in every frame, radians; None where it rests."""
    shifts: Float[np.ndarray, "n 3"] | None = None
    """Millimetres from its place; None where it stays."""


def clip_joints(clip: Clip) -> tuple[Joint, ...]:
    """The person's jaw, where the model has one, and both eyes, where its blendshapes turn eyeballs."""
    person, track = clip.person, clip.track
    joints = []
    if "jaw" in person.joints and person.jaw_weights.any():
        moved = (track.jaw[:, :3], track.jaw[:, 3:]) if clip.moves_jaw else (None, None)
        joints.append(Joint("jaw", np.asarray(clip.joint.joint, float), np.asarray(person.jaw_weights, float), *moved))
    if set(EYES) <= set(person.joints) and set(GAZE_NAMES) <= set(person.expression_names):
        joints += [_eye(person, name, track.expression) for name in reversed(EYES)]
    return tuple(joint for joint in joints if joint.holds.any())


def _eye(person: FaceModel, name: str, expression: Float[np.ndarray, "n k"]) -> Joint:
    ball, centre = eyeball(person, name), person.joints[name]
    # Blendshapes move an eyeball along chords, and its back less; the rotation nearest to its front keeps it round.
    looks = [person.expression_names.index(unit) for unit in GAZE_NAMES]
    arms = person.neutral - centre
    front = ball & (arms[:, 2] < -FRONT * np.linalg.norm(arms, axis=1))
    arms = arms[front]
    by_unit = np.einsum("vi,kvj->kij", arms, person.expression_deltas[looks][:, front])
    weights = np.nan_to_num(expression[:, looks])
    left, _, right = np.linalg.svd(arms.T @ arms + np.einsum("nk,kij->nij", weights, by_unit))
    right[:, 2] *= np.linalg.det(left @ right)[:, None]
    turns = Rotation.from_matrix((left @ right).transpose(0, 2, 1)).as_rotvec()
    return Joint(name, np.asarray(centre, float), ball.astype(float), turns if weights.any() else None)


def eyeball(person: FaceModel, name: str) -> Bool[np.ndarray, "v"]:
    """Which vertices are the ball of an eye: parts of the mesh of their own that lie about its joint.

    Vertices at one place, as along the seams of a texture, belong together. Parts that lie before the joint alone are
    none (lashes).
    """
    _, places = np.unique(person.neutral.round(4), axis=0, return_inverse=True)
    count = int(places.max()) + 1
    ends = places[np.concatenate([person.triangles[:, :2], person.triangles[:, 1:]])].T
    _, part = connected_components(coo_array((np.ones(ends.shape[1]), ends), shape=(count, count)), directed=False)
    part = part[places]
    apart = np.linalg.norm(np.subtract(*(person.joints[eye] for eye in EYES)))
    arms = person.neutral - person.joints[name]
    length = np.linalg.norm(arms, axis=1)
    far, aside = length > EYEBALL * apart, arms[:, 2] > -BESIDE * length
    return ~np.isin(part, part[far]) & np.isin(part, part[aside])


def joint_shares(joints: tuple[Joint, ...], count: int) -> Float[np.ndarray, "v 1+j"]:
    """Of each of `count` vertices, the share that moves with the head alone, then with each joint below; sums to 1."""
    holds = np.array([joint.holds for joint in joints], float).reshape(len(joints), count).T
    shares = np.column_stack([np.maximum(1.0 - holds.sum(axis=1), 0.0), holds])
    return shares / shares.sum(axis=1, keepdims=True)


def part_joints(joints: tuple[Joint, ...], part: Part) -> tuple[Joint, ...]:
    """The joints as they hold a part that is tied to the head's vertices."""
    held = (np.einsum("nj,nj->n", part.weights, joint.holds[part.anchors]) for joint in joints)
    return tuple(joint._replace(holds=np.clip(hold, 0.0, 1.0)) for joint, hold in zip(joints, held, strict=True))


def beside_joints(shapes: Shapes, joints: tuple[Joint, ...]) -> Shapes:
    """The shapes without what the eyes' joints do in their place: of a look, the lids and the skin about the eye."""
    balls = np.any([joint.holds > 0.0 for joint in joints if joint.name in EYES], axis=0)
    if not np.any(balls):
        return shapes
    looks = [k for k, name in enumerate(shapes.names) if name in GAZE_NAMES]
    deltas = shapes.deltas.copy()
    deltas[np.ix_(looks, np.flatnonzero(balls))] = 0.0
    return shapes._replace(deltas=deltas)


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
