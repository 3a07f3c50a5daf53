"""Which blendshapes the 68 landmarks cannot tell apart, from the derivative of the landmarks by the weights.

A weight moves the landmarks along its column of the Jacobian. Two things hide a weight. It moves no landmark at all
(the tongue), or a combination of others moves the landmarks the same way: then the data fix the sum, and only the
priors choose among its parts. The pose can make up for some motion too, so that is taken out of every column first.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.energies import Observation, project_landmarks, reprojection_with_jacobian
from workbench.errors import InputError
from workbench.face import FaceParameters, PointModel
from workbench.geometry import Camera

POSE = ("rotation", "translation")


@dataclass(frozen=True)
class Indistinguishable:
    """What the landmarks do not say about the weights."""

    names: tuple[str, ...]
    motion_percent: Float[np.ndarray, "k"]
    """How far weight 1 moves the landmark that it moves most, after the best rigid pose, in % of the eye distance."""
    similarity: Float[np.ndarray, "k k"]
    """Cosine between the motions of two blendshapes: 1 look alike, −1 cancel, 0 for an unseen one."""
    trade: Float[np.ndarray, "k k"]
    """Projector on the combinations that hardly move the landmarks; its entry says how far two weights trade off."""
    unseen: tuple[str, ...]
    """Blendshapes that move no landmark enough to be seen."""
    groups: tuple[tuple[str, ...], ...]
    """Blendshapes that can replace or cancel each other, in the order of `names`."""


def landmark_motion(points: PointModel, camera: Camera, parameters: FaceParameters) -> Float[np.ndarray, "136 k"]:
    """How each weight moves the 68 projected landmarks beyond what the pose can make up for.

    In percent of the outer-eye distance at weight 1; rows are x and y of each landmark in turn.
    """
    eye_distance_mm = float(np.linalg.norm(np.asarray(points.neutral[45] - points.neutral[36])))
    unit = 0.01 * float(np.mean(np.asarray(camera.focal_px))) * eye_distance_mm / float(parameters.translation[2])
    at = project_landmarks(camera, points, parameters)
    observation = Observation(at, jnp.ones(68), jnp.asarray(unit))
    _, jacobian = reprojection_with_jacobian(camera, points, parameters, observation, (*POSE, "expression"))
    jacobian = np.asarray(jacobian)
    pose, weights = np.linalg.qr(jacobian[:, :6])[0], jacobian[:, 6:]
    return weights - pose @ (pose.T @ weights)


def group_columns(
    motion: Float[np.ndarray, "m k"],
    names: Sequence[str],
    unseen_percent: float = 1.0,
    tolerance: float = 0.25,
    link: float = 0.2,
) -> Indistinguishable:
    """Groups of nearly dependent columns of `motion` (x and y rows in turn, `landmark_motion`).

    Columns are scaled to length 1, so that strong blendshapes do not hide weak ones. Combinations of unit length that
    come out shorter than `tolerance` are hidden ones: right singular vectors of small singular values. The projector on
    all of them does not depend on the choice of these vectors; blendshapes whose entry in it exceeds `link` are joined.
    Raises `InputError` where names and columns differ in number.
    """
    if motion.shape[1] != len(names):
        raise InputError(f"Each column of the motion needs a name: {motion.shape[1]} columns, {len(names)} names.")
    most = np.linalg.norm(motion.reshape(-1, 2, motion.shape[1]), axis=1).max(axis=0)
    seen = most >= unseen_percent
    scaled = np.where(seen, motion / np.maximum(np.linalg.norm(motion, axis=0), 1e-300), 0.0)
    similarity = scaled.T @ scaled
    values, vectors = np.linalg.eigh(similarity[np.ix_(seen, seen)])
    hidden = vectors[:, values < tolerance * tolerance]
    trade = np.zeros_like(similarity)
    trade[np.ix_(seen, seen)] = hidden @ hidden.T
    groups = [tuple(names[k] for k in group) for group in _connected(np.abs(trade) > link) if len(group) > 1]
    unseen = tuple(name for name, is_seen in zip(names, seen, strict=True) if not is_seen)
    return Indistinguishable(tuple(names), most, similarity, trade, unseen, tuple(groups))


def indistinguishable_groups(
    points: PointModel,
    camera: Camera,
    views: Sequence[FaceParameters],
    names: Sequence[str],
    unseen_percent: float = 1.0,
    tolerance: float = 0.25,
    link: float = 0.2,
) -> Indistinguishable:
    """Blendshapes that the landmarks of all these views together cannot tell apart (`group_columns`).

    Each view has its own pose, which is taken out of it; the weights are shared. Raises `InputError` without a view.
    """
    if not views:
        raise InputError("Indistinguishable blendshapes need at least one view; pass the parameters of a frame.")
    motion = np.concatenate([landmark_motion(points, camera, view) for view in views])
    return group_columns(motion, names, unseen_percent, tolerance, link)


def _connected(linked: np.ndarray) -> list[list[int]]:
    """Connected components of a symmetric relation, each ascending, in the order of their first members."""
    left, components = set(range(len(linked))), []
    while left:
        frontier, component = [min(left)], []
        while frontier:
            k = frontier.pop()
            if k in left:
                left.remove(k)
                component.append(k)
                frontier += [int(other) for other in np.flatnonzero(linked[k])]
        components.append(sorted(component))
    return components
