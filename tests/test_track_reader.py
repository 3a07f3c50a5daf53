"""A stored track is read frame by frame, as it is read at once."""

import json
import os
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from tests.performances import performance
from workbench.errors import InputError
from workbench.tracking import Track
from workbench.tracking import track_reader as track_reader_module
from workbench.tracking.records import ARRAYS, FAILURES, stack_fits
from workbench.tracking.track_reader import TrackReader


@pytest.fixture
def stored(head, tmp_path):
    performance(head).save(tmp_path / "track.npz")
    return tmp_path / "track.npz"


@pytest.mark.parametrize("block", [1, 4, 256])
def test_frames_are_those_of_the_whole_track(stored, monkeypatch, block):
    monkeypatch.setattr(track_reader_module, "BLOCK_FRAMES", block)
    whole, reader = Track.load(stored), TrackReader(stored)
    assert len(reader) == len(whole)
    assert reader.meta == whole.meta
    for _ in range(2):
        read = stack_fits(list(reader))
        for name in ARRAYS:
            assert np.array_equal(read[name], getattr(whole, name), equal_nan=read[name].dtype.kind == "f"), name


def test_tracks_of_older_versions_are_read(stored, tmp_path):
    with np.load(stored, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files if name not in ("jaw", "scale", "failure")}
    meta = json.loads(arrays["meta"].item()) | {"format_version": 1}
    arrays["meta"] = np.array(json.dumps(meta))
    np.savez_compressed(tmp_path / "old.npz", **arrays)
    old = [*TrackReader(tmp_path / "old.npz")]
    assert all(fit.scale == 1.0 and not fit.jaw.any() and fit.failure == "" for fit in old)


def test_what_is_no_track_is_refused(stored, tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        TrackReader(tmp_path / "none.npz")
    (tmp_path / "broken.npz").write_bytes(stored.read_bytes()[:2000])
    with pytest.raises(InputError, match="damaged or not a workbench track"):
        TrackReader(tmp_path / "broken.npz")
    np.savez(tmp_path / "other.npz", meta=np.array('{"format": "other"}'), index=np.arange(3))
    with pytest.raises(InputError, match="not a workbench track"):
        TrackReader(tmp_path / "other.npz")
    newer = json.dumps({"format": "face-energy-workbench-track", "format_version": 99})
    np.savez(tmp_path / "newer.npz", meta=np.array(newer), index=np.arange(3))
    with pytest.raises(InputError, match="newer workbench"):
        TrackReader(tmp_path / "newer.npz")


READERS = {"at once": Track.load, "frame by frame": lambda path: list(TrackReader(path))}
both_readers = pytest.mark.parametrize("read", READERS.values(), ids=READERS)


def save(path, arrays, meta):
    np.savez_compressed(path, **{**arrays, "meta": np.array(json.dumps(meta))})
    return path


@pytest.fixture
def contents(stored):
    """Arrays and metadata of a stored track, to be changed."""
    with np.load(stored, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files if name != "meta"}
        return arrays, json.loads(archive["meta"].item())


def changed(array, place, number):
    array = array.copy()
    array[place] = number
    return array


@both_readers
@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: {"found": a["found"][:-1]}, r"found has the shape \(11,\), expected \(12,\)"),
        (lambda a: {"rotation": a["rotation"].T.copy()}, "rotation has the shape"),
        (lambda a: {"expression": a["expression"][:, :-1]}, "expression has the shape"),
        (lambda a: {"status": np.repeat(a["status"], 2, axis=1)}, "status has the shape"),
        (lambda a: {"index": a["index"][0]}, ""),
        (lambda a: {"index": a["index"][::-1]}, "not in ascending order"),
        (lambda a: {"index": a["index"] - 1}, "not in ascending order"),
        (lambda a: {"index": a["index"].astype(float)}, "index holds float64"),
        (lambda a: {"found": a["found"].astype(int)}, "found holds int64"),
        (lambda a: {"shot": a["shot"].astype("U")}, "shot holds <U"),
        (lambda a: {"source": changed(a["source"], 3, 127)}, "source goes beyond the 5"),
        (lambda a: {"failure": changed(a["failure"], 3, -1)}, "failure goes beyond the 4"),
        (lambda a: {"image_size": changed(a["image_size"], 3, 0)}, "a picture has no pixels"),
        (lambda a: {"rotation": changed(a["rotation"], 3, np.nan)}, "rotation of a frame with a face is not finite"),
        (lambda a: {"projected": changed(a["projected"], (3, 7), np.inf)}, "projected of a frame with a face"),
        (lambda a: {"focal_px": changed(a["focal_px"], 3, -1.0)}, "focal length or scale is not positive"),
        (lambda a: {name: array[:0] for name, array in a.items()}, "contains no frames"),
        (lambda a: {"jaw": np.array([{}], object)}, "Python objects"),
    ],
)
def test_arrays_that_are_none_of_a_track_are_refused(contents, tmp_path, read, change, message):
    arrays, meta = contents
    with pytest.raises(
        InputError, match=rf"bad\.npz cannot be read as a track, .*\(.*({message}).*\); run the tracking"
    ):
        read(save(tmp_path / "bad.npz", arrays | change(arrays), meta))


@both_readers
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format_version": "9"}, "written by a newer workbench"),
        ({"expression_names": None}, "expression_names"),
        ({"expression_names": [1, 2]}, r"expression_names\.0"),
        ({"expression_names": ["jawOpen"]}, "expression has the shape"),
        ({"rate": "fast"}, "rate: .*'fast'"),
        ({"rate": float("nan")}, "rate: "),
        ({"inputs": [3]}, r"inputs\.0"),
        ({"inputs": [{"path": 3}]}, r"inputs\.0\.path"),
        ({"landmarks": "points.csv"}, "landmarks: "),
        ({"model": ["head"]}, "model: "),
        ({"model": {"jaw_unit": {"open_deg": 26.5, "sideways_mm": 8.0}}}, r"model\.jaw_unit\.forward_mm"),
        ({"model": {"jaw_unit": {"open_deg": 0.0, "sideways_mm": 8.0, "forward_mm": 8.0}}}, r"jaw_unit\.open_deg"),
        ({"frames": [1]}, "frames: "),
        ({"config": 1}, "config: "),
        ({"x": 10**30}, "more than 20 digits"),
    ],
)
def test_metadata_that_later_steps_could_not_use_are_refused(contents, tmp_path, read, change, message):
    arrays, meta = contents
    with pytest.raises(InputError, match=message) as refusal:
        read(save(tmp_path / "bad.npz", arrays, meta | change))
    assert "\n" not in str(refusal.value)


@both_readers
@pytest.mark.parametrize("text", ["3", "[]", '{"a":' * 100_000, "{", '"text"'])
def test_metadata_that_are_no_table_are_refused(contents, tmp_path, read, text):
    arrays, _ = contents
    np.savez_compressed(tmp_path / "bad.npz", meta=np.array(text), **arrays)
    with pytest.raises(InputError, match="not a workbench track"):
        read(tmp_path / "bad.npz")


@both_readers
def test_a_changed_byte_of_any_array_is_one_sentence(stored, tmp_path, read):
    with zipfile.ZipFile(stored) as archive:
        places = [member.header_offset + 60 + member.compress_size // 2 for member in archive.infolist()]
    content, path = stored.read_bytes(), tmp_path / "bad.npz"
    for place in places:
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x55]) + content[place + 1 :])
        with pytest.raises(InputError, match="is damaged or not a workbench track"):
            read(path)


def test_damage_behind_the_first_frames_is_said_when_it_is_reached(contents, tmp_path, monkeypatch):
    monkeypatch.setattr(track_reader_module, "BLOCK_FRAMES", 4)
    arrays, meta = contents
    arrays["rotation"] = changed(arrays["rotation"], 9, np.nan)
    frames = iter(TrackReader(save(tmp_path / "bad.npz", arrays, meta)))
    assert [next(frames).index for _ in range(8)] == list(range(8))
    with pytest.raises(InputError, match="rotation of a frame with a face is not finite"):
        next(frames)


def test_what_the_user_of_the_frames_raises_is_no_damage(stored):
    with pytest.raises(ZeroDivisionError):
        [fit.index / 0 for fit in TrackReader(stored)]


def test_a_fit_that_is_marked_as_not_finite_is_read(contents, tmp_path):
    arrays, meta = contents
    arrays["rotation"] = changed(arrays["rotation"], 3, np.nan)
    arrays["failure"] = changed(arrays["failure"], 3, FAILURES.index("not finite"))
    path = save(tmp_path / "track.npz", arrays, meta)
    assert Track.load(path)[3].failure == [*TrackReader(path)][3].failure == "not finite"


def test_arrays_in_columns_are_stored_in_rows(stored, tmp_path):
    whole = Track.load(stored)
    replace(whole, expression=np.asfortranarray(whole.expression)).save(tmp_path / "track.npz")
    read = np.stack([fit.expression for fit in TrackReader(tmp_path / "track.npz")])
    np.testing.assert_array_equal(read, whole.expression)


@both_readers
def test_a_pipe_is_no_track(tmp_path, read):
    os.mkfifo(tmp_path / "track.npz")
    with pytest.raises(InputError, match="pipe or device"):
        read(tmp_path / "track.npz")
