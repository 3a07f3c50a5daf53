"""One frame from the flow to its neighbours: pose, weights and jaw by robust Levenberg–Marquardt, compiled once.

Free parameters, weights, bounds, targets and cameras are data. Only another number of surface points, views or
blendshapes triggers recompilation.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from workbench.arrays import AnyArray, Count, Scalar
from workbench.energies.flow import FlowWeights, flow_distances, flow_residuals, robust_scales
from workbench.energies.flow_link import FlowTargets, FlowView
from workbench.face import FaceParameters, pack, unpack
from workbench.flow import SurfacePoints
from workbench.runtime import SMALL_ARRAYS
from workbench.solvers import LevenbergMarquardt, minimise, normal_equations

MOVING = ("rotation", "translation", "expression", "jaw")
"""The parameters estimated from flow; identity and scale are held."""
REWEIGHTINGS = 3
"""Number of reweighted least-squares solves, each with robust weights from the previous result."""


class FlowLimits(NamedTuple):
    """Bounds of the unknowns and limits of the iterations."""

    lower: Float[AnyArray, "n"]
    """Lower bound of each of the `MOVING` unknowns; equal to `upper` if it is held."""
    upper: Float[AnyArray, "n"]
    iterations: Count
    """Limit for each reweighted least-squares solve."""
    tolerance: Scalar


class FlowSolution(NamedTuple):
    """A frame placed by flow."""

    parameters: FaceParameters
    energies: Float[Array, "2"]
    """Energy Σr² of the flow (with robust weights) and of the prior."""
    missed: Float[Array, ""]
    """Weighted mean distance of the points from their targets, percent of the eye distance."""
    status: Int[Array, ""]
    iterations: Int[Array, ""]


@partial(jax.jit, compiler_options=SMALL_ARRAYS)
def solve_flow(
    points: SurfacePoints,
    views: FlowView,
    targets: FlowTargets,
    weights: FlowWeights,
    start: FaceParameters,
    prior: FaceParameters,
    limits: FlowLimits,
) -> FlowSolution:
    """The frame whose points lie closest to the targets from neighbours and flow, near the prior."""

    def terms(vector, scales):
        return flow_residuals(points, views, targets, weights, scales, unpack(vector, start, MOVING), prior)

    def least_squares(carry, _):
        vector, scales = carry

        def residual(vector):
            return jnp.concatenate(list(terms(vector, scales).values())).astype(float)

        def evaluate(vector):
            return normal_equations(residual(vector), jax.jacfwd(residual)(vector))

        found = minimise(
            LevenbergMarquardt(),
            evaluate,
            vector,
            limits.lower,
            limits.upper,
            limits.iterations,
            limits.tolerance,
            cost=lambda vector: jnp.sum(residual(vector) ** 2),
        )
        missed = flow_distances(points, views, targets, unpack(found.x, start, MOVING))
        return (found.x, robust_scales(missed, weights.robust)), (found.status, found.iterations)

    vector = jnp.clip(pack(start, MOVING), limits.lower, limits.upper)
    missed = flow_distances(points, views, targets, unpack(vector, start, MOVING))
    first = (vector, robust_scales(missed, weights.robust))
    (vector, scales), (status, iterations) = jax.lax.scan(least_squares, first, None, length=REWEIGHTINGS)
    result = unpack(vector, start, MOVING)
    energies = jnp.stack([jnp.sum(part**2) for part in terms(vector, scales).values()])
    missed = jnp.linalg.norm(flow_distances(points, views, targets, result), axis=-1)
    counted = targets.weights * scales**2
    mean = (missed * counted).sum() / jnp.maximum(counted.sum(), 1e-9)
    return FlowSolution(result, energies, mean, status[-1], iterations.sum())
