"""What a photo shows around a face, to stand behind the face's renders.

A landmark network finds the jaw by what is beside it. Before plain grey it reads the same face's jaw elsewhere than in
the photo, and a solve turns the head to make up for it. What is around the face is therefore taken from the photo, in
few pixels, with the face itself painted over, so that no second face stands beside the rendered one.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import InputError
from workbench.landmarks.alignment import frame_from_points, sampled
from workbench.landmarks.observations import Landmarks2D

SIDE = 64
"""Pixels of the surroundings' side."""
REACH, DROP = 3.2, 0.1
"""Their side, and how far below the middle of the face box theirs is, in box sides: twice the networks' crop."""
GREY = 115
FOREHEAD = 0.4
"""The face goes on above the brows for this part of the way from the chin to the brows."""
AROUND_INPAINTED = 3.0
"""Radius from which painted-over pixels take their colours, pixels."""


class Surroundings(NamedTuple):
    """A square part of a photo without the face in it; beyond it, its border goes on.

    NumPy's arrays, or JAX's in a solve.
    """

    picture: UInt8[Any, "64 64 3"]
    """RGB."""
    matrix: Float[Any, "2 2"]
    """From the photo's pixels to these: points_photo @ matrix.T + origin."""
    origin: Float[Any, "2"]


def plain_surroundings() -> Surroundings:
    """Grey wherever one looks, for want of a photo."""
    return Surroundings(np.full((SIDE, SIDE, 3), GREY, np.uint8), np.eye(2), np.zeros(2))


def photo_surroundings(picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "n 2"]) -> Surroundings:
    """What is around a face in a photo (RGB), given its landmarks in pixels, the 68 first.

    Plain where the landmarks coincide.
    """
    try:
        face = frame_from_points(points)
    except InputError:
        return plain_surroundings()
    to_photo = face.moved(y=DROP, scale=REACH).crop(SIDE)
    matrix = np.linalg.inv(to_photo.matrix)
    hidden = _face(to_photo.to_face(points[:27]))
    painted = cv2.inpaint(sampled(picture, to_photo, SIDE), hidden, AROUND_INPAINTED, cv2.INPAINT_TELEA)
    return Surroundings(painted, matrix, -matrix @ to_photo.origin)


def seen_around(picture: UInt8[np.ndarray, "h w 3"] | None, landmarks: Landmarks2D | None) -> Surroundings:
    """What is behind the renders of a face, given its photo and its landmarks there; plain without either."""
    if picture is None or landmarks is None:
        return plain_surroundings()
    return photo_surroundings(picture, landmarks.points)


def _face(outline: Float[np.ndarray, "27 2"]) -> UInt8[np.ndarray, "64 64"]:
    """255 within the face whose jaw and brows these are, and a pixel around it."""
    chin, brow = outline[8], outline[[21, 22]].mean(axis=0)
    around = np.concatenate([outline, outline[17:] + FOREHEAD * (brow - chin)])
    mask = np.zeros((SIDE, SIDE), np.uint8)
    cv2.fillConvexPoly(mask, np.round(cv2.convexHull(around.astype(np.float32))).astype(np.int32), 255)
    return cv2.dilate(mask, np.ones((3, 3), np.uint8))
