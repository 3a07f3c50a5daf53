"""One function for every format: what lies at a path becomes a face model in the workbench's conventions."""

import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from workbench.errors import ModelError
from workbench.face.checking import check_face_model
from workbench.face.default_head import load_default_head
from workbench.face.formats.basel import read_basel_h5, read_basel_mat
from workbench.face.formats.eye_joints import with_turned_eyes
from workbench.face.formats.flame import companions, flame_model, is_flame
from workbench.face.formats.gltf import read_gltf
from workbench.face.formats.gnm import gnm_model, is_gnm
from workbench.face.formats.ict_facekit import is_ict_facekit, read_ict_facekit
from workbench.face.formats.landmark_fit import LandmarkFit, centre_of_motion, fit_landmarks, outward
from workbench.face.formats.obj import read_landmarks_toml, read_obj_targets
from workbench.face.formats.pickled_arrays import read_arrays
from workbench.face.formats.placing import Placement, axes_of_joints, correspondences, place
from workbench.face.formats.raw import RawModel, check_raw, embedding_of, places_of
from workbench.face.formats.shape_names import arkit_name, arkit_shapes
from workbench.face.model import Embedding, FaceModel
from workbench.reading import checked_file, reading, shortened

COMPONENTS = 50
"""Identity and expression components of a statistical model that are kept, as many as the default head has."""
FORMATS = (
    ".pkl or .npz (FLAME), .npz (GNM Head), .h5 or .mat (Basel), .glb or .gltf, a folder of OBJ files, "
    "or ICT-FaceKit's folder"
)
CONVERTED = {
    ".fbx": "no maintained library reads its blendshapes; open it in Blender and export glTF (.glb) with shape keys",
    ".blend": "open it in Blender and export glTF (.glb) with shape keys",
    ".vrm": "it is glTF; rename it to .glb",
}
REMEDY = "supply the file as it was published"
IN_PLACE_MM = 15.0
"""A model in millimetres and our axes whose eyes are this close to its origin is in the head frame already."""
MIRROR_MM = 3.0


def load_face_model(
    path: str | Path,
    *,
    landmarks: str | Path | None = None,
    unit: str | None = None,
    identity: int | None = COMPONENTS,
    expressions: int | None = COMPONENTS,
) -> FaceModel:
    """The face model of a file or folder: head frame, millimetres, ARKit's names if the file has such shapes.

    Read are FLAME (.pkl, never executed, or .npz), Basel 2009, 2017 and 2019 (.mat, .h5), GNM Head (.npz), ICT-FaceKit
    (folder), glTF with morph targets (.glb, .gltf) and folders of OBJ targets; the workbench's own head (.npz) too.
    `landmarks` is a `landmarks.toml`, or for FLAME a published embedding; without it, the format's own landmarks are
    taken (for FLAME from the embeddings next to the model), and what is missing is fitted (`landmark_fit`). `unit`
    ("m", "cm", "mm", …) is for heads that are not of human size. Of statistical bases the first `identity` and
    `expressions` components are kept; None keeps all. Raises `ModelError` if parts are missing or do not belong
    together, and for `landmarks` or a `unit` that the format does not use.
    """
    path = Path(path)
    with reading(shortened(path), "a face model", REMEDY, ModelError):
        if _is_own(path):
            if landmarks is not None or unit is not None:
                raise ModelError(f"{path} is the workbench's own head: leave landmarks and unit out, it has them.")
            return load_default_head(path)
        raw = read_raw_model(path, landmarks=landmarks, identity=identity, expressions=expressions)
        return check_face_model(path, _placed(raw, unit, path))


def read_raw_model(
    path: str | Path,
    *,
    landmarks: str | Path | None = None,
    identity: int | None = COMPONENTS,
    expressions: int | None = COMPONENTS,
) -> RawModel:
    """What a file or folder holds, checked: its own unit, axes and names, and the landmarks that it tells.

    Arguments and errors are those of `load_face_model`, which lays the default head on it.
    """
    path, given = Path(path), Path(landmarks) if landmarks is not None else None
    if not os.path.exists(path):
        raise ModelError(f"There is no face model at {shortened(path)}.")
    if given is not None and not os.path.isfile(given):
        raise ModelError(f"There is no landmark file {shortened(given)}.")
    if not path.is_dir():
        checked_file(path, "a face model", ModelError)
    with reading(path, "a face model", REMEDY, ModelError):
        raw = _read(path, given, identity, expressions)
        if given is not None and given.suffix == ".toml":
            places = read_landmarks_toml(given, len(raw.vertices))
            raw = replace(raw, landmarks=places, contour=None, contour_yaw_deg=None)
        return check_raw(path, raw)


def _is_own(path: Path) -> bool:
    if path.suffix != ".npz" or not os.path.isfile(path) or not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return {"neutral.npy", "expression_step_mm.npy"} <= set(archive.namelist())


def _read(path: Path, landmarks: Path | None, identity: int | None, expressions: int | None) -> RawModel:
    suffix = path.suffix.lower()
    if path.is_dir() or suffix not in (".pkl", ".npz"):
        _check_no_embedding(path, landmarks)
    if path.is_dir():
        return read_ict_facekit(path, identity) if is_ict_facekit(path) else read_obj_targets(path)
    if suffix in CONVERTED:
        raise ModelError(f"{path} cannot be read: {CONVERTED[suffix]}.")
    readers: dict[str, Callable[[], RawModel]] = {
        ".mat": lambda: read_basel_mat(path, identity),
        ".h5": lambda: read_basel_h5(path, identity, expressions),
        ".hdf5": lambda: read_basel_h5(path, identity, expressions),
        ".glb": lambda: read_gltf(path),
        ".gltf": lambda: read_gltf(path),
        ".pkl": lambda: _read_named_arrays(path, landmarks, identity, expressions),
        ".npz": lambda: _read_named_arrays(path, landmarks, identity, expressions),
    }
    if suffix == ".obj":
        raise ModelError(f"{path} is one mesh: give the folder with the neutral and its blendshape targets.")
    if suffix not in readers:
        raise ModelError(f"{path} is not a supported face model; supported are {FORMATS}.")
    return readers[suffix]()


def _read_named_arrays(path: Path, landmarks: Path | None, identity: int | None, expressions: int | None) -> RawModel:
    arrays = read_arrays(path)
    if is_flame(arrays):
        own = landmarks is not None and landmarks.suffix != ".toml"
        return flame_model(path, arrays, identity, expressions, [landmarks] if own else companions(path))
    _check_no_embedding(path, landmarks)
    if is_gnm(arrays):
        return gnm_model(path, arrays, identity, expressions)
    held = shortened(", ".join(sorted(map(str, arrays))[:8]))
    raise ModelError(
        f"{path} is neither FLAME (v_template, shapedirs) nor GNM Head (template_vertex_positions); it holds {held}."
    )


def _check_no_embedding(path: Path, landmarks: Path | None) -> None:
    if landmarks is not None and landmarks.suffix != ".toml":
        raise ModelError(
            f"{landmarks} is not a landmarks.toml: embeddings are read for FLAME only; give those of {path} in one."
        )


def _placed(raw: RawModel, unit: str | None, path: Path) -> FaceModel:
    head = load_default_head(gaze=True)
    names, deltas, bounds = arkit_shapes(raw.expression_names, raw.expression_deltas, raw.expression_range)
    points = correspondences(raw, names, deltas, head)
    axes = axes_of_joints(raw, head) if raw.axes is None and len(points.head) < 3 else raw.axes
    placement = _with_exact_origin(raw, place(points, axes, unit, path))
    vertices = placement.points(raw.vertices)
    triangles = np.asarray(raw.triangles, np.int32)
    if not outward(vertices, triangles):
        triangles = triangles[:, ::-1]
    fit, found = _fitted(raw, dict(zip(names, deltas, strict=True)), vertices, triangles, placement, path)
    yaws, contour = _contour(raw, fit, head, found)
    count, people = len(vertices), raw.people()
    model = FaceModel(
        name=raw.name,
        neutral=vertices,
        triangles=triangles,
        expression_names=names,
        expression_deltas=placement.offsets(deltas),
        identity_deltas=placement.offsets(people),
        landmarks=embedding_of({**places_of(fit.landmarks), **raw.landmarks}),
        contour_yaw_deg=yaws,
        contour=contour,
        colors=raw.colors if raw.colors is not None else np.full((count, 3), 190, np.uint8),
        regions=_regions(raw, fit, vertices, head, found),
        joints={name: placement.points(joint) for name, joint in raw.joints.items()},
        jaw_weights=raw.jaw_weights if raw.jaw_weights is not None else np.zeros(count),
        uv=raw.uv if raw.uv is not None else np.zeros((1, 2)),
        triangles_uv=_uv_triangles(raw, triangles),
        mirror=raw.mirror if raw.mirror is not None else _mirror(vertices),
        identity_joint_deltas=_joint_deltas(raw, placement),
        blink_scale=np.ones(2),
        blink_scale_identity=np.zeros((len(people), 2)),
        expression_range=bounds,
        notes=(*raw.notes, _told(raw, placement, fit, found)),
    )
    return model if raw.eye_weights is None else with_turned_eyes(model, raw.eye_weights)


def _fitted(
    raw: RawModel,
    shapes: dict[str, np.ndarray],
    vertices: np.ndarray,
    triangles: np.ndarray,
    placement: Placement,
    path: Path,
) -> tuple[LandmarkFit, bool]:
    """The default head laid on the mesh, and whether it lies on it. Raises `ModelError` where landmarks need it to."""
    eyes = {name: placement.points(raw.joints[name]) for name in ("leftEye", "rightEye") if name in raw.joints}
    moved = {name: delta for name, delta in shapes.items() if arkit_name(name) and np.any(delta)}
    motions = {name: centre_of_motion(delta) @ vertices for name, delta in moved.items()}
    head = load_default_head(gaze=True)
    fit = fit_landmarks(vertices, triangles, raw.landmarks, eyes, motions, placement.size, head)
    found = fit.lies_on_it(placement.size)
    if len(raw.landmarks) < 68 and not found:
        raise ModelError(
            f"{path}: the default head could not be laid on this mesh ({100 * fit.covered:.0f} % of its face found the "
            f"surface, median distance {fit.distance_mm:.1f} mm); give all 68 landmarks in landmarks.toml."
        )
    return fit, found


def _with_exact_origin(raw: RawModel, placement: Placement) -> Placement:
    if {"leftEye", "rightEye"} <= set(raw.joints):
        return placement._replace(origin=0.5 * (raw.joints["leftEye"] + raw.joints["rightEye"]))
    upright = np.allclose(placement.rotation, np.eye(3)) and placement.unit_mm == 1.0
    if upright and np.linalg.norm(placement.origin) < IN_PLACE_MM:
        return placement._replace(origin=np.zeros(3))
    return placement


def _contour(raw: RawModel, fit: LandmarkFit, head: FaceModel, found: bool) -> tuple[np.ndarray, Embedding]:
    if raw.contour is not None and raw.contour_yaw_deg is not None:
        return raw.contour_yaw_deg, raw.contour
    if found:
        return head.contour_yaw_deg, fit.contour
    return np.zeros(0), Embedding(np.zeros((0, 17, 3), np.int32), np.zeros((0, 17, 3)))


def _regions(
    raw: RawModel, fit: LandmarkFit, vertices: np.ndarray, head: FaceModel, found: bool
) -> dict[str, np.ndarray]:
    """The file's own, or those of the fitted default head's nearest vertices."""
    if raw.regions is not None:
        return {name: np.asarray(index, int) for name, index in raw.regions.items()}
    if not found:
        return {"skin": np.arange(len(vertices))}
    label = np.zeros(len(head.neutral), int)
    names = ("skin", "lips", "brow", "scalp")
    for k, name in enumerate(names):
        label[head.regions.get(name, np.zeros(0, int))] = k
    outer = np.concatenate([head.regions[name] for name in names if name in head.regions])
    nearest = outer[cKDTree(fit.vertices[outer]).query(vertices)[1]]
    return {name: np.flatnonzero(label[nearest] == k) for k, name in enumerate(names)}


def _uv_triangles(raw: RawModel, triangles: np.ndarray) -> np.ndarray:
    if raw.triangles_uv is None:
        return np.zeros((len(triangles), 3), np.int32)
    turned = not np.array_equal(triangles, raw.triangles)
    return np.asarray(raw.triangles_uv[:, ::-1] if turned else raw.triangles_uv, np.int32)


def _mirror(vertices: np.ndarray) -> np.ndarray:
    """The vertex on the other side, or the vertex itself where the mesh has none there."""
    distance, nearest = cKDTree(vertices).query(vertices * [-1.0, 1.0, 1.0])
    return np.where(distance < MIRROR_MM, nearest, np.arange(len(vertices))).astype(np.int32)


def _joint_deltas(raw: RawModel, placement: Placement) -> dict[str, np.ndarray]:
    still = np.zeros((len(raw.people()), 3))
    return {
        name: placement.offsets(raw.identity_joint_deltas[name]) if name in raw.identity_joint_deltas else still
        for name in raw.joints
    }


def _told(raw: RawModel, placement: Placement, fit: LandmarkFit, found: bool) -> str:
    known = len(raw.landmarks)
    units = {1000.0: "metres", 100.0: "decimetres", 10.0: "centimetres", 1.0: "millimetres", 0.001: "micrometres"}
    landmarks = f"{known} landmarks from the file" if known else "no landmarks in the file"
    if known < 68:
        landmarks += f", {68 - known} fitted: the default head lies {fit.distance_mm:.1f} mm from the surface"
    contour = "" if raw.contour is not None or found else "; the jaw contour does not slide"
    return f"stored in {units[placement.unit_mm]}; {landmarks}{contour}."
