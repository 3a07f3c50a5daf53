"""One frame under FACE IT!: head pose and blendshape weights from landmarks."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.energies.flow_link import FlowLink
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, LandmarkModel, landmark_model
from workbench.geometry import Camera, project, yaw_pitch_roll_deg
from workbench.landmarks.observations import Landmarks2D
from workbench.runtime import COMPUTING
from workbench.tracking.face_it_solution import (
    FaceItProblem,
    FaceItSolution,
    cut_off,
    on_device,
    record_of,
    record_without_face,
    solve_settings,
    stage_program,
    traces_of,
)
from workbench.tracking.fitting import (
    Calibrated,
    Continuation,
    Fitter,
    FrameContext,
    StageTrace,
    check_scheme,
    continued,
)
from workbench.tracking.flow_term import FlowTerm, blank_motion, flow_term
from workbench.tracking.frame_solver import FrameInput, read_report, solve_frame
from workbench.tracking.identity import CalibrationSettings, calibrate_identity, spread_over_yaw
from workbench.tracking.initial_pose import initial_pose
from workbench.tracking.observation import FrameObservation
from workbench.tracking.plan import Plan
from workbench.tracking.point_links import flow_views
from workbench.tracking.records import FrameFit
from workbench.tracking.unwatched import never

TRACE_LENGTH = 500
"""Maximum length of a trace: the largest iteration limit that a stage may have."""


class FaceItFitter(Fitter):
    """Fits frames by FACE IT!."""

    renders = False

    def __init__(self, model: FaceModel, plan: Plan):
        self.model = model
        self._landmarks = landmark_model(model)
        self._identity: np.ndarray | None = None
        self._flow: FlowTerm | None = None
        self.configure(plan)

    def configure(self, plan: Plan) -> None:
        """Use another plan from now on; nothing is recompiled unless another kind of solver is chosen."""
        self.plan = plan
        self._flow = flow_term(self.model, plan, self._flow)
        # On the host: a compiled program takes such small arrays from there as quickly, and to put them on the device
        # for each move of a slider takes a quarter as long as a solve.
        self._settings = solve_settings(plan)
        self._programs = {start: stage_program(plan, start) for start in (True, False)}
        self._used = plan.point_weights > 0.0
        self._cameras: dict[tuple[int, int], Camera] = {}

    @property
    def links_frames(self) -> bool:
        """Always true: a frame starts from the result of the previous one."""
        return True

    @property
    def calibrates(self) -> bool:
        """Whether a shot is calibrated before its frames are fitted; without an identity basis nothing is."""
        return self.plan.identity.calibrate and self.model.has_identities

    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera used for pictures of this size."""
        if image_size not in self._cameras:
            self._cameras[image_size] = self.plan.camera.of(image_size)
        return self._cameras[image_size]

    def calibrate(self, observations: Sequence[FrameObservation], frames: int) -> Calibrated:
        """One identity from up to `frames` of these observations of one person, spread over the range of yaws.

        Of a model without an identity basis its only one. Raises `InputError` if none has landmarks.
        """
        chosen = self.calibration_frames(observations, frames)
        if not self.model.has_identities:
            return Calibrated(self.mean_identity(), {})
        result = self._calibrate_on(chosen, [self._initial_pose(observation) for observation in chosen], frames)
        # On the host: JAX would compile a small program for every array that it takes a row of.
        starts, frames_found = {}, jax.tree.map(np.asarray, result.frames)
        for row, observation in enumerate(chosen):
            start = jax.tree.map(lambda stacked, row=row: stacked[row], frames_found)
            starts[observation.index] = start._replace(identity=jnp.zeros(0))
        return Calibrated(np.asarray(result.identity), starts)

    def calibration_frames(self, observations: Sequence[FrameObservation], frames: int) -> list[FrameObservation]:
        """The frames that `calibrate` takes of these, in ascending order of time. Raises as that does."""
        usable = [observation for observation in observations if observation.landmarks is not None]
        if not usable:
            raise InputError("Calibrating an identity needs frames with a face; none of these frames has landmarks.")
        for observation in usable:
            check_scheme(observation, self.model)
        rotations = np.array([self._initial_pose(observation)[0] for observation in usable])
        return [usable[k] for k in spread_over_yaw(yaw_pitch_roll_deg(rotations)[:, 0], frames)]

    def problem(self, observation: FrameObservation, context: FrameContext) -> FaceItProblem:
        """The solver's input for a frame: camera, person, stages and start."""
        began = time.perf_counter()
        camera = self.camera(observation.image_size)
        problem = FaceItProblem(
            observation, context, began, camera, self._settings, self._programs[context.last is None]
        )
        check_scheme(observation, self.model)
        if observation.landmarks is None:
            return problem
        person = self._personal_of(context.identity)
        frame = self._frame_input(observation, context)._replace(flow=self._flow_link(observation, context, camera))
        return replace(problem, person=person, frame=frame)

    def solve(
        self, problem: FaceItProblem, traced: bool = False, cancelled: Callable[[], bool] = never
    ) -> FaceItSolution:
        """Run all stages in one program. It takes milliseconds, so it cannot be cancelled."""
        if problem.frame is None:
            return FaceItSolution(problem, None, None, 0.0)
        with COMPUTING:
            found = solve_frame(
                problem.camera,
                problem.person,
                problem.settings,
                problem.program,
                problem.frame,
                method="levenberg-marquardt" if self.plan.solver.method == "lm" else "trust-region",
                trace_length=TRACE_LENGTH if traced else 0,
                terms=self.plan.terms,
            )
        report = read_report(found)
        return FaceItSolution(problem, found, report, 1e3 * (time.perf_counter() - problem.began))

    def hand_on(self, solution: FaceItSolution) -> Continuation | None:
        """Pose and weights, from which the next frame starts."""
        if solution.found is None:
            return None
        problem = solution.problem
        points = problem.observation.landmarks.points
        return continued(solution.found.parameters, solution.found.pose, problem.context.last, points)

    def traces(self, solution: FaceItSolution) -> tuple[StageTrace, ...]:
        """The iterations of a traced solution, by stage."""
        return traces_of(solution, self.plan)

    def stopped(self, solution: FaceItSolution, steps: int) -> FaceItSolution:
        """The frame solved again with its stages cut off after `steps` iterations."""
        return self.solve(replace(solution.problem, program=cut_off(solution, steps)))

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
        """A perfect detector's observation of the neutral face in front of this camera."""
        neutral = self._landmarks.frontal_neutral()
        points = np.asarray(project(self.camera(image_size), neutral + np.array([0.0, 0.0, 600.0])))
        motion = blank_motion(image_size) if self.plan.compares_pictures else None
        return FrameObservation(0, self._perfect(points, image_size), image_size, motion=motion)

    def _initial_pose(self, observation: FrameObservation) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Rotation and translation of the average face that fit best."""
        camera, neutral = self.camera(observation.image_size), self._landmarks.frontal_neutral()
        return initial_pose(camera, neutral, observation.landmarks.points, self._used)

    def _perfect(self, points: Float[np.ndarray, "points 2"], image_size: tuple[int, int]) -> Landmarks2D:
        scheme = self.model.scheme
        covariance = np.tile(np.eye(2), (len(scheme), 1, 1)) if scheme.has_covariances else None
        return Landmarks2D(points, np.ones(len(scheme)), image_size, covariance)

    def _personal_of(self, identity: Float[np.ndarray, "i"]) -> LandmarkModel:
        # Persons come one after the other, so only the latest is kept on the device.
        if self._identity is None or not np.array_equal(identity, self._identity):
            personal = self._landmarks.personal(np.asarray(identity, float))
            self._neutral = personal.frontal_neutral()
            self._personal = on_device(personal)
            self._identity = np.array(identity)
        return self._personal

    def _frame_input(self, observation: FrameObservation, context: FrameContext) -> FrameInput:
        points, last = observation.landmarks.points, context.last
        counts, whitening = self.plan.measured(observation.landmarks)
        measured = np.column_stack([points, counts])
        if last is not None:
            history = _ONE if last.frames >= 2 else _ZERO
            return FrameInput(measured, last.pose, last.last_pose, history, last.parameters, whitening=whitening)
        start = context.start
        if start is None:
            camera = self.camera(observation.image_size)
            rotation, translation = initial_pose(camera, self._neutral, points, self._used)
            expression = np.zeros(len(self.model.expression_names))
            start = FaceParameters(rotation, translation, expression, np.zeros(0))
        # The identity is already part of the personal landmarks, and there is neither a jaw joint nor a scale.
        start = FaceParameters(start.rotation, start.translation, start.expression, np.zeros(0))
        return FrameInput(measured, _NO_POSE, _NO_POSE, _ZERO, start, whitening=whitening)

    def _flow_link(self, observation: FrameObservation, context: FrameContext, camera: Camera) -> FlowLink | None:
        if self._flow is None:
            return None
        last, identity = None, np.asarray(context.identity, float)
        if context.last is not None and self.plan.compares_pictures:
            last = context.last.parameters._replace(identity=identity, jaw=np.zeros(6), scale=np.ones(1))
        return self._flow.link(observation, last, flow_views(None, camera), self._flow.points_of(identity))

    def _calibrate_on(self, observations, poses, count):
        # The number of frames is fixed, padded with weight zero, so that every shot uses the same compiled program.
        padding = count - len(observations)
        observations = observations + observations[-1:] * padding
        poses = poses + poses[-1:] * padding
        identity = self.plan.identity
        seen = [self.plan.measured(observation.landmarks) for observation in observations]
        weights, whitening = np.stack([counts for counts, _ in seen]), [each for _, each in seen]
        weights[count - padding :] = 0.0
        cameras = [self.camera(observation.image_size) for observation in observations]
        first_pass = self.plan.point_weights.copy()
        second_pass = first_pass.copy()
        first_pass[:17] = 0.0
        second_pass[:17] *= identity.jaw
        settings = CalibrationSettings(
            identity=identity.weight,
            size=identity.size,
            expression=identity.expression,
            limits=tuple(identity.limits),
            landmark_weights=np.stack([first_pass, second_pass]),
            sliding=float(self.plan.sliding),
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
                None if whitening[0] is None else np.stack(whitening),
            )

    def record(self, solution: FaceItSolution) -> FrameFit:
        """The solution as a record for tables, pictures and exports."""
        problem = solution.problem
        if solution.report is None:
            return record_without_face(problem.observation, problem.context.shot, problem.camera, self.model, self.plan)
        return record_of(solution, self.plan)


_ZERO, _ONE, _NO_POSE = jax.device_put((np.zeros(()), np.ones(()), np.zeros(6)))
