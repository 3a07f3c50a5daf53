"""The main job: pictures, a video or a landmark file in; a folder with the track, tables and pictures out."""

import hashlib
import importlib.metadata
import json
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from workbench import __version__
from workbench.config import Config, write_config
from workbench.errors import InputError
from workbench.export import summary_of, write_parameter_table, write_summary
from workbench.face import FaceModel
from workbench.frames import Frame, Frames, ImageFrames, open_frames
from workbench.landmarks.detectors import LandmarkDetector, fallback_note, make_detector
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, read_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.tracking import LandmarkTracker, TrackerOptions
from workbench.tracking import FaceTracker, FrameFit, FrameObservation, Track
from workbench.tracking.track_writer import TrackWriter

LANDMARK_SUFFIXES = (".csv", ".json", ".pts")
PACKAGES = ("jax", "optimistix", "numpy", "scipy", "opencv-contrib-python-headless", "pyvista")
STILL_CONFIDENCE = 0.5
"""Median landmark confidence that a photo needs: no later frame would put a doubtful face right."""
CANVAS = 235
"""Grey level behind the landmarks of a file that comes without its pictures."""

Progress = Callable[[str, int, int | None], None]
"""Called with the name of a step, the frames done, and the frames in all if known."""


@dataclass(frozen=True)
class RunResult:
    """What a run leaves behind."""

    folder: Path
    summary: dict[str, Any]
    files: tuple[Path, ...]
    notes: tuple[str, ...] = field(default=())
    """What a user should know: a damaged file, pictures that could not be made as they should."""

    @property
    def track(self) -> Track:
        """The track, read from its file."""
        return Track.load(self.folder / "track.npz")


def is_landmark_file(path: Path) -> bool:
    """Whether a path names a landmark file and not a picture or a video."""
    return path.suffix.lower() in LANDMARK_SUFFIXES


def track(
    inputs: str | Path | Sequence[str | Path],
    folder: str | Path,
    model: FaceModel,
    config: Config,
    *,
    stills: bool = False,
    pictures: bool = True,
    resume: bool = False,
    landmarks: Path | None = None,
    progress: Progress | None = None,
) -> RunResult:
    """Track a video, a folder, photos or a landmark file into `folder`; see `OUTPUTS` for what it holds afterwards.

    `stills` treats every picture on its own. `landmarks` is a file with the landmarks of the pictures: no detector
    runs. `resume` goes on with an interrupted run of the same input and
    configuration. An interrupted run (Ctrl-C) keeps its finished parts for that. Raises `InputError` for an input
    that cannot be used.
    """
    paths = [Path(path) for path in ([inputs] if isinstance(inputs, str | Path) else inputs)]
    if not paths:
        raise InputError("There is nothing to track; name a photo, a folder, a video or a landmark file.")
    folder, progress = Path(folder), progress or _silent
    source = open_source(paths, config, landmarks)
    stills = stills or source.single_picture
    tracker = FaceTracker(model, config, stills=stills)
    tracker.warm_up(source.image_size)
    folder.mkdir(parents=True, exist_ok=True)
    meta = _meta(paths, landmarks, model, config, stills, source)
    writer = TrackWriter(folder / "track.npz", meta, _fingerprint(meta), resume)
    began, already = time.perf_counter(), len(writer)
    try:
        _track_frames(source, tracker, writer, stills, progress)
    except InputError:
        writer.discard()
        raise
    if not len(writer):
        writer.discard()
        raise InputError(f"{paths[0]} holds no frame to track; check that it plays.")
    seconds = time.perf_counter() - began
    summary = summary_of(writer.tracks(), seconds if not already else None)
    notes = [*source.notes()]
    files = _write_tables(writer, summary, model, config, folder)
    if pictures:
        files += _write_pictures(source, writer, model, stills, folder, progress, notes)
    writer.close()
    return RunResult(folder, summary, (folder / "track.npz", *files), tuple(notes))


OUTPUTS = {
    "track.npz": "everything, for the notebooks (`workbench.Track.load`)",
    "summary.json": "errors, times, camera",
    "parameters.csv": "a row a frame: pose, 44 weights, errors",
    "landmarks.csv": "a row a frame: the 68 detected points",
    "config.toml": "the configuration used",
    "overlay.mp4": "the landmarks on the picture, the 3D face beside it (overlay/ with pictures for stills)",
}


def _silent(step: str, done: int, total: int | None) -> None:
    """No progress is shown."""


class PictureSource:
    """Frames through a detector and, unless they are stills, through the landmark tracker."""

    def __init__(self, frames: Frames, detector: LandmarkDetector, config: Config):
        self.frames = frames
        self.single_picture = frames.kind == "images" and frames.announced_count == 1
        self.image_size = frames.image_size
        self.count = frames.announced_count
        self.detector = detector.name
        self._fallback = fallback_note(config.landmarks.detector, detector.name)
        face = config.landmarks.face
        self._tracker = LandmarkTracker(detector, TrackerOptions(face=face))
        self._finder = LandmarkTracker(detector, TrackerOptions(face=face, accept_confidence=STILL_CONFIDENCE))

    def notes(self) -> list[str]:
        return [*self.frames.notes, *([self._fallback] if self._fallback else [])]

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        if stills:
            yield from (observation for _, observation in self.stills(start))
            return
        frames = self.frames.iterate(max(start - 1, 0))
        if start:
            self._tracker.restore(state, next(frames).picture)
        for frame in frames:
            height, width = frame.picture.shape[:2]
            found = self._tracker.step(frame.picture)
            times = (found.milliseconds["detect"], found.milliseconds["landmarks"])
            yield FrameObservation(frame.index, found.landmarks, (width, height), found.source, found.cut, times)

    def stills(self, start: int = 0) -> Iterator[tuple[Frame, FrameObservation]]:
        """Each frame as a picture of its own, with what is found in it."""
        yield from ((frame, self._still(frame)) for frame in self.frames.iterate(start))

    def state(self) -> dict[str, np.ndarray]:
        return self._tracker.state()

    def _still(self, frame: Frame) -> FrameObservation:
        height, width = frame.picture.shape[:2]
        self._finder.reset()
        found = self._finder.step(frame.picture)
        times = (found.milliseconds["detect"], found.milliseconds["landmarks"])
        return FrameObservation(frame.index, found.landmarks, (width, height), found.source, True, times)


class FileSource:
    """Landmarks that were stored before, with or without their pictures."""

    detector = None

    def __init__(self, paths: list[Path], frames: Frames | None):
        self._paths = paths
        first = next(iter(self._records()), None)
        if first is None:
            raise InputError(f"{paths[0]} holds no frame; a landmark file has a row or an entry a frame.")
        self.image_size = _size(first)
        self.frames = frames or _Canvas(self)
        self.count = self.frames.announced_count
        self.single_picture = frames is not None and frames.kind == "images" and self.count == 1

    def notes(self) -> list[str]:
        return list(self.frames.notes)

    def observations(self, start: int, state: dict[str, np.ndarray], stills: bool) -> Iterator[FrameObservation]:
        for index, record in enumerate(self._records()):
            if index >= start:
                yield FrameObservation(index, record.landmarks, _size(record), "given", stills)

    def state(self) -> dict[str, np.ndarray]:
        return {}

    def _records(self) -> Iterator[LandmarkRecord]:
        for path in self._paths:
            yield from read_landmark_file(path)


class _Canvas:
    """Plain pictures of the sizes that a landmark file names, to draw on."""

    kind, rate, announced_count = "images", 25.0, None

    def __init__(self, source: FileSource):
        self._source = source
        self.name = source._paths[0].stem
        self.image_size = source.image_size
        self.notes: list[str] = []

    def iterate(self, start: int = 0) -> Iterator[Frame]:
        for observation in self._source.observations(start, {}, False):
            width, height = observation.image_size
            picture = np.full((height, width, 3), CANVAS, np.uint8)
            yield Frame(observation.index, picture, 0.0, f"{self.name}-{observation.index}")


def _size(record: LandmarkRecord) -> tuple[int, int]:
    return record.landmarks.image_size if record.landmarks is not None else record.image_size


def open_source(paths: list[Path], config: Config, landmarks: Path | None) -> PictureSource | FileSource:
    """Frames and their landmarks: from a detector, or from a landmark file. Raises `InputError` for a mixture."""
    of_landmarks = [path for path in paths if is_landmark_file(path)]
    if of_landmarks and (len(of_landmarks) < len(paths) or landmarks is not None):
        raise InputError("A run takes pictures or landmark files as input; for both, name the file with --landmarks.")
    if of_landmarks:
        return FileSource(paths, None)
    frames = open_frames(paths if len(paths) > 1 else paths[0])
    if landmarks is not None:
        return FileSource([landmarks], frames)
    return PictureSource(frames, make_detector(config.landmarks.detector), config)


def _track_frames(source, tracker: FaceTracker, writer: TrackWriter, stills: bool, progress: Progress) -> None:
    state = writer.state()
    if len(writer):
        tracker.restore(_prefixed(state, "tracker/"))
    observations = source.observations(len(writer), _prefixed(state, "landmarks/"), stills)
    done = len(writer)

    def store() -> None:
        # Only between frames that are all fitted do tracker, landmarks and written frames stand at one place.
        of_tracker = tracker.state()
        if of_tracker is not None:
            of_landmarks = {f"landmarks/{name}": value for name, value in source.state().items()}
            writer.write_part({f"tracker/{name}": value for name, value in of_tracker.items()} | of_landmarks)

    try:
        for observation in observations:
            for fit in tracker.push(observation):
                writer.add(fit)
            done += 1
            progress("track", done, source.count)
            if writer.wants_part():
                store()
    except KeyboardInterrupt:
        store()
        raise
    for fit in tracker.finish():
        writer.add(fit)
    store()


def _prefixed(state: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}


def _write_tables(writer, summary, model, config, folder: Path) -> tuple[Path, ...]:
    write_summary(summary, folder / "summary.json")
    write_parameter_table(writer.tracks(), model.expression_names, folder / "parameters.csv")
    with LandmarkCsvWriter(folder / "landmarks.csv", confidence=False) as table:
        for position in range(len(writer)):
            table.write(landmark_record(writer[position]))
    write_config(config, folder / "config.toml")
    return tuple(folder / name for name in ("summary.json", "parameters.csv", "landmarks.csv", "config.toml"))


def landmark_record(fit: FrameFit) -> LandmarkRecord:
    """The observed landmarks of a fit as a row of a landmark file."""
    landmarks = Landmarks2D(fit.observed, fit.confidence, fit.image_size) if fit.found else None
    return LandmarkRecord(fit.index, f"frame-{fit.index}", landmarks, fit.image_size)


def _write_pictures(source, writer, model, stills, folder, progress, notes) -> tuple[Path, ...]:
    from workbench.pictures.overlay_files import write_overlay_picture, write_overlay_video  # VTK: a second to import

    total = len(writer)
    if not stills:
        path = folder / "overlay.mp4"
        note = write_overlay_video(
            source.frames, writer, model, path, progress=lambda done, total: progress("overlay", done, total)
        )
        notes += [note] if note else []
        return (path,)
    made = []
    for frame in source.frames.iterate():
        name = "overlay.png" if total == 1 else f"overlay/{frame.index:04d}-{Path(frame.name).stem}.jpg"
        note = write_overlay_picture(folder / name, frame.picture, writer[frame.index], model)
        if note and note not in notes:
            notes.append(note)
        made.append(folder / name)
        progress("overlay", len(made), total)
    return tuple(made)


def _meta(paths, landmarks: Path | None, model: FaceModel, config: Config, stills: bool, source) -> dict[str, Any]:
    return {
        "expression_names": list(model.expression_names),
        "stages": [stage.name for stage in config.stages if stage.enabled],
        "config": json.loads(config.model_dump_json()),
        "inputs": [{"path": str(path), "sha256": content_hash(path)} for path in paths],
        "landmarks": None if landmarks is None else {"path": str(landmarks), "sha256": content_hash(landmarks)},
        "detector": source.detector,
        "names": _names(source.frames) if stills else [],
        "stills": stills,
        "rate": source.frames.rate,
        "camera_guessed": config.camera.matrix is None,
        "model": {"name": model.name, "sha256": model.fingerprint()},
        "versions": software_versions(),
    }


def software_versions() -> dict[str, str]:
    """Versions of what the numbers of a run depend on."""
    return {"workbench": __version__} | {name: importlib.metadata.version(name) for name in PACKAGES}


def _names(frames: Frames) -> list[str]:
    if isinstance(frames, ImageFrames):
        return [path.name for path in frames.paths]  # reading large photos once more for this would take long
    return [frame.name for frame in frames.iterate()]


def _fingerprint(meta: dict[str, Any]) -> str:
    """The metadata holds all that a run depends on: inputs, configuration, model, versions.

    Of the detector only which one ran counts, not whether it was asked for by name or by "auto".
    """
    landmarks = {**meta["config"]["landmarks"], "detector": meta["detector"]}
    run = {**meta, "config": {**meta["config"], "landmarks": landmarks}}
    return hashlib.sha256(json.dumps(run, sort_keys=True).encode()).hexdigest()


def content_hash(path: Path) -> str:
    """SHA-256 of a file, or of the files of a folder in order."""
    digest = hashlib.sha256()
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in files:
        if file.is_file():
            with file.open("rb") as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()
