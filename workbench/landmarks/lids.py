"""Eyelids relative to the corners of their eye: how far open they are, what the network reads too open, and one
detector's lids on another.

The frame of an eye has its outer (right eye) or inner (left eye) corner at (0, 0) and the other one at (1, 0); y points
down. Lengths are in eye widths.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from workbench.landmarks.alignment import FaceFrame, fit_similarity
from workbench.landmarks.observations import Landmarks2D

EYES = (((36, 39), (37, 38), (40, 41)), ((42, 45), (43, 44), (46, 47)))
"""Corners, upper lid and lower lid of the right and the left eye, each from image left to right on a frontal face but
the lower lids, which go back."""
OPENING_READ, OPENING_TRUE = (0.04, 0.08, 0.125, 0.175, 0.22), (-0.01, 0.03, 0.055, 0.139, 0.22)
"""Openings between the lids as the network reads them, and as they are: medians over 374 eyes of people that the
training did not see. It reads shut eyes as open by 0.05, the upper lid too high and the lower one where it is. Below
zero the lids of the head overlap."""
SURE_LIDS = (0.3, 0.6)
"""Median confidences in an eye between which its lids come to be taken over."""
SURE_EYE = (0.2, 0.8)
"""Mean confidences of an eye between which its corners come to be kept."""
ALIKE = (0.5, 2.0)
"""Ratios of the two eye widths between which both detectors mean the same eye."""

_UNIT = np.array([[0.0, 0.0], [1.0, 0.0]])


def lid_openings(points: Float[np.ndarray, "68 2"]) -> Float[np.ndarray, "2"]:
    """How far the lids of the right and the left eye are apart, in widths of the eye; below zero where they overlap."""
    return np.array([_opening(points, *eye) for eye in EYES])


def seen_openings(
    face: Float[np.ndarray, "68 2"], seen: Landmarks2D
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """How far apart a look at a face sees the lids of its right and left eye, in widths of the eye; and how much that
    counts, 0 to 1: nothing, and 0 apart, where the look is unsure or means something else than an eye of this face."""
    known = Landmarks2D(face, np.ones(len(face)), seen.image_size)
    shares = np.array([_share(known, seen, list(corners), [*upper, *lower]) for corners, upper, lower in EYES])
    openings = [_opening(seen.points, *eye) if share > 0.0 else 0.0 for eye, share in zip(EYES, shares, strict=True)]
    return np.array(openings), shares


def true_lids(points: Float[np.ndarray, "68 2"]) -> Float[np.ndarray, "68 2"]:
    """The network's points with the upper lids of narrow eyes lowered to where they are; open eyes are left alone."""
    points = points.copy()
    for corners, upper, lower in EYES:
        if np.allclose(points[corners[0]], points[corners[1]]):
            continue
        eye = _eye(points[list(corners)])
        lids = eye.to_face(points[[*upper, *lower]])
        read = float(lids[2:, 1].mean() - lids[:2, 1].mean())
        if read < OPENING_READ[-1]:
            lids[:2, 1] += read - np.interp(read, OPENING_READ, OPENING_TRUE)
            points[list(upper)] = eye.to_image(lids[:2])
    return points


def with_lids(face: Landmarks2D, other: Landmarks2D) -> Landmarks2D:
    """The landmarks of `face` with the lids of `other`, brought to the corners of the eyes in `face`.

    An eye that `other` is unsure of, or means another thing by, stays. Corners that `face` is unsure of become those of
    `other` as well: where eyes are shut, dlib may lose the whole eye.
    """
    points, confidence = face.points.copy(), face.confidence.copy()
    for corners, upper, lower in EYES:
        ends, lids = list(corners), [*upper, *lower]
        share = _share(face, other, ends, lids)
        if share == 0.0:
            continue
        kept = float(np.interp(face.confidence[ends + lids].mean(), SURE_EYE, (0.0, 1.0)))
        kept = 1.0 - share * (1.0 - kept)
        points[ends] = kept * face.points[ends] + (1.0 - kept) * other.points[ends]
        confidence[ends] = kept * face.confidence[ends] + (1.0 - kept) * other.confidence[ends]
        brought = _eye(points[ends]).to_image(_eye(other.points[ends]).to_face(other.points[lids]))
        points[lids] = (1.0 - share) * face.points[lids] + share * brought
        confidence[lids] = (1.0 - share) * face.confidence[lids] + share * other.confidence[lids]
    return replace(face, points=points, confidence=confidence)


def _share(face: Landmarks2D, other: Landmarks2D, ends: list[int], lids: list[int]) -> float:
    """How much of an eye's lids `other` has: 0 where it is unsure or sees no eye of this size."""
    width, its = (float(np.linalg.norm(points[ends[1]] - points[ends[0]])) for points in (face.points, other.points))
    if not ALIKE[0] * width < its < ALIKE[1] * width:
        return 0.0
    return float(np.interp(np.median(other.confidence[ends + lids]), SURE_LIDS, (0.0, 1.0)))


def _opening(points: Float[np.ndarray, "68 2"], corners, upper, lower) -> float:
    lids = _eye(points[list(corners)]).to_face(points[[*upper, *lower]])
    return float(lids[2:, 1].mean() - lids[:2, 1].mean())


def _eye(corners: Float[np.ndarray, "2 2"]) -> FaceFrame:
    """From the frame of an eye to the picture."""
    return fit_similarity(_UNIT, corners)
