"""Where a run's frames and landmarks come from: a detector over pictures, a landmark file, several cameras."""

from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, islice, repeat
from pathlib import Path
from types import MappingProxyType

import numpy as np
from jaxtyping import UInt8

from workbench.config import Config
from workbench.errors import InputError
from workbench.frames import Frame, FrameRange, Frames, open_frames, range_notes, read_ahead
from workbench.geometry import read_rig
from workbench.landmarks.detection import LandmarkDetector
from workbench.landmarks.detectors import detector_scheme, fallback_note, make_detector
from workbench.landmarks.files import SUFFIXES, LandmarkRecord, read_landmark_file, states_size
from workbench.landmarks.formats.records import scheme_of_records
from workbench.landmarks.observations import Landmarks2D, of_ibug68
from workbench.landmarks.scheme import IBUG68
from workbench.landmarks.tracker_options import TrackerOptions
from workbench.landmarks.tracking import LandmarkTracker
from workbench.tracking import FrameObservation
from workbench.tracking.deep_target import energy_network, photo_landmarks
from workbench.tracking.fitting import PicturePair, motion_of

STILL_CONFIDENCE = 0.5
"""Median landmark confidence that a photo needs: no later frame would put a doubtful face right."""
CANVAS = 235
"""Grey level behind the landmarks of a file that comes without its pictures."""


def is_landmark_file(path: Path) -> bool:
    """Whether a path names a landmark file and not a picture or a video."""
    return path.suffix.lower() in SUFFIXES


class PictureSource:
    """Frames through a detector and, unless they are stills, through the landmark tracker."""

    def __init__(self, frames: Frames, detector: LandmarkDetector, config: Config, keep_pictures: bool = False):
        """`keep_pictures` hands every frame's picture on with its observation."""
        self.frames, self._keep, self._compares = frames, keep_pictures, config.compares_pictures
        self.single_picture = frames.kind == "images" and frames.announced_count == 1
        self.image_size = frames.image_size
        self.count = frames.announced_count
        self.detector, self.scheme = detector.name, detector_scheme(detector.name)
        self._fallback = fallback_note(config.landmarks.detector, detector.name)
        face = config.landmarks.face
        self._tracker = LandmarkTracker(detector, TrackerOptions(face=face))
        self._finder = LandmarkTracker(detector, TrackerOptions(face=face, accept_confidence=STILL_CONFIDENCE))

    @property
    def views(self) -> list[Frames]:
        """The pictures of every view."""
        return [self.frames]

    def notes(self) -> list[str]:
        return [*self.frames.notes, *([self._fallback] if self._fallback else [])]

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        if stills:
            yield from (observation for _, observation in self.stills(start))
            return
        frames, before = read_ahead(self.frames.iterate(max(start - 1, 0))), None
        if start:
            before = next(frames).picture
            self._tracker.restore(state, before)
        for frame in frames:
            height, width = frame.picture.shape[:2]
            found = self._tracker.step(frame.picture)
            times = (found.milliseconds["detect"], found.milliseconds["landmarks"])
            kept = frame.picture if self._keep else None
            motion = motion_of(before, frame.picture) if self._compares else None
            yield FrameObservation(
                frame.index, found.landmarks, (width, height), found.source, found.cut, times, kept, motion=motion
            )
            before = frame.picture

    def stills(self, start: int = 0) -> Iterator[tuple[Frame, FrameObservation]]:
        """Each frame as a picture of its own, with what is found in it."""
        yield from ((frame, self._still(frame)) for frame in read_ahead(self.frames.iterate(start)))

    def state(self) -> dict[str, np.ndarray]:
        return self._tracker.state()

    def _still(self, frame: Frame) -> FrameObservation:
        height, width = frame.picture.shape[:2]
        self._finder.reset()
        found = self._finder.step(frame.picture)
        times = (found.milliseconds["detect"], found.milliseconds["landmarks"])
        kept = frame.picture if self._keep else None
        return FrameObservation(frame.index, found.landmarks, (width, height), found.source, True, times, picture=kept)


def _joined(motions: Sequence[PicturePair | None]) -> PicturePair | None:
    """The pairs of all views as one; None where a view has none."""
    if any(motion is None for motion in motions):
        return None
    return PicturePair(*(tuple(chain(*pictures)) for pictures in zip(*motions, strict=True)))


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
            raise InputError(f"{paths[0]} holds no frame; a landmark file has one row or entry per frame.")
        self.image_size = _size(first)
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
            yield FrameObservation(index, record.landmarks, _size(record), "given", stills, picture=kept, motion=motion)
            before = picture

    def state(self) -> dict[str, np.ndarray]:
        return {}

    def _records(self) -> Iterator[LandmarkRecord]:
        records = chain.from_iterable(read_landmark_file(path, self._given_size) for path in self._paths)
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

    kind, rate, announced_count = "images", 25.0, None

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
    if frames.kind == "images" and frames.announced_count != 1 and not all(states_size(path) for path in paths):
        sizes = {frame.picture.shape[1::-1] for frame in frames.iterate()}
        if len(sizes) > 1:
            raise InputError(
                f"{paths[0]} does not say how large its pictures are, and those of {frames.name} differ in size; track "
                "them one by one."
            )
    return frames.image_size


def _size(record: LandmarkRecord) -> tuple[int, int]:
    return record.landmarks.image_size if record.landmarks is not None else record.image_size


class RigSource:
    """Clips of one performance from several cameras, frame by frame; pictures are those of the first view."""

    def __init__(self, sources: Sequence["DeepSource"], names: Sequence[str]):
        self._sources, self._names = sources, names
        reference = sources[0]
        self.frames, self.image_size, self.detector = reference.frames, reference.image_size, reference.detector
        counts = [source.count for source in sources if source.count is not None]
        self.count = min(counts) if counts else None
        self.single_picture = all(source.single_picture for source in sources)
        self.views, self.scheme = [source.frames for source in sources], IBUG68

    def notes(self) -> list[str]:
        counts = {name: source.count for name, source in zip(self._names, self._sources, strict=True)}
        unequal = len({count for count in counts.values() if count is not None}) > 1
        listed = ", ".join(f"{name}: {count}" for name, count in counts.items())
        uneven = [f"The views have different numbers of frames ({listed}); the shortest counts."] if unequal else []
        return [*dict.fromkeys(note for source in self._sources for note in source.notes()), *uneven]

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        streams = [source.observations(start, {}, stills) for source in self._sources]
        # Not strict: the shortest clip ends the run.
        for reference, *others in zip(*streams, strict=False):
            motion = _joined([reference.motion, *(other.motion for other in others)])
            yield replace(reference, others=tuple(other.landmarks for other in others), motion=motion)

    def state(self) -> dict[str, np.ndarray]:
        return {}


class DeepSource:
    """Another source's frames with N(F*) in place of the detector's landmarks."""

    def __init__(self, source: PictureSource | FileSource, config: Config):
        self._source = source
        self._network = energy_network(config.deep.network)
        self.frames, self.image_size, self.detector = source.frames, source.image_size, source.detector
        self.count, self.single_picture = source.count, source.single_picture
        self.views, self.scheme = source.views, IBUG68
        self._without_pictures = False

    def notes(self) -> list[str]:
        given = "Without pictures the given landmarks stand for what the network would see in them."
        return [*self._source.notes(), *([given] if self._without_pictures else [])]

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        for observation in self._source.observations(start, state, stills):
            landmarks = self._target(observation.picture, observation.landmarks)
            yield replace(observation, landmarks=landmarks)

    def state(self) -> dict[str, np.ndarray]:
        return self._source.state()

    def _target(self, picture: np.ndarray | None, landmarks: Landmarks2D | None) -> Landmarks2D | None:
        if landmarks is None:
            return None
        if picture is None:
            self._without_pictures = True
            return of_ibug68(landmarks)
        return photo_landmarks(self._network, picture, landmarks)


def open_source(
    paths: list[Path],
    config: Config,
    landmarks: Path | None,
    frames: tuple[int, int] | None = None,
    keep_pictures: bool = False,
) -> PictureSource | FileSource:
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
    detector = make_detector(config.landmarks.detector, config.landmarks.face_landmarker)
    return PictureSource(opened, detector, config, keep_pictures)


def open_deep_source(
    paths: list[Path],
    config: Config,
    landmarks: Path | None,
    frames: tuple[int, int] | None = None,
    views: Mapping[str, Path] = MappingProxyType({}),
) -> DeepSource | RigSource:
    """The source of a Deep Energies run; `views` are the clips of a rig's other cameras by the views' names.

    Raises `InputError` for views that the rig does not have or that are missing.
    """
    reference = open_source(paths, config, landmarks, frames, keep_pictures=True)
    if not config.camera.rig:
        if views:
            raise InputError("Clips of several views need their calibration; name the rig file (camera.rig, --rig).")
        return DeepSource(reference, config)
    names = read_rig(config.camera.rig).names
    unknown = [name for name in views if name not in names[1:]]
    missing = [name for name in names[1:] if name not in views]
    if unknown or missing:
        what = f"has no view {unknown[0]!r}" if unknown else f"needs the clip of its view {missing[0]!r}"
        raise InputError(
            f"The rig {what}; the input is its first view {names[0]!r}, and the others ({', '.join(names[1:])}) are "
            "given as --view NAME=CLIP."
        )
    others = [open_source([views[name]], config, None, frames, keep_pictures=True) for name in names[1:]]
    return RigSource([DeepSource(source, config) for source in (reference, *others)], names)
