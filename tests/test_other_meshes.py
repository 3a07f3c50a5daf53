"""Meshes of 3DDFA, PRNet and VRN: read, placed over the picture, measured and drawn beside ours."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.io import savemat

from tests import mesh_layouts
from workbench import reproduction
from workbench.errors import InputError, WorkbenchError
from workbench.pictures.mesh import to_camera
from workbench.reproduction import Study, other_meshes, read_mesh, read_mesh_folder
from workbench.reproduction.mesh_pictures import mesh_panel, photo_panel, square_around
from workbench.reproduction.mesh_placing import distance_px, in_picture, read_over
from workbench.reproduction.other_meshes import FRAMES, true_face
from workbench.reproduction.rendered_clip import OPEN_MOUTH, SIZE, clip_truth

WIDTH, HEIGHT = SIZE
SAME_PIXEL = 1.1
"""Programs count rows from 0 or from 1."""
TETRAHEDRON = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
CORNERS = np.array([[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 9.0]])


@pytest.fixture(scope="module")
def landmarks():
    """The true ones of the frame, pixels."""
    return clip_truth().landmarks[OPEN_MOUTH]


@pytest.fixture(scope="module")
def vertices(head):
    """The rendered head of a frame in its picture: what a perfect program would write."""
    truth = clip_truth()
    person = head.personal(truth.identity)
    pose = truth.rotation[OPEN_MOUTH], truth.translation_mm[OPEN_MOUTH]
    return in_picture(other_meshes._camera(), to_camera(person.vertices(truth.expression[OPEN_MOUTH]), *pose))


@pytest.fixture(scope="module")
def face(head):
    """Points of the rendered face that distances are measured from."""
    return true_face(head, OPEN_MOUTH)


@pytest.fixture
def meshes(tmp_path, head, vertices, landmarks):
    """A folder with a mesh of each program, and a torn one."""
    folder = tmp_path / "meshes"
    for program in ("3DDFA", "PRNet", "VRN"):
        (folder / program).mkdir(parents=True)
    mesh_layouts.write_3ddfa_mat(folder / "3DDFA" / "frame_200_0.mat", vertices, head.triangles, HEIGHT)
    mesh_layouts.write_prnet_obj(folder / "PRNet" / "frame_200.obj", vertices, head.triangles, HEIGHT)
    mesh_layouts.write_vrn_obj(folder / "VRN" / "frame_200.jpg.obj", vertices, head.triangles, landmarks)
    torn = (folder / "3DDFA" / "frame_200_0.mat").read_bytes()[:5000]
    (folder / "3DDFA" / "frame_140_0.mat").write_bytes(torn)
    return folder


@pytest.mark.parametrize("layout", mesh_layouts.WHOLE_PICTURE)
def test_a_mesh_of_the_whole_picture_lies_over_the_face_and_its_axes_are_named(
    layout, head, vertices, face, landmarks, tmp_path
):
    name, write, axes = mesh_layouts.WHOLE_PICTURE[layout]
    write(tmp_path / name, vertices, head.triangles, HEIGHT)
    reading, placed = read_over(read_mesh(tmp_path / name), face, HEIGHT, landmarks)
    assert str(reading) == axes
    assert np.abs(head.landmarks.of(placed)[17:, :2] - landmarks[17:]).max() < SAME_PIXEL
    assert np.abs(placed - vertices).max() < SAME_PIXEL


def test_a_mesh_in_vrns_crop_lies_over_the_face(head, vertices, face, landmarks, tmp_path):
    inside = mesh_layouts.write_vrn_obj(tmp_path / "frame_200.obj", vertices, head.triangles, landmarks)
    reading, placed = read_over(read_mesh(tmp_path / "frame_200.obj"), face, HEIGHT, landmarks)
    assert str(reading) == "z away, in VRN's crop"
    np.testing.assert_allclose(placed[:, :2], vertices[inside, :2], atol=0.02)


def test_triangles_counted_from_1_are_those_counted_from_0(tmp_path):
    for name, first in (("zero", 0), ("one", 1)):
        savemat(tmp_path / f"{name}.mat", {"vertex": CORNERS.T, "tri": (TETRAHEDRON + first).T.astype(float)})
        np.testing.assert_array_equal(read_mesh(tmp_path / f"{name}.mat").triangles, TETRAHEDRON)


def test_the_distance_is_that_of_the_surface_without_what_all_depths_share(head, vertices, face):
    exact = distance_px(face, vertices, head.triangles)
    assert exact < 1e-6
    assert distance_px(face, np.add(vertices, [0.0, 0.0, 300.0]), head.triangles) < 1e-6
    beside = [distance_px(face, np.add(vertices, [shift, 0.0, 0.0]), head.triangles) for shift in (5.0, 10.0, 20.0)]
    assert exact < beside[0] < beside[1] < beside[2] < 20.0


def write_npy(path, array) -> None:
    with path.open("wb") as stream:
        np.save(stream, array)


@pytest.mark.parametrize(
    ("name", "write", "words"),
    [
        ("face.ply", lambda path: path.write_text("ply"), "face.ply is not an OBJ, MAT or NPY file"),
        ("face.obj", lambda path: path.write_text("v 1 2 3\nv 1 2 4\n"), "face.obj holds no mesh"),
        ("face.mat", lambda path: path.write_bytes(b"MATLAB"), "face.mat cannot be read as a mesh"),
        ("face.mat", lambda path: savemat(path, {"depth": CORNERS}), "face.mat has neither vertices nor vertex among"),
        (
            "face.mat",
            lambda path: savemat(path, {"vertices": CORNERS, "triangles": [[0, 1, 7]]}),
            "the array of triangles names number 7 of 4, counted from 0",
        ),
        ("face.npy", lambda path: path.write_bytes(b""), "face.npy is empty (0 bytes), expected a mesh"),
        ("face.npy", lambda path: write_npy(path, np.array([{}] * 4)), "face.npy holds Python objects"),
        (
            "face.npy",
            lambda path: write_npy(path, np.zeros((9, 2))),
            "holds an array of the shape (9, 2), expected vert",
        ),
        ("face.npy", lambda path: write_npy(path, np.full((9, 3), np.nan)), "holds numbers that are not finite"),
        ("face.npy", lambda path: write_npy(path, np.zeros((200, 192, 192), bool)), "holds VRN's volume; make an OBJ"),
        ("face.npy", lambda path: write_npy(path, np.zeros((256, 256, 3), "f2")), "holds PRNet's position map; save"),
    ],
    ids=["kind", "no faces", "torn", "no vertices", "triangles", "empty", "objects", "shape", "nan", "volume", "map"],
)
def test_a_file_without_a_mesh_is_refused_in_one_sentence(name, write, words, tmp_path):
    write(tmp_path / name)
    with pytest.raises(WorkbenchError) as refused:
        read_mesh(tmp_path / name)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_is_no_mesh_is_told_and_the_rest_goes_on(meshes):
    (meshes / "PRNet" / "frame_200_kpt.txt").touch()
    (meshes / "PRNet" / "portrait.obj").touch()
    (meshes / "frame_60.obj").touch()
    found, problems = read_mesh_folder(meshes, FRAMES)
    assert [(one.program, one.frame) for one in found] == [("3DDFA", 200), ("PRNet", 200), ("VRN", 200)]
    torn, named, left_out, loose = problems
    assert "frame_140_0.mat cannot be read as a mesh" in torn
    assert (
        "portrait.obj belongs to no picture here; its name should begin with one of frame_60, frame_140, frame_200"
        in named
    )
    assert "PRNet has files that are not OBJ, MAT or NPY and were left out: frame_200_kpt.txt." in left_out
    assert "frame_60.obj belongs to no program; put it into a folder with the program's name." in loose


def test_of_two_files_of_a_frame_the_one_with_triangles_counts(meshes, head, vertices):
    mesh_layouts.write_3ddfa_obj(meshes / "3DDFA" / "frame_200_0.obj", vertices, head.triangles, HEIGHT)
    found, _ = read_mesh_folder(meshes, FRAMES)
    assert found[0].path.name == "frame_200_0.obj"


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"The folder of meshes .*nowhere does not exist; check the name"):
        read_mesh_folder(tmp_path / "nowhere", FRAMES)
    (tmp_path / "face.obj").write_bytes(b"")
    with pytest.raises(InputError, match=r"face\.obj is not a folder"):
        read_mesh_folder(tmp_path / "face.obj", FRAMES)


@pytest.mark.parametrize("with_triangles", [True, False], ids=["triangles", "points"])
def test_a_mesh_is_drawn_where_the_face_is_and_nowhere_else(with_triangles, head, vertices, landmarks):
    photo = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    square = square_around(landmarks, 1.5, photo)
    surface = vertices if with_triangles else np.concatenate([vertices, vertices[head.triangles].mean(axis=1)])
    panel = mesh_panel(photo, square, 200, surface, head.triangles if with_triangles else None)
    nose, corner = square.inside(landmarks[[30]], 200)[0], (3, 3)
    assert panel[round(nose[1]), round(nose[0])].min() > 100
    assert panel[corner].max() == 0
    assert photo_panel(photo, square, 200).shape == panel.shape


@pytest.fixture
def solved(monkeypatch):
    """The item with the truth in place of a detector and of our solve, which take long."""
    truth = clip_truth()

    def fit(frame):
        parts = {name: getattr(truth, name)[frame] for name in ("rotation", "expression")}
        return SimpleNamespace(
            index=frame, translation=truth.translation_mm[frame], identity=truth.identity, jaw=np.zeros(6), scale=1.0,
            camera=other_meshes._camera(), **parts,
        )  # fmt: skip

    class Solver:
        def solve(self, config, frames, study, label):
            fitter = SimpleNamespace(record=lambda solution: solution)
            return SimpleNamespace(fitter=fitter, solutions={frame: fit(frame) for frame in frames})

    seen = lambda frame: SimpleNamespace(landmarks=SimpleNamespace(points=truth.landmarks[frame]))  # noqa: E731
    monkeypatch.setattr(other_meshes, "clip_solver", Solver)
    monkeypatch.setattr(other_meshes, "observed", seen)


def test_meshes_stand_beside_the_mean_face_and_ours(solved, meshes, tmp_path):
    items = reproduction.choose(["other-meshes"])
    reproduction.run(items, tmp_path / "made", quick=True, meshes=meshes)
    folder = tmp_path / "made" / "other-meshes"
    stored = json.loads((folder / "result.json").read_text())
    distances = {row[0]: float(row[-1]) for row in stored["tables"][0]["rows"]}
    assert list(distances) == ["3DDFA", "PRNet", "VRN", "mean face, PnP", "deep"]
    assert max(distances[name] for name in ("3DDFA", "PRNet", "VRN", "deep")) < 1.5 < distances["mean face, PnP"]
    assert any("frame_140_0.mat cannot be read as a mesh" in note for note in stored["notes"])
    assert {path.name for path in folder.glob("frame_*.png")} == {f"frame_{frame}.png" for frame in FRAMES}


def test_without_meshes_the_item_says_how_they_come_in(solved, tmp_path):
    result = other_meshes.compared(Study(tmp_path, quick=True))
    assert [row[0] for row in result.tables[0].rows] == ["mean face, PnP", "deep"]
    assert any("With --meshes FOLDER" in note for note in result.notes)


def test_the_command_refuses_a_folder_of_meshes_that_is_not_there(run):
    code, _, err = run("reproduce", "other-meshes", "--quick", "--meshes", "nowhere")
    assert code == 2
    assert "nowhere does not exist; check the name and the folder." in err
