"""Pictures in and out: one image, several, a folder or a video as a lazy stream; atomic video and picture files.

Every picture is UInt8 (height, width, 3) RGB. A stream never holds more than the frame that it delivers, and a few read
ahead, so an hour of video needs no more memory than a second. `iterate(start)` delivers identical pictures whenever it
is called again.
"""

import os
import re
import shlex
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from io import BytesIO
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Protocol, runtime_checkable

import av
import cv2
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.reformatter import VideoReformatter
from av.video.stream import VideoStream
from jaxtyping import UInt8
from PIL import (
    BmpImagePlugin,
    Jpeg2KImagePlugin,
    JpegImagePlugin,
    PngImagePlugin,
    PpmImagePlugin,
    TiffImagePlugin,
    WebPImagePlugin,
)

from workbench.errors import InputError
from workbench.files import atomic_path
from workbench.reading import MOST_PIXELS, checked_content, checked_file, natural_key, reading

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".ppm", ".pgm", ".pbm", ".jp2")
VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".ts", ".mts", ".m2ts"),
    *(".ogv", ".wmv", ".flv", ".3gp", ".mjpeg", ".y4m", ".gif"),
)

HEADERS = (
    *(JpegImagePlugin.JpegImageFile, PngImagePlugin.PngImageFile, TiffImagePlugin.TiffImageFile),
    *(WebPImagePlugin.WebPImageFile, BmpImagePlugin.BmpImageFile, PpmImagePlugin.PpmImageFile),
    Jpeg2KImagePlugin.Jpeg2KImageFile,
)
"""Readers of the headers of these formats; OpenCV decodes."""
NETPBM = re.compile(rb"P[2356](?:(?:\s|#[^\n]*\n)+(\d+)){3}\s")
"""The beginning of a .pgm or .ppm; the last number is the value that stands for white."""
FLOAT_SAMPLES = 3
"""What the tag SampleFormat of a TIFF says of floating-point numbers."""
DECODER_LIMITS = {"max_pixels": str(MOST_PIXELS)}
"""FFmpeg's own: frames may also grow in the middle of a video."""

AS_VIDEO = ("a video", "convert it to MP4 (H.264)")

RATE_OF_IMAGES = 25.0
"""Frames per second of what has no rate of its own."""
FRAMES_AHEAD = 3
"""Read while the frame before them is worked on: enough for a decoder that hands over several at once."""
UNEVEN_S = 0.1
"""How far a frame may be from its time at an even rate without a note: more is seen in lips beside the sound."""
KEY_FRAME_SPACING = 100
"""Frames between remembered seek points: a few numbers per four seconds of video, instead of one per key frame."""


@dataclass(frozen=True)
class Frame:
    """One picture of a stream."""

    index: int
    """0-based place in the stream."""
    picture: UInt8[np.ndarray, "h w 3"]
    """RGB, upright."""
    time_s: float
    """Seconds since the first frame of a video, also in a part of it; 0 for images, which have no time."""
    name: str
    """File name of an image; file stem and frame index of a video frame."""


@runtime_checkable
class Frames(Protocol):
    """A stream of pictures, opened and checked but not read."""

    kind: str
    """"images" or "video"."""
    name: str
    """What was opened, for titles and file names: the stem of a file, the name of a folder."""
    rate: float | None
    """Mean frames per second; None for images."""
    announced_count: int | None
    """Number of frames according to the header; None if it says nothing. A damaged file delivers fewer."""
    image_size: tuple[int, int]
    """(width, height) of the first frame, in pixels. Images of one folder may differ in size."""
    notes: list[str]
    """Sentences about what was odd in the input; complete after a full pass."""

    def iterate(self, start: int = 0) -> Generator[Frame]:
        """Yield the frames from index `start` on; the same index gives the same picture at every call."""
        ...


def open_frames(inputs: str | Path | Sequence[str | Path]) -> Frames:
    """Open one image, several images, a folder of images (in natural order: 2 before 10) or one video file.

    The first frame is read at once, so that unusable input fails here and not in the middle of a run.
    Raises `InputError` for missing, empty, unreadable or unsupported files and for folders without pictures.
    """
    if isinstance(inputs, str | Path):
        path = Path(inputs)
        if os.path.isdir(path):
            return ImageFrames(images_in_folder(path), name=path.resolve().name)
        return _open_file(path)
    paths = [Path(item) for item in inputs]
    if not paths:
        raise InputError("expected at least one image or video, got an empty list: name the files to open")
    if len(paths) == 1:
        return open_frames(paths[0])
    for path in paths:
        if path.suffix.lower() in VIDEO_SUFFIXES or os.path.isdir(path):
            raise InputError(f"several inputs must all be images, got {path}: open a video or a folder on its own")
    return ImageFrames(paths, name=paths[0].stem)


def images_in_folder(folder: Path) -> list[Path]:
    """The images directly inside `folder` in natural order; hidden files are left out. Raises `InputError` if none."""
    with reading(folder, "a folder of pictures", "check that you may read it"):
        listed = list(folder.iterdir())
    files = [p for p in listed if p.suffix.lower() in IMAGE_SUFFIXES and p.name[0] != "." and p.is_file()]
    if not files:
        raise InputError(f"expected pictures ({', '.join(IMAGE_SUFFIXES)}) in the folder {folder}, found none")
    return sorted(files, key=natural_key)


def _open_file(path: Path) -> Frames:
    suffix = path.suffix.lower()
    if suffix in IMAGE_SUFFIXES:
        return ImageFrames([path], name=path.stem)
    checked_file(path, "a picture or video")
    if suffix in VIDEO_SUFFIXES:
        return VideoFrames(path)
    raise InputError(
        f"{path} is neither a picture ({', '.join(IMAGE_SUFFIXES)}) nor a video ({', '.join(VIDEO_SUFFIXES)}): "
        "convert it first"
    )


def read_picture(path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Read one image file as upright 8-bit RGB.

    Grey becomes three equal channels. Transparency is dropped, and the stored colours are kept. 16 bits are scaled to
    8 (the high byte), and so are depths in between in .pgm and .ppm. The EXIF orientation is applied. A colour profile
    is not: the values are taken as sRGB. Raises `InputError` for a missing, empty or undecodable file, and beyond
    `MOST_PIXELS`.
    """
    return decoded_picture(checked_content(path, "a picture"), path)


def decoded_picture(content: bytes, name: object) -> UInt8[np.ndarray, "h w 3"]:
    """The picture that the bytes of an image file hold, as `read_picture` gives it; errors quote `name`.

    The size is read from the header before anything is decoded. Raises `InputError` as `read_picture` does.
    """
    with reading(str(name), "a picture", "convert it to PNG or JPEG"):
        width, height = _declared_size(content)
        if width * height > MOST_PIXELS:
            raise InputError(
                f"{name} has {width}×{height} pixels, the limit is {MOST_PIXELS / 1e6:.0f} megapixels; reduce it first"
            )
        if (header := NETPBM.match(content)) is not None and int(header[1]) not in (255, 65535):
            return _scaled_netpbm(content)
        # A header that Pillow does not know is none of the formats above.
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR_RGB) if width else None
    if picture is None and _has_float_pixels(content):
        raise InputError(f"{name} has floating-point pixels, expected 8 or 16 bits: convert it to one of these")
    if picture is None:
        raise InputError(
            f"{name} does not contain a readable picture: it may be damaged, or another kind of file renamed; "
            "remove or replace it"
        )
    return picture


def _scaled_netpbm(content: bytes) -> UInt8[np.ndarray, "h w 3"]:
    """A .pgm or .ppm whose white is not that of 8 or 16 bits, as of cameras with 10 or 12: OpenCV does not scale it."""
    with PpmImagePlugin.PpmImageFile(BytesIO(content)) as stored:
        values = np.asarray(stored)
    picture = (values >> 8).astype(np.uint8) if stored.mode == "I" else values
    return np.repeat(picture[..., None], 3, axis=2) if picture.ndim == 2 else picture


def _has_float_pixels(content: bytes) -> bool:
    """Whether this is a TIFF of floating-point samples; Pillow knows the header of grey ones alone."""
    with suppress(Exception), BytesIO(content) as file:
        tags = TiffImagePlugin.ImageFileDirectory_v2(file.read(8))
        file.seek(tags.next)
        tags.load(file)
        return FLOAT_SAMPLES in tags.get(TiffImagePlugin.SAMPLEFORMAT, ())
    return False


def _declared_size(content: bytes) -> tuple[int, int]:
    """(width, height) that a picture's header declares; (0, 0) for what is not a picture."""
    for kind in HEADERS:
        # `Image.open` does the same with a limit of its own, which it tells by a warning.
        with suppress(Exception), kind(BytesIO(content)) as header:
            return header.size
    return 0, 0


class ImageFrames:
    """Images from files, each read when it is delivered. Every file must exist when the stream is opened."""

    kind = "images"
    rate = None

    def __init__(self, paths: Sequence[Path], name: str) -> None:
        for path in paths:
            checked_file(path, "a picture")
        self.paths = list(paths)
        self.name = name
        self.announced_count = len(self.paths)
        self.notes: list[str] = []
        height, width = read_picture(self.paths[0]).shape[:2]
        self.image_size = (width, height)

    def iterate(self, start: int = 0) -> Generator[Frame]:
        """Yield the images from index `start` on."""
        for index in range(_checked_start(start), len(self.paths)):
            yield Frame(index, read_picture(self.paths[index]), 0.0, self.paths[index].name)


def image_names(frames: Frames | None) -> list[str]:
    """The file names of images in their order, for a range those of its whole stream; none for a video or no frames."""
    if isinstance(frames, FrameRange):
        return image_names(frames._frames)
    return [path.name for path in frames.paths] if isinstance(frames, ImageFrames) else []


def files_read(frames: Frames) -> list[Path]:
    """The files that a stream reads: images in their order, or a video; none where pictures come from elsewhere."""
    if isinstance(frames, FrameRange):
        return files_read(frames._frames)
    if isinstance(frames, ImageFrames):
        return frames.paths
    return [frames.path] if isinstance(frames, VideoFrames) else []


class FrameRange:
    """Consecutive frames of a stream as a stream of their own, counted from 0; their times are those of the stream."""

    def __init__(self, frames: Frames, first: int, last: int) -> None:
        """Frames `first` to `last`, both included. Raises `InputError` for a range that the stream does not have."""
        count = frames.announced_count
        if not 0 <= first <= last or (count is not None and first >= count):
            known = "" if count is None else f"; {frames.name} has frames 0 to {count - 1}"
            raise InputError(f"Frames {first} to {last} were asked for{known}.")
        self._frames, self._first, self._last = frames, first, last
        self._count = count
        self.kind, self.name, self.rate, self.image_size = frames.kind, frames.name, frames.rate, frames.image_size
        self._length = last - first + 1
        self.announced_count = None if count is None else min(self._length, count - first)

    @property
    def notes(self) -> list[str]:
        """Those of the stream, and where it ends before the range does."""
        return [*self._frames.notes, *range_notes(self.name, self._first, self._last, self._count)]

    def iterate(self, start: int = 0) -> Generator[Frame]:
        """Yield the frames from index `start` of the range on."""
        stream = self._frames.iterate(self._first + _checked_start(start))
        for index in range(start, self._length):
            frame = next(stream, None)
            if frame is None and index == 0:
                raise InputError(
                    f"Frames {self._first} to {self._last} were asked for; {self.name} ends before frame {self._first}."
                )
            if frame is None:
                self._count = self._first + index
                return
            yield replace(frame, index=index)


def read_ahead(frames: Generator[Frame], most: int = FRAMES_AHEAD) -> Iterator[Frame]:
    """The same frames, the next ones read by a thread of their own while the caller works on one.

    What goes wrong while reading is raised where the frame would have come.
    """
    with closing(frames), ThreadPoolExecutor(1, "frames") as reader:
        coming = deque(reader.submit(next, frames, None) for _ in range(most))
        while (frame := coming.popleft().result()) is not None:
            coming.append(reader.submit(next, frames, None))
            yield frame


def range_notes(name: str, first: int, last: int, count: int | None) -> list[str]:
    """One sentence where frames `first` to `last` were asked for and there are fewer; none where they are all there."""
    if count is None or last < count:
        return []
    return [f"Frames {first} to {last} were asked for; {name} ends with frame {count - 1}, and the run with it."]


class VideoFrames:
    """A video decoded frame by frame.

    The rotation in the file's metadata is applied. What decodes of a damaged file is delivered, and `notes` says what
    is missing. Pixels are delivered as stored: if they are not square, `notes` says so. `iterate(start)` jumps to the
    last seek point that an earlier pass remembered, and otherwise decodes from the beginning without converting.
    """

    kind = "video"

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        checked_file(self.path, "a video")
        self.name = self.path.stem
        self.notes: list[str] = []
        self._key_frames: dict[int, int] = {}  # frame index -> presentation time stamp
        self._damaged = self._uneven = False
        with reading(self.path, *AS_VIDEO), self._open() as container:
            stream = container.streams.video[0]
            rate = stream.average_rate or stream.guessed_rate
            self.rate = float(rate) if rate else None
            self.announced_count = stream.frames or None
            first = next(self._decoded(container), None)
            if first is None:
                raise InputError(f"no frame of the video {self.path} can be decoded: it is damaged or cut off")
            self._first_pts = first.pts
            self._time_base = float(first.time_base or 0)
            height, width = _upright_rgb(first, VideoReformatter()).shape[:2]
            self.image_size = (width, height)
            aspect = stream.sample_aspect_ratio
            if aspect and aspect != 1:
                self._note(f"{self.path.name}: its pixels are not square ({aspect}); they are used as stored")

    def iterate(self, start: int = 0) -> Generator[Frame]:
        """Yield the frames from index `start` on."""
        start = _checked_start(start)
        origin = max((index for index in self._key_frames if index <= start), default=0)
        with reading(self.path, *AS_VIDEO), ExitStack() as stack:
            decoded = self._decoded_after_seek(stack.enter_context(self._open()), origin) if origin else None
            if decoded is None:
                origin, decoded = 0, self._decoded(stack.enter_context(self._open()))
            index, reformatter = origin - 1, VideoReformatter()
            for index, frame in enumerate(decoded, origin):
                self._remember(index, frame)
                time_s = self._time(index, frame.pts)
                self._note_uneven(index, time_s)
                if index >= start:
                    yield Frame(index, _upright_rgb(frame, reformatter), time_s, f"{self.name}#{index}")
            if index >= 0 and self.announced_count and index + 1 < self.announced_count:
                announced = f"the header announces {self.announced_count} frames"
                self._note(f"{self.path.name}: {announced}, {index + 1} could be decoded")

    def _open(self) -> InputContainer:
        try:
            # Only this file is read: a playlist under a video's name cannot reach for other files or the network.
            options = {"protocol_whitelist": "file", **DECODER_LIMITS}
            container = av.open(str(self.path.absolute()), options=options)
        except (av.error.FFmpegError, ValueError) as error:
            raise InputError(
                f"{self.path} cannot be opened as a video ({error}): it may be damaged, or another kind of file renamed"
            ) from error
        if not container.streams.video:
            container.close()
            raise InputError(f"{self.path} has no video stream: it may hold sound only")
        decoder = container.streams.video[0].codec_context
        decoder.options = DECODER_LIMITS
        # FFmpeg tells no size of what is beyond the limit.
        if not 0 < decoder.width * decoder.height <= MOST_PIXELS:
            container.close()
            raise InputError(
                f"{self.path} declares pictures without a size or of more than {MOST_PIXELS / 1e6:.0f} megapixels: "
                "it may be damaged; convert it to MP4 (H.264) of a common size"
            )
        return container

    def _decoded(self, container: InputContainer) -> Iterator[VideoFrame]:
        """Every frame that decodes, in order of presentation; packets that do not decode are noted and skipped."""
        packets = container.demux(container.streams.video[0])
        while True:
            try:
                packet = next(packets, None)
                if packet is None:
                    return
                frames = packet.decode()
            except av.error.EOFError:
                return
            except av.error.FFmpegError as error:
                self._damaged = True
                self._note(f"{self.path.name}: parts are damaged and were skipped ({error.strerror})")
                continue
            yield from frames

    def _decoded_after_seek(self, container: InputContainer, index: int) -> Iterator[VideoFrame] | None:
        """The frames from the remembered key frame `index` on; None where the container cannot seek to it."""
        pts = self._key_frames[index]
        try:
            container.seek(pts, stream=container.streams.video[0])
        except av.error.FFmpegError:
            return None
        decoded = self._decoded(container)
        for frame in decoded:
            if frame.pts == pts:
                return chain([frame], decoded)
            if frame.pts is None or frame.pts > pts:
                return None
        return None

    def _remember(self, index: int, frame: VideoFrame) -> None:
        """Keep a key frame as a seek point. After damage the decoder conceals, and a seek would give other pictures."""
        usable = frame.key_frame and frame.pts is not None and not self._damaged
        if usable and index - max(self._key_frames, default=0) >= KEY_FRAME_SPACING:
            self._key_frames[index] = frame.pts

    def _time(self, index: int, pts: int | None) -> float:
        if pts is not None and self._first_pts is not None:
            return (pts - self._first_pts) * self._time_base
        return index / self.rate if self.rate else 0.0

    def _note_uneven(self, index: int, time_s: float) -> None:
        """Say once where a frame is shown at another time than at the even rate that results are written with."""
        if self._uneven or not self.rate or abs(time_s - index / self.rate) <= UNEVEN_S:
            return
        self._uneven = True
        self._note(
            f"{self.path.name}: its frames come at uneven times (frame {index} at {time_s:.2f} s, by an even rate of "
            f"{self.rate:.2f} frames/s at {index / self.rate:.2f} s); films and exports are written at that rate. To "
            f"keep them in time, convert the clip first: ffmpeg -i {shlex.quote(str(self.path))} -fps_mode cfr even.mp4"
        )

    def _note(self, sentence: str) -> None:
        if sentence not in self.notes:
            self.notes.append(sentence)


def _upright_rgb(frame: VideoFrame, reformatter: VideoReformatter) -> UInt8[np.ndarray, "h w 3"]:
    """Convert with the colour matrix named in the file and turn by the quarter turns of its display matrix.

    A reformatter keeps its tables from frame to frame; making them anew takes longer than converting a small frame.
    """
    picture = reformatter.reformat(frame, format="rgb24").to_ndarray()
    quarter_turns = round(frame.rotation / 90) % 4  # counter-clockwise, as in np.rot90
    return np.ascontiguousarray(np.rot90(picture, quarter_turns)) if quarter_turns else picture


def _checked_start(start: int) -> int:
    if start < 0:
        raise InputError(f"a stream starts at frame 0 or later, got {start}")
    return start


class VideoWriter:
    """Write pictures as H.264 (yuv420p, BT.709), a format that every browser plays; used in a `with` block.

    The size is that of the first picture; H.264 in yuv420p wants even sizes, so an odd row or column is repeated at
    the edge. The file appears under its name when the block ends; after an exception there is nothing under it.
    Raises `InputError` for a picture of another size or type, and when the block ends without any picture.
    """

    def __init__(self, path: str | Path, rate: float | int = RATE_OF_IMAGES, quality: int = 20) -> None:
        if not 0.001 <= rate <= 1000:
            raise InputError(f"a video needs a rate between 0.001 and 1000 frames per second, got {rate:g}")
        self.path = Path(path)
        if self.path.suffix.lower() not in (".mp4", ".m4v", ".mov", ".mkv"):
            raise InputError(f"H.264 video is written as .mp4, .m4v, .mov or .mkv, got {self.path.name}")
        self._rate = Fraction(rate).limit_denominator(1001)
        self._quality = quality
        self._stack = ExitStack()
        self._stream: VideoStream | None = None
        self._size = (0, 0)
        self.count = 0

    def __enter__(self) -> "VideoWriter":
        temporary = self._stack.enter_context(atomic_path(self.path))
        self._container = self._stack.enter_context(av.open(str(temporary.absolute()), "w"))
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        if kind is not None:
            self._stack.__exit__(kind, error, traceback)
            return
        with self._stack:
            if self._stream is None:
                raise InputError(f"no picture was written to {self.path}: a video needs at least one")
            self._container.mux(self._stream.encode(None))

    def write(self, picture: UInt8[np.ndarray, "..."]) -> None:
        """Append one RGB picture (h, w, 3)."""
        picture = _checked_picture(picture)
        height, width = picture.shape[:2]
        if self._stream is None:
            self._size = (width, height)
            self._stream = self._add_stream(width + width % 2, height + height % 2)
        if (width, height) != self._size:
            raise InputError(f"every picture of a video has one size: expected {self._size}, got {(width, height)}")
        if width % 2 or height % 2:
            picture = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
        frame = VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        frame.pts = self.count
        frame.time_base = 1 / self._rate
        self._container.mux(self._stream.encode(frame))
        self.count += 1

    def _add_stream(self, width: int, height: int) -> VideoStream:
        stream = self._container.add_stream("libx264", rate=self._rate, options={"crf": str(self._quality)})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        context = stream.codec_context
        context.colorspace = context.color_primaries = context.color_trc = 1  # BT.709
        context.color_range = 1  # limited, "MPEG"
        return stream


def write_picture(path: str | Path, picture: UInt8[np.ndarray, "..."], quality: int = 95) -> None:
    """Write an RGB picture (h, w, 3) as PNG or JPEG (by suffix; `quality` 0..100 is JPEG's), atomically."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"pictures are written as .png, .jpg or .jpeg, got {path.name}")
    options = [] if suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, quality]
    encoded = cv2.imencode(suffix, cv2.cvtColor(_checked_picture(picture), cv2.COLOR_RGB2BGR), options)[1]
    with atomic_path(path) as temporary:
        temporary.write_bytes(encoded)


def _checked_picture(picture: np.ndarray) -> UInt8[np.ndarray, "h w 3"]:
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3 or picture.size == 0:
        raise InputError(f"expected an RGB picture, uint8 (h, w, 3), got {picture.dtype} {picture.shape}")
    return picture
