"""ICT-FaceKit (Li et al. 2020): the folder FaceXModel of OBJ files.

`generic_neutral_mesh.obj`, one OBJ an expression as listed in `vertex_indices.json`, `identity000.obj` and on
(principal components, one standard deviation each), and 68 landmark vertices under `idx_to_landmark_verts`. In
centimetres; +x subject's left, +y up, +z out of the face. Names are ARKit's with `_L` and `_R`.
"""

import operator
from pathlib import Path

from workbench.errors import ModelError
from workbench.face.checking import check_names
from workbench.face.formats.obj import read_obj, read_targets
from workbench.face.formats.raw import Y_UP, RawModel, ranges, vertex_place
from workbench.reading import checked_content, checked_json, reading, shortened

NEUTRAL, INDICES = "generic_neutral_mesh.obj", "vertex_indices.json"


def is_ict_facekit(folder: Path) -> bool:
    """Whether the folder is ICT-FaceKit's FaceXModel."""
    return (folder / NEUTRAL).is_file() or (folder / INDICES).is_file()


def read_ict_facekit(folder: Path, identity: int | None) -> RawModel:
    """ICT-FaceKit with at most this many identity components. Raises `ModelError` if a file is missing."""
    for name in (NEUTRAL, INDICES):
        if not (folder / name).is_file():
            raise ModelError(f"ICT-FaceKit needs {name}, none in {folder}; copy the whole folder FaceXModel.")
    content = checked_content(folder / INDICES, "ICT-FaceKit's list", ModelError)
    with reading(folder / INDICES, "ICT-FaceKit's list", "download ICT-FaceKit again", ModelError):
        stored = checked_json(content)
        names = [_file_stem(name) for name in stored["expressions"]]
        check_names(folder / INDICES, "expressions", names)
        landmarks = [operator.index(vertex) for vertex in stored["idx_to_landmark_verts"]]
    neutral = read_obj(folder / NEUTRAL)
    if len(landmarks) != 68 or not 0 <= min(landmarks) <= max(landmarks) < len(neutral.vertices):
        raise ModelError(f"{folder / INDICES} needs 68 landmark vertices of the mesh, got {len(landmarks)}.")
    missing = [name for name in names if not (folder / f"{name}.obj").is_file()]
    if missing:
        raise ModelError(f"{folder / INDICES} lists the expression {missing[0]}, but there is no {missing[0]}.obj.")
    targets = read_targets(folder / NEUTRAL, neutral, [folder / f"{name}.obj" for name in names])
    people = read_targets(folder / NEUTRAL, neutral, sorted(folder.glob("identity[0-9]*.obj"))[:identity])
    return RawModel(
        name="ict-facekit",
        vertices=neutral.vertices,
        triangles=neutral.triangles,
        expression_names=tuple(names),
        expression_deltas=targets - neutral.vertices,
        expression_range=ranges(len(names)),
        identity_deltas=people - neutral.vertices,
        landmarks={point: vertex_place(vertex) for point, vertex in enumerate(landmarks)},
        uv=neutral.uv,
        triangles_uv=neutral.triangles_uv,
        axes=Y_UP,
    )


def _file_stem(name: object) -> str:
    """The name of a file in the folder itself."""
    if not isinstance(name, str) or not name or Path(name).name != name:
        raise ValueError(f"{shortened(name)!r} is not the name of an expression")
    return name
