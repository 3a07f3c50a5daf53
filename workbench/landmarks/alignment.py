"""The face frame: where a face is in the picture, and upright crops of it.

The face frame has its origin in the middle of the square box that a face detector draws, the box side as its unit and
the head's own upright direction as -y. A similarity (scale, roll, position) takes it to pixels.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import InputError
from workbench.landmarks.scheme import GROUPS, first_68

# Measured: the mean of dlib's predictor over HOG boxes of 34 pictures and their mirror images.
MEAN_SHAPE: Float[np.ndarray, "68 2"] = np.array(
    [
        *((-0.457, -0.125), (-0.453, -0.004), (-0.439, 0.117), (-0.413, 0.235), (-0.369, 0.345), (-0.302, 0.442)),
        *((-0.215, 0.522), (-0.116, 0.585), (0, 0.604), (0.116, 0.585), (0.215, 0.522), (0.302, 0.442)),
        *((0.369, 0.345), (0.413, 0.235), (0.439, 0.117), (0.453, -0.004), (0.457, -0.125), (-0.363, -0.252)),
        *((-0.315, -0.316), (-0.237, -0.343), (-0.151, -0.341), (-0.071, -0.314), (0.071, -0.314), (0.151, -0.341)),
        *((0.237, -0.343), (0.315, -0.316), (0.363, -0.252), (0, -0.211), (0, -0.136), (0, -0.062)),
        *((0, 0.015), (-0.097, 0.085), (-0.05, 0.101), (0, 0.115), (0.05, 0.101), (0.097, 0.085)),
        *((-0.275, -0.179), (-0.228, -0.217), (-0.168, -0.219), (-0.115, -0.178), (-0.169, -0.166), (-0.228, -0.163)),
        *((0.115, -0.178), (0.168, -0.219), (0.228, -0.217), (0.275, -0.179), (0.228, -0.163), (0.169, -0.166)),
        *((-0.172, 0.263), (-0.113, 0.215), (-0.047, 0.191), (0, 0.203), (0.047, 0.191), (0.113, 0.215)),
        *((0.172, 0.263), (0.114, 0.324), (0.051, 0.352), (0, 0.358), (-0.051, 0.352), (-0.114, 0.324)),
        *((-0.143, 0.263), (-0.047, 0.239), (0, 0.242), (0.047, 0.239), (0.143, 0.263), (0.049, 0.287)),
        *((0, 0.292), (-0.049, 0.287)),
    ]
)
"""An average frontal face in the face frame."""
MEAN_SHAPE.setflags(write=False)

_INNER = list(GROUPS["inner"])


def rolled(angle_rad: float) -> Float[np.ndarray, "2 2"]:
    """The rotation of the picture's plane, x to the right and y down, clockwise as it is seen."""
    return np.array([[np.cos(angle_rad), -np.sin(angle_rad)], [np.sin(angle_rad), np.cos(angle_rad)]])


@dataclass(frozen=True, eq=False)
class FaceFrame:
    """The similarity that takes the face frame to the picture: points_image = points_face @ matrix.T + origin."""

    matrix: Float[np.ndarray, "2 2"]
    """Scale times rotation; pixels per box side."""
    origin: Float[np.ndarray, "2"]
    """The middle of the box, in pixels."""

    @property
    def side(self) -> float:
        """Length of the box side in pixels."""
        return float(np.hypot(self.matrix[0, 0], self.matrix[1, 0]))

    def to_image(self, points_face: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Face frame to pixels."""
        return points_face @ self.matrix.T + self.origin

    def to_face(self, points_image: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Pixels to face frame."""
        return (points_image - self.origin) @ np.linalg.inv(self.matrix).T

    def moved(self, x: float = 0.0, y: float = 0.0, scale: float = 1.0) -> "FaceFrame":
        """The frame moved by (x, y) box sides and scaled about its middle."""
        return FaceFrame(self.matrix * scale, self.to_image(np.array([[x, y]]))[0])

    def crop(self, side: int) -> "FaceFrame":
        """The similarity from the pixels of a crop of the box, `side` of them wide and high, to the picture's."""
        matrix = self.matrix / side
        return FaceFrame(matrix, self.origin - matrix @ np.full(2, (side - 1) / 2))

    def box(self) -> tuple[float, float, float, float]:
        """The upright square (left, top, right, bottom) of the same middle and side, in pixels."""
        half, (x, y) = self.side / 2, (float(value) for value in self.origin)
        return (x - half, y - half, x + half, y + half)


def frame_from_box(box: tuple[float, float, float, float]) -> FaceFrame:
    """The upright face frame of a detector's box (left, top, right, bottom); raises `InputError` for an empty box."""
    left, top, right, bottom = (float(value) for value in box)
    if not (right > left and bottom > top and np.isfinite([left, top, right, bottom]).all()):
        raise InputError(f"a face box is (left, top, right, bottom) with right > left and bottom > top, got {box}")
    side = (right - left + bottom - top) / 2
    return FaceFrame(np.eye(2) * side, np.array([(left + right) / 2, (top + bottom) / 2]))


def frame_from_points(points: Float[np.ndarray, "points 2"]) -> FaceFrame:
    """The face frame whose mean shape fits the inner 51 points best (least squares); the jaw's contour slides."""
    return fit_similarity(MEAN_SHAPE[_INNER], first_68(points)[_INNER])


def fit_similarity(source: Float[np.ndarray, "n 2"], target: Float[np.ndarray, "n 2"]) -> FaceFrame:
    """The rotation, scale and translation that take `source` closest to `target` (2-D Procrustes without mirroring).

    Raises `InputError` if all points of one side coincide.
    """
    source_middle, target_middle = source.mean(axis=0), target.mean(axis=0)
    a, b = source - source_middle, target - target_middle
    size = float((a * a).sum())
    cosine = float((a * b).sum())
    sine = float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    if size == 0 or np.hypot(cosine, sine) == 0:
        raise InputError("no similarity can be fitted: the points coincide")
    matrix = np.array([[cosine, -sine], [sine, cosine]]) / size
    return FaceFrame(matrix, target_middle - matrix @ source_middle)


def grey_face_crop(
    picture: UInt8[np.ndarray, "..."], face: FaceFrame, box_side: int, margin: int
) -> tuple[UInt8[np.ndarray, "n n"], FaceFrame]:
    """An upright grey crop of a face: the box has `box_side` pixels, with `margin` pixels around it.

    Also returns the similarity from crop pixels to picture pixels. Sampling is bilinear after area averaging where the
    crop is much smaller than the face; beyond the picture's edge its last pixels are repeated.
    """
    size = box_side + 2 * margin
    matrix = face.matrix / box_side
    to_image = FaceFrame(matrix, face.origin - matrix @ np.full(2, (size - 1) / 2))
    window, corner = _window(picture, to_image, size)
    grey = cv2.cvtColor(window, cv2.COLOR_RGB2GRAY) if window.ndim == 3 else window
    return sampled(grey, FaceFrame(matrix, to_image.origin - corner), size), to_image


def sampled(
    picture: UInt8[np.ndarray, "..."], to_image: FaceFrame, size: int, border: int = cv2.BORDER_REPLICATE
) -> UInt8[np.ndarray, "..."]:
    """A square of `size` pixels of a grey or colour picture; `to_image` takes its pixels to the picture's.

    Sampling is bilinear after area averaging where the square is much smaller than what it shows.
    """
    window, (left, top) = _window(picture, to_image, size)
    matrix, offset = to_image.matrix, to_image.origin - (left, top)
    factor = max(1, round(to_image.side))
    if factor > 1 and min(window.shape[:2]) >= factor:
        height, width = (length // factor for length in window.shape[:2])
        window = cv2.resize(window[: height * factor, : width * factor], (width, height), interpolation=cv2.INTER_AREA)
        matrix, offset = matrix / factor, (offset + 0.5) / factor - 0.5  # pixel centres of the averaged picture
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(window, np.column_stack([matrix, offset]), (size, size), flags=flags, borderMode=border)


def _window(picture: np.ndarray, to_image: FaceFrame, size: int) -> tuple[np.ndarray, tuple[int, int]]:
    """The part of the picture under the crop (at least one pixel), so that a large picture costs nothing."""
    corners = to_image.to_image(np.array([[0, 0], [size, 0], [0, size], [size, size]], np.float64))
    limit = np.array([picture.shape[1], picture.shape[0]])
    first = np.clip(np.floor(corners.min(axis=0)).astype(int) - 2, 0, limit - 1)
    last = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 3, first + 1, limit)
    return picture[first[1] : last[1], first[0] : last[0]], (int(first[0]), int(first[1]))
