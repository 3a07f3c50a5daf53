"""One frame under one configuration: calibrate, fit, explain. Knows what came before a frame only by its context."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from workbench.arrays import AnyArray
from workbench.config import Config, Stage
from workbench.energies import EnergyConstants
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, LandmarkModel, landmark_model
from workbench.geometry import Camera, camera_from_fov, camera_from_matrix, project, yaw_pitch_roll_deg
from workbench.landmarks.observations import Landmarks2D
from workbench.rendering import Appearance
from workbench.runtime import COMPUTING
from workbench.tracking.frame_solver import (
    STAGE_SLOTS,
    UNKNOWNS,
    FrameInput,
    FrameSolution,
    SolveSettings,
    StageProgram,
    read_report,
    solve_frame,
)
from workbench.tracking.identity import CalibrationSettings, calibrate_identity, spread_over_yaw
from workbench.tracking.initial_pose import initial_pose
from workbench.tracking.records import FrameFit

TRACE_LENGTH = 500
"""Longest trace; the largest limit that a stage may have."""


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
    picture: UInt8[np.ndarray, "h w 3"] | None = None
    """RGB, where the fit wants it: Deep Energies takes colours and light from one."""
    others: tuple[Landmarks2D | None, ...] = ()
    """Landmarks in the other views of a rig, in its order; None where that view found no face."""


class Continuation(NamedTuple):
    """What one frame hands to the next."""

    parameters: FaceParameters
    pose: Float[AnyArray, "6"]
    last_pose: Float[AnyArray, "6"]
    frames: int
    """Frames since the restart, this one included."""
    points: Float[np.ndarray, "68 2"]


class FrameContext(NamedTuple):
    """What a frame is fitted from, besides its observation."""

    shot: int
    identity: Float[np.ndarray, "i"]
    start: FaceParameters | None
    """Where the calibration left this frame, if it was one of its frames."""
    last: Continuation | None
    """The frame before; None where a shot, or the face after a gap or a jump, begins."""
    appearance: Appearance | None = None
    """Colours and light of the shot, for renders."""


class Calibrated(NamedTuple):
    """Identity of a shot, and where its calibration left the frames that it used."""

    identity: Float[np.ndarray, "i"]
    starts: dict[int, FaceParameters]
    """By frame index."""
    appearance: Appearance | None = None


class StageTrace(NamedTuple):
    """Every iteration of one stage; row 0 is the start."""

    stage: str
    energies: Float[np.ndarray, "steps t"]
    """Weighted energy of each term of the configuration (`Config.terms`)."""
    residuals_px: Float[np.ndarray, "steps 68"]
    """Distance of each model landmark from the observed one."""


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
            constants=EnergyConstants(**config.constants.model_dump()),
            lower=lower,
            upper=upper,
            tolerance=config.solver.tolerance,
            percent=float(config.solver.unit == "percent"),
            sliding=float(config.contour.mode == "sliding"),
        )
    )


def running_stages(config: Config, start: bool) -> list[Stage]:
    """The stages that run on the first frame of a shot (`start`) or on a later one."""
    return [stage for stage in config.stages if stage.enabled and (start or stage.when == "always")]


def stage_program(config: Config, start: bool) -> StageProgram:
    """The stages of a first or a later frame as data for `solve_frame`."""
    chosen = running_stages(config, start)
    slots = STAGE_SLOTS * -(-len(config.stages) // STAGE_SLOTS)
    moves, limit = np.zeros((slots, len(UNKNOWNS)), bool), np.zeros(slots, int)
    weights, omega = np.zeros((slots, 68)), np.zeros((slots, len(config.terms)))
    for k, stage in enumerate(chosen):
        moves[k], limit[k] = [name in stage.free for name in UNKNOWNS], stage.limit
        weights[k] = np.multiply(stage.landmark_weights(config.subsets), config.point_weights())
        omega[k] = config.factors(stage)
    return StageProgram(*(jnp.asarray(part) for part in (moves, limit, weights, omega, len(chosen))))


def corrected(observation: FrameObservation, config: Config) -> FrameObservation:
    """The observation with the detections that the configuration moves; these count as certain."""
    moved = config.moved_points(observation.index)
    if not moved or observation.landmarks is None:
        return observation
    points, confidence = observation.landmarks.points.copy(), observation.landmarks.confidence.copy()
    for point, place in moved.items():
        points[point], confidence[point] = place, 1.0
    return replace(observation, landmarks=replace(observation.landmarks, points=points, confidence=confidence))


def continued(
    parameters: FaceParameters,
    pose: Float[AnyArray, "6"],
    last: Continuation | None,
    points: Float[np.ndarray, "68 2"],
) -> Continuation:
    """What a fitted frame hands to the next one; `last` is what it was handed itself."""
    before = pose if last is None else last.pose
    return Continuation(parameters, pose, before, 1 if last is None else last.frames + 1, points)


class FrameFitter:
    """Fits frames in their context. Holds the arrays of one model and one configuration, no order of frames."""

    def __init__(self, model: FaceModel, config: Config):
        self.model = model
        self._landmarks = landmark_model(model)
        self._identity: np.ndarray | None = None
        self.configure(config)

    def configure(self, config: Config) -> None:
        """Use another configuration from now on; nothing compiles unless the solver's method is a new one."""
        self.config = config
        self._settings = solve_settings(config)
        self._terms = config.terms
        self._used = np.array(config.point_weights()) > 0.0
        self._programs = {start: stage_program(config, start) for start in (True, False)}
        self._cameras: dict[tuple[int, int], tuple[Camera, Camera]] = {}

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the energy's terms."""
        return self._terms

    @property
    def links_frames(self) -> bool:
        """Whether a frame depends on the one before: always, it starts there."""
        return True

    @property
    def calibrates(self) -> bool:
        """Whether a shot is looked at before its frames are fitted."""
        return self.config.identity.calibrate

    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera used for pictures of this size."""
        return self._camera_pair(image_size)[0]

    def mean_identity(self) -> Float[np.ndarray, "i"]:
        """The identity used where none is calibrated."""
        return np.zeros(len(self.model.identity_deltas))

    def calibrate(self, observations: Sequence[FrameObservation], frames: int) -> Calibrated:
        """One identity from up to `frames` of these observations of one person, spread over the yaw.

        Raises `InputError` if none has landmarks.
        """
        usable = [observation for observation in observations if observation.landmarks is not None]
        if not usable:
            raise InputError("An identity is calibrated on frames with a face; none of these has landmarks.")
        neutral = self._landmarks.frontal_neutral()
        poses = [
            initial_pose(self.camera(observation.image_size), neutral, observation.landmarks.points, self._used)
            for observation in usable
        ]
        chosen = spread_over_yaw(yaw_pitch_roll_deg(np.array([rotation for rotation, _ in poses]))[:, 0], frames)
        result = self._calibrate_on([usable[k] for k in chosen], [poses[k] for k in chosen], frames)
        starts = {}
        for row, k in enumerate(chosen):
            start = jax.tree.map(lambda stacked, row=row: stacked[row], result.frames)
            starts[usable[k].index] = start._replace(identity=jnp.zeros(0))
        return Calibrated(np.asarray(result.identity), starts)

    def fit(self, observation: FrameObservation, context: FrameContext) -> tuple[FrameFit, Continuation | None]:
        """The fit of a frame, and what it hands to the next one (None without a face)."""
        if observation.landmarks is None:
            return self._empty(observation, context.shot), None
        fit, solution = self._solve(observation, context, 0)
        return fit, continued(solution.parameters, solution.pose, context.last, observation.landmarks.points)

    def explain(self, observation: FrameObservation, context: FrameContext) -> tuple[FrameFit, tuple[StageTrace, ...]]:
        """The fit with every iteration of every stage kept. Raises `InputError` for a frame without landmarks."""
        if observation.landmarks is None:
            raise InputError(f"Frame {observation.index} has no landmarks; explain a frame with a face.")
        fit, solution = self._solve(observation, context, TRACE_LENGTH)
        stages = running_stages(self.config, start=context.last is None)
        counts = fit.iterations[len(fit.iterations) - len(stages) :]
        energies, residuals = (np.asarray(rows) for rows in solution.traces)
        return fit, tuple(
            StageTrace(stage.name, energies[k, : count + 1], residuals[k, : count + 1])
            for k, (stage, count) in enumerate(zip(stages, counts, strict=True))
        )

    def warm_up(self, image_size: tuple[int, int], trace: bool = False) -> None:
        """Compile (or load from the cache) the program of a fit, and that of `explain` if asked for."""
        observation = self.neutral_observation(image_size)
        afresh = FrameContext(0, self.mean_identity(), None, None)
        _, last = self.fit(observation, afresh)
        for context in (afresh._replace(start=last.parameters), afresh._replace(last=last)):
            self.fit(observation, context)
            if trace:
                self.explain(observation, context)
        if trace:
            self.explain(observation, afresh)

    def neutral_observation(self, image_size: tuple[int, int]) -> FrameObservation:
        """What a perfect detector would see of the neutral face in front of this camera."""
        neutral = self._landmarks.frontal_neutral()
        points = np.asarray(project(self.camera(image_size), neutral + np.array([0.0, 0.0, 600.0])))
        return FrameObservation(0, Landmarks2D(points, np.ones(68), image_size), image_size)

    def _camera_pair(self, image_size):
        if image_size not in self._cameras:
            camera = camera_of(self.config, image_size)
            self._cameras[image_size] = (camera, _on_device(camera))
        return self._cameras[image_size]

    def _personal_of(self, identity: Float[np.ndarray, "i"]) -> LandmarkModel:
        # One person after the other: the newest is kept on the device.
        if self._identity is None or not np.array_equal(identity, self._identity):
            personal = self._landmarks.personal(np.asarray(identity, float))
            self._neutral = personal.frontal_neutral()
            self._personal = _on_device(personal)
            self._identity = np.array(identity)
        return self._personal

    def _solve(
        self, observation: FrameObservation, context: FrameContext, trace_length: int
    ) -> tuple[FrameFit, FrameSolution]:
        began = time.perf_counter()
        camera, camera_on_device = self._camera_pair(observation.image_size)
        personal = self._personal_of(context.identity)
        with COMPUTING:
            solution = solve_frame(
                camera_on_device,
                personal,
                self._settings,
                self._programs[context.last is None],
                self._frame_input(observation, context),
                method=self.config.solver.method,
                trace_length=trace_length,
                terms=self._terms,
            )
        fetched = read_report(solution)
        milliseconds = 1e3 * (time.perf_counter() - began)
        return self._record(observation, context, camera, fetched, milliseconds), solution

    def _frame_input(self, observation: FrameObservation, context: FrameContext) -> FrameInput:
        points, last = observation.landmarks.points, context.last
        measured = np.column_stack([points, observation.landmarks.confidence])
        if last is not None:
            history = _ONE if last.frames >= 2 else _ZERO
            return FrameInput(measured, last.pose, last.last_pose, history, last.parameters)
        start = context.start
        if start is None:
            camera = self.camera(observation.image_size)
            rotation, translation = initial_pose(camera, self._neutral, points, self._used)
            expression = np.zeros(len(self.model.expression_names))
            start = FaceParameters(rotation, translation, expression, np.zeros(0))
        return FrameInput(measured, _NO_POSE, _NO_POSE, _ZERO, start)

    def _calibrate_on(self, observations, poses, count):
        # A fixed number of frames, missing ones with weight zero, so that every shot runs the same program.
        padding = count - len(observations)
        observations = observations + observations[-1:] * padding
        poses = poses + poses[-1:] * padding
        identity = self.config.identity
        weights = np.stack([observation.landmarks.confidence for observation in observations])
        weights[count - padding :] = 0.0
        cameras = [self.camera(observation.image_size) for observation in observations]
        first_pass = np.array(self.config.point_weights())
        second_pass = first_pass.copy()
        first_pass[:17] = 0.0
        second_pass[:17] *= identity.jaw
        settings = CalibrationSettings(
            identity=identity.weight,
            expression=identity.expression,
            limits=tuple(identity.limits),
            landmark_weights=np.stack([first_pass, second_pass]),
            sliding=float(self.config.contour.mode == "sliding"),
        )
        starts = FaceParameters(
            rotation=np.array([rotation for rotation, _ in poses]),
            translation=np.array([translation for _, translation in poses]),
            expression=np.zeros((count, len(self.model.expression_names))),
            identity=np.zeros((count, len(self.model.identity_deltas))),
            jaw=np.zeros((count, 0)),
            scale=np.zeros((count, 0)),
        )
        with COMPUTING:
            return calibrate_identity(
                Camera(*(np.stack(part) for part in zip(*cameras, strict=True))),
                self._landmarks,
                settings,
                starts,
                np.stack([observation.landmarks.points for observation in observations]),
                weights,
            )

    def _record(self, observation, context: FrameContext, camera, solution: FrameSolution, milliseconds: float):
        # Rows are laid out for the stages of a first frame, so that first and later frames stack.
        rows = int(self._programs[True].count)
        count = int(self._programs[context.last is None].count)
        place = slice(rows - count, rows)
        energies = np.full((rows, len(self._terms)), np.nan)
        status, iterations = np.full(rows, -1), np.zeros(rows, int)
        energies[place], status[place] = solution.energies[:count], solution.status[:count]
        iterations[place] = solution.iterations[:count]
        return FrameFit(
            index=observation.index,
            found=True,
            shot=context.shot,
            source=observation.source,
            image_size=observation.image_size,
            camera=camera,
            rotation=solution.parameters.rotation,
            translation=solution.parameters.translation,
            expression=solution.parameters.expression,
            identity=context.identity,
            observed=observation.landmarks.points,
            confidence=observation.landmarks.confidence,
            projected=solution.projected,
            energies=energies,
            status=status,
            iterations=iterations,
            milliseconds=np.array([*observation.milliseconds, milliseconds]),
        )

    def _empty(self, observation: FrameObservation, shot: int) -> FrameFit:
        rows = int(self._programs[True].count)
        missing = lambda *shape: np.full(shape, np.nan)  # noqa: E731
        return FrameFit(
            index=observation.index,
            found=False,
            shot=shot,
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
            energies=missing(rows, len(self._terms)),
            status=np.full(rows, -1),
            iterations=np.zeros(rows, int),
            milliseconds=np.array([*observation.milliseconds, 0.0]),
        )


def _on_device(tree):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)


_ZERO, _ONE, _NO_POSE = jnp.zeros(()), jnp.ones(()), jnp.zeros(6)
