"""Laws of rotations and cameras."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.geometry import (
    axis_angle_from_yaw_pitch_roll,
    camera_from_fov,
    camera_from_matrix,
    horizontal_fov_deg,
    project,
    project_with_derivative,
    rotation_matrix,
    yaw_pitch_roll_deg,
)

angles = st.floats(-3.0, 3.0)
tiny = st.sampled_from([0.0, 1e-12, 1e-6, 1e-5, 9.9e-5, 1.01e-4])
vectors = st.one_of(st.tuples(angles, angles, angles), st.tuples(tiny, tiny, tiny)).map(np.array)
MATRIX = np.array([[820.0, 0.0, 331.0], [0.0, 790.0, 236.0], [0.0, 0.0, 1.0]])
COEFFICIENTS = [0.11, -0.2, 0.003, -0.004, 0.05, 0.02, -0.03, 0.01]


@given(vectors)
def test_rotation_matrix_is_scipys_also_near_zero(vector):
    np.testing.assert_allclose(rotation_matrix(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)


@given(vectors, vectors)
def test_rotation_derivative_agrees_with_central_differences(vector, direction):
    _, derivative = jax.jvp(rotation_matrix, (jnp.asarray(vector),), (jnp.asarray(direction),))
    h = 1e-6
    numeric = (rotation_matrix(vector + h * direction) - rotation_matrix(vector - h * direction)) / (2 * h)
    np.testing.assert_allclose(derivative, numeric, atol=2e-8)


@given(st.tuples(st.floats(-85, 85), st.floats(-85, 85), st.floats(-170, 170)).map(np.array))
def test_yaw_pitch_roll_round_trip(angles_deg):
    np.testing.assert_allclose(yaw_pitch_roll_deg(axis_angle_from_yaw_pitch_roll(angles_deg)), angles_deg, atol=1e-9)


@pytest.mark.parametrize(
    ("angles_deg", "moves"),
    [((20, 0, 0), "nose to the image's left"), ((0, 20, 0), "nose up"), ((0, 0, 20), "top of the head to the right")],
)
def test_signs_of_yaw_pitch_roll_as_seen_in_the_picture(angles_deg, moves):
    rotation = np.asarray(rotation_matrix(axis_angle_from_yaw_pitch_roll(np.array(angles_deg, float))))
    nose = rotation @ [0.0, 0.0, -50.0]
    crown = rotation @ [0.0, -100.0, 0.0]
    assert {
        "nose to the image's left": nose[0] < -10,
        "nose up": nose[1] < -10,
        "top of the head to the right": crown[0] > 10,
    }[moves]


def test_frames_without_a_pose_have_no_angles():
    mixed = np.array([[0.0, 0.0, 0.1], [np.nan, np.nan, np.nan]])
    found = yaw_pitch_roll_deg(mixed)
    assert np.isfinite(found[0]).all()
    assert np.isnan(found[1]).all()


@pytest.mark.parametrize("count", [0, 4, 5, 8])
def test_projection_is_opencvs(count):
    rng = np.random.default_rng(count)
    points = rng.normal([0.0, 0.0, 600.0], 80.0, (40, 3))
    distortion = np.array(COEFFICIENTS[:count])
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, distortion)
    camera = camera_from_matrix(MATRIX, distortion)
    np.testing.assert_allclose(project(camera, points), expected[:, 0], atol=1e-9)
    np.testing.assert_allclose(project_with_derivative(camera, jnp.asarray(points))[0], expected[:, 0], atol=1e-9)


@pytest.mark.parametrize("count", [12, 14])
def test_the_rational_model_is_read_as_opencv_stores_it(count):
    camera = camera_from_matrix(MATRIX, np.array(COEFFICIENTS + [0.0] * (count - 8)))
    np.testing.assert_array_equal(camera.distortion, COEFFICIENTS)
    with pytest.raises(InputError, match=r"thin-prism and tilt terms .* are not supported"):
        camera_from_matrix(MATRIX, np.array(COEFFICIENTS + [0.0] * (count - 9) + [0.001]))


def test_another_number_of_coefficients_is_refused():
    with pytest.raises(InputError, match="has 0, 4, 5 or 8 coefficients, got 6"):
        camera_from_matrix(MATRIX, np.zeros(6))


def test_projection_derivative_agrees_with_automatic_differentiation():
    rng = np.random.default_rng(1)
    points = jnp.asarray(rng.normal([0.0, 0.0, 600.0], 80.0, (40, 3)))
    camera = camera_from_matrix(MATRIX, np.array(COEFFICIENTS))
    expected = jax.vmap(jax.jacfwd(lambda point: project(camera, point)))(points)
    np.testing.assert_allclose(project_with_derivative(camera, points)[1], expected, rtol=1e-9, atol=1e-9)


def test_a_field_of_view_may_have_distortion():
    straight, bent = camera_from_fov((640, 480), 50.0), camera_from_fov((640, 480), 50.0, np.array(COEFFICIENTS[:4]))
    np.testing.assert_array_equal(bent.distortion, [*COEFFICIENTS[:4], 0.0, 0.0, 0.0, 0.0])
    assert np.array_equal(bent.focal_px, straight.focal_px)


@given(st.floats(10.0, 120.0))
def test_field_of_view_round_trip_and_centre(fov_deg):
    camera = camera_from_fov((640, 480), fov_deg)
    assert horizontal_fov_deg(camera, (640, 480)) == pytest.approx(fov_deg)
    np.testing.assert_allclose(project(camera, np.array([[0.0, 0.0, 1.0]])), [[319.5, 239.5]])


def test_a_turned_picture_has_the_same_focal_length():
    assert camera_from_fov((480, 640), 50.0).focal_px[0] == camera_from_fov((640, 480), 50.0).focal_px[0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: camera_from_fov((640, 480), 180.0), "between 0 and 180"),
        (lambda: camera_from_matrix(np.eye(4)), "3 × 3"),
        (lambda: camera_from_matrix(np.diag([-1.0, 1.0, 1.0])), "positive focal"),
        (lambda: camera_from_matrix(MATRIX, np.zeros(3)), "coefficients"),
        (lambda: camera_from_matrix(MATRIX.T), "last row is 0 0 1; transpose"),
        (lambda: camera_from_matrix(2.0 * MATRIX), "last row is 0 0 1"),
        (lambda: camera_from_fov((640, 480), 45.0, np.array([0.1])), "coefficients"),
    ],
)
def test_impossible_cameras_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()
