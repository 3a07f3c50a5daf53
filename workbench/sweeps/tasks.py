"""The tasks of a sweep: small, made of plain values, and without effect but what they store."""

import json
from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache

from workbench.config import Config, parse_config
from workbench.errors import InputError, OutputError
from workbench.face import FaceModel, load_default_head, load_face_model
from workbench.sweeps.clips import SweptClip
from workbench.sweeps.results import objectives_of, result_key, store_result, stored_result
from workbench.sweeps.solving import ClipSolver, kept
from workbench.sweeps.storage import Storage, local_file
from workbench.sweeps.stored_clips import ClipSource, digest_of, observe, store_clip, stored_clip

KEPT_CLIPS = 4


@dataclass(frozen=True)
class ModelSource:
    """Where a face model comes from, and which one it is."""

    place: str
    """Path or URL; empty: the default head."""
    fingerprint: str
    """`FaceModel.fingerprint`."""


@dataclass(frozen=True)
class Observed:
    """A clip whose landmarks are stored."""

    digest: str
    shots: tuple[tuple[int, int], ...]
    """First and last plus one of the frames of each."""


@dataclass(frozen=True)
class ObserveTask:
    """Find the landmarks of a clip."""

    source: ClipSource
    config: str
    """As JSON."""
    place: str
    model: ModelSource

    @property
    def clip(self) -> str:
        """The clip that it is about."""
        return self.source.clip

    def run(self) -> Observed:
        """Do it, unless that was done before. Raises `WorkbenchError`."""
        model, config, storage = solver_of(self.model).model, config_of(self.config), Storage(self.place)
        source = self.source.local
        digest = digest_of(source, config, model)
        clip = stored_clip(storage, digest, source.name)
        if clip is None:
            clip = observe(source, config, model, digest)
            store_clip(storage, clip)
        return Observed(digest, tuple((shot.start, shot.stop) for shot in clip.shots))


@dataclass(frozen=True)
class FitTask:
    """Fit a part of a clip under some configurations."""

    name: str
    digest: str
    windows: tuple[tuple[int, int], ...]
    configs: tuple[str, ...]
    """As JSON."""
    objectives: tuple[str, ...]
    place: str
    model: ModelSource

    @property
    def clip(self) -> str:
        """The clip that it is about."""
        return self.name

    def run(self) -> int:
        """Do what is not stored yet; returns the number of fits that were made. Raises `WorkbenchError`."""
        storage, solver = Storage(self.place), solver_of(self.model)
        windows = [range(*window) for window in self.windows]
        configs = {
            result_key(config, self.digest, windows, self.objectives, self.model.fingerprint): config
            for config in map(config_of, self.configs)
        }
        missing = {key: config for key, config in configs.items() if stored_result(storage, key) is None}
        if not missing:
            return 0
        clip = _clip(storage, self.digest, self.name)
        found = objectives_of(solver, list(missing.values()), clip, windows, self.objectives)
        for key, values in zip(missing, found, strict=True):
            store_result(storage, key, values)
        return len(missing) * sum(map(len, windows))


def config_of(text: str) -> Config:
    """The configuration from its JSON."""
    return parse_config(json.loads(text), "a sweep's task")


def model_source(place: str) -> ModelSource:
    """The face model that a path or URL holds now. Raises `WorkbenchError` if it cannot be read."""
    return ModelSource(place, _face_model(place).fingerprint())


@lru_cache(maxsize=2)
def solver_of(model: ModelSource) -> ClipSolver:
    """This process's solver for a face model. Raises `InputError` where its place holds another one here, or by now."""
    found = _face_model(model.place)
    if found.fingerprint() != model.fingerprint:
        raise InputError(
            f"{model.place or 'The default head'} is not the face model that the sweep started with; give all machines "
            "the same file and the same version of the workbench, and continue with --resume."
        )
    return ClipSolver(found)


def _face_model(place: str) -> FaceModel:
    return load_face_model(local_file(place)) if place else load_default_head()


_CLIPS: OrderedDict[tuple[str, str], SweptClip] = OrderedDict()
"""The latest clips of this process, by place and digest."""


def _clip(storage: Storage, digest: str, name: str) -> SweptClip:
    def read() -> SweptClip:
        clip = stored_clip(storage, digest, name)
        if clip is None:
            raise OutputError(f"The landmarks of {name} are gone from {storage.place}; run the sweep again.")
        return clip

    return kept(_CLIPS, (storage.place, digest), KEPT_CLIPS, read)
