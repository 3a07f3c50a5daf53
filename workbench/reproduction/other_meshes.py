"""Meshes of other programs beside ours over the same pictures, as in Deep Energies Figs. 12 and 20."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib.figure import Figure

from workbench import plots
from workbench.config import preset
from workbench.face import FaceModel, load_default_head, posed_vertices
from workbench.geometry import Camera, camera_from_matrix
from workbench.landmarks.scheme import outer_eye_distance
from workbench.pictures.mesh import to_camera
from workbench.reproduction.clip_solves import clip_solver, observed, parallel_fit, parallel_head
from workbench.reproduction.head_pose import pose_by_pnp
from workbench.reproduction.mesh_files import FoundMesh, read_mesh_folder
from workbench.reproduction.mesh_pictures import mesh_panel, photo_panel, square_around
from workbench.reproduction.mesh_placing import IN_CROP, distance_px, in_picture, read_over
from workbench.reproduction.rendered_clip import OPEN_MOUTH, SIZE, clip_pictures, clip_truth
from workbench.reproduction.study import Result, Study, Table
from workbench.tracking import FrameFit

FRAMES, QUICK_FRAMES = (60, 140, OPEN_MOUTH), (OPEN_MOUTH,)
PANEL, COLUMNS, MARGIN = 280, 4, 1.45
FACE_REGIONS = ("skin", "lips")
FOREHEAD_MM = 15.0
"""How far above the brows the face goes that distances are measured from."""
PNP, PARALLEL, OURS = "mean face, PnP", "deep-parallel", "deep"
NO_MESHES = (
    "With --meshes FOLDER, what 3DDFA, PRNet or VRN made of the pictures frame_N.png, which are in this item's folder, "
    "stands beside these."
)
CROPPED = (
    "VRN's pixels are those of its own crop. Where it has cut follows from landmarks, here from ours: its place may be "
    "off by a pixel or two."
)


class Shown(NamedTuple):
    """A mesh in the pixels of a frame."""

    label: str
    frame: int
    vertices: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "t 3"] | None
    read_as: str = ""


def compared(study: Study) -> Result:
    """Figs. 12 and 20: the meshes of a folder, the mean face by PnP and our solves over the same pictures."""
    head, frames = load_default_head(), QUICK_FRAMES if study.quick else FRAMES
    pictures = clip_pictures(FRAMES)
    faces = {frame: true_face(head, frame) for frame in frames}
    others, problems = ((), ()) if study.meshes is None else read_mesh_folder(study.meshes, FRAMES)
    meshes = [_placed(other, faces[other.frame], study) for other in others if other.frame in frames]
    meshes += [_by_pnp(head, frame) for frame in frames]
    if not study.quick:
        meshes += _by_parallel_projection(frames, study)
    solves = clip_solver().solve(preset("deep"), frames, study, OURS)
    meshes += [_fitted(OURS, head, solves.fitter.record(solves.solutions[frame])) for frame in frames]
    header = ("", "frame", "vertices", "triangles", "axes in the file", "distance")
    title = "Meshes, and their mean distance from the rendered face, % of the eye distance"
    return Result(
        data=f"{len(frames)} frames of the bundled clip of a rendered head, 640 × 480. The mean face is placed by "
        "OpenCV's PnP on the 68 landmarks; deep has the true camera and, as in the paper, the person's shape.",
        figures={
            f"Frame {frame}: meshes over the picture, lit from the camera.": _figure(
                pictures[frame], frame, [mesh for mesh in meshes if mesh.frame == frame]
            )
            for frame in frames
        },
        tables=(Table(title, header, tuple(_row(mesh, faces[mesh.frame]) for mesh in meshes)),),
        notes=(
            "The paper shows the other programs on photos of an actor. They are not part of the workbench; their files "
            "are read. Ours is the preset deep with one network and not its ensemble. What is common to all depths is "
            "taken out of the distance, and axes are read in the way that brings a mesh closest to the face. Parallel "
            "projection opens the mouth here, where the paper's does not: its ten components are those of this head's "
            "own expressions, not Basel's. The paper's last columns, two cameras with temporal refinement, need "
            "another film.",
            *((NO_MESHES,) if study.meshes is None else ()),
            *((CROPPED,) if any(mesh.read_as.endswith(IN_CROP) for mesh in meshes) else ()),
            *problems,
        ),
        pictures={f"frame_{frame}": picture for frame, picture in pictures.items()},
    )


def true_face(head: FaceModel, frame: int) -> Float[np.ndarray, "m 3"]:
    """Points of the rendered face from brows to chin, in the picture (`in_picture`)."""
    truth, person = clip_truth(), head.personal(clip_truth().identity)
    rotation, place = truth.rotation[frame], truth.translation_mm[frame]
    points = to_camera(person.vertices(truth.expression[frame]), rotation, place)
    landmarks = person.landmarks.of(person.neutral)
    _, y, z = person.neutral.T
    face = (y > landmarks[17:27, 1].min() - FOREHEAD_MM) & (y < landmarks[8, 1]) & (z < landmarks[[0, 16], 2].mean())
    shown = np.intersect1d(np.flatnonzero(face), np.concatenate([person.regions[name] for name in FACE_REGIONS]))
    return in_picture(_camera(), points)[shown]


def _camera() -> Camera:
    return camera_from_matrix(clip_truth().camera_matrix)


def _placed(other: FoundMesh, face: Float[np.ndarray, "m 3"], study: Study) -> Shown:
    study.progress(other.program, other.frame, None)
    seen = observed(other.frame).landmarks.points
    reading, vertices = read_over(other.mesh, face, SIZE[1], seen)
    return Shown(other.program, other.frame, vertices, other.mesh.triangles, str(reading))


def _by_pnp(head: FaceModel, frame: int) -> Shown:
    camera, points = _camera(), head.landmarks.of(head.neutral)
    pose = pose_by_pnp(points, observed(frame).landmarks.points, camera)
    return Shown(PNP, frame, in_picture(camera, to_camera(head.neutral, *pose)), head.triangles)


def _by_parallel_projection(frames: Sequence[int], study: Study) -> list[Shown]:
    """Appendix C.2: ten components each of shape and expression, no lens known."""
    found = []
    for done, frame in enumerate(frames):
        study.progress(PARALLEL, done, len(frames))
        found.append(_fitted(PARALLEL, parallel_head(), parallel_fit(PARALLEL, frame)))
    return found


def _fitted(label: str, model: FaceModel, fit: FrameFit) -> Shown:
    vertices = posed_vertices(model.personal(fit.identity), fit.expression, fit.jaw, fit.scale)
    points = in_picture(fit.camera, to_camera(vertices, fit.rotation, fit.translation))
    return Shown(label, fit.index, points, model.triangles)


def _row(mesh: Shown, face: Float[np.ndarray, "m 3"]) -> tuple[str, ...]:
    apart = distance_px(face, mesh.vertices, mesh.triangles)
    percent = 100.0 * apart / outer_eye_distance(clip_truth().landmarks[mesh.frame])
    triangles = "none" if mesh.triangles is None else str(len(mesh.triangles))
    return mesh.label, str(mesh.frame), str(len(mesh.vertices)), triangles, mesh.read_as, f"{percent:.1f}"


def _figure(picture: UInt8[np.ndarray, "h w 3"], frame: int, meshes: Sequence[Shown]) -> Figure:
    """The meshes of a frame, and the picture."""
    square = square_around(clip_truth().landmarks[frame], MARGIN, picture)
    panels = [mesh_panel(picture, square, PANEL, mesh.vertices, mesh.triangles) for mesh in meshes]
    panels.append(photo_panel(picture, square, PANEL))
    return plots.pictures_in_a_row(panels, [*(mesh.label for mesh in meshes), "picture"], columns=COLUMNS)
