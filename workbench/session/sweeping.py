"""Sweeps inside a session: many settings on its frames, in this process, with what is known growing as it runs."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from workbench.config import Config
from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.frames import image_names
from workbench.objectives import TABLE, Truth, flow_of_pictures, folds_of, observed_clip, read_truth
from workbench.session.material import Cancelled, Material, Progress
from workbench.sweeps import (
    USUAL_OBJECTIVES,
    ClipSolver,
    ClipSource,
    Sweep,
    SweepResult,
    SweptClip,
    chosen_windows,
    read_axis,
    read_sampling,
)
from workbench.sweeps.results import folds_needed, objectives_of
from workbench.sweeps.sweep import FITS
from workbench.tracking.chain_solver import CHAINS
from workbench.tracking.unwatched import never

Grown = Callable[[SweepResult], None]


class SessionSweeps:
    """Sweeps over the frames of a material; identities and the pictures' motion are kept from one to the next."""

    def __init__(self, model: FaceModel, material: Material) -> None:
        self._model, self._material = model, material
        self._solver: ClipSolver | None = None
        self._flow: np.ndarray | None = None

    def run(
        self,
        settings: Sequence[str],
        base: Config,
        objectives: Sequence[str] = USUAL_OBJECTIVES,
        frames: int | None = None,
        sample: str | None = None,
        seed: int = 0,
        truth: str | Path | None = None,
        progress: Progress | None = None,
        cancelled: Cancelled = never,
        grown: Grown | None = None,
    ) -> SweepResult:
        """The objectives at every point; those that were done, if cancelled. `grown` gets what is known after each
        group of points. Raises `ConfigError` and `InputError` for what cannot be swept or measured.
        """
        axes = tuple(map(read_axis, settings))
        source = ClipSource(self._material.name, truth=str(truth or ""))
        sweep = Sweep((source,), axes, base, read_sampling(sample, seed), tuple(objectives), frames)
        points, configs = sweep.checked()
        clip = self.clip(sweep.objectives, truth)
        windows = chosen_windows(clip.shots, frames)
        total, done, values = len(points) * sum(map(len, windows)), 0, {}
        if self._solver is None:
            self._solver = ClipSolver(self._model)
        for chunk in in_groups(len(points), windows, sweep.objectives):
            if cancelled():
                break
            found = objectives_of(self._solver, [configs[k] for k in chunk], clip, windows, sweep.objectives)
            values |= {(number, clip.name): rows for number, rows in zip(chunk, found, strict=True)}
            done += len(chunk) * sum(map(len, windows))
            if progress is not None:
                progress("fits", done, total)
            if grown is not None:
                grown(SweepResult(base, axes, points, sweep.objectives, dict(values)))
        return SweepResult(base, axes, points, sweep.objectives, values)

    def clip(self, objectives: Sequence[str], truth: str | Path | None) -> SweptClip:
        """The material with what the objectives need. Raises `InputError` if it has no face."""
        material = self._material
        observations = tuple(material.observations)
        if not any(observation.landmarks is not None for observation in observations):
            raise InputError(f"{material.name} has no face in any frame; there is nothing to sweep over.")
        known, flow = Truth(), None
        if truth is not None:
            indices = [observation.index for observation in observations]
            names, first = image_names(material.pictures.frames), 0 if material.part is None else material.part[0]
            known = read_truth(truth, self._model, indices, observations[0].image_size, names, first)
        if any(TABLE[name].needs == "flow" for name in objectives) and material.pictures.real:
            if self._flow is None:
                self._flow = flow_of_pictures(material.pictures, observed_clip(observations))
            flow = self._flow
        return SweptClip(material.name, "session", observations, material.stills, known, flow)


def in_groups(points: int, windows: Sequence[range], objectives: Sequence[str]) -> list[range]:
    """The numbers of the points in groups of a few blocks of chains each: what is computed between two pictures.

    Each group is spread over all points, so that a curve shows its course early.
    """
    folds = len(folds_of(folds_needed(objectives), 1))
    size = max(1, min(4 * CHAINS // (folds * len(windows)), FITS // (folds * sum(map(len, windows)))))
    count = -(-points // size)
    return [range(first, points, count) for first in range(count)]
