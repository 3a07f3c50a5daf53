"""From two photos and one known frame to where the face's points are in the other frame.

Each pair of pictures is cut out about the face and brought to a few hundred pixels, flow is estimated both ways, and
read where the known frame shows the points of the surface.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.flow import FlowEstimator, occluded

MARGIN = 1.35
"""Side of the cut-out square against that of the box about the face in both frames."""
SMOOTHED_FROM = 1.5
"""Pictures shrunk by more than this are smoothed first."""


class Cutout(NamedTuple):
    """An upright square of a picture: its centre and side in pixels, and the pixels that it is brought to."""

    centre: Float[np.ndarray, "2"]
    side_px: float
    pixels: int

    @property
    def scale(self) -> float:
        """Pixels of the cut-out per pixel of the picture."""
        return self.pixels / self.side_px

    def inside(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """Places in the picture as places in the cut-out."""
        return (points - self.centre) * self.scale + 0.5 * (self.pixels - 1)

    def cut(self, picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "s s 3"]:
        """The square, with the border's pixels continued beyond the picture."""
        if self.scale * SMOOTHED_FROM < 1.0:
            picture = cv2.GaussianBlur(picture, (0, 0), 0.4 / self.scale)
        offset = 0.5 * (self.pixels - 1) - self.scale * self.centre
        matrix = np.array([[self.scale, 0.0, offset[0]], [0.0, self.scale, offset[1]]])
        size = (self.pixels, self.pixels)
        return cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def cutout_about(places: Float[np.ndarray, "*n 2"], pixels: int) -> Cutout:
    """The cut-out about points of a face, pixels."""
    flat = places.reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    return Cutout((low + high) / 2, MARGIN * float((high - low).max()), pixels)


class PhotoFlow(NamedTuple):
    """Where points of a first photo lie in a second one."""

    places: Float[np.ndarray, "n 2"]
    """Pixels of the second photo."""
    consistent: Bool[np.ndarray, "n"]
    """The way back ends near where it began, and neither place is beyond the pictures."""


def photo_flow(
    estimator: FlowEstimator,
    first: UInt8[np.ndarray, "h w 3"],
    second: UInt8[np.ndarray, "h w 3"],
    places: Float[np.ndarray, "n 2"],
    cutout: Cutout,
) -> PhotoFlow:
    """Flow from the first to the second photo at places of the first, estimated inside of the cut-out."""
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
    return PhotoFlow(targets, ~hidden & shown[0] & shown[1] & in_cut)


def read_at(field: Float[np.ndarray, "h w *c"], places: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n *c"]:
    """Bilinear values of a field at places (x, y); the border's beyond it."""
    at = np.ascontiguousarray(places, np.float32)[None]
    values = cv2.remap(
        np.ascontiguousarray(field, np.float32), at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return values[0].astype(float)
