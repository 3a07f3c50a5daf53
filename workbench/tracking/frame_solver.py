"""One frame through the stages of a schedule, as one compiled program.

The free parameters of the stages are part of the program; limits, weights, landmark weights, bounds, camera and model
are data, so that moving any of them compiles nothing.
"""

import math
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from workbench.arrays import AnyArray
from workbench.energies import (
    EnergyConstants,
    EnergyProblem,
    EnergyWeights,
    Observation,
    energy,
    energy_by_term,
    normal_system,
    pack,
    project_landmarks,
    unpack,
)
from workbench.face import FaceParameters, LandmarkModel, contour_blend, model_landmarks
from workbench.geometry import Camera, rotation_matrix
from workbench.solvers import Solution, minimise

OUTER_EYE_CORNERS = (36 - 17, 45 - 17)
"""Among the 51 inner landmarks."""


class StageNumbers(NamedTuple):
    """The traced part of one stage."""

    limit: Int[AnyArray, ""]
    """ρ or ε."""
    landmark_weights: Float[AnyArray, "68"]


class SolveSettings(NamedTuple):
    """The traced part of a configuration."""

    weights: EnergyWeights
    constants: EnergyConstants
    lower: Float[AnyArray, ""]
    """Lowest blendshape weight, −∞ for none."""
    upper: Float[AnyArray, ""]
    tolerance: Float[AnyArray, ""]
    percent: Float[AnyArray, ""]
    """1: residuals count in percent of the outer-eye distance; 0: in pixels."""
    sliding: Float[AnyArray, ""]
    """1: the jaw contour slides with the yaw; 0: it stays at its frontal place."""


class FrameInput(NamedTuple):
    """What one frame brings."""

    measured: Float[AnyArray, "68 3"]
    """x and y in pixels, and confidence: one array, because each one handed over costs as much as an iteration."""
    last_pose: Float[AnyArray, "6"]
    before_last_pose: Float[AnyArray, "6"]
    history: Float[AnyArray, ""]
    start: FaceParameters


class FrameSolution(NamedTuple):
    """What the stages make of it."""

    parameters: FaceParameters
    pose: Float[AnyArray, "6"]
    """[r | t], for the next frame's E_τ."""
    projected: Float[AnyArray, "68 2"]
    """Model landmarks in the picture, pixels."""
    energies: Float[AnyArray, "s 7"]
    """Weighted energy of each term after each stage."""
    status: Int[AnyArray, "s"]
    iterations: Int[AnyArray, "s"]
    report: Float[AnyArray, "n"]
    """Everything above but the traces in one vector (`read_report`): one transfer instead of nine."""
    traces: tuple
    """By stage, None unless asked for: energies (steps, 7) and landmark residuals in pixels (steps, 68)."""


def head_yaw(rotation: Float[AnyArray, "3"]) -> Float[AnyArray, ""]:
    """Yaw in radians of an axis-angle rotation (`geometry.rotations` has the convention)."""
    return jnp.arcsin(jnp.clip(rotation_matrix(rotation)[0, 2], -1.0, 1.0))


@partial(jax.jit, static_argnames=("stages", "trace_length"))
def solve_frame(
    stages: tuple[tuple[str, ...], ...],
    camera: Camera,
    model: LandmarkModel,
    settings: SolveSettings,
    numbers: tuple[StageNumbers, ...],
    frame: FrameInput,
    trace_length: int = 0,
) -> FrameSolution:
    """Run the stages in order, each from where the one before ended. `stages` lists each one's free parameters."""
    parameters = frame.start
    energies, statuses, iterations, traces = [], [], [], []
    for free, number in zip(stages, numbers, strict=True):
        problem = stage_problem(camera, model, settings, number, frame, parameters)
        solution = _solve_stage(problem, parameters, settings, number, free, trace_length)
        parameters = unpack(solution.x, parameters, free)
        energies.append(energy_by_term(problem, parameters, free))
        statuses.append(solution.status)
        iterations.append(solution.iterations)
        traces.append(solution.trace)
    projected = project_landmarks(camera, problem.points, parameters)
    pose = jnp.concatenate([parameters.rotation, parameters.translation])
    parts = (parameters, pose, projected, jnp.stack(energies), jnp.stack(statuses), jnp.stack(iterations))
    report = jnp.concatenate([jnp.ravel(leaf).astype(float) for leaf in jax.tree.leaves(parts)])
    return FrameSolution(*parts, report, tuple(traces))


def read_report(solution: FrameSolution) -> FrameSolution:
    """The solution with NumPy arrays, fetched in one transfer; traces stay where they are."""
    leaves, structure = jax.tree.flatten(tuple(solution)[:6])
    report = np.asarray(solution.report)
    host, start = [], 0
    # Slices of one array: np.split and cumsum take longer here than two iterations of the solver.
    for leaf in leaves:
        shape, dtype = leaf.shape, leaf.dtype
        end = start + math.prod(shape)
        host.append(report[start:end].reshape(shape).astype(dtype, copy=False))
        start = end
    return FrameSolution(*jax.tree.unflatten(structure, host), report, solution.traces)


def stage_problem(
    camera: Camera,
    model: LandmarkModel,
    settings: SolveSettings,
    number: StageNumbers,
    frame: FrameInput,
    parameters: FaceParameters,
) -> EnergyProblem:
    """The energy of one stage: contour, blink travel and residual unit are fixed by where the stage starts."""
    blend = contour_blend(model.contour_yaw, head_yaw(parameters.rotation), settings.sliding)
    points = model_landmarks(model, blend, parameters.identity)
    eye_distance_mm = jnp.linalg.norm(points.neutral[45] - points.neutral[36])
    eye_distance_px = jnp.mean(jnp.asarray(camera.focal_px)) * eye_distance_mm / parameters.translation[2]
    unit = jnp.where(settings.percent > 0.5, 0.01 * eye_distance_px, 1.0)
    weights = number.landmark_weights * frame.measured[:, 2]
    observation = Observation(frame.measured[:, :2], weights, unit)
    return EnergyProblem(
        camera,
        points,
        observation,
        settings.weights,
        settings.constants,
        frame.before_last_pose,
        frame.last_pose,
        frame.history,
    )


def _solve_stage(problem, parameters, settings, number, free, trace_length) -> Solution:
    start = pack(parameters, free)
    upper = jnp.full(start.shape, jnp.inf)
    lower = -upper
    if "expression" in free:
        at = _slot("expression", parameters, free)
        lower, upper = lower.at[at].set(settings.lower), upper.at[at].set(settings.upper)

    def evaluate(x):
        return normal_system(problem, unpack(x, parameters, free), free)

    def cost(x):
        return energy(problem, unpack(x, parameters, free), free)

    def record(state):
        at = unpack(state.x, parameters, free)
        error = project_landmarks(problem.camera, problem.points, at) - problem.observation.points
        return energy_by_term(problem, at, free), jnp.linalg.norm(error, axis=1)

    return minimise(
        evaluate,
        start,
        lower,
        upper,
        number.limit,
        settings.tolerance,
        record if trace_length else None,
        trace_length,
        cost,
    )


def _slot(name: str, parameters: FaceParameters, free: tuple[str, ...]) -> slice:
    start = sum(len(getattr(parameters, other)) for other in free[: free.index(name)])
    return slice(start, start + len(getattr(parameters, name)))
