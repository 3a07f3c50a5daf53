"""Pictures in, pictures out: one image, several images, a folder or a video as a lazy stream; atomic video and picture files.

Every picture is UInt8 (height, width, 3) RGB. A stream never holds more than the frame that it delivers, so an hour of
video needs no more memory than a second, and `iterate(start)` delivers identical pictures whenever it is called again.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Protocol, runtime_checkable

import av
import cv2
import numpy as np
from jaxtyping import UInt8

from workbench.errors import InputError
from workbench.files import atomic_path

IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff", ".ppm", ".pgm", ".pbm", ".jp2")
VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".ts", ".mts", ".m2ts"),
    *(".ogv", ".wmv", ".flv", ".3gp", ".mjpeg", ".y4m", ".gif"),
)

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
    """Seconds since the first frame of a video; 0 for images, which have no time."""
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

    def iterate(self, start: int = 0) -> Iterator[Frame]:
        """Yield the frames from index `start` on; the same index gives the same picture at every call."""
        ...


def open_frames(inputs: str | Path | Sequence[str | Path]) -> Frames:
    """Open one image, several images, a folder of images (in natural order: 2 before 10) or one video file.

    The first frame is read at once, so that what cannot be used fails here and not in the middle of a run.
    Raises `InputError` for missing, empty, unreadable or unsupported files and for folders without pictures.
    """
    if isinstance(inputs, str | Path):
        path = Path(inputs)
        if path.is_dir():
            return ImageFrames(images_in_folder(path), name=path.resolve().name)
        return _open_file(path)
    paths = [Path(item) for item in inputs]
    if not paths:
        raise InputError("expected at least one image or video, got an empty list: name the files to open")
    if len(paths) == 1:
        return open_frames(paths[0])
    for path in paths:
        if path.suffix.lower() in VIDEO_SUFFIXES or path.is_dir():
            raise InputError(f"several inputs must all be images, got {path}: open a video or a folder on its own")
    return ImageFrames(paths, name=paths[0].stem)


def images_in_folder(folder: Path) -> list[Path]:
    """The images directly inside `folder` in natural order; hidden files are left out. Raises `InputError` if none."""
    files = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and p.name[0] != "." and p.is_file()]
    if not files:
        raise InputError(f"expected pictures ({', '.join(IMAGE_SUFFIXES)}) in the folder {folder}, found none")
    return sorted(files, key=_natural_key)


def _natural_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Order by the numbers inside a name: frame2 before frame10; equal numbers (2, 02) by the plain name."""
    parts = re.split(r"([0-9]+)", path.name.casefold())
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts], path.name


def _open_file(path: Path) -> Frames:
    suffix = path.suffix.lower()
    if suffix in IMAGE_SUFFIXES:
        return ImageFrames([path], name=path.stem)
    _check_file(path)
    if suffix in VIDEO_SUFFIXES:
        return VideoFrames(path)
    raise InputError(
        f"{path} is no picture ({', '.join(IMAGE_SUFFIXES)}) and no video ({', '.join(VIDEO_SUFFIXES)}): convert it first"
    )


def _check_file(path: Path) -> None:
    if not path.exists():
        raise InputError(f"{path} does not exist: check the name and the folder")
    if path.is_dir():
        raise InputError(f"expected a file, got the folder {path}")
    if path.stat().st_size == 0:
        raise InputError(f"{path} is empty (0 bytes): copy or download it again")


def read_picture(path: str | Path) -> UInt8[np.ndarray, "h w 3"]:
    """Read one image file as upright 8-bit RGB.

    Grey becomes three equal channels. Transparency is dropped, and the stored colours are kept. 16 bits are scaled to
    8 (the high byte). The EXIF orientation is applied. A colour profile is not: the values are taken as sRGB.
    Raises `InputError` for a missing, empty or undecodable file.
    """
    path = Path(path)
    _check_file(path)
    try:
        picture = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_COLOR_RGB)
    except (cv2.error, OSError) as error:
        raise InputError(f"{path} cannot be read as a picture ({error}): convert it to PNG or JPEG") from error
    if picture is None:
        raise InputError(f"{path} does not contain a readable picture: it may be damaged, or another kind of file renamed")
    return picture


class ImageFrames:
    """Images from files, each read when it is delivered. Every file must exist when the stream is opened."""

    kind = "images"
    rate = None

    def __init__(self, paths: Sequence[Path], name: str) -> None:
        for path in paths:
            _check_file(path)
        self.paths = list(paths)
        self.name = name
        self.announced_count = len(self.paths)
        self.notes: list[str] = []
        height, width = read_picture(self.paths[0]).shape[:2]
        self.image_size = (width, height)

    def iterate(self, start: int = 0) -> Iterator[Frame]:
        """Yield the images from index `start` on."""
        for index in range(_checked_start(start), len(self.paths)):
            yield Frame(index, read_picture(self.paths[index]), 0.0, self.paths[index].name)


class VideoFrames:
    """A video decoded frame by frame.

    The rotation in the file's metadata is applied. What decodes of a damaged file is delivered, and `notes` says what
    is missing. Pixels are delivered as stored: if they are not square, `notes` says so. `iterate(start)` jumps to the
    last seek point that an earlier pass remembered, and otherwise decodes from the beginning without converting.
    """

    kind = "video"

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        _check_file(self.path)
        self.name = self.path.stem
        self.notes: list[str] = []
        self._key_frames: dict[int, int] = {}  # frame index -> presentation time stamp
        with self._open() as container:
            stream = container.streams.video[0]
            rate = stream.average_rate or stream.guessed_rate
            self.rate = float(rate) if rate else None
            self.announced_count = stream.frames or None
            first = next(self._decoded(container), None)
            if first is None:
                raise InputError(f"no frame of the video {self.path} can be decoded: it is damaged or cut off")
            self._first_pts = first.pts
            self._time_base = float(first.time_base or 0)
            height, width = _upright_rgb(first).shape[:2]
            self.image_size = (width, height)
            aspect = stream.sample_aspect_ratio
            if aspect and aspect != 1:
                self._note(f"{self.path.name}: its pixels are not square ({aspect}); they are used as stored")

    def iterate(self, start: int = 0) -> Iterator[Frame]:
        """Yield the frames from index `start` on."""
        start = _checked_start(start)
        index = max((i for i in self._key_frames if i <= start), default=0)
        with self._open() as container:
            decoded = self._decoded_from(container, self._key_frames.get(index))
            if decoded is None:  # the container cannot seek there
                index = 0
        if decoded is None:
            with self._open() as container:
                yield from self._delivered(self._decoded(container), 0, start)
            return
        with self._open() as container:
            yield from self._delivered(self._decoded_from(container, self._key_frames.get(index)), index, start)
