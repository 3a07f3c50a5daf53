"""The whole energy E(γ) (FACE IT! Eqs. 5–7): the table's terms, weighed and summed.

As residuals for both systems; by term; and, for points on the mesh, as normal equations.
"""

from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.energies.context import LandmarkErrors, TermContext
from workbench.energies.reprojection import Observation, counted_errors, landmark_errors, reprojection_with_jacobian
from workbench.energies.terms import TABLE, Term, terms_of
from workbench.face.landmark_model import PointModel
from workbench.face.parameters import FaceParameters
from workbench.face.unknowns import pack, slots, unpack
from workbench.geometry import Camera
from workbench.solvers import DenseSystem

FACE_IT_TERMS = terms_of("face-it")
"""The terms of FACE IT! where no stage names another."""


class EnergyProblem(NamedTuple):
    """All that the energy of one frame depends on, besides the parameters."""

    camera: Camera
    points: PointModel
    observation: Observation
    omega: Float[AnyArray, "t"]
    """Factor in front of each term (`terms.stage_factors`)."""
    context: TermContext


def weighed_residuals(
    terms: tuple[str, ...],
    omega: Float[AnyArray, "t"],
    errors: LandmarkErrors,
    parameters: FaceParameters,
    context: TermContext,
) -> dict[str, Float[Array, "_"]]:
    """Residuals by term with √ω applied: the energy is the sum of their squares."""
    omega = dict(zip(terms, jnp.asarray(omega), strict=True))
    return {name: jnp.sqrt(omega[name]) * _values(TABLE[name], errors, parameters, context) for name in terms}


@cache
def residual_of(name: str) -> Callable[..., Float[Array, "_"]]:
    """The residual of a term: of `LandmarkErrors`, or of parameters and context."""
    module, function = TABLE[name].residual.split(":")
    return getattr(import_module(f"workbench.energies.{module}"), function)


def _values(term: Term, errors: LandmarkErrors, parameters: FaceParameters, context: TermContext):
    residual = residual_of(term.name)
    return residual(errors) if term.of == "landmarks" else residual(parameters, context)


def residuals(
    problem: EnergyProblem,
    parameters: FaceParameters,
    free: tuple[str, ...],
    terms: tuple[str, ...] = FACE_IT_TERMS,
) -> dict[str, Float[Array, "_"]]:
    """Weighed residuals of every term that `free` parameters can change, for points on the mesh."""
    chosen = [k for k, name in enumerate(terms) if depends_on(TABLE[name], free)]
    errors = landmark_errors(problem.camera, problem.points, parameters, problem.observation)
    errors = errors._replace(weighted_edges=problem.context.constants.weighted_edges)
    omega = jnp.asarray(problem.omega)[np.array(chosen)]
    return weighed_residuals(tuple(terms[k] for k in chosen), omega, errors, parameters, problem.context)


def energy(
    problem: EnergyProblem,
    parameters: FaceParameters,
    free: tuple[str, ...],
    terms: tuple[str, ...] = FACE_IT_TERMS,
) -> Float[AnyArray, ""]:
    """E(γ), summed in the order of `normal_system`, so that both round alike."""
    found = residuals(problem, parameters, free, terms)
    data = found.pop("landmarks")
    return data @ data + sum(jnp.sum(part**2) for part in found.values())


def energy_by_term(
    problem: EnergyProblem,
    parameters: FaceParameters,
    free: tuple[str, ...],
    terms: tuple[str, ...] = FACE_IT_TERMS,
) -> Float[Array, "t"]:
    """Weighed energy of each of `terms`, zero for those that `free` parameters cannot change."""
    found = residuals(problem, parameters, free, terms)
    return jnp.stack([jnp.sum(found[name] ** 2) if name in found else jnp.zeros(()) for name in terms])


def normal_system(
    problem: EnergyProblem,
    parameters: FaceParameters,
    free: tuple[str, ...],
    terms: tuple[str, ...] = FACE_IT_TERMS,
) -> DenseSystem:
    """Cost, Jᵀr and JᵀJ of the whole energy, columns in the order of `free`.

    Terms on single unknowns only touch the diagonal, and single residuals are rank-one updates: adding them here
    instead of as Jacobian rows halves the arithmetic of an expression step. The former enter with their exact second
    derivative r'² + r·r'' where it is not negative, instead of Gauss–Newton's r'²: this costs nothing on a diagonal,
    and the smoothed L1 norm, which is all but straight, takes half as many steps.
    """
    omega = dict(zip(terms, jnp.asarray(problem.omega), strict=True))
    residual, jacobian = reprojection_with_jacobian(
        problem.camera, problem.points, parameters, problem.observation, free
    )
    cost = omega["landmarks"] * (residual @ residual)
    # Jᵀr is one more column of the same product.
    rows = jnp.concatenate([jacobian.T, residual[None]])
    product = omega["landmarks"] * (rows @ rows.T)
    gradient, matrix = product[:-1, -1], product[:-1, :-1]
    diagonal, others = jnp.zeros(len(gradient)), 0.0
    for name in terms:
        term, root = TABLE[name], jnp.sqrt(omega[name])
        if name == "landmarks" or not depends_on(term, free):
            continue
        if term.of == "parameters" and not any(len(getattr(parameters, unknown)) for unknown in term.unknowns):
            continue  # a model without blendshapes
        if term.of == "parameters" and term.structure != "dense":
            values, slopes, forces, bends = _on_unknowns(term, problem.context, parameters, free)
            values, slopes, forces = root * values, root * slopes, root * forces
            gradient = gradient + slopes * forces
            if term.structure == "diagonal":
                diagonal = diagonal + jnp.maximum(slopes * slopes + forces * (root * bends), 0.0)
            else:
                matrix = matrix + slopes[:, None] * slopes[None, :]
        else:
            of = _of_landmarks if term.of == "landmarks" else _of_parameters
            values, slopes = (root * part for part in of(term, problem, parameters, free))
            gradient, matrix = gradient + values @ slopes, matrix + slopes.T @ slopes
        others = others + jnp.sum(values**2)
    at = jnp.arange(len(gradient))
    # Not as a matrix: a sum of matrices would compute the diagonal again for each of its entries.
    matrix = matrix.at[at, at].add(diagonal, indices_are_sorted=True, unique_indices=True)
    return DenseSystem(cost + others, gradient, matrix)


def depends_on(term: Term, free: tuple[str, ...]) -> bool:
    """Whether a term changes with the free parameters."""
    return term.of == "landmarks" or bool(set(term.unknowns) & set(free))


def _on_unknowns(term: Term, context: TermContext, parameters: FaceParameters, free: tuple[str, ...]):
    """Residuals of a diagonal or single term, with its slope by each free parameter and the residual that goes with it;
    one forward or backward pass gives all slopes. Of a diagonal one the second derivatives too, else zeros."""
    blocks = tuple(name for name in term.unknowns if len(getattr(parameters, name)))
    vector = pack(parameters, blocks)

    def residual(vector):
        return residual_of(term.name)(unpack(vector, parameters, blocks), context)

    def along(of, vector):
        return jax.jvp(of, (vector,), (jnp.ones_like(vector),))

    if term.structure == "diagonal":
        (values, slopes), (_, bends) = along(partial(along, residual), vector)
        forces = values
    else:
        values, pull = jax.vjp(residual, vector)
        (slopes,) = pull(jnp.ones_like(values))
        forces, bends = jnp.broadcast_to(values, slopes.shape), jnp.zeros_like(slopes)
    return values, *(_spread(part, blocks, parameters, free) for part in (slopes, forces, bends))


def _spread(entries, blocks: tuple[str, ...], parameters: FaceParameters, free: tuple[str, ...]):
    """Entries by block as a vector over the free parameters, 0 for the other ones."""
    places = slots(parameters, blocks)
    return jnp.concatenate(
        [entries[places[name]] if name in places else jnp.zeros(len(getattr(parameters, name))) for name in free]
    )


def _of_landmarks(term: Term, problem: EnergyProblem, parameters: FaceParameters, free: tuple[str, ...]):
    """Residuals and derivative of a term on the landmarks' errors, through the derivative of the errors in pixels."""
    observation = problem.observation
    plain = Observation(observation.points, jnp.ones(len(observation.weights)), jnp.ones(()))
    error, by_unknown = reprojection_with_jacobian(problem.camera, problem.points, parameters, plain, free)

    def residual(error):
        errors = counted_errors(error.reshape(-1, 2), observation)
        return residual_of(term.name)(errors._replace(weighted_edges=problem.context.constants.weighted_edges))

    values, push = jax.linearize(residual, error)
    return values, jax.vmap(push, in_axes=1, out_axes=1)(by_unknown)


def _of_parameters(term: Term, problem: EnergyProblem, parameters: FaceParameters, free: tuple[str, ...]):
    """Residuals and derivative of any term on the parameters."""

    def residual(vector):
        return residual_of(term.name)(unpack(vector, parameters, free), problem.context)

    vector = pack(parameters, free)
    return residual(vector), jax.jacfwd(residual)(vector)
