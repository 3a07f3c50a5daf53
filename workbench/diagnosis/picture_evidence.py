"""Evidence from the pictures about landmarks: the motion of the picture, its sharpness and the direction of blur."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.landmarks.alignment import fit_similarity
from workbench.landmarks.scheme import POINT_COUNT

FLOW_FACE_PX = 160.0
"""Size to which faces are scaled before measuring flow, so that one window size fits all."""
FLOW_WINDOW = 21
ROUND_TRIP = 0.01
"""Largest forward-backward error of a point, in face sizes, for its flow to be used."""
MARGIN = 0.6
"""Margin of the crop around the landmarks, in face sizes."""


def carried_by_flow(
    previous: UInt8[np.ndarray, "h w 3"],
    picture: UInt8[np.ndarray, "h w 3"],
    points: Float[np.ndarray, "points 2"],
    face_px: float,
) -> Float[np.ndarray, "points 2"]:
    """Current positions of the content at `points` of the previous picture (Lucas–Kanade), pixels.

    NaN if a point tracked forward and back does not return to its start, or leaves the picture.
    """
    scale = FLOW_FACE_PX / face_px
    low = np.maximum(np.floor(points.min(0) - MARGIN * face_px), 0).astype(int)
    high = np.minimum(np.ceil(points.max(0) + MARGIN * face_px) + 1, [picture.shape[1], picture.shape[0]]).astype(int)
    missing = np.full(points.shape, np.nan)
    if previous.shape != picture.shape or (high - low < 8).any():
        return missing
    first, second = (_grey(each[low[1] : high[1], low[0] : high[0]], scale) for each in (previous, picture))
    # Pixel centres: (p + 0.5) · scale − 0.5.
    start = np.float32((points - low + 0.5) * scale - 0.5)[:, None]
    options = {"winSize": (FLOW_WINDOW, FLOW_WINDOW), "maxLevel": 4}
    there, ahead, _ = cv2.calcOpticalFlowPyrLK(first, second, start, None, **options)
    back, behind, _ = cv2.calcOpticalFlowPyrLK(second, first, there, None, **options)
    size = np.array([first.shape[1], first.shape[0]])
    good = (ahead.ravel() == 1) & (behind.ravel() == 1)
    good &= np.linalg.norm(back - start, axis=2).ravel() < ROUND_TRIP * FLOW_FACE_PX
    good &= ((start > 0) & (start < size - 1) & (there > 0) & (there < size - 1)).all(axis=(1, 2))
    moved = (there[:, 0].astype(float) + 0.5) / scale - 0.5 + low
    return np.where(good[:, None], moved, missing)


def _grey(picture: np.ndarray, scale: float) -> np.ndarray:
    grey = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY)
    how = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    return cv2.resize(grey, None, fx=scale, fy=scale, interpolation=how)


def gradient_energy(
    picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "points 2"], face_px: float
) -> Float[np.ndarray, "2 2"]:
    """Structure tensor of the region of the 68 per unit of its contrast: dᵀ·E·d is the squared grey slope along d.

    The face is first scaled to a fixed size, so that values within a shot are comparable.
    """
    points = points[:POINT_COUNT]
    low = np.clip(np.floor(points.min(0)), 0, [picture.shape[1] - 4, picture.shape[0] - 4]).astype(int)
    high = np.maximum(np.ceil(points.max(0)).astype(int) + 1, low + 4)
    grey = _grey(picture[low[1] : high[1], low[0] : high[0]], FLOW_FACE_PX / face_px).astype(np.float32)
    # Slight smoothing, because noise and compression would otherwise count as sharpness.
    grey = cv2.GaussianBlur(grey, (0, 0), 1.0)
    slope = np.stack([cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1)], axis=-1).reshape(-1, 2)
    return (slope.T @ slope / len(slope) / max(float(grey.var()), 1.0)).astype(float)


@dataclass(frozen=True)
class Blur:
    """How a picture is blurred along one direction."""

    direction: Float[np.ndarray, "2"]
    """Unit vector in the picture along which detail is lost."""
    sharpness: float
    """Squared slope along it, relative to the previous picture along the same direction (or to the slope across)."""
    across: float
    """The same ratio across that direction: 1 if only this direction is blurred."""


def directional_blur(energy: Float[np.ndarray, "2 2"], previous: Float[np.ndarray, "2 2"] | None) -> Blur:
    """The direction that lost most detail compared with the previous picture (or with the other direction)."""
    reference = np.eye(2) * np.linalg.eigvalsh(energy)[1] if previous is None else previous
    # Generalised eigenproblem: the ratio of the two quadratic forms is smallest along the first vector.
    root = np.linalg.inv(np.linalg.cholesky(reference + 1e-9 * np.eye(2)))
    values, vectors = np.linalg.eigh(root @ energy @ root.T)
    direction = root.T @ vectors[:, 0]
    return Blur(direction / np.linalg.norm(direction), float(values[0]), float(values[1]))


def change_of_patch(
    previous: UInt8[np.ndarray, "h w 3"],
    picture: UInt8[np.ndarray, "h w 3"],
    points_before: Float[np.ndarray, "points 2"],
    chosen: Bool[np.ndarray, "points"],
    others: Float[np.ndarray, "n 2"],
    others_before: Float[np.ndarray, "n 2"],
) -> float:
    """Mean absolute change since the previous picture inside the hull of the chosen points, in grey levels.

    The similarity of the other points compensates the motion of the face, so that head motion alone changes nothing.
    """
    to_now = fit_similarity(others_before, others)
    inverse = np.linalg.inv(to_now.matrix)
    matrix = np.column_stack([to_now.matrix, to_now.origin])
    warped = cv2.warpAffine(previous, matrix, (picture.shape[1], picture.shape[0]))
    inside = np.zeros(picture.shape[:2], np.uint8)
    region = to_now.to_image(points_before[chosen])
    cv2.fillConvexPoly(inside, cv2.convexHull(np.float32(region)).astype(np.int32), 1)
    if not inside.any() or not np.isfinite(inverse).all():
        return 0.0
    greys = [cv2.cvtColor(each, cv2.COLOR_RGB2GRAY).astype(np.float32)[inside == 1] for each in (warped, picture)]
    return float(np.abs(greys[1] - greys[0]).mean())
