"""Points on the mesh in the picture, against observed ones, with their derivative."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.energies.context import LandmarkErrors
from workbench.face.landmark_model import PointModel
from workbench.face.parameters import FaceParameters
from workbench.geometry import Camera, project, project_with_derivative, rotation_matrix


class Observation(NamedTuple):
    """Detected landmarks of one frame for the solver."""

    points: Float[AnyArray, "points 2"]
    """Pixels."""
    weights: Float[AnyArray, "points"]
    """Factor of each landmark's squared error; 0 takes it out."""
    unit_px: Float[AnyArray, ""]
    """Pixels that count as 1 in the residual (1 for pixels, 1 % of the eye distance for percent)."""
    whitening: Float[AnyArray, "points 2 2"] | None = None
    """Takes each point's error in pixels to one of unit variance, upper triangular (Wood et al. 2022): such errors
    count in standard deviations, not in `unit_px`. None: errors in every direction count alike."""


def points_head(model: PointModel, parameters: FaceParameters) -> Float[AnyArray, "points 3"]:
    """b_0 + B·w (+ identity) at the landmarks, head frame, millimetres."""
    points = model.neutral + jnp.tensordot(parameters.expression, model.expression, axes=1)
    if model.identity.shape[0]:
        points = points + jnp.tensordot(parameters.identity, model.identity, axes=1)
    return points


def project_landmarks(camera: Camera, model: PointModel, parameters: FaceParameters) -> Float[AnyArray, "points 2"]:
    """π(R·P_i + t) for all landmarks, pixels."""
    turned = _turned(points_head(model, parameters), rotation_matrix(parameters.rotation))
    return project(camera, turned + parameters.translation)


def landmark_errors(
    camera: Camera, model: PointModel, parameters: FaceParameters, observation: Observation
) -> LandmarkErrors:
    """π(R·P_i + t) − p_i in pixels, or whitened; what each counts, and the unit of residuals."""
    return counted_errors(project_landmarks(camera, model, parameters) - observation.points, observation)


def counted_errors(error_px: Float[AnyArray, "points 2"], observation: Observation) -> LandmarkErrors:
    """Errors in pixels as an observation counts them."""
    root, unit = jnp.sqrt(observation.weights), observation.unit_px
    if observation.whitening is None:
        return LandmarkErrors(error_px, root, unit)
    return LandmarkErrors(_whitened(observation.whitening, error_px), root, unwhitened=error_px / unit)


def reprojection_with_jacobian(
    camera: Camera,
    model: PointModel,
    parameters: FaceParameters,
    observation: Observation,
    free: tuple[str, ...],
) -> tuple[Float[AnyArray, "m"], Float[AnyArray, "m n"]]:
    """`landmark_residual` of these errors, and its derivative by the chain rule ∂π · ∂(R·P + t).

    Columns come in the order of `free`.

    Written out because automatic differentiation would push one tangent per weight through all of it.
    """
    rotation = rotation_matrix(parameters.rotation)
    points = points_head(model, parameters)
    points_camera = _turned(points, rotation) + parameters.translation
    pixels, derivative = project_with_derivative(camera, points_camera)
    scale = jnp.sqrt(observation.weights)
    error = pixels - observation.points
    if observation.whitening is None:
        scale = scale / observation.unit_px
    else:
        error, derivative = (_whitened(observation.whitening, part) for part in (error, derivative))
    residual = error * scale[:, None]
    by_camera = derivative * scale[:, None, None]
    by_head = by_camera @ rotation
    blocks = []
    for name in free:
        if name == "rotation":
            turned = jnp.einsum("abk,nb->kna", jax.jacfwd(rotation_matrix)(parameters.rotation), points)
            blocks.append(_chain(by_camera, turned))
        elif name == "translation":
            blocks.append(jnp.moveaxis(by_camera, -1, 0))
        else:
            blocks.append(_chain(by_head, getattr(model, name)))
    # A row per unknown, for the basis lies so in memory: JᵀJ takes half the time of a column per unknown.
    rows = jnp.concatenate(blocks).reshape(-1, residual.size)
    return residual.ravel(), rows.T


def _whitened(whitening: Float[AnyArray, "points 2 2"], error: Float[AnyArray, "points 2 *d"]):
    """W·e for every point, and W·∂e: W is upper triangular."""
    first, corner, second = (
        whitening[:, i, j].reshape(-1, *[1] * (error.ndim - 2)) for i, j in ((0, 0), (0, 1), (1, 1))
    )
    return jnp.stack([first * error[:, 0] + corner * error[:, 1], second * error[:, 1]], axis=1)


def _turned(points: Float[AnyArray, "points 3"], rotation: Float[AnyArray, "3 3"]) -> Float[AnyArray, "points 3"]:
    # R·P_i by columns of R, for the same reason as in `_chain`.
    return sum(points[:, axis, None] * rotation[:, axis] for axis in range(3))


def _chain(outer: Float[AnyArray, "points 2 3"], inner: Float[AnyArray, "n points 3"]) -> Float[AnyArray, "n points 2"]:
    # Three multiply-adds fuse into one loop; as a batched product of matrices it is several times slower on a CPU.
    return sum(outer[None, :, :, axis] * inner[:, :, None, axis] for axis in range(3))
