"""A tuning session: one configuration under change, its history, and the fits that belong to it. No widgets."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from workbench.config import DEFAULT_PRESET, Config, Difference, parse_config, preset
from workbench.diagnosis import Change, Diagnosis
from workbench.errors import InputError
from workbench.face import FaceModel, load_default_head
from workbench.session.calibrations import Calibrations
from workbench.session.clip_run import ClipRuns, Run, described_track
from workbench.session.diagnosing import Diagnosing, check_diagnosed
from workbench.session.exports import Exports, track_command
from workbench.session.frame_fits import FrameFits, compile_solvers
from workbench.session.gesture import Gesture
from workbench.session.landmark_edits import moved, put_back, weighed, with_subset
from workbench.session.material import Cancelled, Material, Progress, load_material, material_of_track
from workbench.session.metrics import metrics_of
from workbench.session.observed_frames import ObservedFrames
from workbench.session.temporal import TemporalWork
from workbench.session.tuned_config import TunedConfig
from workbench.tracking import FrameContext, FrameFit, FrameObservation, StageTrace, Track
from workbench.tracking.deep_solution import DeepSolution
from workbench.tracking.fitting import never


class TuningSession:
    """Frames, landmarks, model and a configuration that is tuned; the panel is a view on this.

    `fit_frame` fits one frame under the present configuration in the context of the last whole run (the frame before
    it, as that run left it). `fit_clip` runs all frames, with the same numbers as `workbench track`. Methods may be
    called from any thread.
    """

    def __init__(self, model: FaceModel, material: Material, config: Config | None = None):
        self.model, self.material = model, material
        self.base = preset(DEFAULT_PRESET) if config is None else config
        self._listeners: list[Callable[[str], None]] = []
        self._tuned = TunedConfig(self.base, self.tell)
        self._frames = ObservedFrames(material)
        calibrations = Calibrations(material, self._frames)
        self._runs = ClipRuns(model, material, self.base, self._frames, calibrations)
        self._fits = FrameFits(model, material, self.base, self._frames, calibrations, self._runs.continued_from)
        self._diagnosing = Diagnosing(model, material, self._frames)
        self._exports = Exports(model, material)
        self.temporal = TemporalWork(self)
        """Infill and refinement of the clip."""

    def __repr__(self) -> str:
        return f"TuningSession({self.material.name!r}, {len(self)} frames, preset {self.config.preset!r})"

    def __len__(self) -> int:
        return len(self.material.observations)

    # --- configuration and history ---

    @property
    def config(self) -> Config:
        """The present configuration."""
        return self._tuned.present

    def set(self, label: str = "", gesture: Gesture | str | None = None, **sections: Any) -> Config:
        """Change keys of sections, as `Config.changed`; one step of undo.

        Changes with the same `gesture` are one step: those of one drag of a slider however slow, others if they follow
        each other within 0.8 s. Raises `ConfigError` for what a configuration cannot hold, and leaves everything as it
        was.
        """
        return self._tuned.set(label, gesture, **sections)

    def use(self, config: Config, label: str = "configuration", gesture: Gesture | str | None = None) -> Config:
        """Replace the whole configuration; one step of undo."""
        return self._tuned.use(config, label, gesture)

    def undo(self) -> str | None:
        """Take back the last change; its label, None if there is none."""
        return self._tuned.undo()

    def redo(self) -> str | None:
        """Make the change again that was taken back last; its label, None if there is none."""
        return self._tuned.redo()

    @property
    def undo_label(self) -> str | None:
        """What `undo` would take back."""
        return self._tuned.history.undo_label

    @property
    def redo_label(self) -> str | None:
        """What `redo` would make again."""
        return self._tuned.history.redo_label

    def take_snapshot(self, name: str) -> None:
        """Keep the present configuration under a name. Raises `ConfigError` for an empty name."""
        self._tuned.take_snapshot(name)

    def restore_snapshot(self, name: str) -> Config:
        """Return to a snapshot; one step of undo. Raises `ConfigError` for a name that was never taken."""
        return self.use(self._tuned.snapshot(name), f"snapshot {name}")

    @property
    def snapshots(self) -> Mapping[str, Config]:
        """Configurations that were kept, by name."""
        return self._tuned.snapshots

    def changes(self, since: Config | str | None = None) -> list[Difference]:
        """What differs from a configuration, a snapshot by name, or the start of the session (default)."""
        return self._tuned.changes(since)

    @property
    def unexported(self) -> list[Difference]:
        """What changed since the last export, or since the start if there was none."""
        return self.changes(self._tuned.exported)

    # --- landmarks ---

    def weigh(self, points: Iterable[int], factor: float | int, label: str = "") -> Config:
        """Set the factor of single landmarks in every stage; 0 mutes, 1 is as configured."""
        return self.use(weighed(self.config, points, factor), label or "landmark weight")

    def move(self, frame: int, point: int, place: tuple[float, float], gesture: Gesture | str | None = None) -> Config:
        """Put a detection of one frame where it belongs, pixels."""
        self._frames.check(frame)
        return self.use(moved(self.config, frame, {point: place}), f"landmark {point} of frame {frame}", gesture)

    def put_back(self, frame: int, points: Iterable[int]) -> Config:
        """Give points of a frame the places that the detector gave them."""
        return self.use(put_back(self.config, frame, points), f"detections of frame {frame}")

    def save_subset(self, name: str, points: Iterable[int]) -> Config:
        """Name a set of landmarks, for stages and weights. Raises `ConfigError` for an empty one or a group's name."""
        return self.use(with_subset(self.config, name, points), f"subset {name}")

    # --- frames ---

    def observation(self, frame: int, config: Config | None = None) -> FrameObservation:
        """A frame's observation with the detections that were moved. Raises `InputError` outside the material."""
        return self._frames.observation(frame, self.config if config is None else config)

    def picture(self, frame: int) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a frame; blank where the material has none. Raises `InputError` outside the material."""
        self._frames.check(frame)
        return self.material.pictures[frame]

    def fit_frame(self, frame: int, coarse: bool = False, config: Config | None = None) -> FrameFit:
        """The fit of one frame under the present configuration, or another one that it is compared with.

        `coarse` keeps an identity that an earlier configuration calibrated on the shot, for dragging in a clip.
        """
        return self._fits.fit(frame, self.config if config is None else config, coarse)

    def explain_frame(self, frame: int) -> tuple[FrameFit, tuple[StageTrace, ...]]:
        """`fit_frame` with every iteration kept. Raises `InputError` for a frame without landmarks."""
        return self._fits.explain(frame, self.config)

    def solve_frame(self, frame: int) -> DeepSolution | None:
        """What every stage of Deep Energies made of a frame; None under FACE IT! and without a face."""
        return self._fits.solve(frame, self.config)

    def stage_strip(self, frame: int) -> UInt8[np.ndarray, "h w 3"] | None:
        """The stages of Deep Energies on a frame as a film strip; None where there is nothing to draw."""
        return self._fits.stage_strip(frame, self.config)

    def fit_steps(self, frame: int, steps: int) -> FrameFit:
        """The fit of a frame stopped after `steps` iterations, counted through all stages.

        Raises `InputError` for a frame without landmarks.
        """
        return self._fits.stopped(frame, self.config, steps)

    def context(self, frame: int) -> FrameContext:
        """What the fit of a frame starts from under the present configuration."""
        return self._fits.problem(frame, self.config).context

    def diagnose(self, frame: int) -> Diagnosis:
        """Reasons why the fit of a frame may be bad, and why the last whole run flags it if it does.

        Raises `InputError` for a frame without landmarks.
        """
        config = self.config
        check_diagnosed(config)
        return self._diagnosing.diagnose(self._fits.problem(frame, config), config, self.run)

    def apply(self, change: Change, frame: int) -> Config:
        """Make a change that a diagnosis of a frame proposes; one step of undo."""
        config = change.apply_to(self.config)
        return self.use(moved(config, frame, change.landmarks) if change.landmarks else config, change.label)

    # --- the whole clip ---

    def fit_clip(
        self, progress: Progress | None = None, cancelled: Cancelled = never, config: Config | None = None
    ) -> Track | None:
        """Fit all frames under the present configuration, or another one; None if cancelled.

        These are the fits of single frames, as `workbench track` makes them; `temporal` works on them over time. A
        cancelled run leaves the fits of the last whole one.
        """
        if self._runs.fit(self.config if config is None else config, progress, cancelled) is None:
            return None
        self.tell("run")
        return self.track

    @property
    def run(self) -> Run | None:
        """The last whole run."""
        return self._runs.last

    @property
    def track(self) -> Track:
        """The last whole run as a track; runs all frames if there was none."""
        return described_track(self._whole_run(), self.model, self.material.stills)

    @property
    def stale(self) -> Bool[np.ndarray, "n"]:
        """Frames whose fit in the last run belongs to another configuration."""
        return self._runs.stale(self.config)

    def metrics(self) -> dict[str, float]:
        """Errors and jitter of the last whole run; runs all frames if there was none."""
        return self._whole_run().metrics

    def track_fits(self) -> Sequence[FrameFit]:
        """The fits of the last whole run; runs all frames if there was none."""
        return self._whole_run().fits

    def _whole_run(self) -> Run:
        if self.run is None:
            self.fit_clip()
        return self.run

    def warm_up(self) -> None:
        """Compile all that a panel can ask for: every solver, with and without its trace, and a diagnosis."""
        if not self.base.traits.real_time:
            self.fit_frame(0)
            return
        observations = self.material.observations
        compile_solvers(self.model, self.base, observations[0].image_size)
        seen = next((k for k, observation in enumerate(observations) if observation.landmarks is not None), None)
        if seen is not None:
            self.diagnose(seen)

    # --- export ---

    def export(
        self, path: str | Path, progress: Progress | None = None, cancelled: Cancelled = never, overwrite: bool = False
    ) -> Path:
        """Write the configuration with its provenance; `workbench track --config` runs it to the same numbers.

        All frames are fitted first if the last run belongs to another configuration, and worked on over time if it
        asks for that, so that the metrics in the file are those of the file. Raises `InputError` if `cancelled`, and
        for a file that is there already, unless this session wrote it or `overwrite` is set.
        """
        path, config = Path(path), self.config
        self._exports.check(path, overwrite)
        fits = self.temporal.fits_by(config, progress, cancelled)
        if fits is None:
            raise InputError(f"The export was cancelled; {path} was not written.")
        self._exports.write(path, config, self.base, self._runs.base_metrics(progress), metrics_of(fits))
        self._tuned.exported = config
        self.tell("export")
        return path

    def may_write(self, path: str | Path) -> bool:
        """Whether an export overwrites nothing but what this session exported before."""
        return self._exports.may_write(path)

    def command(self, path: str | Path) -> str:
        """The command line that runs an exported configuration on this material."""
        return track_command(self.material, path)

    # --- listeners ---

    def listen(self, callback: Callable[[str], None]) -> Callable[[], None]:
        """Call `callback(what)` after each change of "config", "run", "time", "snapshots", "export"; returns what
        ends it.

        Callbacks run in the thread that made the change.
        """
        self._listeners.append(callback)
        return lambda: self._listeners.remove(callback) if callback in self._listeners else None

    def tell(self, what: str) -> None:
        """Call every listener."""
        for callback in tuple(self._listeners):
            callback(what)


def open_session(
    inputs: str | Path | Sequence[str | Path] | Track | Material,
    config: Config | str | None = None,
    model: FaceModel | None = None,
    landmarks: str | Path | None = None,
    stills: bool = False,
    progress: Progress | None = None,
) -> TuningSession:
    """A session on a photo, photos, a clip, a landmark file, a `Track`, or a `Material`.

    `config` is a configuration or the name of a preset; a track brings its own. Raises `InputError` and `ConfigError`
    as reading them does.
    """
    model = load_default_head() if model is None else model
    if isinstance(config, str):
        config = preset(config)
    if isinstance(inputs, Material):
        return TuningSession(model, inputs, config)
    if isinstance(inputs, Track):
        stored = inputs.meta.get("config")
        config = config or (parse_config(stored, "the track's configuration") if stored else None)
        return TuningSession(model, material_of_track(inputs), config)
    config = config or preset(DEFAULT_PRESET)
    return TuningSession(model, load_material(inputs, config, landmarks, stills, progress), config)
