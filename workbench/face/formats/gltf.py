"""glTF 2.0 with morph targets (.glb, .gltf): the meshes of the face at rest, names from `extras.targetNames`.

Node transforms and skins are applied at the rest pose. Meshes without morph targets are kept where they lie within the
ones that have some (eyes, teeth); a body is left out. Compressed geometry is refused.
"""

import base64
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.errors import ModelError
from workbench.face.formats.raw import RawModel, check_mesh, ranges

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES = 4
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
EYE_NODES = {
    **dict.fromkeys(("lefteye", "eyeleft", "leye", "eyel"), "leftEye"),
    **dict.fromkeys(("righteye", "eyeright", "reye", "eyer"), "rightEye"),
}
"""Names of nodes at the eyes' centres, letters only, lower case."""


_BROKEN = (KeyError, IndexError, TypeError, ValueError, AttributeError, struct.error, OverflowError, OSError)
"""What goes wrong where a broken file is followed."""


class _Part(NamedTuple):
    """One primitive, placed in the scene at rest."""

    vertices: np.ndarray
    triangles: np.ndarray
    targets: dict[str, np.ndarray]
    color: np.ndarray
    uv: np.ndarray | None


def read_gltf(path: Path) -> RawModel:
    """The face of a .glb or .gltf file. Raises `ModelError` for damaged files and files without morph targets."""
    try:
        document = _Document(path)
        parts = list(document.parts())
    except ModelError:
        raise
    except _BROKEN as error:
        raise ModelError(f"{path} cannot be read as glTF 2.0 ({type(error).__name__}: {error}).") from error
    moving = [part for part in parts if part.targets]
    if not moving:
        raise ModelError(f"{path} has no morph targets; export the face with its shape keys.")
    corners = np.concatenate([part.vertices for part in moving])
    lowest, highest = corners.min(0), corners.max(0)

    def within(part: _Part) -> bool:
        centre = part.vertices.mean(0)
        return bool(np.all((lowest < centre) & (centre < highest)))

    return _joined(path, [part for part in parts if part.targets or within(part)], document.eyes())


def _joined(path: Path, parts: list[_Part], eyes: dict[str, np.ndarray]) -> RawModel:
    names = tuple(dict.fromkeys(name for part in parts for name in part.targets))
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts])
    triangles = np.concatenate([part.triangles + start for part, start in zip(parts, starts, strict=False)])
    deltas = np.zeros((len(names), len(vertices), 3))
    for part, start in zip(parts, starts, strict=False):
        for name, target in part.targets.items():
            deltas[names.index(name), start : start + len(part.vertices)] += target
    check_mesh(path, vertices, triangles, {"morph targets": deltas})
    textured = all(part.uv is not None for part in parts)
    return RawModel(
        name=path.stem,
        vertices=vertices,
        triangles=triangles,
        expression_names=names,
        expression_deltas=deltas,
        expression_range=ranges(len(names)),
        joints=eyes if len(eyes) == 2 else {},
        colors=np.concatenate([np.tile(part.color, (len(part.vertices), 1)) for part in parts]),
        # glTF counts v downwards.
        uv=np.concatenate([part.uv * [1.0, -1.0] + [0.0, 1.0] for part in parts]) if textured else None,
        triangles_uv=triangles if textured else None,
    )


class _Document:
    """The JSON of a glTF file with its buffers."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        self._path, self._blob = path, b""
        text = content
        if content[:4] == b"glTF":
            text, self._blob = _chunks(path, content)
        self.json: dict[str, Any] = json.loads(text)
        compressed = [name for name in COMPRESSED if name in self.json.get("extensionsRequired", [])]
        if compressed:
            raise ModelError(f"{path} is compressed ({compressed[0]}); export it without compression.")
        self._buffers = [self._buffer(buffer) for buffer in self.json.get("buffers", [])]
        self._matrices = self._global_matrices()

    def eyes(self) -> dict[str, np.ndarray]:
        """Centres of the eyes, where nodes are named after them."""
        found = {}
        for index, matrix in self._matrices.items():
            letters = "".join(
                letter for letter in self.json["nodes"][index].get("name", "").lower() if letter.isalpha()
            )
            if letters in EYE_NODES and np.any(matrix[:3, 3]):
                found[EYE_NODES[letters]] = matrix[:3, 3]
        return found

    def parts(self) -> Iterator[_Part]:
        """The triangle primitives of the scene."""
        for index, matrix in self._matrices.items():
            node = self.json["nodes"][index]
            if "mesh" not in node:
                continue
            mesh = self.json["meshes"][node["mesh"]]
            for primitive in mesh["primitives"]:
                if primitive.get("mode", TRIANGLES) == TRIANGLES:
                    yield self._part(mesh, primitive, self._placing(primitive, node, matrix))

    def _part(self, mesh: dict, primitive: dict, placing: np.ndarray) -> _Part:
        attributes = primitive["attributes"]
        positions = self._accessor(attributes["POSITION"])
        indices = self._accessor(primitive["indices"]) if "indices" in primitive else np.arange(len(positions))
        names = (mesh.get("extras") or {}).get("targetNames", [])
        targets = {}
        for k, target in enumerate(primitive.get("targets", [])):
            name = str(names[k]) if k < len(names) else f"target_{k:03d}"
            if "POSITION" in target:
                offsets = self._accessor(target["POSITION"])
                targets[name] = np.einsum("vij,vj->vi", placing[:, :3, :3], offsets)
        return _Part(
            vertices=np.einsum("vij,vj->vi", placing[:, :3, :3], positions) + placing[:, :3, 3],
            triangles=np.asarray(indices, np.int64).reshape(-1, 3),
            targets=targets,
            color=self._color(primitive),
            uv=self._accessor(attributes["TEXCOORD_0"]) if "TEXCOORD_0" in attributes else None,
        )

    def _placing(self, primitive: dict, node: dict, matrix: np.ndarray) -> np.ndarray:
        """A matrix a vertex, from the mesh to the scene: the node's, or the skin's at rest."""
        attributes = primitive["attributes"]
        count = self.json["accessors"][attributes["POSITION"]]["count"]
        if "skin" not in node or "JOINTS_0" not in attributes:
            return np.broadcast_to(matrix, (count, 4, 4))
        skin = self.json["skins"][node["skin"]]
        joints = np.stack([self._matrices.get(joint, np.eye(4)) for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            joints = joints @ self._accessor(skin["inverseBindMatrices"]).reshape(-1, 4, 4).transpose(0, 2, 1)
        weights = self._accessor(attributes["WEIGHTS_0"])
        chosen = self._accessor(attributes["JOINTS_0"]).astype(int)
        return np.einsum("vk,vkij->vij", weights / weights.sum(1, keepdims=True), joints[chosen])

    def _color(self, primitive: dict) -> np.ndarray:
        material = self.json["materials"][primitive["material"]] if "material" in primitive else {}
        rough = material.get("pbrMetallicRoughness", {})
        # A texture is not read: its factor is mostly white, which would glare.
        plain = "baseColorTexture" not in rough and "baseColorFactor" in rough
        linear = np.array(rough["baseColorFactor"][:3] if plain else [0.52, 0.52, 0.52], float)
        return np.round(255.0 * np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)

    def _global_matrices(self) -> dict[int, np.ndarray]:
        """Node to scene, by node, for the nodes of the scene."""
        nodes = self.json.get("nodes", [])
        scenes = self.json.get("scenes", [])
        roots = scenes[self.json.get("scene", 0)].get("nodes", []) if scenes else range(len(nodes))
        found: dict[int, np.ndarray] = {}
        waiting = [(root, np.eye(4)) for root in roots]
        while waiting:
            index, parent = waiting.pop(0)
            if index in found:
                raise ModelError(f"{self._path}: node {index} hangs below two nodes; the file is damaged.")
            found[index] = parent @ _local_matrix(nodes[index])
            waiting += [(child, found[index]) for child in nodes[index].get("children", [])]
        return found

    def _accessor(self, index: int) -> np.ndarray:
        """The numbers of an accessor, (count, width) or (count,); normalised integers as fractions."""
        accessor = self.json["accessors"][index]
        dtype, width, count = (
            np.dtype(COMPONENTS[accessor["componentType"]]),
            WIDTHS[accessor["type"]],
            accessor["count"],
        )
        if "bufferView" in accessor:
            values = self._view(accessor["bufferView"], accessor.get("byteOffset", 0), dtype, width, count)
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            where, new = sparse["indices"], sparse["values"]
            kind = np.dtype(COMPONENTS[where["componentType"]])
            rows = self._view(where["bufferView"], where.get("byteOffset", 0), kind, 1, sparse["count"])
            values[rows[:, 0]] = self._view(new["bufferView"], new.get("byteOffset", 0), dtype, width, sparse["count"])
        if accessor.get("normalized") and dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(dtype).max, -1.0)
        values = values.astype(float) if values.dtype.kind == "f" else values
        return values[:, 0] if width == 1 else values

    def _view(self, index: int, offset: int, dtype: np.dtype, width: int, count: int) -> np.ndarray:
        view = self.json["bufferViews"][index]
        data = self._buffers[view["buffer"]]
        start, length = view.get("byteOffset", 0), view["byteLength"]
        size = dtype.itemsize * width
        stride = view.get("byteStride", size)
        if min(start, offset, count) < 0 or (
            count and (offset + (count - 1) * stride + size > length or start + length > len(data))
        ):
            raise ModelError(f"{self._path}: an accessor reaches beyond its buffer; the file is cut off or damaged.")
        rows = np.frombuffer(data, np.uint8, count=(count - 1) * stride + size if count else 0, offset=start + offset)
        strided = np.lib.stride_tricks.as_strided(rows, (count, size), (stride, 1))
        return np.ascontiguousarray(strided).view(dtype).reshape(count, width).copy()

    def _buffer(self, buffer: dict) -> bytes:
        uri = buffer.get("uri")
        if uri is None:
            return self._blob
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        path = (self._path.parent / unquote(uri)).resolve()
        if not path.is_relative_to(self._path.parent.resolve()) or not path.is_file():
            raise ModelError(f"{self._path} needs {uri} beside it; copy the whole folder, or export a .glb.")
        return path.read_bytes()


def _chunks(path: Path, content: bytes) -> tuple[bytes, bytes]:
    """JSON and binary chunk of a .glb."""
    _, version, length = struct.unpack_from("<4sII", content)
    if version != 2 or length > len(content):
        raise ModelError(
            f"{path} is glTF {version}.0 of {length} bytes, got {len(content)}; supply a whole glTF 2.0 file."
        )
    found, place = {}, 12
    while place + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, place)
        found.setdefault(kind, content[place + 8 : place + 8 + size])
        place += 8 + size
    return found[b"JSON"], found.get(b"BIN\0", b"")


def _local_matrix(node: dict) -> np.ndarray:
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    matrix = np.eye(4)
    rotation = Rotation.from_quat(node.get("rotation", [0.0, 0.0, 0.0, 1.0])).as_matrix()
    matrix[:3, :3] = rotation * np.array(node.get("scale", [1.0, 1.0, 1.0]), float)
    matrix[:3, 3] = node.get("translation", [0.0, 0.0, 0.0])
    return matrix
