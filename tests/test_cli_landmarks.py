"""`workbench landmarks`: what it writes, what it tells, and that `workbench track` goes on from there."""

import errno
import hashlib
import os
import sys

import cv2
import numpy as np
import pytest

from tests.landmark_layouts import openface_csv
from tests.optional_parts import needs_dlib
from workbench.cli import screen
from workbench.config import preset
from workbench.frames import VideoWriter, open_frames, read_picture
from workbench.landmarks import dlib_detector
from workbench.landmarks.alignment import MEAN_SHAPE, frame_from_box, frame_from_points
from workbench.landmarks.detection import FaceDetection
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.network_detector import BUNDLED
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import outer_eye_distance
from workbench.pipeline import open_source
from workbench.samples import sample
from workbench.tracking import Track

CONFIDENCE = np.linspace(0.4, 1.0, 68)
"""Of the detector below: point 0 is unsure, point 67 certain."""


class BrightSquares:
    """A detector to which every bright square is a face (the real ones have tests of their own)."""

    def __init__(self, name: str):
        self.name = name

    def detect_faces(self, picture, effort="full"):
        bright = (picture.min(axis=2) > 128).astype(np.uint8)
        parts = cv2.connectedComponentsWithStats(bright)[2][1:]
        boxes = [(x - 0.5, y - 0.5, x + w - 0.5, y + h - 0.5) for x, y, w, h in parts[:, :4].astype(float)]
        return sorted((FaceDetection(box, 1.0) for box in boxes), key=lambda face: -face.area)

    def align(self, picture, box):
        return Landmarks2D(frame_from_box(box).to_image(MEAN_SHAPE), CONFIDENCE, picture.shape[1::-1])

    def refine(self, picture, points):
        return self.align(picture, frame_from_points(points).box())


@pytest.fixture
def detector(monkeypatch):
    """The bright squares stand in for every detector, under the name that "auto" would give."""
    asked = []

    def make(name, face_landmarker):
        asked.append(name)
        return BrightSquares("network" if name == "auto" else name)

    monkeypatch.setattr("workbench.pipeline.picture_source.make_detector", make)
    return asked


def face_picture(*squares: tuple[int, int, int], size: tuple[int, int] = (320, 240)) -> np.ndarray:
    """A dark picture with bright squares (left, top, side)."""
    picture = np.full((size[1], size[0], 3), 20, np.uint8)
    for left, top, side in squares:
        picture[top : top + side, left : left + side] = 200
    return picture


def expected_points(left: int, top: int, side: int) -> np.ndarray:
    box = (left - 0.5, top - 0.5, left + side - 0.5, top + side - 0.5)
    return frame_from_box(box).to_image(MEAN_SHAPE)


@pytest.fixture
def photos(tmp_path):
    """Three photos: a face, none, two of which the right one is larger."""
    folder = tmp_path / "photos"
    folder.mkdir()
    squares = {"anna": [(100, 60, 90)], "wall": [], "couple": [(20, 60, 60), (180, 60, 100)]}
    for place, (name, faces) in enumerate(squares.items()):
        cv2.imwrite(str(folder / f"{place}-{name}.png"), face_picture(*faces))
    return folder


@pytest.fixture
def film(tmp_path):
    """Six frames: a face that moves to the right, hidden in frame 2."""
    with VideoWriter(tmp_path / "film.mp4", rate=25) as writer:
        for index in range(6):
            writer.write(face_picture(*([] if index == 2 else [(80 + 4 * index, 60, 96)])))
    return tmp_path / "film.mp4"


# --- what it writes ---


@pytest.mark.usefixtures("detector", "photos")
def test_the_table_has_a_row_a_picture_with_a_confidence_for_every_point(run, tmp_path):
    code, _, err = run("landmarks", "photos")
    assert (code, err) == (0, "")
    anna, wall, couple = read_landmark_file(tmp_path / "landmarks.csv")
    np.testing.assert_allclose(anna.landmarks.points, expected_points(100, 60, 90), atol=6e-4)
    np.testing.assert_allclose(anna.landmarks.confidence, CONFIDENCE, atol=6e-5)
    assert anna.landmarks.image_size == (320, 240)
    assert wall.landmarks is None
    assert wall.image_size == (320, 240)
    np.testing.assert_allclose(couple.landmarks.points, expected_points(180, 60, 100), atol=6e-4)


@pytest.mark.usefixtures("detector", "photos")
def test_every_photo_gets_a_drawn_copy_beside_the_table_and_stays_as_it_is(run, tmp_path):
    before = (tmp_path / "photos" / "0-anna.png").read_bytes()
    run("landmarks", "photos", "--out", "results/found.csv")
    drawn = sorted(path.name for path in (tmp_path / "results" / "found").iterdir())
    assert drawn == ["0000-0-anna.jpg", "0001-1-wall.jpg", "0002-2-couple.jpg"]
    assert (tmp_path / "photos" / "0-anna.png").read_bytes() == before


@pytest.mark.usefixtures("detector", "photos")
def test_sure_points_are_drawn_yellow_and_guessed_ones_violet(run, tmp_path):
    run("landmarks", "photos/0-anna.png")
    drawn = read_picture(tmp_path / "landmarks" / "0000-0-anna.jpg").astype(int)
    points = np.rint(expected_points(100, 60, 90)).astype(int)
    red, green, blue = drawn[points[67, 1], points[67, 0]]
    assert min(red, green) > blue + 50
    red, green, blue = drawn[points[0, 1], points[0, 0]]
    assert blue > red


@pytest.mark.usefixtures("detector", "photos")
def test_without_pictures_there_is_the_table_alone(run, tmp_path):
    run("landmarks", "photos", "--no-pictures")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["landmarks.csv", "photos"]


@pytest.mark.usefixtures("detector", "film")
def test_of_a_video_every_frame_stands_alone_and_the_drawing_is_a_video(run, tmp_path):
    code, out, _ = run("landmarks", "film.mp4")
    assert code == 0
    records = list(read_landmark_file(tmp_path / "landmarks.csv"))
    assert [record.landmarks is not None for record in records] == [True, True, False, True, True, True]
    for index in (0, 1, 3, 4, 5):
        distance = np.abs(records[index].landmarks.points - expected_points(80 + 4 * index, 60, 96)).max()
        assert distance < 1.5  # the film's compression moves edges
    assert len(list(open_frames(tmp_path / "landmarks.mp4").iterate())) == 6
    assert "5 of 6 with a face" in out
    assert "film#2" in out


@pytest.mark.usefixtures("detector", "photos")
def test_face_chooses_the_face_at_a_point_instead_of_the_largest(run, tmp_path):
    run("landmarks", "photos/2-couple.png", "--face", "50,90", "--no-pictures")
    (record,) = read_landmark_file(tmp_path / "landmarks.csv")
    np.testing.assert_allclose(record.landmarks.points, expected_points(20, 60, 60), atol=6e-4)


@pytest.mark.usefixtures("detector", "film")
def test_a_film_that_the_command_does_not_name_is_replaced_only_on_demand(run, tmp_path):
    (tmp_path / "take.mp4").write_bytes(b"somebody's film")
    code, _, err = run("landmarks", "film.mp4", "--out", "take.csv")
    assert code == 2
    assert "take.mp4 exists already" in err
    assert "--overwrite" in err
    assert (tmp_path / "take.mp4").read_bytes() == b"somebody's film"
    assert not (tmp_path / "take.csv").exists()
    assert run("landmarks", "film.mp4", "--out", "take.csv", "--no-pictures")[0] == 0
    assert run("landmarks", "film.mp4", "--out", "take.csv", "--overwrite")[0] == 0
    assert len(list(open_frames(tmp_path / "take.mp4").iterate())) == 6


@pytest.mark.usefixtures("detector", "photos")
def test_a_table_without_a_name_and_drawn_pictures_are_replaced_only_on_demand(run, tmp_path):
    (tmp_path / "landmarks").mkdir()
    (tmp_path / "landmarks" / "note.txt").write_text("not drawn")
    assert run("landmarks", "photos/0-anna.png")[0] == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert "landmarks.csv exists already" in run("landmarks", "photos/2-couple.png", "--no-pictures")[2]
    assert "0000-0-anna.jpg exists already" in run("landmarks", "photos/0-anna.png", "--out", "landmarks.csv")[2]
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    assert run("landmarks", "photos/2-couple.png", "--out", "landmarks.csv", "--no-pictures")[0] == 0
    assert run("landmarks", "photos/0-anna.png", "--overwrite")[0] == 0


# --- what it tells ---


@pytest.mark.usefixtures("detector", "photos")
def test_it_tells_each_photos_confidence_and_which_had_no_face(run):
    out = run("landmarks", "photos", "--detector", "network")[1]
    assert "2 of 3 with a face" in out
    line = next(line for line in out.splitlines() if "0-anna.png" in line)
    unsure = int((CONFIDENCE < 0.5).sum())
    assert line.split()[2:] == [f"{np.median(CONFIDENCE):.2f}", str(unsure), "50", "px"]
    assert "no face" in next(line for line in out.splitlines() if line.split()[:2] == ["1", "1-wall.png"])
    assert ["no", "face", "1-wall.png"] in [line.split() for line in out.splitlines()]
    assert "network, median" in out


@pytest.mark.usefixtures("detector")
def test_many_photos_are_counted_and_not_listed_one_by_one(run, tmp_path):
    folder = tmp_path / "many"
    folder.mkdir()
    for index in range(45):
        squares = [(40, 40, 64)] if index % 2 else []
        cv2.imwrite(str(folder / f"p{index}.png"), face_picture(*squares, size=(160, 160)))
    out = run("landmarks", "many", "--no-pictures")[1]
    assert "22 of 45 with a face" in out
    assert "p0.png, p2.png" in out
    assert "p38.png and 3 more" in out
    assert "unsure points" not in out


@pytest.mark.usefixtures("photos")
def test_the_detector_is_auto_unless_one_is_named(run, detector):
    run("landmarks", "photos", "--no-pictures")
    run("landmarks", "photos", "--no-pictures", "--overwrite", "--detector", "dlib-hog")
    assert detector == ["auto", "dlib-hog"]


@pytest.mark.usefixtures("detector", "photos")
@pytest.mark.parametrize("command", ["landmarks", "track"])
@pytest.mark.parametrize("name", ["dlib", "dlib+network"])
def test_dlibs_licence_is_told_where_dlib_ran_and_only_there(run, command, name, monkeypatch):
    monkeypatch.setattr(dlib_detector, "_notice_given", False)
    options = ["--no-pictures", "--overwrite", *(["--stills"] if command == "track" else [])]
    assert "300-W" not in run(command, "photos", *options, "--detector", "network")[1]
    assert run(command, "photos", *options, "--detector", name)[1].count("300-W") == 1


@pytest.mark.usefixtures("detector", "photos")
def test_a_run_on_a_folder_has_the_folders_whole_name(run, tmp_path):
    (tmp_path / "photos").rename(tmp_path / "shoot.2024")
    assert run("track", "shoot.2024", "--stills", "--no-pictures", "--no-identity")[0] == 0
    assert (tmp_path / "out" / "shoot.2024" / "track.npz").is_file()


@pytest.mark.usefixtures("detector", "photos")
def test_the_command_that_it_names_next_tracks_from_the_table(run, tmp_path):
    out = run("landmarks", "photos")[1]
    command = next(line for line in out.splitlines() if line.strip().startswith("next")).split()[1:]
    assert command == ["workbench", "track", "photos", "--stills", "--landmarks", "landmarks.csv"]
    code, out, err = run(*command[1:], "--no-pictures", "--no-identity")
    assert (code, err) == (0, "")
    assert "from a file" in out
    stored, track = list(read_landmark_file("landmarks.csv")), Track.load(tmp_path / "out" / "photos" / "track.npz")
    assert list(track.found) == [True, False, True]
    for index in (0, 2):
        np.testing.assert_array_equal(track[index].observed, stored[index].landmarks.points)
        np.testing.assert_array_equal(track[index].confidence, stored[index].landmarks.confidence)


@pytest.mark.usefixtures("film")
def test_a_clip_is_tracked_from_another_programs_table_in_the_clips_size(run, tmp_path):
    face = expected_points(80, 60, 96).round(3)
    rows = [(f"{1 + frame}, 0, 0.0, 0.9, {int(frame != 2)}", face + frame * np.array([4, 0])) for frame in range(6)]
    (tmp_path / "openface.csv").write_text(openface_csv(rows))
    code, out, err = run("track", "film.mp4", "--landmarks", "openface.csv", "--no-pictures", "--no-identity")
    assert (code, err) == (0, "")
    assert "5 of 6 with a face" in out
    track = Track.load(tmp_path / "out" / "film" / "track.npz")
    assert list(track.found) == [True, True, False, True, True, True]
    assert track[5].image_size == (320, 240)
    np.testing.assert_allclose(track[5].observed, face + np.array([20, 0]), atol=1e-9)


@pytest.mark.usefixtures("detector", "photos")
def test_the_next_command_stays_on_one_line_of_a_narrow_terminal(run, monkeypatch):
    monkeypatch.setattr(screen, "console", screen.Console(width=50, highlight=False))
    command = "workbench track photos/0-anna.png photos/2-couple.png --stills --landmarks landmarks.csv"
    assert command in run("landmarks", "photos/0-anna.png", "photos/2-couple.png", "--no-pictures")[1]


@pytest.mark.usefixtures("detector", "film")
def test_the_next_command_of_a_video_or_a_single_photo_is_no_row_of_stills(run):
    assert "workbench track film.mp4 --landmarks landmarks.csv" in run("landmarks", "film.mp4", "--no-pictures")[1]


# --- what cannot be done ---


@pytest.mark.parametrize(("name", "to_copy"), [("points.npy", "points.npy"), ("my points.npy", "'my points.npy'")])
def test_another_programs_landmarks_without_their_pictures_are_refused(name, to_copy, run, tmp_path):
    np.save(tmp_path / name, expected_points(80, 60, 96))
    code, _, err = run("track", name, "--no-pictures")
    assert code == 2
    assert err == (
        f"error: {name} does not say how large its pictures are: name the clip or photo as well, as in "
        f"`workbench track CLIP --landmarks {to_copy}`\n"
    )


def test_another_programs_landmarks_of_photos_that_differ_in_size_are_refused(run, tmp_path):
    (tmp_path / "mixed").mkdir()
    for index, size in enumerate([(320, 240), (300, 240)]):
        cv2.imwrite(str(tmp_path / "mixed" / f"{index}.png"), face_picture(size=size))
    np.save(tmp_path / "points.npy", np.array([expected_points(80, 60, 96)] * 2))
    code, _, err = run("track", "mixed", "--stills", "--landmarks", "points.npy", "--no-pictures")
    assert code == 2
    assert "points.npy does not say how large its pictures are, and those of mixed differ in size" in err


def test_one_of_several_photos_has_its_own_size(tmp_path):
    (tmp_path / "mixed").mkdir()
    for index, size in enumerate([(320, 240), (300, 240)]):
        cv2.imwrite(str(tmp_path / "mixed" / f"{index}.png"), face_picture(size=size))
    np.save(tmp_path / "points.npy", np.array([expected_points(80, 60, 96)] * 2))
    source = open_source([tmp_path / "mixed"], preset("joint"), tmp_path / "points.npy", (1, 1))
    assert source.image_size == (300, 240)


@pytest.mark.usefixtures("detector", "photos")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere.jpg"], "nowhere.jpg does not exist"),
        (["empty"], "expected pictures"),
        (["photos", "photos/0-anna.png"], "several inputs must all be images"),
        (["photos", "--out", "landmarks.txt"], "written as .csv, got landmarks.txt"),
        (["points.csv"], "points.csv holds landmarks"),
        (["photos", "--detector", "magic"], "landmarks.detector"),
        (["photos", "--face-landmarker", "f.task"], "belongs to the detector mediapipe; add --detector"),
        (["photos", "--face", "left"], "X,Y"),
    ],
)
def test_mistakes_are_one_sentence_and_leave_nothing(arguments, message, run, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "points.csv").write_text("frame,width,height\n")
    before = sorted(tmp_path.iterdir())
    code, out, err = run("landmarks", *arguments)
    assert code == 2
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert message in err
    assert "Traceback" not in out + err
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.usefixtures("detector", "photos")
def test_a_damaged_photo_stops_the_run_and_is_named(run, tmp_path):
    (tmp_path / "photos" / "1-wall.png").write_bytes(b"no picture")
    code, _, err = run("landmarks", "photos", "--no-pictures")
    assert code == 2
    assert "1-wall.png does not contain a readable picture" in err
    assert not (tmp_path / "landmarks.csv").exists()


@pytest.mark.usefixtures("detector", "film")
def test_an_interruption_leaves_no_half_table(run, tmp_path, monkeypatch):
    def interrupt(self, picture, box):
        raise KeyboardInterrupt

    monkeypatch.setattr(BrightSquares, "align", interrupt)
    code, _, err = run("landmarks", "film.mp4")
    assert code == 130
    assert "landmarks.csv was not written" in err
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def no_table(path, target):
    """Stands for `Path.replace` where there is no room for a table."""
    if path.suffix == ".csv":
        raise OSError(errno.ENOSPC, "No space left on device")
    return os.replace(path, target)


def stop_at_the_last(detector, picture, box):
    """Stands for the alignment of a picture: Ctrl-C at the larger face of two."""
    if box[2] - box[0] > 95:
        raise KeyboardInterrupt
    return Landmarks2D(frame_from_box(box).to_image(MEAN_SHAPE), CONFIDENCE, picture.shape[1::-1])


@pytest.mark.usefixtures("detector", "photos", "film")
@pytest.mark.parametrize("theirs", [False, True])
@pytest.mark.parametrize(
    ("inputs", "place", "happens"),
    [
        ("photos", "pathlib.Path.replace", no_table),
        ("photos", "tests.test_cli_landmarks.BrightSquares.align", stop_at_the_last),
        ("film.mp4", "pathlib.Path.replace", no_table),
    ],
)
def test_what_a_call_drew_goes_with_the_table_that_it_could_not_write(
    run, tmp_path, monkeypatch, inputs, place, happens, theirs
):
    if theirs:
        (tmp_path / "l").mkdir()
        (tmp_path / "l" / "mine.txt").write_text("of the user")
    before = sorted(tmp_path.rglob("*"))
    with monkeypatch.context() as patch:
        patch.setattr(place, happens)
        assert run("landmarks", inputs, "--out", "l.csv")[0] in (2, 130)
    assert sorted(tmp_path.rglob("*")) == before
    assert run("landmarks", inputs, "--out", "l.csv")[0] == 0


@pytest.mark.usefixtures("detector", "photos", "film")
@pytest.mark.parametrize(
    ("inputs", "drawn", "place", "happens"),
    [
        ("photos", "l", "tests.test_cli_landmarks.BrightSquares.align", stop_at_the_last),
        ("film.mp4", "l.mp4", "pathlib.Path.replace", no_table),
    ],
)
def test_what_an_earlier_call_drew_stays_where_a_later_one_fails(
    run, tmp_path, monkeypatch, inputs, drawn, place, happens
):
    assert run("landmarks", inputs, "--out", "l.csv")[0] == 0
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.setattr(place, happens)
    assert run("landmarks", inputs, "--out", "l.csv", "--overwrite")[0] in (2, 130)
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / drawn).exists()


# --- with the real detectors ---

PORTRAIT_TOLERANCE = 0.08
"""Mean distance of the network's inner points from dlib's on the portrait, in distances of the outer eye corners."""


def only_row(path) -> np.ndarray:
    (record,) = read_landmark_file(path)
    return record.landmarks.points


@needs_dlib
def test_the_portraits_points_by_dlib_are_those_that_are_bundled(run, tmp_path):
    assert run("landmarks", str(sample("astronaut")), "--detector", "dlib")[0] == 0
    found, bundled = only_row(tmp_path / "landmarks.csv"), only_row(sample("astronaut-landmarks"))
    np.testing.assert_allclose(found, bundled, atol=0.5)


def test_the_portraits_points_are_by_the_network_unless_another_detector_is_named(run, tmp_path):
    code, out, err = run("landmarks", str(sample("astronaut")))
    assert (code, err) == (0, "")
    assert "1 of 1 with a face" in out
    assert "network, median" in out
    assert "300-W" not in out
    found, bundled = only_row(tmp_path / "landmarks.csv"), only_row(sample("astronaut-landmarks"))
    distances = np.linalg.norm(found - bundled, axis=1)[17:]
    assert distances.mean() < PORTRAIT_TOLERANCE * outer_eye_distance(bundled)


# --- `workbench info` ---


def test_info_tells_the_bundled_networks_and_the_detector_that_auto_means(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "dlib", None)
    out = run("info")[1]
    weights = sorted(BUNDLED.glob("*.safetensors"))
    assert weights
    for path in weights:
        line = next(line for line in out.splitlines() if f"network {path.stem}" in line)
        assert "parameters" in line
        assert f"SHA-256 {hashlib.sha256(path.read_bytes()).hexdigest()[:12]}" in line
    row = {line.split()[0]: line for line in out.splitlines() if " detector" in line}
    assert row["auto"].split()[-1] == "network"
    assert 'pip install "face-energy-workbench[dlib]"' in row["dlib"]


@needs_dlib
def test_info_tells_that_dlib_is_installed_with_its_model_files(run, monkeypatch):
    def told():
        return next(line for line in run("info")[1].splitlines() if "dlib detector" in line).split()[2]

    assert told() == "installed"
    monkeypatch.setattr(dlib_detector, "CNN_FILE", "of_another_version.dat")
    assert told() == "missing:"
