"""The readers of files from outside, each with a small valid file and a use of what was read (see `fuzzing`).

Everything here may be imported by the judge's process: functions of the module, nothing but the package behind them.
"""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tests import landmark_layouts, mesh_layouts
from tests.fuzz_face_readers import FACE_READERS
from tests.fuzzing import Reader
from tests.networks import random_landmark_network
from workbench import config as configuration
from workbench.export import retargeting
from workbench.export.clip import main_identity
from workbench.geometry import Camera, Rig, View, project, project_to_view, rig_files
from workbench.landmarks import files as landmark_files
from workbench.landmarks.observations import Landmarks2D
from workbench.networks import torch_checkpoints
from workbench.networks.landmark_network import read_landmark_network, save_landmark_network
from workbench.networks.weights import named_arrays
from workbench.rendering.appearance import Appearance, load_appearance
from workbench.reproduction import read_mesh, read_truth, write_truth
from workbench.session import material_of_track
from workbench.tracking import FrameFit, Track
from workbench.tracking.records import frame_errors, stack_fits
from workbench.tracking.track_reader import TrackReader

NAMES = ("jawOpen", "mouthSmileLeft", "mouthSmileRight")
CHARACTER = ("Mouth_Open", "Smile")


def make_config(folder: Path) -> None:
    (folder / "config.toml").write_text(
        'version = 1\npreset = "joint"\n[camera]\nfov_deg = 40.0\n[weights]\ntau = 0.2\n[contour]\nsliding = true\n'
        '[landmarks]\nweights = { jaw = 0.5, "30" = 2.0 }\n[subsets]\nchin = [7, 8, 9]\n[infill]\nframes = [[3, 5]]\n'
        '[[stages]]\nname = "pose"\nfree = ["rotation", "translation"]\nlandmarks = { all = 1.0, chin = 0.0 }\n'
        '[provenance]\nmodel = "head"\ninputs = ["clip.mp4"]\nbefore = { error = 1.5 }\n'
    )


def read_config(folder: Path) -> None:
    config = configuration.read_config(folder / "config.toml")
    assert len(config.point_weights()) == 68
    assert all(len(stage.landmark_weights(config.subsets)) == 68 for stage in config.stages)
    assert configuration.parse_config(config.model_dump(), "again") == config
    configuration.config_toml(config)


def make_mapping(folder: Path) -> None:
    (folder / "mapping.toml").write_text(
        '[shapes]\nMouth_Open = "jawOpen"\nSmile = { mouthSmileLeft = 0.5, mouthSmileRight = 0.5 }\n'
    )


def read_mapping(folder: Path) -> None:
    mapping = retargeting.read_mapping(folder / "mapping.toml", NAMES, CHARACTER)
    assert mapping.matrix.shape == (3, 2)
    assert np.isfinite(mapping.matrix).all()


def make_boston(folder: Path) -> None:
    rng = np.random.default_rng(2)
    write_truth(folder / "jam1.dat", rng.uniform(-30.0, 30.0, (4, 3)), rng.normal(0.0, 100.0, (4, 3)))


def read_boston(folder: Path) -> None:
    angles, places = read_truth(folder / "jam1.dat")
    assert angles.shape == places.shape == (len(angles), 3)
    assert np.isfinite(angles).all()
    assert np.isfinite(places).all()


def make_prnet_mat(folder: Path) -> None:
    vertices, triangles = np.random.default_rng(4).uniform(0.0, 99.0, (6, 3)), np.array([[0, 1, 2], [3, 4, 5]])
    mesh_layouts.write_prnet_mat(folder / "frame_200_mesh.mat", vertices, triangles, 100)


def make_vertices_npy(folder: Path) -> None:
    np.save(folder / "frame_200.npy", np.random.default_rng(4).uniform(0.0, 99.0, (6, 3)).astype(np.float32))


def read_other_mesh(folder: Path) -> None:
    (path,) = folder.iterdir()
    mesh = read_mesh(path)
    assert mesh.vertices.shape == (len(mesh.vertices), 3)
    assert np.isfinite(mesh.vertices).all()
    assert mesh.triangles is None or np.isfinite(mesh.vertices[mesh.triangles]).all()


def _records() -> list[landmark_files.LandmarkRecord]:
    rng = np.random.default_rng(1)
    size = (640, 480)
    faces = [Landmarks2D(rng.uniform(0, 400, (68, 2)), rng.uniform(0, 1, 68), size) for _ in range(2)]
    return [
        landmark_files.LandmarkRecord(0, "first", faces[0], size),
        landmark_files.LandmarkRecord(2, "none", None, size),
        landmark_files.LandmarkRecord(5, "last", faces[1], size),
    ]


def make_landmarks_csv(folder: Path) -> None:
    landmark_files.write_landmark_file(folder / "points.csv", _records())


def make_landmarks_json(folder: Path) -> None:
    landmark_files.write_landmark_file(folder / "points.json", _records())


def make_landmarks_pts(folder: Path) -> None:
    landmark_files.write_landmark_file(folder / "points.pts", _records()[:1])


def make_pts_folder(folder: Path) -> None:
    for record in _records():
        if record.landmarks is not None:
            landmark_files.write_landmark_file(folder / f"{record.name}.pts", [record])


def make_openface(folder: Path) -> None:
    faces = [record.landmarks.points for record in _records() if record.landmarks is not None]
    rows = [("1, 0, 0.000, 0.98, 1", faces[0]), ("1, 1, 0.000, 0.97, 1", faces[1]), ("3, 0, 0.067, 0.1, 0", faces[1])]
    (folder / "points.csv").write_text(landmark_layouts.openface_csv(rows))


def make_mesh_csv(folder: Path) -> None:
    (folder / "points.csv").write_text(landmark_layouts.mediapipe_csv([_mesh(), None]))


def make_mesh_json(folder: Path) -> None:
    result = {"faceLandmarks": [landmark_layouts.named_points(_mesh())]}
    (folder / "points.json").write_text(json.dumps([result, {"faceLandmarks": []}]))


def make_points_npy(folder: Path) -> None:
    faces = [record.landmarks.points for record in _records() if record.landmarks is not None]
    np.save(folder / "points.npy", np.array([faces, [faces[0], np.full((68, 2), np.nan)]]))


def make_imglab(folder: Path) -> None:
    box = landmark_layouts.dlib_box(_records()[0].landmarks.points)
    pictures = [("file='a.jpg' width='640' height='480'", [box, box]), ("file='b.jpg'", [])]
    (folder / "points.xml").write_text(landmark_layouts.dlib_xml(pictures))


def _mesh() -> np.ndarray:
    return landmark_layouts.mesh_of(_records()[0].landmarks.points, (640, 480), 468)


def read_sizeless_landmarks(folder: Path) -> None:
    _use_landmarks(folder, (640, 480))


def read_pts_folder(folder: Path) -> None:
    _check_landmarks(folder, (640, 480))


def read_landmarks(folder: Path) -> None:
    _use_landmarks(folder, None)


def _use_landmarks(folder: Path, image_size: tuple[int, int] | None) -> None:
    (path,) = folder.iterdir()
    _check_landmarks(path, image_size)


def _check_landmarks(path: Path, image_size: tuple[int, int] | None) -> None:
    for record in landmark_files.read_landmark_file(path, image_size):
        assert record.frame >= 0
        assert record.image_size is None or min(record.image_size) >= 1
        if record.landmarks is not None:
            assert np.isfinite(record.landmarks.points).all()


def _rig() -> Rig:
    camera = Camera(np.array([770.0, 765.0]), np.array([319.5, 239.5]), np.zeros(8))
    turned = Rotation.from_rotvec([0.0, 0.5, 0.0]).as_matrix()
    moved = np.array([0.0, 0.0, 600.0]) - turned @ [0.0, 0.0, 600.0]
    return Rig(
        (
            View("front", (640, 480), camera, np.eye(3), np.zeros(3)),
            View("side", (640, 480), camera, turned, moved),
        )
    )


def make_rig_toml(folder: Path) -> None:
    rig_files.write_rig(_rig(), folder / "rig.toml")


def _make_opencv(path: Path) -> None:
    left, right = _rig().views
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("unit", "mm")
    for number, view in enumerate((left, right), 1):
        (fx, fy), (cx, cy) = view.camera.focal_px, view.camera.principal_point_px
        storage.write(f"K{number}", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
        storage.write(f"D{number}", view.camera.distortion[None, :5])
    storage.write("R", right.rotation_view_world)
    storage.write("T", right.translation_view_world_mm[:, None])
    storage.release()


def make_rig_yaml(folder: Path) -> None:
    _make_opencv(folder / "rig.yml")


def make_rig_json(folder: Path) -> None:
    _make_opencv(folder / "rig.json")


def make_rig_xml(folder: Path) -> None:
    _make_opencv(folder / "rig.xml")


def read_rig(folder: Path) -> None:
    (path,) = folder.iterdir()
    rig = rig_files.read_rig(path)
    point = np.array([[0.0, 0.0, 600.0]])
    for view in rig.names:
        assert np.isfinite(rig.view(view).position_world_mm).all()
        assert np.isfinite(np.asarray(rig.placed_view(view).rotation_view_reference)).all()
    assert np.isfinite(np.asarray(project_to_view(point, rig.placed_view(0)))).all()
    assert rig_files.rig_toml(rig)


EXPRESSION = ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "browInnerUp")


def make_track(folder: Path) -> None:
    rng, size = np.random.default_rng(4), (640, 480)
    fits = []
    for index in range(5):
        unknown = np.nan if index == 2 else 1.0
        points = rng.uniform(0, 400, (68, 2))
        fits.append(
            FrameFit(
                index=index,
                found=index != 2,
                shot=0,
                source="none" if index == 2 else "detected",
                image_size=size,
                camera=Camera(np.full(2, 700.0), np.array([319.5, 239.5]), np.zeros(8)),
                rotation=rng.normal(0, 0.1, 3) * unknown,
                translation=np.array([0.0, 0.0, 600.0]) * unknown,
                expression=rng.uniform(0, 1, len(EXPRESSION)) * unknown,
                identity=rng.normal(0, 1, 3) * unknown,
                observed=points * unknown,
                confidence=np.ones(68) * unknown,
                projected=(points + 1.0) * unknown,
                energies=np.zeros((2, 7)),
                status=np.zeros(2, int),
                iterations=np.ones(2, int),
                milliseconds=np.zeros(3),
            )
        )
    meta = {
        "expression_names": list(EXPRESSION),
        "stages": ["pose", "expression"],
        "config": configuration.preset("joint").model_dump(mode="json"),
        "inputs": [{"path": "clip.mp4", "sha256": "0" * 64}],
        "landmarks": None,
        "names": [],
        "stills": False,
        "frames": [0, 4],
        "rate": 25.0,
        "model": {
            "name": "default-head",
            "sha256": "0" * 64,
            "jaw_unit": {"open_deg": 26.5, "sideways_mm": 8.0, "forward_mm": 8.0},
        },
        "versions": {"workbench": "0.2.0"},
    }
    Track(meta=meta, **stack_fits(fits)).save(folder / "track.npz")


def _use_frame(fit: FrameFit, names: tuple[str, ...]) -> None:
    assert len(fit.expression) == len(names)
    if fit.found and fit.failure != "not finite":
        assert all(np.isfinite(values).all() for values in (fit.rotation, fit.translation, fit.expression, fit.jaw))
        assert np.isfinite(fit.angles_deg).all()
        assert np.isfinite(fit.residuals_px).all()
        assert np.isfinite(np.asarray(project(fit.camera, np.array([[0.0, 0.0, 600.0]])))).all()
    if fit.landmarks is not None:
        assert np.isfinite(fit.landmarks.points).all()


def _use_track(track: Track) -> None:
    for position in (0, len(track) // 2, len(track) - 1):
        _use_frame(track[position], track.expression_names)
    assert frame_errors(track).shape == (len(track), 4)
    assert main_identity(track)[0].shape == track.identity.shape[1:]
    material_of_track(replace(track, meta={**track.meta, "inputs": []}))
    if track.meta.get("config"):
        configuration.parse_config(track.meta["config"], "track")


def read_track(folder: Path) -> None:
    _use_track(Track.load(folder / "track.npz"))


def read_track_by_frames(folder: Path) -> None:
    reader = TrackReader(folder / "track.npz")
    fits = list(reader)
    assert len(fits) == len(reader)
    for fit in fits:
        _use_frame(fit, tuple(reader.meta["expression_names"]))


VERTICES = 20
MODEL = SimpleNamespace(neutral=np.zeros((VERTICES, 3)))
"""Of a face model, a stored appearance needs the number of vertices."""


def make_appearance(folder: Path) -> None:
    rng = np.random.default_rng(5)
    numbers = (rng.uniform(0, 1, shape).astype(np.float32) for shape in ((VERTICES, 3), (9, 3), VERTICES))
    Appearance(*numbers, 0.01).save(folder / "actor.npz")


def read_appearance(folder: Path) -> None:
    appearance = load_appearance(folder / "actor.npz", MODEL)
    assert appearance.albedo.shape == (VERTICES, 3)
    for values in (appearance.albedo, appearance.light, appearance.seen, appearance.residual):
        assert np.isfinite(values).all()


def make_network(folder: Path) -> None:
    save_landmark_network(folder / "network.safetensors", random_landmark_network((2, 2, 2, 2), 1))


def read_network(folder: Path) -> None:
    network = read_landmark_network(folder / "network.safetensors")
    assert all(np.isfinite(array).all() for array in named_arrays(network).values())


def make_checkpoint(folder: Path) -> None:
    _save_checkpoint(folder / "network.pth", zipped=True)


def make_old_checkpoint(folder: Path) -> None:
    _save_checkpoint(folder / "network.pth", zipped=False)


def _save_checkpoint(path: Path, zipped: bool) -> None:
    import torch  # not in the judge's process, which only reads

    state = {"conv.weight": torch.ones(2, 3), "conv.bias": torch.arange(2), "half": torch.ones(2, dtype=torch.half)}
    torch.save({"state_dict": state, "epoch": 3}, path, _use_new_zipfile_serialization=zipped)


def read_checkpoint(folder: Path) -> None:
    weights = torch_checkpoints.read_checkpoint(folder / "network.pth")
    assert weights.arrays
    for array in weights.arrays.values():
        array.sum()


READERS = (
    Reader("configuration", make_config, read_config),
    Reader("retargeting", make_mapping, read_mapping),
    Reader("head-tracking readings", make_boston, read_boston),
    Reader("other program's mesh .mat", make_prnet_mat, read_other_mesh),
    Reader("other program's mesh .npy", make_vertices_npy, read_other_mesh),
    Reader("landmarks csv", make_landmarks_csv, read_landmarks),
    Reader("landmarks json", make_landmarks_json, read_landmarks),
    Reader("landmarks pts", make_landmarks_pts, read_landmarks),
    Reader("landmarks pts of a clip", make_pts_folder, read_pts_folder),
    Reader("OpenFace csv", make_openface, read_sizeless_landmarks),
    Reader("MediaPipe csv", make_mesh_csv, read_sizeless_landmarks),
    Reader("MediaPipe json", make_mesh_json, read_sizeless_landmarks),
    Reader("face-alignment npy", make_points_npy, read_sizeless_landmarks),
    Reader("imglab xml", make_imglab, read_sizeless_landmarks),
    Reader("rig toml", make_rig_toml, read_rig),
    Reader("rig yaml", make_rig_yaml, read_rig),
    Reader("rig json", make_rig_json, read_rig),
    Reader("rig xml", make_rig_xml, read_rig),
    Reader("track", make_track, read_track),
    Reader("track by frames", make_track, read_track_by_frames),
    Reader("appearance", make_appearance, read_appearance),
    Reader("safetensors", make_network, read_network),
    Reader("checkpoint", make_checkpoint, read_checkpoint),
    Reader("checkpoint before 1.6", make_old_checkpoint, read_checkpoint),
    *FACE_READERS,
)
