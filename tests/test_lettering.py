"""Text in pictures looks the same whatever was drawn before, and fits."""

import cv2
import numpy as np
import pytest

from workbench.pictures.lettering import SMALLEST_PX, fitting_size, text_width, write_text

LINE = "frame 12   error 0.7 px (0.6 %)   yaw −5°"


def written(size: int = 15) -> np.ndarray:
    page = np.zeros((40, 640, 3), np.uint8)
    write_text(page, LINE, (10, 25), (255, 255, 255), size)
    return page


@pytest.mark.parametrize("thickness", [1, 2, 3])
def test_text_keeps_its_weight_beside_text_of_other_weights(thickness):
    expected, wide = written(), text_width(LINE, 15)
    page = np.zeros((40, 640, 3), np.uint8)
    cv2.putText(page, "another program", (10, 25), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), thickness)
    np.testing.assert_array_equal(written(), expected)
    assert text_width(LINE, 15) == wide


@pytest.mark.parametrize("size", [7, 13, 24])
def test_the_width_of_text_is_where_its_pixels_end(size):
    columns = np.flatnonzero(written(size).any((0, 2)))
    assert abs(columns[-1] + 1 - 10 - text_width(LINE, size)) <= 2


@pytest.mark.parametrize("width", [120, 300, 1000])
def test_text_is_as_large_as_fits(width):
    size = fitting_size(LINE, 20, width)
    assert text_width(LINE, size) <= width or size == SMALLEST_PX
    assert size == 20 or text_width(LINE, size + 1) > width
