"""Streams of pictures: what is opened, in which order, upright, complete, the same at every pass; atomic writing."""

import os
import resource
import struct
import threading
import zlib
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from tests.short_clips import write_timed_clip
from workbench.errors import InputError
from workbench.frames import (
    IMAGE_SUFFIXES,
    FrameRange,
    Frames,
    VideoWriter,
    open_frames,
    read_ahead,
    read_picture,
    write_picture,
)

REAL_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def picture_with_number(number: int, width: int = 64, height: int = 48) -> np.ndarray:
    """A smooth picture whose red level tells its number."""
    y, x = np.mgrid[:height, :width]
    return np.stack([np.full_like(x, 10 + 2 * number), 2 * x, 3 * y], axis=-1).clip(0, 255).astype(np.uint8)


def write_clip(path: Path, count: int, rate: float = 25.0) -> Path:
    with VideoWriter(path, rate=rate) as writer:
        for number in range(count):
            writer.write(picture_with_number(number % 120))
    return path


def indices(frames: Frames, start: int = 0) -> list[int]:
    return [frame.index for frame in frames.iterate(start)]


# --- images ---


def test_one_image_is_a_stream_of_one_frame(tmp_path):
    write_picture(tmp_path / "face.png", picture_with_number(3))
    frames = open_frames(tmp_path / "face.png")
    assert isinstance(frames, Frames)
    assert (frames.kind, frames.name, frames.rate, frames.announced_count) == ("images", "face", None, 1)
    assert frames.image_size == (64, 48)
    (frame,) = frames.iterate()
    assert (frame.index, frame.name, frame.time_s) == (0, "face.png", 0.0)
    np.testing.assert_array_equal(frame.picture, picture_with_number(3))


def test_folder_is_read_in_natural_order_and_sizes_may_differ(tmp_path):
    for number in (10, 2, 1):
        write_picture(tmp_path / f"take{number}.png", picture_with_number(number, width=40 + number))
    (tmp_path / "notes.txt").write_text("not a picture")
    (tmp_path / ".hidden.png").write_text("not a picture")
    frames = open_frames(tmp_path)
    assert frames.name == tmp_path.name
    assert [frame.name for frame in frames.iterate()] == ["take1.png", "take2.png", "take10.png"]
    assert [frame.picture.shape[1] for frame in frames.iterate()] == [41, 42, 50]
    assert indices(frames, start=2) == [2]


def test_several_images_keep_the_given_order(tmp_path):
    paths = [tmp_path / "b.png", tmp_path / "a.jpg"]
    for path in paths:
        write_picture(path, picture_with_number(1))
    assert [frame.name for frame in open_frames(paths).iterate()] == ["b.png", "a.jpg"]


@pytest.mark.parametrize(
    ("stored", "expected"),
    [
        pytest.param(np.full((8, 9), 77, np.uint8), (77, 77, 77), id="grey"),
        pytest.param(np.full((8, 9, 4), (30, 20, 10, 0), np.uint8), (10, 20, 30), id="transparent BGRA"),
        pytest.param(np.full((8, 9, 3), (3 * 257, 2 * 257, 257), np.uint16), (1, 2, 3), id="16 bits BGR"),
    ],
)
def test_every_kind_of_png_becomes_8_bit_rgb(tmp_path, stored, expected):
    cv2.imwrite(str(tmp_path / "p.png"), stored)
    picture = read_picture(tmp_path / "p.png")
    assert picture.dtype == np.uint8
    assert picture.shape == (8, 9, 3)
    np.testing.assert_array_equal(picture[4, 4], expected)


def test_exif_orientation_is_applied(tmp_path):
    write_picture(tmp_path / "plain.jpg", picture_with_number(0, width=64, height=32))
    data = (tmp_path / "plain.jpg").read_bytes()
    entry = struct.pack(">HHIHH", 0x0112, 3, 1, 6, 0)  # orientation 6: turn clockwise to see it upright
    tiff = b"MM\x00*" + struct.pack(">IH", 8, 1) + entry + struct.pack(">I", 0)
    segment = b"\xff\xe1" + struct.pack(">H", len(tiff) + 8) + b"Exif\x00\x00" + tiff
    (tmp_path / "turned.jpg").write_bytes(data[:2] + segment + data[2:])
    turned = read_picture(tmp_path / "turned.jpg")
    np.testing.assert_array_equal(turned, np.rot90(read_picture(tmp_path / "plain.jpg"), -1))


def png_of(width: int, height: int) -> bytes:
    """A PNG whose header declares a size, and whose few bytes unpack to black."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = [(b"IHDR", header), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")]
    chunks = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)


def test_a_picture_beyond_a_hundred_megapixels_is_refused_by_its_header(tmp_path):
    (tmp_path / "bomb.png").write_bytes(png_of(30_000, 30_000))
    (tmp_path / "bomb.pgm").write_bytes(b"P5 30000 30000 255\n" + bytes(1000))
    for name in ("bomb.png", "bomb.pgm"):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        with pytest.raises(InputError, match="30000×30000 pixels, the limit is 100 megapixels"):
            read_picture(tmp_path / name)
        assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB


@pytest.mark.parametrize("suffix", IMAGE_SUFFIXES)
def test_every_format_of_pictures_is_read(suffix, tmp_path):
    stored = picture_with_number(3) if suffix not in (".pgm", ".pbm") else np.full((48, 64), 255, np.uint8)
    (tmp_path / f"p{suffix}").write_bytes(cv2.imencode(suffix, stored)[1].tobytes())
    assert read_picture(tmp_path / f"p{suffix}").shape == (48, 64, 3)


@pytest.mark.parametrize("white", [100, 1023, 4095])
@pytest.mark.parametrize("kind", ["P2", "P3", "P5", "P6"])
def test_white_is_white_whatever_number_a_netpbm_file_has_for_it(kind, white, tmp_path):
    """Cameras of machine vision write 10 and 12 bits."""
    colour = np.array([white, white // 2, 0]) if kind in ("P3", "P6") else np.array([white // 2])
    values = np.stack([np.full(len(colour), white), colour])
    if kind in ("P2", "P3"):
        body = " ".join(map(str, values.ravel())).encode()
    else:
        body = values.astype(np.uint8 if white < 256 else ">u2").tobytes()
    (tmp_path / "p.ppm").write_bytes(f"{kind}\n# a camera\n2 1\n{white}\n".encode() + body)
    read = read_picture(tmp_path / "p.ppm")
    expected = np.broadcast_to(np.floor(255.999 * values / white), (2, 3))
    assert np.abs(read[0] - expected).max() <= 1.0
    assert read[0, 0].tolist() == [255, 255, 255]


def test_a_format_that_is_not_offered_is_not_decoded_under_another_name(tmp_path):
    (tmp_path / "p.png").write_bytes(cv2.imencode(".hdr", np.ones((8, 8, 3), np.float32))[1].tobytes())
    with pytest.raises(InputError, match="does not contain a readable picture"):
        read_picture(tmp_path / "p.png")


@pytest.mark.parametrize("shape", [(8, 9), (8, 9, 3)], ids=["grey", "colour"])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_tiff_of_floating_point_numbers_is_not_called_damaged(shape, kind, tmp_path):
    (tmp_path / "p.tif").write_bytes(cv2.imencode(".tif", np.ones(shape, kind))[1].tobytes())
    with pytest.raises(InputError, match=r"p\.tif has floating-point pixels, expected 8 or 16 bits: convert it"):
        read_picture(tmp_path / "p.tif")


@pytest.mark.parametrize("name", ["pipe.png", "pipe.mp4"])
def test_pipes_are_refused_without_waiting(name, tmp_path):
    os.mkfifo(tmp_path / name)
    with pytest.raises(InputError, match="pipe or device"):
        open_frames(tmp_path / name)


def test_tiny_and_huge_pictures_are_pictures(tmp_path):
    write_picture(tmp_path / "tiny.png", np.zeros((1, 1, 3), np.uint8))
    assert open_frames(tmp_path / "tiny.png").image_size == (1, 1)
    write_picture(tmp_path / "huge.jpg", np.zeros((6000, 8000, 3), np.uint8))
    assert open_frames(tmp_path / "huge.jpg").image_size == (8000, 6000)


# --- video ---


def test_video_delivers_frames_with_index_time_and_colour(tmp_path):
    frames = open_frames(write_clip(tmp_path / "clip.mp4", 12, rate=12.5))
    assert (frames.kind, frames.name, frames.announced_count, frames.image_size) == ("video", "clip", 12, (64, 48))
    assert frames.rate == pytest.approx(12.5)
    delivered = list(frames.iterate())
    assert [frame.index for frame in delivered] == list(range(12))
    np.testing.assert_allclose([frame.time_s for frame in delivered], np.arange(12) / 12.5, atol=1e-6)
    assert delivered[4].name == "clip#4"
    assert np.abs(delivered[4].picture.astype(int) - picture_with_number(4)).mean() < 4
    assert frames.notes == []


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
def test_frames_at_uneven_times_are_told_with_the_way_to_even_ones(suffix, tmp_path):
    """As phones and screen recorders write them: here 30 frames at 33 ms and 30 at 100 ms."""
    path = tmp_path / f"my phone{suffix}"
    milliseconds = np.cumsum([0, *[33] * 30, *[100] * 29])
    write_timed_clip(path, [picture_with_number(index % 12) for index in range(60)], milliseconds)
    frames = open_frames(path)
    delivered = list(frames.iterate())
    np.testing.assert_allclose([frame.time_s for frame in delivered], milliseconds / 1000, atol=2e-3)
    command = f"ffmpeg -i '{path}' -fps_mode cfr"
    assert [("uneven times" in note, command in note) for note in frames.notes] == [(True, True)]
    list(frames.iterate())
    assert len(frames.notes) == 1


def test_a_video_of_pictures_beyond_the_limit_is_refused(tmp_path, monkeypatch):
    path = write_clip(tmp_path / "clip.mp4", 3)
    monkeypatch.setattr("workbench.frames.MOST_PIXELS", 64 * 48 - 1)
    with pytest.raises(InputError, match=r"declares pictures without a size or of more than"):
        open_frames(path)


def test_the_decoder_itself_refuses_larger_pictures_than_the_header_declares(tmp_path, monkeypatch):
    path = write_clip(tmp_path / "clip.mp4", 3)
    monkeypatch.setattr("workbench.frames.DECODER_LIMITS", {"max_pixels": str(64 * 48 - 1)})
    with pytest.raises(InputError, match="no frame of the video"):
        open_frames(path)


def test_a_second_pass_from_any_frame_gives_identical_pictures(tmp_path):
    frames = open_frames(write_clip(tmp_path / "long.mp4", 330))
    first = {frame.index: frame for frame in frames.iterate()}
    for start in (0, 1, 149, 250, 251, 329):  # 250 and later begin at a remembered key frame
        again = list(frames.iterate(start))
        assert [frame.index for frame in again] == list(range(start, 330))
        for frame in again[:3]:
            np.testing.assert_array_equal(frame.picture, first[frame.index].picture)
            assert frame.time_s == first[frame.index].time_s
    fresh = open_frames(tmp_path / "long.mp4")
    np.testing.assert_array_equal(next(fresh.iterate(251)).picture, first[251].picture)
    assert indices(frames, start=330) == []


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_rotation_in_the_metadata_is_applied(tmp_path, turns):
    path = tmp_path / "turned.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"crf": "1"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.set_display_rotation(90 * turns)
        for _ in range(2):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture_with_number(5), format="rgb24")))
        container.mux(stream.encode(None))
    plain = next(iter(av.open(str(path)).decode(video=0)))
    frame = next(open_frames(path).iterate())
    quarter_turns = round(plain.rotation / 90)
    assert quarter_turns % 4 in (turns, 4 - turns)
    np.testing.assert_array_equal(frame.picture, np.rot90(plain.to_ndarray(format="rgb24"), quarter_turns))
    assert open_frames(path).image_size == ((64, 48) if turns == 2 else (48, 64))


def test_damaged_tail_delivers_what_decodes_and_says_so(tmp_path):
    whole = write_clip(tmp_path / "whole.mkv", 300)
    data = whole.read_bytes()
    (tmp_path / "cut.mkv").write_bytes(data[: len(data) * 2 // 3])
    frames = open_frames(tmp_path / "cut.mkv")
    delivered = indices(frames)
    assert 0 < len(delivered) < 300
    assert delivered == indices(frames)


@pytest.mark.skipif(not REAL_DATA.is_dir(), reason="the real clips are not part of the project")
def test_real_damaged_file_notes_how_many_frames_decode():
    frames = open_frames(REAL_DATA / "obama.mp4")
    assert frames.announced_count == 158
    assert len(indices(frames)) == 55
    assert frames.notes == ["obama.mp4: the header announces 158 frames, 55 could be decoded"]


# --- what cannot be opened ---


def text_named(name: str):
    def make(folder: Path) -> Path:
        (folder / name).write_text("this is a text file\n" * 50)
        return folder / name

    return make


def empty_file(folder: Path) -> Path:
    (folder / "empty.mp4").touch()
    return folder / "empty.mp4"


def sound_only(folder: Path) -> Path:
    with av.open(str(folder / "sound.mp4"), "w") as container:
        stream = container.add_stream("aac", rate=48000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 48000
        container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return folder / "sound.mp4"


def header_only(folder: Path) -> Path:
    data = write_clip(folder / "whole.mkv", 30).read_bytes()
    (folder / "header.mkv").write_bytes(data[:700])
    return folder / "header.mkv"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        pytest.param(lambda folder: folder / "none.mp4", "does not exist", id="missing video"),
        pytest.param(lambda folder: folder / "none.png", "does not exist", id="missing image"),
        pytest.param(empty_file, "is empty", id="empty file"),
        pytest.param(text_named("renamed.mp4"), "cannot be opened as a video", id="text as mp4"),
        pytest.param(text_named("renamed.jpg"), "does not contain a readable picture", id="text as jpg"),
        pytest.param(text_named("notes.txt"), "neither a picture .* nor a video", id="unsupported"),
        pytest.param(sound_only, "no video stream", id="sound only"),
        pytest.param(header_only, "video", id="no frames"),
        pytest.param(lambda folder: folder, "found none", id="folder without pictures"),
        pytest.param(lambda folder: [], "empty list", id="nothing"),
        pytest.param(lambda folder: "n" * 5000, "cannot be opened", id="endless name"),
        pytest.param(lambda folder: "n" * 5000 + ".png", "cannot be opened", id="endless name of a picture"),
        pytest.param(lambda folder: "a\0b.mp4", "cannot be opened", id="name with NUL"),
        pytest.param(lambda folder: ["n" * 5000, "b.png"], "cannot be opened", id="endless name among others"),
        pytest.param(lambda folder: [folder / "a.png", folder / "b.mp4"], "must all be images", id="mixture"),
    ],
)
def test_unusable_inputs_fail_at_once_and_say_why(tmp_path, make, message):
    with pytest.raises(InputError, match=message):
        open_frames(make(tmp_path))


def test_a_playlist_named_as_video_does_not_open_other_files(tmp_path):
    clip = write_clip(tmp_path / "other.mp4", 3)
    (tmp_path / "list.mp4").write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{clip}\n#EXT-X-ENDLIST\n")
    with pytest.raises(InputError):
        open_frames(tmp_path / "list.mp4")


def test_a_stream_cannot_start_before_its_first_frame(tmp_path):
    write_picture(tmp_path / "p.png", picture_with_number(0))
    with pytest.raises(InputError, match="starts at frame 0"):
        next(open_frames(tmp_path / "p.png").iterate(-1))


# --- writing ---


def test_written_video_pads_odd_sizes_and_keeps_colours(tmp_path):
    colours = np.zeros((121, 161, 3), np.uint8)
    colours[:, :54], colours[:, 54:108], colours[:, 108:] = (200, 40, 30), (30, 190, 60), (20, 60, 220)
    with VideoWriter(tmp_path / "v.mp4", rate=30000 / 1001) as writer:
        for _ in range(3):
            writer.write(colours)
    frames = open_frames(tmp_path / "v.mp4")
    assert frames.image_size == (162, 122)
    assert frames.rate == pytest.approx(29.97, abs=0.01)
    picture = next(frames.iterate()).picture
    for x in (20, 80, 140):
        np.testing.assert_allclose(picture[60, x].astype(int), colours[60, x], atol=6)


def test_video_appears_only_when_it_is_whole(tmp_path):
    def interrupted() -> None:
        with VideoWriter(tmp_path / "v.mp4") as writer:
            writer.write(picture_with_number(0))
            assert not (tmp_path / "v.mp4").exists()
            raise KeyError("interrupted")

    with pytest.raises(KeyError):
        interrupted()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("pictures", "message"),
    [
        ([], "at least one"),
        ([np.zeros((8, 8, 3), np.uint8), np.zeros((8, 10, 3), np.uint8)], "one size"),
        ([np.zeros((8, 8), np.uint8)], "RGB picture"),
    ],
)
def test_video_writer_refuses_what_is_no_video(tmp_path, pictures, message):
    def write_all() -> None:
        with VideoWriter(tmp_path / "v.mp4") as writer:
            for picture in pictures:
                writer.write(picture)

    with pytest.raises(InputError, match=message):
        write_all()
    assert list(tmp_path.iterdir()) == []


def test_video_writer_checks_rate_and_suffix(tmp_path):
    with pytest.raises(InputError, match="rate"):
        VideoWriter(tmp_path / "v.mp4", rate=0)
    with pytest.raises(InputError, match=r"\.mp4"):
        VideoWriter(tmp_path / "v.gif")


def test_pictures_are_written_losslessly_as_png_and_nothing_else_is_written(tmp_path):
    picture = picture_with_number(7)
    write_picture(tmp_path / "new" / "p.png", picture)
    np.testing.assert_array_equal(read_picture(tmp_path / "new" / "p.png"), picture)
    with pytest.raises(InputError, match="are written as"):
        write_picture(tmp_path / "p.tiff", picture)
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


# --- a part of a stream ---


def test_a_range_says_where_the_stream_ends_before_it_does(tmp_path):
    clip = open_frames(write_clip(tmp_path / "talk.mp4", 12))
    part = FrameRange(clip, 8, 20)
    assert indices(part) == [0, 1, 2, 3]
    assert part.notes == ["Frames 8 to 20 were asked for; talk ends with frame 11, and the run with it."]
    assert FrameRange(clip, 8, 11).notes == []


def test_a_range_counts_from_zero_and_keeps_the_clock_of_the_stream(tmp_path):
    clip = open_frames(write_clip(tmp_path / "talk.mp4", 12))
    whole, part = list(clip.iterate()), list(FrameRange(clip, 8, 11).iterate())
    assert [frame.index for frame in part] == [0, 1, 2, 3]
    assert [frame.time_s for frame in part] == [frame.time_s for frame in whole[8:]]


def test_a_range_of_a_stream_of_unknown_length_says_so_when_it_has_ended(tmp_path):
    clip = open_frames(write_clip(tmp_path / "talk.mp4", 12))
    clip.announced_count = None
    part = FrameRange(clip, 8, 20)
    assert part.notes == []
    assert indices(part, 2) == [2, 3]
    assert part.notes == ["Frames 8 to 20 were asked for; talk ends with frame 11, and the run with it."]


def test_a_range_behind_the_end_of_a_stream_of_unknown_length_is_refused(tmp_path):
    clip = open_frames(write_clip(tmp_path / "talk.mp4", 12))
    clip.announced_count = None
    with pytest.raises(InputError, match="Frames 100 to 200 were asked for; talk ends before frame 100"):
        indices(FrameRange(clip, 100, 200))


# --- reading ahead ---


def test_frames_read_ahead_are_the_same_in_the_same_order(tmp_path):
    clip = open_frames(write_clip(tmp_path / "clip.mp4", 12))
    ahead, plain = list(read_ahead(clip.iterate(2))), list(clip.iterate(2))
    assert [frame.index for frame in ahead] == [frame.index for frame in plain] == list(range(2, 12))
    assert all(np.array_equal(a.picture, b.picture) for a, b in zip(ahead, plain, strict=True))


def test_the_next_frames_are_read_while_one_is_worked_on():
    third = threading.Event()

    def frames():
        for index in range(5):
            if index == 3:
                third.set()
            yield index

    stream = read_ahead(frames(), most=3)
    assert next(stream) == 0
    assert third.wait(10.0)
    assert list(stream) == [1, 2, 3, 4]


def test_what_goes_wrong_while_reading_ahead_comes_after_the_frames_before_it():
    def frames():
        yield from (0, 1)
        raise InputError("the third frame is damaged")

    stream = read_ahead(frames())
    assert [next(stream), next(stream)] == [0, 1]
    with pytest.raises(InputError, match="the third frame is damaged"):
        next(stream)


def test_a_stream_left_early_closes_what_it_reads():
    closed = []

    def frames():
        try:
            yield from range(100)
        finally:
            closed.append(True)

    stream = read_ahead(frames())
    assert next(stream) == 0
    stream.close()
    assert closed == [True]
