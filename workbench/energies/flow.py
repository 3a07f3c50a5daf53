"""Flow energies (Deep Energies Sec. 6 and 7): the motion of the rendered face should be that of the photographed one.

A neighbouring frame whose parameters are known gives every visible point of the face a place in its picture, and the
flow from there to the frame a place in the frame. ‖N(F*₁, F*₂) − N(F₁, F₂)‖ at these points is the distance of the
face's points from these places. N(F₁, F₂) is the exact flow of the moving mesh, or that plus what an estimator says
beside it on the rendered pair (`bias_px`): then the same estimator is on both sides, as in the paper. The paper also
takes the estimator's derivative; here `bias_px` is a constant, and the derivative is the mesh's.

Infill and refinement solve on `flow_residuals`. As a term of any stage it is `flow_residual`, with the frame before as
the only neighbour.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from workbench.arrays import AnyArray, Scalar
from workbench.energies.context import TermContext, still
from workbench.energies.flow_link import FlowTargets, FlowView
from workbench.energies.stay import expression_residual, pose_residual
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters
from workbench.face.jaw_unit import JawUnit
from workbench.flow import SurfacePoints, points_in_camera
from workbench.geometry import Camera, project
from workbench.landmarks.scheme import POINT_COUNT

LANDMARKS = 68.0
"""All points of a view count as so many landmarks, however many they are."""
NEAR_FACE_MM = 30.0
"""Surface farther from every landmark (ears, neck, crown) carries no point."""
DENSE_MM, DENSER = 12.0, 6.0
"""About eyes and mouth, within this distance, points lie this many times as dense: small parts that move much."""
FACE_REGIONS = ("skin", "lips", "brow")
NEARLY_ZERO = 1e-6
"""Square below which a series replaces √(log(1 + s) / s), which has no derivative at 0."""


class FlowWeights(NamedTuple):
    """Weights of the terms; a residual is in percent of the outer-eye distance."""

    flow: Scalar
    stay: Scalar
    """Of the squared distance of blendshapes and jaw from where the prior has them."""
    stay_pose: Scalar
    """Of that of the pose; one radian counts as 100 mm."""
    robust: Scalar
    """Residual from which a point counts less and less, percent (Cauchy); infinite: plain least squares."""


def points_in_views(
    points: SurfacePoints, views: FlowView, parameters: FaceParameters
) -> tuple[Float[Array, "views n 2"], Float[Array, "views n 3"]]:
    """The surface points in the picture of each view (stacked), pixels, and in its camera frame, millimetres."""
    reference = points_in_camera(points, parameters)
    seen = [
        reference @ jnp.asarray(rotation, reference.dtype).T + jnp.asarray(translation, reference.dtype)
        for rotation, translation in zip(views.rotation, views.translation, strict=True)
    ]
    cameras = [Camera(*(part[k] for part in views.camera)) for k in range(len(seen))]
    return jnp.stack([project(camera, at) for camera, at in zip(cameras, seen, strict=True)]), jnp.stack(seen)


def flow_residuals(
    points: SurfacePoints,
    views: FlowView,
    targets: FlowTargets,
    weights: FlowWeights,
    scales: Float[AnyArray, "sides views n"],
    parameters: FaceParameters,
    prior: FaceParameters,
) -> dict[str, Float[Array, "_"]]:
    """Residuals by term: `flow` (Deep Energies Sec. 6 and 7) and `stay`, the optional prior of Sec. 7.

    `scales` multiply the flow's residuals (`robust_scales`). The energy is the sum of all squares.
    """
    missed = flow_distances(points, views, targets, parameters)
    share = jnp.sqrt(weights.flow * LANDMARKS / missed.shape[2]) * jnp.sqrt(targets.weights) * scales
    stay = stay_residual(parameters, prior, weights, points.model.jaw.unit)
    return {"flow": (missed * share[..., None]).ravel(), "stay": stay}


def stay_residual(
    parameters: FaceParameters, prior: FaceParameters, weights: FlowWeights, jaw_unit: JawUnit
) -> Float[Array, "k"]:
    """The optional prior of Sec. 7: the pose, then blendshapes and jaw, near where `prior` has them."""
    context = still(prior)._replace(jaw_unit=jaw_unit)
    return jnp.concatenate(
        [
            jnp.sqrt(weights.stay_pose) * pose_residual(parameters, context),
            jnp.sqrt(weights.stay) * expression_residual(parameters, context),
        ]
    )


def flow_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "n"]:
    """The flow term: points of the face against where they were in the frame before, moved by the pictures' flow.

    Percent of the outer-eye distance. The squares sum to 68 times the mean of Cauchy's c²·log(1 + d²/c²): factors from
    the start of a stage, as `robust_scales` has them, would call a whole face that has moved since an outlier.
    """
    link = context.flow
    missed = flow_distances(link.points, link.views, link.targets, parameters)
    share = jnp.sqrt(LANDMARKS / missed.shape[2] * jnp.asarray(link.targets.weights))
    return (missed * (share * _cauchy_roots(missed, link.robust))[..., None]).ravel().astype(float)


def _cauchy_roots(missed: Float[AnyArray, "*n 2"], robust: Scalar) -> Float[Array, "*n"]:
    """Factor of each distance with which its square is Cauchy's c²·log(1 + d²/c²)."""
    squared = (missed**2).sum(axis=-1) / jnp.square(robust)
    large = squared > NEARLY_ZERO
    safe = jnp.where(large, squared, 1.0)
    return jnp.where(large, jnp.sqrt(jnp.log1p(safe) / safe), 1.0 - 0.25 * squared)


def flow_distances(
    points: SurfacePoints, views: FlowView, targets: FlowTargets, parameters: FaceParameters
) -> Float[Array, "sides views n 2"]:
    """How far each point is from where its neighbour and the flow say, percent of the outer-eye distance."""
    places, _ = points_in_views(points, views, parameters)
    missed = places[None] + targets.bias_px - targets.places
    return missed / targets.unit_px[:, None, None]


def robust_scales(missed: Float[AnyArray, "sides views n 2"], robust: Scalar) -> Float[Array, "sides views n"]:
    """Factor of each residual for which the next least squares is a step of Cauchy's."""
    return 1.0 / jnp.sqrt(1.0 + (missed**2).sum(axis=-1) / jnp.square(robust))


def choose_surface(model: FaceModel, count: int) -> tuple[np.ndarray, Float[np.ndarray, "n 3"]]:
    """Triangles and barycentrics of `count` points spread over the face's skin, denser about eyes and mouth.

    The same for every call. Raises `InputError` for less than 16 points.
    """
    if count < 16:
        raise InputError(f"Flow is compared at 16 surface points or more, got {count}.")
    corners = model.neutral[model.triangles]
    distance = _to_landmarks(model)
    wanted = _on_face(model, distance)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    share = area * wanted * (1.0 + (DENSER - 1.0) * (distance[:, 36:].min(axis=1) < DENSE_MM))
    # Evenly along the sum of shares: close triangles are close in the mesh's order, so that the points spread.
    steps = (np.arange(count) + 0.5) / count * share.sum()
    triangle = np.searchsorted(np.cumsum(share), steps).clip(0, len(share) - 1)
    rng = np.random.default_rng(0)
    first, second = np.sqrt(rng.uniform(size=count)), rng.uniform(size=count)
    barycentric = np.stack([1.0 - first, first * (1.0 - second), first * second], axis=1)
    return triangle, barycentric


def face_triangles(model: FaceModel) -> Bool[np.ndarray, "t"]:
    """Which triangles are of the face's skin near the landmarks: neither ears, neck and crown nor eyes and teeth."""
    return _on_face(model, _to_landmarks(model))


def _on_face(model: FaceModel, to_landmarks: Float[np.ndarray, "t 68"]) -> Bool[np.ndarray, "t"]:
    wanted = to_landmarks.min(axis=1) < NEAR_FACE_MM
    if all(name in model.regions for name in FACE_REGIONS):
        skin = np.zeros(len(model.neutral), bool)
        skin[np.concatenate([model.regions[name] for name in FACE_REGIONS])] = True
        wanted &= skin[model.triangles].all(axis=1)
    return wanted


def _to_landmarks(model: FaceModel) -> Float[np.ndarray, "t 68"]:
    """Distance of each triangle's centre from each of the 68 landmarks, millimetres."""
    centres = model.neutral[model.triangles].mean(axis=1)
    return np.linalg.norm(centres[:, None] - model.landmarks.of(model.neutral)[None, :POINT_COUNT], axis=2)
