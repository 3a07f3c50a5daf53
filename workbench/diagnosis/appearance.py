"""How a face looks in its picture, compared with the other frames of its shot: sharpness, brightness, colours by place.

Looks are taken in the face frame, an upright square around the face, so that those of different frames lie on each
other. A look needs no fit: it is evidence that is independent of the landmarks' residuals.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from workbench.diagnosis.picture_evidence import gradient_energy
from workbench.landmarks.alignment import MEAN_SHAPE, FaceFrame, frame_from_points, sampled
from workbench.landmarks.scheme import face_size

Pictures = Callable[[int], UInt8[np.ndarray, "h w 3"]]
"""The picture of a frame by its index."""

CELLS, CELL_PX = 12, 6
"""Cells along a side of the square, and pixels along a side of a cell."""
REACH = 0.62
"""Half a side of the square in the face frame's unit: from above the brows to below the chin."""
NEAR = (2, 4, 7, 12, 20, 32, 50, 75)
"""Distances, in frames, of the other frames that a face is compared with."""
FEWEST_LOOKS = 4
"""Other looks below which nothing is usual."""
ALIKE = 0.25
"""Quantile over the other looks that counts as the likeness to them: an occlusion may have begun some frames before."""
SOBEL_SUM = 8.0
"""What OpenCV's Sobel filter makes of a slope of one."""
FLOOR_LEVELS = 6.0
"""Colour difference of a cell, in levels of CIELAB, below which two faces count as alike."""

PLACES: Float[np.ndarray, "c c 2"] = np.stack(
    np.meshgrid(*2 * [(np.arange(CELLS) + 0.5) / CELLS * 2.0 * REACH - REACH]), axis=-1
)
"""The middle of each cell in the face frame."""


def _in_face() -> Bool[np.ndarray, "c c"]:
    outline = np.float32(MEAN_SHAPE[[*range(17), *range(26, 16, -1)]] * 0.94)
    inside = [cv2.pointPolygonTest(outline, (float(x), float(y)), False) >= 0 for x, y in PLACES.reshape(-1, 2)]
    return np.array(inside).reshape(CELLS, CELLS)


FACE: Bool[np.ndarray, "c c"] = _in_face()
"""Cells that lie in an average face."""
PARTS: Mapping[str, Bool[np.ndarray, "c c"]] = {
    "mouth": FACE & (np.abs(PLACES[..., 0]) < 0.24) & (PLACES[..., 1] > 0.14) & (PLACES[..., 1] < 0.42),
    "chin": FACE & (PLACES[..., 1] > 0.36),
    "right_eye": FACE & (PLACES[..., 0] < -0.04) & (PLACES[..., 1] < -0.06),
    "left_eye": FACE & (PLACES[..., 0] > 0.04) & (PLACES[..., 1] < -0.06),
    "lower_face": FACE & (PLACES[..., 1] > 0.1),
    "upper_face": FACE & (PLACES[..., 1] < -0.08),
    "right_side": FACE & (PLACES[..., 0] < -0.04),
    "left_side": FACE & (PLACES[..., 0] > 0.04),
}
"""Parts of the face that may be covered, by the names of their points in `causes.groups`; sides are the person's."""


@dataclass(frozen=True, eq=False)
class FaceLook:
    """A face as its picture shows it."""

    colors: Float[np.ndarray, "c c 3"]
    """Mean colour of each cell in CIELAB, about 0..255."""
    slopes: Float[np.ndarray, "c c 2"]
    """Mean steepness of the lightness across and down each cell, levels: a hand has a face's colour, but no lips."""
    sharpness: float
    """Squared slope of the grey levels per unit of their variance, over the face scaled to a fixed size."""

    @cached_property
    def brightness(self) -> float:
        """Median lightness of the face, 0..255."""
        return float(np.median(self.colors[FACE][:, 0]))

    @cached_property
    def levelled(self) -> Float[np.ndarray, "c c 5"]:
        """Colours without the light that is common to the whole face, and slopes."""
        return np.concatenate([self.colors - np.median(self.colors[FACE], axis=0), self.slopes], axis=-1)


def look_of(picture: UInt8[np.ndarray, "h w 3"], points: Float[np.ndarray, "points 2"]) -> FaceLook:
    """The look of the face with these landmarks."""
    face, size = frame_from_points(points), CELLS * CELL_PX
    matrix = face.matrix * (2.0 * REACH / size)
    to_image = FaceFrame(matrix, face.origin - matrix @ np.full(2, (size - 1) / 2))
    crop = cv2.cvtColor(sampled(picture, to_image, size), cv2.COLOR_RGB2LAB).astype(float)
    smooth = cv2.GaussianBlur(crop[..., 0], (0, 0), 1.0)
    slopes = np.abs(np.stack([cv2.Sobel(smooth, cv2.CV_64F, *way) for way in ((1, 0), (0, 1))], axis=-1)) / SOBEL_SUM
    colors, slopes = (
        part.reshape(CELLS, CELL_PX, CELLS, CELL_PX, -1).mean(axis=(1, 3)) for part in (crop, CELL_PX * slopes)
    )
    return FaceLook(colors, slopes, float(np.trace(gradient_energy(picture, points, float(face_size(points))))))


def differences(look: FaceLook, others: Sequence[FaceLook]) -> Float[np.ndarray, "c c"]:
    """How far each cell is from that of the most alike of the other looks, in levels."""
    apart = [np.linalg.norm(look.levelled - other.levelled, axis=-1) for other in others]
    return np.quantile(apart, ALIKE, axis=0)


@dataclass(frozen=True, eq=False)
class UsualLook:
    """What is usual among the looks of a shot near a frame."""

    looks: Mapping[int, FaceLook]
    """By frame; without the frame itself."""

    @property
    def known(self) -> bool:
        """Whether there are enough looks to say what is usual."""
        return len(self.looks) >= FEWEST_LOOKS

    @cached_property
    def sharpness(self) -> float:
        """Median over the looks."""
        return float(np.median([look.sharpness for look in self.looks.values()]))

    @cached_property
    def least_sharpness(self) -> float:
        """Sharpness that one in ten of the looks does not reach: talking and turning heads blur a little."""
        return float(np.quantile([look.sharpness for look in self.looks.values()], 0.1))

    @cached_property
    def brightness(self) -> float:
        """Median over the looks."""
        return float(np.median([look.brightness for look in self.looks.values()]))

    @cached_property
    def differences(self) -> Float[np.ndarray, "c c"]:
        """How far a cell of one of these looks usually is from the others."""
        looks = list(self.looks.values())
        each = [differences(look, looks[:k] + looks[k + 1 :]) for k, look in enumerate(looks)]
        return np.median(each, axis=0)

    def surprise(self, look: FaceLook) -> Float[np.ndarray, "c c"]:
        """How many times farther than usual each cell of a look is from the others; about 1 in an ordinary frame."""
        return differences(look, list(self.looks.values())) / (self.differences + FLOOR_LEVELS)


def near(index: int, there: Sequence[int]) -> list[int]:
    """The frames to compare a frame with, of those that are `there`, ascending."""
    wanted = {index + sign * step for step in NEAR for sign in (-1, 1)}
    return sorted(wanted & set(there))
