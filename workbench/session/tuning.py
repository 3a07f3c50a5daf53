"""A tuning session: the configuration being tuned, its history, and its fits. No widgets."""

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

import workbench
from workbench.config import DEFAULT_PRESET, Config, Difference, config_of_track, preset, read_config
from workbench.errors import InputError
from workbench.session.gesture import Gesture
from workbench.session.history import Step
from workbench.session.landmark_edits import check_movable, moved, put_back, weighed, with_subset
from workbench.session.material import Cancelled, Material, Progress, load_material, stored_track
from workbench.session.tuned_config import TunedConfig, preset_on, snapshot_title
from workbench.tracking import FrameObservation
from workbench.tracking.unwatched import never


class TuningSession:
    """Frames, landmarks, model and the configuration being tuned; the panel is a view of it.

    `fit_frame` fits one frame under the current configuration, continuing from the previous frame of the last complete
    run. `fit_clip` fits all frames, with the same numbers as `workbench track`. Methods may be called from any thread.
    """

    def __init__(
        self, model: "workbench.face.FaceModel | None", material: Material, config: Config | None = None
    ) -> None:
        """`model`: None for the default head, which is loaded when something is first computed, as its programs are.

        Raises `ModelError` for a model without the material's landmarks.
        """
        self.material = material
        self.base = preset(DEFAULT_PRESET) if config is None else config
        self._listeners: list[Callable[[str], None]] = []
        self._tuned = TunedConfig(self.base, self.tell)
        self._working, self._made = threading.RLock(), None
        if model is not None:
            self._made = self._make(model)

    def __repr__(self) -> str:
        return f"TuningSession({self.material.name!r}, {len(self)} frames, preset {self.config.preset!r})"

    def __len__(self) -> int:
        return len(self.material.observations)

    def _make(self, model: "workbench.face.FaceModel | None") -> "workbench.session.session_work.SessionWork":
        from workbench.session.session_work import SessionWork  # here: a clip's first frame is shown without it

        return SessionWork(self, model, self.material, self.base)

    @property
    def _work(self) -> "workbench.session.session_work.SessionWork":
        with self._working:
            if self._made is None:
                self._made = self._make(None)
        return self._made

    @property
    def model(self) -> "workbench.face.FaceModel":
        """The head, with the material's landmarks."""
        return self._work.model

    @property
    def runs(self) -> "workbench.session.clip_run.ClipRuns":
        """Runs over all frames by their configuration, to compare with the last one."""
        return self._work.runs

    @property
    def temporal(self) -> "workbench.session.TemporalWork":
        """Infill and refinement of the clip."""
        return self._work.temporal

    # --- configuration and history ---

    @property
    def config(self) -> Config:
        """The current configuration."""
        return self._tuned.present

    def set(self, label: str = "", gesture: Gesture | str | None = None, **sections: Any) -> Config:
        """Change keys of sections like `Config.changed`; one undo step.

        Changes with the same `gesture` are one step: all changes of one slider drag, and other changes that follow
        each other within 0.8 s. Raises `ConfigError` for invalid values and then changes nothing.
        """
        return self._tuned.set(label, gesture, **sections)

    def use(self, config: Config, label: str = "configuration", gesture: Gesture | str | None = None) -> Config:
        """Replace the whole configuration; one undo step."""
        return self._tuned.use(config, label, gesture)

    def undo(self) -> str | None:
        """Undo the last change. Returns its label; None if there is none."""
        return self._tuned.undo()

    def redo(self) -> str | None:
        """Redo the change that was undone last. Returns its label; None if there is none."""
        return self._tuned.redo()

    @property
    def undo_steps(self) -> tuple[Step[Config], ...]:
        """The changes that `undo` would revert, the newest last."""
        return self._tuned.history.steps

    @property
    def undo_label(self) -> str | None:
        """Label of the change that `undo` would revert."""
        return self._tuned.history.undo_label

    @property
    def redo_label(self) -> str | None:
        """Label of the change that `redo` would repeat."""
        return self._tuned.history.redo_label

    def take_snapshot(self, name: str) -> None:
        """Store the current configuration under a name. Raises `ConfigError` for an empty or reserved name."""
        self._tuned.take_snapshot(name)

    def restore_snapshot(self, name: str) -> Config:
        """Return to a snapshot; one undo step. Raises `ConfigError` for an unknown name."""
        return self.use(self._tuned.snapshot(name), snapshot_title(name))

    @property
    def snapshots(self) -> Mapping[str, Config]:
        """Stored configurations, by name."""
        return self._tuned.snapshots

    def changes(self, since: Config | str | None = None) -> list[Difference]:
        """Differences from a configuration, a snapshot by name, or the start of the session (default)."""
        return self._tuned.changes(since)

    @property
    def unexported(self) -> list[Difference]:
        """Changes since the last export, or since the start if there was none."""
        return self.changes(self._tuned.exported)

    # --- landmarks ---

    def weigh(self, points: Iterable[int], factor: float | int, label: str = "") -> Config:
        """Set the factor of single landmarks in every stage; 0 mutes, 1 leaves them as configured."""
        return self.use(weighed(self.config, points, factor), label or "landmark weight")

    def move(self, frame: int, point: int, place: tuple[float, float], gesture: Gesture | str | None = None) -> Config:
        """Move a detection of one frame to its correct position, pixels. Raises `InputError` where there is none."""
        check_movable(self.observation(frame), point)
        return self.use(moved(self.config, frame, {point: place}), f"landmark {point} of frame {frame}", gesture)

    def put_back(self, frame: int, points: Iterable[int]) -> Config:
        """Return points of a frame to their detected positions. Raises `InputError` where the material has none."""
        found = put_back(self.config, frame, points, self.material.undetected)
        return self.use(found, f"detections of frame {frame}")

    def save_subset(self, name: str, points: Iterable[int]) -> Config:
        """Name a set of landmarks for stages and weights. Raises `ConfigError` for an empty set or a group's name."""
        return self.use(with_subset(self.config, name, points), f"subset {name}")

    # --- frames ---

    def observation(self, frame: int, config: Config | None = None) -> FrameObservation:
        """A frame's observation with its moved detections. Raises `InputError` outside the material."""
        return self._work.frames.observation(frame, self.config if config is None else config)

    def picture(self, frame: int) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a frame; blank if the material has none. Raises `InputError` outside the material."""
        self.material.check(frame)
        return self.material.pictures[frame]

    def fit_frame(
        self, frame: int, coarse: bool = False, config: Config | None = None, cancelled: Cancelled = never
    ) -> "workbench.tracking.FrameFit":
        """The fit of one frame under the current configuration, or under `config` for comparison.

        `coarse`: any identity calibrated on the shot will do, for fast dragging. Raises `StoppedError` if cancelled.
        """
        return self._work.fits.fit(frame, self.config if config is None else config, coarse, cancelled)

    def explain_frame(
        self, frame: int
    ) -> "tuple[workbench.tracking.FrameFit, tuple[workbench.tracking.StageTrace, ...]]":
        """`fit_frame` with every iteration kept. Raises `InputError` for a frame without landmarks."""
        return self._work.fits.explain(frame, self.config)

    def solve_frame(self, frame: int) -> "workbench.tracking.deep_solution.DeepSolution | None":
        """The result of each Deep Energies stage on a frame; None under FACE IT! or without a face."""
        return self._work.fits.solve(frame, self.config)

    def stage_strip(self, frame: int) -> UInt8[np.ndarray, "h w 3"] | None:
        """The Deep Energies stages on a frame as a film strip; None if there is nothing to draw."""
        return self._work.fits.stage_strip(frame, self.config)

    def fit_steps(self, frame: int, steps: int) -> "workbench.tracking.FrameFit":
        """The fit of a frame stopped after `steps` iterations, counted through all stages.

        Raises `InputError` for a frame without landmarks.
        """
        return self._work.fits.stopped(frame, self.config, steps)

    def context(self, frame: int) -> "workbench.tracking.FrameContext":
        """The state that the fit of a frame starts from under the current configuration."""
        return self._work.context(frame, self.config)

    def diagnose(
        self, frame: int, progress: Progress | None = None, cancelled: Cancelled = never
    ) -> "workbench.diagnosis.Diagnosis":
        """Reasons why the fit of a frame may be bad, and why the last complete run flags it, if it does.

        Raises `InputError` for a frame without landmarks, and `StoppedError` if cancelled.
        """
        return self._work.diagnose(frame, self.config, progress, cancelled)

    def uncertainty(self, frame: int) -> "workbench.diagnosis.Uncertainty":
        """How well landmarks and priors determine the fit of a frame. Raises `InputError` as `diagnose` does."""
        return self._work.uncertainty(frame, self.config)

    def apply(self, change: "workbench.diagnosis.Change", frame: int) -> Config:
        """Apply a change proposed by the diagnosis of a frame; one undo step."""
        config = change.apply_to(self.config)
        return self.use(moved(config, frame, change.landmarks) if change.landmarks else config, change.label)

    # --- the whole clip ---

    def fit_clip(
        self, progress: Progress | None = None, cancelled: Cancelled = never, config: Config | None = None
    ) -> "workbench.tracking.Track | None":
        """Fit all frames under the current configuration, or another one; None if cancelled.

        These are the frame-by-frame fits of `workbench track`; `temporal` infills and refines them. After a cancelled
        run, the fits of the last complete run stay.
        """
        if self.runs.fit(self.config if config is None else config, progress, cancelled) is None:
            return None
        self.tell("run")
        return self.track

    @property
    def run(self) -> "workbench.session.clip_run.Run | None":
        """The last complete run."""
        return self.runs.last

    @property
    def track(self) -> "workbench.tracking.Track":
        """The last complete run as a track; fits all frames if there is none."""
        return self._work.track_of(self._whole_run())

    @property
    def stale(self) -> Bool[np.ndarray, "n"]:
        """Frames whose fit in the last run belongs to another configuration."""
        return self.runs.stale(self.config)

    def metrics(self) -> dict[str, float]:
        """Errors and jitter of the last complete run; fits all frames if there is none."""
        return self._whole_run().metrics

    def track_fits(self) -> "Sequence[workbench.tracking.FrameFit]":
        """The fits of the last complete run; fits all frames if there is none."""
        return self._whole_run().fits

    def sweep(self, settings: Sequence[str] | str, **options: Any) -> "workbench.sweeps.SweepResult":
        """Try many settings around the current one, for example `session.sweep("weights.tau=log(1e-3,10,13)")`.

        `options`: objectives, frames (a budget), sample, seed, truth, progress, cancelled, grown; see `SessionSweeps`.
        """
        return self._work.sweeps.run([settings] if isinstance(settings, str) else settings, self.config, **options)

    def tune(self, objective: str, learn: Sequence[str] = (), **options: Any) -> "workbench.learning.Tuned":
        """What the clip chooses, e.g. with `session.tune("jitter", ["weights.tau"])`; options as in `tune_material`."""
        return self._work.tune(self.config, objective, learn, **options)

    def _whole_run(self) -> "workbench.session.clip_run.Run":
        if self.run is None:
            self.fit_clip()
        return self.run

    def warm_up(self, cancelled: Cancelled = never) -> None:
        """Compile everything a panel can request. Raises `StoppedError` if cancelled."""
        from workbench.session.readiness import get_ready  # here: see `_make`

        get_ready(self, cancelled)

    # --- export ---

    def export(
        self, path: str | Path, progress: Progress | None = None, cancelled: Cancelled = never, overwrite: bool = False,
        config: Config | None = None,
    ) -> Path:  # fmt: skip
        """Write the configuration (None: the current one) with its provenance, for `workbench track --config`.

        If the last run belongs to another configuration, all frames are fitted first, with infill and refinement if
        configured, so that the metrics in the file are those of its configuration. Raises `InputError` if `cancelled`,
        and for a file that exists, unless it is as this session wrote it or `overwrite` is set.
        """
        path, config = Path(path), config or self.config
        if not self._work.export(path, config, self.base, overwrite, progress, cancelled):
            raise InputError(f"The export was cancelled; {path} was not written.")
        self._tuned.exported = config
        self.tell("export")
        return path

    def load(self, path: str | Path) -> Config:
        """Use the settings of a file (`settings_for`); one undo step. Raises `ConfigError` like `read_config`."""
        from workbench.session.exports import settings_for  # here: see `_make`

        self._tuned.exported = stored = read_config(path)
        return self.use(settings_for(self.material, stored, self.config), f"settings of {Path(path).name}")

    def may_write(self, path: str | Path) -> bool:
        """Whether an export would overwrite nothing, or only a file that is as this session exported it."""
        return self._work.exports.may_write(path)

    def command(self, path: str | Path, config: Config | None = None) -> str:
        """The command line that runs an exported configuration (None: the current one) on this material."""
        from workbench.session.exports import track_command  # here: see `_make`

        return track_command(self.material, path, config or self.config, self._made and self._made.model)

    # --- listeners ---

    def listen(self, callback: Callable[[str], None]) -> Callable[[], None]:
        """Call `callback(what)` after each change of "config", "run", "time", "snapshots" or "export".

        Returns a function that stops the calls. Callbacks run in the thread that made the change.
        """
        self._listeners.append(callback)
        return lambda: self._listeners.remove(callback) if callback in self._listeners else None

    def tell(self, what: str) -> None:
        """Call every listener."""
        for callback in tuple(self._listeners):
            callback(what)


def open_session(
    inputs: "str | Path | Sequence[str | Path] | workbench.tracking.Track | Material",
    config: Config | str | None = None,
    model: "workbench.face.FaceModel | None" = None,
    landmarks: str | Path | None = None,
    stills: bool = False,
    progress: Progress | None = None,
    seen: Callable[[FrameObservation], None] | None = None,
) -> TuningSession:
    """A session on a photo, photos, a clip, a landmark file, a run's folder, a `Track` or its file, or a `Material`.

    `config` is a configuration or the name of a preset; a track has its own, and a preset keeps how its points were
    found. `progress` and `seen` are as for `load_material`. Raises `InputError` and `ConfigError` if one of them cannot
    be read, and `InputError` for a track of a model other than the default head without `model`, or with `landmarks`.
    """
    name = config if isinstance(config, str) else None
    if name is not None:
        config = preset(name)
    if isinstance(inputs, Material):
        return TuningSession(model, inputs, config)
    photos = landmarks is not None or stills  # of a folder, whatever else is in it
    if isinstance(inputs, str | Path) and (stored := stored_track(inputs, folders=not photos)) is not None:
        inputs = workbench.tracking.Track.load(stored)
    if isinstance(inputs, str | Path | Sequence):
        config = config or preset(DEFAULT_PRESET)
        return TuningSession(model, load_material(inputs, config, landmarks, stills, progress, seen), config)
    from workbench.session.stored_material import check_default_head, material_of_track  # here: clips do without it

    if landmarks is not None:
        raise InputError("A track has its own landmarks; open its pictures to give them others.")
    if model is None:
        check_default_head(inputs.meta)
    made = config_of_track(inputs.meta)
    if name is not None and made is not None:
        config = preset_on(name, made)
    return TuningSession(model, material_of_track(inputs), config or made)
