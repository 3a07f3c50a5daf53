"""Text in pictures: one font at one weight, as small as it must be to fit."""

import cv2
import numpy as np
from jaxtyping import UInt8

SMALLEST_PX = 7
_FONT = cv2.FontFace("sans")
# Without a weight, OpenCV draws with that of the last text in the process, whoever drew it.
_REGULAR = 400


def text_width(text: str, size: int) -> int:
    """Width in pixels of a line of text at this font size in pixels."""
    # OpenCV wraps text at the right edge of the picture that it measures for.
    picture = (len(text) * size + size, 2 * size)
    return cv2.getTextSize(picture, text, (0, 0), _FONT, size, _REGULAR)[2]


def fitting_size(text: str, size: int, width: int) -> int:
    """This font size in pixels, or the largest below it at which the text is no wider than `width` (never below 7)."""
    while size > SMALLEST_PX and text_width(text, size) > width:
        size -= 1
    return size


def write_text(
    picture: UInt8[np.ndarray, "h w 3"], text: str, place: tuple[int, int], color: tuple[int, int, int], size: int
) -> None:
    """Draw a line of text into the picture; `place` is the left end of its base line in pixels."""
    cv2.putText(picture, text, place, color, _FONT, size, _REGULAR)
