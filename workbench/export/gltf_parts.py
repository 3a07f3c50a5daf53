"""What a character wears, in glTF: a node, a mesh and a material for each part."""

from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from workbench.export.clip import FLIP, Clip, to_world
from workbench.export.gltf_buffer import INDICES, VERTICES, Buffer
from workbench.export.looks import LOOKS, STILL_MM, Look
from workbench.export.skinning import Joint, Shapes, joint_shares, part_joints
from workbench.extras import needs
from workbench.face import DressedHead, Part, WornPart
from workbench.pictures.mesh import corner_sum, split_seams, vertex_normals

with needs("formats"):
    import pygltflib

JPEG_QUALITY = 92
GAMMA = 2.2


@dataclass
class AddedParts:
    """What the parts add to a document, a node and a mesh for each."""

    nodes: list[pygltflib.Node] = field(default_factory=list)
    meshes: list[pygltflib.Mesh] = field(default_factory=list)
    follow: list[bool] = field(default_factory=list)
    """Whether a part has the face's morph targets; the others move with the head alone."""
    materials: list[pygltflib.Material] = field(default_factory=list)
    images: list[pygltflib.Image] = field(default_factory=list)


def add_parts(
    pool: Buffer,
    clip: Clip,
    shapes: Shapes,
    joints: tuple[Joint, ...],
    dressed: DressedHead,
    first: int,
    images_before: int,
) -> AddedParts:
    """All parts on the clip's person; `first` is the frame whose weights the meshes rest at."""
    added = AddedParts()
    rest = clip.person.neutral
    for worn, points in zip(dressed.worn, dressed.parts_on(rest, rest), strict=True):
        part = worn.part
        image = None
        if part.kind != "corneas":
            image = images_before + len(added.images)
            added.images.append(embedded(pool, f"{part.kind}-{part.style}", worn.picture))
        added.materials.append(_material(worn, image))
        mesh = _mesh(pool, shapes, joints, part, points, len(added.materials))
        if not part.still:
            mesh.weights = np.asarray(shapes.weights[first], float).tolist()
        added.meshes.append(mesh)
        added.nodes.append(pygltflib.Node(name=part.kind, mesh=len(added.meshes)))  # mesh 0 is the face
        added.follow.append(not part.still)
    return added


def add_skin(pool: Buffer, attributes: pygltflib.Attributes, shares: Float[np.ndarray, "n j"]) -> None:
    """Tie vertices to the head and up to three joints below it; see `joint_shares`."""
    weights = np.zeros((len(shares), 4))
    weights[:, : shares.shape[1]] = shares
    joints = np.where(weights > 0.0, np.arange(4, dtype=np.uint8), np.uint8(0))  # an unused slot names joint 0
    attributes.JOINTS_0 = pool.add(joints, VERTICES)
    attributes.WEIGHTS_0 = pool.add(weights, VERTICES)


def embedded(pool: Buffer, name: str, picture: UInt8[np.ndarray, "h w _"]) -> pygltflib.Image:
    """A picture in the file: PNG where anything is transparent, else JPEG."""
    if picture.shape[2] == 4 and picture[..., 3].min() < 255:
        encoded = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGBA2BGRA))[1]
        return pygltflib.Image(name=name, bufferView=pool.view(encoded.tobytes()), mimeType="image/png")
    encoded = cv2.imencode(".jpg", picture[..., 2::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    return pygltflib.Image(name=name, bufferView=pool.view(encoded.tobytes()), mimeType="image/jpeg")


def _material(worn: WornPart, image: int | None) -> pygltflib.Material:
    look = LOOKS[worn.part.kind]
    surface = pygltflib.PbrMetallicRoughness(metallicFactor=0.0, roughnessFactor=look.roughness)
    if image is None:
        surface.baseColorFactor = [1.0, 1.0, 1.0, look.opacity]
    else:
        surface.baseColorTexture = pygltflib.TextureInfo(index=image)
    return pygltflib.Material(
        name=worn.part.kind,
        pbrMetallicRoughness=surface,
        alphaMode=_alpha_mode(look),
        alphaCutoff=look.cutoff or None,
        doubleSided=look.both_sides,
    )


def _alpha_mode(look: Look) -> str:
    if look.cutoff:
        return pygltflib.MASK
    return pygltflib.BLEND if look.alpha or look.opacity < 1.0 else pygltflib.OPAQUE


def _mesh(
    pool: Buffer,
    shapes: Shapes,
    joints: tuple[Joint, ...],
    part: Part,
    points: Float[np.ndarray, "n 3"],
    material: int,
) -> pygltflib.Mesh:
    order, uv_of_corner, triangles = split_seams(part.triangles, part.triangles_uv)
    normals = vertex_normals(points, part.triangles, corner_sum(part.triangles, len(points)))[order] * FLIP
    normals[np.linalg.norm(normals, axis=1) < 0.5] = (0.0, 0.0, 1.0)
    attributes = pygltflib.Attributes(POSITION=pool.add(to_world(points[order]), VERTICES, bounds=True))
    attributes.NORMAL = pool.add(normals, VERTICES)
    attributes.TEXCOORD_0 = pool.add(part.uv[uv_of_corner] * [1.0, -1.0] + [0.0, 1.0], VERTICES)  # v counts down
    if part.shade.min() < 255:
        linear = (part.shade[order, None] / 255.0) ** GAMMA
        attributes.COLOR_0 = pool.add(np.repeat(linear, 3, axis=1), VERTICES)
    if joints and not part.still:
        add_skin(pool, attributes, joint_shares(part_joints(joints, part), len(points))[order])
    indices = pool.add(triangles.astype(np.uint16).ravel(), INDICES)
    primitive = pygltflib.Primitive(attributes=attributes, indices=indices, material=material)
    extras = {}
    if not part.still:
        unmoved = pool.zeros(len(order))
        primitive.targets = [
            {"POSITION": unmoved}
            if np.abs(delta).max() < STILL_MM
            else {"POSITION": pool.add(to_world(delta[order]), VERTICES, bounds=True)}
            for delta in part.carried(shapes.deltas)
        ]
        extras = {"targetNames": list(shapes.names)}
    return pygltflib.Mesh(name=part.kind, primitives=[primitive], extras=extras)
