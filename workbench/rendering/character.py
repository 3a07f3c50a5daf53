"""A character for this renderer: its skin as the face model's texture, its hair as something outside of the face.

The face is the head's own mesh with the character's skin, brows painted in; eyes, teeth and tongue, which a character
wears as parts of finer meshes, stay the plain head's. Hair is no part of the face model: it stands still on the skull,
is cut along its transparency into opaque triangles, and hides what lies behind it. It is constant in the derivative,
so that no pixel under hair says anything about the face.
"""

from typing import NamedTuple

import cv2
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, UInt8
from scipy.ndimage import map_coordinates

from workbench.arrays import AnyArray
from workbench.face import FaceModel, FaceParameters, load_default_head
from workbench.face.dressed_head import DressedHead, WornPart
from workbench.frames import read_picture
from workbench.rendering.camera import AnyCamera
from workbench.rendering.head import RenderModel, placed, render_face
from workbench.rendering.renderer import Rendering, render
from workbench.rendering.texture import Texture
from workbench.rendering.topology import MeshTopology, mesh_topology
from workbench.rendering.uv_map import drawn_triangles, uv_map
from workbench.samples import sample

SIDE = 512
"""Side of the texture: one to two texels per pixel of a network's crop. Finer ones would flicker, as bilinear
look-ups do not average."""
OUTSIDE = ("hair",)
"""Kinds of worn parts that may hide the face."""
PIECE_MM, MOST_SPLITS = 10.0, 4
"""Longest edge of a triangle of hair after it is cut, unless that takes more splits of an edge."""
SOLID = 0.5
"""Mean opacity from which a piece of hair hides what is behind it."""


class Cover(NamedTuple):
    """What a head wears outside of the face: opaque triangles tied to the resting head."""

    anchors: Int[AnyArray, "n k"]
    """Vertices of the head."""
    weights: Float[AnyArray, "n k"]
    offsets: Float[AnyArray, "n 3"]
    """Millimetres, for the mean head's size."""
    corners: Int[AnyArray, "m 3"]
    """The tied vertices around each vertex of the mesh."""
    shares: Float[AnyArray, "m 3"]
    colors: Float[AnyArray, "m 3"]
    topology: MeshTopology
    scale_vertices: Int[AnyArray, "3 2"]
    """Pairs of head vertices whose distances along x, y and z say how large a head is."""


class CharacterLook(NamedTuple):
    """How a character looks: the texture of its face, and what hides it; None for a bald one."""

    texture: Texture
    cover: Cover | None


def character_look(dressed: DressedHead, side: int = SIDE) -> CharacterLook:
    """A character for the renderer, with a texture of `side` × `side` texels, in the pictures' own encoding."""
    model = dressed.model
    mapped = uv_map(model, side)
    texture = np.where(dressed.shown[mapped.triangle][..., None], _resized(dressed.skin, side), _own_skin(side)) / 255.0
    outside = [worn for worn in dressed.worn if worn.part.kind in OUTSIDE]
    for worn in dressed.worn:
        if worn.part.kind == "brows":
            texture = _painted(texture, worn, model)
    return CharacterLook(_texture(texture, model), _cover(outside[0], dressed) if outside else None)


def plain_look(side: int = SIDE) -> CharacterLook:
    """The default head without a character: its painted texture, and nothing before the face."""
    return CharacterLook(_texture(_own_skin(side) / 255.0, load_default_head()), None)


def vertex_colors(texture: Texture, model: FaceModel) -> Float[np.ndarray, "v 3"]:
    """The texture's colour at each vertex."""
    uv = np.zeros((len(model.neutral), 2), np.float32)
    uv[model.triangles] = np.asarray(texture.uv)[np.asarray(texture.triangles_uv)]
    return _looked_up(np.asarray(texture.picture), uv)


def cover_vertices(cover: Cover, model: RenderModel, parameters: FaceParameters) -> Float[Array, "m 3"]:
    """Vertices of the cover in the camera frame, millimetres; constant in the derivative."""
    parameters = FaceParameters(*(jnp.asarray(part, jnp.float32) for part in lax.stop_gradient(parameters)))
    rest = model.neutral
    if len(parameters.identity):
        rest = rest + jnp.tensordot(parameters.identity, model.identity, axes=1)
    axes = jnp.arange(3)
    own, mean = (
        jnp.abs(head[cover.scale_vertices[:, 0], axes] - head[cover.scale_vertices[:, 1], axes])
        for head in (rest, model.neutral)
    )
    tied = jnp.einsum("nk,nkd->nd", cover.weights, rest[cover.anchors]) + own / mean * cover.offsets
    return placed(jnp.einsum("mj,mjd->md", cover.shares, tied[cover.corners]), parameters)


def covered(
    rendering: Rendering,
    cover: Cover,
    vertices_camera: Float[Array, "m 3"],
    camera: AnyCamera,
    light: Float[AnyArray, "9 3"],
    *,
    size: tuple[int, int],
) -> tuple[Float[Array, "h w 3"], Bool[Array, "h w"]]:
    """A rendered face with its cover in front, and the pixels that the cover hides.

    The cover has the light's mean, no shades: its cards' normals say little. There the picture's derivative is zero.
    """
    ambient = jnp.asarray(light, jnp.float32) * (jnp.arange(9) == 0)[:, None]
    hair = lax.stop_gradient(
        render(
            vertices_camera, cover.topology, camera, cover.colors, ambient, jnp.zeros(3),
            size=size, antialias=False, cull_backfaces=False,
        )
    )  # fmt: skip
    hidden = hair.depth < lax.stop_gradient(rendering.depth)
    return jnp.where(hidden[..., None], hair.color, rendering.color), hidden


def hidden_pixels(
    cover: Cover,
    model: RenderModel,
    parameters: FaceParameters,
    camera: AnyCamera,
    *,
    size: tuple[int, int],
) -> Bool[Array, "h w"]:
    """The pixels of a picture of `size` (width, height) that a cover hides, of the face or of what is beside it."""
    light, black = jnp.zeros((9, 3)), jnp.zeros(3)
    face = render_face(model, parameters, camera, model.colors, light, black, size=size, antialias=False)
    return covered(face, cover, cover_vertices(cover, model, parameters), camera, light, size=size)[1]


def _own_skin(side: int) -> UInt8[np.ndarray, "s s 3"]:
    return _resized(read_picture(sample("head-texture")), side)


def _resized(picture: UInt8[np.ndarray, "h w 3"], side: int) -> UInt8[np.ndarray, "s s 3"]:
    return cv2.resize(picture, (side, side), interpolation=cv2.INTER_AREA)


def _texture(picture: Float[np.ndarray, "s s 3"], model: FaceModel) -> Texture:
    return Texture(picture.astype(np.float32), model.uv.astype(np.float32), model.triangles_uv.astype(np.int32))


def _painted(texture: Float[np.ndarray, "s s 3"], worn: WornPart, model: FaceModel) -> Float[np.ndarray, "s s 3"]:
    """The texture with a part that lies flat on the skin painted into it."""
    part, uv_of_vertex = worn.part, np.zeros((len(model.neutral), 2))
    uv_of_vertex[model.triangles] = model.uv[model.triangles_uv]
    places = np.einsum("nk,nkd->nd", part.weights, uv_of_vertex[part.anchors])[part.triangles]
    own = part.uv[part.triangles_uv]
    triangle, barycentric = drawn_triangles(places, len(texture))
    on = triangle >= 0
    seen = _looked_up(
        _averaged(worn.picture, len(texture) * np.sqrt(_areas(places).sum() / _areas(own).sum())),
        np.einsum("nj,njd->nd", barycentric[on], own[triangle[on]]),
    )
    painted = texture.copy()
    painted[on] = seen[:, :3] + (1.0 - seen[:, 3:]) * painted[on]
    return painted


def _cover(worn: WornPart, dressed: DressedHead) -> Cover:
    """A part cut into pieces, of which the solid ones are kept."""
    part = worn.part
    neutral = part.on(dressed.model.neutral)
    edges = neutral[part.triangles] - neutral[np.roll(part.triangles, 1, axis=1)]
    longest = np.linalg.norm(edges, axis=-1).max(axis=1)
    splits = np.clip(np.ceil(longest / PIECE_MM), 1, MOST_SPLITS).astype(int)
    pieces = [(np.flatnonzero(splits == count), _split(count)) for count in np.unique(splits).tolist()]
    triangle = np.concatenate([np.repeat(triangles, len(shares)) for triangles, shares in pieces])
    shares = np.concatenate([np.tile(shares, (len(triangles), 1, 1)) for triangles, shares in pieces])
    uv = np.einsum("pj,pjd->pd", shares.mean(axis=1), part.uv[part.triangles_uv][triangle])
    texel = np.sqrt(np.median(_areas(part.uv[part.triangles_uv])[triangle] / splits[triangle] ** 2))
    seen = _looked_up(_averaged(worn.picture, 1.0 / texel), uv)
    solid = seen[:, 3] >= SOLID
    corners = np.repeat(part.triangles[triangle[solid]], 3, axis=0)
    colors = np.repeat(seen[solid, :3] / seen[solid, 3:], 3, axis=0)
    return Cover(
        anchors=part.anchors.astype(np.int32),
        weights=part.weights.astype(np.float32),
        offsets=part.offsets.astype(np.float32),
        corners=corners.astype(np.int32),
        shares=shares[solid].reshape(-1, 3).astype(np.float32),
        colors=colors.astype(np.float32),
        topology=mesh_topology(np.arange(len(corners)).reshape(-1, 3), len(corners)),
        scale_vertices=dressed.scale_vertices.astype(np.int32),
    )


def _split(count: int) -> Float[np.ndarray, "p 3 3"]:
    """The count² equal pieces of a triangle: barycentric coordinates of their corners."""
    upright = [[(i, j), (i + 1, j), (i, j + 1)] for i in range(count) for j in range(count - i)]
    turned = [[(i + 1, j), (i + 1, j + 1), (i, j + 1)] for i in range(count) for j in range(count - i - 1)]
    first, second = np.moveaxis(np.array(upright + turned) / count, -1, 0)
    return np.stack([1.0 - first - second, first, second], axis=-1)


def _areas(uv: Float[np.ndarray, "t 3 2"]) -> Float[np.ndarray, "t"]:
    (x, y), (u, v) = (np.moveaxis(uv[:, k] - uv[:, 0], -1, 0) for k in (1, 2))
    return 0.5 * np.abs(x * v - y * u)


def _averaged(picture: UInt8[np.ndarray, "h w 4"], side: float) -> Float[np.ndarray, "a b 4"]:
    """RGBA of 0 to 1, colours times opacity, of about `side` × `side` texels, at most its own."""
    opacity = picture[..., 3:] / np.float32(255.0)
    whole = np.concatenate([picture[..., :3] / np.float32(255.0) * opacity, opacity], axis=2)
    height, width = (int(np.clip(round(side), 1, own)) for own in picture.shape[:2])
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)


def _looked_up(picture: Float[np.ndarray, "h w c"], uv: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n c"]:
    """As `sample_texture`, of any number of channels, in double precision."""
    height, width = picture.shape[:2]
    column, row = ((uv * [1.0, -1.0] + [0.0, 1.0]) * [width, height] - 0.5).T
    channels = np.moveaxis(picture, 2, 0)
    return np.stack([map_coordinates(part, (row, column), float, order=1, mode="nearest") for part in channels], axis=1)
