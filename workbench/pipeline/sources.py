"""Where a run's frames and landmarks come from: a landmark file here, a detector in `picture_source.py`."""

from collections.abc import Generator, Iterator, Sequence
from itertools import chain, islice, repeat
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

import workbench
from workbench.config import Config
from workbench.errors import InputError
from workbench.frames import RATE_OF_IMAGES, Frame, FrameRange, Frames, image_names, open_frames, range_notes
from workbench.landmarks.files import LandmarkRecord, is_landmark_file, read_landmark_file, states_size
from workbench.landmarks.formats.records import by_pictures, check_size, scheme_of_records, without_gaps
from workbench.tracking import FrameObservation
from workbench.tracking.observation import motion_of

CANVAS = 235
"""Grey level behind the landmarks of a file that comes without its pictures."""


class FileSource:
    """Landmarks that were stored before, with or without their pictures."""

    detector = None

    def __init__(
        self,
        paths: list[Path],
        frames: Frames | None,
        rows: range | None = None,
        keep_pictures: bool = False,
        compare_pictures: bool = False,
        names: Sequence[str] = (),
    ):
        """`rows`: the part of the file that counts. `keep_pictures` hands the pictures on with the observations,
        `compare_pictures` with those of the frame before. `names` are those of the image files, if they are such."""
        self._names, self._beyond = names, False
        self._paths, self._rows, self._keep = paths, rows, keep_pictures and frames is not None
        self._compares = compare_pictures and frames is not None
        self._count: int | None = None
        self._given_size = None if frames is None else _given_size(paths, frames)
        first = next(iter(self._records()), None)
        if first is None:
            selected = "" if rows is None else f" from {rows.start} to {rows.stop - 1}"
            raise InputError(f"{paths[0]} holds no frame{selected}; a landmark file has one row or entry per frame.")
        self.image_size = first.size
        self.scheme = scheme_of_records(self._records())
        self.frames = frames or _Canvas(self)
        self.count = self.frames.announced_count
        self.single_picture = frames is not None and frames.kind == "images" and self.count == 1
        self.views: list[Frames] = [] if frames is None else [frames]
        if self.single_picture and next(islice(self._records(), 1, None), None) is not None:
            raise InputError(
                f"{paths[0]} holds the landmarks of several frames, and {self.frames.name} is one picture; name a file "
                "with those of this picture."
            )

    def notes(self) -> list[str]:
        if self.views:
            file, clip = self._paths[0].name, self.frames.name
            told = f"{file} has rows beyond the last frame of {clip}; they are left out."
            return [*self.frames.notes, *([told] if self._beyond else [])]
        rows = self._rows
        return [] if rows is None else range_notes(self._paths[-1].name, rows.start, rows.stop - 1, self._count)

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        first = max(start - 1, 0) if self._compares else start
        pictures, records = self._pictures(first), islice(self._records(), start, None)
        before = next(pictures) if first < start else None
        # With pictures these are the frames: one without a record has no face.
        rows = chain(records, repeat(None)) if self.views else records
        for index, (picture, record) in enumerate(zip(pictures, rows, strict=False), start):
            motion = motion_of(before, picture) if self._compares else None
            kept = picture if self._keep else None
            landmarks = None if record is None else record.landmarks
            size = self._size(index, picture, record)
            yield FrameObservation(index, landmarks, size, "given", stills, picture=kept, motion=motion)
            before = picture
        self._beyond = next(records, None) is not None

    def _pictures(self, first: int) -> Iterator[UInt8[np.ndarray, "h w 3"] | None]:
        """The pictures from a frame on; None for those that are only counted, and without end where there are none.

        Only images are counted: the header of a video may announce more frames than it has, or fewer.
        """
        if not self.views:
            return repeat(None)
        if not (self._keep or self._compares) and self.frames.kind == "images":
            return repeat(None, max(self.count - first, 0))
        return (frame.picture for frame in self.frames.iterate(first))

    def _size(
        self, index: int, picture: UInt8[np.ndarray, "h w 3"] | None, record: LandmarkRecord | None
    ) -> tuple[int, int]:
        """(width, height) of a frame. Raises `InputError` for landmarks of a picture of another size."""
        if not self.views:
            return record.size
        landmarks = None if record is None else record.landmarks
        if picture is None:
            if landmarks is not None and landmarks.image_size == self.frames.image_size:
                return landmarks.image_size
            picture = next(self.frames.iterate(index)).picture  # images may differ in size from the first one
        if landmarks is not None:
            check_size(landmarks, picture.shape[1::-1], f"frame {index} of {self.frames.name}")
        return picture.shape[1::-1]

    def state(self) -> dict[str, np.ndarray]:
        return {}

    def _records(self) -> Iterator[LandmarkRecord]:
        files = (without_gaps(path, read_landmark_file(path, self._given_size)) for path in self._paths)
        records = chain.from_iterable(files)
        # A CSV names no pictures, and is not read as a whole.
        if self._names and self._paths[0].suffix.lower() != ".csv":
            records = by_pictures(records, self._names)
        if self._rows is None:
            yield from records
            return
        count = self._rows.start
        for record in islice(records, self._rows.start, self._rows.stop):
            count += 1
            yield record
        self._count = count


class _Canvas:
    """Plain pictures of the sizes that a landmark file names, to draw on."""

    kind, rate, announced_count = "images", RATE_OF_IMAGES, None

    def __init__(self, source: FileSource):
        self._source = source
        self.name = source._paths[0].stem
        self.image_size = source.image_size
        self.notes: list[str] = []

    def iterate(self, start: int = 0) -> Generator[Frame]:
        for observation in self._source.observations(start, {}, False):
            name = f"{self.name}-{observation.index}"
            yield Frame(observation.index, canvas(observation.image_size), 0.0, name)


def canvas(size: tuple[int, int]) -> UInt8[np.ndarray, "h w 3"]:
    """A plain picture of this (width, height)."""
    return np.full((size[1], size[0], 3), CANVAS, np.uint8)


def _given_size(paths: list[Path], frames: Frames) -> tuple[int, int]:
    """The size of the pictures, for landmark files that do not say it. Raises `InputError` where sizes differ."""
    if frames.kind == "images" and not all(states_size(path) for path in paths):
        # The size of a part of a folder is that of the folder's first photo, which may be no part of it.
        sizes = {frame.picture.shape[1::-1] for frame in frames.iterate()}
        if len(sizes) > 1:
            raise InputError(
                f"{paths[0]} does not say how large its pictures are, and those of {frames.name} differ in size; track "
                "them one by one."
            )
        return next(iter(sizes), frames.image_size)
    return frames.image_size


def open_source(
    paths: list[Path],
    config: Config,
    landmarks: Path | None,
    frames: tuple[int, int] | None = None,
    keep_pictures: bool = False,
) -> "workbench.pipeline.PictureSource | FileSource":
    """Frames and their landmarks: from a detector, or from a landmark file. Raises `InputError` for a mixture.

    `frames` are the first and last one that count.
    """
    rows = None if frames is None else range(frames[0], frames[1] + 1)
    of_landmarks = [path for path in paths if is_landmark_file(path)]
    if of_landmarks and (len(of_landmarks) < len(paths) or landmarks is not None):
        raise InputError("A run takes pictures or landmark files as input; for both, name the file with --landmarks.")
    if of_landmarks:
        return FileSource(paths, None, rows)
    opened = open_frames(paths if len(paths) > 1 else paths[0])
    names = image_names(opened)
    opened = opened if frames is None else FrameRange(opened, *frames)
    if landmarks is not None:
        return FileSource([landmarks], opened, rows, keep_pictures, config.compares_pictures, names)
    from workbench.pipeline.picture_source import picture_source  # here: it imports the detectors, which takes seconds

    return picture_source(opened, config, keep_pictures)
