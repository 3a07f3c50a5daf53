"""A tuning session: one configuration under change, its history, and the fits that belong to it. No widgets."""

import shlex
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, UInt8

from workbench.config import DEFAULT_PRESET, Config, Difference, differences, parse_config, preset, write_config
from workbench.diagnosis import (
    Change,
    Diagnosis,
    FrameCase,
    FrameFlags,
    ShotReference,
    diagnose_frame,
    flag_frames,
    reference_of,
)
from workbench.errors import ConfigError, InputError
from workbench.face import FaceModel, load_default_head
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures.deep_strip import stage_strip
from workbench.pipeline import software_versions
from workbench.planning import plan_of
from workbench.session.exports import taken_text
from workbench.session.gesture import Gesture, Gestures
from workbench.session.material import Material, Progress, load_material, material_of_track
from workbench.session.metrics import metrics_of, metrics_of_track
from workbench.session.temporal import TIME_SECTIONS, TemporalWork
from workbench.tracker import calibration_window
from workbench.tracking import FaceItFitter, FrameContext, FrameFit, FrameObservation, StageTrace, Track
from workbench.tracking.deep_fitter import DeepSolution
from workbench.tracking.deep_target import energy_network, photo_landmarks
from workbench.tracking.fitting import (
    Calibrated,
    Continuation,
    Fitter,
    FrameProblem,
    FrameSolution,
    corrected,
    with_face,
)
from workbench.tracking.records import Fits, stack_fits
from workbench.tracking.systems import configured, make_fitter
from workbench.tracking.walk import Walk, context_of

HISTORY = 200
"""Steps that can be taken back."""


@dataclass(frozen=True)
class Step:
    """One entry of the history: the configuration before a change, and what the change was called."""

    config: Config
    label: str


@dataclass(frozen=True, eq=False)
class Run:
    """The fits of all frames under one configuration."""

    config: Config
    track: Track
    """The fits, without metadata: thousands of frames as a few arrays."""
    before: tuple[Continuation | None, ...]
    """What each frame was continued from, in NumPy's arrays: JAX's own take twenty times the memory of such few
    numbers."""

    @property
    def fits(self) -> Sequence[FrameFit]:
        """The fit of each frame."""
        return Fits(self.track)

    @cached_property
    def flags(self) -> FrameFlags:
        """Frames that stand out."""
        return flag_frames(self.track, self.config)

    @cached_property
    def metrics(self) -> dict[str, float]:
        """Errors and jitter."""
        return metrics_of_track(self.track)


class TuningSession:
    """Frames, landmarks, model and a configuration that is tuned; the panel is a view on this.

    `fit_frame` fits one frame under the present configuration in the context of the last whole run (the frame before
    it, as that run left it). `fit_clip` runs all frames, with the same numbers as `workbench track`. Methods may be
    called from any thread.
    """

    def __init__(self, model: FaceModel, material: Material, config: Config | None = None):
        self.model, self.material = model, material
        self.base = preset(DEFAULT_PRESET) if config is None else config
        self._config = self.base
        self._undo: list[Step] = []
        self._redo: list[Step] = []
        self._gestures = Gestures()
        self._snapshots: dict[str, Config] = {}
        self._exported: Config | None = None
        self._written: set[Path] = set()
        self._run: Run | None = None
        self._base_metrics: dict[str, float] | None = None
        self._calibrations: dict[tuple, Calibrated] = {}
        self._listeners: list[Callable[[str], None]] = []
        self._lock = threading.RLock()
        self._fitting = threading.RLock()
        self._calibrating = threading.Lock()
        self._diagnosing = threading.Lock()
        self._fitter = make_fitter(model, plan_of(self.base))
        self._fitter_config = self.base
        """What the fitter follows now."""
        self._diagnostic_fitter: FaceItFitter | None = None
        self._targets: dict[tuple[int, str], Landmarks2D] = {}
        self._solution: tuple[tuple, FrameSolution] | None = None
        self._reference: tuple[tuple[int, Config], ShotReference] | None = None
        self.temporal = TemporalWork(self)
        """Infill and refinement of the clip."""

    def __repr__(self) -> str:
        return f"TuningSession({self.material.name!r}, {len(self)} frames, preset {self._config.preset!r})"

    def __len__(self) -> int:
        return len(self.material.observations)

    # --- configuration and history ---

    @property
    def config(self) -> Config:
        """The present configuration."""
        return self._config

    def set(self, label: str = "", gesture: Gesture | str | None = None, **sections: Any) -> Config:
        """Change keys of sections, as `Config.changed`; one step of undo.

        Changes with the same `gesture` are one step: those of one drag of a slider however slow, others if they follow
        each other within 0.8 s. Raises `ConfigError` for what a configuration cannot hold, and leaves everything as it
        was.
        """
        return self.use(self._config.changed(**sections), label or ", ".join(sections), gesture)

    def use(self, config: Config, label: str = "configuration", gesture: Gesture | str | None = None) -> Config:
        """Replace the whole configuration; one step of undo."""
        with self._lock:
            if config == self._config:
                return config
            if not self._gestures.goes_on(gesture):
                self._undo = [*self._undo[-HISTORY + 1 :], Step(self._config, label)]
            self._redo = []
            self._config = config
        self.tell("config")
        return config

    def undo(self) -> str | None:
        """Take back the last change; its label, None if there is none."""
        return self._travel(self._undo, self._redo)

    def redo(self) -> str | None:
        """Make the change again that was taken back last; its label, None if there is none."""
        return self._travel(self._redo, self._undo)

    @property
    def undo_label(self) -> str | None:
        """What `undo` would take back."""
        return self._undo[-1].label if self._undo else None

    @property
    def redo_label(self) -> str | None:
        """What `redo` would make again."""
        return self._redo[-1].label if self._redo else None

    def take_snapshot(self, name: str) -> None:
        """Keep the present configuration under a name. Raises `ConfigError` for an empty name."""
        if not name.strip():
            raise ConfigError("A snapshot needs a name.")
        self._snapshots[name.strip()] = self._config
        self.tell("snapshots")

    def restore_snapshot(self, name: str) -> Config:
        """Return to a snapshot; one step of undo. Raises `ConfigError` for a name that was never taken."""
        return self.use(self._snapshot(name), f"snapshot {name}")

    @property
    def snapshots(self) -> Mapping[str, Config]:
        """Configurations that were kept, by name."""
        return dict(self._snapshots)

    def changes(self, since: Config | str | None = None) -> list[Difference]:
        """What differs from a configuration, a snapshot by name, or the start of the session (default)."""
        if isinstance(since, str):
            since = self._snapshot(since)
        return differences(self.base if since is None else since, self._config)

    @property
    def unexported(self) -> list[Difference]:
        """What changed since the last export, or since the start if there was none."""
        return self.changes(self._exported)

    def _snapshot(self, name: str) -> Config:
        if name not in self._snapshots:
            known = ", ".join(self._snapshots) or "none yet"
            raise ConfigError(f"There is no snapshot {name!r}; there are: {known}.")
        return self._snapshots[name]

    def _travel(self, source: list[Step], target: list[Step]) -> str | None:
        with self._lock:
            if not source:
                return None
            step = source.pop()
            target.append(Step(self._config, step.label))
            self._config = step.config
            self._gestures.end()
        self.tell("config")
        return step.label

    # --- landmarks and stages ---

    def weigh(self, points: Iterable[int], factor: float | int, label: str = "") -> Config:
        """Set the factor of single landmarks in every stage; 0 mutes, 1 is as configured."""
        stored = dict(self._config.landmarks.weights)
        for point in points:
            stored.pop(str(point), None)
            stored[str(point)] = float(factor)
        # A point that only its own entry touches needs none for a factor of one.
        groups = {name: value for name, value in stored.items() if not name.isdigit()}
        singles = {name: value for name, value in stored.items() if name.isdigit() and (value != 1.0 or groups)}
        return self._set_landmarks("weights", groups | singles, label or "landmark weight")

    def move(self, frame: int, point: int, place: tuple[float, float], gesture: Gesture | str | None = None) -> Config:
        """Put a detection of one frame where it belongs, pixels."""
        self.observation(frame)
        moved = {key: dict(points) for key, points in self._config.landmarks.moved.items()}
        moved.setdefault(str(frame), {})[str(point)] = (float(place[0]), float(place[1]))
        return self._set_landmarks("moved", moved, f"landmark {point} of frame {frame}", gesture)

    def put_back(self, frame: int, points: Iterable[int]) -> Config:
        """Give points of a frame the places that the detector gave them."""
        moved = {key: dict(places) for key, places in self._config.landmarks.moved.items()}
        for point in points:
            moved.get(str(frame), {}).pop(str(point), None)
        moved = {key: places for key, places in moved.items() if places}
        return self._set_landmarks("moved", moved, f"detections of frame {frame}")

    def save_subset(self, name: str, points: Iterable[int]) -> Config:
        """Name a set of landmarks, for stages and weights. Raises `ConfigError` for an empty one or a group's name."""
        points = tuple(sorted({int(point) for point in points}))
        if not points:
            raise ConfigError("A landmark subset needs at least one point; select some first.")
        return self.set(f"subset {name}", subsets={name: points})

    def _set_landmarks(self, key: str, value: dict, label: str, gesture: Gesture | str | None = None) -> Config:
        stored = self._config.landmarks.model_dump()
        stored[key] = value
        return self.set(label, gesture, landmarks=stored)

    # --- frames and fits ---

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the energy's terms under the present configuration."""
        return self._config.terms

    def observation(self, frame: int, config: Config | None = None) -> FrameObservation:
        """A frame's observation with the detections that were moved. Raises `InputError` outside the material."""
        config = self._config if config is None else config
        if not 0 <= frame < len(self):
            raise InputError(f"There is no frame {frame}; {self.material.name} has frames 0 to {len(self) - 1}.")
        return self._observed(frame, config)

    def _observed(self, frame: int, config: Config, pictured: bool = False) -> FrameObservation:
        return corrected(self._detected(frame, config, pictured), config.moved_points(frame))

    def _detected(self, frame: int, config: Config, pictured: bool = False) -> FrameObservation:
        """A frame as the system wants it: Deep Energies looks at the photo with its own network, N(F*).

        `pictured`: with the picture, where there is one.
        """
        observation = self.material.observations[frame]
        if not config.traits.renders or observation.landmarks is None or not self.material.pictures.real:
            return observation
        picture, key = self.material.pictures[frame], (frame, config.deep.network)
        if key not in self._targets:
            network = energy_network(config.deep.network)
            self._targets[key] = photo_landmarks(network, picture, observation.landmarks)
        return replace(observation, landmarks=self._targets[key], picture=picture if pictured else None)

    def picture(self, frame: int) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a frame; blank where the material has none."""
        self.observation(frame)
        return self.material.pictures[frame]

    def fit_frame(self, frame: int, coarse: bool = False, config: Config | None = None) -> FrameFit:
        """The fit of one frame under the present configuration, or another one that it is compared with.

        `coarse` keeps an identity that an earlier configuration calibrated on the shot, for dragging in a clip.
        """
        with self._fitting:
            return self._fitter.record(self._solved(self._problem(frame, coarse, config)))

    def explain_frame(self, frame: int) -> tuple[FrameFit, tuple[StageTrace, ...]]:
        """`fit_frame` with every iteration kept. Raises `InputError` for a frame without landmarks."""
        with self._fitting:
            solution = self._traced(frame)
            return self._fitter.record(solution), self._fitter.traces(solution)

    def solve_frame(self, frame: int) -> DeepSolution | None:
        """What every stage of Deep Energies made of a frame; None under FACE IT! and without a face."""
        with self._fitting:
            problem = self._problem(frame, coarse=True)
            if not self._fitter.renders or problem.observation.landmarks is None:
                return None
            return self._solved(problem)

    def stage_strip(self, frame: int) -> UInt8[np.ndarray, "h w 3"] | None:
        """The stages of Deep Energies on a frame as a film strip; None where there is nothing to draw."""
        solution = self.solve_frame(frame)
        if solution is None or not self.material.pictures.real:
            return None
        with self._fitting:
            return stage_strip(self.picture(frame), self._fitter, solution)

    def fit_steps(self, frame: int, steps: int) -> FrameFit:
        """The fit of a frame stopped after `steps` iterations, counted through all stages.

        Raises `InputError` for a frame without landmarks.
        """
        with self._fitting:
            return self._fitter.record(self._fitter.stopped(self._traced(frame), steps))

    def context(self, frame: int) -> FrameContext:
        """What the fit of a frame starts from under the present configuration."""
        with self._fitting:
            return self._problem(frame, coarse=False).context

    def diagnose(self, frame: int) -> Diagnosis:
        """Reasons why the fit of a frame may be bad, and why the last whole run flags it if it does.

        Raises `InputError` for a frame without landmarks.
        """
        if not self._config.traits.diagnosed:
            raise InputError(
                "The diagnosis tries changes to FACE IT!; go to a FACE IT! preset for it. What failed under Deep "
                "Energies is named beside the frame, and the film strip shows at which stage."
            )
        with self._fitting:
            config, problem = self._config, self._problem(frame, coarse=False)
        observation, context = problem.observation, problem.context
        frames = self.material.shots[context.shot]
        shot = [corrected(self.material.observations[k], config.moved_points(k)) for k in frames]
        real = self.material.pictures.real
        previous = self.picture(frame - 1) if real and frame - 1 in frames else None
        case = FrameCase(observation, context, config, shot, self.picture(frame) if real else None, previous)
        with self._diagnosing:
            if self._diagnostic_fitter is None:
                self._diagnostic_fitter = FaceItFitter(self.model, plan_of(config))
            key = (context.shot, config)
            if self._reference is None or self._reference[0] != key:
                self._reference = (key, reference_of(self.model, config, shot, self._diagnostic_fitter))
            found = diagnose_frame(self.model, case, self._diagnostic_fitter, self._reference[1])
        return replace(found, flag="" if self._run is None else self._run.flags.text[frame])

    def apply(self, change: Change, frame: int) -> Config:
        """Make a change that a diagnosis of a frame proposes; one step of undo."""
        config = change.apply_to(self._config)
        if change.landmarks:
            stored = config.landmarks.model_dump()
            moved = dict(stored["moved"].get(str(frame), {}))
            moved |= {str(point): (float(x), float(y)) for point, (x, y) in change.landmarks.items()}
            stored["moved"] = {**stored["moved"], str(frame): moved}
            config = config.changed(landmarks=stored)
        return self.use(config, change.label)

    def fit_clip(
        self,
        progress: Progress | None = None,
        cancelled: Callable[[], bool] = lambda: False,
        config: Config | None = None,
    ) -> Track | None:
        """Fit all frames under the present configuration, or another one; None if cancelled.

        These are the fits of single frames, as `workbench track` makes them; `temporal` works on them over time. A
        cancelled run leaves the fits of the last whole one.
        """
        config = self._config if config is None else config
        walk = Walk(make_fitter(self.model, plan_of(config)))
        fits, before = [], []
        for shot, frames in enumerate(self.material.shots):
            walk.begin_shot(self._calibrated(shot, config, walk.fitter))
            for frame in frames:
                if cancelled():
                    return None
                fit, context = walk.step(self.observation(frame, config))
                fits.append(fit)
                before.append(_on_host(context.last))
                if progress is not None:
                    progress("fit", len(fits), len(self))
        run = Run(config, Track(meta={}, **stack_fits(fits)), tuple(before))
        with self._lock:
            self._run = run
            if config == self.base:
                self._base_metrics = run.metrics
        self.tell("run")
        return self.track

    @property
    def run(self) -> Run | None:
        """The last whole run."""
        return self._run

    @property
    def track(self) -> Track:
        """The last whole run as a track; runs all frames if there was none."""
        run = self._whole_run()
        meta = {
            "expression_names": list(self.model.expression_names),
            "stages": [stage.name for stage in run.config.stages if stage.enabled],
            "stills": self.material.stills,
            "camera_guessed": run.config.camera.matrix is None,
            "config": run.config.model_dump(mode="json"),
        }
        return replace(run.track, meta=meta)

    @property
    def stale(self) -> Bool[np.ndarray, "n"]:
        """Frames whose fit in the last run belongs to another configuration."""
        if self._run is None:
            return np.ones(len(self), bool)
        if _without_moves(self._run.config) != _without_moves(self._config):
            return np.ones(len(self), bool)
        before, now = self._run.config.landmarks.moved, self._config.landmarks.moved
        frames = {int(key) for key in {*before, *now} if before.get(key) != now.get(key)}
        stale = np.zeros(len(self), bool)
        for shot in self.material.shots:
            # A moved point can reach every frame of its shot: through the identity, and from frame to frame.
            touched = [frame for frame in shot if frame in frames]
            if touched:
                stale[shot.start : shot.stop] = True
        return stale

    def metrics(self) -> dict[str, float]:
        """Errors and jitter of the last whole run; runs all frames if there was none."""
        return self._whole_run().metrics

    def track_fits(self) -> Sequence[FrameFit]:
        """The fits of the last whole run; runs all frames if there was none."""
        return self._whole_run().fits

    def _whole_run(self) -> Run:
        if self._run is None:
            self.fit_clip()
        return self._run

    def warm_up(self) -> None:
        """Compile all that a panel can ask for: every solver, with and without its trace, and a diagnosis."""
        size = self.material.observations[0].image_size
        if not self.base.traits.real_time:
            self.fit_frame(0)
            return
        for changes in ({}, {"method": "optimistix-lm"}, {"method": "optimistix-dogleg"}):
            solver = {"method": "lm", "bounded": False, **changes}
            fitter = FaceItFitter(self.model, plan_of(self.base.changed(solver=solver)))
            fitter.warm_up(size, trace=True)
        for frames in {1, self.base.identity.frames}:
            fitter.calibrate([fitter.neutral_observation(size)], frames)
        seen = [k for k, observation in enumerate(self.material.observations) if observation.landmarks is not None]
        if seen:
            self.diagnose(seen[0])

    # --- export ---

    def export(
        self,
        path: str | Path,
        progress: Progress | None = None,
        cancelled: Callable[[], bool] = lambda: False,
        overwrite: bool = False,
    ) -> Path:
        """Write the configuration with its provenance; `workbench track --config` runs it to the same numbers.

        All frames are fitted first if the last run belongs to another configuration, and worked on over time if it
        asks for that, so that the metrics in the file are those of the file. Raises `InputError` if `cancelled`, and
        for a file that is there already, unless this session wrote it or `overwrite` is set.
        """
        path, config = Path(path), self._config
        if not overwrite and not self.may_write(path):
            raise InputError(taken_text(path, self.material.name))
        fits = self.temporal.fits_by(config, progress, cancelled)
        if fits is None:
            raise InputError(f"The export was cancelled; {path} was not written.")
        after = metrics_of(fits)
        before = self._base_metrics if self._base_metrics is not None else self._metrics_of_base(progress)
        provenance = {
            "exported": datetime.now(UTC).isoformat(timespec="seconds"),
            "versions": software_versions(),
            "model": f"{self.model.name} sha256:{self.model.fingerprint()}",
            "inputs": self.material.sources(),
            "landmarks": self.material.landmark_source(),
            "changed": [str(item) for item in differences(self.base, config)],
            "before": before,
            "after": after,
        }
        write_config(config.changed(provenance=provenance), path)
        self._exported = config
        self._written.add(path.absolute())
        self.tell("export")
        return path

    def may_write(self, path: str | Path) -> bool:
        """Whether an export overwrites nothing but what this session exported before."""
        return not Path(path).exists() or Path(path).absolute() in self._written

    def command(self, path: str | Path) -> str:
        """The command line that runs an exported configuration on this material."""
        words = ["workbench", "track", *(self.material.inputs or ["INPUT"]), "--config", path]
        if self.material.landmark_file is not None:
            words += ["--landmarks", self.material.landmark_file]
        if self.material.stills and len(self) > 1:
            words.append("--stills")
        return shlex.join(str(word) for word in words)

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

    # --- within ---

    def _configure(self, config: Config) -> None:
        if self._fitter_config is not config:
            self._fitter, self._fitter_config = configured(self._fitter, plan_of(config)), config

    def _solved(self, problem: FrameProblem, traced: bool = False) -> FrameSolution:
        """A frame's problem solved. Where a solution holds renders the newest is kept: a panel asks for its fit, its
        path and its pictures."""
        observation, context = problem.observation, problem.context
        if not self._fitter.renders or observation.landmarks is None:
            return self._fitter.solve(problem, traced)
        points, identity = observation.landmarks.points.tobytes(), context.identity.tobytes()
        key = (observation.index, _without_moves(self._fitter_config), identity, points)
        if self._solution is None or self._solution[0] != key:
            self._solution = (key, self._fitter.solve(problem))
        return self._solution[1]

    def _traced(self, frame: int) -> FrameSolution:
        """A frame solved with every iteration kept. Raises `InputError` for one without landmarks."""
        problem = self._problem(frame, coarse=True)
        with_face(problem.observation)
        return self._solved(problem, traced=True)

    def _problem(self, frame: int, coarse: bool, config: Config | None = None) -> FrameProblem:
        """What the solver is given of a frame, after the frame before it as the last whole run left that."""
        config = self._config if config is None else config
        observation = self.observation(frame, config)
        shot = next(number for number, frames in enumerate(self.material.shots) if frame in frames)
        self._configure(config)
        calibrated = self._calibrated(shot, config, self._fitter, coarse)
        last = _on_device(self._run.before[frame]) if self._run is not None else None
        return self._fitter.problem(observation, context_of(observation, shot, calibrated, last))

    def _calibrated(self, shot: int, config: Config, fitter: Fitter, coarse: bool = False) -> Calibrated:
        if not fitter.calibrates:
            return Calibrated(fitter.mean_identity(), {})
        stills = self.material.stills
        frames = self.material.shots[shot]
        seen = self.material.observations[frames.start : frames.stop]
        window = calibration_window(seen, 1 if stills else config.identity.window)
        window = [self._observed(item.index, config, pictured=True) for item in window]
        if not any(observation.landmarks is not None for observation in window):
            return Calibrated(fitter.mean_identity(), {})
        key = (shot, _identity_key(config, window))
        with self._calibrating:
            if coarse and len(frames) > 1 and key not in self._calibrations:
                earlier = [found for (number, _), found in self._calibrations.items() if number == shot]
                if earlier:
                    return earlier[-1]._replace(starts={})
            if key not in self._calibrations:
                self._calibrations[key] = fitter.calibrate(window, 1 if stills else config.identity.frames)
                while len(self._calibrations) > 4 * len(self.material.shots) + 32:
                    self._calibrations.pop(next(iter(self._calibrations)))
            return self._calibrations[key]

    def _metrics_of_base(self, progress: Progress | None) -> dict[str, float]:
        other = TuningSession(self.model, self.material, self.base)
        other.fit_clip(progress)
        self._base_metrics = other.run.metrics
        return self._base_metrics


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


def _on_host(last: Continuation | None) -> Continuation | None:
    return jax.tree.map(lambda leaf: np.array(leaf) if isinstance(leaf, jax.Array) else leaf, last)


def _on_device(last: Continuation | None) -> Continuation | None:
    """The continuation as the frame before left it, so that nothing compiles again."""
    if last is None:
        return None
    numbers = jax.tree.map(jnp.asarray, (last.parameters, last.pose, last.last_pose))
    return Continuation(*numbers, last.frames, last.points)


def _without_moves(config: Config) -> str:
    """What the fit of a single frame depends on, but for the points that were moved."""
    left_out = dict.fromkeys(("preset", "provenance", *TIME_SECTIONS), True)
    return config.model_dump_json(exclude={**left_out, "landmarks": {"moved"}})


def _identity_key(config: Config, window: Sequence[FrameObservation]) -> str:
    """What the identity of a shot depends on."""
    moved = {key: config.landmarks.moved[key] for item in window if (key := str(item.index)) in config.landmarks.moved}
    kept = {"system", "camera", "identity", "contour", "subsets"}
    kept |= {"deep"} if config.traits.reads("deep") else set()
    sections = config.model_dump_json(include=kept)
    return f"{sections}{config.point_weights()}{moved}"
