"""A frame under FACE IT! before and after its stages: the problem, the solution, and its record."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from workbench.face import FaceModel, LandmarkModel
from workbench.geometry import Camera
from workbench.solvers import Status
from workbench.tracking.fitting import FrameProblem, FrameSolution, StageTrace, landmarks_of_others
from workbench.tracking.frame_solver import (
    BLOCKS,
    STAGE_SLOTS,
    FrameInput,
    SolvedFrame,
    SolveSettings,
    StageProgram,
)
from workbench.tracking.observation import FrameObservation
from workbench.tracking.plan import Plan
from workbench.tracking.records import FrameFit, recorded_covariance


@dataclass(frozen=True)
class FaceItProblem(FrameProblem):
    """The input of `solve_frame` for one frame; without landmarks there is nothing to solve."""

    began: float
    """Time at which work on the frame began, seconds."""
    camera: Camera
    settings: SolveSettings
    program: StageProgram
    """The stages that run."""
    person: LandmarkModel | None = None
    frame: FrameInput | None = None


@dataclass(frozen=True)
class FaceItSolution(FrameSolution):
    """The results of `solve_frame`; None if there was nothing to solve."""

    problem: FaceItProblem
    found: SolvedFrame | None
    """On the device, for the next frame."""
    report: SolvedFrame | None
    """The same as NumPy arrays."""
    milliseconds: float

    @property
    def counts(self) -> list[int]:
        """Iterations of each stage that ran."""
        return [int(count) for count in self.report.iterations[: int(self.problem.program.count)]]


def solve_settings(plan: Plan) -> SolveSettings:
    """The settings shared by all stages, as traced values; on the host."""
    lower, upper = (0.0, 1.0) if plan.solver.bounded else (-np.inf, np.inf)
    return in_doubles(
        SolveSettings(
            constants=plan.constants,
            lower=lower,
            upper=upper,
            tolerance=plan.solver.tolerance,
            percent=float(plan.solver.percent),
            sliding=float(plan.sliding),
            dogleg=float(plan.solver.method == "optimistix-dogleg"),
        )
    )


def stage_program(plan: Plan, start: bool) -> StageProgram:
    """The stages of a first or a later frame as data for `solve_frame`; on the host."""
    chosen = plan.running(start)
    slots = STAGE_SLOTS * -(-len(plan.stages) // STAGE_SLOTS)
    moves, limit = np.zeros((slots, len(BLOCKS)), bool), np.zeros(slots, int)
    weights, omega = np.zeros((slots, len(plan.point_weights))), np.zeros((slots, len(plan.terms)))
    for k, stage in enumerate(chosen):
        moves[k], limit[k] = [name in stage.free for name in BLOCKS], stage.limit
        weights[k], omega[k] = stage.landmark_weights, stage.omega
    return StageProgram(moves, limit, weights, omega, np.asarray(len(chosen)))


def traces_of(solution: FaceItSolution, plan: Plan) -> tuple[StageTrace, ...]:
    """The iterations of a traced solution, by stage."""
    stages = plan.running(start=solution.problem.context.last is None)
    energies, residuals = (np.asarray(rows) for rows in solution.found.traces)
    return tuple(
        StageTrace(stages[k].name, energies[k, : count + 1], residuals[k, : count + 1])
        for k, count in enumerate(solution.counts)
    )


def cut_off(solution: FaceItSolution, steps: int) -> StageProgram:
    """The stages of a solution limited to `steps` iterations, counted across all stages.

    Stages beyond that do not run at all: even without an iteration they would move the jaw contour.
    """
    left, limits = max(steps, 0), []
    for count in solution.counts:
        limits.append(min(count, left))
        left -= limits[-1]
        if left == 0:
            break
    program = solution.problem.program
    limit = np.array(program.limit)
    limit[: len(limits)] = limits
    return program._replace(limit=limit, count=np.asarray(len(limits)))


def record_of(solution: FaceItSolution, plan: Plan) -> FrameFit:
    """The record of a solution with a face, for tables, pictures and exports."""
    problem, found = solution.problem, solution.report
    observation, context = problem.observation, problem.context
    # Rows are laid out for the stages of a first frame, so that first and later frames can be stacked.
    stages, count = plan.running(start=True), int(problem.program.count)
    rows = len(stages)
    place = [k for k, stage in enumerate(stages) if context.last is None or not stage.first_only][:count]
    energies = np.full((rows, len(plan.terms)), np.nan)
    status, iterations = np.full(rows, -1), np.zeros(rows, int)
    energies[place], status[place] = found.energies[:count], found.status[:count]
    iterations[place] = found.iterations[:count]
    return FrameFit(
        index=observation.index,
        found=True,
        shot=context.shot,
        source=observation.source,
        image_size=observation.image_size,
        camera=problem.camera,
        rotation=found.parameters.rotation,
        translation=found.parameters.translation,
        expression=found.parameters.expression,
        identity=context.identity,
        observed=observation.landmarks.points,
        confidence=observation.landmarks.confidence,
        projected=found.projected,
        energies=energies,
        status=status,
        iterations=iterations,
        milliseconds=np.array([*observation.milliseconds, solution.milliseconds]),
        others=landmarks_of_others(observation),
        failure="not finite" if (status[place[-1:]] == Status.NOT_FINITE.value).any() else "",
        covariance=recorded_covariance(observation.landmarks.covariance, observation.landmarks.scheme),
    )


def record_without_face(
    observation: FrameObservation, shot: int, camera: Camera, model: FaceModel, plan: Plan
) -> FrameFit:
    """The record of a frame without landmarks."""
    rows, points = len(plan.running(start=True)), len(model.scheme)
    return FrameFit(
        index=observation.index,
        found=False,
        shot=shot,
        source="none",
        image_size=observation.image_size,
        camera=camera,
        rotation=_missing(3),
        translation=_missing(3),
        expression=_missing(len(model.expression_names)),
        identity=_missing(len(model.identity_deltas)),
        observed=_missing(points, 2),
        confidence=_missing(points),
        projected=_missing(points, 2),
        energies=_missing(rows, len(plan.terms)),
        status=np.full(rows, -1),
        iterations=np.zeros(rows, int),
        milliseconds=np.array([*observation.milliseconds, 0.0]),
        others=landmarks_of_others(observation),
        covariance=recorded_covariance(None, model.scheme),
    )


def _missing(*shape: int) -> Float[np.ndarray, "..."]:
    return np.full(shape, np.nan)


def in_doubles(tree):
    """A tree of numbers as NumPy arrays in double precision."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), tree)


def on_device(tree):
    """A tree of numbers as JAX arrays in double precision."""
    return jax.device_put(in_doubles(tree))
