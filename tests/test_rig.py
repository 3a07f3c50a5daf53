"""Calibrated rigs: laws of their poses, their files, and what is refused."""

import json
import re
import textwrap
from dataclasses import replace
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.pages import code_blocks
from tests.scenes import make_scene
from tests.stereo_scenes import make_rig, make_stereo_scene
from workbench.errors import InputError
from workbench.geometry import (
    Camera,
    Rig,
    View,
    camera_from_fov,
    epipolar_distance,
    fundamental_matrix,
    pose_in_view,
    project,
    project_to_view,
    read_rig,
    relative_pose,
    reprojection_error,
    resized_view,
    rig_files,
    rig_report,
    rig_toml,
    rotation_matrix,
    to_reference,
    to_view,
    triangulate,
    undistorted_pixels,
    undistorted_rays,
    write_rig,
    yaw_pitch_roll_deg,
)
from workbench.geometry.opencv_files import read_opencv_file

SIZE = (640, 480)
CAMERA = camera_from_fov(SIZE, 45.0)
MATRIX = np.array([[772.5, 0.0, 319.5], [0.0, 772.5, 239.5], [0.0, 0.0, 1.0]])
DISTORTION = np.array([[0.11, -0.2, 0.003, -0.004, 0.05]])

components = st.floats(-3.0, 3.0)
rotations = st.tuples(components, components, components).map(lambda v: Rotation.from_rotvec(v).as_matrix())
places = st.tuples(*[st.floats(-500.0, 500.0)] * 3).map(np.array)
poses = st.tuples(rotations, places)
seeds = st.integers(0, 2**32 - 1)


def random_rig(seed: int, count: int = 3) -> Rig:
    """Cameras of all kinds around a point of an arbitrary world, looking about there."""
    rng = np.random.default_rng(seed)
    world = Rotation.random(rng=rng)
    views = []
    for index in range(count):
        turned = Rotation.from_rotvec(np.array([0.0, 0.35 * index, 0.0]) + rng.uniform(-0.1, 0.1, 3)) * world
        focal, centre = rng.uniform(600, 900, 2), rng.normal([319.5, 239.5], 10.0)
        camera = Camera(focal, centre, rng.uniform(-0.01, 0.01, 8))
        translation = rng.normal([0.0, 0.0, 700.0], 15.0)
        views.append(View(f"view {index}", SIZE, camera, turned.as_matrix(), translation))
    return Rig(tuple(views))


def pair(rotation: np.ndarray, translation: np.ndarray, **changed) -> Rig:
    """Two cameras with this pose of the second in the first."""
    first = View("left", SIZE, CAMERA, np.eye(3), np.zeros(3))
    entries = {"name": "right", "image_size": SIZE, "camera": CAMERA, **changed}
    return Rig((first, View(**entries, rotation_view_world=rotation, translation_view_world_mm=translation)))


def assert_same(one: Rig, other: Rig, **tolerance) -> None:
    assert one.names == other.names
    for a, b in zip(one.views, other.views, strict=True):
        assert a.image_size == b.image_size
        for left, right in zip(a.camera, b.camera, strict=True):
            np.testing.assert_allclose(left, right, **tolerance)
    np.testing.assert_allclose(one.rotation_view_reference, other.rotation_view_reference, **tolerance)
    np.testing.assert_allclose(one.translation_view_reference_mm, other.translation_view_reference_mm, **tolerance)


# --- poses ---


@given(poses, poses, poses, places)
def test_relative_poses_compose(a, b, c, point_world):
    rotation_ba, translation_ba = relative_pose(*a, *b)
    rotation_cb, translation_cb = relative_pose(*b, *c)
    rotation_ca, translation_ca = relative_pose(*a, *c)
    np.testing.assert_allclose(rotation_cb @ rotation_ba, rotation_ca, atol=1e-12)
    np.testing.assert_allclose(rotation_cb @ translation_ba + translation_cb, translation_ca, atol=1e-9)
    point_a, point_b = a[0] @ point_world + a[1], b[0] @ point_world + b[1]
    np.testing.assert_allclose(rotation_ba @ point_a + translation_ba, point_b, atol=1e-9)


@given(poses)
def test_a_pose_relative_to_itself_is_none(pose):
    rotation, translation = relative_pose(*pose, *pose)
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(translation, 0.0, atol=1e-9)


@given(seeds, places)
def test_a_rig_places_world_points_in_every_view_and_back(seed, offset):
    rig = random_rig(seed)
    reference = rig.views[0]
    points_world = np.stack([offset, offset + 10.0])
    points_reference = points_world @ reference.rotation_view_world.T + reference.translation_view_world_mm
    for index, view in enumerate(rig.views):
        placed = rig.placed_view(index)
        points_view = to_view(points_reference, placed)
        expected = points_world @ view.rotation_view_world.T + view.translation_view_world_mm
        np.testing.assert_allclose(points_view, expected, atol=1e-9)
        np.testing.assert_allclose(to_reference(points_view, placed), points_reference, atol=1e-9)


def test_the_first_view_is_the_reference_exactly():
    rig = random_rig(3)
    np.testing.assert_array_equal(rig.rotation_view_reference[0], np.eye(3))
    np.testing.assert_array_equal(rig.translation_view_reference_mm[0], np.zeros(3))
    np.testing.assert_array_equal(rig.position_reference_mm[0], np.zeros(3))


def test_a_camera_stands_where_its_picture_has_no_depth():
    rig = random_rig(4)
    for index in range(3):
        np.testing.assert_allclose(to_view(rig.position_reference_mm[index], rig.placed_view(index)), 0.0, atol=1e-10)
        view = rig.views[index]
        seen = view.rotation_view_world @ view.position_world_mm + view.translation_view_world_mm
        np.testing.assert_allclose(seen, 0.0, atol=1e-10)


def test_all_views_are_projected_to_at_once_under_a_trace():
    rig = random_rig(5)
    points = jnp.array([[10.0, -20.0, 650.0], [0.0, 0.0, 700.0]])
    together = jax.jit(jax.vmap(project_to_view, in_axes=(None, 0)))(points, rig.placed)
    for index, name in enumerate(rig.names):
        placed = rig.placed_view(name)
        np.testing.assert_allclose(together[index], project(placed.camera, to_view(points, placed)), rtol=1e-12)


@given(seeds)
def test_a_heads_pose_in_a_view_moves_its_points_as_the_rig_does(seed):
    rng = np.random.default_rng(seed)
    placed = random_rig(seed).placed_view(1)
    rotation, translation = rng.normal(0.0, 0.5, (2, 3)), rng.normal([0.0, 0.0, 600.0], 50.0, (2, 3))
    turned, moved = pose_in_view(rotation, translation, placed)
    point = np.array([5.0, -30.0, 12.0])
    for k in range(2):
        point_reference = np.asarray(rotation_matrix(rotation[k])) @ point + translation[k]
        expected = to_view(point_reference, placed)
        np.testing.assert_allclose(rotation_matrix(turned[k]) @ point + moved[k], expected, atol=1e-9)


def test_a_camera_to_the_right_sees_the_head_turned_to_the_left_of_its_picture(head):
    scene = make_stereo_scene(head, make_rig((0.0, 30.0)), moving=False)
    assert scene.rig.position_reference_mm[1, 0] > 0
    middle, side = scene.points[:, 0]
    eyes = [(points[36, 0] + points[45, 0]) / 2 for points in (middle, side)]
    assert middle[30, 0] == pytest.approx(eyes[0], abs=1.0)
    assert side[30, 0] < eyes[1] - 10


def test_the_reference_view_of_a_scene_is_the_scene_of_one_camera(head):
    stereo = make_stereo_scene(head, frames=2, seed=4)
    truth = stereo.parameters[1]
    weights = dict(zip(head.expression_names, np.asarray(truth.expression), strict=True))
    angles_deg = yaw_pitch_roll_deg(np.array(truth.rotation))
    assert np.abs(angles_deg).max() < 15.0
    mono = make_scene(head, angles_deg, weights, translation=truth.translation)
    np.testing.assert_allclose(stereo.points[0, 1], mono.points, atol=1e-9)


# --- what a rig is not ---


def stretched(factor: float) -> np.ndarray:
    return np.diag([factor, 1.0, 1.0])


AWAY = np.array([-200.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Rig(()), "at least one view"),
        (lambda: pair(np.eye(3), AWAY, name="left"), "is used for two views"),
        (lambda: pair(np.eye(3), AWAY, name=" "), "needs a name"),
        (lambda: pair(np.eye(3), AWAY, image_size=(0, 480)), "0 × 480"),
        (lambda: pair(stretched(1.01), AWAY), "not a rotation .* 0.02"),
        (lambda: pair(np.full((3, 3), np.nan), AWAY), "not a rotation"),
        (lambda: pair(stretched(-1.0), AWAY), "mirrors"),
        (lambda: pair(np.eye(3), np.array([np.inf, 0.0, 0.0])), "finite numbers"),
        (lambda: pair(np.eye(3), AWAY, camera=CAMERA._replace(focal_px=np.array([700.0, -1.0]))), "positive"),
        (lambda: pair(np.eye(3), AWAY, camera=CAMERA._replace(distortion=np.full(8, np.nan))), "not finite"),
        (lambda: pair(np.eye(3), AWAY, camera=CAMERA._replace(principal_point_px=np.array([900.0, 1.0]))), "outside"),
        (lambda: pair(np.eye(3), np.zeros(3)), "same place"),
        (lambda: pair(np.eye(3), 0.001 * AWAY), "0.2 mm apart.*unit"),
        (lambda: pair(np.eye(3), 1000.0 * AWAY), "mm apart.*unit"),
        (lambda: pair(np.diag([-1.0, 1.0, -1.0]), AWAY), "share no point.*world_from_view"),
        (lambda: make_rig().view("left"), "no view 'left'; its views are middle, side"),
        (lambda: resized_view(make_rig().views[0], (640, 360)), "not scaled copies"),
    ],
)
def test_what_cannot_be_a_rig_is_refused_in_one_sentence(make, message):
    with pytest.raises(InputError, match=message) as refusal:
        make()
    assert "\n" not in str(refusal.value)


def test_rounded_digits_of_a_rotation_are_repaired():
    rotation = Rotation.from_rotvec([0.02, 0.5, -0.03]).as_matrix()
    repaired = pair(rotation.round(4), -rotation @ [300.0, 0.0, 80.0]).views[1].rotation_view_world
    np.testing.assert_allclose(repaired.T @ repaired, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(repaired, rotation, atol=1e-4)


def test_one_camera_and_a_parallel_pair_are_rigs():
    assert len(make_rig((0.0,))) == 1
    assert len(pair(np.eye(3), np.array([-65.0, 0.0, 0.0]))) == 2


def test_a_rig_cannot_be_changed_in_place():
    rig = make_rig()
    for array in (rig.views[0].rotation_view_world, rig.views[1].camera.focal_px, rig.rotation_view_reference):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0


@given(seeds, st.sampled_from([0.25, 0.5, 2.0]))
def test_a_scaled_picture_shows_the_same_points_at_scaled_places(seed, scale):
    view = random_rig(seed).views[1]
    point = np.array([[30.0, -20.0, 600.0]])
    resized = resized_view(view, (int(640 * scale), int(480 * scale)))
    expected = (np.asarray(project(view.camera, point)) + 0.5) * scale - 0.5
    np.testing.assert_allclose(project(resized.camera, point), expected, atol=1e-9)


# --- points in several views ---


def seen_points(rig: Rig, seed: int, count: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """Points in front of all cameras, and their pixels in each."""
    points = np.random.default_rng(seed).normal([0.0, 0.0, 700.0], 40.0, (count, 3))
    return points, np.stack([project_to_view(points, rig.placed_view(v)) for v in range(len(rig))])


def with_distortion(rig: Rig) -> Rig:
    coefficients = np.array([-0.28, 0.09, 0.002, -0.001, 0.0, 0.0, 0.0, 0.0])
    return Rig(tuple(replace(v, camera=v.camera._replace(distortion=coefficients)) for v in rig.views))


@given(seeds)
def test_undistorted_rays_invert_the_projection(seed):
    rng = np.random.default_rng(seed)
    camera = with_distortion(random_rig(seed)).views[0].camera
    rays = rng.uniform(-0.4, 0.4, (20, 2))
    pixels = np.asarray(project(camera, np.column_stack([rays, np.ones(20)])))
    np.testing.assert_allclose(undistorted_rays(camera, pixels), rays, atol=1e-9)
    straight = camera._replace(distortion=np.zeros(8))
    expected = project(straight, np.column_stack([rays, np.ones(20)]))
    np.testing.assert_allclose(undistorted_pixels(camera, pixels), expected, atol=1e-6)


def test_pixels_that_no_ray_reaches_and_missing_pixels_have_no_ray():
    folding = CAMERA._replace(distortion=np.array([-2.0, 0, 0, 0, 0, 0, 0, 0]))
    found = undistorted_rays(folding, np.array([[0.0, 0.0], [320.0, 240.0], [np.nan, 1.0]]))
    assert np.isfinite(found).all(axis=1).tolist() == [False, True, False]


@given(seeds)
def test_one_point_lies_on_its_epipolar_lines_through_any_lens(seed):
    rig = with_distortion(random_rig(seed))
    _, pixels = seen_points(rig, seed)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        distances = epipolar_distance(rig.placed_view(a), rig.placed_view(b), pixels[a], pixels[b])
        np.testing.assert_allclose(distances, 0.0, atol=1e-6)


def test_the_epipolar_distance_is_measured_across_the_line_in_pixels():
    # A pair side by side: lines are the rows of the picture, and only y counts.
    rig = pair(np.eye(3), np.array([-200.0, 0.0, 0.0]))
    _, pixels = seen_points(rig, 0)
    a, b = rig.placed_view(0), rig.placed_view(1)
    np.testing.assert_allclose(epipolar_distance(a, b, pixels[0], pixels[1] + [7.0, 3.0]), 3.0)
    np.testing.assert_allclose(epipolar_distance(b, a, pixels[1] + [7.0, 3.0], pixels[0]), 3.0)


@given(seeds)
def test_the_fundamental_matrix_is_transposed_the_other_way_round(seed):
    rig = random_rig(seed)
    forth = fundamental_matrix(rig.placed_view(0), rig.placed_view(1))
    back = fundamental_matrix(rig.placed_view(1), rig.placed_view(0))
    forth, back = forth / np.linalg.norm(forth), back.T / np.linalg.norm(back)
    np.testing.assert_allclose(forth * np.sign((forth * back).sum()), back, atol=1e-9)


@given(seeds)
def test_triangulation_recovers_points_through_any_lens(seed):
    rig = with_distortion(random_rig(seed))
    points, pixels = seen_points(rig, seed)
    found = triangulate(rig.placed, pixels)
    np.testing.assert_allclose(found, points, atol=1e-5)
    np.testing.assert_allclose(reprojection_error(rig.placed, found, pixels), 0.0, atol=1e-6)


def test_triangulation_needs_two_views_of_a_point():
    rig = random_rig(6)
    points, pixels = seen_points(rig, 6)
    pixels[0, :3] = np.nan
    pixels[1, 0] = np.nan
    found = triangulate(rig.placed, pixels)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], points[1:], atol=1e-6)


def test_parallel_rays_give_no_place():
    rig = pair(np.eye(3), np.array([-200.0, 0.0, 0.0]))
    pixels = np.array([[[320.0, 240.0]], [[320.0, 240.0]]])
    assert np.isnan(triangulate(rig.placed, pixels)).all()


def test_triangulated_points_are_nearest_to_noisy_pixels():
    rig = with_distortion(random_rig(7))
    points, pixels = seen_points(rig, 7, 200)
    pixels += np.random.default_rng(7).normal(0.0, 1.0, pixels.shape)

    def total(places):
        return (reprojection_error(rig.placed, places, pixels) ** 2).sum(axis=0)

    found = triangulate(rig.placed, pixels)
    for step in 0.05 * np.vstack([np.eye(3), -np.eye(3)]):
        assert (total(found + step) > total(found)).all()
    assert np.median(np.linalg.norm(found - points, axis=1)) < 3.0


# --- the report ---


def test_a_report_measures_lenses_and_places():
    rig = make_rig((0.0, 30.0))
    first, second = rig_report(rig).views
    assert first.fov_deg == pytest.approx((45.0, 34.515), abs=1e-3)
    assert first.principal_offset_px == (0.0, 0.0)
    assert first.corner_distortion_px == 0.0
    assert second.baseline_mm == pytest.approx(2 * 600 * np.sin(np.radians(15)))
    assert second.angle_deg == pytest.approx(30.0)
    assert second.meeting_mm == pytest.approx(600.0)
    assert second.gap_mm == pytest.approx(0.0, abs=1e-9)
    assert second.roll_deg == pytest.approx(0.0)
    assert rig_report(rig).meeting_reference_mm == pytest.approx((0.0, 0.0, 600.0), abs=1e-9)
    assert rig_report(rig).warnings == ()


def test_the_report_of_one_camera_and_of_barrel_distortion():
    report = rig_report(make_rig((0.0,), distortion=(-0.25, 0.1)))
    assert report.meeting_reference_mm is None
    assert report.views[0].corner_distortion_px == pytest.approx(30.8, abs=2.0)
    assert report.views[0].fov_deg[0] > 46.0


def lens(**changed) -> Rig:
    """Two cameras 30° apart, the second with another lens."""
    first, second = make_rig().views
    return Rig((first, replace(second, camera=second.camera._replace(**changed))))


def placed(turn_deg, translation=(0.0, 0.0, 600.0)) -> Rig:
    """The second camera turned by these angles about x, y, z before it is set down."""
    turned = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    first, second = make_rig().views
    moved = np.array(translation, float)
    return Rig((first, replace(second, rotation_view_world=turned, translation_view_world_mm=moved)))


@pytest.mark.parametrize(
    ("make", "warning"),
    [
        (lambda: make_rig((0.0, 30.0), distance_mm=60.0), "60 mm in front.*unit"),
        (lambda: make_rig((0.0, 30.0), distance_mm=12000.0), "12000 mm in front.*unit"),
        (lambda: make_rig((0.0, 3.0)), "3.0° between"),
        (lambda: make_rig((0.0, 120.0)), "120° between"),
        (lambda: make_rig((0.0, 180.0)), "180° between.*seen by both"),
        (lambda: pair(np.eye(3), np.array([-65.0, 0.0, 0.0])), "parallel axes.*65 mm"),
        (lambda: placed((0.0, 30.0, 90.0)), "turned by -?90°"),
        (
            lambda: placed((0.0, 30.0, 0.0), (0.0, 260.0, 600.0)),
            "side: its axis misses the point where the axes meet by 1[0-9]+ mm",
        ),
        (lambda: placed((0.0, -10.0, 0.0), (-300.0, 0.0, 0.0)), "behind"),
        (lambda: lens(focal_px=np.array([900.0, 700.0])), "not square"),
        (lambda: lens(focal_px=np.array([120.0, 120.0])), "139° is unusual"),
        (lambda: lens(principal_point_px=np.array([450.0, 240.0])), "131 px off the middle"),
        (lambda: lens(distortion=np.array([-2.0, 0, 0, 0, 0, 0, 0, 0])), "folds over"),
        (lambda: lens(distortion=np.array([3.0, 0, 0, 0, 0, 0, 0, 0])), "moves a corner by"),
    ],
)
def test_what_seems_wrong_is_said_in_one_sentence(make, warning):
    warnings = rig_report(make()).warnings
    assert any(re.search(warning, text) for text in warnings), warnings
    assert all(text.count("\n") == 0 and len(text) < 160 for text in warnings)


# --- files ---


def save_opencv(path: Path, **entries) -> Path:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in entries.items():
        storage.write(name, value)
    storage.release()
    return path


ROTATION = Rotation.from_rotvec([0.01, 0.5, -0.02]).as_matrix()
TRANSLATION = np.array([0.0, 0.0, 600.0]) - ROTATION @ [0.0, 0.0, 600.0]
PAIR = {"K1": MATRIX, "D1": DISTORTION, "K2": MATRIX, "D2": DISTORTION, "R": ROTATION, "T": TRANSLATION[:, None]}
WIDTH_HEIGHT = {"image_width": 640, "image_height": 480}


@given(seed=seeds)
def test_a_written_rig_is_read_to_the_same_bits(tmp_path_factory, seed):
    rig = random_rig(seed)
    path = tmp_path_factory.mktemp("rig") / "rig.toml"
    write_rig(rig, path)
    assert_same(read_rig(path), rig, rtol=0, atol=0)


@pytest.mark.parametrize("suffix", ["yml", "yaml", "json", "xml"])
def test_a_stereo_calibration_of_opencv_is_read(tmp_path, suffix):
    rig = read_rig(save_opencv(tmp_path / f"stereo.{suffix}", **PAIR, **WIDTH_HEIGHT))
    assert rig.names == ("camera1", "camera2")
    assert rig.views[0].image_size == SIZE
    np.testing.assert_allclose(rig.rotation_view_reference[1], ROTATION, atol=1e-15)
    np.testing.assert_allclose(rig.translation_view_reference_mm[1], TRANSLATION, atol=1e-12)
    np.testing.assert_allclose(rig.views[1].camera.distortion[:5], DISTORTION[0])
    # OpenCV's own projection of a point, through both cameras.
    point = np.array([[12.0, -7.0, 580.0]])
    expected, _ = cv2.projectPoints(point, cv2.Rodrigues(ROTATION)[0], TRANSLATION, MATRIX, DISTORTION)
    np.testing.assert_allclose(project_to_view(point, rig.placed_view(1)), expected[0], atol=1e-9)


def test_opencvs_stereo_sample_writes_two_files_without_a_picture_size(tmp_path):
    names = {"K1": "M1", "K2": "M2"}
    intrinsics = {names.get(key, key): PAIR[key] for key in ("K1", "D1", "K2", "D2")}
    first = save_opencv(tmp_path / "intrinsics.yml", **intrinsics)
    second = save_opencv(tmp_path / "extrinsics.yml", R=PAIR["R"], T=PAIR["T"] / 10, R1=np.eye(3), P1=np.eye(3, 4))
    rig = read_rig([first, second], unit="cm", image_size=SIZE)
    np.testing.assert_allclose(rig.translation_view_reference_mm[1], TRANSLATION, atol=1e-12)
    with pytest.raises(InputError, match=r"no picture size.*--size"):
        read_rig([first, second])
    with pytest.raises(InputError, match=r"no R and T.*extrinsic"):
        read_rig(first, image_size=SIZE)


def test_the_files_of_two_pairs_are_no_rig(tmp_path):
    files = [save_opencv(tmp_path / name, **PAIR, **WIDTH_HEIGHT) for name in ("ab.yml", "ac.yml")]
    with pytest.raises(InputError, match=r"to several pairs of cameras; .*three or more cameras one file each"):
        read_rig(files)


def test_a_picture_size_that_is_asked_for_is_that_of_the_file(tmp_path):
    path = save_opencv(tmp_path / "stereo.yml", **PAIR, **WIDTH_HEIGHT)
    assert_same(read_rig(path, image_size=SIZE), read_rig(path), rtol=0, atol=0)
    with pytest.raises(InputError, match="pictures are 640 × 480, and 320 × 240 was asked for; leave out --size"):
        read_rig(path, image_size=(320, 240))


def test_an_ordinary_calibration_of_opencvs_sample_names_its_model(tmp_path):
    path = save_opencv(tmp_path / "stereo.yml", **PAIR, **WIDTH_HEIGHT, fisheye_model=0)
    assert read_rig(path).names == ("camera1", "camera2")


@pytest.mark.parametrize("as_matrix", [True, False])
def test_a_file_a_camera_of_opencv_is_read(tmp_path, as_matrix):
    rig = random_rig(8)
    paths = []
    for view in rig.views:
        rotation = view.rotation_view_world
        pose = {"R": rotation} if as_matrix else {"rvec": Rotation.from_matrix(rotation).as_rotvec()[:, None]}
        (fx, fy), (cx, cy) = view.camera.focal_px, view.camera.principal_point_px
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        entries = {"camera_matrix": matrix, "distortion_coefficients": view.camera.distortion[None], **WIDTH_HEIGHT}
        path = tmp_path / f"{view.name}.yml"
        paths.append(save_opencv(path, **entries, **pose, tvec=view.translation_view_world_mm / 1000, unit="m"))
    assert_same(read_rig(paths), rig, atol=1e-9)


def test_files_of_one_name_are_told_apart_by_their_folders(tmp_path):
    paths = []
    for view in make_rig().views[:2]:
        (tmp_path / view.name).mkdir()
        pose = {"R": view.rotation_view_world, "tvec": view.translation_view_world_mm}
        path = tmp_path / view.name / "calib.yml"
        paths.append(save_opencv(path, camera_matrix=MATRIX, **WIDTH_HEIGHT, **pose))
    assert read_rig(paths).names == make_rig().names[:2]


def test_lists_of_plain_json_are_read_as_matrices(tmp_path):
    text = """{"K1": %s, "K2": %s, "R": %s, "T": %s, "image_size": [640, 480]}"""
    parts = [np.asarray(value).tolist() for value in (MATRIX, MATRIX, ROTATION, TRANSLATION)]
    path = tmp_path / "rig.json"
    path.write_text(text % tuple(map(str, parts)), encoding="utf-8-sig")  # as some editors of Windows write it
    np.testing.assert_allclose(read_rig(path).rotation_view_reference[1], ROTATION, atol=1e-15)


@pytest.mark.parametrize("unit", ["mm", "cm", "m"])
def test_lengths_come_in_the_unit_that_the_file_names(tmp_path, unit):
    rig = make_rig()
    factor = {"mm": 1.0, "cm": 10.0, "m": 1000.0}[unit]
    lines = []
    for line in rig_toml(rig).splitlines():
        if line.startswith("unit"):
            line = f'unit = "{unit}"'
        if line.startswith("translation"):
            line = f"translation = [0.0, 0.0, {600.0 / factor}]"
        lines.append(line)
    path = tmp_path / "rig.toml"
    path.write_text("\n".join(lines))
    assert_same(read_rig(path), rig, atol=1e-9)


def test_poses_of_cameras_in_the_world_are_turned_round(tmp_path):
    rig = random_rig(9)
    text = rig_toml(rig).replace("view_from_world", "world_from_view")
    for view in rig.views:
        text = text.replace(str(view.translation_view_world_mm.tolist()), str(view.position_world_mm.tolist()))
        for row, column in zip(view.rotation_view_world, view.rotation_view_world.T, strict=True):
            text = text.replace(f"    {row.tolist()},", f"    {column.tolist()},")
    path = tmp_path / "rig.toml"
    path.write_text(text)
    assert_same(read_rig(path), rig, atol=1e-9)


def edited(before: str, after: str):
    def write(folder: Path) -> list[Path]:
        text = rig_toml(make_rig())
        assert before in text
        (folder / "rig.toml").write_text(text.replace(before, after))
        return [folder / "rig.toml"]

    return write


def raw(name: str, content: bytes):
    def write(folder: Path) -> list[Path]:
        (folder / name).write_bytes(content)
        return [folder / name]

    return write


def opencv(name: str = "rig.yml", **changed):
    def write(folder: Path) -> list[Path]:
        entries = {**PAIR, **WIDTH_HEIGHT, **changed}
        return [save_opencv(folder / name, **{k: v for k, v in entries.items() if v is not None})]

    return write


CUT = b"%YAML:1.0\n---\nK1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 1., 2."
SHORT = CUT + b" ]\n"
LONE = {"K1": None, "K2": None, "K": MATRIX}


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda _: [], "at least one file"),
        (lambda folder: [folder / "rig.toml"], "does not exist"),
        (raw("rig.txt", b""), "got rig.txt"),
        (raw("rig.toml", b"unit = "), "not valid TOML"),
        (raw("rig.toml", b"\xff\xfe"), "not valid TOML"),
        (raw("rig.toml", b'unit = "mm"\nviews = 3\n'), r"\[\[views\]\]"),
        (raw("rig.toml", b'unit = "mm"\nviews = []\n'), "at least one view"),
        (edited('unit = "mm"', 'unit = "inch"'), "'inch'.*mm, cm, m"),
        (edited('unit = "mm"', ""), "unit is missing"),
        (edited("version = 1", "version = 2"), "version is 2"),
        (edited("unit =", "units ="), "'units'; did you mean unit"),
        (edited("view_from_world", "camera"), "pose is 'camera'"),
        (edited("translation = ", "translaton = "), "view 1: unknown key 'translaton'; did you mean translation"),
        (edited("name = ", "# name = "), "view 1: name is missing"),
        (edited('name = "side"', "name = 2"), "view 2: name is 2"),
        (edited('name = "side"', f'name = "{"s" * 101}"'), "view 2: name is .* at most 100 letters"),
        (edited('unit = "mm"', "unit = []"), r"unit is \[\]"),
        (edited('unit = "mm"', "unit = " + "[" * 200 + "]" * 200), "nested more than 100 deep"),
        (edited("[0.0, 0.0, 600.0]", "[0.0, 0.0, 1e12]"), "beyond 1e[+]09"),
        (edited("image_size = [640, 480]", "image_size = [640.5, 480]"), "whole pixels"),
        (edited("image_size = [640, 480]", "image_size = [640]"), "image_size has 1 entries, expected 2"),
        (edited("[0.0, 0.0, 600.0]", '"far"'), "translation is 'far', expected 3 numbers"),
        (edited("[0.0, 0.0, 600.0]", "[0.0, 0.0, nan]"), "not finite"),
        (edited("[0.0, 0.0, 600.0]", "[0.0, 0.0, 0.6]"), "0.3106 mm apart.*unit"),
        (edited("distortion = [0.0,", "distortion = ["), "7"),
        (edited("[0.0, 0.0, 1.0]", "[0.0, 0.0]"), "view 1: matrix"),
        (raw("rig.yml", b""), "cannot be read as an OpenCV file"),
        (raw("rig.yml", CUT), "cannot be read as an OpenCV file"),
        (raw("rig.yml", SHORT), "cannot be read as an OpenCV file"),
        (raw("rig.json", b'{"K1": [1,'), "cannot be read as an OpenCV file"),
        (raw("rig.xml", b"<?xml version='1.0'?><opencv_storage><K1>"), "cannot be read as an OpenCV file"),
        (raw("rig.yml", b"\xff\xfe\x00"), "cannot be read as an OpenCV file"),
        (raw("rig.yml", b"%YAML:1.0\n---\na: 1\n"), "no camera matrix.*its keys: a"),
        (raw("rig.json", b'{"a": ' + b"[" * 200_000), "nests its entries"),
        (raw("rig.yml", b"%YAML:1.0\n---\na:\n   - " + b"- " * 200_000 + b"1\n"), "nests its entries"),
        (raw("rig.xml", b"<?xml version='1.0'?>" + b"<a>" * 200_000), "nests its entries"),
        (opencv(R=None), "no R and T"),
        (opencv(K2=None), "no matrix for camera 2"),
        (opencv(R=-ROTATION), "camera 2: The rotation of view 'camera2' mirrors"),
        (opencv(R=np.eye(2)), "rotation has 4 entries, expected 3 or 9"),
        (opencv(D1=np.zeros((1, 6))), "camera 1: .*coefficients, got 6"),
        (opencv(D1=np.full((1, 14), 0.1)), "camera 1: .*thin-prism and tilt terms"),
        (opencv(K1=np.diag([-1.0, 1.0, 1.0])), "positive focal"),
        (opencv(unit="feet"), "unit is 'feet'"),
        (opencv(fisheye_model=1), "uses OpenCV's fisheye model; calibrate with"),
        (opencv(T=TRANSLATION / 1000), "mm apart.*unit"),
        (opencv(image_width=300), "principal point .* lies outside"),
        (opencv(**LONE, R=None), "where its camera is: no rotation"),
        (opencv(**LONE, T=None), "where its camera is: no translation"),
    ],
)
def test_damaged_files_are_refused_in_one_sentence_that_names_them(tmp_path, capfd, write, message):
    paths = write(tmp_path)
    with pytest.raises(InputError, match=message) as refusal:
        read_rig(paths)
    assert "\n" not in str(refusal.value)
    assert not paths or paths[0].name in str(refusal.value)
    assert capfd.readouterr().err == ""


MATRIX_TYPES = {"d": np.float64, "f": np.float32, "i": np.int32, "u": np.uint8}


@pytest.mark.parametrize("suffix", ["yml", "json", "xml"])
@settings(max_examples=15)
@given(data=st.data())
def test_matrices_are_those_that_opencv_reads(tmp_path_factory, suffix, data):
    rows, cols = data.draw(st.integers(1, 4)), data.draw(st.integers(1, 5))
    dtype = MATRIX_TYPES[data.draw(st.sampled_from(sorted(MATRIX_TYPES)))]
    shape = (rows, cols, data.draw(st.sampled_from((1, 3))))
    matrix = np.random.default_rng(data.draw(seeds)).uniform(0, 200, shape).astype(dtype)
    comment, size = "written after a calibration", {"image_width": 640, "unit": "mm"}
    path = tmp_path_factory.mktemp("matrix") / f"file.{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in {"points": np.full((50, 2), np.nan), "K1": matrix, **size}.items():
        storage.write(name, value)
        storage.writeComment(comment)
    storage.release()
    found = read_opencv_file(path, re.compile("K1|image_width|unit"))
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    expected = storage.getNode("K1").mat()
    np.testing.assert_array_equal(found.pop("K1").astype(expected.dtype), expected)
    assert found == {"points": None, **size}


def stored_matrix(**changed) -> dict[str, object]:
    entry = {"type_id": "opencv-matrix", "rows": 3, "cols": 3, "dt": "d", "data": MATRIX.ravel().tolist(), **changed}
    return {key: value for key, value in entry.items() if value is not None}


@pytest.mark.parametrize(
    "changed",
    [
        {"cols": None},
        {"cols": -1},
        {"rows": 0},
        {"rows": 1.5},
        {"rows": [3]},
        {"cols": 10**12},
        {"dt": "nonsense"},
        {"dt": "9d"},
        {"data": [1.0] * 8},
        {"data": [1.0] * 8 + ["a"]},
        {"data": [[1.0, 2.0, 3.0]] * 3},
        {"data": "text"},
        {"sizes": [2, 2]},
        {"sizes": [3, 3, 10**9]},
    ],
)
@pytest.mark.parametrize("suffix", ["json", "yml", "xml"])
def test_a_matrix_whose_sizes_do_not_fit_is_refused(tmp_path, suffix, changed):
    # OpenCV's own reader writes beyond its memory here.
    path, entry = tmp_path / f"rig.{suffix}", stored_matrix(**changed)
    if suffix == "xml":
        data = " ".join(map(str, np.ravel(entry["data"]).tolist()[: -2 if np.ndim(entry["data"]) == 2 else None]))
        fields = "".join(f"<{key}>{value}</{key}>" for key, value in {**entry, "data": data}.items())
        path.write_text(f"<?xml version='1.0'?><opencv_storage><K1>{fields}</K1></opencv_storage>")
    else:
        tag = "" if suffix == "json" else "%YAML 1.2\n---\n"
        path.write_text(tag + (json.dumps({"K1": entry}) if suffix == "json" else f"K1: {json.dumps(entry)}\n"))
    with pytest.raises(InputError, match=r"cannot be read as an OpenCV file \(.+\); it may be cut off"):
        read_rig(path, image_size=SIZE)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("rig.yml", "K1: &a [*a, *a]\n", "refers from one entry to another"),
        ("rig.xml", '<!DOCTYPE a [<!ENTITY b "c">]><opencv_storage><K1>&b;</K1></opencv_storage>', "defines entities"),
        ("rig.yml", "K1: [" + "1, " * 20_000 + "1]\n", "K1 has 60008 characters"),
        ("rig.json", "[" + "1," * 2_500_000 + "1]", "more than 4 MB"),
    ],
    ids=["references", "entities", "a long matrix", "a long file"],
)
def test_files_that_would_take_all_memory_or_time_are_refused(tmp_path, name, content, message):
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=message):
        read_rig(tmp_path / name)


def test_calibrations_with_many_picture_points_are_read(tmp_path):
    points = {"image_points": np.random.default_rng(2).uniform(0, 600, (3000, 2))}
    rig = read_rig(save_opencv(tmp_path / "stereo.yml", **points, **PAIR, **WIDTH_HEIGHT))
    assert rig.names == ("camera1", "camera2")


def test_what_a_file_says_is_not_said_again(tmp_path):
    write_rig(make_rig(), tmp_path / "rig.toml")
    with pytest.raises(InputError, match="gives its own unit"):
        read_rig(tmp_path / "rig.toml", unit="m")
    with pytest.raises(InputError, match="name it alone"):
        read_rig([tmp_path / "rig.toml", tmp_path / "rig.toml"])
    path = save_opencv(tmp_path / "rig.yml", **PAIR, **WIDTH_HEIGHT, unit="mm")
    with pytest.raises(InputError, match="leave one out"):
        read_rig(path, unit="cm")


def test_rigs_are_written_as_toml_only(tmp_path):
    with pytest.raises(InputError, match=r"written as \.toml"):
        write_rig(make_rig(), tmp_path / "rig.yml")
    assert list(tmp_path.iterdir()) == []


def test_the_rig_in_the_documentation_is_one(tmp_path):
    (text,) = [text for page, text in code_blocks("toml") if page == "docs/guides/stereo.md"]
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    rig = read_rig(tmp_path / "rig.toml")
    assert rig.names == ("left", "right")
    assert rig_report(rig).warnings == ()


def test_the_rig_in_the_reference_is_one(tmp_path):
    example = rig_files.__doc__.split("\n\n")
    first, view = (textwrap.dedent(example[i]) for i in (2, 3))
    other = view.replace('"left"', '"right"').replace("translation = [0.0,", "translation = [-60.0,")
    (tmp_path / "rig.toml").write_text("\n".join([first, view, other]), encoding="utf-8")
    assert read_rig(tmp_path / "rig.toml").names == ("left", "right")
