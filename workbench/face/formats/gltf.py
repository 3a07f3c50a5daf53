"""glTF 2.0 with morph targets (.glb, .gltf): the meshes of the face at rest, names from `extras.targetNames`.

A file may stand in the pose in which its clip begins. Skins are therefore read as they were bound, and what an
animation turns stands at the nearest right angle. Meshes without morph targets are kept where they lie within the ones
that have some (eyes, teeth); a body is left out. Compressed geometry is refused.
"""

import base64
import struct
from collections import deque
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.errors import ModelError
from workbench.face.checking import FARTHEST
from workbench.face.formats.placing import nearest_right_angle
from workbench.face.formats.raw import RawModel, check_mesh, ranges
from workbench.face.gaze import EYES
from workbench.reading import MOST_UNPACKED_BYTES, checked_content, checked_json, reading, shortened

COMPONENTS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES = 4
COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression")
EYE_NODES = {
    **dict.fromkeys(("lefteye", "eyeleft", "leye", "eyel"), "leftEye"),
    **dict.fromkeys(("righteye", "eyeright", "reye", "eyer"), "rightEye"),
}
"""Names of nodes at the eyes' centres, letters only, lower case."""


MOST_READ = 20_000
"""Arrays that are read, of one accessor or many: a face has hundreds."""


class _Part(NamedTuple):
    """One primitive, placed in the scene at rest."""

    vertices: np.ndarray
    triangles: np.ndarray
    targets: dict[str, np.ndarray]
    color: np.ndarray
    uv: np.ndarray | None
    eye_weights: np.ndarray
    """Shares that turn with the joints `EYES`."""


class _Binding(NamedTuple):
    """What the vertices of a primitive hang on."""

    skin: dict[str, Any]
    joints: np.ndarray
    """By vertex, up to four numbers in the skin's list."""
    shares: np.ndarray
    """Of each of them; their sum is 1."""


def read_gltf(path: Path) -> RawModel:
    """The face of a .glb or .gltf file. Raises `ModelError` for damaged files and files without morph targets."""
    content = checked_content(path, "glTF 2.0", ModelError)
    with reading(path, "glTF 2.0", "export it again", ModelError):
        return _face(path, _Document(path, content))


def _face(path: Path, document: "_Document") -> RawModel:
    parts = list(document.parts())
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
    if len(names) * vertices.nbytes > MOST_UNPACKED_BYTES:
        raise ModelError(
            f"{path}: {len(names)} morph targets of {len(vertices)} vertices are beyond 2 GB; reduce them."
        )
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
        eye_weights=np.concatenate([part.eye_weights for part in parts]) if len(eyes) == 2 else None,
        colors=np.concatenate([np.tile(part.color, (len(part.vertices), 1)) for part in parts]),
        # glTF counts v downwards.
        uv=np.concatenate([part.uv * [1.0, -1.0] + [0.0, 1.0] for part in parts]) if textured else None,
        triangles_uv=triangles if textured else None,
    )


class _Document:
    """The JSON of a glTF file with its buffers."""

    def __init__(self, path: Path, content: bytes) -> None:
        self._path, self._blob = path, b""
        self._read_bytes = self._read_count = 0
        text = content
        if content[:4] == b"glTF":
            text, self._blob = _chunks(path, content)
        self.json: dict[str, Any] = checked_json(text)
        compressed = [name for name in COMPRESSED if name in self.json.get("extensionsRequired", [])]
        if compressed:
            raise ModelError(f"{path} is compressed ({compressed[0]}); export it without compression.")
        self._buffers = [self._buffer(buffer) for buffer in self.json.get("buffers", [])]
        self._matrices = self._matrices_at_rest()

    def eyes(self) -> dict[str, np.ndarray]:
        """Centres of the eyes, where nodes are named after them."""
        places = ((self._eye_of(index), matrix[:3, 3]) for index, matrix in self._matrices.items())
        return {eye: place for eye, place in places if eye and np.any(place)}

    def _eye_of(self, index: int) -> str:
        """The eye that a node is named after; empty for others."""
        name = self._entry("nodes", index).get("name", "")
        if not isinstance(name, str):
            raise ValueError(f"node {index} has a name that is not text")
        return EYE_NODES.get("".join(letter for letter in name.lower() if letter.isalpha()), "")

    def parts(self) -> Iterator[_Part]:
        """The triangle primitives of the scene."""
        for index, matrix in self._matrices.items():
            node = self._entry("nodes", index)
            if "mesh" not in node:
                continue
            mesh = self._entry("meshes", node["mesh"])
            for primitive in mesh["primitives"]:
                if primitive.get("mode", TRIANGLES) == TRIANGLES:
                    yield self._part(mesh, primitive, node, matrix)

    def _entry(self, kind: str, index: Any) -> dict[str, Any]:
        """One entry of a list of the document."""
        entries = self.json.get(kind)
        if not isinstance(entries, list) or type(index) is not int or not 0 <= index < len(entries):
            raise ValueError(f"{kind} has no entry {shortened(index)}")
        return entries[index]

    def _part(self, mesh: dict, primitive: dict, node: dict, matrix: np.ndarray) -> _Part:
        attributes = primitive["attributes"]
        positions = self._vectors(attributes["POSITION"], None, 3)
        count = len(positions)
        binding = self._binding(attributes, node, count)
        placing = np.broadcast_to(matrix, (count, 4, 4)) if binding is None else self._placing(binding)
        indices = self._accessor(primitive["indices"]) if "indices" in primitive else np.arange(count)
        if indices.ndim != 1 or indices.dtype.kind not in "iu":
            raise ValueError("the corners of its triangles are not integers")
        names = (mesh.get("extras") or {}).get("targetNames", [])
        targets = {}
        for k, target in enumerate(primitive.get("targets", [])):
            named = isinstance(names, list) and k < len(names) and isinstance(names[k], str) and names[k]
            if "POSITION" in target:
                offsets = self._vectors(target["POSITION"], count, 3)
                targets[names[k] if named else f"target_{k:03d}"] = np.einsum("vij,vj->vi", placing[:, :3, :3], offsets)
        return _Part(
            vertices=np.einsum("vij,vj->vi", placing[:, :3, :3], positions) + placing[:, :3, 3],
            triangles=np.asarray(indices, np.int64).reshape(-1, 3),
            targets=targets,
            color=self._color(primitive),
            uv=self._vectors(attributes["TEXCOORD_0"], count, 2) if "TEXCOORD_0" in attributes else None,
            eye_weights=np.zeros((count, 2)) if binding is None else self._eye_weights(binding),
        )

    def _binding(self, attributes: dict, node: dict, count: int) -> _Binding | None:
        """What the vertices hang on; None for a mesh without a skin."""
        if "skin" not in node or "JOINTS_0" not in attributes:
            return None
        skin = self._entry("skins", node["skin"])
        weights = self._vectors(attributes["WEIGHTS_0"], count, 4)
        chosen = self._vectors(attributes["JOINTS_0"], count, 4)
        if chosen.dtype.kind not in "iu" or np.any(chosen < 0):
            raise ValueError("the joints of its skin are not integers")
        sums = weights.sum(1, keepdims=True)
        if not np.all(sums > 0.0):
            raise ValueError("vertices of its skin have no weight")
        return _Binding(skin, chosen, weights / sums)

    def _placing(self, binding: _Binding) -> np.ndarray:
        """One matrix per vertex, from the mesh to the scene as its skin is at rest."""
        joints = np.stack([self._matrices.get(joint, np.eye(4)) for joint in binding.skin["joints"]])
        if "inverseBindMatrices" in binding.skin:
            joints = joints @ self._inverse_bind(binding.skin)
        return np.einsum("vk,vkij->vij", binding.shares, joints[binding.joints])

    def _eye_weights(self, binding: _Binding) -> np.ndarray:
        eyes = [self._eye_of(joint) for joint in binding.skin["joints"]]
        on_eye = np.array([[name == eye for eye in EYES] for name in eyes], float)
        return np.einsum("vk,vke->ve", binding.shares, on_eye[binding.joints])

    def _vectors(self, index: Any, count: int | None, width: int) -> np.ndarray:
        """An accessor of `count` vectors. Raises ValueError for others."""
        vectors = self._accessor(index)
        if vectors.ndim != 2 or vectors.shape[1] != width or (count is not None and len(vectors) != count):
            raise ValueError(f"accessor {index} holds {vectors.shape}, expected ({count or 'n'}, {width})")
        return vectors

    def _color(self, primitive: dict) -> np.ndarray:
        material = self._entry("materials", primitive["material"]) if "material" in primitive else {}
        rough = material.get("pbrMetallicRoughness", {})
        # A texture is not read: its factor is mostly white, which would glare.
        plain = "baseColorTexture" not in rough and "baseColorFactor" in rough
        linear = _finite(rough["baseColorFactor"][:3] if plain else [0.52, 0.52, 0.52], 3)
        return np.round(255.0 * np.clip(linear, 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)

    def _matrices_at_rest(self) -> dict[int, np.ndarray]:
        """Node to scene, by node: joints where their skins were bound, what carries a face as no animation turns it."""
        animations = self.json.get("animations", [])
        targets = [channel["target"] for animation in animations for channel in animation["channels"]]
        turned = {target.get("node") for target in targets if target.get("path") == "rotation"}
        skins = [skin for skin in self.json.get("skins", []) if "inverseBindMatrices" in skin]
        joints = {joint for skin in skins for joint in skin["joints"]}
        straightened = (turned - joints) & self._above_faces()
        present = self._global_matrices(straightened, {})
        bound: dict[int, np.ndarray] = {}
        for skin in skins:
            inverse = dict(zip(skin["joints"], self._inverse_bind(skin), strict=True))
            top = next((node for node in present if node in inverse), None)
            if top is None:
                continue
            skinned = bound.get(top, present[top]) @ inverse[top]
            if top in turned and top not in bound:
                skinned[:3, :3] = _straightened(skinned[:3, :3])
                skinned[:3, 3] = present[top][:3, 3] - skinned[:3, :3] @ np.linalg.pinv(inverse[top])[:3, 3]
            for joint, matrix in inverse.items():
                bound.setdefault(joint, skinned @ np.linalg.pinv(matrix))
        return self._global_matrices(straightened, bound)

    def _above_faces(self) -> set[int]:
        """Nodes of meshes with morph targets, and those that they hang below."""
        nodes, above = self.json.get("nodes", []), set()
        parents = {child: index for index, node in enumerate(nodes) for child in node.get("children", [])}
        for index, node in enumerate(nodes):
            mesh = self._entry("meshes", node["mesh"]) if "mesh" in node else {}
            if any("targets" in primitive for primitive in mesh.get("primitives", [])):
                while index is not None and index not in above:
                    above.add(index)
                    index = parents.get(index)
        return above

    def _inverse_bind(self, skin: dict) -> np.ndarray:
        """From the mesh to each joint of a skin, as it was bound."""
        matrices = self._vectors(skin["inverseBindMatrices"], len(skin["joints"]), 16)
        return matrices.reshape(-1, 4, 4).transpose(0, 2, 1)

    def _global_matrices(self, straightened: Set[int], bound: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Node to scene, by node, for the nodes of the scene; those of `bound` as it says."""
        nodes = self.json.get("nodes", [])
        scenes = self.json.get("scenes", [])
        roots = self._entry("scenes", self.json.get("scene", 0)).get("nodes", []) if scenes else range(len(nodes))
        found: dict[int, np.ndarray] = {}
        waiting = deque((root, np.eye(4)) for root in roots)
        while waiting:
            index, parent = waiting.popleft()
            node = self._entry("nodes", index)
            if index in found:
                raise ModelError(f"{self._path}: node {index} has two parents; the file is damaged.")
            local = _local_matrix(node)
            if index in straightened:
                local[:3, :3] = _straightened(local[:3, :3])
            found[index] = bound.get(index, parent @ local)
            waiting.extend((child, found[index]) for child in node.get("children", []))
        return found

    def _accessor(self, index: Any) -> np.ndarray:
        """The numbers of an accessor, (count, width) or (count,); normalised integers as fractions."""
        accessor = self._entry("accessors", index)
        dtype, width = np.dtype(COMPONENTS[accessor["componentType"]]), WIDTHS[accessor["type"]]
        count = _natural(accessor["count"])
        self._spend(count * width * np.dtype(float).itemsize)
        if "bufferView" in accessor:
            values = self._view(accessor["bufferView"], accessor.get("byteOffset", 0), dtype, width, count)
        elif count > sum(map(len, self._buffers)):
            raise ModelError(f"{self._path}: an accessor declares {count} entries that no buffer holds.")
        else:
            values = np.zeros((count, width), dtype)
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            where, new = sparse["indices"], sparse["values"]
            kind, changed = np.dtype(COMPONENTS[where["componentType"]]), _natural(sparse["count"])
            rows = self._view(where["bufferView"], where.get("byteOffset", 0), kind, 1, changed)[:, 0]
            if kind.kind != "u" or np.any(rows >= count):
                raise ValueError(f"the sparse accessor {index} changes entries that it does not have")
            values[rows] = self._view(new["bufferView"], new.get("byteOffset", 0), dtype, width, changed)
        if accessor.get("normalized") and dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(dtype).max, -1.0)
        values = values.astype(float) if values.dtype.kind == "f" else values
        return values[:, 0] if width == 1 else values

    def _spend(self, size: int) -> None:
        """Count what is read: a few bytes of JSON may ask for the same array again and again."""
        self._read_bytes, self._read_count = self._read_bytes + size, self._read_count + 1
        if self._read_bytes > MOST_UNPACKED_BYTES or self._read_count > MOST_READ:
            raise ModelError(
                f"{self._path}: its accessors ask for more than 2 GB or {MOST_READ} arrays; reduce the file."
            )

    def _view(self, index: Any, offset: Any, dtype: np.dtype, width: int, count: int) -> np.ndarray:
        view = self._entry("bufferViews", index)
        buffer = _natural(view["buffer"])
        data = self._buffers[buffer]
        start, length, offset = _natural(view.get("byteOffset", 0)), _natural(view["byteLength"]), _natural(offset)
        size = dtype.itemsize * width
        stride = _natural(view.get("byteStride", size))
        if stride < size:
            raise ValueError(f"entries of {size} bytes are {stride} bytes apart")
        if count and (offset + (count - 1) * stride + size > length or start + length > len(data)):
            raise ModelError(f"{self._path}: an accessor reaches beyond its buffer; the file is cut off or damaged.")
        rows = np.frombuffer(data, np.uint8, count=(count - 1) * stride + size, offset=start + offset) if count else b""
        strided = np.lib.stride_tricks.as_strided(np.frombuffer(rows, np.uint8), (count, size), (stride, 1))
        return np.ascontiguousarray(strided).view(dtype).reshape(count, width).copy()

    def _buffer(self, buffer: dict) -> bytes:
        uri = buffer.get("uri")
        if uri is None:
            return self._blob
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        path = (self._path.parent / unquote(uri)).resolve()
        if not path.is_relative_to(self._path.parent.resolve()) or not path.is_file():
            raise ModelError(
                f"{self._path} needs {shortened(uri)} next to it; copy the whole folder, or export a .glb."
            )
        return checked_content(path, "a buffer of glTF", ModelError)


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
        return _finite(node["matrix"], 16).reshape(4, 4).T
    matrix = np.eye(4)
    rotation = Rotation.from_quat(_finite(node.get("rotation", [0.0, 0.0, 0.0, 1.0]), 4)).as_matrix()
    matrix[:3, :3] = rotation * _finite(node.get("scale", [1.0, 1.0, 1.0]), 3)
    matrix[:3, 3] = _finite(node.get("translation", [0.0, 0.0, 0.0]), 3)
    return matrix


def _straightened(linear: np.ndarray) -> np.ndarray:
    """The map with its turn replaced by the nearest one by right angles."""
    left, _, right = np.linalg.svd(linear)
    turn = np.sign(np.linalg.det(linear)) * left @ right  # of a mirrored map, that of the one it mirrors
    return nearest_right_angle(turn) @ turn.T @ linear


def _finite(values: Any, count: int) -> np.ndarray:
    """So many numbers. Raises ValueError for anything else."""
    numbers = np.array(values, float)
    if numbers.shape != (count,) or not np.all(np.abs(numbers) <= FARTHEST):
        raise ValueError(f"expected {count} numbers, got {shortened(values)}")
    return numbers


def _natural(value: Any) -> int:
    """A count or place in the file. Raises ValueError for anything else."""
    if type(value) is not int or value < 0:
        raise ValueError(f"expected a whole number from 0, got {shortened(value)}")
    return value
