"""A run over a whole clip: its fits, the state each frame was continued from, and the fits that are out of date."""

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool

from workbench.config import Config
from workbench.diagnosis import FrameFlags, flag_frames
from workbench.face import FaceModel
from workbench.pipeline import software_versions
from workbench.planning import plan_of
from workbench.session.calibrations import Calibrations
from workbench.session.dependence import fits_key, stale_frames
from workbench.session.material import Cancelled, Material, Progress
from workbench.session.metrics import metrics_of_track
from workbench.session.observed_frames import ObservedFrames
from workbench.tracking import FrameContext, FrameFit, Track
from workbench.tracking.fitting import Continuation
from workbench.tracking.records import Fits, stack_fits
from workbench.tracking.systems import make_fitter
from workbench.tracking.track_layout import model_record, scheme_record
from workbench.tracking.unwatched import never
from workbench.tracking.walk import Walk


@dataclass(frozen=True, eq=False)
class Run:
    """The fits of all frames under one configuration."""

    config: Config
    track: Track
    """The fits as a few stacked arrays, without metadata, so that thousands of frames stay small."""
    before: tuple[Continuation | None, ...]
    """The state each frame was continued from, as NumPy arrays: for so few numbers, JAX arrays take twenty times the
    memory."""

    @property
    def fits(self) -> Sequence[FrameFit]:
        """The fit of each frame."""
        return Fits(self.track)

    @cached_property
    def flags(self) -> FrameFlags:
        """Frames flagged for diagnosis."""
        return flag_frames(self.track, self.config)

    @cached_property
    def metrics(self) -> dict[str, float]:
        """Errors and jitter."""
        return metrics_of_track(self.track)


KEPT_RUNS = 8
"""Runs that are kept by their configuration, for comparison."""


class ClipRuns:
    """Runs over all frames of a material, with the same numbers as `workbench track`; keeps the last complete run, and
    some by their configuration."""

    def __init__(
        self, model: FaceModel, material: Material, base: Config, frames: ObservedFrames, calibrations: Calibrations
    ) -> None:
        self.last: Run | None = None
        """The last complete run."""
        self._model, self._material, self._base = model, material, base
        self._frames, self._calibrations = frames, calibrations
        self._kept: OrderedDict[str, Run] = OrderedDict()
        self._lock = threading.Lock()

    def fit(self, config: Config, progress: Progress | None = None, cancelled: Cancelled = never) -> Run | None:
        """Fit all frames and keep the run. None if cancelled; the last complete run then stays."""
        run = self._fitted(config, progress, cancelled)
        if run is not None:
            with self._lock:
                self.last = run
                self._keep(run)
        return run

    def known(self, config: Config) -> Run | None:
        """The run under a configuration, if it is kept."""
        return self._kept.get(fits_key(config))

    def aside(self, config: Config, progress: Progress | None = None, cancelled: Cancelled = never) -> Run | None:
        """The run under a configuration, which does not become the last one; None if cancelled."""
        run = self.known(config) or self._fitted(config, progress, cancelled)
        if run is not None:
            with self._lock:
                self._keep(run)
        return run

    def walked(
        self, part: range, config: Config, cancelled: Cancelled = never
    ) -> Iterator[tuple[FrameFit, FrameContext]]:
        """The fits of frames in turn, with the context of each, until cancelled; `part` begins with a shot."""
        walk = Walk(make_fitter(self._model, plan_of(config, self._model.scheme)))
        for shot, frames in enumerate(self._material.shots):
            if frames.start not in part:
                continue
            walk.shot = shot - 1
            walk.begin_shot(self._calibrations.of_shot(shot, config, walk.fitter))
            for frame in frames[: part.stop - frames.start]:
                if cancelled():
                    return
                yield walk.step(self._frames.linked_observation(frame, config))

    def continued_from(self, frame: int) -> Continuation | None:
        """The state that a frame was continued from in the last run, in the form that needs no recompilation."""
        last = None if self.last is None else self.last.before[frame]
        if last is None:
            return None
        numbers = jax.tree.map(jnp.asarray, (last.parameters, last.pose, last.last_pose))
        return Continuation(*numbers, last.frames, last.points)

    def stale(self, config: Config) -> Bool[np.ndarray, "n"]:
        """Frames whose fit in the last run is out of date under a configuration."""
        if self.last is None:
            return np.ones(len(self._material.observations), bool)
        return stale_frames(self.last.config, config, self._material.shots)

    def _keep(self, run: Run) -> None:
        key, base = fits_key(run.config), fits_key(self._base)
        self._kept[key] = run
        self._kept.move_to_end(key)
        while len(self._kept) > KEPT_RUNS:
            self._kept.pop(next(kept for kept in self._kept if kept != base))

    def _fitted(self, config: Config, progress: Progress | None, cancelled: Cancelled) -> Run | None:
        fits, before, count = [], [], len(self._material.observations)
        for fit, context in self.walked(range(count), config, cancelled):
            fits.append(fit)
            before.append(_on_host(context.last))
            if progress is not None:
                progress("fit", len(fits), count)
        return Run(config, Track(meta={}, **stack_fits(fits)), tuple(before)) if len(fits) == count else None


def described_track(run: Run, model: FaceModel, material: Material) -> Track:
    """The track of a run, with the metadata of a track that `workbench track` writes."""
    config, record = run.config, material.opened.record
    views = {name: found for name, path in material.views.items() if (found := record(path))}
    meta = {
        "inputs": [*filter(None, map(record, material.inputs)), *views.values()],
        "views": {name: found["path"] for name, found in views.items()},
        "landmarks": record(material.landmark_file),
        "frames": None if material.part is None else list(material.part),
        "rate": material.rate,
        "versions": software_versions(),
        "expression_names": list(model.expression_names),
        "stages": [stage.name for stage in config.stages if stage.enabled],
        "stills": material.stills,
        "camera_guessed": config.camera.guessed,
        "config": config.model_dump(mode="json"),
        "model": model_record(model),
        **scheme_record(model.scheme),
    }
    if material.detector or material.inputs:  # what found the landmarks of a picture in memory, nobody said
        meta["detector"] = material.detector
    return replace(run.track, meta=meta)


def _on_host(last: Continuation | None) -> Continuation | None:
    return jax.tree.map(lambda leaf: np.array(leaf) if isinstance(leaf, jax.Array) else leaf, last)
