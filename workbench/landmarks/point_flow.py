"""Landmarks carried from one picture to the next by pyramidal Lucas-Kanade flow between crops of the face."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.landmarks.alignment import FaceFrame, fit_similarity, frame_from_points, grey_face_crop

FLOW_BOX, FLOW_MARGIN = 128, 64
"""Pixels of the face box, and around it, in the crops that flow is measured on: cost independent of picture size."""


@dataclass(frozen=True, eq=False)
class FaceCrop:
    """Where a face is in a picture, and the grey crop about it."""

    points: Float[np.ndarray, "points 2"]
    frame: FaceFrame
    grey: UInt8[np.ndarray, "s s"]


@dataclass(frozen=True, eq=False)
class CarriedPoints:
    """Points of one picture found again in the next."""

    points: Float[np.ndarray, "points 2"]
    """Where the flow puts the points; points that it lost move with the others."""
    valid: Bool[np.ndarray, "points"]
    round_trip: Float[np.ndarray, "points"]
    """Distance between each point and itself carried forward and back, in box sides."""


def crop_about(picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "points 2"]) -> FaceCrop:
    """The crop of a face that flow starts from."""
    frame = frame_from_points(points)
    return FaceCrop(points, frame, grey_face_crop(picture, frame, FLOW_BOX, FLOW_MARGIN)[0])


def carried(face: FaceCrop, picture: UInt8[np.ndarray, "h w 3"], window: int, round_trip_sides: float) -> CarriedPoints:
    """The points of a face in the next picture, at the same place of the crop, and back to check.

    `window` is the side of the Lucas-Kanade window, pixels of the crop; a point is lost if it comes back further than
    `round_trip_sides` from where it began.
    """
    crop, to_image = grey_face_crop(picture, face.frame, FLOW_BOX, FLOW_MARGIN)
    before = to_image.to_face(face.points).astype(np.float32)
    size = (window, window)
    after, found, _ = cv2.calcOpticalFlowPyrLK(face.grey, crop, before[:, None], None, winSize=size)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(crop, face.grey, after, None, winSize=size)
    round_trip = np.linalg.norm(back[:, 0].astype(np.float64) - before, axis=1) / FLOW_BOX
    inside = ((after[:, 0] > 0) & (after[:, 0] < crop.shape[0] - 1)).all(axis=1)
    valid = found.ravel().astype(bool) & found_back.ravel().astype(bool) & inside
    valid &= round_trip < round_trip_sides
    points = to_image.to_image(after[:, 0].astype(np.float64))
    if valid.sum() >= 6:
        points[~valid] = fit_similarity(face.points[valid], points[valid]).to_image(face.points[~valid])
    else:
        points = face.points.copy()
    return CarriedPoints(points, valid, round_trip)
