"""The whole energy E(γ) (FACE IT! Eqs. 5–7) for one set of free parameters: as residuals, by term, and as normal
equations."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray, Scalar
from workbench.energies.priors import (
    beta_residual,
    beta_slope,
    identity_residual,
    range_residual,
    range_slope,
    sigma_residual,
    sigma_smooth_residual,
    sigma_smooth_slope,
)
from workbench.energies.reprojection import Observation, reprojection_residual, reprojection_with_jacobian
from workbench.energies.temporal import tau_residual, tau_scale
from workbench.energies.weights import EnergyConstants, EnergyWeights
from workbench.face.landmark_model import PointModel
from workbench.face.parameters import FaceParameters
from workbench.geometry import Camera
from workbench.solvers import DenseSystem

TERMS = ("data", "tau", "beta", "sigma", "sigma_smooth", "range", "identity")
"""Terms in the order of their residuals. `data` is E_pose or E_fit, by what is free."""


class EnergyProblem(NamedTuple):
    """All that the energy of one frame depends on, besides the parameters."""

    camera: Camera
    points: PointModel
    observation: Observation
    weights: EnergyWeights
    constants: EnergyConstants
    before_last_pose: Float[AnyArray, "6"]
    last_pose: Float[AnyArray, "6"]
    history: Float[AnyArray, ""]
    """1 where the two poses before exist, else 0: no E_τ on the first two frames of a shot."""


def data_weight(weights: EnergyWeights, free: tuple[str, ...]) -> Scalar:
    """Factor of the reprojection term: ω_sparse·ω_pose while only the pose is free, else ω_sparse·ω_fit."""
    return weights.sparse * (weights.pose if is_pose_only(free) else weights.fit)


def is_pose_only(free: tuple[str, ...]) -> bool:
    """Whether nothing but the rigid pose is free."""
    return not {"expression", "identity"} & set(free)


def residuals(problem: EnergyProblem, parameters: FaceParameters, free: tuple[str, ...]) -> dict[str, AnyArray]:
    """Residuals of every term that `free` parameters can change, weights applied; E is the sum of their squares."""
    weights, constants, w = problem.weights, problem.constants, parameters.expression
    data = reprojection_residual(problem.camera, problem.points, parameters, problem.observation)
    found = {"data": jnp.sqrt(data_weight(weights, free)) * data}
    prior = weights.prior
    if {"rotation", "translation"} & set(free):
        pose = jnp.concatenate([parameters.rotation, parameters.translation])
        tau = tau_residual(problem.before_last_pose, problem.last_pose, pose, constants.rotation_mm)
        found["tau"] = jnp.sqrt(prior * weights.tau) * problem.history * tau
    if "expression" in free:
        found["beta"] = jnp.sqrt(prior * weights.beta) * beta_residual(w, constants)
        found["sigma"] = jnp.sqrt(prior * weights.sigma) * sigma_residual(w)
        found["sigma_smooth"] = jnp.sqrt(prior * weights.sigma_smooth) * sigma_smooth_residual(w, constants.delta)
        found["range"] = jnp.sqrt(prior * weights.range) * range_residual(w)
    if "identity" in free:
        found["identity"] = jnp.sqrt(prior * weights.identity) * identity_residual(parameters.identity)
    return found


def energy(problem: EnergyProblem, parameters: FaceParameters, free: tuple[str, ...]) -> Float[AnyArray, ""]:
    """E(γ), summed in the order of `normal_system`, so that both round alike."""
    found = residuals(problem, parameters, free)
    data = found.pop("data")
    return data @ data + sum(jnp.sum(part**2) for part in found.values())


def energy_by_term(problem: EnergyProblem, parameters: FaceParameters, free: tuple[str, ...]) -> Float[AnyArray, "7"]:
    """Weighted energy of each of `TERMS`, zero for terms that `free` parameters cannot change."""
    found = residuals(problem, parameters, free)
    return jnp.stack([jnp.sum(found[term] ** 2) if term in found else jnp.zeros(()) for term in TERMS])


def normal_system(problem: EnergyProblem, parameters: FaceParameters, free: tuple[str, ...]) -> DenseSystem:
    """Cost, Jᵀr and JᵀJ of the whole energy, columns in the order of `free`.

    Terms on single unknowns only touch the diagonal, and the paper's single residuals are rank-one updates; adding
    them here instead of as Jacobian rows halves the arithmetic of an expression step.
    """
    weights, constants, w = problem.weights, problem.constants, parameters.expression
    residual, jacobian = reprojection_with_jacobian(
        problem.camera, problem.points, parameters, problem.observation, free
    )
    factor = data_weight(weights, free)
    cost = factor * (residual @ residual)
    gradient = factor * (residual @ jacobian)
    matrix = factor * (jacobian.T @ jacobian)
    others = residuals(problem, parameters, free)
    slots = _slots(parameters, free)
    diagonal, gradients = [], []
    for name in free:
        size = slots[name].stop - slots[name].start
        if name in ("rotation", "translation"):
            part = slice(0, 3) if name == "rotation" else slice(3, 6)
            slope = jnp.sqrt(weights.prior * weights.tau) * problem.history * tau_scale(constants.rotation_mm)[part]
            diagonal.append(slope * slope)
            gradients.append(slope * others["tau"][part])
        elif name == "expression":
            smooth = jnp.sqrt(weights.prior * weights.sigma_smooth) * sigma_smooth_slope(w, constants.delta)
            outside = jnp.sqrt(weights.prior * weights.range) * range_slope(w)
            beta = jnp.sqrt(weights.prior * weights.beta) * beta_slope(w, constants)
            sigma = jnp.sqrt(weights.prior * weights.sigma) * jnp.sign(w)
            diagonal.append(smooth * smooth + outside * outside)
            gradients.append(
                smooth * others["sigma_smooth"] + outside * others["range"] + beta * others["beta"]
                + sigma * others["sigma"]
            )  # fmt: skip
            rank_two = beta[:, None] * beta[None, :] + sigma[:, None] * sigma[None, :]
            slot = slots[name]
            matrix = rank_two + matrix if len(free) == 1 else matrix.at[slot, slot].add(rank_two)
        else:
            diagonal.append(jnp.full(size, 1.0) * weights.prior * weights.identity)
            gradients.append(jnp.sqrt(weights.prior * weights.identity) * others["identity"])
    cost = cost + sum(jnp.sum(others[term] ** 2) for term in others if term != "data")
    return DenseSystem(cost, gradient + jnp.concatenate(gradients), matrix + jnp.diag(jnp.concatenate(diagonal)))


def pack(parameters: FaceParameters, free: tuple[str, ...]) -> Float[AnyArray, "n"]:
    """The free parameters as one vector."""
    return jnp.concatenate([getattr(parameters, name) for name in free])


def unpack(vector: Float[AnyArray, "n"], parameters: FaceParameters, free: tuple[str, ...]) -> FaceParameters:
    """`parameters` with the free ones replaced by the entries of `vector`."""
    slots = _slots(parameters, free)
    return parameters._replace(**{name: vector[slot] for name, slot in slots.items()})


def _slots(parameters: FaceParameters, free: tuple[str, ...]) -> dict[str, slice]:
    slots, start = {}, 0
    for name in free:
        size = len(getattr(parameters, name))
        slots[name] = slice(start, start + size)
        start += size
    return slots
