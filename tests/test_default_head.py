"""The default head keeps its promises: format, symmetry, a closed mouth, blinks that close, landmarks in place."""

import struct
import tomllib
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[1] / "data_samples" / "head"
ARKIT = [
    "browDownLeft",
    "browDownRight",
    "browInnerUp",
    "browOuterUpLeft",
    "browOuterUpRight",
    "cheekPuff",
    "cheekSquintLeft",
    "cheekSquintRight",
    "eyeBlinkLeft",
    "eyeBlinkRight",
    "eyeLookDownLeft",
    "eyeLookDownRight",
    "eyeLookInLeft",
    "eyeLookInRight",
    "eyeLookOutLeft",
    "eyeLookOutRight",
    "eyeLookUpLeft",
    "eyeLookUpRight",
    "eyeSquintLeft",
    "eyeSquintRight",
    "eyeWideLeft",
    "eyeWideRight",
    "jawForward",
    "jawLeft",
    "jawOpen",
    "jawRight",
    "mouthClose",
    "mouthDimpleLeft",
    "mouthDimpleRight",
    "mouthFrownLeft",
    "mouthFrownRight",
    "mouthFunnel",
    "mouthLeft",
    "mouthLowerDownLeft",
    "mouthLowerDownRight",
    "mouthPressLeft",
    "mouthPressRight",
    "mouthPucker",
    "mouthRight",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthSmileLeft",
    "mouthSmileRight",
    "mouthStretchLeft",
    "mouthStretchRight",
    "mouthUpperUpLeft",
    "mouthUpperUpRight",
    "noseSneerLeft",
    "noseSneerRight",
    "tongueOut",
]
FLIP = np.array([-1, 1, 1])
MIDLINE_LANDMARKS = [8, 27, 28, 29, 30, 33, 51, 57, 62, 66]
LANDMARK_PAIRS = [(0, 16), (7, 9), (17, 26), (21, 22), (31, 35), (36, 45), (39, 42), (37, 44), (41, 46), (40, 47)]
LANDMARK_PAIRS += [(48, 54), (50, 52), (59, 55), (60, 64), (61, 63), (67, 65)]


@pytest.fixture(scope="module")
def head() -> dict[str, np.ndarray]:
    with np.load(FOLDER / "head.npz", allow_pickle=False) as archive:
        return dict(archive)


def shaped(head, identity=None, **expression):
    """Vertices of an identity with some expression weights, mm."""
    vertices = head["neutral"].astype(float)
    if identity is not None:
        vertices = vertices + np.tensordot(identity, head["identity_deltas"] * float(head["identity_step_mm"]), axes=1)
    names = head["expression_names"].tolist()
    for name, weight in expression.items():
        unit = head["expression_deltas"][names.index(name)] * float(head["expression_step_mm"])
        vertices = vertices + weight * unit
    return vertices


def landmarks(head, vertices):
    corners = vertices[head["landmark_vertices"].astype(int)]
    return np.einsum("lk,lkd->ld", head["landmark_barycentric"], corners)


def identities(count, seed=12):
    return np.random.default_rng(seed).normal(size=(count, 50))


def visible_area(head, vertices, names, box, step=0.4):
    """Area (mm2) of the named regions seen from the front inside box = (x0, x1, y0, y1), by a small z-buffer."""
    x0, x1, y0, y1 = box
    triangles = head["triangles"].astype(int)
    middle = vertices[triangles].mean(axis=1)
    near = (middle[:, 0] > x0 - 6) & (middle[:, 0] < x1 + 6) & (middle[:, 1] > y0 - 6) & (middle[:, 1] < y1 + 6)
    triangles = triangles[near & (middle[:, 2] < 25)]
    codes = [head["region_names"].tolist().index(name) for name in names]
    wanted = np.isin(head["regions"][triangles], codes).all(axis=1)
    shape = (int((y1 - y0) / step), int((x1 - x0) / step))
    depth, seen = np.full(shape, np.inf), np.zeros(shape, bool)
    for triangle, is_wanted in zip(triangles, wanted, strict=True):
        points = vertices[triangle]
        low = np.maximum(np.ceil((points[:, :2].min(axis=0) - [x0, y0]) / step).astype(int), 0)
        high = np.floor((points[:, :2].max(axis=0) - [x0, y0]) / step).astype(int)
        high = np.minimum(high, [shape[1] - 1, shape[0] - 1])
        basis = np.vstack([points[:, :2].T, np.ones(3)])
        if (high < low).any() or abs(np.linalg.det(basis)) < 1e-9:
            continue
        columns, rows = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        grid = np.stack([columns.ravel() * step + x0, rows.ravel() * step + y0, np.ones(columns.size)])
        share = np.linalg.solve(basis, grid)
        inside = (share >= -1e-9).all(axis=0)
        row, column, z = rows.ravel()[inside], columns.ravel()[inside], points[:, 2] @ share[:, inside]
        front = z < depth[row, column]
        depth[row[front], column[front]], seen[row[front], column[front]] = z[front], is_wanted
    return seen.sum() * step**2


def teeth_area(head, vertices):
    centre = landmarks(head, vertices)[[48, 54]].mean(axis=0)
    return visible_area(head, vertices, ("teethU", "teethL"), (-32, 32, centre[1] - 14, centre[1] + 14))


def left_eye_area(head, vertices):
    eye = landmarks(head, vertices)[[42, 45]].mean(axis=0)
    box = (eye[0] - 20, eye[0] + 20, eye[1] - 14, eye[1] + 16)
    return visible_area(head, vertices, ("eyeL", "eye_cavity"), box)


def test_arrays_have_the_documented_shapes_and_types(head):
    count, faces = len(head["neutral"]), len(head["triangles"])
    expected = {
        "neutral": ((count, 3), "f4"),
        "triangles": ((faces, 3), "u2"),
        "uv": ((len(head["uv"]), 2), "f4"),
        "triangles_uv": ((faces, 3), "u2"),
        "expression_deltas": ((52, count, 3), "i2"),
        "expression_step_mm": ((), "f4"),
        "identity_deltas": ((50, count, 3), "i2"),
        "identity_step_mm": ((), "f4"),
        "joints": ((5, 3), "f4"),
        "identity_joint_deltas": ((50, 5, 3), "f4"),
        "jaw_weights": ((count,), "f2"),
        "jaw_unit": ((3,), "f4"),
        "regions": ((count,), "u1"),
        "colors": ((count, 3), "u1"),
        "mirror": ((count,), "u2"),
        "landmark_vertices": ((68, 3), "u2"),
        "landmark_barycentric": ((68, 3), "f4"),
        "contour_yaw_deg": ((9,), "f4"),
        "contour_vertices": ((9, 17, 3), "u2"),
        "contour_barycentric": ((9, 17, 3), "f4"),
        "blink_scale_mean": ((2,), "f4"),
        "blink_scale_identity": ((50, 2), "f4"),
    }
    found = {name: (head[name].shape, head[name].dtype.str[1:]) for name in expected}
    assert found == expected
    assert set(head) == set(expected) | {"expression_names", "joint_names", "region_names"}
    assert 4500 < count < 5200


def test_the_files_are_small():
    assert (FOLDER / "head.npz").stat().st_size <= 1_500_000
    assert (FOLDER / "albedo.png").stat().st_size <= 600_000
    assert (FOLDER / "preview.jpg").stat().st_size <= 150_000


def test_the_texture_is_a_square_of_1024(head):
    header = (FOLDER / "albedo.png").read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", header[16:24]) == (1024, 1024)
    assert head["uv"].min() >= 0
    assert head["uv"].max() <= 1


def test_no_texture_triangle_is_folded_over(head):
    corners = head["uv"].astype(float)[head["triangles_uv"].astype(int)]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    on_face = (head["uv"][head["triangles_uv"].astype(int), 1] > 0.3).all(axis=1)
    assert min((area[on_face] > 0).mean(), (area != 0).mean()) > 0.995


def test_every_index_is_in_range_and_every_value_finite(head):
    count = len(head["neutral"])
    for name in ("triangles", "mirror", "landmark_vertices", "contour_vertices"):
        assert head[name].max() < count
    assert head["triangles_uv"].max() < len(head["uv"])
    assert head["regions"].max() < len(head["region_names"])
    assert all(np.isfinite(array).all() for array in head.values() if array.dtype.kind == "f")
    assert len(np.unique(head["triangles"])) == count


def test_expressions_are_the_52_of_arkit(head):
    assert head["expression_names"].tolist() == ARKIT
    assert head["expression_deltas"].any(axis=(1, 2)).all()


def test_sizes_are_those_of_a_human_head_in_millimetres(head):
    width, height, depth = np.ptp(head["neutral"], axis=0)
    assert 150 < width < 220
    assert 230 < height < 330
    assert 180 < depth < 270
    names = head["joint_names"].tolist()
    left, right = (head["joints"][names.index(name)] for name in ("leftEye", "rightEye"))
    np.testing.assert_allclose(left - right, [63, 0, 0], atol=1e-3)
    np.testing.assert_allclose(left + right, 0, atol=1e-3)


def test_the_frame_is_image_right_down_away(head):
    eye, nose, chin = (landmarks(head, shaped(head))[i] for i in (45, 30, 8))
    assert eye[0] > 20
    assert chin[1] > nose[1] > 20
    assert nose[2] < -30


def test_triangles_face_outwards(head):
    corners = head["neutral"].astype(float)[head["triangles"].astype(int)]
    volume = np.einsum("td,td->t", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert 2e6 < volume < 6e6
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    tip = head["landmark_vertices"][30].astype(int)
    at_nose = normals[np.isin(head["triangles"], tip).any(axis=1)].sum(axis=0)
    assert at_nose[2] / np.linalg.norm(at_nose) < -0.7


def test_mirror_is_an_involution_that_reflects_everything(head):
    mirror = head["mirror"].astype(int)
    np.testing.assert_array_equal(mirror[mirror], np.arange(len(mirror)))
    np.testing.assert_allclose(head["neutral"][mirror] * FLIP, head["neutral"], atol=1e-4)
    np.testing.assert_array_equal(head["identity_deltas"][:, mirror] * FLIP, head["identity_deltas"])
    np.testing.assert_array_equal(head["jaw_weights"][mirror], head["jaw_weights"])
    np.testing.assert_array_equal(head["colors"][mirror], head["colors"])


def test_triangulation_is_mirror_symmetric(head):
    mirror = head["mirror"].astype(int)
    triangles = {frozenset(triangle) for triangle in head["triangles"].tolist()}
    assert triangles == {frozenset(mirror[triangle].tolist()) for triangle in head["triangles"].astype(int)}


def test_left_and_right_units_are_exact_mirror_images(head):
    mirror, names = head["mirror"].astype(int), head["expression_names"].tolist()
    for index, name in enumerate(names):
        swapped = name.replace("Left", "Right") if "Left" in name else name.replace("Right", "Left")
        reflected = head["expression_deltas"][names.index(swapped)][mirror] * FLIP
        np.testing.assert_array_equal(reflected, head["expression_deltas"][index], err_msg=name)


def test_sided_units_move_the_subjects_side(head):
    for name in ("mouthSmile", "eyeBlink", "browDown", "noseSneer", "cheekSquint"):
        motion = np.linalg.norm(shaped(head, **{f"{name}Left": 1.0}) - shaped(head), axis=1)
        assert head["neutral"][motion.argmax(), 0] > 5, name
    teeth = head["regions"] == head["region_names"].tolist().index("teethL")
    assert (shaped(head, jawLeft=1.0) - shaped(head))[teeth, 0].mean() > 3


def test_a_full_smile_folds_the_cheek_softly(head):
    """Beside the left corner of the mouth: MakeHuman's unit has a crease of 98° there, the resting face one of 42°."""
    triangles = head["triangles"].astype(int)
    skin = head["regions"] == head["region_names"].tolist().index("skin")
    near = skin & (np.linalg.norm(head["neutral"] - (39.0, 69.0, -13.0), axis=1) < 24.0)
    triangles = triangles[near[triangles].all(axis=1)]
    vertices = shaped(head, mouthSmileLeft=1.0, mouthSmileRight=1.0)
    first, second, third = (vertices[triangles[:, k]] for k in range(3))
    normals = np.cross(second - first, third - first)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, inverse, uses = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(inverse, kind="stable")
    pairs = order[np.isin(inverse[order], np.flatnonzero(uses == 2))].reshape(-1, 2) // 3
    creases = np.degrees(np.arccos(np.clip((normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1), -1.0, 1.0)))
    assert len(creases) > 100
    assert creases.max() < 75.0
    assert np.sqrt((creases**2).mean()) < 15.0


def test_identity_components_are_nearly_orthogonal_and_ordered(head):
    components = head["identity_deltas"].reshape(50, -1) * float(head["identity_step_mm"])
    norms = np.linalg.norm(components, axis=1)
    assert (np.diff(norms) < 1e-2 * norms[:-1]).all()
    cosines = components @ components.T / np.outer(norms, norms) - np.eye(50)
    assert np.abs(cosines).max() < 0.05


def test_jaw_carries_lower_teeth_and_tongue_only(head):
    weights, names = head["jaw_weights"].astype(float), head["region_names"].tolist()
    part = {name: weights[head["regions"] == names.index(name)] for name in names}
    assert weights.min() >= 0
    assert weights.max() <= 1
    np.testing.assert_array_equal(part["teethL"], 1)
    assert part["tongue"].min() > 0.85
    for name in ("teethU", "eyeL", "eyeR", "scalp", "brow"):
        np.testing.assert_allclose(part[name], 0, atol=1e-3, err_msg=name)


def test_jaw_open_lowers_the_chin_and_the_lower_teeth(head):
    before, after = shaped(head), shaped(head, jawOpen=1.0)
    names, moved = head["region_names"].tolist(), (after - before)[:, 1]
    assert moved[head["regions"] == names.index("teethL")].max() > 25
    assert np.abs(moved[head["regions"] == names.index("teethU")]).max() < 0.5
    assert (landmarks(head, after) - landmarks(head, before))[8, 1] > 20


def test_no_teeth_show_between_resting_lips(head):
    assert teeth_area(head, shaped(head)) < 0.5
    # Tilted up and down by 15 degrees there is still nothing to see.
    for angle in (-0.26, 0.26):
        turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
        assert teeth_area(head, shaped(head) @ turn.T) < 1.0


@pytest.mark.long
def test_few_identities_show_teeth_at_rest(head):
    areas = np.array([teeth_area(head, shaped(head, identity)) for identity in identities(20)])
    # The raw units show more than 0.5 mm2 on 85 % of identities, 7 mm2 on average.
    assert (areas > 0.5).mean() < 0.1
    assert areas.mean() < 0.5


def test_teeth_show_when_the_lips_part(head):
    assert teeth_area(head, shaped(head, mouthUpperUpLeft=1.0, mouthLowerDownLeft=1.0, jawOpen=0.2)) > 10


def test_scaled_blink_closes_the_lids_of_random_identities(head):
    for identity in identities(6):
        scale = np.clip(head["blink_scale_mean"] + identity @ head["blink_scale_identity"], 0.3, 2)
        closed = shaped(head, identity, eyeBlinkLeft=scale[0], eyeBlinkRight=scale[1])
        assert left_eye_area(head, shaped(head, identity)) > 60
        assert left_eye_area(head, closed) < 3
        points = landmarks(head, closed)
        for upper, lower in ((37, 41), (38, 40), (43, 47), (44, 46)):
            assert abs(points[lower, 1] - points[upper, 1]) < 3


def test_blink_scale_is_the_same_for_both_eyes(head):
    np.testing.assert_array_equal(head["blink_scale_mean"][0], head["blink_scale_mean"][1])
    np.testing.assert_array_equal(head["blink_scale_identity"][:, 0], head["blink_scale_identity"][:, 1])
    assert 0.8 < head["blink_scale_mean"][0] < 1.2


def test_landmarks_are_convex_combinations(head):
    for name in ("landmark_barycentric", "contour_barycentric"):
        np.testing.assert_allclose(head[name].sum(axis=-1), 1, atol=1e-6)
        assert head[name].min() >= 0


def test_landmarks_are_symmetric(head):
    points = landmarks(head, shaped(head))
    np.testing.assert_allclose(points[MIDLINE_LANDMARKS, 0], 0, atol=0.05)
    for right, left in LANDMARK_PAIRS:
        np.testing.assert_allclose(points[right] * FLIP, points[left], atol=0.01)


def test_landmarks_sit_where_their_names_say(head):
    points, names = landmarks(head, shaped(head)), head["region_names"].tolist()
    assert points[36, 0] < points[39, 0] < 0 < points[42, 0] < points[45, 0]
    assert points[17, 0] < points[21, 0] < 0
    assert (points[17:27, 1] < points[36:48, 1].min()).all()
    assert points[51, 1] < points[62, 1] <= points[66, 1] + 1 < points[57, 1] + 1 < points[8, 1]
    eyes = shaped(head)[np.isin(head["regions"], [names.index("eyeL"), names.index("eyeR")])]
    nearest = np.linalg.norm(points[36:48, None] - eyes, axis=2).min(axis=1)
    assert nearest.max() < 8


def test_contour_follows_the_visible_jaw_line(head):
    yaw = head["contour_yaw_deg"]
    np.testing.assert_array_equal(yaw, np.arange(-40, 41, 10))
    corners = shaped(head)[head["contour_vertices"].astype(int)]
    contour = np.einsum("blk,blkd->bld", head["contour_barycentric"], corners)
    np.testing.assert_allclose(contour[::-1, ::-1] * FLIP, contour, atol=0.05)
    # Nose to image left (yaw > 0): the far side is the subject's right, whose silhouette moves towards the nose.
    right_depth = contour[:, 2:6, 2].mean(axis=1)
    assert right_depth[-1] < right_depth[0] - 5


def test_the_landmark_file_names_all_points():
    data = tomllib.loads((FOLDER / "landmarks.toml").read_text(encoding="utf-8"))
    assert [point["id"] for point in data["point"]] == list(range(68))
    assert data["point"][36]["name"] == "right eye, outer corner"
    assert data["point"][30]["name"] == "nose bridge, tip"
    assert [row["yaw"] for row in data["contour"]] == list(range(-40, 41, 10))
    assert len({point["name"] for point in data["point"]}) == 68
