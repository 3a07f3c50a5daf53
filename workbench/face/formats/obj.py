"""Wavefront OBJ, read in the file's own order, and folders of OBJ targets."""

from codecs import BOM_UTF8
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from workbench.errors import ModelError
from workbench.face.checking import check_embedding, check_numbers, index_beyond
from workbench.face.formats.raw import Place, RawModel, check_mesh, places_of, ranges, vertex_place
from workbench.face.model import Embedding
from workbench.reading import checked_content, checked_file, reading, toml_tables

LANDMARKS_FILE = "landmarks.toml"
REMEDY = "export it again"


class ObjMesh(NamedTuple):
    """Positions as listed, polygons cut into fans of triangles. (Libraries split or merge vertices at seams.)"""

    vertices: Float[np.ndarray, "v 3"]
    triangles: Integer[np.ndarray, "t 3"]
    uv: Float[np.ndarray, "u 2"] | None
    triangles_uv: Integer[np.ndarray, "t 3"] | None
    faces_text: bytes
    """The lines of the faces: equal text is equal topology."""


def read_obj(path: Path) -> ObjMesh:
    """The mesh of an OBJ file. Raises `ModelError` for a file without one."""
    content = _content(path)
    with reading(path, "OBJ", REMEDY, ModelError):
        vertices, faces_text = _vertices_and_faces(path, content)
        uv = _numbers(content.splitlines(), b"vt ", 2)
        corners = [
            [corner.split(b"/") for corner in line.split()[1:]] for line in faces_text.splitlines() if line[:2] == b"f "
        ]
        triangles = _fans([[_index(corner[0], len(vertices)) for corner in face] for face in corners])
        textured = len(uv) > 0 and all(len(corner) > 1 and corner[1] for face in corners for corner in face)
        triangles_uv = _fans([[_index(c[1], len(uv)) for c in face] for face in corners]) if textured else None
        if len(triangles) == 0:
            raise ModelError(f"{path} holds no mesh; export it again with its faces.")
        check_mesh(path, vertices, triangles, {})
        if textured:
            check_numbers(path, "vt", uv, (len(uv), 2))
        return ObjMesh(vertices, triangles, uv if textured else None, triangles_uv, faces_text)


def read_obj_vertices(path: Path) -> tuple[Float[np.ndarray, "v 3"], bytes]:
    """Positions and the text of the faces: all that a target needs beside its neutral."""
    content = _content(path)
    with reading(path, "OBJ", REMEDY, ModelError):
        return _vertices_and_faces(path, content)


def _content(path: Path) -> bytes:
    return checked_content(path, "OBJ", ModelError).removeprefix(BOM_UTF8)


def _vertices_and_faces(path: Path, content: bytes) -> tuple[Float[np.ndarray, "v 3"], bytes]:
    lines = content.splitlines()
    vertices = _numbers(lines, b"v ", 3)
    if len(vertices) == 0:
        raise ModelError(f"{path} holds no mesh; export it again with its faces.")
    check_numbers(path, "v", vertices, (len(vertices), 3))
    return vertices, b"\n".join(line.strip() for line in lines if line[:2] == b"f ")


def read_targets(neutral_path: Path, neutral: ObjMesh, paths: Iterable[Path]) -> Float[np.ndarray, "n v 3"]:
    """Positions of targets in correspondence with the neutral. Raises `ModelError` where one is not."""
    targets = []
    for path in paths:
        vertices, faces_text = read_obj_vertices(path)
        if len(vertices) != len(neutral.vertices):
            raise ModelError(
                f"{path.name} has {len(vertices)} vertices and {neutral_path.name} {len(neutral.vertices)}; "
                "all targets must come from one mesh."
            )
        # Other texture or normal numbers are no other topology.
        if faces_text != neutral.faces_text and not np.array_equal(read_obj(path).triangles, neutral.triangles):
            raise ModelError(
                f"{path.name} lists different faces from {neutral_path.name}; export without reordering vertices."
            )
        targets.append(vertices)
    return np.stack(targets) if targets else np.zeros((0, len(neutral.vertices), 3))


def read_obj_targets(folder: Path, neutral: str = "neutral") -> RawModel:
    """A folder of `neutral.obj` and one OBJ a blendshape, named by its file; `landmarks.toml` where it is there."""
    neutral_path = folder / f"{neutral}.obj"
    if not neutral_path.is_file():
        raise ModelError(f"A model folder needs {neutral}.obj, none in {folder}; export the neutral face there.")
    paths = sorted(path for path in folder.glob("*.obj") if path != neutral_path)
    if not paths:
        raise ModelError(f"{folder} holds no blendshape targets next to {neutral}.obj; add one OBJ per blendshape.")
    mesh = read_obj(neutral_path)
    targets = read_targets(neutral_path, mesh, paths)
    landmarks = folder / LANDMARKS_FILE
    return RawModel(
        name=folder.resolve().name,
        vertices=mesh.vertices,
        triangles=mesh.triangles,
        expression_names=tuple(path.stem for path in paths),
        expression_deltas=targets - mesh.vertices,
        expression_range=ranges(len(paths)),
        landmarks=read_landmarks_toml(landmarks, len(mesh.vertices)) if landmarks.is_file() else {},
        uv=mesh.uv,
        triangles_uv=mesh.triangles_uv,
    )


def read_landmarks_toml(path: Path, vertex_count: int) -> dict[int, Place]:
    """The 68 landmarks of a `landmarks.toml`: 68 vertex numbers from 0, or 68 triples with `barycentric`."""
    if not path.is_file():
        raise ModelError(f"A model folder needs {LANDMARKS_FILE} with the 68 points, none at {path}.")
    stored = toml_tables(checked_file(path, LANDMARKS_FILE, ModelError), ModelError)
    with reading(path, LANDMARKS_FILE, "write it as the documentation of load_face_model describes", ModelError):
        return _landmarks(path, stored, vertex_count)


def _landmarks(path: Path, stored: dict[str, Any], vertex_count: int) -> dict[int, Place]:
    try:
        vertices = np.asarray(stored.get("vertices", []))
        barycentric = np.asarray(stored.get("barycentric", []), float)
    except (ValueError, TypeError) as error:
        raise ModelError(f"{path} needs 68 vertex numbers, or 68 triples with barycentric.") from error
    single = vertices.shape == (68,)
    if not single and (vertices.shape != (68, 3) or barycentric.shape != (68, 3)):
        raise ModelError(f"{path} needs 68 vertex numbers, or 68 triples with barycentric, got {vertices.shape}.")
    if vertices.dtype.kind != "i":
        raise ModelError(f"{path} needs whole numbers of vertices, counted from 0.")
    if (worst := index_beyond(vertices, vertex_count)) is not None:
        raise ModelError(f"{path} names vertex {worst}, the mesh has {vertex_count}, counted from 0.")
    if single:
        return {point: vertex_place(int(vertex)) for point, vertex in enumerate(vertices)}
    embedding = Embedding(vertices.astype(np.int32), barycentric)
    check_embedding(path, "barycentric", embedding, (68,), vertex_count)
    return places_of(embedding)


def _numbers(lines: list[bytes], keyword: bytes, count: int) -> np.ndarray:
    rows = [line.split()[1 : 1 + count] for line in lines if line.startswith(keyword)]
    return np.array(rows, float).reshape(-1, count)


def _index(text: bytes, count: int) -> int:
    """From 0. OBJ counts from 1, and backwards from the end with negative numbers."""
    number = int(text)
    index = number - 1 if number > 0 else count + number
    if not 0 <= index < count:
        raise ValueError(f"a face names number {number} of {count}")
    return index


def _fans(faces: list[list[int]]) -> np.ndarray:
    fans = [(face[0], face[k], face[k + 1]) for face in faces for k in range(1, len(face) - 1)]
    return np.array(fans, np.int64).reshape(-1, 3)
