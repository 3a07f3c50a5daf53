"""The face finder around its network: what it shows it, and how maps become boxes in the picture's pixels."""

import json
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.networks import randomised
from workbench.errors import InputError, ModelError
from workbench.frames import read_picture
from workbench.landmarks.alignment import frame_from_points
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.network_detector import NetworkDetector
from workbench.networks import face_finder
from workbench.networks.encoder import BLOCKS, WIDTHS
from workbench.networks.face_finder import (
    OVERLAP,
    SMALLEST_PART,
    FaceFinder,
    boxes_of,
    padded_square,
    part_sides,
    read_face_finder,
    starts,
)
from workbench.networks.landmark_network import empty_landmark_network, save_landmark_network
from workbench.networks.weights import ARCHITECTURE, save_module
from workbench.samples import sample

SIZE = (4, 6, 8, 10)


def empty_finder_network():
    return empty_landmark_network(SIZE, 1, outputs=face_finder.OUTPUTS)


def maps_with(*faces: tuple[int, int, float, float]) -> np.ndarray:
    """Maps in which the cells (row, column) hold a face of this side, in input pixels, with this score."""
    maps = np.zeros((4, 64, 64), np.float32)
    maps[0] = -9.0
    for row, column, side, score in faces:
        maps[0, row, column] = np.log(score / (1 - score))
        maps[1, row, column] = np.log(side / 64)
    return maps


@pytest.fixture
def finder(monkeypatch):
    """A finder whose network answers each picture with what the test puts into `answer`."""
    made = FaceFinder(empty_finder_network())
    made.answer = lambda square: maps_with()
    monkeypatch.setattr(made, "_maps", lambda square: made.answer(square))
    return made


def test_a_cell_stands_for_the_four_pixels_that_it_covers():
    ((box, score),) = boxes_of(maps_with((10, 20, 64.0, 0.8)), 0.3)
    assert np.allclose(box, (81.5 - 32, 41.5 - 32, 81.5 + 32, 41.5 + 32))
    assert score == pytest.approx(0.8)


def test_a_face_may_lie_beside_its_cell():
    maps = maps_with((10, 20, 32.0, 0.8))
    maps[2, 10, 20], maps[3, 10, 20] = 0.25, -0.125  # in parts of 64 pixels
    ((box, _),) = boxes_of(maps, 0.3)
    assert np.allclose(box, (97.5 - 16, 33.5 - 16, 97.5 + 16, 33.5 + 16))


def test_only_the_maxima_above_the_score_count_surest_first():
    maps = maps_with((10, 10, 64.0, 0.6), (10, 11, 64.0, 0.5), (40, 40, 64.0, 0.9), (50, 10, 64.0, 0.2))
    assert [round(score, 2) for _, score in boxes_of(maps, 0.3)] == [0.9, 0.6]


@pytest.mark.parametrize(("size", "scale"), [((512, 384), 0.5), ((100, 256), 1.0), ((128, 32), 2.0), ((20, 30), 4.0)])
def test_a_picture_is_fitted_into_the_upper_left_and_the_rest_is_grey(size, scale):
    width, height = size
    square, found = padded_square(np.full((height, width, 3), 250, np.uint8))
    assert square.shape == (256, 256, 3)
    assert found == scale
    rows, columns = np.nonzero((square == 250).all(axis=2))
    assert (rows.max() + 1, columns.max() + 1) == (round(height * scale), round(width * scale))
    assert (square[round(height * scale) :] == face_finder.PADDING_GREY).all()


def test_boxes_come_in_the_pixels_of_the_picture(finder):
    finder.answer = lambda square: maps_with((10, 20, 64.0, 0.8))
    ((box, _),) = finder.find(np.zeros((512, 400, 3), np.uint8))
    # The edges of half-size pixels: 49.5 lies at the edge (49.5 + 0.5) · 2 − 0.5 of the picture.
    assert np.allclose(box, (99.5, 19.5, 227.5, 147.5))


def test_two_boxes_on_one_face_are_one_and_the_surer_stays(finder):
    finder.answer = lambda square: maps_with((20, 20, 64.0, 0.7), (22, 22, 60.0, 0.9), (20, 50, 64.0, 0.6))
    scores = [round(score, 2) for _, score in finder.find(np.zeros((256, 256, 3), np.uint8))]
    assert scores == [0.9, 0.6]


def test_small_faces_are_found_in_the_parts_where_they_look_larger(finder):
    picture = np.zeros((256, 256, 3), np.uint8)
    picture[201:217, 210:226] = 255

    def answer(square):
        rows, columns = np.nonzero(square.min(axis=2) > 200)
        side = np.sqrt(len(rows))
        if side < 20:
            return maps_with()
        return maps_with((round((rows.mean() - 1.5) / 4), round((columns.mean() - 1.5) / 4), side, 0.8))

    finder.answer = answer
    assert finder.find(picture) == []
    ((box, _),) = next(filter(None, finder.find_smaller(picture)))
    np.testing.assert_allclose(box, (209.5, 200.5, 225.5, 216.5), atol=1.5)


@given(st.integers(1, 20_000))
def test_parts_become_smaller_down_to_the_smallest(longest):
    sides = [longest, *part_sides(longest)]
    assert all(smaller < larger for larger, smaller in pairwise(sides))
    assert all(2 * smaller >= larger for larger, smaller in pairwise(sides))
    assert sides[-1] == min(longest, SMALLEST_PART)


@given(st.integers(1, 5_000), st.integers(SMALLEST_PART, 1_000))
def test_parts_cover_a_picture_and_overlap(length, side):
    begin = starts(length, side)
    assert begin[0] == 0
    assert begin[-1] == max(0, length - side)
    assert all(later - earlier <= (1 - OVERLAP) * side + 1 for earlier, later in pairwise(begin))


def test_a_face_of_48_pixels_is_found_in_a_large_picture():
    portrait = read_picture(sample("astronaut"))
    (record,) = read_landmark_file(sample("astronaut-landmarks"))
    small, scale = cv2.resize(portrait, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), 0.5
    picture = np.full((720, 1280, 3), 120, np.uint8)
    picture[300 : 300 + small.shape[0], 900 : 900 + small.shape[1]] = small
    (face,) = NetworkDetector().detect_faces(picture)
    true = frame_from_points(scale * record.landmarks.points + (900, 300)).box()
    assert 45 < true[2] - true[0] < 55
    np.testing.assert_allclose(face.box, true, atol=8)


def test_stored_weights_give_the_same_finder(tmp_path):
    network = randomised(empty_finder_network(), seed=3)
    size = {WIDTHS: json.dumps(SIZE), BLOCKS: "1"}
    save_module(tmp_path / "finder.safetensors", network, {ARCHITECTURE: face_finder.NAME, **size})
    picture = np.random.default_rng(0).integers(0, 256, (90, 120, 3), np.uint8)
    stored = read_face_finder(tmp_path / "finder.safetensors").find(picture, 0.0)
    assert stored == FaceFinder(network).find(picture, 0.0)
    assert stored


def test_weights_of_another_network_are_refused(tmp_path):
    path = tmp_path / "landmarks.safetensors"
    save_landmark_network(path, randomised(empty_landmark_network(SIZE, 1)))
    with pytest.raises(ModelError, match="face-energy-finder-1, but its metadata names face-energy-landmarks-1"):
        read_face_finder(path)
    with pytest.raises(InputError, match="no weights file"):
        read_face_finder(tmp_path / "none.safetensors")
