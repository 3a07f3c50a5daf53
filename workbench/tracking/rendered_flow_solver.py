"""One frame by the flow energy of Deep Energies Secs. 6 and 7, with the flow network on photos and renders alike.

Dogleg on ‖N(F₁*, F₂*) − N(F₁, F₂)‖² and its like, with the derivative taken through network and renderer. As in
`flow_solver`, residuals are in percent of the outer-eye distance and may be weighted robustly, and priors may hold a
frame.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from workbench.arrays import AnyArray
from workbench.energies.flow import LANDMARKS, FlowWeights, robust_scales, stay_residual
from workbench.face import FaceParameters, pack, typical_sizes, unpack
from workbench.face.jaw_unit import JawUnit
from workbench.flow import FlowModel
from workbench.rendering import RenderModel
from workbench.runtime import COMPUTING
from workbench.solvers import Status, TrustRegion, init, judge, normal_equations, propose
from workbench.tracking.deep_programs import CHUNK
from workbench.tracking.flow_renders import RenderedView
from workbench.tracking.flow_solver import MOVING, FlowLimits, FlowSolution
from workbench.tracking.rendered_flow import Moves, look_at, rendered_derivative, seen_flow, seen_flow_derivative

SMALLEST_RADIUS = 1e-2
"""Fraction of a Gauss–Newton step below which a solve stops, because the flow of renders is not smooth below it."""


@dataclass(frozen=True, eq=False)
class RenderedPair:
    """Two renders, one of a frame that is known."""

    moves: Moves
    """Whether the frame that is solved comes first or second."""
    known: tuple[Float[AnyArray, "s s 3"], ...]
    """The other frame's render in each view."""


@dataclass(frozen=True, eq=False)
class FlowDifference:
    """One term of the energy: ‖Σ factorₖ·N(pair k) − target‖²."""

    factors: tuple[float, ...]
    """One for each pair of the problem: (1, −1) in self flow."""
    target: Float[np.ndarray, "views m m 2"]
    """The flow of the photos, pixels of the cut-outs; 0 in self flow."""
    weights: Float[np.ndarray, "views m m"]
    """0 where no face is shown."""


@dataclass(frozen=True, eq=False)
class RenderedFlowProblem:
    """The energy of one frame."""

    network: FlowModel
    side: int
    """Size in pixels of what the network sees."""
    model: RenderModel
    views: tuple[RenderedView, ...]
    pairs: tuple[RenderedPair, ...]
    differences: tuple[FlowDifference, ...]
    unit_px: Float[np.ndarray, "views"]
    """One percent of the outer-eye distance in each cut-out."""
    weights: FlowWeights
    prior: FaceParameters
    limits: FlowLimits

    @property
    def pixels(self) -> int:
        """Size of the cut-outs."""
        return self.pairs[0].known[0].shape[0]

    @property
    def jaw_unit(self) -> JawUnit:
        """The face model's."""
        return self.model.jaw.unit


def solve_rendered_flow(
    problem: RenderedFlowProblem, start: FaceParameters, cancelled: Callable[[], bool] = lambda: False
) -> FlowSolution:
    """Up to `limits.iterations` dogleg steps from `start`; each takes one derivative through renderer and network."""
    limits, sizes = problem.limits, typical_sizes(start, MOVING, problem.jaw_unit)
    lower, upper = np.asarray(limits.lower), np.asarray(limits.upper)
    columns = np.flatnonzero(lower < upper)
    vector = np.clip(np.asarray(pack(start, MOVING)), lower, upper)
    method = TrustRegion(sizes, smallest=SMALLEST_RADIUS, largest=1.0)
    flows = flows_at(problem, unpack(vector, start, MOVING))
    if not len(columns):
        return _solution(problem, unpack(vector, start, MOVING), flows, Status.CONVERGED, 0)
    state, system, count = init(method, vector, 0.0), None, 0
    while int(state.status) == Status.RUNNING and count < int(limits.iterations) and not cancelled():
        if system is None:
            here = unpack(np.asarray(state.x), start, MOVING)
            # Robust weights are those of the place that a step starts from.
            scales = [robust_scales(missed, problem.weights.robust) for missed in differences_of(problem, flows)]
            jacobian = np.concatenate([_flow_jacobian(problem, here, columns, scales), _prior_jacobian(problem, here)])
            system = normal_equations(_residual(problem, here, flows, scales), jacobian)
        candidate, move = propose(method, system, state, lower, upper)
        tried = unpack(np.asarray(candidate), start, MOVING)
        tried_flows = flows_at(problem, tried)
        residual = _residual(problem, tried, tried_flows, scales)
        state = judge(method, system, state, candidate, move, residual @ residual, limits.tolerance)
        count += 1
        if state.accepted:
            flows, system = tried_flows, None
    return _solution(problem, unpack(np.asarray(state.x), start, MOVING), flows, int(state.status), count)


def flows_at(problem: RenderedFlowProblem, parameters: FaceParameters) -> Float[np.ndarray, "pairs views m m 2"]:
    """N of every pair in every view with the frame at these parameters, pixels of the cut-outs."""
    side, flows = problem.side, np.empty((len(problem.pairs), len(problem.views)), object)
    for v, view in enumerate(problem.views):
        with COMPUTING:
            here = look_at(problem.model, view, parameters, problem.pixels)
            for p, pair in enumerate(problem.pairs):
                flows[p, v] = seen_flow(problem.network, pair.known[v], here, moves=pair.moves, side=side)
    return np.array([[np.asarray(flow) for flow in row] for row in flows], float)


def differences_of(
    problem: RenderedFlowProblem, flows: Float[np.ndarray, "pairs views m m 2"]
) -> list[Float[np.ndarray, "views m m 2"]]:
    """Each difference of flows, percent of the outer-eye distance."""
    unit = problem.unit_px[:, None, None, None]
    return [(np.tensordot(one.factors, flows, axes=1) - one.target) / unit for one in problem.differences]


def flow_residual(
    problem: RenderedFlowProblem,
    flows: Float[np.ndarray, "pairs views m m 2"],
    scales: list[Float[AnyArray, "views m m"]],
) -> Float[np.ndarray, "n"]:
    """The flow's residuals with their weights; the face counts as 68 landmarks in each view, however large it is."""
    missed = differences_of(problem, flows)
    return np.concatenate(
        [(part * share[..., None]).ravel() for part, share in zip(missed, _shares(problem, scales), strict=True)]
    )


def _shares(problem: RenderedFlowProblem, scales) -> list[Float[np.ndarray, "views m m"]]:
    shares = []
    for one, scale in zip(problem.differences, scales, strict=True):
        shown = np.maximum(one.weights.sum(axis=(1, 2), keepdims=True), 1.0)
        shares.append(np.sqrt(problem.weights.flow * LANDMARKS / shown * one.weights) * np.asarray(scale))
    return shares


def _flow_jacobian(problem: RenderedFlowProblem, parameters: FaceParameters, columns, scales):
    """Derivative of `flow_residual` by the unknowns, taken for `columns` alone; scales are constant in it."""
    derivative = flow_derivative(problem, parameters, columns)
    sizes = typical_sizes(parameters, MOVING, problem.jaw_unit)
    unit = problem.unit_px[:, None, None, None]
    parts = []
    for one, share in zip(problem.differences, _shares(problem, scales), strict=True):
        moved = np.einsum("p,cpvijd->cvijd", one.factors, derivative) / unit * share[..., None]
        parts.append(moved.reshape(len(columns), -1))
    jacobian = np.zeros((sum(part.shape[1] for part in parts), len(sizes)))
    jacobian[:, columns] = np.concatenate(parts, axis=1).T / sizes[columns]
    return jacobian


def flow_derivative(
    problem: RenderedFlowProblem, parameters: FaceParameters, columns: Int[np.ndarray, "c"]
) -> Float[np.ndarray, "c pairs views m m 2"]:
    """Derivative of `flows_at` by some of the scaled unknowns."""
    padded = np.full(-(-len(columns) // CHUNK) * CHUNK, -1)
    padded[: len(columns)] = columns
    views = []
    for v, view in enumerate(problem.views):
        with COMPUTING:
            here = look_at(problem.model, view, parameters, problem.pixels)
            chunks = [_chunk_derivative(problem, v, here, parameters, chunk) for chunk in padded.reshape(-1, CHUNK)]
        views.append(np.concatenate(chunks)[: len(columns)])
    return np.stack(views, axis=2).astype(float)


def _chunk_derivative(problem: RenderedFlowProblem, v: int, here, parameters: FaceParameters, chunk):
    """Derivative of the flows in one view, whose render is `here`."""
    view = problem.views[v]
    changes = rendered_derivative(problem.model, view, parameters, chunk, pixels=problem.pixels).astype(here.dtype)
    flows = [
        seen_flow_derivative(problem.network, pair.known[v], here, changes, moves=pair.moves, side=problem.side)
        for pair in problem.pairs
    ]
    return np.stack([np.asarray(flow) for flow in flows], axis=1)


def _residual(problem: RenderedFlowProblem, parameters: FaceParameters, flows, scales) -> Float[np.ndarray, "n"]:
    return np.concatenate([flow_residual(problem, flows, scales), _prior_residual(problem, parameters)])


def _prior_residual(problem: RenderedFlowProblem, parameters: FaceParameters) -> Float[np.ndarray, "k"]:
    vector = pack(parameters, MOVING)
    return np.asarray(_priors(vector, parameters, problem.prior, problem.weights, problem.jaw_unit), float)


def _prior_jacobian(problem: RenderedFlowProblem, parameters: FaceParameters) -> Float[np.ndarray, "k n"]:
    vector = pack(parameters, MOVING)
    return np.asarray(_priors_derivative(vector, parameters, problem.prior, problem.weights, problem.jaw_unit), float)


@jax.jit
def _priors(
    vector, parameters: FaceParameters, prior: FaceParameters, weights: FlowWeights, jaw_unit: JawUnit
) -> Float[Array, "k"]:
    return stay_residual(unpack(vector, parameters, MOVING), prior, weights, jaw_unit)


_priors_derivative = jax.jit(jax.jacfwd(_priors))


def _solution(problem, parameters: FaceParameters, flows, status: int, count: int) -> FlowSolution:
    missed = differences_of(problem, flows)
    scales = [robust_scales(part, problem.weights.robust) for part in missed]
    of_flow, of_prior = flow_residual(problem, flows, scales), _prior_residual(problem, parameters)
    lengths = np.stack([np.linalg.norm(part, axis=-1) for part in missed])
    counted = np.stack([one.weights for one in problem.differences]) * np.square(scales)
    # Below the smallest radius nothing is left to gain.
    ends = {Status.RUNNING: Status.ITERATION_LIMIT, Status.STALLED: Status.CONVERGED}
    return FlowSolution(
        parameters,
        np.array([of_flow @ of_flow, of_prior @ of_prior]),
        np.asarray((lengths * counted).sum() / max(counted.sum(), 1e-9)),
        np.asarray(ends.get(Status(status), Status(status)).value),
        np.asarray(count),
    )
