"""How well landmarks and priors determine pose and weights: the posterior of the problem linearised at the fit."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from workbench.config import Config
from workbench.diagnosis.records import Uncertainty
from workbench.energies import TABLE, normal_system, reprojection_with_jacobian, stage_factors
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, LandmarkModel, landmark_model
from workbench.geometry import Camera, rotation_matrix
from workbench.planning import plan_of
from workbench.runtime import COMPUTING, SMALL_ARRAYS
from workbench.tracking import FrameContext, FrameFit
from workbench.tracking.face_it_solution import solve_settings
from workbench.tracking.frame_solver import FrameInput, SolveSettings, stage_problem

FREE = ("rotation", "translation", "expression")
POSE_NAMES = ("pitch", "yaw", "roll", "x", "y", "depth")
"""Rotations about the camera's x, y, z axes and positions along them."""
WEIGHT_WIDTH = 0.5
"""Prior standard deviation of a weight that is kept in its range, as a share of that range."""
STRONG = 0.9
UNKNOWN_SCALE = np.array([0.1] * 3 + [10.0] * 3)
"""Typical size of the pose's unknowns, radians and millimetres; for a weight it is 0.3."""
WEIGHT_SCALE = 0.3
BOUND = 1e-9
RANK = 1e-12
"""Eigenvalues of the scaled precision below this fraction of the largest count as zero: undetermined directions."""


class Linearised(NamedTuple):
    """The least-squares problem around a fit, with all unknowns of a frame free."""

    residual: Float[np.ndarray, "m"]
    """Data residual, percent of the outer-eye distance, with landmark weights applied."""
    jacobian: Float[np.ndarray, "m n"]
    """Its derivative by rotation (axis-angle), translation and weights."""
    matrix: Float[np.ndarray, "n n"]
    """Half the energy's second derivative as the solver has it (`energies.normal_system`), in the energy's unit."""
    gradient: Float[np.ndarray, "n"]
    data_factor: float
    """ω_sparse · ω_fit."""
    unit: float
    """Size of one unit of the residual, % of the outer-eye distance."""
    row_weights: Float[np.ndarray, "m"]
    """Weight of each coordinate: landmark weight times what the detection counts."""


def linearise(model: FaceModel, config: Config, context: FrameContext, fit: FrameFit) -> Linearised:
    """The problem of a fit with pose and expression both free, and landmarks weighted as in the last stage.

    Raises `InputError` for a frame without a face.
    """
    if not fit.found:
        raise InputError(f"Frame {fit.index} has no landmarks; choose a frame with a face to estimate uncertainty.")
    stage = config.running(start=context.last is None)[-1]
    scheme = model.scheme
    weights = np.multiply(stage.landmark_weights(config.subsets, scheme), config.point_weights(scheme))
    # A fit does not hold the pictures that the flow term would need.
    terms = tuple(name for name in config.terms if not TABLE[name].compares_pictures)
    factors = stage_factors(config.omega(), config.system, FREE, stage.terms, terms)
    personal = landmark_model(model).personal(np.asarray(fit.identity))
    last = context.last
    zero = np.zeros(6)
    plan = plan_of(config, scheme)
    counts, whitening = (plan.counts(fit.confidence), None) if fit.landmarks is None else plan.measured(fit.landmarks)
    parameters = FaceParameters(fit.rotation, fit.translation, fit.expression, np.zeros(0))
    before = context.start if last is None else last.parameters
    expression = np.zeros(len(fit.expression)) if before is None else np.asarray(before.expression)
    start = parameters._replace(expression=expression)
    frame = FrameInput(
        np.column_stack([fit.observed, counts]),
        zero if last is None else np.asarray(last.pose),
        zero if last is None else np.asarray(last.last_pose),
        np.asarray(float(last is not None and last.frames >= 2)),
        start,
        whitening=whitening,
    )
    settings = solve_settings(plan)
    arrays = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), (fit.camera, personal, settings))
    with COMPUTING:
        residual, jacobian, matrix, gradient, unit = _linearised(
            *arrays, jnp.asarray(weights), jnp.asarray(factors), frame, parameters, terms
        )
    percent = 1.0 if config.solver.unit == "percent" else float(unit)
    if whitening is not None:
        percent = float(unit) * float(np.median(np.linalg.det(whitening) ** -0.5))
    return Linearised(
        *(np.asarray(part) for part in (residual, jacobian, matrix, gradient)),
        data_factor=factors[terms.index("landmarks")],
        unit=percent,
        row_weights=np.repeat(weights * counts, 2),
    )


@partial(jax.jit, static_argnames="terms", compiler_options=SMALL_ARRAYS)
def _linearised(
    camera: Camera,
    model: LandmarkModel,
    settings: SolveSettings,
    weights: Float[jax.Array, "points"],
    omega: Float[jax.Array, "t"],
    frame: FrameInput,
    parameters: FaceParameters,
    terms: tuple[str, ...],
):
    problem = stage_problem(camera, model, settings, weights, omega, frame, parameters)
    residual, jacobian = reprojection_with_jacobian(camera, problem.points, parameters, problem.observation, FREE)
    system = normal_system(problem, parameters, FREE, terms)
    # One pixel in percent of the eye distance, for residuals in pixels.
    eye = jnp.linalg.norm(problem.points.neutral[45] - problem.points.neutral[36])
    eye_px = jnp.mean(camera.focal_px) * eye / parameters.translation[2]
    return residual, jacobian, system.matrix, system.gradient, 100.0 / eye_px


def estimate_uncertainty(model: FaceModel, config: Config, context: FrameContext, fit: FrameFit) -> Uncertainty:
    """Posterior covariance of pose and weights: σ²·H⁻¹ of data and priors, σ² from the data residual.

    H is JᵀJ, of terms on single unknowns half the whole second derivative (`energies.normal_system`).

    Weights that the energy presses against a bound are held there. Where weights are kept in the model's range, that is
    part of the prior. Raises `InputError` for a frame without a face.
    """
    problem = linearise(model, config, context, fit)
    held = _held(config, fit, problem.gradient, model.weight_range())
    free = np.concatenate([np.ones(6, bool), ~held])
    # A residual with less weight says less about the noise, so rows are counted by their weight.
    rows = problem.row_weights
    count = float(rows.sum())
    spent = free.sum() * count / max(np.count_nonzero(rows), 1)
    degrees_of_freedom = max(count - spent, count / 4.0, 1e-3)
    variance = max(problem.data_factor * float(problem.residual @ problem.residual) / degrees_of_freedom, 1e-12)
    prior = np.zeros(len(free))
    if config.solver.bounded:
        # A weight without a range is held, and has no use for a prior.
        span = np.diff(model.weight_range(), axis=1)[:, 0]
        prior[6:] = np.where(span > 0.0, span * WEIGHT_WIDTH, 1.0) ** -2
    precision = problem.matrix / variance + np.diag(prior)
    covariance, condition = inverse_on(precision, free)
    weighted = problem.jacobian.T @ (rows[:, None] * problem.jacobian)
    scatter = covariance @ (problem.data_factor / variance * weighted) @ covariance
    to_axes = np.eye(len(free))
    to_axes[:3, :3] = _left_jacobian(np.asarray(fit.rotation))
    about_axes = to_axes @ covariance @ to_axes.T
    deviations = np.sqrt(np.maximum(np.diagonal(about_axes), 0.0))
    names = (*POSE_NAMES, *model.expression_names)
    return Uncertainty(
        names=names,
        covariance=covariance,
        scatter=scatter,
        noise_percent=float(np.sqrt(variance / max(problem.data_factor, 1e-12))) * problem.unit,
        rotation_deg=np.degrees(deviations[:3]),
        translation_mm=deviations[3:6],
        weights=deviations[6:],
        on_bound=held,
        condition=condition,
        pairs=correlated_pairs(about_axes, names),
    )


def inverse_on(
    precision: Float[np.ndarray, "n n"], free: Bool[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "n n"], float]:
    """Inverse over the free unknowns (zero elsewhere), and the condition number in units of typical size.

    Undetermined combinations get the variance of their typical size instead of an infinite one.
    """
    scale = np.concatenate([UNKNOWN_SCALE, np.full(len(free) - 6, WEIGHT_SCALE)])[free]
    scaled = precision[np.ix_(free, free)] * scale[:, None] * scale[None, :]
    values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
    condition = float(values[-1] / values[0]) if values[0] > 0.0 else np.inf
    values = np.where(values > RANK * values[-1], values, np.maximum(1.0, RANK * values[-1]))
    covariance = np.zeros(precision.shape)
    covariance[np.ix_(free, free)] = (vectors / values) @ vectors.T * scale[:, None] * scale[None, :]
    return covariance, condition


def correlated_pairs(
    covariance: Float[np.ndarray, "n n"], names: tuple[str, ...], strong: float = STRONG
) -> tuple[tuple[str, str, float], ...]:
    """Pairs of unknowns whose absolute correlation exceeds `strong`, strongest first."""
    deviations = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    known = deviations > 0.0
    safe = np.where(known, deviations, 1.0)
    correlation = np.where(known[:, None] & known[None, :], covariance / safe[:, None] / safe[None, :], 0.0)
    rows, columns = np.nonzero(np.triu(np.abs(correlation) > strong, 1))
    found = [(names[i], names[j], float(correlation[i, j])) for i, j in zip(rows, columns, strict=True)]
    return tuple(sorted(found, key=lambda pair: -abs(pair[2])))


def vertex_uncertainty(
    model: FaceModel, uncertainty: Uncertainty, fit: FrameFit, pose: bool = False
) -> Float[np.ndarray, "v"]:
    """Standard deviation of each vertex's position in millimetres (root of the summed variances of x, y, z).

    For the shape in the head frame, or with `pose` for the position in the camera frame, where depth dominates.
    """
    person = model.personal(np.asarray(fit.identity))
    covariance = uncertainty.covariance if pose else uncertainty.covariance[6:, 6:]
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    kept = values > 1e-12 * max(values[-1], 1e-300)
    shapes = np.moveaxis(person.expression_deltas, 0, 2)
    if not pose:
        return np.sqrt(((shapes @ root[:, kept]) ** 2).sum(axis=(1, 2)))
    vertices = person.vertices(fit.expression)
    rotation = np.asarray(rotation_matrix(jnp.asarray(fit.rotation)))
    turned = np.einsum("abk,vb->vak", np.asarray(jax.jacfwd(rotation_matrix)(jnp.asarray(fit.rotation))), vertices)
    shifted = np.broadcast_to(np.eye(3), (len(vertices), 3, 3))
    jacobian = np.concatenate([turned, shifted, np.einsum("ab,vbk->vak", rotation, shapes)], axis=2)
    return np.sqrt(((jacobian @ root[:, kept]) ** 2).sum(axis=(1, 2)))


def _held(
    config: Config, fit: FrameFit, gradient: Float[np.ndarray, "n"], bounds: Float[np.ndarray, "k 2"]
) -> Bool[np.ndarray, "k"]:
    """Weights that are at a bound and pressed against it."""
    if not config.solver.bounded:
        return np.zeros(len(fit.expression), bool)
    slope, (lower, upper) = gradient[6:], bounds.T
    at_lower, at_upper = fit.expression <= lower + BOUND, fit.expression >= upper - BOUND
    return (at_lower & (slope >= 0.0)) | (at_upper & (slope <= 0.0))


def _left_jacobian(rotation: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """∂ (rotation about the camera's axes) / ∂ (axis-angle): from R(r + dr) = exp(J·dr)·R(r)."""
    angle = float(np.linalg.norm(rotation))
    x, y, z = rotation
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-6:
        return np.eye(3) + 0.5 * cross
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.eye(3) + first * cross + second * cross @ cross
