"""Boston University's head-tracking set: files in its layout, calibration and errors of FACE IT! Table 1."""

import av
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.frames import VideoWriter, open_frames
from workbench.geometry import axis_angle_from_yaw_pitch_roll, yaw_pitch_roll_deg
from workbench.reproduction import (
    BostonSequence,
    boston_camera,
    mean_errors,
    pose_errors,
    read_sequence,
    read_set,
    write_truth,
)
from workbench.reproduction.boston import NAMES, PRINTED_DEG

FRAMES = 6
LINES = [f"{k} {0.5 * k} {0.1 * k} {20 + k} {-k} {2 * k} {3 * k}" for k in range(FRAMES + 1)]
"""Seven numbers a line: frame, X, Y, Z, roll, yaw, pitch; the first line before the first frame."""


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    """A video of the set's picture size."""
    return video(tmp_path_factory.mktemp("film") / "film.avi", FRAMES, (320, 240))


def video(path, frames, size):
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mjpeg", rate=30)
        stream.width, stream.height, stream.pix_fmt = *size, "yuvj420p"
        for k in range(frames):
            picture = np.full((size[1], size[0], 3), 40 * k % 256, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture)))
        container.mux(stream.encode(None))
    return path


@pytest.fixture
def folder(tmp_path, film):
    """Two sequences in the set's layout."""
    for name in ("jam1", "vam9"):
        (tmp_path / f"{name}.avi").write_bytes(film.read_bytes())
        (tmp_path / f"{name}.dat").write_text("\n".join(LINES) + "\n")
    return tmp_path


def sequence(angles_deg, places_mm) -> BostonSequence:
    return BostonSequence("jam1", None, np.asarray(angles_deg, float), np.asarray(places_mm, float))


def nodding(seed=0, frames=40):
    """Poses of a head: yaw, pitch and roll in degrees, and places in millimetres."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-30.0, 30.0, (frames, 3)), rng.normal((0.0, 0.0, 700.0), 40.0, (frames, 3))


def test_the_set_is_five_people_with_nine_sequences_each():
    assert len(NAMES) == 45
    assert NAMES[0] == "jam1"
    assert NAMES[-1] == "vam9"


def test_readings_become_angles_and_places_in_the_cameras_frame(folder):
    """X is to the picture's left there and to the right here; inches become millimetres, the first line is left out."""
    read = read_sequence(folder, "jam1")
    np.testing.assert_allclose(read.places_mm[0], [-0.5 * 25.4, 0.1 * 25.4, 21.0 * 25.4])
    np.testing.assert_allclose(read.angles_deg[0], [-2.0, -3.0, 1.0])
    assert len(read.angles_deg) == len(read.places_mm) == FRAMES
    assert read.video == folder / "jam1.avi"


def test_a_converted_copy_of_a_video_serves(folder, film):
    (folder / "jam1.avi").unlink()
    with VideoWriter(folder / "jam1.mp4", 30.0) as writer:
        for frame in open_frames(film).iterate():
            writer.write(frame.picture)
    assert read_sequence(folder, "jam1").video == folder / "jam1.mp4"


def test_what_is_written_in_the_layout_is_read_again(folder):
    angles, places = nodding(frames=FRAMES)
    write_truth(folder / "jam1.dat", angles, places)
    read = read_sequence(folder, "jam1")
    np.testing.assert_allclose(read.angles_deg, angles, atol=1e-5)
    np.testing.assert_allclose(read.places_mm, places, atol=1e-4)


def test_missing_sequences_are_told_and_the_others_read(folder):
    (folder / "vam9.dat").unlink()
    read, problems = read_set(folder)
    assert [one.name for one in read] == ["jam1"]
    assert len(problems) == 44
    assert problems[-1] == f"{folder / 'vam9.dat'} does not exist; check the name and the folder."


def test_the_part_of_uniform_light_is_found_in_the_whole_set(folder, tmp_path_factory):
    whole = tmp_path_factory.mktemp("set")
    folder.rename(whole / "uniform-light")
    assert [one.name for one in read_set(whole)[0]] == ["jam1", "vam9"]


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (LINES[:4], f"has 4 lines, expected {FRAMES + 1}, one before and one for each of the {FRAMES} frames"),
        ([*LINES, LINES[-1]], f"has {FRAMES + 2} lines, expected {FRAMES + 1}"),
        ([*LINES[:-1], "6 3.0 0."], f"has 3 numbers in line {FRAMES + 1}, expected 7; copy it from the set again."),
        ([LINES[0].replace("20", "twenty"), *LINES[1:]], "could not convert string to float: 'twenty'"),
        ([LINES[0], LINES[1].replace("21", "nan"), *LINES[2:]], "it holds numbers that no sensor reads"),
        (LINES[:1], "it has nothing after its first line"),
        (["\N{FACE WITH COLD SWEAT}"], "cannot be read as a sequence's readings"),
        ([], "is empty"),
    ],
    ids=["torn", "too long", "torn in a line", "words", "not finite", "one line", "no text", "empty"],
)
def test_damaged_readings_are_refused_in_one_sentence(folder, lines, words):
    (folder / "jam1.dat").write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_sequence(folder, "jam1")
    assert words in str(refused.value)
    assert str(refused.value).startswith(str(folder / "jam1.dat"))
    assert str(refused.value).endswith(".")


def test_a_torn_video_is_refused(folder, film):
    (folder / "jam1.avi").write_bytes(film.read_bytes()[:300])
    with pytest.raises(InputError, match=r"jam1\.avi"):
        read_sequence(folder, "jam1")


def test_a_video_of_another_size_is_refused(folder):
    video(folder / "jam1.avi", FRAMES, (160, 120))
    with pytest.raises(InputError, match="has 160 × 120 pixels, expected 320 × 240"):
        read_sequence(folder, "jam1")


def test_a_folder_without_the_set_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"has no sequence that can be read; of jam1: .*jam1\.dat does not exist"):
        read_set(tmp_path)
    with pytest.raises(InputError, match="is not a folder"):
        read_set(tmp_path / "nowhere")


def test_the_truth_has_no_error_however_the_transmitter_stands():
    """Calibrated by the first frame, neither a turn nor a shift between its axes and the camera's counts."""
    angles, places = nodding()
    turn = Rotation.from_rotvec([0.1, -0.3, 0.2])
    turned = turn * Rotation.from_rotvec(axis_angle_from_yaw_pitch_roll(angles))
    errors = pose_errors(sequence(angles, places), turned.as_rotvec(), places + np.array([10.0, -60.0, 30.0]))
    assert errors.angles_deg.max() < 1e-9
    assert errors.places_in.max() < 1e-9


def test_errors_are_those_of_each_angle_and_axis():
    angles, places = np.zeros((3, 3)), np.zeros((3, 3))
    wrong = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, -3.0, 0.0]])
    moved = np.array([[0.0, 0.0, 0.0], [25.4, 0.0, 0.0], [0.0, 0.0, -50.8]])
    errors = pose_errors(sequence(angles, places), axis_angle_from_yaw_pitch_roll(wrong), moved)
    np.testing.assert_allclose(errors.angles_deg, np.abs(wrong), atol=1e-12)
    np.testing.assert_allclose(errors.places_in, [[0, 0, 0], [1, 0, 0], [0, 0, 2]])
    mean = mean_errors([errors, errors])
    assert (mean.roll_deg, mean.pitch_deg, mean.yaw_deg) == pytest.approx((0.0, 1.0, 5.0 / 3.0))
    assert mean.average_deg == pytest.approx((1.0 + 5.0 / 3.0) / 3.0)
    assert mean.places_in == pytest.approx((1.0 / 3.0, 0.0, 2.0 / 3.0))
    assert (mean.frames, mean.missed) == (6, 0)


def test_frames_without_a_face_are_counted_and_left_out():
    """The first frame with a face is the one that calibrates."""
    angles, places = nodding()
    rotations = axis_angle_from_yaw_pitch_roll(angles)
    rotations[:2], rotations[7] = np.nan, np.nan
    errors = pose_errors(sequence(angles, places), rotations, places)
    assert (len(errors.angles_deg), errors.missed) == (37, 3)
    assert errors.angles_deg.max() < 1e-9


def test_without_any_face_there_is_no_mean():
    angles, places = nodding(frames=4)
    errors = pose_errors(sequence(angles, places), np.full((4, 3), np.nan), places)
    assert errors.missed == 4
    with pytest.raises(InputError, match="4 frames were missed"):
        mean_errors([errors])


def test_poses_of_another_number_of_frames_are_refused():
    angles, places = nodding(frames=4)
    with pytest.raises(InputError, match="jam1 has 4 frames, got rotations"):
        pose_errors(sequence(angles, places), np.zeros((3, 3)), np.zeros((3, 3)))


def test_the_printed_rows_are_those_of_table_1():
    """The average is that of the three angles, to the digits that each row has."""
    assert PRINTED_DEG["FACE IT!"] == (2.35, 3.62, 4.38, 3.45)
    for *angles, average in PRINTED_DEG.values():
        assert np.mean(angles) == pytest.approx(average, abs=0.011)


def test_the_camera_looks_at_the_middle_of_the_picture():
    camera = boston_camera()
    assert tuple(camera.principal_point_px) == (160.0, 120.0)
    assert tuple(camera.focal_px) == (500.0, 500.0)


def test_the_angles_that_are_compared_are_the_workbenchs():
    """A head that turns by yaw alone errs in yaw alone if it is not followed."""
    angles = np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    errors = pose_errors(sequence(angles, np.zeros((2, 3))), np.zeros((2, 3)), np.zeros((2, 3)))
    np.testing.assert_allclose(errors.angles_deg[1], [20.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(yaw_pitch_roll_deg(axis_angle_from_yaw_pitch_roll(angles)), angles, atol=1e-12)
