"""Contact sheets show training pictures as they are, each with the points that a network should find."""

import cv2
import numpy as np
import pytest

from tests.dotted_pool import write_dotted_pool
from workbench.frames import read_picture
from workbench.training.contact_sheet import (
    CLEAN_ROWS,
    COLUMNS,
    DOT_COLOR,
    SHEET,
    TILE_PX,
    TRAINING_ROWS,
    Sample,
    contact_sheet,
    face_samples,
    shown_early,
)

GREY = np.full((64, 64, 3), 90, np.uint8)
ROWS = CLEAN_ROWS + TRAINING_ROWS


@pytest.fixture(scope="module")
def pool_folder(tmp_path_factory):
    return write_dotted_pool(tmp_path_factory.mktemp("pool"))


def dots(sheet: np.ndarray) -> np.ndarray:
    """The middle of each dot, x and y."""
    mask = (sheet == DOT_COLOR).all(axis=-1).astype(np.uint8)
    return cv2.connectedComponentsWithStats(mask)[3][1:]


def test_a_dot_lies_where_its_point_is():
    samples = [Sample(GREY)] * COLUMNS
    samples[2] = Sample(GREY, np.array([[15.5, 31.5]]))
    found = dots(contact_sheet(samples))
    assert found == pytest.approx(np.array([[2.25 * TILE_PX - 0.5, TILE_PX / 2 - 0.5]]), abs=0.6)


def test_pictures_come_in_rows():
    samples = [Sample(np.full((32, 32, 3), k, np.uint8)) for k in range(2 * COLUMNS)]
    tiles = contact_sheet(samples).reshape(2, TILE_PX, COLUMNS, TILE_PX, 3)
    assert tiles[:, TILE_PX // 2, :, TILE_PX // 2, 0].ravel().tolist() == list(range(2 * COLUMNS))


def test_faces_have_their_landmarks_and_pupils_and_walls_have_none(pool_folder):
    counts = [len(sample.points) for sample in face_samples(pool_folder)]
    assert len(counts) == ROWS * COLUMNS
    assert set(counts) == {0, 70}


def test_the_clean_rows_come_first_and_show_faces_alone(pool_folder):
    shown = [len(sample.points) > 0 for sample in face_samples(pool_folder)]
    assert all(shown[: CLEAN_ROWS * COLUMNS])
    assert not all(shown)


def test_the_sheet_is_there_while_the_rest_of_the_pool_is_rendered_and_stays_as_it_is(tmp_path):
    reports: list[str] = []
    progress = shown_early(reports.append, write_dotted_pool(tmp_path), face_samples)
    progress(240, 720)
    assert read_picture(tmp_path / SHEET).shape == (ROWS * TILE_PX, COLUMNS * TILE_PX, 3)
    (tmp_path / SHEET).write_bytes(b"as it was")
    progress(480, 720)
    assert (tmp_path / SHEET).read_bytes() == b"as it was"
    assert reports == ["rendered 240 of 720", f"what the network will see: {tmp_path / SHEET}", "rendered 480 of 720"]
