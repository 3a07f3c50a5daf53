"""The optimum of a stage as a function of everything that its energy depends on, with the derivative that it has there.

At the optimum x of E(x; θ) unknowns either feel no force, ∂E/∂x_f = 0, or rest on a bound that E presses them against.
Differentiated by θ (the weights of terms and landmarks, constants, camera, and what the stage holds) this gives, by the
implicit function theorem,

    H_ff · dx_f = −∂²E/∂x_f∂θ · dθ,     dx of unknowns on a bound = 0:

one linear system a stage, however many iterations the solver took. H is the whole Hessian of the energy: Gauss–Newton's
JᵀJ leaves out how residuals bend, and the smoothed L1 norm, linear far from 0, is all bend (its JᵀJ is 1/(4w) where its
curvature is nearly 0); the solver's normal equations have that, but not how landmarks bend with the pose.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from workbench.arrays import AnyArray
from workbench.energies import TABLE, EnergyProblem, depends_on, landmark_errors, normal_system, weighed_residuals
from workbench.face import FaceParameters, pack, unpack
from workbench.solvers import LevenbergMarquardt, minimise

OFF = 1e-200
"""Added to every ω: the derivative of √ω exists at ω = 0, and no other number changes."""
STILL = 1e-11
"""The force on free unknowns, relative to the forces of the terms, below which an optimum is reached."""
SOLVER_STEPS, SOLVER_TOLERANCE = 30, 1e-4
"""What the solver does before Newton's steps."""
NEWTON_STEPS = 40
FIRST_DAMPING, FALL = 10.0, 0.01
"""Of Newton's steps. Where the solver stops, the smoothed L1 norm still bends so fast that a whole step goes too far; a
few steps later nothing has to be held back."""
RIDGE = 1e-13
"""Share of the largest curvature added to all: unknowns that nothing holds, as in a hidden frame, stay."""


class Box(NamedTuple):
    """Where the unknowns of a stage may be."""

    lower: Float[AnyArray, "n"]
    upper: Float[AnyArray, "n"]


def smooth_energy(
    problem: EnergyProblem,
    x: Float[AnyArray, "n"],
    held: FaceParameters,
    free: tuple[str, ...],
    terms: tuple[str, ...],
) -> Float[AnyArray, ""]:
    """E(x) as `energies.energy` has it, with derivatives where an ω or the weight of a landmark is 0.

    That by the weight of a landmark is 0 there: who is out, stays out.
    """
    parameters = unpack(x, held, free)
    counts = jnp.asarray(problem.observation.weights)
    root = jnp.where(counts > 0.0, jnp.sqrt(jnp.where(counts > 0.0, counts, 1.0)), 0.0)
    certain = problem.observation._replace(weights=jnp.ones(len(counts)))
    errors = landmark_errors(problem.camera, problem.points, parameters, certain)
    errors = errors._replace(root=root, weighted_edges=problem.context.constants.weighted_edges)
    chosen = [k for k, name in enumerate(terms) if depends_on(TABLE[name], free)]
    omega = jnp.asarray(problem.omega)[np.array(chosen)] + OFF
    names = tuple(terms[k] for k in chosen)
    found = weighed_residuals(names, omega, errors, parameters, problem.context)
    return sum(jnp.sum(part**2) for part in found.values())


@partial(jax.jit, static_argnums=(3, 4))
def slope_of(
    problem: EnergyProblem, x: Float[AnyArray, "n"], held: FaceParameters, free: tuple[str, ...], terms: tuple[str, ...]
) -> Float[AnyArray, "n"]:
    """∂E/∂x."""
    return jax.grad(smooth_energy, argnums=1)(problem, x, held, free, terms)


@partial(jax.jit, static_argnums=(3, 4))
def curvature_of(
    problem: EnergyProblem, x: Float[AnyArray, "n"], held: FaceParameters, free: tuple[str, ...], terms: tuple[str, ...]
) -> Float[AnyArray, "n n"]:
    """∂²E/∂x²."""
    return jax.jacfwd(slope_of, argnums=1)(problem, x, held, free, terms)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def optimum(
    free: tuple[str, ...],
    terms: tuple[str, ...],
    problem: EnergyProblem,
    start: FaceParameters,
    box: Box,
) -> Float[AnyArray, "n"]:
    """The unknowns `free` of a stage where its energy is least near `start`, inside the box.

    Differentiable by `problem` (forward and backward), and by the entries of `start` that the stage holds. Newton's
    steps follow those of the solver: a solver that stops where the energy falls by less than a millionth is still a
    hundredth of a weight away, which a derivative feels.
    """
    x = pack(start, free)

    def system(x):
        return normal_system(problem, unpack(x, start, free), free, terms)

    def energy(x):
        return smooth_energy(problem, x, start, free, terms)

    found = minimise(LevenbergMarquardt(), system, x, box.lower, box.upper, SOLVER_STEPS, SOLVER_TOLERANCE, cost=energy)

    def slope(x):
        return slope_of(problem, x, start, free, terms)

    def curvature(x):
        return curvature_of(problem, x, start, free, terms)

    return _by_newton(energy, slope, curvature, found.x, box.lower, box.upper)


@optimum.defjvp
def _optimum_moves(free, terms, primals, tangents):
    problem, start, box = primals
    problem_moves, start_moves, *_ = tangents
    x = optimum(free, terms, problem, start, box)
    slope, curvature = (of(problem, x, start, free, terms) for of in (slope_of, curvature_of))
    at_bound = resting(x, slope, box.lower, box.upper)
    turned = jax.jvp(
        lambda problem, held: slope_of(problem, x, held, free, terms), (problem, start), (problem_moves, start_moves)
    )[1]
    return x, jnp.linalg.solve(_among_free(curvature, at_bound, 0.0), jnp.where(at_bound, 0.0, -turned))


def resting(
    x: Float[AnyArray, "n"], slope: Float[AnyArray, "n"], lower: Float[AnyArray, "n"], upper: Float[AnyArray, "n"]
) -> Bool[AnyArray, "n"]:
    """Which unknowns rest on a bound that the energy presses them against."""
    return ((x <= lower) & (slope >= 0.0)) | ((x >= upper) & (slope <= 0.0))


def _among_free(curvature, fixed, damping):
    """The Hessian among unknowns that are free, and the identity among the others."""
    both_free = ~fixed[:, None] & ~fixed[None, :]
    steepest = jnp.max(jnp.abs(jnp.diagonal(curvature)))
    diagonal = jnp.where(fixed, 1.0, damping * jnp.abs(jnp.diagonal(curvature)) + RIDGE * steepest)
    return jnp.where(both_free, curvature, 0.0) + jnp.diag(diagonal)


class _Newton(NamedTuple):
    """State of Newton's steps."""

    count: Float[AnyArray, ""]
    x: Float[AnyArray, "n"]
    force: Float[AnyArray, ""]
    """Largest on a free unknown, relative to the first."""
    damping: Float[AnyArray, ""]


def _by_newton(energy, slope_at, curvature_at, x, lower, upper):
    """The place of least energy near x, by steps with the whole Hessian; a step that makes the force on the free
    unknowns no less is taken again, shorter."""

    def free_force(x):
        slope = slope_at(x)
        return jnp.max(jnp.abs(jnp.where(resting(x, slope, lower, upper), 0.0, slope)))

    def wanted(state):
        return (state.count < NEWTON_STEPS) & (state.force > STILL * scale) & (state.damping < 1e9)

    def step(state):
        slope, curvature = slope_at(state.x), curvature_at(state.x)
        held = resting(state.x, slope, lower, upper)
        move = jnp.linalg.solve(_among_free(curvature, held, state.damping), jnp.where(held, 0.0, -slope))
        candidate = jnp.clip(state.x + move, lower, upper)
        force = free_force(candidate)
        rounding = 1e-13 * jnp.abs(energy(state.x))
        better = jnp.where(
            force < state.force,
            energy(candidate) <= energy(state.x) + rounding,
            energy(candidate) < energy(state.x) - rounding,
        )
        less = FALL * state.damping * (state.damping > 1e-6)
        damping = jnp.where(better, less, jnp.maximum(10 * state.damping, 1e-4))
        return _Newton(
            state.count + 1,
            jnp.where(better, candidate, state.x),
            jnp.where(better, force, state.force),
            damping,
        )

    scale = 1.0 + jnp.abs(energy(x))
    first = _Newton(jnp.asarray(0), x, free_force(x), jnp.asarray(FIRST_DAMPING))
    return jax.lax.while_loop(wanted, step, first).x
