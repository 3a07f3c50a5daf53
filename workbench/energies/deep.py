"""The energy of Deep Energies: landmarks that a network sees in the photo against those it sees in the render (Eq. 2).

Beside it the preselected points of Appendix C.1: points on the mesh, projected, against the same detections. A share
per landmark mixes the two. Both predictions enter the residuals linearly, so a solver may bring their derivative from
anywhere: by forward mode through renderer and network, by differences, or from the other prediction.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from workbench.arrays import AnyArray, Scalar
from workbench.energies.context import LandmarkErrors, TermContext
from workbench.energies.terms import terms_of
from workbench.energies.total import weighed_residuals
from workbench.face import FaceModel, FaceParameters, contour_blend
from workbench.geometry import project, rotation_matrix, yaw_of
from workbench.landmarks.dense_detector import nearness
from workbench.landmarks.network_detector import CROP_SIDE, landmark_crop
from workbench.landmarks.surroundings import Surroundings
from workbench.networks import CropBox, DenseNetwork, EnergyNetwork, Fan, NetworkLandmarks, landmarks_in
from workbench.networks.crop import fan_box_of, seen_in_crop, within_picture
from workbench.networks.regression import covariance_of
from workbench.rendering import (
    Cover,
    CropCamera,
    RenderModel,
    Texture,
    cover_vertices,
    covered,
    face_vertices,
    model_at,
    render,
    render_model,
)
from workbench.rendering.camera import AnyCamera, OrthographicCamera

DEEP_TERMS = terms_of("deep-energies")
"""The terms of Deep Energies where no stage names another: E_1 and E_2 of Sec. 8.1, λ‖w‖² of Sec. 8.2, the identity's,
and the rigid prior of Sec. 5."""


class DeepModel(NamedTuple):
    """A face to be rendered, and where its preselected points lie."""

    render: RenderModel
    landmarks: Int[AnyArray, "points 3"]
    """Vertices around each point."""
    barycentric: Float[AnyArray, "points 3"]
    contour: Int[AnyArray, "b 17 3"]
    """The jaw contour, frontal first and then for each tabulated yaw."""
    contour_barycentric: Float[AnyArray, "b 17 3"]
    contour_yaw: Float[AnyArray, "b"]
    """Radians."""


class DeepView(NamedTuple):
    """What one camera contributes: its pose, what its photo shows, and how its render is lit."""

    camera: AnyCamera
    rotation: Float[AnyArray, "3 3"]
    """From the reference camera's frame to this one's; the identity for a single camera."""
    translation: Float[AnyArray, "3"]
    """The reference camera's place in this one's frame, millimetres."""
    target: Float[AnyArray, "points 2"]
    """N(F*), pixels."""
    weights: Float[AnyArray, "points"]
    """W times what the detection counts; all 0 where this view found no face."""
    share: Float[AnyArray, "points"]
    """1: the landmark is seen in the render by the network; 0: it is the preselected point."""
    unit_px: Scalar
    """What one unit of the landmark residuals is."""
    light: Float[AnyArray, "9 3"]
    surroundings: Surroundings
    """What is behind the render."""
    whitening: Float[AnyArray, "points 2 2"] | None = None
    """Takes an error in pixels to one of unit variance by the photo's covariances; None where N tells none."""
    crop: CropBox | None = None
    """D of the photo, for a network whose answer depends on where in D the face is; None: D follows the render."""
    image_size: Float[AnyArray, "2"] | None = None
    """Width and height of the photo, pixels: beyond them the render is black, as the photo's crop is. None: it has no
    border."""
    held: Scalar = 0.0
    """1: the render is seen in the photo's `crop`; 0: D follows the render."""


class NetworkView(NamedTuple):
    """What the network sees in one render."""

    points: Float[Array, "points 2"]
    """N(F), pixels of the whole picture."""
    confidence: Float[Array, "points"]
    """0 to 1."""
    heat_maps: Float[Array, "points m m"] | None
    """None from a dense network."""
    picture: Float[Array, "s s 3"]
    """The render inside of the crop, RGB in 0..1."""
    box: CropBox


def deep_model(model: FaceModel) -> DeepModel:
    """A face model with what this energy needs, on JAX's default device; made once."""
    contour = np.concatenate([model.landmarks.vertices[None, :17], model.contour.vertices.reshape(-1, 17, 3)])
    shares = np.concatenate([model.landmarks.barycentric[None, :17], model.contour.barycentric.reshape(-1, 17, 3)])
    made = (
        np.asarray(model.landmarks.vertices, np.int32),
        np.asarray(model.landmarks.barycentric, np.float32),
        np.asarray(contour, np.int32),
        np.asarray(shares, np.float32),
        np.radians(np.concatenate([[0.0], model.contour_yaw_deg])),
    )
    return DeepModel(render_model(model), *(jnp.asarray(part) for part in made))


def view_vertices(model: DeepModel, view: DeepView, parameters: FaceParameters) -> Float[Array, "v 3"]:
    """The face in the frame of a view's camera, millimetres."""
    return in_view(face_vertices(model.render, parameters), view)


def in_view(points: Float[Array, "n 3"], view: DeepView) -> Float[Array, "n 3"]:
    """Points of the reference camera's frame in a view's."""
    rotation, translation = (jnp.asarray(part, jnp.float32) for part in (view.rotation, view.translation))
    return points @ rotation.T + translation


def preselected_points(
    model: DeepModel, view: DeepView, parameters: FaceParameters, sliding: Scalar = 1.0
) -> Float[Array, "points 2"]:
    """The points on the mesh, projected, pixels (Appendix C.1). `sliding` 1: the jaw contour follows the yaw."""
    # Only the vertices around the points: the derivative by all unknowns is not taken of the whole mesh.
    around = jnp.concatenate([model.contour.ravel(), model.landmarks[17:].ravel()])
    vertices = view_vertices(model._replace(render=model_at(model.render, around)), view, parameters)
    of_contour, of_inner = jnp.split(vertices, [model.contour.size])
    turned = jnp.asarray(view.rotation) @ rotation_matrix(jnp.asarray(parameters.rotation))
    yaw = jax.lax.stop_gradient(yaw_of(turned))
    blend = contour_blend(model.contour_yaw, yaw, sliding).astype(jnp.float32)
    contour = jnp.einsum(
        "b,bnjd,bnj->nd", blend, of_contour.reshape(*model.contour.shape, 3), model.contour_barycentric
    )
    inner = jnp.einsum("njd,nj->nd", of_inner.reshape(-1, 3, 3), model.barycentric[17:])
    return _project(view.camera, jnp.concatenate([contour, inner]))


def network_view(
    network: EnergyNetwork,
    model: DeepModel,
    albedo: Float[AnyArray, "v 3"] | Texture,
    view: DeepView,
    parameters: FaceParameters,
    side: int = CROP_SIDE,
    samples: int = 1,
    cover: Cover | None = None,
) -> NetworkView:
    """N(F(x_R)): the face rendered inside of its crop and seen by the network.

    The crop D is where a detector that never fails would put it, from the projected points; constant in the
    derivative, as in the paper (Sec. 4). Rendering the crop itself replaces cutting and resizing a render. Where the
    view holds the photo's crop, D is that. A `cover`, as hair, is drawn before the face, and has no derivative. Behind
    the face are the photo's surroundings, and beyond the photo's border all is black, as in the photo's crop: what is
    beside a face moves the network's answer, and is to move both alike.
    """
    box = jax.lax.stop_gradient(crop_of(network, preselected_points(model, view, parameters, 0.0)))
    if view.crop is not None:
        box = jax.tree.map(lambda own, photo: jnp.where(jnp.asarray(view.held) > 0.5, photo, own), box, view.crop)
    vertices = view_vertices(model, view, parameters)
    camera = CropCamera(view.camera, box, jnp.float32(side))
    around = view.surroundings
    behind = seen_in_crop(jnp.asarray(around.picture, jnp.float32) / 255.0, around.matrix, around.origin, box, side)
    seen = render(
        vertices, model.render.topology, camera, albedo, view.light, behind, size=(side, side), samples=samples
    )
    picture = seen.color
    if cover is not None:
        worn = in_view(cover_vertices(cover, model.render, parameters), view)
        picture, _ = covered(seen, cover, worn, camera, view.light, size=(side, side))
    if view.image_size is not None:
        picture = picture * within_picture(box, view.image_size, side)[..., None].astype(picture.dtype)
    landmarks = landmarks_in(network, jnp.moveaxis(picture, -1, 0), box)
    return NetworkView(landmarks.points, confidence_of(network, landmarks), landmarks.heat_maps, picture, box)


def confidence_of(network: EnergyNetwork, seen: NetworkLandmarks) -> Float[Array, "points"]:
    """How sure the network is of each landmark, 0..1: by its heat map, or by its covariance."""
    if isinstance(network, DenseNetwork):
        return nearness(seen.points, covariance_of(seen.whitening))
    return network.confidence_of(seen.heat_maps)


def crop_of(network: EnergyNetwork, points: Float[AnyArray, "points 2"]) -> CropBox:
    """The crop that a network wants of a face whose landmarks are known, pixels."""
    return fan_box_of(points) if isinstance(network, Fan) else landmark_crop(points)


def deep_residuals(
    views: DeepView,
    omega: Float[AnyArray, "t"],
    predicted: Float[AnyArray, "views points 2"],
    parameters: FaceParameters,
    context: TermContext,
    terms: tuple[str, ...] = DEEP_TERMS,
) -> dict[str, Float[Array, "_"]]:
    """Residuals by term, weighed: the energy is the sum of their squares.

    W multiplies squared errors: the paper's is its root. Errors count in `unit_px`, and W weighs E_2 too unless the
    context's `weighted_edges` is 0; the paper has pixels and does not weigh E_2. `views` is stacked. `predicted` are
    landmarks in each view, pixels. Where the views have a `whitening`, E_1 counts standard deviations.
    """
    apart = predicted - views.target
    unwhitened = apart / jnp.asarray(views.unit_px)[:, None, None]
    error = unwhitened if views.whitening is None else jnp.einsum("vpij,vpj->vpi", views.whitening, apart)
    root = jnp.sqrt(jnp.asarray(views.weights))
    errors = LandmarkErrors(error, root, unwhitened=unwhitened, weighted_edges=context.constants.weighted_edges)
    return weighed_residuals(terms, omega, errors, parameters, context)


def _project(camera: AnyCamera, points: Float[Array, "n 3"]) -> Float[Array, "n 2"]:
    if isinstance(camera, OrthographicCamera):
        return points[:, :2] * camera.scale_px_per_mm + camera.principal_point_px
    return project(camera, points)
