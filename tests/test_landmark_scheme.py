"""The iBUG 68-point scheme: sides are the subject's, groups, mirror, and the checks of the landmark record."""

from itertools import pairwise

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.landmarks import scheme
from workbench.landmarks.alignment import MEAN_SHAPE, fit_similarity, frame_from_box, frame_from_points
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.turned_faces import shape_deviation


def test_point_36_is_the_subjects_right_eyes_outer_corner_at_image_left_on_a_frontal_face():
    assert scheme.POINT_NAMES[36] == "right eye, outer corner"
    assert scheme.RIGHT_EYE_OUTER_CORNER == 36
    assert 36 in scheme.GROUPS["right_eye"]
    assert MEAN_SHAPE[36, 0] < 0 < MEAN_SHAPE[45, 0]
    assert MEAN_SHAPE[36, 0] < MEAN_SHAPE[39, 0]  # the outer corner is farther out than the inner one


def test_groups_partition_the_face():
    parts = ("jaw", "right_brow", "left_brow", "nose_bridge", "nose_base", "right_eye", "left_eye", "outer_lips")
    members = [i for name in (*parts, "inner_lips") for i in scheme.GROUPS[name]]
    assert members == list(range(68))
    assert scheme.GROUPS["inner"] == scheme.GROUPS["non_jaw"] == tuple(range(17, 68))
    assert set(scheme.GROUPS["robust"]) == {36, 39, 42, 45, *range(27, 36)}
    assert len(scheme.POINT_NAMES) == len(set(scheme.POINT_NAMES)) == 68


def test_group_names_agree_with_point_names():
    for name, side in (("right_eye", "right eye"), ("left_eye", "left eye"), ("right_brow", "right brow")):
        assert all(scheme.POINT_NAMES[i].startswith(side) for i in scheme.GROUPS[name])


def test_mirror_is_its_own_inverse_and_swaps_side_names():
    mirror = np.array(scheme.MIRROR)
    np.testing.assert_array_equal(mirror[mirror], np.arange(68))
    for i, name in enumerate(scheme.POINT_NAMES):
        swapped = name.replace("right", "?").replace("left", "right").replace("?", "left")
        assert scheme.POINT_NAMES[mirror[i]] == swapped


def test_mirrored_points_are_those_of_the_flipped_picture():
    points = frame_from_box((100.0, 50.0, 300.0, 250.0)).to_image(MEAN_SHAPE)
    mirrored = scheme.mirror_points(points, width=640)
    assert mirrored[36, 0] == pytest.approx(639 - points[45, 0])
    assert mirrored[36, 0] < mirrored[45, 0]
    np.testing.assert_allclose(scheme.mirror_points(mirrored, width=640), points)


def test_polylines_draw_every_point_and_close_eyes_and_lips():
    segments = {pair for line in scheme.POLYLINES for pair in pairwise(line)}
    assert {point for pair in segments for point in pair} == set(range(68))
    assert {(41, 36), (59, 48)} <= segments
    assert (16, 17) not in segments


def test_masks_join_groups():
    mask = scheme.group_mask("jaw", "mouth")
    assert mask.sum() == 17 + 20
    with pytest.raises(InputError, match=r"no landmark group 'nosse'.*nose_bridge"):
        scheme.group_mask("nosse")


def test_outer_eye_distance_is_the_distance_of_36_and_45():
    points = np.zeros((68, 2))
    points[45] = (3, 4)
    assert scheme.outer_eye_distance(points) == 5


def test_lip_distance_is_the_distance_of_62_and_66_in_plane_and_space():
    points = np.zeros((2, 68, 3))
    points[1, 66] = (2, 3, 6)
    assert scheme.lip_distance(points).tolist() == [0, 7]
    assert scheme.lip_distance(points[1, :, :2]) == pytest.approx(np.hypot(2, 3))


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ((67, 2), "68 points, got 67"),
        ((69, 2), "68 points, got 69"),
        ((68, 3), r"\(68, 3\)"),
        ((136,), r"\(136,\)"),
    ],
)
def test_other_counts_and_shapes_are_refused_with_what_came(shape, message):
    with pytest.raises(InputError, match=message):
        scheme.mirror_points(np.zeros(shape), width=640)


@pytest.mark.parametrize(
    ("shape", "message"), [((67, 2), "68 points, got 67"), ((68, 3), r"\(68, 3\)"), ((136,), r"\(136,\)")]
)
def test_there_are_no_68_among_fewer_points(shape, message):
    with pytest.raises(InputError, match=message):
        scheme.first_68(np.zeros(shape))


# --- the record ---


def test_landmarks_are_copied_and_read_only():
    points = np.zeros((68, 2))
    landmarks = Landmarks2D(points, np.ones(68), (640, 360))
    points[0] = 5
    assert landmarks.points[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        landmarks.points[0] = 1


def broken(index: int, value: float) -> np.ndarray:
    points = np.zeros((68, 2))
    points[index, 1] = value
    return points


@pytest.mark.parametrize(
    ("points", "confidence", "size", "message"),
    [
        (np.zeros((67, 2)), np.ones(68), (9, 9), "got 67"),
        (broken(5, np.nan), np.ones(68), (9, 9), "landmark 5 is"),
        (broken(66, np.inf), np.ones(68), (9, 9), "landmark 66 is"),
        (np.zeros((68, 2)), np.ones(67), (9, 9), "one confidence for each"),
        (np.zeros((68, 2)), np.full(68, 1.5), (9, 9), "confidence of landmark 0 is 1.5"),
        (np.zeros((68, 2)), np.full(68, np.nan), (9, 9), "confidence of landmark 0 is nan"),
        (np.zeros((68, 2)), np.ones(68), (0, 9), "image size"),
    ],
)
def test_a_record_that_cannot_be_used_is_refused(points, confidence, size, message):
    with pytest.raises(InputError, match=message):
        Landmarks2D(points, confidence, size)


# --- the face frame ---


def test_face_frame_recovers_position_size_and_roll():
    angle, side, middle = np.deg2rad(30), 120.0, np.array([200.0, 90.0])
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    points = side * MEAN_SHAPE @ rotation.T + middle
    frame = frame_from_points(points)
    np.testing.assert_allclose(frame.origin, middle, atol=1e-9)
    np.testing.assert_allclose(frame.matrix, side * rotation, atol=1e-9)
    np.testing.assert_allclose(frame.to_face(points), MEAN_SHAPE, atol=1e-12)
    assert shape_deviation(points) == pytest.approx(0, abs=1e-12)


def test_face_frame_needs_a_box_and_points_with_extent():
    with pytest.raises(InputError, match="right > left"):
        frame_from_box((10.0, 10.0, 10.0, 20.0))
    with pytest.raises(InputError, match="coincide"):
        fit_similarity(MEAN_SHAPE, np.zeros((68, 2)))
