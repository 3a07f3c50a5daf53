"""Curves for spreadsheets, pandas and Live Link Face: names, sides, units, times, gaps."""

import csv
import sys
from dataclasses import replace

import numpy as np
import pandas
import pytest
from scipy.spatial.transform import Rotation

from tests.performances import FRAMES, GAP, performance, with_jaw
from workbench.errors import InputError, MissingDependencyError
from workbench.export import export_track
from workbench.export.live_link import HEADER, LIVE_LINK_SHAPES, head_angles, timecode, write_live_link_csv
from workbench.export.tables import curve_columns, write_curves, write_parquet
from workbench.face import USUAL_JAW, load_default_head

APP_HEADER = (
    "Timecode,BlendShapeCount,EyeBlinkLeft,EyeLookDownLeft,EyeLookInLeft,EyeLookOutLeft,EyeLookUpLeft,EyeSquintLeft,"
    "EyeWideLeft,EyeBlinkRight,EyeLookDownRight,EyeLookInRight,EyeLookOutRight,EyeLookUpRight,EyeSquintRight,"
    "EyeWideRight,JawForward,JawRight,JawLeft,JawOpen,MouthClose,MouthFunnel,MouthPucker,MouthRight,MouthLeft,"
    "MouthSmileLeft,MouthSmileRight,MouthFrownLeft,MouthFrownRight,MouthDimpleLeft,MouthDimpleRight,MouthStretchLeft,"
    "MouthStretchRight,MouthRollLower,MouthRollUpper,MouthShrugLower,MouthShrugUpper,MouthPressLeft,MouthPressRight,"
    "MouthLowerDownLeft,MouthLowerDownRight,MouthUpperUpLeft,MouthUpperUpRight,BrowDownLeft,BrowDownRight,BrowInnerUp,"
    "BrowOuterUpLeft,BrowOuterUpRight,CheekPuff,CheekSquintLeft,CheekSquintRight,NoseSneerLeft,NoseSneerRight,"
    "TongueOut,HeadYaw,HeadPitch,HeadRoll,LeftEyeYaw,LeftEyePitch,LeftEyeRoll,RightEyeYaw,RightEyePitch,RightEyeRoll"
)


@pytest.fixture(scope="module")
def track(head):
    return performance(head)


@pytest.fixture(scope="module")
def live_link(track, tmp_path_factory):
    path = tmp_path_factory.mktemp("tables") / "face.arkit.csv"
    write_live_link_csv(track, path, 25.0)
    return path


def turned(head, yaw=0.0, pitch=0.0, roll=0.0):
    """A track of one frame with this head pose, in our angles."""
    track = performance(head, frames=1, gap=None)
    rotation = Rotation.from_euler("XYZ", [-pitch, yaw, roll], degrees=True).as_rotvec()
    return replace(track, rotation=rotation[None])


# --- Live Link Face ---


def test_the_header_is_the_apps(live_link):
    assert live_link.read_text().splitlines()[0] == APP_HEADER
    assert len(HEADER) == 2 + 61


def test_the_app_knows_all_of_arkits_blendshapes():
    assert sorted(LIVE_LINK_SHAPES) == sorted(load_default_head(gaze=True).expression_names)


def test_pandas_reads_the_weights_back_left_on_the_left(live_link, track):
    table = pandas.read_csv(live_link)
    assert len(table) == FRAMES
    for name in track.expression_names:
        column = table[name[0].upper() + name[1:]].to_numpy()
        np.testing.assert_allclose(column, track.expression[:, track.expression_names.index(name)], atol=1e-8)
    assert table["MouthSmileLeft"].iloc[-1] == 1.0
    assert table["MouthSmileRight"].iloc[-1] == 0.0
    assert (table[["EyeLookInLeft", "LeftEyeYaw"]].dropna() == 0.0).all(axis=None)


def test_the_eyes_turn_as_their_weights_say(track, tmp_path):
    """To the subject's left is positive, as of the head; 21 degrees at most, by the default head."""
    names = [*track.expression_names, "eyeLookOutLeft", "eyeLookInRight", "eyeLookDownRight"]
    looks = np.tile([1.0, 0.5, 1.0], (FRAMES, 1))
    looking = replace(
        track, expression=np.hstack([track.expression, looks]), meta={**track.meta, "expression_names": names}
    )
    write_live_link_csv(looking, tmp_path / "looks.csv")
    row = pandas.read_csv(tmp_path / "looks.csv").iloc[0]
    assert np.degrees(row["LeftEyeYaw"]) == pytest.approx(21.2, abs=0.2)
    assert np.degrees(row["RightEyeYaw"]) == pytest.approx(10.6, abs=0.2)
    assert np.degrees(row["RightEyePitch"]) == pytest.approx(-16.7, abs=0.2)
    assert row["LeftEyeRoll"] == row["RightEyeRoll"] == 0.0
    assert row["EyeLookOutLeft"] == 1.0


def test_a_frame_without_a_face_keeps_its_row_and_counts_no_values(live_link):
    rows = list(csv.reader(live_link.read_text().splitlines()))
    assert all(len(row) == len(HEADER) for row in rows)
    assert rows[1 + GAP][1:] == ["0"] + [""] * 61
    assert {row[1] for k, row in enumerate(rows[1:]) if k != GAP} == {"61"}


def test_a_failed_fit_counts_as_no_face_for_the_app(track, tmp_path):
    write_live_link_csv(replace(track, failure=np.where(track.index == 2, 1, 0)), tmp_path / "x.csv")
    assert pandas.read_csv(tmp_path / "x.csv")["BlendShapeCount"].tolist().count(0) == 2


@pytest.mark.parametrize(
    ("angles", "column", "sign"),
    [
        ({"yaw": -20.0}, 0, +1),  # to the subject's own left
        ({"pitch": 20.0}, 1, +1),  # up
        ({"roll": -20.0}, 2, +1),  # the subject's left ear rises
    ],
)
def test_head_angles_are_radians_with_the_apps_signs(angles, column, sign, head):
    found = head_angles(turned(head, **angles))[0]
    expected = np.zeros(3)
    expected[column] = sign * np.radians(20.0)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_head_angles_turn_a_head_by_yaw_then_pitch_then_roll(head):
    track = turned(head, 25.0, -15.0, 10.0)
    yaw, pitch, roll = head_angles(track)[0]
    rebuilt = Rotation.from_euler("YXZ", [yaw, -pitch, roll])  # +x right, +y up, +z out of the face
    flip = np.array([1.0, -1.0, -1.0])
    ours = Rotation.from_rotvec(track.rotation[0]).apply(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(rebuilt.apply(np.array([1.0, 2.0, 3.0]) * flip), ours * flip, atol=1e-9)


@pytest.mark.parametrize(
    ("index", "rate", "code"),
    [
        (0, 25.0, "00:00:00:00.000"),
        (24, 25.0, "00:00:00:24.000"),
        (25, 25.0, "00:00:01:00.000"),
        (60 * 60 * 60 + 61, 60.0, "01:00:01:01.000"),
        (1, 30000 / 1001, "00:00:00:01.001"),
        (30, 30000 / 1001, "00:00:01:00.030"),
        (3, 2.5, "00:00:01:00.400"),
    ],
)
def test_timecodes_count_frames_and_keep_real_time(index, rate, code):
    assert timecode(index, rate) == code


def test_a_track_without_arkits_blendshapes_is_refused(track, tmp_path):
    strange = replace(track, meta={**track.meta, "expression_names": [f"s{k}" for k in range(44)]})
    with pytest.raises(InputError, match="knows ARKit's blendshapes only"):
        write_live_link_csv(strange, tmp_path / "x.csv")
    assert not list(tmp_path.iterdir())


def test_a_track_without_blendshapes_is_refused(track, tmp_path):
    none = replace(track, expression=track.expression[:, :0], meta={**track.meta, "expression_names": []})
    with pytest.raises(InputError, match="the track has none"):
        write_live_link_csv(none, tmp_path / "x.arkit.csv")


@pytest.mark.parametrize("kind", [".csv", ".arkit.csv", ".parquet", ".npz"])
def test_times_that_are_made_up_are_told_in_every_format(kind, track, head, tmp_path):
    still = replace(track, meta={**track.meta, "rate": None})
    (note,) = export_track(still, head, tmp_path / f"x{kind}").notes
    assert "25 per second" in note
    assert export_track(still, head, tmp_path / f"y{kind}", rate=30.0).notes == ()


def test_the_motion_of_a_jaw_joint_is_in_the_jaws_blendshapes(track, tmp_path):
    write_live_link_csv(with_jaw(track), tmp_path / "jaw.csv")
    last = pandas.read_csv(tmp_path / "jaw.csv").iloc[-1]
    assert last["JawOpen"] == pytest.approx(0.6 + 24.0 / USUAL_JAW.open_deg)
    assert last["JawForward"] == pytest.approx(2.0 / USUAL_JAW.forward_mm)
    assert last["JawLeft"] == pytest.approx(4.0 * np.cos(5.0) / USUAL_JAW.sideways_mm)
    assert last["JawRight"] == 0.0


# --- all curves ---


def test_pandas_reads_every_curve_back(track, tmp_path):
    write_curves(track, tmp_path / "face.csv", 25.0)
    table = pandas.read_csv(tmp_path / "face.csv")
    for name, values in curve_columns(track, 25.0).items():
        np.testing.assert_allclose(table[name].to_numpy(float), values.astype(float), rtol=1e-8, atol=1e-12)
    assert np.isnan(table["jawOpen"][GAP])
    assert table["found"].tolist() == [int(k != GAP) for k in range(FRAMES)]


def test_the_last_frame_is_turned_by_30_degrees_and_that_many_radians(track, tmp_path):
    write_curves(track, tmp_path / "face.csv", 25.0)
    last = pandas.read_csv(tmp_path / "face.csv").iloc[-1]
    assert last["yaw_deg"] == pytest.approx(-30.0)
    matrix = Rotation.from_rotvec([last["rx"], last["ry"], last["rz"]]).as_matrix()
    expected = Rotation.from_euler("XYZ", np.radians([-20.0, -30.0, 10.0])).as_matrix()
    np.testing.assert_allclose(matrix, expected, atol=1e-8)
    assert last["time_s"] == pytest.approx((FRAMES - 1) / 25.0)
    assert last["tz"] == pytest.approx(650.0)


def test_a_jaw_joint_a_scale_and_failures_have_columns_where_there_are_any(track):
    moved = replace(with_jaw(track), failure=np.where(track.index == 3, 2, 0))
    columns = curve_columns(moved, 25.0)
    np.testing.assert_array_equal(columns["jaw_rx"], moved.jaw[:, 0])
    np.testing.assert_array_equal(columns["jaw_tz"], moved.jaw[:, 5])
    np.testing.assert_array_equal(columns["scale"], moved.scale)
    assert columns["failure"][3] == 2
    assert not {"jaw_rx", "scale", "failure"} & set(curve_columns(track, 25.0))


def test_parquet_holds_the_same_columns_and_the_units(track, tmp_path):
    from pyarrow import parquet

    write_parquet(track, tmp_path / "face.parquet", 25.0)
    table = pandas.read_parquet(tmp_path / "face.parquet")
    columns = curve_columns(track, 25.0)
    assert list(table) == list(columns)
    np.testing.assert_array_equal(table["mouthSmileLeft"].to_numpy(), columns["mouthSmileLeft"])
    assert parquet.read_schema(tmp_path / "face.parquet").metadata[b"rx, ry, rz"] == b"radians"


def test_parquet_without_its_package_says_what_to_install(track, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "face-energy-workbench\[parquet\]"'):
        write_parquet(track, tmp_path / "face.parquet", 25.0)
