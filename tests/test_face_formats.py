"""Other people's face models: each format is written as it really is, read, and compared with the truth."""

import builtins
import json
import os
import pickle
import struct

import h5py
import numpy as np
import pytest
import scipy.io
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.face_files import (
    COMPONENTS,
    OFFSET,
    SHAPES,
    Calls,
    chumpy_wrapped,
    flame_arrays,
    flame_embedding,
    make_subject,
    nearest_vertices,
    python2_pickle,
    without_shift,
    write_basel_2009,
    write_basel_2019,
    write_glb,
    write_gnm,
    write_ict,
    write_obj,
    write_obj_folder,
    y_up,
)
from tests.scenes import FOV_DEG, make_scene
from workbench.config import preset
from workbench.errors import ModelError
from workbench.face import arkit_name, landmark_model, load_default_head, load_face_model
from workbench.face.formats.landmark_fit import outward
from workbench.face.formats.obj import read_obj
from workbench.face.formats.pickled_arrays import read_arrays
from workbench.face.formats.shape_names import arkit_shapes
from workbench.landmarks.scheme import MIRROR
from workbench.samples import sample
from workbench.tracker import FaceTracker

NAMED_POINTS = {
    "right.eye.corner_outer": 36,
    "right.eye.corner_inner": 39,
    "left.eye.corner_inner": 42,
    "left.eye.corner_outer": 45,
    "center.nose.tip": 30,
    "right.lips.corner": 48,
    "left.lips.corner": 54,
    "center.chin.tip": 8,
}
STATISTICAL = tuple(f"expression_{k:03d}" for k in range(COMPONENTS))
JAW = ("jawOpen", "jawLeft", "jawRight")


@pytest.fixture(scope="module")
def subject():
    return make_subject()


@pytest.fixture(scope="module")
def flame_file(subject, tmp_path_factory):
    path = tmp_path_factory.mktemp("flame") / "generic_model.pkl"
    path.write_bytes(python2_pickle(flame_arrays(subject)))
    return path


def as_flame_of_python2(folder, subject):
    arrays = flame_arrays(subject)
    arrays |= {key: chumpy_wrapped(arrays[key]) for key in ("v_template", "shapedirs")}
    (folder / "generic_model.pkl").write_bytes(python2_pickle(arrays))
    return folder / "generic_model.pkl"


def as_flame_of_python3(folder, subject):
    arrays = flame_arrays(subject)
    (folder / "flame2023.pkl").write_bytes(pickle.dumps(arrays, protocol=4))
    return folder / "flame2023.pkl"


def as_flame_npz(folder, subject):
    arrays = flame_arrays(subject)
    arrays["J_regressor"] = arrays["J_regressor"].toarray()
    np.savez(folder / "flame2023.npz", **arrays)
    return folder / "flame2023.npz"


def as_flame_with_embedding(folder, subject):
    (folder / "flame_static_embedding.pkl").write_bytes(python2_pickle(flame_embedding(subject)))
    return as_flame_of_python3(folder, subject)


def as_gnm(folder, subject):
    return write_gnm(folder / "gnm_head.npz", subject, subject.expressions, list(STATISTICAL))


def as_basel_2019(folder, subject):
    return write_basel_2019(folder / "model2019_face12.h5", subject, NAMED_POINTS)


def as_ict(folder, subject):
    return write_ict(folder / "FaceXModel", subject)


def as_glb(folder, subject):
    return write_glb(folder / "avatar.glb", subject, {"eyeBlinkLeft": "eyeBlink_L"}, sparse="browInnerUp")


def as_obj_folder(folder, subject):
    return write_obj_folder(folder / "objs", subject, lambda points: points)


def as_obj_folder_in_metres(folder, subject):
    z_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    return write_obj_folder(folder / "objs", subject, lambda points: y_up(points) @ z_up.T + OFFSET)


def as_obj_folder_without_landmarks(folder, subject):
    return write_obj_folder(folder / "objs", subject, lambda points: y_up(points, 10.0), landmarks=False)


WRITERS = {
    "flame python 2": (as_flame_of_python2, (*STATISTICAL, *JAW)),
    "flame python 3": (as_flame_of_python3, (*STATISTICAL, *JAW)),
    "flame npz": (as_flame_npz, (*STATISTICAL, *JAW)),
    "flame embedding": (as_flame_with_embedding, (*STATISTICAL, *JAW)),
    "gnm": (as_gnm, STATISTICAL),
    "basel 2019": (as_basel_2019, STATISTICAL),
    "ict": (as_ict, ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "browInnerUp")),
    "glb": (as_glb, SHAPES),
    "obj": (as_obj_folder, tuple(sorted(SHAPES))),
    "obj metres, z up": (as_obj_folder_in_metres, tuple(sorted(SHAPES))),
    "obj, no landmarks": (as_obj_folder_without_landmarks, tuple(sorted(SHAPES))),
}


@pytest.fixture(scope="module", params=WRITERS)
def loaded(request, subject, tmp_path_factory):
    """(model, names that the format should give) of one format."""
    write, names = WRITERS[request.param]
    return load_face_model(write(tmp_path_factory.mktemp("model"), subject)), names


def test_vertices_come_back_in_millimetres_and_the_head_frame(loaded, subject):
    model, _ = loaded
    np.testing.assert_allclose(without_shift(model, subject), subject.vertices, atol=0.05)
    # The origin is between the eyes' centres, as well as the file tells them.
    np.testing.assert_allclose(model.neutral[: len(subject.vertices)].mean(0), subject.vertices.mean(0), atol=6.0)


def test_shapes_have_the_right_names_and_offsets(loaded, subject):
    model, names = loaded
    assert model.expression_names == names
    count = len(subject.vertices)
    for name in set(names) & set(SHAPES) - (set(JAW) if STATISTICAL[0] in names else set()):
        delta = model.expression_deltas[names.index(name)][:count]
        np.testing.assert_allclose(delta, subject.shapes[name], atol=0.01)
    for k, name in enumerate(name for name in names if name in STATISTICAL):
        np.testing.assert_allclose(model.expression_deltas[names.index(name)], subject.expressions[k], atol=0.01)
        assert model.weight_range()[names.index(name)].tolist() == [-3.0, 3.0]


def test_identity_components_come_back_with_unit_variance(loaded, subject):
    model, _ = loaded
    for k, delta in enumerate(model.identity_deltas):
        np.testing.assert_allclose(delta, subject.identity[k], atol=0.01)


def test_landmarks_lie_where_they_belong(loaded, subject):
    model, _ = loaded
    points = model.landmarks.of(model.neutral)
    truth = subject.landmarks.of(subject.vertices)
    error = np.linalg.norm(points - points[17:].mean(0) - truth + truth[17:].mean(0), axis=1)
    assert np.isfinite(points).all()
    assert error[17:].mean() < 2.0
    assert error[:17].mean() < 4.0


def test_left_is_the_subjects_left(loaded, subject):
    model, names = loaded
    points = model.landmarks.of(model.neutral)
    assert points[45, 0] > 25.0
    assert points[36, 0] < -25.0
    if "mouthSmileLeft" in names:
        moved = np.linalg.norm(model.expression_deltas[names.index("mouthSmileLeft")], axis=1)
        assert moved @ model.neutral[:, 0] / moved.sum() > 10.0
    if "leftEye" in model.joints:
        np.testing.assert_allclose(model.joints["leftEye"], -model.joints["rightEye"], atol=1.0)
        assert model.joints["leftEye"][0] > 25.0


def test_triangles_face_outwards_and_the_contour_slides(loaded):
    model, _ = loaded
    assert outward(model.neutral, model.triangles)
    turned = model.contour.of(model.neutral)
    # Turned to the own right, the right side of the contour moves towards the nose.
    assert turned[-1, :8, 2].mean() < turned[0, :8, 2].mean() - 5.0


@pytest.mark.parametrize("whole", ["cheekPuff", "Cheek_Puff"])
def test_halves_beside_the_whole_shape_are_shapes_of_their_own(whole):
    names = ("cheekPuff_L", whole, "cheekPuff_R")
    order, deltas, _ = arkit_shapes(names, np.ones((3, 4, 3)), np.tile([0.0, 1.0], (3, 1)))
    assert order == ("cheekPuff_L", "cheekPuff", "cheekPuff_R")
    assert (deltas == 1.0).all()


def test_gltf_keeps_what_is_inside_the_head_and_leaves_the_body_out(subject, tmp_path):
    model = load_face_model(as_glb(tmp_path, subject))
    assert len(model.neutral) == len(subject.vertices) + 8
    assert model.notes[-1].startswith("stored in metres")


def test_basel_2009_has_a_face_and_no_expressions(subject, tmp_path):
    path = write_basel_2009(tmp_path / "01_MorphableModel.mat", subject)
    (tmp_path / "points.toml").write_text(f"vertices = {nearest_vertices(subject).tolist()}\n")
    model = load_face_model(path, landmarks=tmp_path / "points.toml")
    np.testing.assert_allclose(without_shift(model, subject), subject.vertices, atol=0.05)
    np.testing.assert_allclose(model.identity_deltas, subject.identity, atol=0.01)
    assert model.expression_names == ()
    assert "no expressions" in model.notes[0]
    assert outward(model.neutral, model.triangles)
    assert model.colors.max() == 120


@pytest.mark.parametrize("name", ["face-it", "calibrated", "joint"])
def test_a_model_without_expressions_is_fitted_by_pose_and_identity(name, subject, tmp_path):
    (tmp_path / "points.toml").write_text(f"vertices = {nearest_vertices(subject).tolist()}\n")
    path = write_basel_2009(tmp_path / "01_MorphableModel.mat", subject)
    model = load_face_model(path, landmarks=tmp_path / "points.toml")
    scene = make_scene(model, (6.0, 4.0, 2.0), sliding=name != "face-it")
    config = preset(name).changed(camera={"fov_deg": FOV_DEG})
    (fit,) = FaceTracker(model, config).fit_all([scene.observation(0)])
    np.testing.assert_allclose(fit.angles_deg, scene.angles_deg, atol=0.5)
    assert fit.residuals_px.mean() < 0.2
    assert fit.expression.shape == (0,)


def test_the_jaw_of_flame_is_a_joint_and_three_shapes(flame_file, subject):
    model = load_face_model(flame_file)
    np.testing.assert_allclose(
        model.joints["jaw"] - model.joints["leftEye"], subject.joints["jaw"] - subject.joints["leftEye"], atol=0.1
    )
    np.testing.assert_allclose(model.jaw_weights, subject.jaw_weights, atol=1e-6)
    chin = {name: model.landmarks.of(model.expression_deltas[model.expression_names.index(name)])[8] for name in JAW}
    assert chin["jawOpen"][1] > 15.0
    assert chin["jawLeft"][0] > 5.0
    assert chin["jawRight"][0] < -5.0
    assert model.jaw_unit.open_deg == pytest.approx(26.5, abs=0.1)
    hang = model.jaw_weights[model.landmarks.vertices[8]] @ model.landmarks.barycentric[8]
    assert hang * model.jaw_unit.sideways_mm == pytest.approx(chin["jawLeft"][0], rel=0.1)


def test_components_are_limited_and_unlimited(flame_file, subject):
    few = load_face_model(flame_file, identity=3, expressions=2)
    assert len(few.identity_deltas) == 3
    assert few.expression_names == ("expression_000", "expression_001", *JAW)
    assert len(load_face_model(flame_file, identity=None, expressions=None).identity_deltas) == COMPONENTS


def test_the_largest_components_of_gnm_are_kept_under_their_names(subject, tmp_path):
    small, large = 0.01 * subject.expressions[:2], subject.expressions[:2]
    names = ["left_eye_region_0", "left_eye_region_1", "lower_face_region_0", "lower_face_region_1"]
    write_gnm(tmp_path / "gnm_head.npz", subject, np.concatenate([small, large]), names)
    model = load_face_model(tmp_path / "gnm_head.npz", expressions=2)
    assert model.expression_names == ("lower_face_region_0", "lower_face_region_1")
    assert set(model.regions) == {"skin", "left"}


def test_the_axes_of_gnm_are_told_by_its_joints(subject, tmp_path):
    z_up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    write_gnm(tmp_path / "gnm_head.npz", subject, subject.expressions[:2], ["a_0", "a_1"], z_up)
    model = load_face_model(tmp_path / "gnm_head.npz")
    np.testing.assert_allclose(without_shift(model, subject), subject.vertices, atol=0.05)
    np.testing.assert_allclose(model.expression_deltas, subject.expressions[:2], atol=0.01)


@pytest.mark.train
def test_an_embedding_with_tensors_of_pytorch_gives_its_arrays(flame_file, subject, tmp_path):
    """DECA's landmark_embedding.npy holds its sliding contour as tensors, which are left out."""
    torch = pytest.importorskip("torch")
    embedding = {
        "full_lmk_faces_idx": flame_embedding(subject)["lmk_face_idx"][None],
        "full_lmk_bary_coords": flame_embedding(subject)["lmk_b_coords"][None],
        "dynamic_lmk_faces_idx": torch.zeros((79, 17), dtype=torch.long),
        "dynamic_lmk_bary_coords": torch.zeros((79, 17, 3)),
    }
    np.save(tmp_path / "landmark_embedding.npy", np.array(embedding, object), allow_pickle=True)
    model = load_face_model(flame_file, landmarks=tmp_path / "landmark_embedding.npy")
    assert "51 landmarks from the file" in model.notes[-1]
    assert len(model.contour_yaw_deg) == 9


def test_the_published_contour_of_flame_is_read_with_either_sign(subject, tmp_path):
    for sign in (1, -1):
        folder = tmp_path / f"sign{sign}"
        folder.mkdir()
        path = as_flame_of_python3(folder, subject)
        _write_contour(folder, subject, sign)
        model = load_face_model(path)
        assert model.contour_yaw_deg.tolist() == [-39, -30, -20, -10, 0, 10, 20, 30, 39]
        depth = model.contour.of(model.neutral)[:, :8, 2].mean(1)
        assert depth[-1] < depth[4] < depth[0]


def _write_contour(folder, subject, sign):
    """79 contours as FLAME publishes them; `sign` is what a positive entry turns the head by in our sign."""
    centres = subject.vertices[subject.triangles].mean(1)
    yaws = np.array(list(subject.contours))
    faces = np.zeros((79, 17), np.int64)
    for entry in range(79):
        turn = sign * (entry if entry < 40 else 39 - entry)
        places = subject.contours[yaws[np.argmin(np.abs(yaws - turn))]]
        faces[entry] = np.argmin(np.linalg.norm(centres[None] - places[:, None], axis=-1), axis=1)
    table = {"lmk_face_idx": faces, "lmk_b_coords": np.full((79, 17, 3), 1 / 3)}
    np.save(folder / "flame_dynamic_embedding.npy", np.array(table, object), allow_pickle=True)


def test_an_embedding_may_be_named(flame_file, subject, tmp_path):
    np.save(tmp_path / "mine.npy", np.array(flame_embedding(subject), object), allow_pickle=True)
    model = load_face_model(flame_file, landmarks=tmp_path / "mine.npy")
    truth = subject.landmarks.of(subject.vertices)[17:]
    points = model.landmarks.of(model.neutral)[17:]
    np.testing.assert_allclose(points - points.mean(0), truth - truth.mean(0), atol=0.01)


@pytest.mark.parametrize("write", [as_gnm, as_glb, as_obj_folder])
def test_an_embedding_for_another_model_than_flame_is_refused(write, subject, tmp_path):
    np.save(tmp_path / "mine.npy", np.array(flame_embedding(subject), object), allow_pickle=True)
    with pytest.raises(ModelError, match=r"is not a landmarks\.toml: embeddings are read for FLAME only"):
        load_face_model(write(tmp_path, subject), landmarks=tmp_path / "mine.npy")


@pytest.mark.parametrize("options", [{"landmarks": "points.toml"}, {"unit": "cm"}])
def test_the_workbenchs_own_head_takes_no_landmarks_and_no_unit(options):
    with pytest.raises(ModelError, match="is the workbench's own head: leave landmarks and unit out"):
        load_face_model(sample("head"), **options)


def test_an_obj_may_begin_with_a_byte_order_mark(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8-sig")
    np.testing.assert_array_equal(read_obj(tmp_path / "a.obj").vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_the_workbenchs_own_head_is_read(head):
    assert load_face_model(sample("head")).fingerprint() == load_default_head(sample("head")).fingerprint()


@pytest.mark.parametrize("unit_mm", [1000.0, 10.0, 1.0, 0.001])
def test_units_are_recognised_by_the_heads_size(unit_mm, subject, tmp_path):
    folder = write_obj_folder(tmp_path / "objs", subject, lambda points: y_up(points, unit_mm))
    if unit_mm == 1000.0:  # six decimals of a metre
        assert "metres" in load_face_model(folder).notes[-1]
    width = np.ptp(load_face_model(folder).neutral[:, 0])
    assert width == pytest.approx(np.ptp(subject.vertices[:, 0]), rel=1e-3)


@pytest.mark.parametrize("size", [1.0, 0.8])
def test_the_jaw_of_a_small_head_travels_less(size, subject, tmp_path):
    model = load_face_model(write_obj_folder(tmp_path / "objs", subject, lambda points: y_up(size * points, 1.0)))
    whole = load_face_model(write_obj_folder(tmp_path / "whole", subject, lambda points: y_up(points, 1.0)))
    np.testing.assert_array_equal(model.jaw_range[:, :3], whole.jaw_range[:, :3])  # angles know no size
    np.testing.assert_allclose(model.jaw_range[:, 3:], size * whole.jaw_range[:, 3:], rtol=1e-3)


def test_a_head_of_no_human_size_needs_its_unit(subject, tmp_path):
    folder = write_obj_folder(tmp_path / "objs", subject, lambda points: y_up(points, 33.0))
    with pytest.raises(ModelError, match=r"not of human size.*--unit cm"):
        load_face_model(folder)
    width = np.ptp(load_face_model(folder, unit="cm").neutral[:, 0])
    assert width == pytest.approx(np.ptp(subject.vertices[:, 0]) * 10.0 / 33.0, rel=1e-3)


@pytest.mark.parametrize(
    ("written", "read"),
    [
        ("jawOpen", "jawOpen"),
        ("JawOpen", "jawOpen"),
        ("eyeBlink_L", "eyeBlinkLeft"),
        ("Face.browDown.R", "browDownRight"),
        ("blendShape1.mouth_smile_left", "mouthSmileLeft"),
        ("expression_000", None),
        ("left", None),
    ],
)
def test_names_are_brought_to_arkits_spelling(written, read):
    assert arkit_name(written) == read


# --- hostile and broken files -----------------------------------------------------------------------------------------


def payloads(trap):
    """Calls that would create the file `trap`."""
    return {
        "os.system": Calls(os.system, f"touch {trap}"),
        "eval": Calls(builtins.eval, f"open({str(trap)!r}, 'w').close()"),
        "exec": Calls(builtins.exec, f"open({str(trap)!r}, 'w').close()"),
        "os.mkdir": Calls(os.mkdir, str(trap)),
        "numpy": Calls(np.savetxt, str(trap), [1.0]),
    }


@pytest.mark.parametrize("protocol", [0, 1, 2, 3, 4, 5])
@pytest.mark.parametrize("kind", payloads(""))
def test_a_hostile_pickle_is_refused_and_nothing_runs(kind, protocol, subject, tmp_path):
    trap = tmp_path / "trap"
    arrays = {"v_template": np.zeros((3, 3)), "shapedirs": payloads(trap)[kind]}
    path = tmp_path / "model.pkl"
    path.write_bytes(pickle.dumps(arrays, protocol=protocol))
    with pytest.raises(ModelError, match="nothing of it was run"):
        load_face_model(path)
    assert not trap.exists()
    pickle.loads(path.read_bytes())
    assert trap.exists()  # the payload was a real one


def test_a_payload_inside_an_npz_or_npy_is_refused_as_well(flame_file, tmp_path):
    trap = tmp_path / "trap"
    hostile = np.array(payloads(trap)["os.system"], object)
    np.savez(tmp_path / "model.npz", v_template=np.zeros((3, 3)), shapedirs=hostile)
    np.save(tmp_path / "landmark_embedding.npy", hostile, allow_pickle=True)
    for options in ({}, {"landmarks": tmp_path / "landmark_embedding.npy"}):
        with pytest.raises(ModelError, match="system, which no face model needs"):
            load_face_model(flame_file if options else tmp_path / "model.npz", **options)
    assert not trap.exists()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"(S'touch trap'\nios\nsystem\n.", "opcode INST"),
        (b"(cos\nsystem\nS'touch trap'\no.", "opcode OBJ"),
        (b"cos\nsystem\n(S'touch trap'\ntR.", "calls os.system"),
        (b"S'touch trap'\ncos\nsystem\n\x81.", "no name|broken|cannot be read"),
        (b"hello", "no opcode|cannot be read"),
        (b"", "is empty"),
        (b"}.", "neither FLAME"),
        (b"]q\x00h\x00a.", "nested without end"),
        (b"(dp0\nS'again\nI1\ns.", "no quotes"),
    ],
)
def test_pickles_that_are_no_model_are_told_in_one_sentence(content, message, tmp_path):
    path = tmp_path / "model.pkl"
    path.write_bytes(content)
    with pytest.raises(ModelError, match=message):
        load_face_model(path)


SMALL = {
    "v_template": np.arange(12.0).reshape(4, 3),
    "f": np.array([[0, 1, 2]], np.uint32),
    "shapedirs": np.zeros((4, 3, 20)),
    "wrapped": chumpy_wrapped(np.eye(2)),
}


@settings(max_examples=60)
@given(st.integers(0, 4), st.floats(0.0, 1.0), st.integers(0, 255))
def test_damaged_pickles_are_refused_or_read_as_plain_arrays(tmp_path_factory, protocol, place, byte):
    content = bytearray(pickle.dumps(SMALL, protocol=protocol))
    at = int(place * (len(content) - 1))
    path = tmp_path_factory.mktemp("damaged") / "model.pkl"
    path.write_bytes(content[:at])
    with pytest.raises(ModelError, match=r"model\.pkl"):  # a pickle without its end is none
        read_arrays(path)
    path.write_bytes(bytes(content[:at]) + bytes([byte]) + bytes(content[at + 1 :]))
    read, refused = {}, f"{path} in one line"
    try:
        read = read_arrays(path)
    except ModelError as error:
        refused = str(error)
    assert str(path) in refused
    assert "\n" not in refused
    assert not any(isinstance(value, np.ndarray) and value.dtype.hasobject for value in read.values())


def test_arrays_of_every_kind_come_back_from_pickles(tmp_path):
    wanted = {
        "f8": np.arange(6.0).reshape(2, 3),
        "f4": np.asfortranarray(np.arange(6, dtype=np.float32).reshape(2, 3)),
        "big": np.arange(4, dtype=">i4"),
        "bool": np.array([True, False]),
        "scalar": np.float64(2.5),
        "empty": np.zeros((0, 3)),
    }
    written = [pickle.dumps(wanted, protocol=protocol) for protocol in range(6)] + [python2_pickle(wanted)]
    for content in written:
        (tmp_path / "arrays.pkl").write_bytes(content)
        read = read_arrays(tmp_path / "arrays.pkl")
        for name, array in wanted.items():
            np.testing.assert_array_equal(read[name], array)


# --- missing and inconsistent data ------------------------------------------------------------------------------------


def flame_without(key):
    def damage(folder, subject):
        arrays = flame_arrays(subject)
        del arrays[key]
        (folder / "model.pkl").write_bytes(pickle.dumps(arrays))
        return folder / "model.pkl"

    return damage


def flame_with(**changes):
    def damage(folder, subject):
        (folder / "model.pkl").write_bytes(pickle.dumps(flame_arrays(subject) | changes))
        return folder / "model.pkl"

    return damage


def flame_with_foreign_embedding(folder, subject):
    embedding = flame_embedding(subject)
    embedding["lmk_face_idx"] = embedding["lmk_face_idx"] + 100_000
    (folder / "flame_static_embedding.pkl").write_bytes(pickle.dumps(embedding))
    return as_flame_of_python3(folder, subject)


def cut_file(write, part):
    def damage(folder, subject):
        path = write(folder, subject)
        path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])
        return path

    return damage


def basel_without_expression_variance(folder, subject):
    path = as_basel_2019(folder, subject)
    with h5py.File(path, "a") as stored:
        del stored["expression/model/pcaVariance"]
    return path


def mat_of_something_else(folder, subject):
    scipy.io.savemat(folder / "other.mat", {"x": np.zeros(3)})
    return folder / "other.mat"


def ict_without(name):
    def damage(folder, subject):
        path = as_ict(folder, subject)
        (path / name).unlink()
        return path

    return damage


def ict_with_other_mesh(folder, subject):
    path = as_ict(folder, subject)
    write_obj(path / "jawOpen.obj", subject.vertices[:50], np.array([[0, 1, 2]]))
    return path


def glb_json(change):
    """A .glb whose JSON was changed."""

    def damage(folder, subject):
        path = as_glb(folder, subject)
        content = path.read_bytes()
        size = struct.unpack_from("<I", content, 12)[0]
        document = json.loads(content[20 : 20 + size])
        change(document)
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        rest = content[20 + size :]
        head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
        path.write_bytes(head + struct.pack("<I4s", len(text), b"JSON") + text + rest)
        return path

    return damage


def no_targets(document):
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            primitive.pop("targets", None)


def compressed(document):
    document["extensionsRequired"] = ["KHR_draco_mesh_compression"]


def beyond_buffer(document):
    document["accessors"][0]["count"] = 10**7


def outside_folder(document):
    document["buffers"][0]["uri"] = "../../secret.bin"


def unnamed_targets(document):
    document["meshes"][0]["extras"] = {}


def swapped_landmarks(folder, subject):
    path = as_obj_folder(folder, subject)
    (path / "landmarks.toml").write_text(f"vertices = {nearest_vertices(subject)[list(MIRROR)].tolist()}\n")
    return path


def ict_with_swapped_landmarks(folder, subject):
    path = as_ict(folder, subject)
    stored = json.loads((path / "vertex_indices.json").read_text())
    stored["idx_to_landmark_verts"] = [stored["idx_to_landmark_verts"][point] for point in MIRROR]
    (path / "vertex_indices.json").write_text(json.dumps(stored))
    return path


def a_sphere(folder, subject):
    ball = trimesh.creation.icosphere(subdivisions=4, radius=90.0)
    (folder / "ball").mkdir()
    write_obj(folder / "ball" / "neutral.obj", ball.vertices, ball.faces)
    for name, centre in {"jawOpen": (0, 80, 0), "eyeBlinkLeft": (40, 0, 70), "eyeBlinkRight": (-40, 0, 70)}.items():
        near = np.linalg.norm(ball.vertices - centre, axis=1) < 40.0
        write_obj(folder / "ball" / f"{name}.obj", ball.vertices + near[:, None] * [0.0, 3.0, 0.0], ball.faces)
    return folder / "ball"


def file_named(name):
    def damage(folder, subject):
        (folder / name).write_bytes(b"something")
        return folder / name

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder, subject: folder / "nothing.pkl", "There is no face model"),
        (flame_without("f"), "f is missing"),
        (flame_without("shapedirs"), "neither FLAME"),
        (flame_with(shapedirs=np.zeros((7, 3, 20))), "shapedirs has shape"),
        (flame_with(shapedirs=np.zeros((7, 3, 33))), "FLAME's is"),
        (flame_with(v_template="text"), "is str, not an array"),
        (flame_with(f=np.array([[0, 1, 10**6]])), "names vertex 1000000"),
        (flame_with(f=np.array([[0, 1, -2]])), "names vertex -2"),
        (flame_with(J_regressor=np.zeros((4, 9))), "J_regressor has shape"),
        (flame_with(weights=np.zeros((4, 9))), "weights has shape"),
        (flame_with(posedirs=np.zeros((4, 9))), "posedirs has shape"),
        (flame_with_foreign_embedding, "take the embedding that belongs to it"),
        (cut_file(as_flame_npz, 0.6), "cannot be read as arrays"),
        (cut_file(as_basel_2019, 0.5), "cannot be read as HDF5"),
        (basel_without_expression_variance, "expression/model/pcaVariance is missing"),
        (mat_of_something_else, "shapeMU is missing"),
        (file_named("model.mat"), "cannot be read as a MATLAB file"),
        (ict_without("jawOpen.obj"), "lists the expression jawOpen"),
        (ict_without("vertex_indices.json"), "needs vertex_indices.json"),
        (ict_without("generic_neutral_mesh.obj"), "needs generic_neutral_mesh.obj"),
        (ict_with_other_mesh, "all targets must come from one mesh"),
        (cut_file(as_glb, 0.5), "supply a whole glTF"),
        (glb_json(no_targets), "no morph targets"),
        (glb_json(compressed), "without compression"),
        (glb_json(beyond_buffer), "reaches beyond its buffer"),
        (glb_json(outside_folder), "copy the whole folder"),
        (glb_json(unnamed_targets), "does not say where its face is"),
        (file_named("face.gltf"), "cannot be read as glTF"),
        (file_named("face.fbx"), "export glTF"),
        (file_named("face.obj"), "one mesh"),
        (file_named("face.docx"), "supported are"),
        (swapped_landmarks, "only when mirrored"),
        (ict_with_swapped_landmarks, "only when mirrored"),
        (a_sphere, "landmarks.toml"),
    ],
)
def test_what_is_wrong_with_a_file_is_told_in_one_sentence(damage, message, subject, tmp_path):
    with pytest.raises(ModelError, match=message) as told:
        load_face_model(damage(tmp_path, subject))
    assert "\n" not in str(told.value)


# --- a fit with such a model ------------------------------------------------------------------------------------------


# The paper's E_β knows weights in [0, 1] and has no place here; its E_σ stands in the way of components of either sign.
@pytest.mark.long
@pytest.mark.parametrize(("name", "degrees", "pixels"), [("joint", 1.5, 1.5), ("face-it", 6.0, 5.0)])
def test_face_it_tracks_with_ten_identity_and_ten_expression_components(name, degrees, pixels, flame_file):
    model = load_face_model(flame_file)
    rng = np.random.default_rng(5)
    calibrated = name == "joint"
    identity = 0.5 * rng.normal(size=COMPONENTS) * calibrated
    scenes = []
    for index in range(4):
        weights = {f"expression_{k:03d}": float(weight) for k, weight in enumerate(rng.uniform(-1.5, 1.5, 3))}
        angles = (6.0 * index - 8.0, 4.0, 2.0)
        scenes.append(make_scene(model, angles, weights | {"jawOpen": 0.2 * index}, identity, sliding=calibrated))
    config = preset(name).changed(camera={"fov_deg": FOV_DEG}, weights={"beta": 0.0})
    tracker = FaceTracker(model, config if calibrated else config.changed(weights={"sigma": 0.01}))
    fits = list(tracker.fit_all(scene.observation(index) for index, scene in enumerate(scenes)))
    assert len(fits) == 4
    for fit, scene in zip(fits, scenes, strict=True):
        assert fit.expression.shape == (COMPONENTS + 3,)
        np.testing.assert_allclose(fit.angles_deg, scene.angles_deg, atol=degrees)
        assert fit.residuals_px.mean() < pixels
    # Components go below zero, where the weights of blendshapes may not.
    assert min(fit.expression[:COMPONENTS].min() for fit in fits) < -0.1
    if calibrated:
        assert min(fit.expression[COMPONENTS:].min() for fit in fits) >= 0.0
        assert fits[0].identity.shape == (COMPONENTS,)
        assert np.abs(fits[0].identity).max() > 0.1


def test_the_landmark_model_bounds_each_weight_by_its_own_range(flame_file):
    model = load_face_model(flame_file)
    points = landmark_model(model)
    assert points.expression_lower.tolist() == [-3.0] * COMPONENTS + [0.0] * 3
    assert points.expression_upper.tolist() == [3.0] * COMPONENTS + [1.0] * 3
