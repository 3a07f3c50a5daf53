"""One frame through the stages of a schedule, as one compiled program.

Which stages run, what each frees, their limits, all weights, bounds, camera and model are data: changing them does not
recompile anything. Only a trust region instead of Levenberg–Marquardt, or keeping a trace, makes another program.
"""

import math
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from workbench.arrays import AnyArray
from workbench.energies import (
    FACE_IT_TERMS,
    TABLE,
    EnergyConstants,
    EnergyProblem,
    Observation,
    TermContext,
    depends_on,
    energy,
    energy_by_term,
    normal_system,
    project_landmarks,
)
from workbench.energies.context import Gaze
from workbench.energies.flow_link import FlowLink
from workbench.energies.systems import SYSTEMS
from workbench.face import (
    FaceParameters,
    LandmarkModel,
    contour_blend,
    model_landmarks,
    pack,
    typical_sizes,
    unpack,
)
from workbench.geometry import Camera, head_yaw
from workbench.landmarks.schemes import PUPILS
from workbench.runtime import SMALL_ARRAYS
from workbench.solvers import LevenbergMarquardt, Solution, TrustRegion, minimise

BLOCKS = SYSTEMS["face-it"].blocks
"""Blocks of parameters that a stage may free, in the order of the solver's vector."""
BRANCHES = (("rotation", "translation"), BLOCKS)
"""The branches of one compiled program: a pose-only stage costs a small solve, any other stage a solve of the whole
vector. Parameters that a stage does not free are masked, so that no schedule triggers recompilation."""
PUPIL_GUESS = 0.06
"""Deviation, as a share of the outer-eye distance, of a pupil that is half hidden: some 20 degrees of gaze."""
STAGE_SLOTS = 8
"""Schedules are padded to a multiple of this many stages."""
Method = Literal["levenberg-marquardt", "trust-region"]


class StageProgram(NamedTuple):
    """The stages to run, as data."""

    moves: Bool[AnyArray, "s 3"]
    """Which of `BLOCKS` each stage frees."""
    limit: Int[AnyArray, "s"]
    """ρ or ε."""
    landmark_weights: Float[AnyArray, "s points"]
    omega: Float[AnyArray, "s t"]
    """Factor in front of each term; 0 if a stage leaves it out."""
    count: Int[AnyArray, ""]
    """Number of stages that run; the remaining rows are padding."""


class SolveSettings(NamedTuple):
    """The settings of a solve, as traced values."""

    constants: EnergyConstants
    lower: Float[AnyArray, "*k"]
    """Lower bound of each blendshape weight, −∞ for none. The model's own bounds replace finite ones, and apply to
    weights that the model holds because they move no landmark."""
    upper: Float[AnyArray, "*k"]
    tolerance: Float[AnyArray, ""]
    percent: Float[AnyArray, ""]
    """1: residuals in percent of the outer-eye distance; 0: in pixels."""
    sliding: Float[AnyArray, ""]
    """1: the jaw contour slides with the yaw; 0: it stays at its frontal position."""
    dogleg: Float[AnyArray, ""] | float = 0.0
    """1: the trust region descends along the dogleg; 0: by a damped step."""


class FrameInput(NamedTuple):
    """The input for one frame."""

    measured: Float[AnyArray, "points 3"]
    """x and y in pixels, and what the point counts. One array: each one passed in costs as much as an iteration."""
    last_pose: Float[AnyArray, "6"]
    before_last_pose: Float[AnyArray, "6"]
    history: Float[AnyArray, ""]
    start: FaceParameters
    flow: FlowLink | None = None
    """None where no stage names the flow term."""
    whitening: Float[AnyArray, "points 2 2"] | None = None
    """`Observation.whitening`."""


class SolvedFrame(NamedTuple):
    """The results of the stages for one frame; rows of stages that did not run hold NaN, −1 and 0."""

    parameters: FaceParameters
    pose: Float[AnyArray, "6"]
    """[r | t], for the next frame's E_τ."""
    projected: Float[AnyArray, "points 2"]
    """Model landmarks in the picture, pixels."""
    energies: Float[AnyArray, "s t"]
    """Weighted energy of each term after each stage."""
    status: Int[AnyArray, "s"]
    iterations: Int[AnyArray, "s"]
    report: Float[AnyArray, "n"]
    """All of the above in one vector (`read_report`): one transfer instead of nine."""
    traces: Any
    """None unless requested: per stage, energies (s, steps, t) and landmark residuals in pixels (s, steps, points)."""


def run_stages(
    camera: Camera,
    model: LandmarkModel,
    settings: SolveSettings,
    program: StageProgram,
    frame: FrameInput,
    method: Method = "levenberg-marquardt",
    trace_length: int = 0,
    terms: tuple[str, ...] = FACE_IT_TERMS,
) -> SolvedFrame:
    """Run the stages in order, each from the previous result. `terms` names the columns of `program.omega`."""
    settings = within_range(settings, model)
    program = jax.tree.map(jnp.asarray, program)  # a traced stage picks its row

    def branch(free: tuple[str, ...]):
        def run(problem: EnergyProblem, parameters: FaceParameters, moves, limit):
            moving = moving_unknowns(parameters, moves, free)
            solution = _solve_stage(problem, parameters, settings, limit, free, moving, terms, method, trace_length)
            return unpack(solution.x, parameters, free), solution.status, solution.iterations, solution.trace

        return run

    pose_only, everything = (branch(free) for free in BRANCHES)
    of_pose = np.array([depends_on(TABLE[name], BRANCHES[0]) for name in terms])

    def body(carry):
        k, parameters, _, rows = carry
        moves = program.moves[k]
        # A held pose has no E_τ.
        seen = frame._replace(history=frame.history * moves[:2].any())
        omega, landmark_weights = program.omega[k], program.landmark_weights[k]
        problem = stage_problem(camera, model, settings, landmark_weights, omega, seen, parameters)
        parameters, status, iterations, trace = jax.lax.cond(
            moves[2], everything, pose_only, problem, parameters, moves, program.limit[k]
        )
        energies = jnp.where(moves[2] | of_pose, energy_by_term(problem, parameters, BLOCKS, terms), 0.0)
        projected = project_landmarks(camera, problem.points, parameters)
        new = (energies, status, iterations, trace)
        return k + 1, parameters, projected, jax.tree.map(lambda old, row: old.at[k].set(row), rows, new)

    slots, count = len(program.moves), len(frame.measured)
    trace = None
    if trace_length:
        trace = (jnp.zeros((slots, trace_length + 1, len(terms))), jnp.zeros((slots, trace_length + 1, count)))
    rows = (jnp.full((slots, len(terms)), jnp.nan), jnp.full(slots, -1), jnp.zeros(slots, int), trace)
    parameters = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), frame.start)
    parameters = parameters._replace(expression=jnp.where(_held(settings), settings.lower, parameters.expression))
    start = (jnp.asarray(0), parameters, jnp.zeros((count, 2)), rows)
    _, parameters, projected, rows = jax.lax.while_loop(lambda carry: carry[0] < program.count, body, start)
    pose = jnp.concatenate([parameters.rotation, parameters.translation])
    parts = (parameters, pose, projected, *rows[:3])
    report = jnp.concatenate([jnp.ravel(leaf).astype(float) for leaf in jax.tree.leaves(parts)])
    return SolvedFrame(*parts, report, rows[3])


solve_frame = jax.jit(run_stages, static_argnames=("method", "trace_length", "terms"), compiler_options=SMALL_ARRAYS)
"""`run_stages` as a compiled program."""


def within_range(settings: SolveSettings, model: LandmarkModel) -> SolveSettings:
    """The settings with the model's own bounds of each weight; if weights are unbounded, only of those that the model
    holds."""
    held = model.expression_lower == model.expression_upper
    return settings._replace(
        lower=jnp.where(held | jnp.isfinite(settings.lower), model.expression_lower, settings.lower),
        upper=jnp.where(held | jnp.isfinite(settings.upper), model.expression_upper, settings.upper),
    )


def _held(settings: SolveSettings):
    """Weights whose lower and upper bounds are equal."""
    return settings.lower == settings.upper


def read_report(solution: SolvedFrame) -> SolvedFrame:
    """The solution as NumPy arrays, fetched in one transfer; traces stay on the device."""
    leaves, structure = jax.tree.flatten(tuple(solution)[:6])
    report = np.asarray(solution.report)
    host, start = [], 0
    # Plain slices of one array: here np.split and cumsum would take longer than two iterations of the solver.
    for leaf in leaves:
        shape, dtype = leaf.shape, leaf.dtype
        end = start + math.prod(shape)
        host.append(report[start:end].reshape(shape).astype(dtype, copy=False))
        start = end
    return SolvedFrame(*jax.tree.unflatten(structure, host), report, solution.traces)


def stage_problem(
    camera: Camera,
    model: LandmarkModel,
    settings: SolveSettings,
    landmark_weights: Float[AnyArray, "points"],
    omega: Float[AnyArray, "t"],
    frame: FrameInput,
    parameters: FaceParameters,
) -> EnergyProblem:
    """The energy of one stage: contour, blink travel and residual unit are fixed at the start of the stage."""
    blend = contour_blend(model.contour_yaw, head_yaw(parameters.rotation), settings.sliding)
    points = model_landmarks(model, blend, parameters.identity)
    eye_distance_mm = jnp.linalg.norm(points.neutral[45] - points.neutral[36])
    eye_distance_px = jnp.mean(jnp.asarray(camera.focal_px)) * eye_distance_mm / parameters.translation[2]
    unit = jnp.where(settings.percent > 0.5, 0.01 * eye_distance_px, 1.0)
    weights = landmark_weights * frame.measured[:, 2]
    observation = Observation(frame.measured[:, :2], weights, unit, frame.whitening)
    before = (frame.before_last_pose, frame.last_pose, frame.history)
    gaze = None
    if model.gaze is not None:
        hidden = hidden_eyes(frame, weights, eye_distance_px)
        gaze = Gaze(model.gaze, hidden, frame.start.expression)
    context = TermContext(settings.constants, *before, parameters, frame.flow, gaze=gaze, usual=model.usual)
    return EnergyProblem(camera, points, observation, omega, context)


def hidden_eyes(
    frame: FrameInput, weights: Float[AnyArray, "points"], eye_distance_px: Float[AnyArray, ""]
) -> Float[AnyArray, ""]:
    """How far both pupils are hidden: each one's variance squared against that of a guess, 1 without weight.

    Squared, so that eyes which are seen are not held at all. Where one is, the other follows it by vergence. Without
    covariances what confidence lacks, squared as well.
    """
    pupils = np.array(PUPILS)
    if frame.whitening is None:
        return jnp.prod(jnp.where(weights[pupils] > 0.0, (1.0 - frame.measured[pupils, 2]) ** 2, 1.0))
    # The whitening is triangular: the product of its diagonal is one over the area of a deviation.
    variance = 1.0 / (frame.whitening[pupils, 0, 0] * frame.whitening[pupils, 1, 1])
    more = (variance / (PUPIL_GUESS * eye_distance_px) ** 2) ** 2
    return jnp.prod(jnp.where(weights[pupils] > 0.0, more / (more + 1.0), 1.0))


def moving_unknowns(
    parameters: FaceParameters, moves: Bool[AnyArray, "3"], free: tuple[str, ...]
) -> Bool[AnyArray, "n"]:
    """Which entries of the solver's vector a stage frees; `moves` is the same for each of `BLOCKS`."""
    return jnp.concatenate(
        [jnp.broadcast_to(moves[BLOCKS.index(name)], getattr(parameters, name).shape) for name in free]
    )


def _solve_stage(problem, parameters, settings, limit, free, moving, terms, method: Method, trace_length) -> Solution:
    start = pack(parameters, free)

    def record(x):
        at = unpack(x, parameters, free)
        error = project_landmarks(problem.camera, problem.points, at) - problem.observation.points
        return energy_by_term(problem, at, free, terms), jnp.linalg.norm(error, axis=1)

    def cost(x):
        return energy(problem, unpack(x, parameters, free), free, terms)

    held = ~moving
    upper = jnp.full(start.shape, jnp.inf)
    lower = -upper
    if "expression" in free:
        at = slice(len(start) - len(parameters.expression), None)
        lower, upper = lower.at[at].set(settings.lower), upper.at[at].set(settings.upper)
    recorded = (record if trace_length else None, trace_length)
    if method == "levenberg-marquardt":
        solver = LevenbergMarquardt()
    else:
        solver = TrustRegion(typical_sizes(parameters, free), "either", is_dogleg=settings.dogleg > 0.5)
    return minimise(
        solver,
        lambda x: normal_system(problem, unpack(x, parameters, free), free, terms).restricted(moving),
        start, jnp.where(held, start, lower), jnp.where(held, start, upper),
        limit, settings.tolerance, *recorded, cost,
    )  # fmt: skip
