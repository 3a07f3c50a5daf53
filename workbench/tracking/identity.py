"""Identity calibration: one identity shared by several frames, each with its own pose and expression.

FACE IT! animates a character or a reconstruction made beforehand. Here the reconstruction is estimated from the
landmarks by least squares, with a normal prior on the identity coefficients and another on the head's size. Chin and
jaw are used only in the second pass: a detected contour is a silhouette, and a pose fitted to it turns the head to
explain a long face.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from workbench.arrays import AnyArray, Count, Scalar
from workbench.energies import FACE_IT_TERMS, EnergyConstants, energy, normal_system
from workbench.face import FaceParameters, LandmarkModel, pack, unpack
from workbench.geometry import Camera
from workbench.runtime import ONE_THREAD
from workbench.solvers import ArrowheadSystem, DenseSystem, LevenbergMarquardt, minimise
from workbench.tracking.frame_solver import BLOCKS, FrameInput, SolveSettings, moving_unknowns, stage_problem

MOVES = ((True, True, True), (False, False, True))
"""Which of `BLOCKS` each pass frees in every frame, in addition to the shared identity: first everything, on the inner
landmarks; then expression and identity on all landmarks, with the poses held."""


class CalibrationSettings(NamedTuple):
    """Traced settings of the calibration; residuals are in percent of the outer-eye distance."""

    identity: Scalar
    """ω of ‖identity‖²: the squared landmark noise, in percent, that one standard deviation of the face costs."""
    size: Scalar
    """ω of (the head's growth over the mean head, in percent)²; see `identity_prior`."""
    expression: Scalar
    """ω of the smoothed L1 norm of each frame's weights: high, because identity should explain what is constant."""
    limits: tuple[Count, ...]
    """Maximum iterations of each pass (`MOVES`)."""
    landmark_weights: Float[AnyArray, "passes points"]
    """Landmark weights of each pass (`MOVES`)."""
    sliding: Scalar


class Calibration(NamedTuple):
    """Shared identity, and the pose and expression of each frame from the same solve."""

    identity: Float[AnyArray, "i"]
    frames: FaceParameters
    """Stacked over the frames."""
    cost: Float[AnyArray, ""]
    iterations: Int[AnyArray, "passes"]


@partial(jax.jit, compiler_options=ONE_THREAD)
def calibrate_identity(
    cameras: Camera,
    model: LandmarkModel,
    settings: CalibrationSettings,
    starts: FaceParameters,
    points: Float[AnyArray, "f points 2"],
    weights: Float[AnyArray, "f points"],
    whitening: Float[AnyArray, "f points 2 2"] | None = None,
) -> Calibration:
    """Solve for one identity and `f` poses and expressions; cameras and starts are stacked over the frames.

    `whitening` as in `Observation`. A frame with all weights zero is ignored. Blendshape weights stay in the model's
    range. Each pass fixes contour and blink travel at its start.
    """
    steps = (jnp.asarray(MOVES), jnp.asarray(settings.limits), jnp.asarray(settings.landmark_weights))

    def run(frames, a_pass):
        frames, solution = _solve_pass(cameras, model, settings, a_pass, frames, (points, weights, whitening))
        return frames, (solution.cost, solution.iterations)

    frames, (costs, iterations) = jax.lax.scan(run, jax.tree.map(jnp.asarray, starts), steps)
    return Calibration(frames.identity[0], frames, costs[-1], iterations)


def _solve_pass(cameras, model, settings, a_pass, frames, observed):
    moves, limit, landmark_weights = a_pass
    prior = identity_prior(model, settings)
    free = (*BLOCKS, "identity")
    # The prior of the shared identity counts once, not once per frame, so it is added to the whole system below.
    factors = {"landmarks": 1.0, "sigma_smooth": settings.expression}
    omega = jnp.stack([jnp.asarray(factors.get(name, 0.0), float) for name in FACE_IT_TERMS])
    solve_settings = SolveSettings(EnergyConstants(), 0.0, 1.0, 1e-6, 1.0, settings.sliding)

    def problem_of(camera, parameters, seen):
        points, weight, whitening = seen
        measured = jnp.concatenate([points, weight[:, None]], axis=1)
        frame = FrameInput(measured, jnp.zeros(6), jnp.zeros(6), jnp.zeros(()), parameters, whitening=whitening)
        return stage_problem(camera, model, solve_settings, landmark_weights, omega, frame, parameters)

    problems = jax.vmap(problem_of)(cameras, frames, observed)
    packed = jax.vmap(lambda frame: pack(frame, BLOCKS))(frames)
    count, common = len(packed), slice(packed.shape[1], None)
    first = jax.tree.map(lambda stacked: stacked[0], frames)
    moving = jnp.tile(moving_unknowns(first, moves, BLOCKS), count)
    moving = jnp.concatenate([moving, jnp.ones(len(first.identity), bool)])

    def split(x):
        return x[: packed.size].reshape(packed.shape), x[packed.size :]

    def of_frames(function, x):
        """`function(problem, parameters)` evaluated for each frame."""
        locals_, identity = split(x)

        def of_frame(problem, local, frame):
            return function(problem, unpack(jnp.concatenate([local, identity]), frame, free), free)

        return jax.vmap(of_frame)(problems, locals_, frames)

    def cost(x):
        identity = split(x)[1]
        return of_frames(energy, x).sum() + identity @ prior @ identity

    def evaluate(x):
        identity = split(x)[1]
        systems = of_frames(normal_system, x)
        total = systems.cost.sum() + identity @ prior @ identity
        if count == 1:
            # A single frame needs no Schur complement: solving one dense system is several times faster.
            gradient = systems.gradient[0].at[common].add(prior @ identity)
            system = DenseSystem(total, gradient, systems.matrix[0].at[common, common].add(prior))
        else:
            system = arrowhead(total, systems, identity)
        return system.restricted(moving)

    def arrowhead(total, systems, identity):
        own = slice(0, packed.shape[1])
        return ArrowheadSystem(
            cost=total,
            local_gradient=systems.gradient[:, own],
            shared_gradient=systems.gradient[:, common].sum(0) + prior @ identity,
            local=systems.matrix[:, own, own],
            border=systems.matrix[:, own, common],
            shared=systems.matrix[:, common, common].sum(0) + prior,
        )

    lower, upper = _bounds(frames, model)
    solution = minimise(
        LevenbergMarquardt(),
        evaluate,
        jnp.concatenate([packed.ravel(), frames.identity[0]]),
        lower,
        upper,
        limit,
        1e-6,
        cost=cost,
    )
    locals_, identity = split(solution.x)
    moved = jax.vmap(lambda local, frame: unpack(local, frame, BLOCKS))(locals_, frames)
    return moved._replace(identity=jnp.broadcast_to(identity, frames.identity.shape)), solution


def identity_prior(model: LandmarkModel, settings: CalibrationSettings) -> Float[AnyArray, "i i"]:
    """The matrix P of the prior identityᵀ P identity = ω_identity ‖identity‖² + ω_size (growth in percent)².

    The growth is that of the frontal landmarks about their centre, to first order. One camera hardly tells a head's
    size, but a basis ties it to proportions: without a prior of its own, what a detector gets wrong alike in every
    frame makes the head a fifth smaller and nearer.
    """
    frontal = jnp.concatenate([model.contour_neutral[0], model.inner_neutral])
    moved = jnp.concatenate([model.contour_identity[0], model.inner_identity], axis=1)
    centred = frontal - frontal.mean(axis=0)
    growth = 100.0 * (moved * centred).sum(axis=(1, 2)) / (centred**2).sum()
    return settings.identity * jnp.eye(len(growth)) + settings.size * jnp.outer(growth, growth)


def _bounds(frames: FaceParameters, model: LandmarkModel):
    pose, identity = jnp.full(6, jnp.inf), jnp.full(frames.identity.shape[1], jnp.inf)
    frame_count = len(frames.expression)
    lower = jnp.concatenate([-pose, model.expression_lower])
    upper = jnp.concatenate([pose, model.expression_upper])
    return (
        jnp.concatenate([jnp.tile(lower, frame_count), -identity]),
        jnp.concatenate([jnp.tile(upper, frame_count), identity]),
    )


def spread_over_yaw(yaws_deg: Float[np.ndarray, "n"], count: int) -> Int[np.ndarray, "_"]:
    """Indices of up to `count` frames spread evenly over the range of head yaws, in ascending order of time.

    Views from several directions are needed to separate depth from expression. One alone is the middle one.
    """
    order = np.argsort(yaws_deg, kind="stable")
    if count == 1:
        return order[(len(order) - 1) // 2 :][:1]
    chosen = order[np.unique(np.round(np.linspace(0, len(order) - 1, min(count, len(order)))).astype(int))]
    return np.sort(chosen)
