"""What a photo shows around a face, to stand behind the face's renders.

A landmark network finds the jaw by what is beside it. Before plain grey it reads the same face's jaw elsewhere than in
the photo, and a solve turns the head to make up for it. What is around the face is therefore taken from the photo, in
few pixels, with the face itself painted over, so that no second face stands beside the rendered one.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.arrays import AnyArray
from workbench.landmarks.alignment import FaceFrame, sampled
from workbench.networks import CropBox, to_crop, to_picture

SIDE = 64
"""Pixels of the surroundings' side."""
REACH = 2.0
"""Their side, in sides of the crop that the network sees of the photo."""
GREY = 115
FOREHEAD = 0.4
"""The face goes on above the brows for this part of the way from the chin to the brows."""
AROUND_INPAINTED = 3.0
"""Radius from which painted-over pixels take their colours, pixels."""


class Surroundings(NamedTuple):
    """A square part of a photo without the face in it; beyond it, its border goes on."""

    picture: UInt8[AnyArray, "64 64 3"]
    """RGB."""
    box: CropBox
    """Where in the photo it is."""


def plain_surroundings() -> Surroundings:
    """Grey wherever one looks, for want of a photo."""
    box = CropBox(np.zeros(2), np.float64(1.0), np.float64(0.0))
    return Surroundings(np.full((SIDE, SIDE, 3), GREY, np.uint8), box)


def photo_surroundings(
    picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "n 2"], crop: CropBox
) -> Surroundings:
    """What is around a face in a photo (RGB).

    `points` are its landmarks in pixels, the 68 first; `crop` is what a network sees of it. Plain where the face fills
    all of it.
    """
    box = CropBox(np.asarray(crop.centre), REACH * np.asarray(crop.side), np.asarray(crop.roll))
    face = _face(np.asarray(to_crop(points[:27], box, SIDE)))
    if face.all():
        return plain_surroundings()
    return Surroundings(cv2.inpaint(_shrunk(picture, box), face, AROUND_INPAINTED, cv2.INPAINT_TELEA), box)


def _shrunk(picture: UInt8[np.ndarray, "h w 3"], box: CropBox) -> UInt8[np.ndarray, "64 64 3"]:
    """The picture inside of the box; beyond the picture, its border goes on."""
    origin, *ends = np.asarray(to_picture(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), box, SIDE))
    return sampled(picture, FaceFrame(np.stack(ends, axis=1) - origin[:, None], origin), SIDE)


def _face(outline: Float[np.ndarray, "27 2"]) -> UInt8[np.ndarray, "64 64"]:
    """255 within the face whose jaw and brows these are, and a pixel around it."""
    chin, brow = outline[8], outline[[21, 22]].mean(axis=0)
    around = np.concatenate([outline, outline[17:] + FOREHEAD * (brow - chin)])
    mask = np.zeros((SIDE, SIDE), np.uint8)
    cv2.fillConvexPoly(mask, np.round(cv2.convexHull(around.astype(np.float32))).astype(np.int32), 255)
    return cv2.dilate(mask, np.ones((3, 3), np.uint8))
