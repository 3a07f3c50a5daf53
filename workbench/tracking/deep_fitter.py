"""One frame under Deep Energies: renders in place of points on the mesh.

Frames are independent (the paper's Sec. 7 starts from there): a fit needs the shot's identity and appearance and the
frame's own landmarks, nothing of the frame before, unless a stage names a term that links frames (E_τ).
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from workbench.energies import TermContext
from workbench.energies.deep import DeepView, crop_of, deep_model
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, free_parameters, parameter_range, seen_shapes
from workbench.geometry import Camera, yaw_pitch_roll_deg
from workbench.landmarks.network_detector import CROP_BOXES
from workbench.landmarks.observations import Landmarks2D
from workbench.rendering import (
    Appearance,
    ambient_light,
    directional_light,
    estimate_appearance,
    orthographic_camera,
    turned_light,
)
from workbench.rendering.camera import OrthographicCamera
from workbench.solvers import Status
from workbench.tracking.deep_programs import DeepScene
from workbench.tracking.deep_solver import StageProblem, StageResult, solve_stage
from workbench.tracking.deep_target import energy_network
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.failures import failure_of_residuals
from workbench.tracking.fitting import (
    Calibrated,
    Continuation,
    Fitter,
    FrameContext,
    FrameObservation,
    FrameProblem,
    FrameSolution,
    StageTrace,
    continued,
    never,
)
from workbench.tracking.plan import Plan, StagePlan
from workbench.tracking.records import FAILURES, FrameFit

EYES_PER_BOX = 0.726
"""Outer-eye distance of an average face in face-box sides (`landmarks.alignment.MEAN_SHAPE`): unlike the distance in
the picture it does not shrink with the yaw."""
FAR_MM = 1e5
"""A parallel view is recorded as a camera at this distance, so that everything that reads a fit can draw it."""
BACKGROUND = (0.45, 0.45, 0.45)
NEUTRAL_YAW_DEG = 25.0
"""A weight of 1 makes a frame as unfit for the appearance as this yaw."""


@dataclass(frozen=True)
class DeepProblem(FrameProblem):
    """A frame as the stages take it; without a face in any view there is nothing to solve."""

    stages: tuple[StagePlan, ...]
    scene: DeepScene | None = None
    views: tuple[DeepView, ...] = ()
    """What each camera brings, every landmark in full."""
    start: FaceParameters | None = None
    history: TermContext | None = None


@dataclass(frozen=True)
class DeepSolution(FrameSolution):
    """What every stage made of a frame; no results where there was nothing to solve."""

    problem: DeepProblem
    results: tuple[StageResult, ...]
    views: tuple[DeepView, ...]
    """As the last stage had them."""
    seconds: tuple[float, ...]
    """Of each stage."""

    @property
    def stages(self) -> tuple[StagePlan, ...]:
        """Those that ran."""
        return self.problem.stages[: len(self.results)]

    @property
    def start(self) -> FaceParameters:
        """Where the first stage began."""
        return self.problem.start

    @property
    def parameters(self) -> FaceParameters:
        """Where the last stage ended."""
        return self.results[-1].parameters


class DeepFitter(Fitter):
    """Fits frames by Deep Energies."""

    renders = True

    def __init__(self, model: FaceModel, plan: Plan):
        self.model = model
        self._deep_model = deep_model(model)
        self._points = FaceItFitter(model, plan.by_points)
        self._seen = jnp.asarray(seen_shapes(model), float)
        self.configure(plan)

    def configure(self, plan: Plan) -> None:
        """Follow another plan from now on. Raises `InputError` for a network file that cannot be used."""
        self.plan, self.rig = plan, plan.camera.rig
        self._network = energy_network(plan.deep.network)
        self._points.configure(plan.by_points)

    @property
    def links_frames(self) -> bool:
        """Whether a frame depends on the one before: where a stage names a term that does."""
        return self.plan.linked

    @property
    def calibrates(self) -> bool:
        """Whether a shot is looked at before its frames are fitted: for the identity, the appearance, or both."""
        return self.plan.identity.calibrate or self.plan.deep.appearance == "estimate"

    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera of the reference view; for a parallel view one far away that looks alike."""
        if self.rig is not None:
            return self.rig.views[0].camera
        guessed = self.plan.camera.of(image_size)
        if not self.plan.camera.parallel:
            return guessed
        scale = self._start_scale(guessed)
        return Camera(np.full(2, scale * FAR_MM), np.asarray(guessed.principal_point_px, float), np.zeros(8))

    def neutral_observation(self, image_size: tuple[int, int]) -> FrameObservation:
        """What a perfect detector would see of the neutral face in front of this camera; nothing in a rig's others."""
        others = () if self.rig is None else (None,) * (len(self.rig) - 1)
        return replace(self._points.neutral_observation(image_size), others=others)

    def warm_up(self, image_size: tuple[int, int], trace: bool = False) -> None:
        """Compile (or load from the cache) every program of a fit."""
        observation = self.neutral_observation(image_size)
        self.fit(observation, FrameContext(0, self.mean_identity(), None, None))

    def calibrate(self, observations: Sequence[FrameObservation], frames: int) -> Calibrated:
        """Identity as FACE IT! calibrates it, and the appearance from the frame nearest to neutral that has a picture.

        Raises `InputError` if none has landmarks.
        """
        if self.plan.identity.calibrate:
            calibrated = self._points.calibrate(observations, frames)
        else:
            calibrated = Calibrated(self.mean_identity(), {})
        return calibrated._replace(starts={}, appearance=self.appearance(observations, calibrated.identity))

    def appearance(
        self, observations: Sequence[FrameObservation], identity: Float[np.ndarray, "i"]
    ) -> Appearance | None:
        """Colours and light of the frame nearest to neutral and frontal; None without pictures or by configuration."""
        pictured = [item for item in observations if item.picture is not None and item.landmarks is not None]
        if self.plan.deep.appearance == "model" or not pictured:
            return None
        fits = [self._points.fit(item, FrameContext(0, identity, None, None))[0] for item in pictured]
        best = min(range(len(fits)), key=lambda k: _unfitness(fits[k]))
        person, fit = self.model.personal(identity), fits[best]
        vertices = person.vertices(fit.expression)
        from_head = Rotation.from_rotvec(np.array(fit.rotation)).apply(vertices) + fit.translation
        try:
            return estimate_appearance(pictured[best].picture, person, from_head, fit.camera)
        except InputError:
            return None  # too small a face: the model's own colours serve

    def problem(self, observation: FrameObservation, context: FrameContext) -> DeepProblem:
        """What each camera brings, colours, start and stages of a frame."""
        problem = DeepProblem(observation, context, self.plan.running(start=True))
        if not observation.faces:
            return problem
        start = self._start(observation, context)
        return replace(
            problem,
            scene=self.scene(context.appearance),
            views=self.views(observation, context),
            start=start,
            history=self._history(context.last, start),
        )

    def solve(self, problem: DeepProblem, traced: bool = False, cancelled: Callable[[], bool] = never) -> DeepSolution:
        """All stages in order, with what each left; every step is kept anyway. `cancelled` is asked before each."""
        results, seconds, views = [], [], ()
        parameters = problem.start
        for stage in problem.stages if problem.views else ():
            began = time.perf_counter()
            views = self._weighed(problem.views, stage)
            result = solve_stage(self._stage_problem(problem, views, stage), parameters, cancelled)
            parameters = result.parameters
            results.append(result)
            seconds.append(time.perf_counter() - began)
        return DeepSolution(problem, tuple(results), views, tuple(seconds))

    def hand_on(self, solution: DeepSolution) -> Continuation | None:
        """The pose, where a term links frames."""
        problem = solution.problem
        if not self.links_frames or problem.observation.landmarks is None:
            return None
        parameters = solution.parameters
        pose = np.concatenate([parameters.rotation, parameters.translation])
        return continued(parameters, pose, problem.context.last, problem.observation.landmarks.points)

    def traces(self, solution: DeepSolution) -> tuple[StageTrace, ...]:
        """The accepted steps, by stage."""
        target = solution.problem.observation.landmarks.points
        return tuple(
            StageTrace(
                stage.name,
                np.stack([step.energies for step in result.path]),
                np.stack([np.linalg.norm(step.points[0] - target, axis=1) for step in result.path]),
            )
            for stage, result in zip(solution.stages, solution.results, strict=True)
        )

    def stopped(self, solution: DeepSolution, steps: int) -> DeepSolution:
        """The solution as it stood after `steps` accepted steps, counted through all stages."""
        results, left = [], max(steps, 0)
        for result in solution.results:
            kept = min(left, len(result.path) - 1)
            results.append(result.stopped(kept))
            left -= kept
            if kept < len(result.path) - 1 or left == 0:
                break
        return replace(solution, results=tuple(results), seconds=solution.seconds[: len(results)])

    def scene(self, appearance: Appearance | None) -> DeepScene:
        """Network, model and colours of a shot."""
        albedo = self._deep_model.render.colors if appearance is None else jnp.asarray(appearance.albedo, jnp.float32)
        sliding = jnp.asarray(float(self.plan.sliding))
        return DeepScene(self._network, self._deep_model, albedo, sliding)

    def views(
        self, observation: FrameObservation, context: FrameContext, stage: StagePlan | None = None
    ) -> tuple[DeepView, ...]:
        """What each camera brings to a stage; every landmark in full for None."""
        if stage is not None:
            return self._weighed(self.views(observation, context), stage)
        light = light_of(context.appearance)
        if self.rig is None:
            camera = self._solver_camera(observation.image_size)
            return (self._view(camera, np.eye(3), np.zeros(3), observation.landmarks, light),)
        seen = (observation.landmarks, *observation.others)
        if len(seen) != len(self.rig):
            raise InputError(
                f"The rig has {len(self.rig)} views ({', '.join(self.rig.names)}), the frame landmarks of {len(seen)}; "
                "give one clip for each view."
            )
        places = zip(self.rig.rotation_view_reference, self.rig.translation_view_reference_mm, strict=True)
        return tuple(
            self._view(view.camera, rotation, translation, landmarks, turned_light(light, rotation))
            for view, (rotation, translation), landmarks in zip(self.rig.views, places, seen, strict=True)
        )

    def _weighed(self, views: tuple[DeepView, ...], stage: StagePlan) -> tuple[DeepView, ...]:
        """The views with what each landmark counts in a stage."""
        weights = stage.landmark_weights
        return tuple(view._replace(weights=jnp.asarray(weights * np.asarray(view.weights))) for view in views)

    def record(self, solution: DeepSolution) -> FrameFit:
        """A solution as what tables, pictures and exports read."""
        observation, context = solution.problem.observation, solution.problem.context
        if not solution.results:
            return self._empty(observation, context.shot)
        results, rows = solution.results, len(solution.problem.stages)
        parameters = jax.tree.map(lambda part: np.array(part, float), solution.parameters)
        prediction, camera = results[-1].prediction, self.camera(observation.image_size)
        translation, scale = parameters.translation, float(parameters.scale[0])
        if self.plan.camera.parallel:
            translation = np.array([translation[0], translation[1], FAR_MM])
        landmarks = observation.landmarks
        # A view that saw nothing has no residual either: its confidence of 0 keeps it out of all means.
        observed = prediction.points[0] if landmarks is None else landmarks.points
        rotation = np.array(parameters.rotation)
        return FrameFit(
            index=observation.index,
            found=True,
            shot=context.shot,
            source=observation.source,
            image_size=observation.image_size,
            camera=camera,
            rotation=rotation,
            translation=translation,
            expression=parameters.expression,
            identity=parameters.identity,
            observed=observed,
            confidence=np.zeros(68) if landmarks is None else landmarks.confidence,
            projected=prediction.points[0],
            energies=_rows([result.energies for result in results], rows, np.nan),
            status=_rows([int(result.status.value) for result in results], rows, -1),
            iterations=_rows([result.iterations for result in results], rows, 0),
            milliseconds=np.array([*observation.milliseconds, 1e3 * sum(solution.seconds)]),
            jaw=parameters.jaw,
            scale=scale,
            failure=self._failure(solution),
        )

    def start(self, identity: Float[np.ndarray, "i"]) -> FaceParameters:
        """The frontal start: facing the camera, in the middle of the picture."""
        count = len(self.model.expression_names)
        return FaceParameters(
            rotation=jnp.zeros(3),
            translation=jnp.array([0.0, 0.0, self.plan.deep.distance_mm]),
            expression=jnp.zeros(count),
            identity=jnp.asarray(identity, float),
            jaw=jnp.zeros(6),
            scale=jnp.ones(1),
        )

    def _start(self, observation: FrameObservation, context: FrameContext) -> FaceParameters:
        start = self.start(context.identity)
        if context.start is not None:
            given = context.start
            count = len(self.model.expression_names)
            return start._replace(
                rotation=jnp.asarray(given.rotation, float),
                translation=jnp.asarray(given.translation, float),
                expression=self._seen * given.expression if len(given.expression) == count else start.expression,
                jaw=jnp.asarray(given.jaw, float) if len(given.jaw) else start.jaw,
            )
        if self.plan.deep.start == "frontal" or observation.landmarks is None:
            return start
        fit = self._points.fit(observation, FrameContext(0, context.identity, None, None))[0]
        return start._replace(rotation=jnp.asarray(fit.rotation), translation=jnp.asarray(fit.translation))

    def _stage_problem(self, problem: DeepProblem, views: tuple[DeepView, ...], stage: StagePlan) -> StageProblem:
        deep, free = self.plan.deep, self.free(stage)
        lower, upper = self._bounds()
        return StageProblem(
            scene=problem.scene,
            views=views,
            terms=self.terms,
            omega=stage.omega,
            context=problem.history,
            free=free,
            lower=lower,
            upper=upper,
            limit=stage.limit,
            tolerance=deep.tolerance,
            derivative=deep.derivative,
        )

    def _history(self, last: Continuation | None, start: FaceParameters) -> TermContext:
        """What terms that link frames are told of the frames before."""
        constants = self.plan.constants
        if last is None:
            return TermContext(constants, np.zeros(6), np.zeros(6), np.zeros(()), start)
        known = np.asarray(float(last.frames >= 2))
        return TermContext(constants, np.asarray(last.last_pose), np.asarray(last.pose), known, start)

    def free(self, stage: StagePlan) -> Bool[np.ndarray, "n"]:
        """Which entries of the flattened parameters a stage frees. Raises `ConfigError` for shapes the model lacks."""
        return np.concatenate(
            free_parameters(self.model, stage.free, stage.shapes, self.plan.camera.parallel, stage.name)
        )

    def _bounds(self) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        lower, upper = parameter_range(self.model, self.plan.solver.bounded)
        return np.concatenate(lower), np.concatenate(upper)

    def _solver_camera(self, image_size: tuple[int, int]) -> Camera | OrthographicCamera:
        guessed = self.plan.camera.of(image_size)
        if not self.plan.camera.parallel:
            return Camera(*(jnp.asarray(part, float) for part in guessed))
        made = orthographic_camera(image_size, self._start_scale(guessed))
        return OrthographicCamera(*(jnp.asarray(part, float) for part in made))

    def _start_scale(self, guessed: Camera) -> float:
        """Pixels per millimetre at the start's distance."""
        return float(np.mean(np.asarray(guessed.focal_px))) / self.plan.deep.distance_mm

    def _view(self, camera, rotation, translation, landmarks: Landmarks2D | None, light) -> DeepView:
        if landmarks is None:
            target, confidence, unit = np.zeros((68, 2)), np.zeros(68), 1.0
        else:
            target, confidence = landmarks.points, landmarks.confidence
            unit = 1.0
            if self.plan.solver.percent:
                unit = self._percent_px(target)
        share = {"deep": np.ones(68), "points": np.zeros(68), "mixed": confidence}[self.plan.deep.energy]
        if landmarks is None:
            share = np.zeros(68)
        return DeepView(
            camera=Camera(*(jnp.asarray(part, float) for part in camera)) if isinstance(camera, Camera) else camera,
            rotation=jnp.asarray(rotation, jnp.float32),
            translation=jnp.asarray(translation, jnp.float32),
            target=jnp.asarray(target),
            weights=jnp.asarray(confidence),
            share=jnp.asarray(share),
            unit_px=jnp.asarray(unit),
            light=jnp.asarray(light, jnp.float32),
            background=jnp.asarray(BACKGROUND, jnp.float32),
        )

    def _percent_px(self, points: Float[np.ndarray, "68 2"]) -> float:
        """One percent of a face's outer-eye distance, pixels, by the size of its crop."""
        return 0.01 * EYES_PER_BOX / CROP_BOXES * float(crop_of(self._network, jnp.asarray(points)).side)

    def _failure(self, solution: DeepSolution) -> str:
        """Why the result should not be used, by its errors in the first view that shows something wrong."""
        result = solution.results[-1]
        if result.status is Status.NOT_FINITE:
            return FAILURES[3]
        percent = [
            np.linalg.norm(points - np.asarray(view.target), axis=1) / self._percent_px(np.asarray(view.target))
            for view, points in zip(solution.views, result.prediction.points, strict=True)
            if np.any(np.asarray(view.weights) > 0.0)
        ]
        if not percent:
            return ""
        limits = self.plan.deep.largest_error, self.plan.deep.largest_disagreement
        return FAILURES[next(filter(None, failure_of_residuals(np.stack(percent), *limits)), 0)]

    def _empty(self, observation: FrameObservation, shot: int) -> FrameFit:
        rows = len(self.plan.running(start=True))
        empty, _ = self._points.fit(
            replace(observation, landmarks=None), FrameContext(shot, self.mean_identity(), None, None)
        )
        return replace(
            empty,
            camera=self.camera(observation.image_size),
            energies=np.full((rows, len(self.terms)), np.nan),
            status=np.full(rows, -1),
            iterations=np.zeros(rows, int),
            jaw=np.full(6, np.nan),
        )


def _rows(values: list, count: int, missing: float | int) -> np.ndarray:
    """Values of the stages that ran, filled up to all of them."""
    known = np.asarray(values)
    return np.concatenate([known, np.full((count - len(known), *known.shape[1:]), missing, known.dtype)])


def light_of(appearance: Appearance | None) -> Float[np.ndarray, "9 3"]:
    """The light of an appearance, in the reference camera's frame; a plain one from the front where none was
    estimated."""
    if appearance is not None:
        return appearance.light
    return ambient_light(0.6) + directional_light((0.2, -0.5, -1.0), 0.4)


def _unfitness(fit: FrameFit) -> float:
    yaw, pitch, _ = yaw_pitch_roll_deg(fit.rotation)
    return float((abs(yaw) + abs(pitch)) / NEUTRAL_YAW_DEG + np.abs(fit.expression).sum() + fit.errors[1] / 5.0)
