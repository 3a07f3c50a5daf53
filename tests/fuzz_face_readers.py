"""The readers of face models, pictures and videos for the fuzz suite: small valid files, and a use of what was read."""

import json
import pickle
from dataclasses import fields
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from tests import face_files
from tests.fuzzing import Reader
from workbench.face import FaceModel, load_default_head, load_face_model, read_obj_folder
from workbench.face.formats.loading import read_raw_model
from workbench.face.formats.raw import RawModel
from workbench.frames import IMAGE_SUFFIXES, VideoWriter, open_frames, read_picture


@cache
def subject() -> face_files.Subject:
    return face_files.small_subject()


# --- what a model must be ---


def check_sense(model: RawModel | FaceModel, vertices: np.ndarray) -> None:
    """Fail where a part of the model is no number, or names what is not there."""
    for part in fields(model):
        check_finite(part.name, getattr(model, part.name))
    assert model.triangles.ndim == 2
    assert not model.triangles.size or 0 <= model.triangles.min() <= model.triangles.max() < len(vertices)
    assert len(model.expression_names) == len(model.expression_deltas) == len(set(model.expression_names))
    assert model.expression_deltas.shape[1:] == vertices.shape
    if model.triangles_uv is not None and model.uv is not None:
        assert model.triangles_uv.shape == model.triangles.shape
        assert not model.triangles_uv.size or 0 <= model.triangles_uv.min() <= model.triangles_uv.max() < len(model.uv)
    if model.mirror is not None:
        assert np.all((model.mirror >= 0) & (model.mirror < len(vertices)))


def check_finite(name: str, value: object) -> None:
    if isinstance(value, np.ndarray):
        assert value.dtype.kind in "biuf", name
        assert np.isfinite(value).all(), name
    for inner in value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else ():
        check_finite(name, inner)


def use_raw(model: RawModel) -> None:
    check_sense(model, model.vertices)
    low, high = model.vertices.min(0), model.vertices.max(0)
    for point, (corners, weights) in model.landmarks.items():
        assert 0 <= point < 68
        # Within the mesh, or a little beyond a triangle at its edge.
        place = weights @ model.vertices[corners]
        assert np.all((place >= 2 * low - high - 1e-9) & (place <= 2 * high - low + 1e-9))
    if model.identity_deltas is not None:
        assert model.identity_deltas.shape[1:] == model.vertices.shape
    for index in (model.regions or {}).values():
        assert np.all((index >= 0) & (index < len(model.vertices)))


def use_face(model: FaceModel) -> None:
    check_sense(model, model.neutral)
    personal = model.personal(np.full(len(model.identity_deltas), 0.5))
    weights = np.full(len(model.expression_names), 0.5)
    assert np.isfinite(model.landmarks.of(personal.vertices(weights))).all()
    assert np.isfinite(model.contour.of(model.neutral)).all()
    assert np.all(np.diff(model.contour_yaw_deg) > 0.0)


def read_raw(folder: Path) -> None:
    path = next((path for path in folder.iterdir() if path.stem == "model"), folder / "model")
    use_raw(read_raw_model(path, identity=None, expressions=None))


def read_whole(folder: Path) -> None:
    use_face(load_face_model(folder / "model"))


# --- models ---


def flame_arrays() -> dict[str, object]:
    arrays = face_files.flame_arrays(subject())
    return {name: value for name, value in arrays.items() if name != "posedirs"}


def make_flame_npz(folder: Path) -> None:
    arrays = flame_arrays()
    np.savez(folder / "model.npz", **(arrays | {"J_regressor": arrays["J_regressor"].toarray()}))


def make_flame_pickle(folder: Path) -> None:
    (folder / "model.pkl").write_bytes(pickle.dumps(flame_arrays(), protocol=2))
    embedding = {"lmk_face_idx": np.arange(51), "lmk_b_coords": np.full((51, 3), 1 / 3)}
    (folder / "flame_static_embedding.pkl").write_bytes(face_files.python2_pickle(embedding))


def make_gnm(folder: Path) -> None:
    face_files.write_gnm(folder / "model.npz", subject(), subject().expressions, [f"e{k}" for k in range(10)])


def make_basel_mat(folder: Path) -> None:
    face_files.write_basel_2009(folder / "model.mat", subject())


def make_basel_h5(folder: Path) -> None:
    face_files.write_basel_2019(folder / "model.h5", subject(), {"center.nose.tip": 30, "left.eye.corner_inner": 42})


def make_glb(folder: Path) -> None:
    face_files.write_glb(folder / "model.glb", subject(), {}, sparse="browInnerUp")


def make_ict(folder: Path) -> None:
    face_files.write_ict(folder / "model", subject())


def make_objs(folder: Path) -> None:
    face_files.write_obj_folder(folder / "model", subject(), lambda points: points)
    landmarks = {"vertices": [[k, k + 1, k + 2] for k in range(68)], "barycentric": [[0.5, 0.25, 0.25]] * 68}
    text = "\n".join(f"{key} = {json.dumps(rows)}" for key, rows in landmarks.items())
    (folder / "model" / "landmarks.toml").write_text(text)


def read_objs(folder: Path) -> None:
    read_raw(folder)
    use_face(read_obj_folder(folder / "model"))


def make_own_head(folder: Path) -> None:
    person, steps, rng = subject(), 1e-3, np.random.default_rng(2)
    count, places = len(person.vertices), np.arange(68)
    contour = np.stack([places[:17]] * 3)
    np.savez(
        folder / "head.npz",
        neutral=person.vertices.astype(np.float32),
        triangles=person.triangles.astype(np.uint16),
        expression_names=np.array(list(person.shapes)),
        expression_deltas=np.round(np.stack(list(person.shapes.values())) / steps).astype(np.int16),
        expression_step_mm=np.float64(steps),
        identity_deltas=np.round(person.identity[:3] / steps).astype(np.int16),
        identity_step_mm=np.float64(steps),
        landmark_vertices=person.landmarks.vertices,
        landmark_barycentric=person.landmarks.barycentric,
        contour_yaw_deg=np.array([-20.0, 0.0, 20.0]),
        contour_vertices=np.stack([contour] * 3, axis=-1),
        contour_barycentric=np.tile([1.0, 0.0, 0.0], (3, 17, 1)),
        colors=np.full((count, 3), 190, np.uint8),
        region_names=np.array(["skin", "lips"]),
        regions=(np.arange(count) > 60).astype(np.uint8),
        joint_names=np.array(list(person.joints)),
        joints=np.stack(list(person.joints.values())),
        jaw_weights=person.jaw_weights,
        uv=rng.uniform(0.0, 1.0, (count, 2)),
        triangles_uv=person.triangles,
        mirror=np.arange(count),
        identity_joint_deltas=np.zeros((3, len(person.joints), 3)),
        blink_scale_mean=np.ones(2),
        blink_scale_identity=np.zeros((3, 2)),
    )


def read_own_head(folder: Path) -> None:
    use_face(load_default_head(folder / "head.npz", gaze=True))


def make_whole(folder: Path) -> None:
    face_files.write_obj_folder(
        folder / "model", face_files.make_subject(), lambda points: face_files.y_up(points, 10.0)
    )
    for path in sorted((folder / "model").glob("*.obj")):
        if path.stem not in ("neutral", "jawOpen"):
            path.unlink()


# --- pictures ---


def picture() -> np.ndarray:
    return np.random.default_rng(3).integers(0, 255, (48, 64, 3), np.uint8)


def make_pictures(folder: Path) -> None:
    for suffix in IMAGE_SUFFIXES:
        stored = picture()[..., 0] if suffix in (".pgm", ".pbm") else picture()
        (folder / f"p{suffix}").write_bytes(cv2.imencode(suffix, stored)[1].tobytes())


def read_pictures(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        decoded = read_picture(path)
        assert decoded.dtype == np.uint8
        assert decoded.ndim == 3
        assert decoded.shape[2] == 3
        assert decoded.size


def make_videos(folder: Path) -> None:
    for suffix in (".mp4", ".mkv"):
        with VideoWriter(folder / f"v{suffix}") as writer:
            for _ in range(4):
                writer.write(picture())


def read_videos(folder: Path) -> None:
    for path in sorted(folder.iterdir()):
        frames = open_frames(path)
        for frame in frames.iterate():
            assert np.isfinite(frame.time_s)
            assert frame.picture.dtype == np.uint8
            assert frame.picture.ndim == 3


FACE_READERS = (
    Reader("FLAME .npz", make_flame_npz, read_raw),
    Reader("FLAME .pkl", make_flame_pickle, read_raw),
    Reader("GNM .npz", make_gnm, read_raw),
    Reader("Basel .mat", make_basel_mat, read_raw),
    Reader("Basel .h5", make_basel_h5, read_raw, share=0.1),
    Reader("glTF .glb", make_glb, read_raw),
    Reader("ICT-FaceKit", make_ict, read_raw),
    Reader("OBJ folder", make_objs, read_objs, share=0.5),
    Reader("own head .npz", make_own_head, read_own_head),
    Reader("whole model", make_whole, read_whole, share=0.01),
    Reader("pictures", make_pictures, read_pictures),
    Reader("videos", make_videos, read_videos, share=0.5),
)
