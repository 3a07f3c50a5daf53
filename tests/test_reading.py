"""The door of every reader: regular files only, declared sizes checked first, one sentence for the rest."""

import hashlib
import io
import json
import os
import zipfile
from codecs import BOM_UTF8
from pathlib import Path

import numpy as np
import pytest

from workbench.errors import InputError, ModelError
from workbench.frames import open_frames, read_picture, write_picture
from workbench.landmarks.files import read_landmark_file
from workbench.reading import checked_arrays, checked_file, checked_json, checked_toml, content_hash, reading


def archive(**arrays: np.ndarray) -> io.BytesIO:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    stream.seek(0)
    return stream


@pytest.mark.parametrize("cause", [KeyError("jaw"), RecursionError(), MemoryError(), OSError(5, "I/O error")])
def test_what_a_library_raises_becomes_one_sentence_of_the_asked_kind(cause):
    sentence = r"head\.npz cannot be read as a head \(.+\); bake it again\."
    with pytest.raises(ModelError, match=sentence), reading("head.npz", "a head", "bake it again", ModelError):
        raise cause


def test_the_projects_own_errors_pass_as_they_are():
    with (
        pytest.raises(InputError, match=r"^already clear$"),
        reading("points.json", "landmarks", "export them again"),
    ):
        raise InputError("already clear")


def test_an_interruption_is_no_damage():
    with pytest.raises(KeyboardInterrupt), reading("points.json", "landmarks", "export them again"):
        raise KeyboardInterrupt


def test_long_reasons_are_cut_to_a_line():
    with pytest.raises(InputError) as caught, reading("x", "y", "z"):
        raise ValueError("a" * 5000 + "\nsecond line")
    assert len(str(caught.value)) < 300
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("read", [read_picture, open_frames, read_landmark_file, content_hash])
def test_a_file_that_may_not_be_read_is_refused_in_one_sentence(read, tmp_path, monkeypatch):
    path = tmp_path / ("points.xml" if read is read_landmark_file else "photo.png")
    write_picture(tmp_path / "photo.png", np.zeros((8, 8, 3), np.uint8))
    (tmp_path / "points.xml").write_text("<dataset></dataset>")

    def refused(self, *_args, **_options):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(InputError, match=rf"{path.name} cannot be .*\(Permission denied\); check that you may"):
        list(read(path))


def test_what_file_managers_leave_in_a_folder_does_not_change_it(tmp_path):
    (tmp_path / "0.png").write_bytes(b"tracked")
    before = content_hash(tmp_path)
    for name in (".DS_Store", "Thumbs.db", "desktop.ini"):
        (tmp_path / name).write_bytes(b"left behind")
    assert content_hash(tmp_path) == before


def test_a_file_that_stays_as_it_is_is_read_once_for_its_hash(tmp_path, monkeypatch):
    (tmp_path / "photos").mkdir()
    clip, photo = tmp_path / "clip.mp4", tmp_path / "photos" / "0.png"
    for path in (clip, photo):
        path.write_bytes(b"tracked")
    read, digest = [], hashlib.file_digest
    monkeypatch.setattr(hashlib, "file_digest", lambda file, kind: read.append(Path(file.name)) or digest(file, kind))
    before = [content_hash(path) for path in (clip, photo.parent)]
    monkeypatch.chdir(tmp_path)
    assert [content_hash(Path(name)) for name in ("clip.mp4", "photos")] == before
    assert read == [clip, photo]
    (tmp_path / "other").write_bytes(b"another")
    os.utime("other", ns=(0, clip.stat().st_mtime_ns))
    os.replace("other", clip)
    photo.write_bytes(b"changed in place")
    assert not {content_hash(path) for path in (clip, photo.parent)} & set(before)


def test_a_pipe_is_refused_without_waiting(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe or device"):
        checked_file(tmp_path / "pipe", "a track")


@pytest.mark.parametrize(
    ("name", "said"), [("/dev/zero", "pipe or device"), ("a\0b", "cannot be opened"), ("n" * 5000, "cannot be opened")]
)
def test_devices_and_impossible_names_are_refused(name, said):
    with pytest.raises(InputError, match=said) as caught:
        checked_file(name, "a track")
    assert len(str(caught.value)) < 400


def test_missing_empty_and_folder_are_told_apart(tmp_path):
    (tmp_path / "empty").touch()
    for name, said in (("absent", "does not exist"), ("empty", "is empty"), (".", "is a folder")):
        with pytest.raises(InputError, match=said):
            checked_file(tmp_path / name, "a track")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 101 + "]" * 101, "nested"),
        ('{"a":' * 100_000, "nested"),
        ("9" * 21, "digits"),
        ("-" + "9" * 5000, "digits"),
    ],
)
def test_json_beyond_the_limits_is_refused(text, said):
    with pytest.raises(ValueError, match=said):
        checked_json(text)


def test_json_within_the_limits_is_read_as_ever():
    value = {"brackets in text": "[" * 500 + '"', "deep": [[[1, -2.5e-3, None, True]]], "id": 99999999999999999999}
    assert checked_json(json.dumps(value)) == value


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a = " + "[" * 101 + "]" * 101, "nested"),
        ("a." * 50_000 + "a = 1", "parts"),
        ("[" + "a." * 50_000 + "a]", "parts"),
        ("a = 1" + "0" * 5000, "digits"),
    ],
)
def test_toml_beyond_the_limits_is_refused(text, said):
    with pytest.raises(ValueError, match=said):
        checked_toml(text)


@pytest.mark.parametrize("text", ['"' + '\\"' * 200_000, "'" * 200_000, '"""' + '\\"' * 200_000 + "\\", "a" * 200_000])
@pytest.mark.parametrize("read", [checked_json, checked_toml])
def test_texts_that_never_end_are_refused_in_one_pass(read, text):
    with pytest.raises(ValueError):  # noqa: PT011 (the parsers' own words)
        read(text)


def test_toml_within_the_limits_is_read_as_ever():
    text = "a = \"[[[[\" # [[[[ \nb = [1, 2]\nf = 0.3000000000000000444089\n[c.d]\ne = '''[{\n'''\n"
    assert checked_toml(text) == {"a": "[[[[", "b": [1, 2], "f": 0.30000000000000004, "c": {"d": {"e": "[{\n"}}}


@pytest.mark.parametrize(("read", "text"), [(checked_json, '{"a": 1}'), (checked_toml, "a = 1")])
def test_the_byte_order_mark_of_windows_editors_is_no_text(read, text):
    assert read(BOM_UTF8 + text.encode()) == {"a": 1}


def test_arrays_are_read_after_their_sizes_were_checked():
    with checked_arrays(archive(points=np.arange(6.0), name=np.array("head"))) as stored:
        np.testing.assert_array_equal(stored["points"], np.arange(6.0))
        assert stored["name"].item() == "head"


def test_a_bomb_is_refused_before_it_unpacks():
    with pytest.raises(ValueError, match="unpack to"), checked_arrays(archive(a=np.zeros(100_000)), most_bytes=700_000):
        pass


def test_an_array_that_declares_more_than_it_holds_is_refused():
    content = io.BytesIO()
    np.save(content, np.zeros(4))
    lying = content.getvalue().replace(b"(4,)", b"(4000000000000,)")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as written:
        written.writestr("a.npy", lying[:128] + b"\0" * 32)
    with pytest.raises(ValueError, match=r"declares|header"), checked_arrays(stream):
        pass


def test_numbers_of_no_bytes_are_refused():
    """Any number of them fits any file; as a million million floats they fill the memory."""
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": "|V0", "fortran_order": False, "shape": (10**12,)})
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as written:
        written.writestr("a.npy", content.getvalue())
    with pytest.raises(ValueError, match="declares 1000000000000 numbers"), checked_arrays(stream):
        pass


def test_arrays_of_python_objects_are_refused():
    with pytest.raises(ValueError, match="objects"), checked_arrays(archive(a=np.array([{}], object))):
        pass
