"""One frame under Deep Energies: landmarks are compared in renders instead of as points on the mesh.

Frames are independent, as Sec. 7 of the paper assumes: a fit needs the shot's identity and appearance and the frame's
own landmarks, but nothing from the previous frame, unless a stage names a term that links frames (E_τ).
"""

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from workbench.energies import TermContext
from workbench.energies.deep import DeepView, deep_model
from workbench.energies.flow_link import FlowLink
from workbench.errors import ModelError, WorkbenchWarning
from workbench.face import (
    FaceModel,
    FaceParameters,
    free_parameters,
    keeps_the_mouth_shut,
    load_default_head,
    parameter_range,
    seen_shapes,
)
from workbench.face.usual_expressions import usual_expressions
from workbench.geometry import Camera
from workbench.networks import EnergyNetwork
from workbench.rendering import Appearance
from workbench.tracking.deep_appearance import most_neutral_appearance
from workbench.tracking.deep_programs import DeepScene
from workbench.tracking.deep_solution import DeepProblem, DeepSolution, record_of
from workbench.tracking.deep_solver import StageProblem, solve_stage
from workbench.tracking.deep_target import energy_network, steadied
from workbench.tracking.deep_views import FAR_MM, eyes_per_box, holding, light_of, recorded_camera, views_of, weighed
from workbench.tracking.face_it_fitter import FaceItFitter
from workbench.tracking.fitting import (
    Calibrated,
    Continuation,
    Fitter,
    FrameContext,
    StageTrace,
    check_scheme,
    continued,
)
from workbench.tracking.flow_term import FlowTerm, flow_term
from workbench.tracking.observation import FrameObservation
from workbench.tracking.plan import Plan, StagePlan
from workbench.tracking.point_links import flow_views
from workbench.tracking.records import FrameFit
from workbench.tracking.unwatched import never


class DeepFitter(Fitter):
    """Fits frames by Deep Energies."""

    renders = True

    def __init__(self, model: FaceModel, plan: Plan):
        self.model = model
        self._deep_model = deep_model(model)
        self._points = FaceItFitter(model, plan.by_points)
        self._seen = jnp.asarray(seen_shapes(model), float)
        self._flow: FlowTerm | None = None
        self.configure(plan)

    def configure(self, plan: Plan) -> None:
        """Use another plan from now on. Raises `InputError` for an unusable network, `ModelError` for the model."""
        _check_look(self.model, plan)
        self.plan, self.rig = plan, plan.camera.rig
        self._look = jax.tree.map(jnp.asarray, plan.look)
        self._network = energy_network(plan.deep.network)
        self._eyes = eyes_per_box(self.model, self._network)
        self._flow = flow_term(self.model, plan, self._flow, self._deep_model.render)
        self._points.configure(plan.by_points)
        _warn_of_a_shut_mouth(self.model, plan)

    @property
    def links_frames(self) -> bool:
        """Whether a frame depends on the previous one, because a stage names a term that links frames."""
        return self.plan.linked

    @property
    def calibrates(self) -> bool:
        """Whether a shot is calibrated before its frames are fitted: its identity, its appearance, or both."""
        return self._points.calibrates or self.plan.deep.appearance != "model"

    def camera(self, image_size: tuple[int, int]) -> Camera:
        """The camera of the reference view; for an orthographic view, an equivalent distant camera."""
        return recorded_camera(self.plan, image_size)

    def neutral_observation(self, image_size: tuple[int, int]) -> FrameObservation:
        """A perfect detector's observation of the neutral face in front of this camera; none in a rig's other views."""
        others = () if self.rig is None else (None,) * (len(self.rig) - 1)
        return replace(self._points.neutral_observation(image_size), others=others)

    def warm_up(self, image_size: tuple[int, int], trace: bool = False) -> None:
        """Compile (or load from the cache) every program of a fit."""
        observation = self.neutral_observation(image_size)
        self.fit(observation, FrameContext(0, self.mean_identity(), None, None))

    def calibrate(self, observations: Sequence[FrameObservation], frames: int) -> Calibrated:
        """The identity, calibrated as under FACE IT! but on several looks at each picture (`steadied`), and the
        appearance of the most neutral frame with a picture.

        Raises `InputError` if none has landmarks.
        """
        calibrated = Calibrated(self.mean_identity(), {})
        if self._points.calibrates:
            chosen = self._points.calibration_frames(observations, frames)
            calibrated = self._points.calibrate([_steadied(item, self._network) for item in chosen], frames)
        return calibrated._replace(starts={}, appearance=self.appearance(observations, calibrated.identity))

    def appearance(
        self, observations: Sequence[FrameObservation], identity: Float[np.ndarray, "i"]
    ) -> Appearance | None:
        """Colours and light of the most neutral and frontal frame; None without pictures or if configured so."""
        pictured = [item for item in observations if item.picture is not None and item.landmarks is not None]
        if self.plan.deep.appearance == "model" or not pictured:
            return None
        fits = [self._points.fit(item, FrameContext(0, identity, None, None))[0] for item in pictured]
        person, head = self.model.personal(identity), self._deep_model.render
        return most_neutral_appearance([item.picture for item in pictured], fits, person, head, self._look)

    def problem(self, observation: FrameObservation, context: FrameContext) -> DeepProblem:
        """The solver's input for a frame: views, colours, start and stages."""
        problem = DeepProblem(observation, context, self.plan.running(start=True))
        check_scheme(observation, self.model)
        if not observation.faces:
            return problem
        start = self._start(observation, context)
        return replace(
            problem,
            scene=self.scene(context.appearance),
            views=self.views(observation, context),
            start=start,
            history=self._history(context.last, start)._replace(flow=self._flow_link(observation, context, start)),
        )

    def solve(self, problem: DeepProblem, traced: bool = False, cancelled: Callable[[], bool] = never) -> DeepSolution:
        """Run all stages in order. Every step is kept, traced or not. `cancelled` is checked before each step."""
        results, seconds, views = [], [], ()
        parameters = problem.start
        for stage in problem.stages if problem.views else ():
            began = time.perf_counter()
            views = holding(weighed(problem.views, stage), problem.scene, parameters)
            result = solve_stage(self._stage_problem(problem, views, stage), parameters, cancelled)
            parameters = result.parameters
            results.append(result)
            seconds.append(time.perf_counter() - began)
        return DeepSolution(problem, tuple(results), views, tuple(seconds))

    def hand_on(self, solution: DeepSolution) -> Continuation | None:
        """The pose, if a term links frames."""
        problem = solution.problem
        if not self.links_frames or problem.observation.landmarks is None:
            return None
        parameters = solution.parameters
        pose = np.concatenate([parameters.rotation, parameters.translation])
        return continued(parameters, pose, problem.context.last, problem.observation.landmarks.points)

    def traces(self, solution: DeepSolution) -> tuple[StageTrace, ...]:
        """The accepted steps, by stage."""
        return solution.traces()

    def stopped(self, solution: DeepSolution, steps: int) -> DeepSolution:
        """The solution after `steps` accepted steps, counted across all stages."""
        return solution.stopped(steps)

    def scene(self, appearance: Appearance | None) -> DeepScene:
        """Network, model and colours of a shot."""
        sliding = jnp.asarray(float(self.plan.sliding))
        if self._look is not None:
            return DeepScene(self._network, self._deep_model, self._look.texture, sliding, self._look.cover)
        albedo = self._deep_model.render.colors if appearance is None else jnp.asarray(appearance.albedo, jnp.float32)
        return DeepScene(self._network, self._deep_model, albedo, sliding)

    def views(
        self, observation: FrameObservation, context: FrameContext, stage: StagePlan | None = None
    ) -> tuple[DeepView, ...]:
        """The views for a stage; with all landmarks at full weight for None."""
        if stage is not None:
            return weighed(self.views(observation, context), stage)
        return views_of(self.plan, self._network, self._eyes, observation, light_of(context.appearance))

    def record(self, solution: DeepSolution) -> FrameFit:
        """The solution as a record for tables, pictures and exports."""
        observation = solution.problem.observation
        if not solution.results:
            return self._empty(observation, solution.problem.context.shot)
        return record_of(solution, self.plan, self._network, self._eyes, self.camera(observation.image_size))

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
            given, count = context.start, len(self.model.expression_names)
            return start._replace(
                rotation=jnp.asarray(given.rotation, float),
                translation=jnp.asarray(given.translation, float),
                expression=self._seen * given.expression if len(given.expression) == count else start.expression,
                jaw=jnp.asarray(given.jaw, float) if len(given.jaw) else start.jaw,
                scale=jnp.asarray(given.scale, float) if len(given.scale) else start.scale,
            )
        if self.plan.deep.start == "frontal" or observation.landmarks is None:
            return start
        fit = self._points.fit(observation, FrameContext(0, context.identity, None, None))[0]
        # In parallel projection a head that is as far again is half as large, at half the offset.
        nearer = self.plan.deep.distance_mm / fit.translation[2] if self.plan.camera.parallel else 1.0
        place = nearer * jnp.asarray(fit.translation)
        return start._replace(rotation=jnp.asarray(fit.rotation), translation=place, scale=nearer * start.scale)

    def _stage_problem(self, problem: DeepProblem, views: tuple[DeepView, ...], stage: StagePlan) -> StageProblem:
        deep, free = self.plan.deep, self.free(stage)
        lower, upper = map(np.concatenate, parameter_range(self.model, self.plan.solver.bounded))
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
        """The state of previous frames, for terms that link frames."""
        poses, known = (np.zeros(6), np.zeros(6)), np.zeros(())
        if last is not None:
            poses, known = (np.asarray(last.last_pose), np.asarray(last.pose)), np.asarray(float(last.frames >= 2))
        usual = usual_expressions(self.model.expression_names)
        return TermContext(self.plan.constants, *poses, known, start, jaw_unit=self.model.jaw_unit, usual=usual)

    def _flow_link(
        self, observation: FrameObservation, context: FrameContext, start: FaceParameters
    ) -> FlowLink | None:
        if self._flow is None:
            return None
        last = None if context.last is None or not self.plan.compares_pictures else context.last.parameters
        beyond_mm = FAR_MM - float(start.translation[2]) if self.plan.camera.parallel else 0.0
        views = flow_views(self.rig, self.camera(observation.image_size), observation.view_sizes)
        return self._flow.link(observation, last, views, self._flow.points, beyond_mm)

    def free(self, stage: StagePlan) -> Bool[np.ndarray, "n"]:
        """Which entries of the flattened parameters a stage frees. Raises `ConfigError` for unknown blendshapes."""
        return np.concatenate(
            free_parameters(self.model, stage.free, stage.shapes, self.plan.camera.parallel, stage.name)
        )

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


def _steadied(observation: FrameObservation, network: EnergyNetwork) -> FrameObservation:
    """A frame with the landmarks of several looks at its picture, if it has one."""
    if observation.picture is None or observation.landmarks is None:
        return observation
    return replace(observation, landmarks=steadied(network, observation.picture, observation.landmarks))


def _check_look(model: FaceModel, plan: Plan) -> None:
    """Raise `ModelError` where renders are to show a character on another model."""
    if plan.look is not None and model.name != load_default_head().name:
        raise ModelError(
            f"Characters are for the default head, this is the model {model.name}; choose another deep.appearance."
        )


def _warn_of_a_shut_mouth(model: FaceModel, plan: Plan) -> None:
    """Warn where stages free the first components of a basis, and nothing that any stage frees opens the mouth."""
    stages = [stage for stage in plan.stages if stage.enabled]
    able = [stage for stage in stages if "expression" in stage.free]
    shapes = [shape for stage in able for shape in stage.shapes]
    if (
        any(shape.startswith("first:") for shape in shapes)
        and all(stage.shapes for stage in able)
        and not any({"jaw", "jaw_open"} & set(stage.free) for stage in stages)
        and keeps_the_mouth_shut(model, shapes)
    ):
        warnings.warn(
            f"The stages free {', '.join(dict.fromkeys(shapes))} of {model.name}, none of which parts the lips: the "
            "mouth stays shut. Use a model whose components are sorted by size; "
            "workbench.face.principal_expressions makes one.",
            WorkbenchWarning,
            stacklevel=3,
        )
