"""FACE IT! over a stream of landmarks: identity calibration, first poses, and one frame after the other."""

import copy
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.config import Config, Stage
from workbench.energies import TERMS, EnergyConstants, EnergyWeights
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, LandmarkModel, landmark_model
from workbench.geometry import Camera, camera_from_fov, camera_from_matrix, project, yaw_pitch_roll_deg
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import outer_eye_distance
from workbench.tracking.frame_solver import (
    FrameInput,
    FrameSolution,
    SolveSettings,
    StageNumbers,
    read_report,
    solve_frame,
)
from workbench.tracking.identity import CalibrationSettings, calibrate_identity, spread_over_yaw
from workbench.tracking.initial_pose import initial_pose
from workbench.tracking.records import FrameFit

TRACE_LENGTH = 500
"""Longest trace; the largest limit that a stage may have."""
JUMP = 0.5
"""Mean landmark motion between frames, in outer-eye distances, that restarts the pose."""


@dataclass(frozen=True)
class FrameObservation:
    """What a frame brings to the tracker."""

    index: int
    landmarks: Landmarks2D | None
    image_size: tuple[int, int]
    source: str = "given"
    cut: bool = False
    """Whether this frame starts a new shot."""
    milliseconds: tuple[float, float] = (0.0, 0.0)
    """Time that detection and landmarks took."""


class Continuation(NamedTuple):
    """What one frame hands to the next."""

    parameters: FaceParameters
    pose: Float[np.ndarray, "6"]
    last_pose: Float[np.ndarray, "6"]
    frames: int
    """Frames since the restart, this one included."""
    points: Float[np.ndarray, "68 2"]


def camera_of(config: Config, image_size: tuple[int, int]) -> Camera:
    """The configured camera of a picture (width, height): given, or guessed from the field of view."""
    if config.camera.matrix is not None:
        return camera_from_matrix(np.array(config.camera.matrix), np.array(config.camera.distortion))
    return camera_from_fov(image_size, config.camera.fov_deg)


def solve_settings(config: Config) -> SolveSettings:
    """The traced part of a configuration."""
    lower, upper = (0.0, 1.0) if config.solver.bounded else (-np.inf, np.inf)
    return _on_device(
        SolveSettings(
            weights=EnergyWeights(**config.weights.model_dump(), identity=config.identity.weight),
            constants=EnergyConstants(**config.constants.model_dump()),
            lower=lower,
            upper=upper,
            tolerance=config.solver.tolerance,
            percent=float(config.solver.unit == "percent"),
            sliding=float(config.contour.sliding),
        )
    )


def stage_program(config: Config, start: bool) -> tuple[tuple[tuple[str, ...], ...], tuple[StageNumbers, ...]]:
    """Free parameters (part of the program) and numbers (data) of the stages of a first or a later frame."""
    chosen = running_stages(config, start)
    numbers = tuple(StageNumbers(jnp.asarray(stage.limit), jnp.asarray(stage.landmark_weights())) for stage in chosen)
    return tuple(stage.free for stage in chosen), numbers


def running_stages(config: Config, start: bool) -> list[Stage]:
    """The stages that run on the first frame of a shot (`start`) or on a later one."""
    return [stage for stage in config.stages if stage.enabled and (start or stage.when == "always")]


class StageTrace(NamedTuple):
    """Every iteration of one stage; row 0 is the start."""

    stage: str
    energies: Float[np.ndarray, "steps 7"]
    """Weighted energy of each of `energies.TERMS`."""
    residuals_px: Float[np.ndarray, "steps 68"]
    """Distance of each model landmark from the observed one."""


class FaceTracker:
    """Landmarks in, fits out. `push` may hold frames back until the identity of their shot is calibrated."""

    def __init__(self, model: FaceModel, config: Config, stills: bool = False):
        """`stills`: every frame is its own shot, no term links it to another."""
        self.model = model
        self.stills = stills
        self._landmarks = landmark_model(model)
        self._cameras: dict[tuple[int, int], tuple[Camera, Camera]] = {}
        self._shot = -1
        self._pending: list[FrameObservation] = []
        self.configure(config)
        self._start_shot()

    def warm_up(self, image_size: tuple[int, int]) -> None:
        """Compile (or load from the cache) all that a run needs, so that its first frames are as fast as the others."""
        other = FaceTracker(self.model, self.config, stills=self.stills)
        neutral = self._landmarks.frontal_neutral()
        camera = self.camera(image_size)
        points = np.asarray(project(camera, neutral + np.array([0.0, 0.0, 600.0])))
        landmarks = Landmarks2D(points, np.ones(68), image_size)
        for index in range(2):
            other.push(FrameObservation(index, landmarks, image_size))
        other.finish()

    def configure(self, config: Config) -> None:
        """Use another configuration from the next frame on; only another order of free parameters compiles."""
        self.config = config
        self._settings = solve_settings(config)
        self._start_program = stage_program(config, start=True)
        self._next_program = stage_program(config, start=False)
        self._cameras.clear()

    def push(self, observation: FrameObservation) -> list[FrameFit]:
        """Take the next frame; return the fits that are ready, in order."""
        ready = []
        if (observation.cut or self.stills) and (self._pending or self._seen):
            ready += self.finish()
            self._start_shot()
        self._seen = True
        self._pending.append(observation)
        if self._identity is None and self._faces_pending():
            if len(self._pending) < (1 if self.stills else self.config.identity.window):
                return ready
            self._calibrate(self._pending)
        return ready + self._flush()

    def explain(self, observation: FrameObservation) -> tuple[FrameFit, tuple["StageTrace", ...]]:
        """Fit one frame as the next `push` would, with every iteration kept; the tracker itself does not move.

        The identity is the calibrated one if the shot has it, else (and for stills) calibrated on this frame alone.
        Raises `InputError` for a frame without landmarks.
        """
        if observation.landmarks is None:
            raise InputError(f"Frame {observation.index} has no landmarks; explain a frame with a face.")
        probe = copy.copy(self)
        probe._starts = dict(self._starts)
        if self.stills:
            probe._start_shot()
        if probe._identity is None:
            probe._calibrate([observation])
        last = probe._continuing(observation)
        fit, solution = probe._solve(observation, last, TRACE_LENGTH)
        names = [stage.name for stage in running_stages(self.config, start=last is None)]
        iterations = fit.iterations[len(fit.iterations) - len(names) :]
        traces = tuple(
            StageTrace(name, np.asarray(energies)[: count + 1], np.asarray(residuals)[: count + 1])
            for name, (energies, residuals), count in zip(names, solution.traces, iterations, strict=True)
        )
        return fit, traces

    def finish(self) -> list[FrameFit]:
        """Fits of the frames still held back: the shot has ended."""
        if self._identity is None and self._faces_pending():
            self._calibrate(self._pending)
        return self._flush()

    def fit_all(self, observations: Iterable[FrameObservation]) -> Iterator[FrameFit]:
        """`push` for each observation, then `finish`."""
        for observation in observations:
            yield from self.push(observation)
        yield from self.finish()

    def state(self) -> dict[str, np.ndarray] | None:
        """Everything the next frame depends on, as plain arrays; None while frames are held back."""
        if self._pending:
            return None
        arrays = {"shot": np.array(self._shot), "seen": np.array(self._seen)}
        if self._identity is not None:
            arrays["identity"] = self._identity
        if self._last is not None:
            arrays |= {f"parameters_{k}": np.asarray(value) for k, value in enumerate(self._last.parameters)}
            arrays |= {"pose": np.asarray(self._last.pose), "last_pose": np.asarray(self._last.last_pose)}
            arrays |= {"frames": np.array(self._last.frames), "points": self._last.points}
        return arrays

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Go on from a `state`."""
        self._start_shot()
        self._shot, self._seen = int(arrays["shot"]), bool(arrays["seen"])
        if "identity" in arrays:
            self._use_identity(arrays["identity"])
        if "pose" in arrays:
            parameters = FaceParameters(*(jnp.asarray(arrays[f"parameters_{k}"]) for k in range(4)))
            self._last = Continuation(
                parameters,
                jnp.asarray(arrays["pose"]),
                jnp.asarray(arrays["last_pose"]),
                int(arrays["frames"]),
                arrays["points"],
            )

    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera used for pictures of this size."""
        return self._camera_pair(image_size)[0]

    def _camera_pair(self, image_size):
        if image_size not in self._cameras:
            camera = camera_of(self.config, image_size)
            self._cameras[image_size] = (camera, _on_device(camera))
        return self._cameras[image_size]

    def _start_shot(self) -> None:
        self._shot += 1
        self._seen = False
        self._last: Continuation | None = None
        self._starts: dict[int, FaceParameters] = {}
        self._identity = None
        if not self.config.identity.calibrate:
            self._use_identity(np.zeros(len(self.model.identity_deltas)))

    def _use_identity(self, identity: Float[np.ndarray, "i"]) -> None:
        self._identity = np.asarray(identity, float)
        personal = self._landmarks.personal(self._identity)
        self._neutral = personal.frontal_neutral()
        self._personal: LandmarkModel = _on_device(personal)

    def _faces_pending(self) -> bool:
        return any(observation.landmarks is not None for observation in self._pending)

    def _flush(self) -> list[FrameFit]:
        pending, self._pending = self._pending, []
        return [self._fit(observation) for observation in pending]

    def _calibrate(self, observations: list[FrameObservation]) -> None:
        usable = [observation for observation in observations if observation.landmarks is not None]
        neutral = self._landmarks.frontal_neutral()
        poses = [
            initial_pose(self.camera(observation.image_size), neutral, observation.landmarks.points)
            for observation in usable
        ]
        count = 1 if self.stills else self.config.identity.frames
        chosen = spread_over_yaw(yaw_pitch_roll_deg(np.array([rotation for rotation, _ in poses]))[:, 0], count)
        result = self._calibrate_on([usable[k] for k in chosen], [poses[k] for k in chosen], count)
        self._use_identity(np.asarray(result.identity))
        for row, k in enumerate(chosen):
            start = jax.tree.map(lambda stacked, row=row: stacked[row], result.frames)
            self._starts[usable[k].index] = start._replace(identity=jnp.zeros(0))

    def _calibrate_on(self, observations, poses, count):
        # A fixed number of frames, missing ones with weight zero, so that every shot runs the same program.
        padding = count - len(observations)
        observations = observations + observations[-1:] * padding
        poses = poses + poses[-1:] * padding
        identity = self.config.identity
        weights = np.stack([observation.landmarks.confidence for observation in observations])
        weights[count - padding :] = 0.0
        cameras = [self.camera(observation.image_size) for observation in observations]
        first_pass = np.ones(68)
        first_pass[:17] = 0.0
        second_pass = np.ones(68)
        second_pass[:17] = identity.jaw
        settings = CalibrationSettings(
            identity=identity.weight,
            expression=identity.expression,
            limits=tuple(identity.limits),
            landmark_weights=np.stack([first_pass, second_pass]),
            sliding=float(self.config.contour.sliding),
        )
        starts = FaceParameters(
            rotation=np.array([rotation for rotation, _ in poses]),
            translation=np.array([translation for _, translation in poses]),
            expression=np.zeros((count, len(self.model.expression_names))),
            identity=np.zeros((count, len(self.model.identity_deltas))),
        )
        return calibrate_identity(
            Camera(*(np.stack(part) for part in zip(*cameras, strict=True))),
            self._landmarks,
            settings,
            starts,
            np.stack([observation.landmarks.points for observation in observations]),
            weights,
        )

    def _fit(self, observation: FrameObservation) -> FrameFit:
        if observation.landmarks is None:
            self._last = None
            return self._empty(observation)
        fit, solution = self._solve(observation, last := self._continuing(observation))
        self._last = Continuation(
            solution.parameters,
            solution.pose,
            solution.pose if last is None else last.pose,
            1 if last is None else last.frames + 1,
            observation.landmarks.points,
        )
        return fit

    def _continuing(self, observation: FrameObservation) -> Continuation | None:
        if self._last is None or self._jumped(self._last.points, observation.landmarks.points):
            return None
        return self._last

    def _solve(
        self, observation: FrameObservation, last: Continuation | None, trace_length: int = 0
    ) -> tuple[FrameFit, FrameSolution]:
        began = time.perf_counter()
        camera, camera_on_device = self._camera_pair(observation.image_size)
        stages, numbers = self._start_program if last is None else self._next_program
        frame = self._frame_input(observation, last)
        solution = solve_frame(
            stages, camera_on_device, self._personal, self._settings, numbers, frame, trace_length=trace_length
        )
        fetched = read_report(solution)
        milliseconds = 1e3 * (time.perf_counter() - began)
        return self._record(observation, camera, stages, fetched, milliseconds), solution

    def _frame_input(self, observation: FrameObservation, last: Continuation | None) -> FrameInput:
        points = observation.landmarks.points
        measured = np.column_stack([points, observation.landmarks.confidence])
        if last is not None:
            history = _ONE if last.frames >= 2 else _ZERO
            return FrameInput(measured, last.pose, last.last_pose, history, last.parameters)
        start = self._starts.get(observation.index)
        if start is None:
            rotation, translation = initial_pose(self.camera(observation.image_size), self._neutral, points)
            expression = np.zeros(len(self.model.expression_names))
            start = FaceParameters(rotation, translation, expression, np.zeros(0))
        return FrameInput(measured, _NO_POSE, _NO_POSE, _ZERO, start)

    @staticmethod
    def _jumped(before: Float[np.ndarray, "68 2"], now: Float[np.ndarray, "68 2"]) -> bool:
        return float(np.linalg.norm(now - before, axis=1).mean()) > JUMP * outer_eye_distance(before)

    def _record(self, observation, camera, stages, solution: FrameSolution, milliseconds: float) -> FrameFit:
        # Rows are laid out for the longest program, so that first and later frames stack.
        rows = len(self._start_program[0])
        place = slice(rows - len(stages), rows)
        energies = np.full((rows, len(TERMS)), np.nan)
        status, iterations = np.full(rows, -1), np.zeros(rows, int)
        energies[place], status[place], iterations[place] = solution.energies, solution.status, solution.iterations
        return FrameFit(
            index=observation.index,
            found=True,
            shot=self._shot,
            source=observation.source,
            image_size=observation.image_size,
            camera=camera,
            rotation=solution.parameters.rotation,
            translation=solution.parameters.translation,
            expression=solution.parameters.expression,
            identity=self._identity,
            observed=observation.landmarks.points,
            confidence=observation.landmarks.confidence,
            projected=solution.projected,
            energies=energies,
            status=status,
            iterations=iterations,
            milliseconds=np.array([*observation.milliseconds, milliseconds]),
        )

    def _empty(self, observation: FrameObservation) -> FrameFit:
        rows = len(self._start_program[0])
        missing = lambda *shape: np.full(shape, np.nan)  # noqa: E731
        return FrameFit(
            index=observation.index,
            found=False,
            shot=self._shot,
            source="none",
            image_size=observation.image_size,
            camera=self.camera(observation.image_size),
            rotation=missing(3),
            translation=missing(3),
            expression=missing(len(self.model.expression_names)),
            identity=missing(len(self.model.identity_deltas)),
            observed=missing(68, 2),
            confidence=missing(68),
            projected=missing(68, 2),
            energies=missing(rows, len(TERMS)),
            status=np.full(rows, -1),
            iterations=np.zeros(rows, int),
            milliseconds=np.array([*observation.milliseconds, 0.0]),
        )


def _on_device(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


_ZERO, _ONE, _NO_POSE = jnp.zeros(()), jnp.ones(()), jnp.zeros(6)
