"""glTF 2.0 (.glb): the person's head, blendshapes as morph targets, joints of jaw and eyes, camera and animation."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from workbench.export.clip import FLIP, Clip, quaternions, to_world
from workbench.export.gltf_buffer import INDICES, VERTICES, Buffer
from workbench.export.gltf_parts import AddedParts, add_parts, add_skin, embedded
from workbench.export.looks import SKIN
from workbench.export.skinning import Joint, Shapes, beside_joints, clip_joints, clip_shapes, joint_shares
from workbench.extras import needs
from workbench.face import DressedHead, FaceModel
from workbench.files import atomic_path
from workbench.geometry import Camera
from workbench.pictures.head_picture import bundled_texture
from workbench.pictures.mesh import corner_sum, split_seams, vertex_normals

with needs("formats"):
    import pygltflib

NEAR_M, FAR_M = 0.01, 100.0
SMOOTH = pygltflib.Sampler(magFilter=pygltflib.LINEAR, minFilter=pygltflib.LINEAR_MIPMAP_LINEAR)


def write_gltf(clip: Clip, path: str | Path, dressed: DressedHead | None = None) -> None:
    """Write a binary glTF that other programs play.

    Nodes: `camera` in the origin, `head` (animated; a joint), below it `jaw` and, where eyes turn, `leftEye` and
    `rightEye`, and `face`, the mesh that they move. Morph targets have the blendshapes' names (`extras.targetNames`);
    those of a look move lids and skin, the eyeballs turn with their joints. Keys lie at the times of the frames with a
    face. Vertices along the seams of the texture are doubled, as the format wants it. With `dressed` the character
    plays: the face has its skin, and each part that it wears is a node of its own, with the same morph targets if it
    moves.
    """
    document = _document(clip, dressed)
    with atomic_path(path) as temporary:
        document.save_binary(str(temporary))


def _document(clip: Clip, dressed: DressedHead | None) -> pygltflib.GLTF2:
    person, track = clip.person, clip.track
    pool = Buffer()
    corners, uv_corners, triangles = render_corners(person)
    triangles = triangles if dressed is None else triangles[dressed.shown]
    found = np.flatnonzero(track.found)
    joints = clip_joints(clip)
    shapes = beside_joints(clip_shapes(clip), joints)
    picture = bundled_texture(person) if dressed is None else dressed.skin
    textured = picture is not None
    mesh = _mesh(pool, person, shapes, corners, uv_corners, triangles, shapes.weights[found[0]], joints, textured)
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
    if joints:
        # A mesh that joints move stands beside them: its own place does not count.
        places = to_world(np.stack([joint.place for joint in joints]))
        nodes += [
            pygltflib.Node(name=joint.name, translation=_numbers(place))
            for joint, place in zip(joints, places, strict=True)
        ]
        below = list(range(3, len(nodes)))
        nodes[1].children, nodes[2].skin = below, 0
        inverse = np.tile(np.eye(4), (1 + len(joints), 1, 1))
        inverse[1:, :3, 3] = -places
        bind = pool.add(inverse.transpose(0, 2, 1))  # column-major
        skins = [pygltflib.Skin(name="head", joints=[1, *below], skeleton=1, inverseBindMatrices=bind)]
        scene.append(2)
    else:
        nodes[1].children = [2]
    images = [] if picture is None else [embedded(pool, "albedo", picture)]
    worn = add_parts(pool, clip, shapes, joints, dressed, found[0], len(images)) if dressed else AddedParts()
    moving = [2]
    for number, (node, follows) in enumerate(zip(worn.nodes, worn.follow, strict=True), len(nodes)):
        moving += [number] if follows else []
        if follows and joints:
            node.skin = 0
            scene.append(number)
        else:
            nodes[1].children = [*(nodes[1].children or []), number]
    nodes += worn.nodes
    images += worn.images
    named = {"character": dressed.character.name} if dressed else {}
    document = pygltflib.GLTF2(
        asset=pygltflib.Asset(version="2.0", generator="Face Energy Workbench"),
        scene=0,
        scenes=[pygltflib.Scene(name="performance", nodes=scene)],
        nodes=nodes,
        meshes=[mesh, *worn.meshes],
        skins=skins,
        cameras=[_camera(clip.camera, clip.image_size)],
        materials=[_material(textured), *worn.materials],
        animations=[_animation(pool, clip, shapes, joints, found, moving)],
        images=images,
        textures=[pygltflib.Texture(source=source, sampler=0) for source in range(len(images))],
        samplers=[SMOOTH] if images else [],
        extras={"frames_per_second": clip.rate, "frames": len(track), "model": person.name} | named,
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
    pool, person: FaceModel, shapes: Shapes, corners, uv_corners, triangles, weights, joints: tuple[Joint, ...],
    textured: bool,
) -> pygltflib.Mesh:  # fmt: skip
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
    if not textured:
        linear = ((person.colors[corners] / 255.0) ** 2.2).astype(np.float32)
        attributes.COLOR_0 = pool.add(linear, VERTICES)
    if joints:
        add_skin(pool, attributes, joint_shares(joints, len(person.neutral))[corners])
    targets = [
        {
            "POSITION": pool.add(to_world(delta[corners]), VERTICES, bounds=True),
            "NORMAL": pool.add(normals(person.neutral + delta) - neutral, VERTICES),
        }
        for delta in shapes.deltas
    ]
    indices = pool.add(triangles.astype(np.uint32 if len(corners) > 65_535 else np.uint16).ravel(), INDICES)
    return pygltflib.Mesh(
        name="face",
        primitives=[pygltflib.Primitive(attributes=attributes, indices=indices, material=0, targets=targets)],
        weights=_numbers(weights),
        extras={"targetNames": list(shapes.names)} if shapes.names else {},
    )


def _animation(
    pool, clip: Clip, shapes: Shapes, joints: tuple[Joint, ...], found: Int[np.ndarray, "m"], moving: list[int]
) -> pygltflib.Animation:
    """Curves of head, jaw and eyes, and the weights of all nodes that have the morph targets."""
    track = clip.track
    times = pool.add(clip.times_s[found], bounds=True)
    curves = {
        (1, "translation"): to_world(track.translation[found]),
        (1, "rotation"): quaternions(track.rotation[found]),
    }
    if shapes.names:
        curves[2, "weights"] = shapes.weights[found].ravel()
    if clip.moves_scale:
        curves[1, "scale"] = np.repeat(track.scale[found, None], 3, axis=1)
    for node, joint in enumerate(joints, 3):
        if joint.shifts is not None:
            curves[node, "translation"] = to_world(joint.place + joint.shifts[found])
        if joint.turns is not None:
            curves[node, "rotation"] = quaternions(joint.turns[found])
    made = pygltflib.Animation(name="performance")
    for number, ((node, path), values) in enumerate(curves.items()):
        made.samplers.append(pygltflib.AnimationSampler(input=times, output=pool.add(values)))
        target = pygltflib.AnimationChannelTarget(node=node, path=path)
        made.channels.append(pygltflib.AnimationChannel(sampler=number, target=target))
        if path == "weights":
            targets = [pygltflib.AnimationChannelTarget(node=other, path=path) for other in moving if other != node]
            made.channels += [pygltflib.AnimationChannel(sampler=number, target=other) for other in targets]
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
    surface = pygltflib.PbrMetallicRoughness(metallicFactor=0.0, roughnessFactor=SKIN.roughness)
    if texture:
        surface.baseColorTexture = pygltflib.TextureInfo(index=0)
    return pygltflib.Material(name="skin", pbrMetallicRoughness=surface, alphaMode=pygltflib.OPAQUE, alphaCutoff=None)


def _numbers(values: Float[np.ndarray, "..."]) -> list[float]:
    return np.asarray(values, float).tolist()
