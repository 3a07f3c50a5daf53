"""A whole sweep: the plan of its points, the tasks, who does them, and what comes of it."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, count
from pathlib import Path
from typing import TypeVar

import numpy as np

from workbench.config import DEFAULT_PRESET, Config, preset
from workbench.errors import InputError, OutputError
from workbench.geometry import read_rig
from workbench.objectives import TABLE, folds_of
from workbench.sweeps.acting import check_axis
from workbench.sweeps.clips import chosen_windows, parts_of
from workbench.sweeps.outcome import SweepResult
from workbench.sweeps.results import folds_needed, result_key, stored_result
from workbench.sweeps.solving import check_swept
from workbench.sweeps.space import Axis, Point, Sampling, config_at, points_of
from workbench.sweeps.storage import Storage, anywhere
from workbench.sweeps.stored_clips import ClipSource, check_sources
from workbench.sweeps.tasks import FitTask, ModelSource, ObserveTask, model_source
from workbench.tracking.unwatched import silent
from workbench.workers import Failed, Workers

USUAL_OBJECTIVES = ("error", "left-out-points", "jitter", "iterations")
FITS = 1000
"""Fits of a task at most, folds included: about a second."""
DEFINITION = "sweep.json"
NO_VALUES = (
    "No objective has a value in the frames that were fitted, as where none of them has a face; fit more (--frames), "
    "or measure something else (--objective)."
)

Item = TypeVar("Item")
Progress = Callable[[str, int, int | None], None]


@dataclass(frozen=True)
class Sweep:
    """What is asked of a sweep."""

    sources: tuple[ClipSource, ...]
    axes: tuple[Axis, ...]
    base: Config = field(default_factory=lambda: preset(DEFAULT_PRESET))
    sampling: Sampling = field(default_factory=Sampling)
    objectives: tuple[str, ...] = USUAL_OBJECTIVES
    """Each counts once."""
    frames: int | None = None
    """Budget of frames in each clip; None: all."""
    model: str = ""
    """Path or URL of the face model; empty: the default head."""

    def __post_init__(self):
        object.__setattr__(self, "objectives", tuple(dict.fromkeys(self.objectives)))

    @property
    def names(self) -> tuple[str, ...]:
        """The clips' names in tables; clips of the same name are numbered."""
        counts = Counter(source.name for source in self.sources)
        taken = {name for name, times in counts.items() if times == 1}
        names = []
        for source in self.sources:
            name = source.name
            if counts[name] > 1:
                name = next(free for number in count(1) if (free := f"{source.name}-{number}") not in taken)
            names.append(name)
            taken.add(name)
        return tuple(names)

    def checked(self) -> tuple[tuple[Point, ...], tuple[Config, ...]]:
        """The points with their configurations.

        Raises `ConfigError` for an unknown setting or objective, an empty range, a value out of range, and for
        settings that do not act on a fit from landmarks; `InputError` for an objective that needs a truth or a second
        camera where a clip has none.
        """
        check_sources(self.sources, self.objectives)
        for axis in self.axes:
            check_axis(axis, self.base)
        points = points_of(self.axes, self.sampling)
        configs = tuple(config_at(self.base, point) for point in points)
        for config in configs:
            check_swept(config)
        return points, configs

    def definition(self) -> dict:
        """What it asks for, as plain JSON."""
        return {
            "clips": [source.clip for source in self.sources],
            "axes": {axis.path: list(axis.values) or list(axis.between) for axis in self.axes},
            "sampling": [self.sampling.kind, self.sampling.count, self.sampling.seed],
            "objectives": list(self.objectives),
            "frames": self.frames,
            "base": self.base.model_dump(mode="json"),
            "model": self.model,
        }


def run_sweep(
    sweep: Sweep, place: str | Path, workers: Workers, resume: bool = False, progress: Progress | None = None
) -> SweepResult:
    """Do a sweep, keeping its results in a folder by path or URL; what is there already is not done again.

    A clip that cannot be fitted or measured is told in `SweepResult.failures`, and the rest goes on. Raises
    `ConfigError` for what the sweep asks for, `OutputError` for a place that takes no more or that holds a sweep unless
    `resume`, `InputError` for a rig that cannot be read, and if no clip can be used, or fitted and measured at any
    point. Whatever ends it, finished results stay.
    """
    sweep = _in_any_folder(sweep)  # workers may run in another one
    points, configs = sweep.checked()
    if sweep.base.camera.rig:
        read_rig(sweep.base.camera.rig)
    place = anywhere(str(place))
    storage, progress = Storage(place), progress or silent
    if not resume:
        _check_free(storage)
    model = model_source(sweep.model)
    observed, failures = _observed(sweep, model, storage, workers, progress)
    if not observed:
        raise InputError(f"None of the clips can be used: {next(iter(failures.values()))}")
    # Not before: a name that was misspelt leaves the place free for the same command without the slip.
    begun = storage.holds(DEFINITION)
    _claim(storage, sweep)
    parts = {
        name: parts_of(chosen_windows([range(*shot) for shot in clip.shots], sweep.frames))
        for name, clip in observed.items()
    }
    texts = [config.model_dump_json() for config in configs]
    tasks = [
        FitTask(
            name,
            observed[name].digest,
            tuple((w.start, w.stop) for w in part),
            chunk,
            sweep.objectives,
            place,
            model,
        )
        for name in observed
        for part in parts[name]
        for chunk in chunked(texts, sum(map(len, part)), sweep.objectives)
    ]
    sizes = [len(task.configs) * sum(stop - start for start, stop in task.windows) for task in tasks]
    done, total = 0, sum(sizes)
    progress("fits", 0, total)
    for number, result in workers.results(tasks):
        if isinstance(result, Failed):
            if result.fatal:
                raise OutputError(f"{result.reason} Finished work is kept; --resume goes on from there.")
            failures[tasks[number].name] = result.reason
        done += sizes[number]
        progress("fits", done, total)
    stored = _stored(sweep, model, storage, configs, observed, parts)
    whole = {place: rows for place, rows in stored.items() if len(rows) == len(parts[place[1]])}
    values = {place: np.concatenate(rows, axis=1) for place, rows in whole.items()}
    known = {name for (_, name), rows in values.items() if np.isfinite(rows).any()}
    failures |= {name: NO_VALUES for _, name in values if name not in known and name not in failures}
    values = {place: rows for place, rows in values.items() if place[1] in known}
    if not values:
        # A slip as well, unless there is something to go on with.
        if not begun and not any(np.isfinite(rows).any() for rows in chain(*stored.values())):
            storage.remove(DEFINITION)
        raise InputError(f"None of the clips can be fitted: {next(iter(failures.values()), 'No result was stored.')}")
    failures = {name: f"{reason}{_gaps(name, points, values)}" for name, reason in failures.items()}
    return SweepResult(sweep.base, sweep.axes, points, sweep.objectives, values, failures)


def _in_any_folder(sweep: Sweep) -> Sweep:
    """The sweep with its files named as in any folder."""
    rig, landmarker = anywhere(sweep.base.camera.rig), anywhere(sweep.base.landmarks.face_landmarker)
    base = sweep.base.changed(camera={"rig": rig}, landmarks={"face_landmarker": landmarker})
    return replace(
        sweep, sources=tuple(source.anywhere for source in sweep.sources), base=base, model=anywhere(sweep.model)
    )


def _gaps(name: str, points: Sequence[Point], values: Mapping[tuple[int, str], np.ndarray]) -> str:
    """What it means for a comparison that a clip has numbers at some points only."""
    without = sum((point.number, name) not in values for point in points)
    if without in (0, len(points)):
        return ""
    return f" {without} of {len(points)} points are without this clip, and are compared with no other."


def _check_free(storage: Storage) -> None:
    """Raise `OutputError` for a place that holds a sweep already."""
    if storage.holds(DEFINITION):
        raise OutputError(
            f"{storage.place} holds a sweep; continue it with --resume (to add points, name all values, old and new), "
            "or name another folder."
        )


def _claim(storage: Storage, sweep: Sweep) -> None:
    """Write down what the place is for."""
    storage.write(DEFINITION, json.dumps(sweep.definition(), indent=1).encode())


def _observed(sweep: Sweep, model: ModelSource, storage: Storage, workers: Workers, progress: Progress):
    """The clips by name, with their landmarks stored; and why others have none."""
    text = sweep.base.model_dump_json()
    flow = any(TABLE[name].needs == "flow" for name in sweep.objectives)
    tasks = [
        ObserveTask(ClipSource(**{**vars(source), "flow": flow}), text, storage.place, model)
        for source in sweep.sources
    ]
    found, failures = {}, {}
    progress("clips", 0, len(tasks))
    for number, result in workers.results(tasks):
        name = sweep.names[number]
        if not isinstance(result, Failed):
            found[name] = result
        elif result.fatal:
            raise OutputError(f"{result.reason} Finished work is kept; --resume goes on from there.")
        else:
            failures[name] = result.reason
        progress("clips", len(found) + len(failures), len(tasks))
    return {name: found[name] for name in sweep.names if name in found}, failures


def chunked(items: Sequence[Item], frames: int, objectives: Sequence[str]) -> list[tuple[Item, ...]]:
    """Configurations, or their numbers, in groups of about `FITS` fits of so many frames each."""
    fits = frames * len(folds_of(folds_needed(objectives), 1))
    size = max(1, FITS // max(1, fits))
    return [tuple(items[first : first + size]) for first in range(0, len(items), size)]


def _stored(sweep: Sweep, model: ModelSource, storage: Storage, configs, observed, parts):
    """The stored results by point and clip, of each part of the clip that has one."""
    found = {}
    for number, config in enumerate(configs):
        for name, clip in observed.items():
            keys = [result_key(config, clip.digest, part, sweep.objectives, model.fingerprint) for part in parts[name]]
            rows = [stored_result(storage, key) for key in keys]
            found[number, name] = [each for each in rows if each is not None]
    return found
