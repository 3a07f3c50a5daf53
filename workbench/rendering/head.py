"""The parametric face as arrays for the renderer: parameters in, vertices and pictures out."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from workbench.arrays import AnyArray
from workbench.face import FaceModel, FaceParameters, JawJoint, jaw_joint, move_jaw
from workbench.face.model import BLINK_SCALE_RANGE
from workbench.geometry import rotation_matrix
from workbench.rendering.camera import AnyCamera
from workbench.rendering.renderer import Rendering, render
from workbench.rendering.texture import Texture
from workbench.rendering.topology import MeshTopology, mesh_topology

BESIDE_MM = 2.0
"""Lip vertices this close from side to side are compared: of these, the lower lip's move farther under `jawOpen`."""


class RenderModel(NamedTuple):
    """A face model as float32 arrays: vertices are linear in expression and identity, blinks scaled to the person."""

    neutral: Float[AnyArray, "v 3"]
    expression: Float[AnyArray, "k v 3"]
    identity: Float[AnyArray, "i v 3"]
    expression_scale: Float[AnyArray, "k"]
    """Travel of each blendshape for the mean identity (1 but for blinks)."""
    expression_scale_identity: Float[AnyArray, "i k"]
    jaw: JawJoint
    topology: MeshTopology
    colors: Float[AnyArray, "v 3"]
    """The model's own albedo, 0 to 1."""
    uv: Float[AnyArray, "u 2"]
    triangles_uv: Int[AnyArray, "t 3"]


def render_model(model: FaceModel) -> RenderModel:
    """What rendering needs of a face model, on JAX's default device; made once."""
    scale, scale_identity = model.shape_scales()
    made = RenderModel(
        neutral=model.neutral.astype(np.float32),
        expression=model.expression_deltas.astype(np.float32),
        identity=model.identity_deltas.astype(np.float32),
        expression_scale=scale.astype(np.float32),
        expression_scale_identity=scale_identity.astype(np.float32),
        jaw=jax.tree.map(lambda part: np.asarray(part, np.float32), jaw_joint(model)),
        topology=mesh_topology(model.triangles, len(model.neutral), lip_sides(model)),
        colors=model.colors.astype(np.float32) / 255.0,
        uv=model.uv.astype(np.float32),
        triangles_uv=model.triangles_uv.astype(np.int32),
    )
    return jax.tree.map(jnp.asarray, made)


def model_at(model: RenderModel, vertices: Int[AnyArray, "n"]) -> RenderModel:
    """The model with these vertices alone, in this order; its topology, which they no longer fit, stays as it was."""
    return model._replace(
        neutral=model.neutral[vertices],
        expression=model.expression[:, vertices],
        identity=model.identity[:, vertices],
        colors=model.colors[vertices],
        jaw=model.jaw._replace(weights=model.jaw.weights[vertices], corrective=model.jaw.corrective[vertices]),
    )


def lip_sides(model: FaceModel) -> Int[np.ndarray, "t"]:
    """1 for triangles of the upper lip, 2 for those of the lower lip, 0 for others and where both meet."""
    sides = np.zeros(len(model.triangles), np.int64)
    if "lips" not in model.regions or "jawOpen" not in model.expression_names:
        return sides
    way = np.linalg.norm(model.expression_deltas[model.expression_names.index("jawOpen")], axis=1)
    lips = model.regions["lips"]
    beside = np.abs(model.neutral[lips, None, 0] - model.neutral[None, lips, 0]) < BESIDE_MM
    least, most = (
        pick(np.where(beside, way[None, lips], empty), axis=1) for pick, empty in ((np.min, np.inf), (np.max, -np.inf))
    )
    side_of_vertex = np.zeros(len(model.neutral), np.int64)
    side_of_vertex[lips] = np.where(way[lips] < 0.5 * (least + most), 1, 2)
    corners = side_of_vertex[model.triangles]
    for side in (1, 2):
        sides[(corners == side).any(axis=1) & (corners != 3 - side).all(axis=1)] = side
    return sides


# By itself one program; inlined, part of any other as if it were written there.
@partial(jax.jit, inline=True)
def face_vertices(model: RenderModel, parameters: FaceParameters) -> Float[Array, "v 3"]:
    """x_R = R(θ)·x(w) + t in the camera frame, millimetres, float32 (Deep Energies Eq. 1).

    x(w) is identity, then blendshapes, then the jaw joint. Empty parameters mean the mean identity, a resting joint
    and scale 1.
    """
    parameters = FaceParameters(*(jnp.asarray(part, jnp.float32) for part in parameters))
    expression, identity, jaw = parameters.expression, parameters.identity, parameters.jaw
    scale, vertices = model.expression_scale, model.neutral
    if len(identity):
        scale = jnp.clip(scale + identity @ model.expression_scale_identity, *BLINK_SCALE_RANGE)
        vertices = vertices + jnp.tensordot(identity, model.identity, axes=1)
    vertices = vertices + jnp.tensordot(expression * scale, model.expression, axes=1)
    if len(jaw):
        vertices = move_jaw(model.jaw, vertices, identity, jaw)
    return placed(vertices, parameters)


def placed(vertices: Float[Array, "v 3"], parameters: FaceParameters) -> Float[Array, "v 3"]:
    """From the head's frame to the camera's: R(θ)·s·x + t, millimetres. An empty scale means 1."""
    if len(parameters.scale):
        vertices = vertices * parameters.scale
    return vertices @ rotation_matrix(parameters.rotation).T + parameters.translation


def render_face(
    model: RenderModel,
    parameters: FaceParameters,
    camera: AnyCamera,
    albedo: Float[AnyArray, "v 3"] | Texture,
    light: Float[AnyArray, "9 3"],
    background: Float[AnyArray, "*hw 3"],
    *,
    size: tuple[int, int],
    samples: int = 1,
    antialias: bool = True,
) -> Rendering:
    """Render the face with these parameters; the rest as in `render`."""
    vertices = face_vertices(model, parameters)
    return render(
        vertices, model.topology, camera, albedo, light, background, size=size, samples=samples, antialias=antialias
    )
