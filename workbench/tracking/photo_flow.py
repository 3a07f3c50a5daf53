"""Positions of the face's points in a photo, by optical flow from a photo whose fit is known.

Each pair of pictures is cropped around the face and scaled to a few hundred pixels. Flow is estimated both ways and
sampled at the surface points of the known frame.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.flow import FlowEstimator, occluded

MARGIN = 1.35
"""Side of the cut-out square relative to the bounding box of the face in both frames."""
SMOOTHED_FROM = 1.5
"""Pictures reduced by more than this factor are smoothed first."""


class Cutout(NamedTuple):
    """An upright square of a picture: its centre and side in pixels, and the size in pixels that it is scaled to."""

    centre: Float[np.ndarray, "2"]
    side_px: float
    pixels: int

    @property
    def scale(self) -> float:
        """Pixels of the cut-out per pixel of the picture."""
        return self.pixels / self.side_px

    def inside(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Picture coordinates converted to cut-out coordinates."""
        return (points - self.centre) * self.scale + 0.5 * (self.pixels - 1)

    def cut(self, picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "s s 3"]:
        """The square; border pixels are repeated beyond the picture."""
        if self.scale * SMOOTHED_FROM < 1.0:
            picture = cv2.GaussianBlur(picture, (0, 0), 0.4 / self.scale)
        offset = 0.5 * (self.pixels - 1) - self.scale * self.centre
        matrix = np.array([[self.scale, 0.0, offset[0]], [0.0, self.scale, offset[1]]])
        size = (self.pixels, self.pixels)
        return cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def cutout_about(places: Float[np.ndarray, "*n 2"], pixels: int) -> Cutout:
    """The cut-out around points of a face, pixels."""
    flat = places.reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    return Cutout((low + high) / 2, MARGIN * float((high - low).max()), pixels)


class PhotoFlow(NamedTuple):
    """Positions of a first photo's points in a second photo."""

    places: Float[np.ndarray, "n 2"]
    """Pixels of the second photo."""
    consistent: Bool[np.ndarray, "n"]
    """The backward flow returns close to the start, and both positions are inside the pictures."""
    inside: Bool[np.ndarray, "n"]
    """Both positions are inside the pictures."""


def photo_flow(
    estimator: FlowEstimator,
    first: UInt8[np.ndarray, "h w 3"],
    second: UInt8[np.ndarray, "h w 3"],
    places: Float[np.ndarray, "n 2"],
    cutout: Cutout,
) -> PhotoFlow:
    """Flow from the first to the second photo at points of the first, estimated inside the cut-out."""
    cuts = cutout.cut(first), cutout.cut(second)
    forward, backward = estimator(*cuts), estimator(*cuts[::-1])
    inside = cutout.inside(places)
    flow = read_at(forward, inside)
    hidden = read_at(occluded(forward, backward).astype(np.float32), inside) > 0.5
    targets = places + flow / cutout.scale
    height, width = first.shape[:2]
    size = np.array([width - 1, height - 1])
    shown = [((at >= 0.0) & (at <= size)).all(axis=1) for at in (places, targets)]
    in_cut = ((inside >= 0.0) & (inside <= cutout.pixels - 1)).all(axis=1)
    seen = shown[0] & shown[1] & in_cut
    return PhotoFlow(targets, ~hidden & seen, seen)


def read_at(field: Float[np.ndarray, "h w *c"], places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n *c"]:
    """A field sampled bilinearly at points (x, y); border values are repeated outside."""
    at = np.ascontiguousarray(places, np.float32)[None]
    values = cv2.remap(
        np.ascontiguousarray(field, np.float32), at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return values[0].astype(float)
