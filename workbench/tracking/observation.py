"""What is known of a frame before it is fitted: its landmarks, and its pictures where a fit needs them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.surroundings import Surroundings

Pictures = tuple[UInt8[np.ndarray, "_ _ 3"], ...]
"""The pictures of one frame, one for each view of a rig; a single one without a rig."""


class PicturePair(NamedTuple):
    """What a frame's optical flow is found in."""

    before: Pictures
    """Those of the frame before."""
    now: Pictures


def motion_of(before: UInt8[np.ndarray, "h w 3"] | None, now: UInt8[np.ndarray, "h w 3"] | None) -> PicturePair | None:
    """The pair of a single view; None if one of the pictures is missing."""
    return None if before is None or now is None else PicturePair((before,), (now,))


@dataclass(frozen=True)
class FrameObservation:
    """The input of the tracker for one frame."""

    index: int
    landmarks: Landmarks2D | None
    image_size: tuple[int, int]
    source: str = "given"
    cut: bool = False
    """Whether this frame starts a new shot."""
    milliseconds: tuple[float, float] = (0.0, 0.0)
    """Time taken by face detection and by landmarks."""
    picture: UInt8[np.ndarray, "h w 3"] | None = None
    """RGB, if the fit needs it: Deep Energies estimates colours and light from it, and what is behind its renders."""
    others: tuple[Landmarks2D | None, ...] = ()
    """Landmarks in the other views of a rig, in the rig's order; None for a view without a face."""

    surroundings: tuple[Surroundings, ...] = ()
    """What is behind the renders of Deep Energies in each view. Where it is not given, the first view's is made from
    `picture`, and all else is plain."""
    motion: PicturePair | None = None
    """Given where a stage names the flow term; None on a clip's first frame, and without pictures."""

    @property
    def view_sizes(self) -> tuple[tuple[int, int] | None, ...]:
        """(width, height) of the pictures of each view; None where nothing tells it."""
        if self.motion is not None:
            return tuple(picture.shape[1::-1] for picture in self.motion.now)
        others = (None if landmarks is None else landmarks.image_size for landmarks in self.others)
        return (self.image_size, *others)

    @property
    def faces(self) -> bool:
        """Whether any view shows a face."""
        return any(landmarks is not None for landmarks in (self.landmarks, *self.others))
