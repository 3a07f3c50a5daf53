"""Landmarks of OpenFace, 300-W, face-alignment, MediaPipe and dlib are read as these programs write them."""

import json
from codecs import BOM_UTF8
from pathlib import Path

import cv2
import numpy as np
import pytest

import workbench
from tests.landmark_layouts import (
    REAL_MESH,
    dlib_box,
    dlib_xml,
    ibug_pts,
    mediapipe_csv,
    mesh_of,
    named_points,
    openface_csv,
    openface_picture_csv,
)
from workbench.config import preset
from workbench.errors import InputError
from workbench.landmarks.files import LandmarkRecord, read_landmark_file, states_size
from workbench.landmarks.formats.mediapipe import VERTICES
from workbench.landmarks.observations import Landmarks2D
from workbench.landmarks.scheme import MIRROR, outer_eye_distance
from workbench.pipeline import open_source
from workbench.samples import sample

SIZE = (640, 360)
SMALL, LARGE = (np.random.default_rng(7).uniform(0, span, (68, 2)).round(3) for span in (80, 300))
"""Two faces, the second the larger one, in pixels."""


def read(path: Path, content: str | bytes, size: tuple[int, int] | None = SIZE) -> list[LandmarkRecord]:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return list(read_landmark_file(path, size))


def found(record: LandmarkRecord) -> Landmarks2D:
    assert record.landmarks is not None
    return record.landmarks


def at(record: LandmarkRecord, face: np.ndarray) -> None:
    """The record has this face, to a thousandth of a pixel."""
    np.testing.assert_allclose(found(record).points, face, atol=1e-3)


def numpy_bytes(folder: Path, array: object, allow_pickle: bool = False) -> bytes:
    np.save(folder / "array.npy", array, allow_pickle=allow_pickle)
    return (folder / "array.npy").read_bytes()


# --- OpenFace ---


def test_openface_counts_frames_from_one_and_gives_each_face_one_confidence(tmp_path):
    rows = [
        ("1, 0, 0.000, 0.98, 1", SMALL),
        ("2, 0, 0.033, 0.03, 0", np.zeros((68, 2))),
        ("3, 0, 0.067, 0.88, 1", LARGE),
    ]
    first, lost, last = read(tmp_path / "clip.csv", openface_csv(rows))
    assert [record.frame for record in (first, lost, last)] == [0, 1, 2]
    at(first, SMALL)
    at(last, LARGE)
    assert lost.landmarks is None
    assert found(first).image_size == lost.image_size == SIZE
    np.testing.assert_array_equal(found(last).confidence, np.full(68, 0.88))


def test_of_several_faces_in_openfaces_table_the_largest_is_taken_and_frames_without_a_row_have_none(tmp_path):
    rows = [("1, 0, 0, 0.7, 1", LARGE), ("1, 1, 0, 0.98, 1", SMALL), ("4, 1, 0.1, 0.98, 1", SMALL)]
    records = read(tmp_path / "clip.csv", openface_csv(rows))
    assert [record.landmarks is None for record in records] == [False, True, True, False]
    at(records[0], LARGE)
    at(records[3], SMALL)


def test_openfaces_table_of_a_picture_has_a_row_for_each_face(tmp_path):
    (record,) = read(tmp_path / "photo.csv", openface_picture_csv([(0.9, SMALL), (0.8, LARGE)]))
    at(record, LARGE)
    assert found(record).confidence[0] == 0.8


# --- 300-W ---


def test_a_published_annotation_counts_pixels_from_one(tmp_path):
    (record,) = read(tmp_path / "face.pts", ibug_pts(LARGE))
    at(record, LARGE)
    assert found(record).image_size == SIZE


def test_a_folder_of_annotations_is_a_clip_in_the_order_of_its_names(tmp_path):
    folder = tmp_path / "annot"
    folder.mkdir()
    for name, face in {"frame10.pts": LARGE, "frame2.PTS": SMALL, "frame11.pts": SMALL}.items():
        (folder / name).write_text(ibug_pts(face))
    for name in ("frame2.jpg", ".frame3.pts", "notes.txt"):
        (folder / name).write_text("no annotation")
    first, second, third = read_landmark_file(folder, SIZE)
    assert [(record.frame, record.name) for record in (first, second, third)] == [
        (0, "frame2"),
        (1, "frame10"),
        (2, "frame11"),
    ]
    at(first, SMALL)
    at(second, LARGE)
    assert found(third).image_size == third.image_size == SIZE
    assert not states_size(folder)


def test_what_is_wrong_in_a_folder_of_annotations_is_named_with_its_file(tmp_path):
    with pytest.raises(InputError, match=r"is a folder without \.pts files: name a landmark file"):
        read_landmark_file(tmp_path, SIZE)
    (tmp_path / "1.pts").write_text(ibug_pts(LARGE))
    (tmp_path / "2.pts").write_text(ibug_pts(LARGE)[:-1].replace("}", ""))
    with pytest.raises(InputError, match="does not say how large its pictures are"):
        read_landmark_file(tmp_path)
    records = read_landmark_file(tmp_path, SIZE)
    assert next(records).frame == 0
    with pytest.raises(InputError, match=r"2\.pts, line 72: the closing brace is missing"):
        next(records)


def test_photos_and_the_folder_of_their_annotations_are_tracked_together(tmp_path):
    for name, face in {"b.pts": LARGE, "a.pts": SMALL}.items():
        (tmp_path / name).write_text(ibug_pts(face))
        cv2.imwrite(str(tmp_path / f"{name[0]}.png"), np.zeros((360, 640, 3), np.uint8))
    source = open_source([tmp_path], preset("face-it"), tmp_path)
    seen = [observation.landmarks for observation in source.observations(0, {}, stills=True)]
    np.testing.assert_allclose([landmarks.points for landmarks in seen], [SMALL, LARGE], atol=1e-3)
    assert (source.count, source.image_size) == (2, SIZE)


@pytest.mark.parametrize("layout", ["a folder of .pts", "imglab's, in another order"])
def test_photos_take_the_annotations_that_name_them(layout, tmp_path):
    """Else, where one is missing, all photos behind it would have those of another."""
    photos, given = tmp_path / "photos", tmp_path / "annotations"
    for folder in (photos, given):
        folder.mkdir()
    for name in "abc":
        cv2.imwrite(str(photos / f"{name}.png"), np.zeros((360, 640, 3), np.uint8))
    if layout == "a folder of .pts":
        for name, face in {"a": SMALL, "c": LARGE, "d": SMALL}.items():
            (given / f"{name}.pts").write_text(ibug_pts(face))
    else:
        given = tmp_path / "faces.xml"
        named = [(f"file='shoot/{name}.png'", [dlib_box(face)]) for name, face in (("c", LARGE), ("a", SMALL))]
        given.write_text(dlib_xml(named))
    source = open_source([photos], preset("face-it"), given)
    first, second, third = source.observations(0, {}, stills=True)
    np.testing.assert_allclose([first.landmarks.points, third.landmarks.points], [SMALL, LARGE], atol=1e-3)
    assert second.landmarks is None
    (alone,) = open_source([photos / "c.png"], preset("face-it"), given).observations(0, {}, stills=True)
    np.testing.assert_allclose(alone.landmarks.points, LARGE, atol=1e-3)
    (part,) = open_source([photos], preset("face-it"), given, frames=(2, 2)).observations(0, {}, stills=True)
    np.testing.assert_allclose(part.landmarks.points, LARGE, atol=1e-3)


def test_photos_that_no_annotation_names_take_them_in_their_order(tmp_path):
    photos, given = tmp_path / "photos", tmp_path / "annotations"
    for folder in (photos, given):
        folder.mkdir()
    for index, face in enumerate((SMALL, LARGE)):
        cv2.imwrite(str(photos / f"IMG_{index}.png"), np.zeros((360, 640, 3), np.uint8))
        (given / f"{index}.pts").write_text(ibug_pts(face))
    seen = open_source([photos], preset("face-it"), given).observations(0, {}, stills=True)
    np.testing.assert_allclose([each.landmarks.points for each in seen], [SMALL, LARGE], atol=1e-3)


# --- face-alignment ---


@pytest.mark.parametrize("count", [2, 3], ids=["x y", "x y z"])
def test_an_array_is_one_face_or_one_face_a_frame(tmp_path, count):
    faces = np.concatenate([[SMALL, LARGE], np.ones((2, 68, 1))], axis=2)[..., :count].astype(np.float32)
    (alone,) = read(tmp_path / "photo.npy", numpy_bytes(tmp_path, faces[1]))
    at(alone, LARGE)
    first, second = read(tmp_path / "clip.npy", numpy_bytes(tmp_path, faces))
    at(first, SMALL)
    at(second, LARGE)
    assert (second.frame, second.name) == (1, "clip#1")
    np.testing.assert_array_equal(found(second).confidence, np.ones(68))


def test_a_face_of_nan_is_none_and_of_several_in_a_frame_the_largest_is_taken(tmp_path):
    nothing = np.full((68, 2), np.nan)
    frames = np.array([[SMALL, LARGE], [nothing, SMALL], [nothing, nothing]])
    first, second, third = read(tmp_path / "clip.npy", numpy_bytes(tmp_path, frames))
    at(first, LARGE)
    at(second, SMALL)
    assert third.landmarks is None


def test_lists_of_points_in_json_are_faces_of_frames(tmp_path):
    content = json.dumps([LARGE.tolist(), [], [SMALL.tolist(), LARGE.tolist()], None])
    first, second, third, fourth = read(tmp_path / "clip.json", content)
    at(first, LARGE)
    at(third, LARGE)
    assert second.landmarks is fourth.landmarks is None


# --- MediaPipe ---


def test_the_68_points_are_named_for_both_sides_alike():
    mesh = json.loads(REAL_MESH.read_text())["faceLandmarks"][0]
    assert len(VERTICES) == 68
    assert max(max(vertices) for vertices in VERTICES) < 468
    right = [mean(mesh, vertices) for vertices in VERTICES]
    left = [mean(mesh, VERTICES[mirrored]) for mirrored in MIRROR]
    level = [abs(a[1] - b[1]) for a, b in zip(right, left, strict=True)]
    assert max(level) < 0.03  # the head in the portrait is tilted by a few degrees
    assert all(right[point][0] < left[point][0] for point in (*range(8), *range(17, 22), *range(36, 42)))


def mean(mesh: list[dict[str, float]], vertices: tuple[int, ...]) -> np.ndarray:
    return np.mean([(mesh[vertex]["x"], mesh[vertex]["y"]) for vertex in vertices], axis=0)


def test_what_mediapipe_found_in_the_portrait_lies_on_its_stored_landmarks():
    (record,) = read_landmark_file(REAL_MESH, (512, 512))
    (stored,) = read_landmark_file(sample("astronaut-landmarks"))
    stored = found(stored).points
    distance = np.linalg.norm(found(record).points - stored, axis=1) / outer_eye_distance(stored)
    assert distance[17:].mean() < 0.04
    assert distance[36:48].mean() < 0.02
    assert distance.max() < 0.12


@pytest.mark.parametrize("count", [468, 478])
def test_a_mesh_becomes_pixels_by_the_size_of_its_picture(tmp_path, count):
    mesh = mesh_of(LARGE, SIZE, count)
    (array,) = read(tmp_path / "a.npy", numpy_bytes(tmp_path, mesh))
    at(array, LARGE)
    (face,) = read(tmp_path / "b.json", json.dumps(mesh.tolist()))
    at(face, LARGE)
    first, second = read(tmp_path / "c.csv", mediapipe_csv([None, mesh]))
    assert first.landmarks is None
    at(second, LARGE)


def test_half_a_pixel_lies_between_the_edge_of_a_picture_and_its_first_centre(tmp_path):
    corner = np.zeros((478, 3))
    corner[VERTICES[8][0], :2] = 1.0
    (record,) = read(tmp_path / "corner.npy", numpy_bytes(tmp_path, corner))
    np.testing.assert_allclose(found(record).points[30], (-0.5, -0.5))
    np.testing.assert_allclose(found(record).points[8], (639.5, 359.5))


RESULTS = {
    "web": lambda *meshes: {"faceLandmarks": [named_points(mesh) for mesh in meshes], "faceBlendshapes": []},
    "Python": lambda *meshes: {"face_landmarks": [named_points(mesh) for mesh in meshes]},
    "web before 2023": lambda *meshes: {"multiFaceLandmarks": [named_points(mesh) for mesh in meshes]},
    "Python before 2023": lambda *meshes: {"multi_face_landmarks": [{"landmark": named_points(m)} for m in meshes]},
}


@pytest.mark.parametrize("result", RESULTS.values(), ids=RESULTS)
def test_mediapipes_results_hold_faces_of_a_frame(tmp_path, result):
    small, large = (mesh_of(face, SIZE) for face in (SMALL, LARGE))
    (alone,) = read(tmp_path / "photo.json", json.dumps(result(small, large)))
    at(alone, LARGE)
    first, second, third = read(tmp_path / "clip.json", json.dumps([result(small), result(), result(small, large)]))
    at(first, SMALL)
    assert second.landmarks is None
    at(third, LARGE)


def test_a_mesh_table_needs_no_frame_column_and_any_order_will_do(tmp_path):
    lines = mediapipe_csv([mesh_of(LARGE, SIZE), mesh_of(SMALL, SIZE)]).splitlines()
    turned = [",".join(reversed(line.split(",")[1:])) for line in lines]
    first, second = read(tmp_path / "clip.csv", "\n".join(turned))
    at(first, LARGE)
    at(second, SMALL)


# --- dlib ---


def test_pictures_of_imglab_are_frames_with_their_largest_face(tmp_path):
    sized = "file='b.jpg' width='900' height='800'"
    pictures = [
        ("file='a.jpg'", [dlib_box(SMALL), dlib_box(LARGE)]),
        (sized, [dlib_box(SMALL), dlib_box(LARGE, " ignore='1'")]),
        ("file='c.jpg'", ["<box top='1' left='1' width='9' height='9'/>"]),
    ]
    first, second, third = read(tmp_path / "faces.xml", dlib_xml(pictures))
    at(first, LARGE)
    at(second, SMALL)
    assert (first.name, second.name) == ("a.jpg", "b.jpg")
    assert (first.image_size, second.image_size) == (SIZE, (900, 800))
    assert third.landmarks is None


def test_imglab_may_order_parts_otherwise(tmp_path):
    box = dlib_box(LARGE).splitlines()
    (record,) = read(
        tmp_path / "faces.xml", dlib_xml([("file='a.jpg'", ["\n".join([box[0], *box[-2:0:-1], box[-1]])])])
    )
    at(record, LARGE)


# --- All of them ---


LAYOUTS = {
    "openface.csv": lambda face, size, folder: openface_csv([("1, 0, 0.000, 1.00, 1", face)]),
    "picture.csv": lambda face, size, folder: openface_picture_csv([(1.0, face)]),
    "ibug.pts": lambda face, size, folder: ibug_pts(face),
    "alignment.npy": lambda face, size, folder: numpy_bytes(folder, face[None]),
    "mesh.npy": lambda face, size, folder: numpy_bytes(folder, mesh_of(face, size)),
    "mesh.json": lambda face, size, folder: json.dumps(RESULTS["web"](mesh_of(face, size))),
    "mesh.csv": lambda face, size, folder: mediapipe_csv([mesh_of(face, size)]),
    "imglab.xml": lambda face, size, folder: dlib_xml([("file='astronaut.png'", [dlib_box(face)])]),
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_the_portrait_is_fitted_alike_through_every_layout(name, tmp_path):
    (stored,) = read_landmark_file(sample("astronaut-landmarks"))
    landmarks = found(stored)
    content = LAYOUTS[name](landmarks.points, landmarks.image_size, tmp_path)
    (tmp_path / name).write_bytes(content.encode() if isinstance(content, str) else content)
    fit = workbench.fit(sample("astronaut"), landmarks=tmp_path / name)
    again = workbench.fit(sample("astronaut"), landmarks=landmarks.points)
    np.testing.assert_allclose(fit.landmarks.points, landmarks.points, atol=1e-4)
    np.testing.assert_allclose(fit.yaw_pitch_roll, again.yaw_pitch_roll, atol=0.01)
    np.testing.assert_allclose(list(fit.weights.values()), list(again.weights.values()), atol=0.002)


@pytest.mark.parametrize("name", [name for name in LAYOUTS if not name.endswith(".npy")])
def test_every_layout_of_text_may_begin_with_a_byte_order_mark(name, tmp_path):
    (record,) = read(tmp_path / name, BOM_UTF8 + LAYOUTS[name](LARGE, SIZE, tmp_path).encode())
    at(record, LARGE)


@pytest.mark.parametrize("name", [name for name in LAYOUTS if not name.endswith(".pts")])
def test_a_layout_without_the_pictures_size_asks_for_the_pictures(name, tmp_path):
    content = LAYOUTS[name](LARGE, SIZE, tmp_path)
    with pytest.raises(InputError, match=f"does not say how large its pictures are: .*--landmarks .*{name}"):
        read(tmp_path / name, content, None)
    assert not states_size(tmp_path / name)


def test_layouts_with_the_pictures_size_say_so(tmp_path):
    assert states_size(sample("astronaut-landmarks"))
    (tmp_path / "faces.xml").write_text(dlib_xml([("file='a' width='9' height='9'", [])]))
    assert states_size(tmp_path / "faces.xml")


OPENFACE = openface_csv([("1, 0, 0.000, 0.98, 1", SMALL)])
MESH = mesh_of(LARGE, SIZE)
IMGLAB = dlib_xml([("file='a.jpg'", [dlib_box(LARGE)])])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", OPENFACE.replace(", y_67", ""), "line 1: expected x and y of 68 points .*missing: y_67"),
        ("a.csv", OPENFACE.replace(", y_67", ", x_68"), "line 1: expected x and y of 68 points .*missing: y_67"),
        ("a.csv", OPENFACE.replace("\n1, 0", "\n0, 0"), "line 2: frame counts from 1, got 0"),
        ("a.csv", OPENFACE.replace("\n1, 0", "\none, 0"), "line 2: frame is 'one', expected a whole number"),
        ("a.csv", OPENFACE.replace("\n1, 0", "\n9000000, 0"), "8999999 frames are missing before frame"),
        ("a.csv", OPENFACE.replace("0.98", "1.98"), "line 2: the confidence of landmark 0 is 1.98"),
        ("a.csv", OPENFACE.replace("0.98", "sure"), "line 2: confidence is ' sure', expected a number"),
        ("a.csv", OPENFACE.replace(", 0.40", ""), "line 2: expected .* cells as in the header, got"),
        (
            "a.csv",
            openface_csv([("2, 0, 0, 0.9, 1", SMALL), ("1, 0, 0, 0.9, 1", SMALL)]),
            "frame numbers must ascend, got 1: sort the rows",
        ),
        ("a.csv", mediapipe_csv([MESH * 500]), "line 2: MediaPipe's points are fractions .*as MediaPipe does"),
        ("a.json", json.dumps([MESH[:100].tolist()]), "entry 0: a face has 68 points, or .* 468 or 478; got 100"),
        ("a.json", json.dumps([MESH.tolist(), 3]), "entry 1: expected a list of faces, got 3"),
        ("a.json", json.dumps([{"hands": []}]), "entry 0: expected one of faceLandmarks, .*, got hands"),
        (
            "a.json",
            json.dumps({"faceLandmarks": ["face"]}),
            "entry 0: expected a face as a list of points, .*got 'face'",
        ),
        (
            "a.json",
            json.dumps({"faceLandmarks": [[{"x": "a", "y": 1}]]}),
            "entry 0: x and y of a point are not numbers",
        ),
        ("a.xml", "<dataset><images/></dataset>", "names no picture: expected imglab's <image>"),
        ("a.xml", IMGLAB.replace('name="67"', 'name="68"'), r"picture 0 \(a.jpg\): .* parts 00 to 67; missing: 67"),
        ("a.xml", dlib_xml([("file='a'", [dlib_box(np.ones((70, 2)))])]), "the parts 00 to 67; it has 70"),
        ("a.xml", IMGLAB.replace("<image ", "<image width='0' height='9' "), "width and height from 1, got 0,0,9"),
        ("a.xml", IMGLAB[:-40], r"a\.xml cannot be read as landmarks \(.*; export them again"),
        ("a.xml", "<!DOCTYPE a>" + IMGLAB, "defines entities"),
        ("a.xml", "<a>" * 50, "nested more than 16 deep"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, name, content, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path / name, content)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((67, 2)), "entry 0: a face has 68 points, or .*got 67"),
        (np.zeros((2, 68, 4)), r"expected numbers of shape \(68, 2\).*got \(2, 68, 4\) of float64"),
        (np.full((68, 2), "x"), r"expected numbers .* got \(68, 2\) of str"),
        (np.array([[SMALL], []], dtype=object), "holds Python objects, which are not read: save frames"),
    ],
)
def test_an_array_of_something_else_is_refused(tmp_path, array, message):
    with pytest.raises(InputError, match=message):
        read(tmp_path / "a.npy", numpy_bytes(tmp_path, array, allow_pickle=True))
