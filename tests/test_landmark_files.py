"""Landmark files: what is written is read back; what is wrong is named with its line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workbench.errors import InputError
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, read_landmark_file, write_landmark_file
from workbench.landmarks.formats.own_csv import csv_columns
from workbench.landmarks.observations import Landmarks2D


def record(frame: int, seed: int = 0, name: str = "") -> LandmarkRecord:
    rng = np.random.default_rng(seed)
    points, confidence = rng.uniform(-20, 700, (68, 2)).round(3), rng.uniform(size=68).round(4)
    return LandmarkRecord(frame, name or f"clip#{frame}", Landmarks2D(points, confidence, (640, 360)), (640, 360))


def same(first: LandmarkRecord, second: LandmarkRecord) -> None:
    assert (first.frame, first.image_size) == (second.frame, second.image_size)
    np.testing.assert_allclose(first.landmarks.points, second.landmarks.points, atol=1e-9)
    np.testing.assert_allclose(first.landmarks.confidence, second.landmarks.confidence, atol=1e-9)


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_frames_with_and_without_a_face_are_read_back(tmp_path, suffix):
    path = tmp_path / f"clip{suffix}"
    records = [record(0), LandmarkRecord(1, "clip#1", None, (640, 360)), record(7, seed=1)]
    write_landmark_file(path, records)
    again = list(read_landmark_file(path))
    same(again[0], records[0])
    same(again[2], records[2])
    assert again[1] == records[1]
    assert again[2].name == "clip#7"


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_points_that_all_coincide_mean_that_there_is_no_face(tmp_path, suffix):
    """Some programs write zeros where they find none."""
    path, nothing = tmp_path / f"clip{suffix}", Landmarks2D(np.zeros((68, 2)), np.zeros(68), (640, 360))
    write_landmark_file(path, [record(0), LandmarkRecord(1, "clip#1", nothing, (640, 360)), record(2)])
    again = list(read_landmark_file(path))
    assert [one.landmarks is None for one in again] == [False, True, False]
    assert again[1].size == (640, 360)


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_points_without_any_confidence_mean_that_there_is_no_face(tmp_path, suffix):
    path, seen = tmp_path / f"clip{suffix}", record(1)
    worthless = replace(seen, landmarks=replace(seen.landmarks, confidence=np.zeros(68)))
    write_landmark_file(path, [record(0), worthless, record(2)])
    assert [one.landmarks is None for one in read_landmark_file(path)] == [False, True, False]


@given(st.integers(0, 2**31))
def test_csv_keeps_three_decimals_of_any_point(tmp_path_factory, seed):
    path = tmp_path_factory.mktemp("landmarks") / "clip.csv"
    write_landmark_file(path, [record(3, seed=seed)])
    (again,) = read_landmark_file(path)
    same(again, record(3, seed=seed))


def test_pts_counts_pixels_from_one(tmp_path):
    points = np.zeros((68, 2))
    points[1] = (10.5, 20.25)
    landmarks = Landmarks2D(points, np.ones(68), (30, 40))
    write_landmark_file(tmp_path / "face.pts", [LandmarkRecord(0, "face", landmarks, (30, 40))])
    lines = (tmp_path / "face.pts").read_text().splitlines()
    assert lines[:5] == ["version: 1", "n_points: 68", "{", "1.000 1.000", "11.500 21.250"]
    assert lines[-1] == "}"
    (again,) = read_landmark_file(tmp_path / "face.pts", image_size=(30, 40))
    np.testing.assert_allclose(again.landmarks.points, points)
    assert again.landmarks.image_size == again.image_size == (30, 40)


def test_pts_without_its_picture_has_no_image_size_but_room_for_all_points(tmp_path):
    write_landmark_file(tmp_path / "face.pts", [record(0)])
    (again,) = read_landmark_file(tmp_path / "face.pts")
    assert again.image_size is None
    assert (again.landmarks.points.max(axis=0) <= again.landmarks.image_size).all()


def test_csv_without_confidence_columns_is_certain(tmp_path):
    with LandmarkCsvWriter(tmp_path / "clip.csv", confidence=False) as writer:
        writer.write(record(0))
    (again,) = read_landmark_file(tmp_path / "clip.csv")
    np.testing.assert_array_equal(again.landmarks.confidence, np.ones(68))


def test_csv_is_read_row_by_row(tmp_path):
    write_landmark_file(tmp_path / "clip.csv", [record(0)])
    with open(tmp_path / "clip.csv", "a") as file:
        file.write("this row is broken\n")
    rows = read_landmark_file(tmp_path / "clip.csv")
    assert next(rows).frame == 0
    with pytest.raises(InputError, match="line 3"):
        next(rows)


def test_csv_writer_leaves_nothing_after_an_error_and_wants_ascending_frames(tmp_path):
    def write_backwards() -> None:
        with LandmarkCsvWriter(tmp_path / "clip.csv") as writer:
            writer.write(record(5))
            writer.write(record(4))

    with pytest.raises(InputError, match="ascending order, got 4 after 5"):
        write_backwards()
    assert list(tmp_path.iterdir()) == []


HEADER = ",".join(csv_columns())
CELLS = ["1.0"] * 136


def row(frame: object = 0, cells: list[str] = CELLS) -> str:
    return ",".join([str(frame), "640", "360", *cells])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "line 1.*the file is empty"),
        ("a,b,c\n", "line 1.*'a,b,c' and 139 columns are missing"),
        (HEADER.replace(",y67", "") + "\n", "line 1.*missing: y67"),
        (HEADER + ",extra\n", "line 1.*another order, or some are unknown"),
        (f"{HEADER}\n{row()}\n{row(1, CELLS[:-2])}\n", "line 3: expected 139 cells.*got 137"),
        (f"{HEADER}\n{row(0, ['nan', *CELLS[1:]])}\n", "line 2: landmark 0 is .*finite"),
        (f"{HEADER}\n{row(0, ['left', *CELLS[1:]])}\n", "line 2: x0 is 'left', expected a number"),
        (f"{HEADER}\n{row(0, ['', *CELLS[1:]])}\n", "line 2: x0 is empty"),
        (f"{HEADER}\n{row('first')}\n", "line 2: frame, width and height must be whole numbers"),
        (f"{HEADER}\n{row(-1)}\n", "line 2: frame counts from 0"),
        (f"{HEADER}\n{row(3)}\n{row(3)}\n", "line 3: frame indices must ascend, got 3 after 3"),
        (f"{HEADER}\n{row('9' * 30)}\n", "line 2: frame, width and height are not those of a picture"),
        (f"{HEADER}\n{row(0, ['x' * 5000, *CELLS[1:]])}\n", "line 2: x0 is 'x+ …, expected a number"),
        (f"{HEADER}\n{row(0, ['x' * 140_000, *CELLS[1:]])}\n", r"cannot be read as landmarks \(field larger"),
    ],
)
def test_a_wrong_csv_is_refused_with_its_line(tmp_path, content, message):
    (tmp_path / "bad.csv").write_text(content)
    with pytest.raises(InputError, match=message):
        list(read_landmark_file(tmp_path / "bad.csv"))


def entry(**changes: object) -> dict[str, object]:
    return {"frame": 0, "width": 9, "height": 9, "points": [[1, 2]] * 68, **changes}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "line 1: this is not JSON"),
        ("[]", 'no list named "frames"'),
        (json.dumps({"frames": [entry(), entry(points=[[1, 2]] * 67)]}), "entry 1 of frames: .*got 67"),
        (json.dumps({"frames": [entry(points=[["a", 2]] * 68)]}), "entry 0 of frames: .*pairs of numbers"),
        (json.dumps({"frames": [entry(points=[[float("nan"), 2]] * 68)]}), "landmark 0 is"),
        (json.dumps({"frames": [{"frame": 0, "width": 9, "height": 9}]}), "points is missing"),
        (json.dumps({"frames": [3]}), "expected an object"),
        (json.dumps({"frames": [entry(width="wide")]}), "whole numbers"),
        (json.dumps({"frames": ["x" * 5000]}), "expected an object .* got 'x+ …"),
        ('{"a":' * 100_000, "nested more than 100 deep"),
        ('{"frames": [' + "9" * 5000 + "]}", "more than 20 digits"),
        (json.dumps({"frames": [entry(points=[[1e300, 2]] * 68)]}), "entry 0 of frames: landmark 0 lies at .* outside"),
    ],
)
def test_a_wrong_json_is_refused_with_its_entry(tmp_path, content, message):
    (tmp_path / "bad.json").write_text(content)
    with pytest.raises(InputError, match=message):
        list(read_landmark_file(tmp_path / "bad.json"))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("hello\n", "line 1: expected an iBUG file"),
        ("version: 1\nn_points: 68\n{\n1 2\n", "line 4: the closing brace is missing"),
        ("version: 1\nn_points: 68\n{\n1 2\n1 two\n}\n", "line 5: expected x and y, got '1 two'"),
        ("version: 1\nn_points: 67\n{\n" + "1 2\n" * 67 + "}\n", "68 points, got 67"),
    ],
)
def test_a_wrong_pts_is_refused_with_its_line(tmp_path, content, message):
    (tmp_path / "bad.pts").write_text(content)
    with pytest.raises(InputError, match=message):
        list(read_landmark_file(tmp_path / "bad.pts"))


def test_other_files_and_missing_files_are_refused(tmp_path):
    (tmp_path / "points.txt").write_text("points")
    with pytest.raises(InputError, match=r"landmark files are \.csv, \.json, \.npy, \.pts or \.xml, got points\.txt"):
        read_landmark_file(tmp_path / "points.txt")
    with pytest.raises(InputError, match=r"written as \.csv, \.json or \.pts, got points\.npy"):
        write_landmark_file(tmp_path / "points.npy", [record(0)])
    with pytest.raises(InputError, match="does not exist"):
        read_landmark_file(tmp_path / "none.csv")
    with pytest.raises(InputError, match="holds one face, got 2 frames"):
        write_landmark_file(tmp_path / "two.pts", [record(0), record(1)])


def test_a_frame_without_size_cannot_be_written_as_csv_or_json(tmp_path):
    for suffix in (".csv", ".json"):
        with pytest.raises(InputError, match="no image size"):
            write_landmark_file(tmp_path / f"a{suffix}", [LandmarkRecord(0, "a", None, None)])
