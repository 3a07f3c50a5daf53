"""The main job: pictures, a video or a landmark file in; a folder with the track, tables and pictures out."""

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from workbench.config import NAMED_FILES, Config, write_config
from workbench.energies.terms import TABLE
from workbench.errors import InputError, LostSchedulerError, OutputError
from workbench.export import summary_of, write_parameter_table, write_summary
from workbench.export.sources import input_files, reference_inputs
from workbench.face import FaceModel, dressed_as, fits_as, in_scheme
from workbench.frames import Frames, ImageFrames, files_read
from workbench.landmarks.files import LandmarkCsvWriter, LandmarkRecord, is_landmark_file
from workbench.landmarks.formats import pts
from workbench.landmarks.scheme import LandmarkScheme
from workbench.landmarks.schemes import OF_DETECTORS
from workbench.pictures.overlay_files import write_overlay_video
from workbench.pipeline.deep_run import track_deep_frames, write_strips
from workbench.pipeline.deep_sources import open_deep_source
from workbench.pipeline.output_folder import FILES, PARTS, TRACKS, drawn_in, keeps_frames, remove_earlier, run_folder
from workbench.pipeline.provenance import software_versions
from workbench.pipeline.sources import open_source
from workbench.pipeline.still_pictures import StillPictures
from workbench.pipeline.temporal_run import (
    Step,
    look_at_pictures,
    needs_pictures,
    over_time,
    views_of,
    wanted_steps,
    worked_meta,
)
from workbench.pipeline.watched_files import WatchedFiles
from workbench.planning import plan_of
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit, FrameObservation, Track
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.track_layout import file_record, model_record, scheme_of, scheme_record
from workbench.tracking.track_reader import TrackReader
from workbench.tracking.track_writer import UNREFINED, TrackWriter, begun_run, has_parts
from workbench.tracking.unwatched import silent
from workbench.workers import ThisProcess, Workers, ready, working

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


def track(
    inputs: str | Path | Sequence[str | Path],
    folder: str | Path,
    model: FaceModel,
    config: Config,
    *,
    stills: bool = False,
    pictures: bool = True,
    resume: bool = False,
    overwrite: bool = False,
    landmarks: Path | None = None,
    frames: tuple[int, int] | None = None,
    views: Mapping[str, Path] = MappingProxyType({}),
    workers: int | Workers = 1,
    progress: Progress | None = None,
) -> RunResult:
    """Track a video, a folder, photos or a landmark file into `folder`; see `OUTPUTS` for what it holds afterwards.

    `stills` treats every picture on its own. `landmarks` is a file with the landmarks of the pictures: no detector
    runs. `frames` are the first and last one of a part. `views` are the clips of a rig's other cameras by the views'
    names, `workers` how many processes fit, or who does (`workbench.workers`); both are for Deep Energies. `resume`
    continues a run of the same input and configuration by the same versions, whose finished parts are kept when it is
    interrupted; `overwrite` replaces what an earlier run left. With both, a run that cannot be continued is replaced.
    Raises `InputError` for an input that cannot be used, `OutputError` for a folder that cannot be written, holds
    another run, or whose files are inputs, and `LostSchedulerError`.
    """
    paths = [Path(path) for path in ([inputs] if isinstance(inputs, str | Path) else inputs)]
    if not paths:
        raise InputError("There is nothing to track; name a photo, a folder, a video or a landmark file.")
    alone = workers == 1 or isinstance(workers, ThisProcess)
    if not config.traits.renders and (views or not alone):
        raise InputError("Several views and several processes belong to Deep Energies; add --preset deep.")
    files = [*paths, *views.values(), *_given(landmarks), *_given(config.camera.rig)]
    job = _Job(Path(folder), model, config, pictures, resume, overwrite, workers, progress or silent)
    with run_folder(job.folder, files, resume, overwrite):
        watched = WatchedFiles([*_named_paths(config), *_points_in([*paths, *views.values()], landmarks)])
        if config.traits.renders:
            source = open_deep_source(paths, config, landmarks, frames, views)
        else:
            source = open_source(paths, config, landmarks, frames, keep_pictures=stills and pictures)
        stills = stills or source.single_picture
        job = replace(job, model=in_scheme(model, source.scheme))
        watched.add(_pictures_of(source.views))
        meta = _meta([*paths, *views.values()], landmarks, job.model, config, stills, source)
        meta["frames"] = None if frames is None else list(frames)
        meta["views"] = {name: str(path.absolute()) for name, path in views.items()}
        _check_begun(job, meta)
        finished = _finished(job, meta)
        if finished is not None:
            return finished
        with _telling_what_is_kept(job.folder):
            return _run(job, source, meta, stills, watched)


@dataclass(frozen=True)
class _Job:
    """What a call of `track` asks for, apart from its input."""

    folder: Path
    model: FaceModel
    config: Config
    pictures: bool
    resume: bool
    overwrite: bool
    workers: int | Workers
    progress: Progress

    @property
    def steps(self) -> tuple[Step, ...]:
        return wanted_steps(self.config)

    @property
    def fits_path(self) -> Path:
        """Where the fits of single frames go."""
        return self.folder / (UNREFINED if self.steps else "track.npz")


def _given(path: str | Path | None) -> tuple[Path, ...]:
    return (Path(path),) if path else ()


@contextmanager
def _telling_what_is_kept(folder: Path) -> Iterator[None]:
    """Say in an `OutputError` that ends a run what is left of it."""
    try:
        yield
    except LostSchedulerError:  # says so itself
        raise
    except OutputError as error:
        if not keeps_frames(folder):
            raise
        raise OutputError(f"{error} Finished parts are kept; the run can be resumed (--resume).") from error


def _check_begun(job: _Job, meta: dict[str, Any]) -> None:
    """Raise `OutputError` if a run to be resumed would start again over the parts of another one."""
    if not job.resume or job.overwrite:
        return
    own = [meta, worked_meta(meta, job.config, job.steps)]
    places = [job.folder / name for name in TRACKS]
    found = [begun for place in places if (begun := begun_run(place)) is not None]
    if found and not any(has_parts(place, _begun_as(place, meta)) for place in places for meta in own):
        what = f"an interrupted run {_unlike(found[0][1], own)}"
        raise OutputError(f"{job.folder} holds {what}, or replace it with --overwrite.")


def _unlike(made: dict[str, Any], wanted: Sequence[dict[str, Any]]) -> str:
    """What another run, by its metadata, has that the wanted one lacks, and what to do other than replace it."""
    was, now = made.get("versions"), wanted[0]["versions"]
    if was not in (None, now) and _fingerprint({**made, "versions": now}) in map(_fingerprint, wanted):
        names = [name for name in {**was, **now} if was.get(name) != now.get(name)]
        listed = ", ".join(f"{name} {was.get(name, 'none')}, now {now.get(name, 'none')}" for name in names)
        return f"that was started with other versions ({listed}); install those again, name another folder"
    ran, runs = made.get("detector"), wanted[0]["detector"]
    if ran and runs and ran != runs and _fingerprint({**made, "detector": runs}) in map(_fingerprint, wanted):
        return f"that was started with the detector {ran}; continue with --detector {ran}, name another folder"
    return "of another input or configuration; name another folder"


def _finished(job: _Job, meta: dict[str, Any]) -> RunResult | None:
    """The result of a run to be resumed that has nothing left to do; None for others.

    Raises `OutputError` where the folder holds a finished run of something else.
    """
    stored = job.folder / "track.npz"
    if not job.resume or not stored.exists() or has_parts(job.fits_path, _begun_as(job.fits_path, meta)):
        return None
    reader = TrackReader(stored)
    made = {name: value for name, value in reader.meta.items() if name not in ("format", "format_version")}
    wanted = worked_meta(meta, job.config, job.steps) if job.steps else meta
    if _fingerprint(made) == _fingerprint(wanted):
        files = [path for path in map(job.folder.joinpath, FILES) if path.exists()]
        for name in PARTS:
            shutil.rmtree(job.folder / name, ignore_errors=True)
        note = "This run was already finished; --overwrite without --resume repeats it."
        return RunResult(job.folder, summary_of(reader.blocks(), None), (*files, *drawn_in(job.folder)), (note,))
    if job.overwrite:
        return None
    raise OutputError(f"{job.folder} holds a finished run {_unlike(made, [wanted])}, or replace it with --overwrite.")


def _run(job: _Job, source, meta: dict[str, Any], stills: bool, watched: WatchedFiles) -> RunResult:
    folder, model, config, progress, steps = job.folder, job.model, job.config, job.progress, job.steps
    if steps and stills:
        raise InputError("Unrelated photos have no neighbours in time; leave infill and refinement out, or --stills.")
    if not source.views and (need := needs_pictures(config, steps)):
        raise InputError(
            f"The method {need!r} needs the pictures, and the input has none; track the clip and name the file with "
            "--landmarks, or choose another method."
        )
    if steps:
        # Settings of the flow that cannot be used are refused before a clip is fitted for nothing.
        FlowFitter(model, plan_of(config, model.scheme))
    # A character that cannot be drawn is refused before a clip is fitted for nothing.
    dressed = dressed_as(config.head.character, model) if job.pictures else None
    tracker = FaceTracker(model, config, stills=stills)
    tracker.warm_up(source.image_size)
    writer = TrackWriter(job.fits_path, meta, _begun_as(job.fits_path, meta), job.resume, watched.check)
    already, strips = len(writer), []
    deep = config.traits.renders
    told, files = [], ()
    with ExitStack() as stack:
        workers, drawn = ready(stack.enter_context(working(job.workers))), None
        began = time.perf_counter()
        if stills and job.pictures:
            drawn = stack.enter_context(StillPictures(source, model, meta["names"], folder, dressed))
            drawn.add_missing(writer)
        try:
            if deep:
                strips = track_deep_frames(source, tracker, writer, stills, workers, progress, drawn)
            else:
                _track_frames(source, tracker, writer, stills, progress, drawn)
            if not len(writer):
                raise InputError(f"{meta['inputs'][0]['path']} holds no frame to track; check that it plays.")
        except InputError:
            if not len(writer):
                writer.discard()
                if drawn is not None:
                    drawn.discard()
            raise
        if drawn is not None:
            files, told = drawn.files(len(writer)), drawn.notes()
    written = writer
    if steps:
        fits, count = _fits(writer), len(writer)
        written = _over_time(fits, source.views, model, config, steps, meta, folder, progress, count, watched)
    seconds = time.perf_counter() - began
    summary = summary_of(written.tracks(), seconds if not already else None)
    files = _write_tables(written, summary, model, config, folder) + files
    if job.pictures and deep:
        files += write_strips(strips, tracker.fitter, folder, progress)
    if job.pictures and not stills:
        files += _write_film(source.frames, written, model, dressed, folder, progress, told)
    files = (folder / "track.npz", *((folder / UNREFINED,) if steps else ()), *files)
    watched.check()  # the film read them once more
    if job.overwrite:
        remove_earlier(folder, files)
    for finished in dict.fromkeys((writer, written)):  # track.npz comes last: with it a run is finished
        finished.close()
    # What was odd in the pictures is known when all of them were read, for the film at the latest.
    return RunResult(folder, summary, files, (*source.notes(), *told, *_blind_terms(config, model.scheme)))


def _blind_terms(config: Config, scheme: LandmarkScheme) -> list[str]:
    """A note where stages name terms of pupils, which landmarks of this scheme do not have."""
    blind = [name for name, term in TABLE.items() if term.of_pupils and name in config.summed_terms]
    if not blind or "pupils" in scheme.groups:
        return []
    seeing = " or ".join(name for name, seen in OF_DETECTORS.items() if "pupils" in seen.groups)
    said = f"These landmarks have no pupils: eyes do not turn, and {', '.join(blind)} have no effect"
    return [f"{said}; use those of the detector {seeing}."]


def retrack(
    stored: str | Path,
    folder: str | Path,
    model: FaceModel,
    config: Config,
    steps: Sequence[Step],
    *,
    pictures: bool = True,
    overwrite: bool = False,
    clip: Path | None = None,
    views: Mapping[str, Path] = MappingProxyType({}),
    progress: Progress | None = None,
) -> RunResult:
    """Infill, refine or re-estimate a stored track into `folder`: a new track and the tables of `track`.

    `config` is the track's own (`config_of`) with changes; `clip` and `views` say where the pictures are now, if they
    were moved. Steps that do not look at pictures need none; without them no film is drawn. `overwrite` replaces what
    an earlier run left. Raises `InputError` for a track, model or pictures that cannot be used, and `OutputError` as
    `track` does.
    """
    folder, progress = Path(folder), progress or silent
    reader = TrackReader(stored)
    model = in_scheme(model, scheme_of(reader.meta))
    check_model(reader.meta, model)
    if (folder / "track.npz").exists() and (folder / "track.npz").samefile(reader.path):
        raise InputError(f"{folder} holds the track itself; choose another folder for the new one.")
    dressed = dressed_as(config.head.character, model) if pictures else None
    watched = WatchedFiles([reader.path, *_named_paths(config)])
    opened = views_of(reader.meta, config, clip, views, look_at_pictures(config, steps), pictures)
    watched.add(_pictures_of(opened))
    inputs = [reader.path, *_given(clip), *views.values(), *_given(config.camera.rig), *input_files(reader.meta)]
    with run_folder(folder, inputs, resume=False, overwrite=overwrite, resumable=False):
        began = time.perf_counter()
        of_track = {name: value for name, value in reader.meta.items() if name != "files"}
        meta = {**of_track, "track": file_record(reader.path), **_named_files(config)}
        writer = _over_time(reader, opened, model, config, steps, meta, folder, progress, len(reader), watched)
        try:
            summary = summary_of(writer.tracks(), time.perf_counter() - began)
            files, told = _write_tables(writer, summary, model, config, folder), []
            if pictures and opened:
                files += _write_film(opened[0], writer, model, dressed, folder, progress, told)
            elif pictures and not any(map(is_landmark_file, reference_inputs(reader.meta))):
                told.append("No film was drawn: the pictures of this track are no longer there; name them with --clip.")
            files = (folder / "track.npz", *files)
            watched.check()  # the film read them once more
            if overwrite:
                remove_earlier(folder, files)
            writer.close()
        except BaseException:
            writer.discard()  # none of these steps goes on where it was interrupted
            raise
        notes = [note for frames in opened for note in frames.notes]
        return RunResult(folder, summary, files, (*notes, *told))


def check_model(meta: Mapping[str, Any], model: FaceModel) -> None:
    """Raise `InputError` unless a track was made with this face model."""
    made = meta.get("model", {})
    if made.get("sha256") is not None and not fits_as(model, made["sha256"]):
        raise InputError(f"The track was made with the face model {made.get('name')!r}; pass that one with --model.")


def _over_time(
    fits: Iterable[FrameFit],
    views,
    model,
    config,
    steps,
    meta,
    folder: Path,
    progress: Progress,
    total: int,
    watched: WatchedFiles,
) -> TrackWriter:
    """The writer of the new track, all of its frames in it."""
    meta = worked_meta(meta, config, steps)
    writer = TrackWriter(folder / "track.npz", meta, _fingerprint(meta), check=watched.check)
    try:
        for fit in over_time(fits, views, model, config, steps, progress, total):
            writer.add(fit)
            if writer.wants_part():
                writer.write_part({})
        writer.write_part({})
    except BaseException:
        writer.discard()
        raise
    return writer


def _fits(writer: TrackWriter) -> Iterator[FrameFit]:
    for part in writer.tracks():
        yield from (part[position] for position in range(len(part)))


def _track_frames(
    source,
    tracker: FaceTracker,
    writer: TrackWriter,
    stills: bool,
    progress: Progress,
    drawn: StillPictures | None = None,
) -> None:
    state = writer.state()
    if len(writer):
        tracker.restore(_prefixed(state, "tracker/"))
    observations = source.observations(len(writer), _prefixed(state, "landmarks/"), stills)
    done = added = len(writer)
    whole: tuple[int, dict[str, np.ndarray]] | None = None

    def take(fits: list[FrameFit], observation: FrameObservation | None = None) -> None:
        # Only between frames that are all fitted do tracker, landmarks and written frames stand at one place.
        nonlocal added, whole
        for fit in fits:
            if drawn is not None and observation is not None:
                drawn.add(observation, fit)  # a still is fitted as soon as it comes
            writer.add(fit)
            added += 1
        of_tracker = tracker.state()
        if of_tracker is not None:
            of_landmarks = {f"landmarks/{name}": value for name, value in source.state().items()}
            whole = added, {f"tracker/{name}": value for name, value in of_tracker.items()} | of_landmarks

    def store() -> None:
        if whole is not None and whole[0] == added:
            if drawn is not None:
                drawn.flush()  # the frames of a part have their pictures
            writer.write_part(whole[1])

    try:
        for observation in observations:
            take(list(tracker.push(observation)), observation)
            done += 1
            progress("track", done, source.count)
            if writer.wants_part():
                store()
    except KeyboardInterrupt:
        store()  # the state is that after the last whole frame: the next one may be begun
        raise
    take(list(tracker.finish()))
    store()


def _prefixed(state: dict[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)}


def _write_tables(writer, summary, model, config, folder: Path) -> tuple[Path, ...]:
    write_summary(summary, folder / "summary.json")
    write_parameter_table(writer.tracks(), model.expression_names, folder / "parameters.csv")
    with LandmarkCsvWriter(folder / "landmarks.csv", confidence=False, scheme=model.scheme) as table:
        for position in range(len(writer)):
            table.write(landmark_record(writer[position]))
    write_config(config, folder / "config.toml")
    return tuple(folder / name for name in ("summary.json", "parameters.csv", "landmarks.csv", "config.toml"))


def landmark_record(fit: FrameFit) -> LandmarkRecord:
    """The observed landmarks of a fit as a row of a landmark file."""
    return LandmarkRecord(fit.index, f"frame-{fit.index}", fit.landmarks, fit.image_size)


def _write_film(frames, writer, model, dressed, folder, progress, notes) -> tuple[Path, ...]:
    path = folder / "overlay.mp4"

    def drawn(done: int, total: int) -> None:
        progress("overlay", done, total)

    note = write_overlay_video(frames, writer, model, path, drawn, dressed=dressed, rate=writer.meta.get("rate"))
    notes += [note] if note else []
    return (path,)


def _meta(paths, landmarks: Path | None, model: FaceModel, config: Config, stills: bool, source) -> dict[str, Any]:
    return {
        "expression_names": list(model.expression_names),
        "stages": [stage.name for stage in config.stages if stage.enabled],
        "config": json.loads(config.model_dump_json()),
        "inputs": [file_record(path) for path in paths],
        "landmarks": None if landmarks is None else file_record(landmarks),
        "detector": source.detector,
        "names": _names(source.frames) if stills else [],
        "stills": stills,
        "rate": source.frames.rate,
        "camera_guessed": config.camera.guessed,
        "model": model_record(model),
        **scheme_record(model.scheme),
        "versions": software_versions(),
        **_named_files(config),
    }


def _named_files(config: Config) -> dict[str, Any]:
    """The files of a configuration that fits depend on, for a track's metadata; nothing where it names none."""
    files = [file_record(path) for path in _named_paths(config)]
    return {"files": files} if files else {}


def _named_paths(config: Config) -> list[Path]:
    named = [Path(getattr(getattr(config, section), key)) for section, key in NAMED_FILES]
    return [path for path in named if path.suffix and path.is_file()]


def _points_in(inputs: Sequence[Path], landmarks: Path | None) -> list[Path]:
    """The landmark files of a run; of a folder of .pts files these alone: what else comes into it is no input."""
    given = [*filter(is_landmark_file, inputs), *_given(landmarks)]
    return [file for path in given for file in (pts.files_in(path) if path.is_dir() else [path])]


def _pictures_of(views: Sequence[Frames]) -> list[Path]:
    return [path for view in views for path in files_read(view)]


def _names(frames: Frames) -> list[str]:
    if isinstance(frames, ImageFrames):
        return [path.name for path in frames.paths]  # reading large photos once more for this would take long
    return [frame.name for frame in frames.iterate()]


def _fingerprint(meta: dict[str, Any]) -> str:
    """The metadata holds all that a run depends on: inputs, configuration and its files, model, versions.

    The order of its entries counts, as later landmark weights overrule earlier ones. Of the detector only which one ran
    counts, not whether it was asked for by name or by "auto"; of inputs, and of files that the configuration names,
    what they hold, not where they are.
    """
    stored = meta["config"]
    config = {**stored, "landmarks": {**stored["landmarks"], "detector": meta["detector"]}}
    for section, key in NAMED_FILES:
        if meta.get("files") and Path(stored[section][key]).suffix:
            config[section] = {**stored[section], key: ""}
    run = {**meta, "config": config, "views": list(meta.get("views") or {})}
    for name in ("inputs", "files"):
        run[name] = [item.get("sha256") for item in meta.get(name, [])]
    run["landmarks"] = (meta.get("landmarks") or {}).get("sha256")
    return hashlib.sha256(json.dumps(run).encode()).hexdigest()


def _begun_as(path: Path, meta: dict[str, Any]) -> str:
    """The fingerprint of a run: the one that its parts at a track's path bear, where an older workbench named them."""
    begun = begun_run(path)
    return begun[0] if begun and begun[1] and _fingerprint(begun[1]) == _fingerprint(meta) else _fingerprint(meta)
