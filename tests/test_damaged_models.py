"""Damaged and hostile face models: one sentence each, before anything is computed, allocated or waited for."""

import json
import os
import struct
import zlib

import h5py
import numpy as np
import pytest
import scipy.io

from tests.face_files import (
    flame_arrays,
    small_subject,
    write_basel_2009,
    write_basel_2019,
    write_glb,
    write_gnm,
    write_ict,
    write_obj_folder,
    y_up,
)
from workbench.errors import ModelError
from workbench.face import load_default_head, load_face_model, read_obj_folder
from workbench.face.formats.basel import read_basel_h5, read_basel_mat
from workbench.face.formats.gltf import read_gltf
from workbench.face.formats.ict_facekit import read_ict_facekit
from workbench.face.formats.matlab import matlab_arrays
from workbench.face.formats.obj import read_landmarks_toml, read_obj, read_obj_targets
from workbench.samples import sample

SUBJECT = small_subject()


def refused(read, path, message):
    """The read raises a `ModelError` of one line that matches."""
    with pytest.raises(ModelError, match=message) as told:
        read(path)
    assert "\n" not in str(told.value)
    assert len(str(told.value)) < 600


# --- MATLAB -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_matlab_arrays_are_read_as_scipy_reads_them(kind, packed, tmp_path):
    written = {"a": np.arange(24).reshape(4, 6).astype(kind), "text": "left alone", "b": np.zeros((0, 3), kind)}
    scipy.io.savemat(tmp_path / "x.mat", written, do_compression=packed)
    read = matlab_arrays((tmp_path / "x.mat").read_bytes(), ["a", "b", "absent"])
    assert set(read) == {"a", "b"}
    for name, array in read.items():
        np.testing.assert_array_equal(array, scipy.io.loadmat(tmp_path / "x.mat")[name])
        assert array.dtype == np.dtype(kind)


def test_no_changed_byte_of_a_matlab_file_ends_the_process(tmp_path):
    content = write_basel_2009(tmp_path / "m.mat", SUBJECT).read_bytes()
    tags = np.flatnonzero(np.frombuffer(content, np.uint8)[: len(content) // 8 * 8].reshape(-1, 8).any(1))[:60]
    for place in (8 * tags[:, None] + np.arange(8)).ravel():
        for byte in (0x00, 0x7F, 0xFF, content[place] ^ 1):
            damaged = content[:place] + bytes([byte]) + content[place + 1 :]
            try:
                matlab_arrays(damaged, ["shapeMU", "shapePC", "shapeEV", "tl"])
            except (ValueError, zlib.error):
                continue


@pytest.mark.parametrize(
    ("variables", "message"),
    [
        ({"tl": "text"}, "tl is not an array of real numbers"),
        ({"tl": np.array([["a", 1]], object)}, "tl is not an array of real numbers"),
        ({"tl": np.ones((4, 3)) * 1j}, "tl is not an array of real numbers"),
        ({"tl": np.full((4, 3), 1.5)}, "not whole"),
        ({"tl": np.zeros((4, 3))}, "names vertex"),
        ({"shapeMU": np.full((216, 1), np.nan)}, "not finite"),
        ({"texMU": np.full((216, 1), np.nan)}, "not finite"),
    ],
)
def test_a_basel_model_of_2009_with_other_contents_is_refused(variables, message, tmp_path):
    write_basel_2009(tmp_path / "m.mat", SUBJECT)
    stored = {k: v for k, v in scipy.io.loadmat(tmp_path / "m.mat").items() if not k.startswith("_")}
    scipy.io.savemat(tmp_path / "m.mat", stored | variables)
    refused(lambda path: read_basel_mat(path, None), tmp_path / "m.mat", message)


def test_a_matlab_bomb_is_refused_before_it_unpacks(tmp_path):
    header = b" " * 116 + bytes(8) + struct.pack("<H", 0x0100) + b"IM"
    flags = struct.pack("<IIII", 6, 8, 6, 0) + struct.pack("<IIii", 5, 8, 1 << 15, 1 << 15)
    name = struct.pack("<II", 1, 8) + b"shapePC\0"[:8]
    name = struct.pack("<II", 1, 7) + b"shapePC\0"
    body = flags + name + struct.pack("<II", 9, 1 << 31)
    packed = zlib.compress(struct.pack("<II", 14, (1 << 32) - 8) + body + bytes(1 << 20))
    (tmp_path / "bomb.mat").write_bytes(header + struct.pack("<II", 15, len(packed)) + packed)
    refused(lambda path: read_basel_mat(path, None), tmp_path / "bomb.mat", "unpack to more than")


# --- HDF5 -------------------------------------------------------------------------------------------------------------


def with_entry(change):
    def damage(folder):
        path = write_basel_2019(folder / "m.h5", SUBJECT, {"center.nose.tip": 30})
        with h5py.File(path, "a") as stored:
            change(stored)
        return path

    return damage


def replaced(key, **options):
    def change(stored):
        del stored[key]
        stored.create_dataset(key, **options)

    return with_entry(change)


def a_group(stored):
    del stored["shape/model/mean"]
    stored.create_group("shape/model/mean")


def a_link_out(stored):
    del stored["shape/model/mean"]
    stored["shape/model/mean"] = h5py.ExternalLink("/etc/passwd", "/x")


def a_link_to_itself(stored):
    del stored["shape/model/mean"]
    stored["shape/model/mean"] = h5py.SoftLink("mean")


def a_way_out(stored):
    stored["out"] = h5py.ExternalLink("/etc/passwd", "/x")
    del stored["shape/model/mean"]
    stored["shape/model/mean"] = h5py.SoftLink("/out/mean")


def moved_behind_a_link(stored):
    stored.move("shape/representer", "common")
    stored["shape/representer"] = h5py.SoftLink("/common")


def numbers_of_another_file(stored):
    del stored["color/model/mean"]
    layout = h5py.VirtualLayout((216,), float)
    layout[:] = h5py.VirtualSource("/etc/passwd", "x", (216,))
    stored.create_virtual_dataset("color/model/mean", layout)


def endless(stored):
    del stored["shape/model/pcaBasis"]
    stored.create_dataset("shape/model/pcaBasis", shape=(2**20, 2**20), dtype="f4")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (with_entry(a_group), "not a data set"),
        (with_entry(a_link_out), "is a link"),
        (with_entry(a_link_to_itself), "is a link"),
        (with_entry(a_way_out), "is a link"),
        (with_entry(numbers_of_another_file), "another file"),
        (with_entry(endless), "declares 4398046511104 bytes"),
        (replaced("shape/model/mean", data="text"), "holds|expected"),
        (replaced("shape/model/mean", data=np.float64(3.0)), "three per vertex"),
        (replaced("shape/model/mean", data=np.zeros(3, [("a", "f8")])), "expected numbers"),
        (replaced("shape/model/mean", shape=(3,), dtype=h5py.vlen_dtype(float)), "expected numbers"),
        (replaced("shape/representer/cells", data=np.float64(1.0)), "no triangle mesh"),
        (replaced("metadata/landmarks/json", data="[" * 5000), "list of points"),
        (replaced("metadata/landmarks/json", data=json.dumps([{"id": 1}])), "list of points"),
        (replaced("metadata/landmarks/json", data=np.zeros(3)), "cannot be read|list of points"),
    ],
)
def test_entries_of_another_kind_are_refused(damage, message, tmp_path):
    refused(lambda path: read_basel_h5(path, None, None), damage(tmp_path), message)


def test_links_within_the_file_are_followed(tmp_path):
    linked = read_basel_h5(with_entry(moved_behind_a_link)(tmp_path), None, None)
    np.testing.assert_array_equal(linked.triangles, SUBJECT.triangles)
    assert list(linked.landmarks) == [30]


def test_a_crash_of_the_hdf5_library_is_a_sentence(tmp_path, monkeypatch):
    path = write_basel_2019(tmp_path / "m.h5", SUBJECT, {})
    crashing = tmp_path / "program.py"
    crashing.write_text("import os\nos.abort()\n")
    monkeypatch.setattr("workbench.face.formats.hdf5_process.__file__", str(crashing))
    refused(lambda path: read_basel_h5(path, None, None), path, "crashed on it or did not finish")


def test_a_read_that_never_ends_is_ended(tmp_path, monkeypatch):
    path = write_basel_2019(tmp_path / "m.h5", SUBJECT, {})
    monkeypatch.setattr("workbench.face.formats.hdf5.LEAST_S", 1e-6)
    refused(lambda path: read_basel_h5(path, None, None), path, "crashed on it or did not finish")


# --- .npz -------------------------------------------------------------------------------------------------------------


def as_flame(folder, **changes):
    arrays = flame_arrays(SUBJECT)
    arrays["J_regressor"] = arrays["J_regressor"].toarray()
    np.savez(folder / "flame.npz", **(arrays | changes))
    return folder / "flame.npz"


def as_gnm(folder, **changes):
    path = write_gnm(folder / "gnm.npz", SUBJECT, SUBJECT.expressions, [f"e{k}" for k in range(10)])
    with np.load(path) as stored:
        np.savez(path, **(dict(stored) | changes))
    return path


@pytest.mark.parametrize(
    ("write", "changes", "message"),
    [
        (as_flame, {"v_template": np.float64(1.0)}, "no triangle mesh"),
        (as_flame, {"f": np.float64(1.0)}, "no triangle mesh"),
        (as_flame, {"f": np.full((4, 3), 0.5)}, "not whole"),
        (as_flame, {"f": np.full((4, 3), 2**40)}, "beyond"),
        (as_flame, {"J_regressor": np.full((5, 72), np.nan)}, "J_regressor holds numbers that are not finite"),
        (as_flame, {"weights": np.full((72, 5), np.inf)}, "weights holds numbers that are not finite"),
        (as_flame, {"shapedirs": np.full((72, 3, 20), 1e300)}, "not finite or beyond"),
        (as_gnm, {"template_vertex_positions": np.float64(1.0)}, "no triangle mesh"),
        (as_gnm, {"expression_names": np.array("one")}, "needs 10 names"),
        (as_gnm, {"template_joint_positions": np.full((3, 3), np.nan)}, "not finite"),
        (as_gnm, {"template_joint_positions": np.float64(1.0)}, "template_joint_positions"),
        (as_gnm, {"joint_identity_basis": np.full((10, 3, 3), np.nan)}, "not finite"),
        (as_gnm, {"mirror_indices": np.full(72, -1)}, "names number -1"),
        (as_gnm, {"mirror_indices": np.linspace(0.0, 71.0, 72)}, "mirror_indices holds float64"),
    ],
)
def test_arrays_that_are_no_parts_of_a_face_are_refused(write, changes, message, tmp_path):
    refused(load_face_model, write(tmp_path, **changes), message)


def test_an_npz_bomb_is_refused_before_it_unpacks(tmp_path):
    path = as_flame(tmp_path)
    content = bytearray(path.read_bytes())
    # The directory at the end of the archive declares what each member unpacks to.
    struct.pack_into("<I", content, content.rindex(b"PK\x01\x02") + 24, 3_200_000_000)
    path.write_bytes(content)
    refused(load_face_model, path, "unpack to 3.2 GB")


OWN = dict(np.load(sample("head")))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"neutral": None}, "has no neutral"),
        ({"neutral": np.float64(1.0)}, "cannot be read"),
        ({"neutral": np.full_like(OWN["neutral"], np.nan)}, "neutral holds numbers that are not finite"),
        ({"mirror": OWN["mirror"].astype(int) - 1}, "mirror names number -1"),
        ({"uv": OWN["uv"][:5]}, "triangles_uv names number"),
        ({"colors": OWN["colors"].astype(float)}, "expected uint8"),
        ({"landmark_barycentric": 2.0 * OWN["landmark_barycentric"]}, "sum to 1"),
        ({"contour_yaw_deg": OWN["contour_yaw_deg"][::-1]}, "do not ascend"),
        ({"expression_names": OWN["expression_names"][:1]}, "one name each"),
        ({"jaw_unit": np.array([26.5, 8.0])}, r"jaw_unit has shape \(2,\)"),
        ({"jaw_unit": np.array([26.5, 0.0, 8.0])}, "an angle and two lengths above 0"),
        ({"joint_names": np.arange(len(OWN["joint_names"]))}, "expected names"),
    ],
)
def test_damage_of_the_workbenchs_own_head_is_told(changes, message, tmp_path):
    np.savez(tmp_path / "head.npz", **{k: v for k, v in (OWN | changes).items() if v is not None})
    refused(load_default_head, tmp_path / "head.npz", message)


def test_a_head_that_was_baked_anew_is_read_anew(tmp_path):
    for shift in (0.0, 1.0):
        np.savez(tmp_path / "head.npz", **(OWN | {"neutral": OWN["neutral"] + shift}))
        np.testing.assert_allclose(load_default_head(tmp_path / "head.npz").neutral, OWN["neutral"] + shift)


def test_a_cut_head_is_told(tmp_path):
    content = sample("head").read_bytes()
    middle = len(content) // 2
    (tmp_path / "cut.npz").write_bytes(content[:middle])
    (tmp_path / "flipped.npz").write_bytes(content[:middle] + bytes([content[middle] ^ 0xFF]) + content[middle + 1 :])
    for name in ("cut.npz", "flipped.npz"):
        refused(load_default_head, tmp_path / name, "cannot be read as a baked head")
        refused(load_face_model, tmp_path / name, "cannot be read as")


# --- glTF -------------------------------------------------------------------------------------------------------------


def glb(change):
    def damage(folder):
        path = write_glb(folder / "face.glb", SUBJECT, {}, sparse="browInnerUp")
        content = path.read_bytes()
        size = struct.unpack_from("<I", content, 12)[0]
        document = json.loads(content[20 : 20 + size])
        change(document)
        text = json.dumps(document).encode()
        chunks = struct.pack("<I4s", len(text), b"JSON") + text + content[20 + size :]
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path

    return damage


def entry(*place, value):
    def change(document):
        for step in place[:-1]:
            document = document[step]
        document[place[-1]] = value

    return glb(change)


def target_of_another_length(document):
    target = document["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]
    document["accessors"][target]["count"] = 71


def sparse_beyond(document):
    sparse = next(accessor for accessor in document["accessors"] if accessor.get("sparse"))
    sparse["count"] = 10


def the_same_target_for_ever(document):
    primitive = document["meshes"][0]["primitives"][0]
    primitive["targets"] = primitive["targets"][:1] * 200_000


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (entry("accessors", 0, value={"componentType": 5126, "count": 2 * 10**8, "type": "VEC3"}), "no buffer|2 GB"),
        (entry("accessors", 0, value={"componentType": 5126, "count": 10**7, "type": "VEC3"}), "no buffer holds"),
        (entry("accessors", 0, "count", value=-1), "whole number from 0"),
        (entry("accessors", 0, "count", value=1.5), "whole number from 0"),
        (entry("bufferViews", 0, "byteStride", value=0), "0 bytes apart"),
        (entry("bufferViews", 0, "byteOffset", value=-8), "whole number from 0"),
        (glb(target_of_another_length), "expected"),
        (glb(sparse_beyond), "does not have|expected"),
        (glb(the_same_target_for_ever), "accessors ask for more"),
        (entry("nodes", 1, "name", value=["leftEye"]), "name that is not text"),
        (entry("nodes", 1, "mesh", value=-1), "meshes has no entry -1"),
        (entry("nodes", 0, "translation", value=[1, 2]), "expected 3 numbers"),
        (entry("nodes", 0, "translation", value=[float("nan"), 0, 0]), "expected 3 numbers"),
        (entry("nodes", 0, "rotation", value="none"), "cannot be read as glTF"),
        (entry("scenes", 0, "nodes", value={"a": 1}), "nodes has no entry"),
        (entry("materials", value=[{"pbrMetallicRoughness": {"baseColorFactor": [1]}}]), None),
        (lambda folder: nested(folder), "nested"),
    ],
)
def test_gltf_that_declares_what_it_does_not_hold_is_refused(damage, message, tmp_path):
    if message is None:  # a material that nothing uses does not matter
        read_gltf(damage(tmp_path))
        return
    refused(read_gltf, damage(tmp_path), message)


def nested(folder):
    (folder / "face.gltf").write_text('{"a":' * 100_000)
    return folder / "face.gltf"


# --- OBJ, ICT-FaceKit, landmarks.toml ---------------------------------------------------------------------------------


@pytest.fixture
def objs(tmp_path):
    return write_obj_folder(tmp_path / "objs", SUBJECT, lambda points: y_up(points))


def test_a_pipe_among_targets_is_refused_without_waiting(objs):
    os.mkfifo(objs / "pipe.obj")
    refused(read_obj_targets, objs, r"pipe\.obj is a pipe")


@pytest.mark.parametrize(
    ("name", "line", "message"),
    [
        ("neutral.obj", "f 1 2 1180591620717411303424", "names number 1180591620717411303424 of 72"),
        ("neutral.obj", "f 1 2 0", None),
        ("neutral.obj", "f 1 2 -99", "names number -99"),
        ("neutral.obj", "v nan 0 0", "not finite"),
        ("jawOpen.obj", "v nan 0 0", "not finite"),
        ("jawOpen.obj", "v 1 2", "cannot be read as OBJ"),
    ],
)
def test_obj_lines_that_mean_nothing_are_refused(name, line, message, objs):
    with (objs / name).open("a") as stream:
        stream.write(line + "\n")
    refused(read_obj_targets, objs, message or "names number 0")


@pytest.mark.parametrize(("line", "message"), [("vt nan 0", "vt holds"), ("vt 0", "cannot be read")])
def test_texture_coordinates_are_checked(line, message, tmp_path):
    ict = write_ict(tmp_path / "ict", SUBJECT)
    path = ict / "generic_neutral_mesh.obj"
    path.write_text(line + "\n" + path.read_text())
    refused(read_obj, path, message)


def test_a_texture_index_beyond_the_list_is_refused(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/2\n")
    refused(read_obj, tmp_path / "a.obj", "names number 2 of 1")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: '{"a":' * 100_000, "nested"),
        (lambda text: text.replace('"jawOpen"', '"../jawOpen"'), "not the name of an expression"),
        (lambda text: text.replace('"jawOpen"', '"mouthSmile_L"'), "twice"),
        (lambda text: text.replace('"idx_to_landmark_verts": [0', '"idx_to_landmark_verts": [0.5'), "cannot be read"),
        (lambda text: text.replace('"idx_to_landmark_verts": [0', '"idx_to_landmark_verts": [-1'), "needs 68"),
        (lambda text: "[]", "cannot be read"),
    ],
)
def test_the_list_of_ict_facekit_is_checked(change, message, tmp_path):
    folder = write_ict(tmp_path / "ict", SUBJECT)
    path = folder / "vertex_indices.json"
    path.write_text(change(path.read_text()))
    refused(lambda folder: read_ict_facekit(folder, None), folder, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("vertices = " + "[" * 5000, "nested"),
        ("vertices = [" + "1.5, " * 68 + "]", "whole numbers"),
        ("vertices = [" + "99999, " * 68 + "]", "names vertex 99999"),
        ("vertices = [-1, " + "0, " * 67 + "]", "names vertex -1, the mesh has 72"),
        ("vertices = [" + "[0, 1, 2], " * 68 + "]\nbarycentric = [" + "[nan, 0, 0], " * 68 + "]", "not finite"),
        ("vertices = [" + "[0, 1, 2], " * 68 + "]\nbarycentric = [" + "[1, 1, 1], " * 68 + "]", "sum to 1"),
        ("vertices = [" + "[0, 1, 2], " * 68 + "]\nbarycentric = [" + "[9, -8, 0], " * 68 + "]", "sum to 1"),
        ("vertices = [[1], 2]", "68 vertex numbers"),
        ("vertices = \xff", "not valid TOML"),
    ],
)
def test_landmarks_toml_is_checked(text, message, tmp_path):
    (tmp_path / "landmarks.toml").write_bytes(text.encode("latin-1"))
    refused(lambda path: read_landmarks_toml(path, 72), tmp_path / "landmarks.toml", message)


def test_a_folder_of_objs_in_the_head_frame_is_checked_as_well(objs):
    assert len(read_obj_folder(objs).expression_names) == 7
    (objs / "landmarks.toml").write_text("vertices = [" + "[0, 1, 2], " * 68 + "]\nbarycentric = [[nan, 0, 0]]")
    refused(read_obj_folder, objs, "68 triples")


# --- names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["n" * 5000, "a\0b", "/dev/zero"])
def test_impossible_names_and_devices_are_no_models(name):
    refused(load_face_model, name, "no face model|pipe or device")
