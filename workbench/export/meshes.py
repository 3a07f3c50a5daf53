"""The face as one mesh per frame (OBJ or PLY), and everything as arrays (NPZ)."""

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.export.clip import Clip
from workbench.export.suffixes import check_free
from workbench.extras import needs
from workbench.face import FaceModel
from workbench.files import PARTIAL, atomic_path, make_folder, writing

KINDS = ("obj", "ply")
FIRST_LINE = "face where it stands before the camera: metres, +y up, +z towards the viewer"


def write_meshes(
    clip: Clip, folder: str | Path, kind: str, progress: Callable[[int, int], None] | None = None
) -> tuple[Path, ...]:
    """Write `folder`/000012.obj (or .ply) for every frame with a face: the same vertices in the same order.

    The folder appears when all are written. Raises `InputError` where it already exists: it may hold frames of
    another export, `OutputError` where it cannot be written, and for PLY `MissingDependencyError` without trimesh.
    """
    folder = Path(folder)
    if kind not in KINDS:
        raise InputError(f"Meshes are written as {' or '.join(KINDS)}, got {kind!r}.")
    check_free(folder)
    make_folder(folder.parent)
    found = np.flatnonzero(clip.track.found).tolist()
    names = [f"{clip.track.index[position]:06d}.{kind}" for position in found]
    with writing(folder):
        temporary = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name[:40]}{PARTIAL}"))
    try:
        write = _obj_writer(clip.person) if kind == "obj" else _ply_writer(clip.person)
        for done, (position, name) in enumerate(zip(found, names, strict=True), 1):
            content = write(clip.vertices_world(position))
            with writing(folder):
                (temporary / name).write_bytes(content)
            if progress is not None:
                progress(done, len(found))
        with writing(folder):
            temporary.chmod(0o755)
            temporary.replace(folder)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
    return tuple(folder / name for name in names)


def write_arrays(clip: Clip, path: str | Path) -> None:
    """Everything as plain arrays, to be read with NumPy alone: a face is s·R·(neutral + Σ w·shapes) + t.

    `names`, `weights`, `found`, `frame`, `time_s`, `shot`; `rotation` (n, 3, 3) and `translation_mm` from the head to
    the camera (OpenCV: +x right, +y down, +z forward); `angles_deg` (yaw, pitch, roll); `camera_matrix`,
    `distortion`, `image_size` of each frame; `neutral_mm`, `shapes_mm`, `triangles` of the person. `scale` s is 1 and
    `jaw` (axis-angle, millimetres) 0 where only blendshapes move; else the joint of `jaw_pivot_mm`, `jaw_weights` and
    `jaw_corrective_mm`, whole at `jaw_open_deg`, moves the face before R as `workbench.face.move_jaw` does.
    """
    track, person = clip.track, clip.person
    matrices = np.full((len(track), 3, 3), np.nan)
    matrices[track.found] = Rotation.from_rotvec(track.rotation[track.found]).as_matrix()
    lenses = np.tile(np.eye(3), (len(track), 1, 1))
    lenses[:, [0, 1], [0, 1]] = track.focal_px
    lenses[:, :2, 2] = track.principal_point_px
    arrays = {
        "names": np.array(track.expression_names),
        "weights": track.expression,
        "found": track.found,
        "frame": track.index,
        "time_s": clip.times_s,
        "frames_per_second": np.array(clip.rate),
        "shot": track.shot,
        "rotation": matrices,
        "translation_mm": track.translation,
        "angles_deg": track.angles_deg,
        "camera_matrix": lenses,
        "distortion": track.distortion,
        "image_size": track.image_size,
        "neutral_mm": person.neutral.astype(np.float32),
        "shapes_mm": person.expression_deltas.astype(np.float32),
        "triangles": person.triangles,
        "scale": track.scale,
        "jaw": track.jaw,
        "jaw_pivot_mm": np.asarray(clip.joint.joint, np.float32),
        "jaw_weights": np.asarray(clip.joint.weights, np.float32),
        "jaw_corrective_mm": np.asarray(clip.joint.corrective, np.float32),
        "jaw_open_deg": np.array(clip.joint.unit.open_deg),
    }
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def _obj_writer(person: FaceModel) -> Callable[[np.ndarray], bytes]:
    """OBJ text of the person's mesh with other vertices; a fifth of trimesh's time, as only they are formatted."""
    colors = [" {:.4f} {:.4f} {:.4f}".format(*color) for color in (person.colors / 255.0).tolist()]
    faces = "\n".join("f {} {} {}".format(*corners) for corners in (person.triangles + 1).tolist())

    def write(vertices: np.ndarray) -> bytes:
        lines = ["v %.7f %.7f %.7f" % tuple(point) for point in vertices.tolist()]  # noqa: UP031 (the fastest way)
        points = "\n".join(map(str.__add__, lines, colors))
        return f"# {FIRST_LINE}\n{points}\n{faces}\n".encode()

    return write


def _ply_writer(person: FaceModel) -> Callable[[np.ndarray], bytes]:
    with needs("formats"):
        import trimesh

    def write(vertices: np.ndarray) -> bytes:
        # Without `process=False` the library merges and reorders vertices.
        mesh = trimesh.Trimesh(vertices, person.triangles, vertex_colors=person.colors, process=False)
        return mesh.export(file_type="ply")

    return write
