"""Which blendshapes the landmarks cannot tell apart, from the derivative of the landmarks by the weights.

A weight moves the landmarks along its column of the Jacobian. It is hidden in two cases: if it moves no landmark at all
(the tongue), or if a combination of other weights moves the landmarks in the same way. The data then determine only the
sum, and the priors its parts. The pose can also compensate some motion, so that is removed from every column first.
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
    """The weights and combinations of weights that the landmarks do not determine."""

    names: tuple[str, ...]
    motion_percent: Float[np.ndarray, "k"]
    """Largest landmark motion at weight 1 after the best rigid pose, in % of the eye distance."""
    similarity: Float[np.ndarray, "k k"]
    """Cosine between the motions of two blendshapes: 1 for identical, −1 for cancelling, 0 for an unseen blendshape."""
    trade: Float[np.ndarray, "k k"]
    """Projector onto the combinations that hardly move the landmarks; an entry says how much two weights trade off."""
    unseen: tuple[str, ...]
    """Blendshapes that move no landmark noticeably."""
    groups: tuple[tuple[str, ...], ...]
    """Blendshapes that can replace or cancel each other, in the order of `names`."""


def landmark_motion(points: PointModel, camera: Camera, parameters: FaceParameters) -> Float[np.ndarray, "m k"]:
    """How each weight moves the projected landmarks, beyond the motion that the pose can compensate.

    In percent of the outer-eye distance at weight 1; rows alternate x and y of each landmark.
    """
    eye_distance_mm = float(np.linalg.norm(np.asarray(points.neutral[45] - points.neutral[36])))
    unit = 0.01 * float(np.mean(np.asarray(camera.focal_px))) * eye_distance_mm / float(parameters.translation[2])
    at = project_landmarks(camera, points, parameters)
    observation = Observation(at, jnp.ones(len(at)), jnp.asarray(unit))
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
    """Groups of nearly dependent columns of `motion` (alternating x and y rows, `landmark_motion`).

    Columns are scaled to length 1, so that strong blendshapes do not hide weak ones. Unit-length combinations whose
    motion is shorter than `tolerance` are hidden: these are right singular vectors with small singular values. The
    projector onto all of them does not depend on the choice of vectors; blendshapes whose entry in it exceeds `link`
    are grouped. Raises `InputError` if the numbers of names and columns differ.
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

    Each view has its own pose, whose motion is removed; the weights are shared. Raises `InputError` without a view.
    """
    if not views:
        raise InputError(
            "Finding indistinguishable blendshapes needs at least one view; pass the parameters of a frame."
        )
    motion = np.concatenate([landmark_motion(points, camera, view) for view in views])
    return group_columns(motion, names, unseen_percent, tolerance, link)


def _connected(linked: np.ndarray) -> list[list[int]]:
    """Connected components of a symmetric relation, each in ascending order, sorted by their first members."""
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
