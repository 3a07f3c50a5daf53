"""The tasks of a sweep: small, made of plain values, and without effect but what they store."""

import json
from collections import OrderedDict
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from workbench.config import Config, parse_config
from workbench.errors import OutputError
from workbench.face import FaceModel, load_default_head, load_face_model
from workbench.sweeps.clips import SweptClip
from workbench.sweeps.results import objectives_of, result_key, store_result, stored_result
from workbench.sweeps.solving import ClipSolver, kept
from workbench.sweeps.storage import Storage, local_file
from workbench.sweeps.stored_clips import ClipSource, digest_of, observe, store_clip, stored_clip

KEPT_CLIPS = 4


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
    model: str = ""
    """Path or URL of the face model; empty: the default head."""

    @property
    def clip(self) -> str:
        """The clip that it is about."""
        return self.source.clip

    def run(self) -> Observed:
        """Do it, unless that was done before. Raises `WorkbenchError`."""
        model, config, storage = solver_of(self.model).model, config_of(self.config), Storage(self.place)
        digest = digest_of(self.source, config, model)
        clip = stored_clip(storage, digest, self.source.name)
        if clip is None:
            clip = observe(self.source, config, model, digest)
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
    model: str = ""

    @property
    def clip(self) -> str:
        """The clip that it is about."""
        return self.name

    def run(self) -> int:
        """Do what is not stored yet; returns the number of fits that were made. Raises `WorkbenchError`."""
        storage, solver = Storage(self.place), solver_of(self.model)
        windows = [range(*window) for window in self.windows]
        configs = {
            result_key(config, self.digest, windows, self.objectives, fingerprint_of(self.model)): config
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
    """The configuration of its JSON."""
    return parse_config(json.loads(text), "a sweep's task")


@lru_cache(maxsize=2)
def solver_of(model: str) -> ClipSolver:
    """This process's solver for a face model."""
    return ClipSolver(face_model_of(model))


@lru_cache(maxsize=2)
def fingerprint_of(model: str) -> str:
    """`FaceModel.fingerprint` of a face model."""
    return solver_of(model).model.fingerprint()


def face_model_of(model: str) -> FaceModel:
    """The face model of a path or URL; the default head for an empty one."""
    return load_face_model(Path(local_file(model))) if model else load_default_head()


_CLIPS: OrderedDict[tuple[str, str], SweptClip] = OrderedDict()
"""The latest clips of this process, by place and digest."""


def _clip(storage: Storage, digest: str, name: str) -> SweptClip:
    def read() -> SweptClip:
        clip = stored_clip(storage, digest, name)
        if clip is None:
            raise OutputError(f"The landmarks of {name} are gone from {storage.place}; run the sweep again.")
        return clip

    return kept(_CLIPS, (storage.place, digest), KEPT_CLIPS, read)
