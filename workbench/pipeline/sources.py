"""Where a run's frames and landmarks come from: a landmark file here, a detector in `picture_source.py`."""

from collections.abc import Generator, Iterator
from itertools import chain, islice, repeat
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

import workbench
from workbench.config import Config
from workbench.errors import InputError
from workbench.frames import RATE_OF_IMAGES, Frame, FrameRange, Frames, open_frames, range_notes
from workbench.landmarks.files import LandmarkRecord, is_landmark_file, read_landmark_file, states_size
from workbench.landmarks.formats.records import scheme_of_records, without_gaps
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
    ):
        """`rows`: the part of the file that counts. `keep_pictures` hands the pictures on with the observations,
        `compare_pictures` with those of the frame before."""
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

    def notes(self) -> list[str]:
        rows = self._rows
        ends = [] if rows is None else range_notes(self._paths[-1].name, rows.start, rows.stop - 1, self._count)
        return list(self.frames.notes) or ends

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        first = max(start - 1, 0) if self._compares else start
        frames = self.frames.iterate(first) if self._keep or self._compares else iter(())
        pictures = chain((frame.picture for frame in frames), repeat(None))
        before = next(pictures) if first < start else None
        for index, record in islice(enumerate(self._records()), start, None):
            picture = next(pictures)
            motion = motion_of(before, picture) if self._compares else None
            kept = picture if self._keep else None
            yield FrameObservation(index, record.landmarks, record.size, "given", stills, picture=kept, motion=motion)
            before = picture

    def state(self) -> dict[str, np.ndarray]:
        return {}

    def _records(self) -> Iterator[LandmarkRecord]:
        files = (without_gaps(path, read_landmark_file(path, self._given_size)) for path in self._paths)
        records = chain.from_iterable(files)
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
    opened = opened if frames is None else FrameRange(opened, *frames)
    if landmarks is not None:
        return FileSource([landmarks], opened, rows, keep_pictures, config.compares_pictures)
    from workbench.pipeline.picture_source import picture_source  # here: it imports the detectors, which takes seconds

    return picture_source(opened, config, keep_pictures)
