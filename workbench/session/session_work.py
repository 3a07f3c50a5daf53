"""What computes in a tuning session: the head, fits of frames and of the clip, diagnosis, sweeps, and the rest."""

from pathlib import Path
from typing import Any

from workbench.config import Config
from workbench.diagnosis import Diagnosis, Uncertainty, estimate_uncertainty
from workbench.face import FaceModel, in_scheme, load_default_head
from workbench.learning import Tuned
from workbench.session.calibrations import Calibrations
from workbench.session.clip_run import ClipRuns, Run, described_track
from workbench.session.dependence import time_key
from workbench.session.diagnosing import Diagnosing, check_diagnosed
from workbench.session.exports import Exports
from workbench.session.frame_fits import FrameFits
from workbench.session.learning import tune_material
from workbench.session.material import Cancelled, Material, Progress
from workbench.session.metrics import metrics_of
from workbench.session.observed_frames import ObservedFrames
from workbench.session.sweeping import SessionSweeps
from workbench.session.temporal import TemporalWork
from workbench.tracking import FrameContext, Track


class SessionWork:
    """The parts of a `TuningSession` that compute, each with its caches. Its module takes seconds to import."""

    def __init__(self, session, model: FaceModel | None, material: Material, base: Config) -> None:
        """`model`: None for the default head. Raises `ModelError` for a model without the material's landmarks."""
        self.model = model = in_scheme(load_default_head() if model is None else model, material.scheme)
        self._material = material
        self.frames = ObservedFrames(material)
        calibrations = Calibrations(material, self.frames)
        self.runs = ClipRuns(model, material, base, self.frames, calibrations)
        self.fits = FrameFits(model, material, base, self.frames, calibrations, self.runs.continued_from)
        self._diagnosing = Diagnosing(model, material, self.frames)
        self.exports = Exports(model, material)
        self.sweeps = SessionSweeps(model, material)
        self.temporal = TemporalWork(session)

    def context(self, frame: int, config: Config) -> FrameContext:
        """The state that the fit of a frame starts from."""
        return self.fits.problem(frame, config).context

    def diagnose(self, frame: int, config: Config, progress: Progress | None, cancelled: Cancelled) -> Diagnosis:
        """Reasons why a fit may be bad. Raises `InputError` for a system that is not diagnosed."""
        problem = self.fits.problem(frame, check_diagnosed(config))
        return self._diagnosing.diagnose(problem, config, self.runs.last, progress, cancelled)

    def uncertainty(self, frame: int, config: Config) -> Uncertainty:
        """How well a fit is determined. Raises `InputError` for a system that is not diagnosed."""
        context = self.context(frame, check_diagnosed(config))
        return estimate_uncertainty(self.model, config, context, self.fits.fit(frame, config))

    def tune(self, config: Config, objective: str, learn: Any, **options: Any) -> Tuned:
        """What the clip chooses; options as in `tune_material`."""
        return tune_material(self.sweeps, self.model, config, objective, learn, **options)

    def track_of(self, run: Run) -> Track:
        """A run as a track with its metadata."""
        return described_track(run, self.model, self._material)

    def export(
        self, path: Path, config: Config, base: Config, overwrite: bool, progress: Progress | None, cancelled: Cancelled
    ) -> bool:
        """Write a configuration with the metrics of its fits and of those of the configuration it was tuned from.

        Infill and refinement count in both. False, and nothing is written, if cancelled. Raises `TakenError` for a file
        that exists, before or after the fits, unless it is as written here or `overwrite` is set.
        """
        self.exports.check(path, overwrite)
        fits = before = self.temporal.fits_by(config, progress, cancelled)
        if fits is not None and time_key(base) != time_key(config):
            run = self.runs.aside(base, progress, cancelled)
            before = None if run is None else self.temporal.after_run(run, progress, cancelled)
        if before is None or cancelled():
            return False
        metrics = metrics_of(before), metrics_of(fits)
        self.exports.check(path, overwrite)  # another program may have written it during the fits
        self.exports.write(path, config, base, *metrics)
        return True
