"""Small files in the real formats of face models, written from a person that is made of the default head.

The mesh is the outer face and the eyes, cut from the head and numbered anew, so that nothing of the default head's
topology helps a reader. `Subject` is the truth in the head frame; each writer takes it to the axes, unit and layout of
its format.
"""

import io
import json
import pickle
import struct
import sys
import types
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import h5py
import numpy as np
import pygltflib
import scipy.io
import scipy.sparse

from workbench.face import Embedding, FaceModel, load_default_head

SHAPES = ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "mouthPucker", "browInnerUp", "eyeBlinkLeft", "eyeBlinkRight")
COMPONENTS = 10
IDENTITY = np.eye(3)
OFFSET = np.array([0.02, -0.25, 0.04])
"""Where the files put the head, metres: formats do not agree on an origin."""


@dataclass(frozen=True)
class Subject:
    """The truth: head frame, millimetres."""

    vertices: np.ndarray
    triangles: np.ndarray
    landmarks: Embedding
    contours: dict[float, np.ndarray]
    """The 17 points of the jaw contour by head yaw in degrees."""
    shapes: dict[str, np.ndarray]
    identity: np.ndarray
    expressions: np.ndarray
    joints: dict[str, np.ndarray]
    jaw_weights: np.ndarray


def make_subject(seed: int = 3) -> Subject:
    """A person that is not the mean."""
    head = load_default_head(gaze=True)
    rng = np.random.default_rng(seed)
    person = head.personal(0.6 * rng.normal(size=50))
    keep = np.zeros(len(person.neutral), bool)
    for region in ("skin", "lips", "brow", "scalp", "eyeL", "eyeR"):
        keep[person.regions[region]] = True
    kept = rng.permutation(np.flatnonzero(keep))
    number = np.full(len(keep), -1)
    number[kept] = np.arange(len(kept))
    mixed = np.linalg.qr(rng.normal(size=(len(SHAPES), len(SHAPES))))[0]
    shapes = {name: person.expression_deltas[person.expression_names.index(name)][kept] for name in SHAPES}
    components = 0.4 * np.tensordot(mixed, np.stack(list(shapes.values())), axes=1)
    rest = COMPONENTS - len(components)
    return Subject(
        vertices=person.neutral[kept],
        triangles=number[person.triangles[keep[person.triangles].all(1)]],
        landmarks=Embedding(number[person.landmarks.vertices].astype(np.int32), person.landmarks.barycentric),
        contours=dict(zip(person.contour_yaw_deg.tolist(), person.contour.of(person.neutral), strict=True)),
        shapes=shapes,
        identity=head.identity_deltas[:COMPONENTS][:, kept],
        expressions=np.concatenate([components, 0.2 * components[:rest] * rng.uniform(0.5, 1.0, (rest, len(kept), 1))]),
        joints={name: person.joints[name] for name in ("jaw", "neck", "leftEye", "rightEye")},
        jaw_weights=person.jaw_weights[kept],
    )


def small_subject(seed: int = 5) -> Subject:
    """A curved patch of 72 vertices: no face, but all that a file of one holds, and read in a millisecond."""
    rng = np.random.default_rng(seed)
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(-60.0, 60.0, 9), np.linspace(-70.0, 70.0, 8)))
    vertices = np.stack([x, y, 0.01 * (x**2 + y**2)], axis=-1)
    corner = np.flatnonzero((np.arange(72) % 9 < 8) & (np.arange(72) < 63))
    triangles = np.stack([corner, corner + 1, corner + 9], axis=-1)
    numbers = np.arange(68)
    landmarks = Embedding(np.stack([numbers] * 3, axis=-1).astype(np.int32), np.tile([1.0, 0.0, 0.0], (68, 1)))
    return Subject(
        vertices=vertices,
        triangles=triangles,
        landmarks=landmarks,
        contours={},
        shapes={name: rng.normal(size=vertices.shape) for name in SHAPES},
        identity=rng.normal(size=(COMPONENTS, 72, 3)),
        expressions=rng.normal(size=(COMPONENTS, 72, 3)),
        joints={"jaw": np.zeros(3), "neck": np.ones(3), "leftEye": vertices[40], "rightEye": vertices[36]},
        jaw_weights=np.linspace(0.0, 1.0, 72),
    )


def y_up(points: np.ndarray, unit_mm: float = 1000.0) -> np.ndarray:
    """Points (or offsets) of the head frame with +y up and +z out of the face, in a unit of so many millimetres."""
    return points * [1.0, -1.0, -1.0] / unit_mm


# --- FLAME ----------------------------------------------------------------------------------------------------------


def flame_arrays(subject: Subject) -> dict[str, object]:
    """What a FLAME pickle holds: 20 shape directions, sparse regressor, skinning weights."""
    directions = np.concatenate([subject.identity, subject.expressions])
    weights = np.zeros((len(subject.vertices), 5))
    weights[:, 2] = subject.jaw_weights
    weights[:, 1] = 1.0 - subject.jaw_weights
    places = [subject.joints[name] for name in ("neck", "neck", "jaw", "leftEye", "rightEye")]
    return {
        "v_template": y_up(subject.vertices) + OFFSET,
        "f": subject.triangles.astype(np.uint32),
        "shapedirs": np.moveaxis(y_up(directions), 0, -1),
        "posedirs": np.zeros((len(subject.vertices), 3, 36)),
        "J_regressor": scipy.sparse.csc_matrix(np.stack([_regressor(subject.vertices, place) for place in places])),
        "kintree_table": np.array([[4294967295, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.uint32),
        "weights": weights,
        "bs_style": "lbs",
        "bs_type": "lrotmin",
    }


def flame_embedding(subject: Subject) -> dict[str, np.ndarray]:
    """The static embedding: 51 landmarks by triangle and barycentric weights."""
    faces, weights = [], []
    for corners, inside in zip(subject.landmarks.vertices[17:], subject.landmarks.barycentric[17:], strict=True):
        used = corners[inside > 1e-6]
        face = int(np.flatnonzero(_holds(subject.triangles, used))[0])
        faces.append(face)
        weights.append([inside[corners == corner].sum() for corner in subject.triangles[face]])
    return {"lmk_face_idx": np.array(faces, np.uint32), "lmk_b_coords": np.array(weights)}


def _holds(triangles: np.ndarray, corners: np.ndarray) -> np.ndarray:
    return np.all([np.any(triangles == corner, axis=1) for corner in corners], axis=0)


def _regressor(vertices: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Weights of nearby vertices that sum to one and give the place."""
    near = np.argsort(np.linalg.norm(vertices - place, axis=1))[:200]
    weights, places = np.zeros(len(vertices)), np.vstack([vertices[near].T, np.ones(len(near))])
    weights[near] = np.linalg.lstsq(places, np.append(place, 1.0), rcond=None)[0]
    return weights


class Python2Pickler(pickle._Pickler):
    """Texts and bytes as the one `str` of Python 2: the bytes of arrays are latin-1 texts."""

    dispatch: ClassVar = dict(pickle._Pickler.dispatch)

    def save_text(self, text: str | bytes) -> None:
        data = text.encode("latin-1") if isinstance(text, str) else text
        short = len(data) < 256
        head = b"U" + bytes([len(data)]) if short else b"T" + struct.pack("<i", len(data))
        self.write(head + data)
        self.memoize(text)

    dispatch[str] = dispatch[bytes] = save_text


def python2_pickle(value: object) -> bytes:
    """Protocol 2 as Python 2 with old NumPy, SciPy and chumpy wrote it."""
    stream = io.BytesIO()
    Python2Pickler(stream, protocol=2).dump(value)
    written = stream.getvalue()
    for new, old in ((b"numpy._core.", b"numpy.core."), (b"scipy.sparse._csc", b"scipy.sparse.csc")):
        written = written.replace(b"c" + new, b"c" + old)
    return written


def chumpy_wrapped(array: np.ndarray) -> object:
    """The array in a `chumpy.ch.Ch`, whose state holds it as x; the package itself is not needed."""
    module = sys.modules.setdefault("chumpy.ch", types.ModuleType("chumpy.ch"))
    sys.modules.setdefault("chumpy", types.ModuleType("chumpy"))
    if not hasattr(module, "Ch"):
        module.Ch = type("Ch", (), {"__module__": "chumpy.ch"})
    wrapped = module.Ch()
    wrapped.__dict__.update(x=array, _dirty_vars=set(), _itr=None, _status="new")
    return wrapped


class Calls:
    """Pickles as a call of a function: what a hostile file would run."""

    def __init__(self, function: object, *arguments: object) -> None:
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


# --- the others -----------------------------------------------------------------------------------------------------


def write_gnm(path: Path, subject: Subject, expressions: np.ndarray, names: list[str], turn=IDENTITY) -> Path:
    """GNM Head: plain arrays by their published names; `turn` takes y-up axes to the file's."""
    count, people = len(subject.vertices), len(subject.identity)
    joints = [(y_up(subject.joints[name]) + OFFSET) @ turn.T for name in ("neck", "leftEye", "rightEye")]
    np.savez(
        path,
        version="3.0",
        variant="head",
        template_vertex_positions=((y_up(subject.vertices) + OFFSET) @ turn.T).astype(np.float32),
        template_joint_positions=np.array(joints),
        vertex_identity_basis=y_up(subject.identity) @ turn.T,
        joint_identity_basis=np.zeros((people, 3, 3)),
        expression_basis=y_up(expressions) @ turn.T,
        expression_names=names,
        identity_names=[f"head_{k}" for k in range(people)],
        joint_names=["neck", "left_eye", "right_eye"],
        triangles=subject.triangles,
        mirror_indices=np.arange(count),
        vertex_groups=np.stack([np.ones(count), subject.vertices[:, 0] > 0]),
        vertex_group_names=["skin", "left"],
    )
    return path


def write_basel_2009(path: Path, subject: Subject) -> Path:
    """MATLAB, micrometres, components of unit norm with their deviations, triangles counted from 1, wound inwards."""
    basis, deviation = _unit_basis(y_up(subject.identity, 0.001))
    scipy.io.savemat(
        path,
        {
            "shapeMU": (y_up(subject.vertices, 0.001)).reshape(-1, 1).astype(np.float32),
            "shapePC": basis,
            "shapeEV": deviation[:, None],
            "texMU": np.full((3 * len(subject.vertices), 1), 120.0, np.float32),
            "tl": subject.triangles[:, [0, 2, 1]] + 1,
        },
    )
    return path


def write_basel_2019(path: Path, subject: Subject, points: dict[str, int]) -> Path:
    """HDF5 of scalismo, millimetres; `points` are named landmarks by iBUG number."""
    moved = OFFSET * 1000.0
    with h5py.File(path, "w") as stored:
        for part, mean, deltas in (
            ("shape", y_up(subject.vertices, 1.0) + moved, subject.identity),
            ("expression", np.zeros_like(subject.vertices), subject.expressions),
        ):
            basis, deviation = _unit_basis(y_up(deltas, 1.0))
            stored[f"{part}/model/mean"] = mean.ravel().astype(np.float32)
            stored[f"{part}/model/pcaBasis"] = basis
            stored[f"{part}/model/pcaVariance"] = deviation**2
        stored["shape/representer/cells"] = subject.triangles.T.astype(np.int32)
        stored["shape/representer/points"] = (y_up(subject.vertices, 1.0) + moved).T
        stored["color/model/mean"] = np.full(3 * len(subject.vertices), 0.5, np.float32)
        places = subject.landmarks.of(subject.vertices)
        listed = [
            {"id": name, "coordinates": (y_up(places[number], 1.0) + moved).tolist()} for name, number in points.items()
        ]
        stored["metadata/landmarks/json"] = np.array([json.dumps(listed)], h5py.string_dtype())
    return path


def _unit_basis(deltas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    flat = deltas.reshape(len(deltas), -1)
    deviation = np.linalg.norm(flat, axis=1)
    return (flat / deviation[:, None]).T, deviation


def write_obj(path: Path, vertices: np.ndarray, triangles: np.ndarray, textured: bool = False) -> None:
    """An OBJ file; `textured` with one texture corner a triangle corner, as files with seams have them."""
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices]
    if textured:
        lines += [f"vt {k / (3 * len(triangles)):.6f} 0.5" for k in range(3 * len(triangles))]
        corners = np.arange(3 * len(triangles)).reshape(-1, 3)
        lines += [
            "f " + " ".join(f"{vertex + 1}/{corner + 1}" for vertex, corner in zip(face, texture, strict=True))
            for face, texture in zip(triangles, corners, strict=True)
        ]
    else:
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles]
    path.write_text("\n".join(lines) + "\n")


def write_ict(folder: Path, subject: Subject, people: int = 2) -> Path:
    """ICT-FaceKit's folder: centimetres, names with _L and _R, brows in two halves."""
    folder.mkdir(exist_ok=True)
    neutral = y_up(subject.vertices, 10.0)
    left = subject.vertices[:, :1] > 0.0
    targets = {
        "jawOpen": subject.shapes["jawOpen"],
        "mouthSmile_L": subject.shapes["mouthSmileLeft"],
        "mouthSmile_R": subject.shapes["mouthSmileRight"],
        "browInnerUp_L": subject.shapes["browInnerUp"] * left,
        "browInnerUp_R": subject.shapes["browInnerUp"] * ~left,
    }
    write_obj(folder / "generic_neutral_mesh.obj", neutral, subject.triangles, textured=True)
    for name, delta in targets.items():
        write_obj(folder / f"{name}.obj", neutral + y_up(delta, 10.0), subject.triangles, textured=True)
    for k in range(people):
        write_obj(folder / f"identity{k:03d}.obj", neutral + y_up(subject.identity[k], 10.0), subject.triangles, True)
    indices = {"expressions": list(targets), "idx_to_landmark_verts": nearest_vertices(subject).tolist()}
    (folder / "vertex_indices.json").write_text(json.dumps(indices))
    return folder


def write_obj_folder(folder: Path, subject: Subject, place, landmarks: bool = True) -> Path:
    """A folder of OBJ targets; `place` takes points of the head frame to the file's."""
    folder.mkdir(exist_ok=True)
    write_obj(folder / "neutral.obj", place(subject.vertices), subject.triangles)
    for name, delta in subject.shapes.items():
        write_obj(folder / f"{name}.obj", place(subject.vertices + delta), subject.triangles)
    if landmarks:
        (folder / "landmarks.toml").write_text(f"vertices = {nearest_vertices(subject).tolist()}\n")
    return folder


def nearest_vertices(subject: Subject) -> np.ndarray:
    """The vertex with the largest weight of each landmark."""
    rows = np.arange(68)
    return subject.landmarks.vertices[rows, subject.landmarks.barycentric.argmax(1)]


def write_glb(path: Path, subject: Subject, names: dict[str, str], sparse: str | None = None) -> Path:
    """glTF of two meshes below a turned and scaled node; `names` are the file's names of the shapes.

    The shape `sparse` is stored as a sparse accessor. Of two meshes without morph targets one is inside the
    head, as teeth are, and one far below, as a body is.
    """
    document = pygltflib.GLTF2(asset=pygltflib.Asset(version="2.0"), scene=0)
    blob = bytearray()

    def accessor(array: np.ndarray, kind: str) -> int:
        component = pygltflib.FLOAT if array.dtype == np.float32 else pygltflib.UNSIGNED_INT
        document.accessors.append(
            pygltflib.Accessor(bufferView=view(array), componentType=component, count=len(array), type=kind)
        )
        return len(document.accessors) - 1

    def view(array: np.ndarray) -> int:
        document.bufferViews.append(pygltflib.BufferView(buffer=0, byteOffset=len(blob), byteLength=array.nbytes))
        blob.extend(array.tobytes())
        return len(document.bufferViews) - 1

    def sparse_accessor(array: np.ndarray) -> int:
        rows = np.flatnonzero(np.any(array != 0.0, axis=1)).astype(np.uint32)
        indices = pygltflib.AccessorSparseIndices(bufferView=view(rows), componentType=pygltflib.UNSIGNED_INT)
        values = pygltflib.AccessorSparseValues(bufferView=view(array[rows]))
        document.accessors.append(
            pygltflib.Accessor(
                componentType=pygltflib.FLOAT,
                count=len(array),
                type="VEC3",
                sparse=pygltflib.Sparse(count=len(rows), indices=indices, values=values),
            )
        )
        return len(document.accessors) - 1

    # Local axes: the node turns a z-up mesh of centimetres to glTF's y-up metres.
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    local = lambda points: (y_up(points, 10.0) @ turn.T).astype(np.float32)  # noqa: E731

    def mesh(vertices: np.ndarray, triangles: np.ndarray, shapes: dict[str, np.ndarray]) -> None:
        targets = [
            {"POSITION": sparse_accessor(local(delta)) if name == sparse else accessor(local(delta), "VEC3")}
            for name, delta in shapes.items()
        ]
        primitive = pygltflib.Primitive(
            attributes=pygltflib.Attributes(POSITION=accessor(local(vertices), "VEC3")),
            indices=accessor(triangles.astype(np.uint32).ravel(), "SCALAR"),
            targets=targets,
        )
        extras = {"targetNames": [names.get(name, name) for name in shapes]} if shapes else {}
        document.meshes.append(pygltflib.Mesh(primitives=[primitive], extras=extras))

    mesh(subject.vertices, subject.triangles, subject.shapes)
    mesh(*_box(np.array([0.0, 50.0, 0.0])), {})
    mesh(*_box(np.array([0.0, 900.0, 0.0])), {})
    document.nodes = [
        pygltflib.Node(children=[1, 2, 3], translation=OFFSET.tolist()),
        *(
            # A quarter turn about x takes z up back to y up; centimetres become metres.
            pygltflib.Node(mesh=k, rotation=[-(0.5**0.5), 0.0, 0.0, 0.5**0.5], scale=[0.01, 0.01, 0.01])
            for k in range(3)
        ),
    ]
    document.scenes = [pygltflib.Scene(nodes=[0])]
    document.buffers = [pygltflib.Buffer(byteLength=len(blob))]
    document.set_binary_blob(bytes(blob))
    document.save_binary(str(path))
    return path


def _box(centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[x, y, z] for x in (-5, 5) for y in (-5, 5) for z in (-5, 5)], float)
    triangles = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]])
    return corners + centre, triangles


def without_shift(model: FaceModel, subject: Subject) -> np.ndarray:
    """The model's vertices with the subject's mean: what is left differs by more than the choice of an origin."""
    count = len(subject.vertices)
    return model.neutral[:count] - model.neutral[:count].mean(0) + subject.vertices.mean(0)
