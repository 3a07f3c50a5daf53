"""What a landmark scheme is, and iBUG's 68 points: groups, names, polylines, mirror, in this one place.

Every scheme begins with the 68 points of iBUG: the numbers of eye corners, lips and jaw contour hold in each, and so do
the measures below, which read the 68 alone, of NumPy's arrays or JAX's.

Indices are 0-based (iBUG's own figures and .pts files count from 1). Side names are the SUBJECT's: the right eye
is the one at image left on a frontal face. Some libraries name the same points by the sides of the image.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Num

from workbench.errors import InputError

POINT_COUNT = 68


def _span(first: int, last: int) -> tuple[int, ...]:
    return tuple(range(first, last + 1))


GROUPS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        "all": _span(0, 67),
        "jaw": _span(0, 16),  # from the subject's right ear over the chin (8) to the left ear
        "right_brow": _span(17, 21),  # outer to inner end
        "left_brow": _span(22, 26),  # inner to outer end
        "brows": _span(17, 26),
        "nose_bridge": _span(27, 30),  # top to tip
        "nose_base": _span(31, 35),  # right to left nostril
        "nose": _span(27, 35),
        "right_eye": _span(36, 41),  # outer corner, upper lid, inner corner, lower lid
        "left_eye": _span(42, 47),  # inner corner, upper lid, outer corner, lower lid
        "eyes": _span(36, 47),
        "outer_lips": _span(48, 59),
        "inner_lips": _span(60, 67),
        "mouth": _span(48, 67),
        "non_jaw": _span(17, 67),
        "inner": _span(17, 67),  # the "inner 51" of the literature
        "robust": (*_span(27, 35), 36, 39, 42, 45),  # FACE IT!: eye corners and nose, for the initial pose
    }
)
"""Group name -> ascending point indices."""

POLYLINES: tuple[tuple[int, ...], ...] = (
    GROUPS["jaw"],
    GROUPS["right_brow"],
    GROUPS["left_brow"],
    GROUPS["nose_bridge"],
    GROUPS["nose_base"],
    (*GROUPS["right_eye"], 36),
    (*GROUPS["left_eye"], 42),
    (*GROUPS["outer_lips"], 48),
    (*GROUPS["inner_lips"], 60),
)
"""Lines to draw a face with; a closed line repeats its first point."""

POINT_NAMES: tuple[str, ...] = (
    *(f"right jaw, point {i + 1} of 8 from the ear" for i in range(8)),
    "chin",
    *(f"left jaw, point {i} of 8 from the ear" for i in range(8, 0, -1)),
    "right brow, outer end",
    "right brow, outer quarter",
    "right brow, middle",
    "right brow, inner quarter",
    "right brow, inner end",
    "left brow, inner end",
    "left brow, inner quarter",
    "left brow, middle",
    "left brow, outer quarter",
    "left brow, outer end",
    "nose bridge, top",
    "nose bridge, upper third",
    "nose bridge, lower third",
    "nose tip",
    "right nostril, outer edge",
    "right nostril, inner edge",
    "nose base, middle",
    "left nostril, inner edge",
    "left nostril, outer edge",
    "right eye, outer corner",
    "right eye, upper lid, outer",
    "right eye, upper lid, inner",
    "right eye, inner corner",
    "right eye, lower lid, inner",
    "right eye, lower lid, outer",
    "left eye, inner corner",
    "left eye, upper lid, inner",
    "left eye, upper lid, outer",
    "left eye, outer corner",
    "left eye, lower lid, outer",
    "left eye, lower lid, inner",
    "mouth, right corner, outer edge",
    "upper lip, outer edge, far right",
    "upper lip, outer edge, right peak",
    "upper lip, outer edge, middle",
    "upper lip, outer edge, left peak",
    "upper lip, outer edge, far left",
    "mouth, left corner, outer edge",
    "lower lip, outer edge, far left",
    "lower lip, outer edge, left",
    "lower lip, outer edge, middle",
    "lower lip, outer edge, right",
    "lower lip, outer edge, far right",
    "mouth, right corner, inner edge",
    "upper lip, inner edge, right",
    "upper lip, inner edge, middle",
    "upper lip, inner edge, left",
    "mouth, left corner, inner edge",
    "lower lip, inner edge, left",
    "lower lip, inner edge, middle",
    "lower lip, inner edge, right",
)
"""Anatomical name of each point; sides are the subject's."""

MIRROR: tuple[int, ...] = (
    *range(16, -1, -1),
    *range(26, 16, -1),
    *(27, 28, 29, 30),
    *range(35, 30, -1),
    *(45, 44, 43, 42, 47, 46),
    *(39, 38, 37, 36, 41, 40),
    *range(54, 47, -1),
    *range(59, 54, -1),
    *range(64, 59, -1),
    *(67, 66, 65),
)
"""MIRROR[i] is the point that i becomes when left and right are swapped; its own inverse."""

RIGHT_EYE_OUTER_CORNER = 36
LEFT_EYE_OUTER_CORNER = 45
UPPER_LIP_INNER_MIDDLE = 62
LOWER_LIP_INNER_MIDDLE = 66
PARTS = ("jaw", "brows", "nose", "eyes", "irises", "mouth", "ears", "face")
"""Groups whose points are no other's, as far as a scheme has them: the rows of strips and tables."""
EYE_PER_SPREAD = 1.48
"""Outer-eye distance of a frontal face in units of the root mean square distance of its 68 points from their centre."""
LEAST_UNIT = 0.5
"""Of `face_size`: the smallest unit of errors in percent."""


@dataclass(frozen=True, eq=False)
class LandmarkScheme:
    """The points of a face that a detector names, the 68 of iBUG first. Where they lie on a face model, it says."""

    name: str
    """As files call it."""
    point_names: tuple[str, ...]
    groups: Mapping[str, tuple[int, ...]]
    """Group name -> ascending point indices."""
    polylines: tuple[tuple[int, ...], ...]
    """Lines to draw a face with; a closed line repeats its first point."""
    mirror: tuple[int, ...]
    """The point that each becomes when left and right are swapped; its own inverse."""
    has_covariances: bool = False
    """Whether detections of it say how sure each place is in each direction."""

    def __len__(self) -> int:
        return len(self.point_names)

    @property
    def parts(self) -> dict[str, tuple[int, ...]]:
        """The parts of the face by name: groups that share no point and together have all of them."""
        return {name: self.groups[name] for name in PARTS if name in self.groups}

    def group_mask(self, *names: str) -> Bool[np.ndarray, "points"]:
        """True for every point of any of the groups. Raises `InputError` that lists the groups."""
        mask = np.zeros(len(self), bool)
        for name in names:
            if name not in self.groups:
                raise InputError(f"there is no landmark group {name!r}: choose one of {', '.join(self.groups)}")
            mask[list(self.groups[name])] = True
        return mask


IBUG68 = LandmarkScheme("ibug68", POINT_NAMES, GROUPS, POLYLINES, MIRROR)
"""The scheme of dlib, of the network detector, and of files that name none."""


def first_68(points: Num[np.ndarray, "..."]) -> Float[np.ndarray, "68 2"]:
    """The 68 points of iBUG among those of any scheme, as float64; raises `InputError` where there are fewer."""
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"landmarks are an array of shape (68, 2), x and y in pixels; got shape {points.shape}")
    if len(points) < POINT_COUNT:
        raise InputError(f"the iBUG scheme has 68 points, got {len(points)}: convert other schemes first")
    return points[:POINT_COUNT].astype(np.float64)


def group_mask(*names: str) -> Bool[np.ndarray, "68"]:
    """True for every point of any of the groups of the 68."""
    return IBUG68.group_mask(*names)


def mirror_points(
    points: Num[np.ndarray, "..."], width: int, scheme: LandmarkScheme = IBUG68
) -> Float[np.ndarray, "points 2"]:
    """The landmarks of the horizontally flipped picture of `width` pixels (pixel centres: x becomes width - 1 - x).

    Raises `InputError` if there are not as many points as in the scheme.
    """
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"landmarks are an array of shape ({len(scheme)}, 2), x and y in pixels; got {points.shape}")
    if len(points) != len(scheme):
        raise InputError(f"the scheme {scheme.name!r} has {len(scheme)} points, got {len(points)}")
    mirrored = np.asarray(points, np.float64)[list(scheme.mirror)]
    mirrored[:, 0] = width - 1 - mirrored[:, 0]
    return mirrored


def outer_eye_distance(points: Float[Any, "*n points d"]) -> Float[Any, "*n"] | float:
    """Distance between the outer corners of the eyes (36 to 45), the unit of landmark errors in the literature.

    In the points' unit. In the picture it shrinks as the head turns.
    """
    corners = points[..., LEFT_EYE_OUTER_CORNER, :], points[..., RIGHT_EYE_OUTER_CORNER, :]
    return ((corners[0] - corners[1]) ** 2).sum(-1) ** 0.5


def error_unit(points: Float[Any, "*n points 2"]) -> Float[Any, "*n"] | float:
    """What every error of a fit in percent is a part of, pixels: the outer-eye distance between the observed landmarks.

    On a profile the corners all but coincide: beyond some 60 degrees of yaw it is half of `face_size`, two fifths of
    what the distance would be from the front.
    """
    distance = outer_eye_distance(points)
    return distance + (LEAST_UNIT * face_size(points) - distance).clip(0.0)


def lip_distance(points: Float[np.ndarray, "*n points d"]) -> Float[np.ndarray, "*n"] | float:
    """How far the mouth is open: the distance between the middles of the inner lips (62 to 66), in the points' unit."""
    return np.linalg.norm(points[..., UPPER_LIP_INNER_MIDDLE, :] - points[..., LOWER_LIP_INNER_MIDDLE, :], axis=-1)


def face_size(points: Float[Any, "*n points 2"]) -> Float[Any, "*n"] | float:
    """What the outer-eye distance of the face would be from the front, pixels: from the spread of the 68 points.

    Turning the head, exchanging points or losing one eye hardly changes it, unlike the distance itself. Diagnosis
    compares frames in this unit.
    """
    points = points[..., :POINT_COUNT, :]
    centred = points - points.mean(axis=-2, keepdims=True)
    return EYE_PER_SPREAD * (centred**2).sum(-1).mean(-1) ** 0.5
