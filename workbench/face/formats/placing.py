"""Unit, axes and origin of a stored face model, recognised by laying the default head on it.

What the file tells of the face, in this order: landmarks, eye centres, and the places that blendshapes of ARKit's names
move. Units are powers of ten apart and heads are not, so that the nearest unit is the right one; axes are exchanged and
turned by right angles, so that a head stored with a slight nod keeps it.
"""

from itertools import permutations, product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.errors import ModelError
from workbench.face.formats.landmark_fit import centre_of_motion
from workbench.face.formats.raw import Y_UP, RawModel
from workbench.face.model import FaceModel

UNITS_MM = {"m": 1000.0, "dm": 100.0, "cm": 10.0, "mm": 1.0, "um": 0.001}
RECOGNISED = ("m", "cm", "mm", "um")
LARGEST_MISFIT = 2.2
"""Factor between a head in a recognised unit and the default head's size."""
FLAT = 0.02
"""Third singular value of points that tell no handedness, in parts of the first."""


class Correspondences(NamedTuple):
    """Points of the default head, millimetres in the head frame, and the same points in the file."""

    head: Float[np.ndarray, "p 3"]
    file: Float[np.ndarray, "p 3"]


class Placement(NamedTuple):
    """points_head = unit_mm · rotation_head_file · (points_file − origin_file)."""

    rotation: Float[np.ndarray, "3 3"]
    unit_mm: float
    origin: Float[np.ndarray, "3"]
    size: float
    """Size of this head in parts of the default head's."""

    def points(self, points_file: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
        """Points of the file in the head frame, millimetres."""
        return self.offsets(points_file - self.origin)

    def offsets(self, offsets_file: Float[np.ndarray, "*b 3"]) -> Float[np.ndarray, "*b 3"]:
        """Offsets of the file in the head frame, millimetres."""
        return self.unit_mm * (offsets_file @ self.rotation.T)


def correspondences(raw: RawModel, names: tuple[str, ...], deltas: np.ndarray, head: FaceModel) -> Correspondences:
    """Points that are known in the default head and in the file; `names` and `deltas` are ARKit's where known."""
    head_points, file_points = [], []
    default_landmarks = head.landmarks.of(head.neutral)
    for point, (vertices, weights) in sorted(raw.landmarks.items()):
        head_points.append(default_landmarks[point])
        file_points.append(weights @ raw.vertices[vertices])
    for eye in ("leftEye", "rightEye"):
        if eye in raw.joints:
            head_points.append(head.joints[eye])
            file_points.append(raw.joints[eye])
    if len(head_points) < 6:
        for name, moved in zip(names, deltas, strict=True):
            if name in head.expression_names and np.any(moved):
                same = head.expression_deltas[head.expression_names.index(name)]
                head_points.append(centre_of_motion(same) @ head.neutral)
                file_points.append(centre_of_motion(moved) @ raw.vertices)
    return Correspondences(np.reshape(head_points, (-1, 3)), np.reshape(file_points, (-1, 3)))


def axes_of_joints(raw: RawModel, head: FaceModel) -> Float[np.ndarray, "3 3"]:
    """Axes by the joints that file and default head share: the neck is below and behind the eyes; else +y is up."""
    shared = [name for name in head.joints if name in raw.joints]
    if len(shared) < 3:
        return Y_UP
    pairs = Correspondences(*(np.array([joints[name] for name in shared]) for joints in (head.joints, raw.joints)))
    covariance = (pairs.head - pairs.head.mean(0)).T @ (pairs.file - pairs.file.mean(0))
    return nearest_right_angle(covariance)


def place(points: Correspondences, axes: np.ndarray | None, unit: str | None, path: object) -> Placement:
    """Where the file's head is. Raises `ModelError` where that cannot be told."""
    count = len(points.head)
    if count < 2:
        raise ModelError(
            f"{path} does not say where its face is: give 68 vertex numbers in landmarks.toml, or export blendshapes "
            "under ARKit's names."
        )
    head, file = points.head - points.head.mean(0), points.file - points.file.mean(0)
    spread = np.sqrt((file**2).sum())
    if spread == 0.0:
        raise ModelError(f"{path}: all known points of the face coincide; the model is damaged.")
    _check_sides(head.T @ file, path)
    rotation = nearest_right_angle(head.T @ file) if axes is None else axes
    scale = float(np.sum(head * (file @ rotation.T)) / spread**2)
    if scale <= 0.0:
        raise ModelError(f"{path}: the eyes or landmarks are the wrong way round; sides are the subject's.")
    unit_mm = _unit(scale, unit, path)
    # The default head's origin, laid on the file by the similarity.
    origin = points.file.mean(0) - rotation.T @ points.head.mean(0) / scale
    return Placement(rotation, unit_mm, origin, unit_mm / scale)


def _right_angles() -> Float[np.ndarray, "24 3 3"]:
    """Every rotation that takes axes to axes."""
    signed = [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return np.stack([matrix for matrix in signed if np.linalg.det(matrix) > 0.0])


def nearest_right_angle(covariance: np.ndarray) -> np.ndarray:
    """The turn by right angles that takes the file's points nearest to the head's; `covariance` is head by file."""
    candidates = _right_angles()
    return candidates[np.argmax(np.einsum("cij,ij->c", candidates, covariance))]


def _check_sides(covariance: np.ndarray, path: object) -> None:
    """Raise `ModelError` for points that fit far better when mirrored: their sides are named by the picture's."""
    left, singular, right = np.linalg.svd(covariance)
    if np.linalg.det(left @ right) < 0.0 and singular[2] > FLAT * singular[0]:
        raise ModelError(
            f"{path}: landmarks or blendshapes fit a face only when mirrored; name left and right as the subject's, "
            "and number landmarks from the subject's right ear."
        )


def _unit(scale: float, unit: str | None, path: object) -> float:
    if unit is not None:
        if unit not in UNITS_MM:
            raise ModelError(f"There is no unit {unit!r}; the units are {', '.join(UNITS_MM)}.")
        return UNITS_MM[unit]
    misfit = {UNITS_MM[name]: abs(np.log(scale / UNITS_MM[name])) for name in RECOGNISED}
    nearest = min(misfit, key=misfit.__getitem__)
    if misfit[nearest] > np.log(LARGEST_MISFIT):
        raise ModelError(
            f"{path}: with eyes about {63.0 / scale:.3g} units apart the head is not of human size in any of "
            f"{', '.join(RECOGNISED)}; say which it is: unit='cm', or --unit cm."
        )
    return nearest
