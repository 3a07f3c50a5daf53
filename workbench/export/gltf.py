"""glTF 2.0 (.glb): the person's head with its blendshapes as morph targets, jaw joint, camera and animation."""

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Int

from workbench.export.clip import FLIP, Clip, quaternions, to_world
from workbench.export.skinning import Shapes, clip_shapes
from workbench.extras import needs
from workbench.face import FaceModel
from workbench.files import atomic_path
from workbench.geometry import Camera
from workbench.pictures.head_picture import bundled_texture
from workbench.pictures.mesh import corner_sum, split_seams, vertex_normals

with needs("formats"):
    import pygltflib

NEAR_M, FAR_M = 0.01, 100.0
JPEG_QUALITY = 92
VERTICES = pygltflib.ARRAY_BUFFER
COMPONENTS = {
    np.dtype(np.float32): pygltflib.FLOAT,
    np.dtype(np.uint8): pygltflib.UNSIGNED_BYTE,
    np.dtype(np.uint16): pygltflib.UNSIGNED_SHORT,
    np.dtype(np.uint32): pygltflib.UNSIGNED_INT,
}
KINDS = {(): pygltflib.SCALAR, (2,): pygltflib.VEC2, (3,): pygltflib.VEC3, (4,): pygltflib.VEC4, (4, 4): pygltflib.MAT4}


def write_gltf(clip: Clip, path: str | Path) -> None:
    """Write a binary glTF that other programs play.

    Nodes: `camera` in the origin, `head` (animated; a joint), `jaw` below it, and `face`, the mesh that both move.
    Morph targets have the blendshapes' names (`extras.targetNames`). Keys lie at the times of the frames with a face.
    Vertices along the seams of the texture are doubled, as the format wants it.
    """
    document = _document(clip)
    with atomic_path(path) as temporary:
        document.save_binary(str(temporary))


def _document(clip: Clip) -> pygltflib.GLTF2:
    person, track = clip.person, clip.track
    pool = _Buffer()
    corners, uv_corners, triangles = render_corners(person)
    found = np.flatnonzero(track.found)
    jawed = "jaw" in person.joints and bool(person.jaw_weights.any())
    shapes = clip_shapes(clip)
    mesh = _mesh(pool, person, shapes, corners, uv_corners, triangles, shapes.weights[found[0]], jawed)
    nodes = [
        pygltflib.Node(name="camera", camera=0),
        pygltflib.Node(
            name="head",
            translation=_numbers(to_world(track.translation[found[0]])),
            rotation=_numbers(quaternions(track.rotation[found[:1]])[0]),
        ),
        pygltflib.Node(name="face", mesh=0),
    ]
    scene, skins = [0, 1], []
    if jawed:
        # A mesh that joints move stands beside them: its own place does not count.
        jaw = to_world(np.asarray(clip.joint.joint, float))
        nodes.append(pygltflib.Node(name="jaw", translation=_numbers(jaw)))
        nodes[1].children, nodes[2].skin = [3], 0
        inverse = np.tile(np.eye(4), (2, 1, 1))
        inverse[1, :3, 3] = -jaw
        bind = pool.add(inverse.transpose(0, 2, 1))  # column-major
        skins = [pygltflib.Skin(name="head", joints=[1, 3], skeleton=1, inverseBindMatrices=bind)]
        scene.append(2)
    else:
        nodes[1].children = [2]
    image, texture = _texture(pool, person)
    document = pygltflib.GLTF2(
        asset=pygltflib.Asset(version="2.0", generator="Face Energy Workbench"),
        scene=0,
        scenes=[pygltflib.Scene(name="performance", nodes=scene)],
        nodes=nodes,
        meshes=[mesh],
        skins=skins,
        cameras=[_camera(clip.camera, clip.image_size)],
        materials=[_material(texture)],
        animations=[_animation(pool, clip, shapes, found)],
        images=image,
        textures=[pygltflib.Texture(source=0, sampler=0)] if texture else [],
        samplers=[pygltflib.Sampler(magFilter=pygltflib.LINEAR, minFilter=pygltflib.LINEAR_MIPMAP_LINEAR)]
        if texture
        else [],
        extras={"frames_per_second": clip.rate, "frames": len(track), "model": person.name},
    )
    document.accessors, document.bufferViews = pool.accessors, pool.views
    document.buffers = [pygltflib.Buffer(byteLength=len(pool.data))]
    document.set_binary_blob(bytes(pool.data))
    return document


def render_corners(person: FaceModel) -> tuple[Int[np.ndarray, "c"], Int[np.ndarray, "c"], Int[np.ndarray, "t 3"]]:
    """Vertex and UV of each point that is drawn, doubled along seams, and triangles over these points."""
    if len(person.uv) > 1:
        return split_seams(person.triangles, person.triangles_uv)
    every = np.arange(len(person.neutral))
    return every, np.zeros(len(every), int), person.triangles.astype(int)


def _mesh(
    pool, person: FaceModel, shapes: Shapes, corners, uv_corners, triangles, weights, jawed: bool
) -> pygltflib.Mesh:
    sums = corner_sum(person.triangles, len(person.neutral))

    def normals(vertices: np.ndarray) -> np.ndarray:
        found = vertex_normals(vertices, person.triangles, sums)[corners] * FLIP
        # Vertices without a triangle, or between two that face each other, have none; the format wants length one.
        found[np.linalg.norm(found, axis=1) < 0.5] = (0.0, 0.0, 1.0)
        return found

    neutral = normals(person.neutral)
    attributes = pygltflib.Attributes(POSITION=pool.add(to_world(person.neutral[corners]), VERTICES, bounds=True))
    attributes.NORMAL = pool.add(neutral, VERTICES)
    if len(person.uv) > 1:
        attributes.TEXCOORD_0 = pool.add(person.uv[uv_corners] * [1.0, -1.0] + [0.0, 1.0], VERTICES)  # v counts down
    if bundled_texture(person) is None:
        linear = ((person.colors[corners] / 255.0) ** 2.2).astype(np.float32)
        attributes.COLOR_0 = pool.add(linear, VERTICES)
    if jawed:
        jaw = person.jaw_weights[corners]
        joints = np.zeros((len(corners), 4), np.uint8)
        joints[:, 1] = jaw > 0.0  # an unused slot names joint 0
        attributes.JOINTS_0 = pool.add(joints, VERTICES)
        attributes.WEIGHTS_0 = pool.add(np.stack([1.0 - jaw, jaw, 0.0 * jaw, 0.0 * jaw], axis=1), VERTICES)
    targets = [
        {
            "POSITION": pool.add(to_world(delta[corners]), VERTICES, bounds=True),
            "NORMAL": pool.add(normals(person.neutral + delta) - neutral, VERTICES),
        }
        for delta in shapes.deltas
    ]
    indices = pool.add(
        triangles.astype(np.uint32 if len(corners) > 65_535 else np.uint16).ravel(), pygltflib.ELEMENT_ARRAY_BUFFER
    )
    return pygltflib.Mesh(
        name="face",
        primitives=[pygltflib.Primitive(attributes=attributes, indices=indices, material=0, targets=targets)],
        weights=_numbers(weights),
        extras={"targetNames": list(shapes.names)},
    )


def _animation(pool, clip: Clip, shapes: Shapes, found: Int[np.ndarray, "m"]) -> pygltflib.Animation:
    track = clip.track
    times = pool.add(clip.times_s[found], bounds=True)
    curves = {
        (1, "translation"): to_world(track.translation[found]),
        (1, "rotation"): quaternions(track.rotation[found]),
        (2, "weights"): shapes.weights[found].ravel(),
    }
    if clip.moves_scale:
        curves[1, "scale"] = np.repeat(track.scale[found, None], 3, axis=1)
    if clip.moves_jaw:
        curves[3, "translation"] = to_world(np.asarray(clip.joint.joint) + track.jaw[found, 3:])
        curves[3, "rotation"] = quaternions(track.jaw[found, :3])
    made = pygltflib.Animation(name="performance")
    for number, ((node, path), values) in enumerate(curves.items()):
        made.samplers.append(pygltflib.AnimationSampler(input=times, output=pool.add(values)))
        target = pygltflib.AnimationChannelTarget(node=node, path=path)
        made.channels.append(pygltflib.AnimationChannel(sampler=number, target=target))
    return made


def _camera(camera: Camera, image_size: tuple[int, int]) -> pygltflib.Camera:
    """The pinhole; what glTF cannot express (an off-centre axis, distortion) is in `extras`."""
    width, height = image_size
    fx, fy = (float(length) for length in camera.focal_px)
    lens = pygltflib.Perspective(
        yfov=float(2.0 * np.arctan(0.5 * height / fy)),
        aspectRatio=float(width * fy / (height * fx)),
        znear=NEAR_M,
        zfar=FAR_M,
    )
    extras = {
        "image_size": [width, height],
        "focal_px": _numbers(camera.focal_px),
        "principal_point_px": _numbers(camera.principal_point_px),
        "distortion": _numbers(camera.distortion),
    }
    return pygltflib.Camera(name="camera", type=pygltflib.PERSPECTIVE, perspective=lens, extras=extras)


def _material(texture: bool) -> pygltflib.Material:
    surface = pygltflib.PbrMetallicRoughness(metallicFactor=0.0, roughnessFactor=0.65)
    if texture:
        surface.baseColorTexture = pygltflib.TextureInfo(index=0)
    return pygltflib.Material(name="skin", pbrMetallicRoughness=surface, alphaMode=pygltflib.OPAQUE, alphaCutoff=None)


def _texture(pool, person: FaceModel) -> tuple[list[pygltflib.Image], bool]:
    picture = bundled_texture(person)
    if picture is None:
        return [], False
    encoded = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    return [pygltflib.Image(name="albedo", bufferView=pool.view(encoded), mimeType="image/jpeg")], True


def _numbers(values: Float[np.ndarray, "..."]) -> list[float]:
    return np.asarray(values, float).tolist()


@dataclass
class _Buffer:
    """The binary part of the file, with what describes it."""

    data: bytearray = field(default_factory=bytearray)
    views: list[pygltflib.BufferView] = field(default_factory=list)
    accessors: list[pygltflib.Accessor] = field(default_factory=list)

    def view(self, content: bytes, target: int | None = None) -> int:
        """Bytes as a new view, aligned to four; `target` says whether they are vertices or indices."""
        self.data.extend(b"\0" * (-len(self.data) % 4))
        place = {"byteOffset": len(self.data), "byteLength": len(content)}
        self.views.append(pygltflib.BufferView(buffer=0, target=target, **place))
        self.data.extend(content)
        return len(self.views) - 1

    def add(self, values: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """An array as a new accessor; floating-point numbers in single precision."""
        if np.issubdtype(values.dtype, np.floating):
            values = values.astype(np.float32)
        values = np.ascontiguousarray(values)
        accessor = pygltflib.Accessor(
            bufferView=self.view(values.tobytes(), target),
            componentType=COMPONENTS[values.dtype],
            count=len(values),
            type=KINDS[values.shape[1:]],
        )
        if bounds:
            accessor.min = np.atleast_1d(values.min(0)).astype(float).tolist()
            accessor.max = np.atleast_1d(values.max(0)).astype(float).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1
