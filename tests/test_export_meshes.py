"""USD, meshes and arrays: read back by the libraries that others read them with."""

import os
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from tests.other_heads import half_open
from tests.performances import FRAMES, GAP, gazes, looking_aside, other_character, performance, with_jaw
from tests.small_disk import small_disk
from workbench.errors import InputError, MissingDependencyError, OutputError
from workbench.export import export_track, make_clip
from workbench.export.meshes import write_arrays, write_meshes
from workbench.export.skinning import eyeball
from workbench.export.usd import write_usd
from workbench.face import load_character, load_default_head
from workbench.face.gaze import directions_deg
from workbench.geometry import project
from workbench.pictures.mesh import to_camera


@pytest.fixture(scope="module")
def clip(head):
    return make_clip(performance(head), head)


def pixels(clip, points_camera):
    return np.asarray(project(clip.camera, points_camera))


def test_what_a_killed_export_left_is_removed_by_the_next_of_its_name_but_not_what_another_writes(head, tmp_path):
    left, written, other = (tmp_path / f".{name}.partial-a1b2c3d4" for name in ("take", "take", "else"))
    written = written.with_name(".take.partial-e5f6g7h8")
    for folder in (left, written, other):
        folder.mkdir()
        (folder / "000000.obj").write_text("half of it")
    for folder in (left, other):
        os.utime(folder, (0.0, 0.0))
    export_track(performance(head), head, tmp_path / "take.obj")
    assert [folder.exists() for folder in (left, written, other)] == [False, True, True]


# --- the clip itself ---


def test_the_person_wears_the_identity_of_the_track(clip, head):
    expected = head.personal(clip.track.identity[0]).vertices(clip.track.expression[3])
    np.testing.assert_allclose(clip.vertices_head(3), expected)


def test_world_points_are_metres_up_and_towards_the_viewer(clip):
    world, track = clip.vertices_world(0), clip.track
    assert world[:, 2].max() < 0.0  # before a camera that looks along −z
    assert abs(-np.median(world[:, 2]) - 0.6) < 0.1
    chin, brow = clip.person.landmarks.of(world)[[8, 19]]
    assert chin[1] < brow[1]
    assert track.translation[0, 2] == 600.0


def test_one_shot_leaves_alone(head):
    track = performance(head, shots=2, gap=None)
    clip = make_clip(track, head, shot=1)
    assert clip.track.index.tolist() == [6, 7, 8, 9, 10, 11]
    assert clip.times_s[0] == pytest.approx(6 / 25.0)
    np.testing.assert_allclose(clip.person.neutral, head.personal(track.identity[-1]).neutral)
    assert clip.notes == ()


def test_several_faces_in_one_file_are_told(head):
    (note,) = make_clip(performance(head, shots=2, gap=1), head).notes
    assert "2 face shapes" in note
    assert "--shot" in note


def test_pictures_without_a_rate_are_told(head):
    track = performance(head, frames=2, gap=None)
    (note,) = make_clip(replace(track, meta={**track.meta, "rate": None}), head).notes
    assert "25 per second" in note
    assert make_clip(replace(track, meta={**track.meta, "rate": None}), head, rate=5.0).rate == 5.0


def test_frames_whose_fit_failed_have_no_key(head):
    track = performance(head, gap=None)
    clip = make_clip(replace(track, failure=np.where(track.index == 4, 1, 0)), head)
    assert clip.notes == (f"1 of {FRAMES} fits failed and have no key",)
    assert np.flatnonzero(~clip.track.found).tolist() == [4]
    assert make_clip(replace(track, failure=np.ones(FRAMES, int)), head).track.found.all()


def test_several_lenses_in_one_file_are_told(head):
    track = performance(head, frames=3, gap=None)
    (note,) = make_clip(replace(track, focal_px=track.focal_px * [[1.0], [1.0], [1.1]]), head).notes
    assert "several lenses" in note


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({}, {"shot": 3}, "the shots 0 to 0, got 3"),
        ({}, {"rate": 0.0}, "a rate between 0 and 1000"),
        ({"found": np.zeros(FRAMES, bool)}, {}, "No frame of this track has a face"),
        ({"expression": np.zeros((FRAMES, 2)), "meta": {"expression_names": ["a", "b"]}}, {}, "2 blendshapes that are"),
        ({"identity": np.zeros((FRAMES, 3))}, {}, "3 identity coefficients"),
    ],
)
def test_what_cannot_be_a_clip_is_refused(change, options, message, head):
    with pytest.raises(InputError, match=message):
        make_clip(replace(performance(head), **change), head, **options)


# --- USD ---


@pytest.fixture(scope="module")
def stage(clip, tmp_path_factory):
    pxr_usd = pytest.importorskip("pxr.Usd")
    path = tmp_path_factory.mktemp("usd") / "face.usd"
    write_usd(clip, path)
    return pxr_usd.Stage.Open(str(path))


def test_the_stage_says_its_units_axis_and_rate(stage):
    from pxr import UsdGeom

    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert stage.GetTimeCodesPerSecond() == 25.0
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, FRAMES - 1)


def test_usd_blendshapes_have_names_and_weights_left_on_the_left(stage, clip):
    from pxr import UsdSkel

    animation = UsdSkel.Animation(stage.GetPrimAtPath("/performance/animation"))
    names = list(animation.GetBlendShapesAttr().Get())
    assert names == list(clip.person.expression_names)
    assert animation.GetBlendShapeWeightsAttr().GetTimeSamples() == [k for k in range(FRAMES) if k != GAP]
    last = dict(zip(names, animation.GetBlendShapeWeightsAttr().Get(FRAMES - 1), strict=True))
    assert (last["mouthSmileLeft"], last["mouthSmileRight"]) == (1.0, 0.0)


@pytest.mark.parametrize("jaw", [False, True], ids=["blendshapes", "jaw joint"])
def test_usd_itself_skins_the_face_to_our_vertices(jaw, head, tmp_path):
    clip = make_clip(with_jaw(performance(head)) if jaw else performance(head), head)
    pytest.importorskip("pxr.Usd")
    from pxr import Gf, Usd, UsdGeom, UsdSkel

    write_usd(clip, tmp_path / "face.usda")
    stage = Usd.Stage.Open(str(tmp_path / "face.usda"))
    root = UsdSkel.Root(stage.GetPrimAtPath("/performance"))
    UsdSkel.BakeSkinning(root, Gf.Interval(0, FRAMES - 1))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/performance/face"))
    for frame in (0, 4, FRAMES - 1):
        points = np.array(mesh.GetPointsAttr().Get(frame))
        assert 1000.0 * np.abs(points - clip.vertices_world(frame)).max() < 0.1


def test_usd_turns_the_eyeballs_about_their_joints_by_the_fitted_gaze_and_keeps_them_round(tmp_path):
    pytest.importorskip("pxr.Usd")
    from pxr import Gf, Usd, UsdGeom, UsdSkel

    clip = looking_aside()
    write_usd(clip, tmp_path / "looking.usda")
    stage = Usd.Stage.Open(str(tmp_path / "looking.usda"))
    skeleton = UsdSkel.Skeleton(stage.GetPrimAtPath("/performance/skeleton"))
    assert list(skeleton.GetJointsAttr().Get()) == ["head", "head/jaw", "head/leftEye", "head/rightEye"]
    UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/performance")), Gf.Interval(0, FRAMES - 1))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/performance/face"))
    balls = {side: eyeball(clip.person, name) for side, name in enumerate(("rightEye", "leftEye"))}
    for frame in (0, FRAMES - 1):
        world = 1000.0 * np.array(mesh.GetPointsAttr().Get(frame)) * [1.0, -1.0, -1.0]
        back = Rotation.from_rotvec(clip.track.rotation[frame]).inv()
        points = back.apply(world - clip.track.translation[frame])
        skin = ~np.any(list(balls.values()), axis=0)
        assert np.abs(points - clip.vertices_head(frame))[skin].max() < 0.1
        for side, ball in balls.items():
            centre = clip.person.joints[("rightEye", "leftEye")[side]]
            rest, arms = clip.person.neutral[ball] - centre, points[ball] - centre
            np.testing.assert_allclose(np.linalg.norm(arms, axis=1), np.linalg.norm(rest, axis=1), atol=0.05)
            front = np.argmin(rest[:, 2])
            turned = directions_deg(arms[front]) - directions_deg(rest[front])
            np.testing.assert_allclose(turned, gazes(clip, frame)[side] - gazes(clip, 0)[side], atol=1.5)


def test_the_usd_camera_has_our_lens_also_where_its_axis_is_off_the_middle(head, tmp_path):
    pytest.importorskip("pxr.Usd")
    from pxr import Usd, UsdGeom

    track = performance(head, frames=2, gap=None)
    clip = make_clip(replace(track, principal_point_px=track.principal_point_px + np.array([30.0, -20.0])), head)
    write_usd(clip, tmp_path / "lens.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "lens.usdc"))
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/performance/camera"))
    matrix = np.array(camera.GetCamera(0).frustum.ComputeProjectionMatrix())
    world = clip.vertices_world(1)
    seen = np.column_stack([world, np.ones(len(world))]) @ matrix
    x = (seen[:, 0] / seen[:, 3] + 1.0) / 2.0 * 640 - 0.5
    y = (1.0 - seen[:, 1] / seen[:, 3]) / 2.0 * 480 - 0.5
    np.testing.assert_allclose(np.stack([x, y], 1), pixels(clip, world * [1000.0, -1000.0, -1000.0]), atol=0.02)


def test_usd_without_its_package_says_what_to_install(clip, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "face-energy-workbench\[usd\]"'):
        write_usd(clip, tmp_path / "face.usd")


@pytest.mark.parametrize("suffix", [".usd", ".usda", ".usdc"])
def test_a_stage_that_finds_no_room_says_what_the_system_says(clip, tmp_path, suffix):
    pytest.importorskip("pxr.Usd")
    with (
        pytest.raises(OutputError, match=rf"face{suffix} cannot be written \(File too large\); the system allows"),
        small_disk(8192),
    ):
        write_usd(clip, tmp_path / f"face{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_what_usd_alone_knows_of_a_stage_that_it_cannot_write_is_told(clip, tmp_path, monkeypatch):
    pytest.importorskip("pxr.Usd")
    from pxr import Sdf, Tf

    monkeypatch.setattr(Sdf.Layer, "Export", lambda *_: Tf.RaiseRuntimeError("There is no writer"))
    refusal = r"cannot be written \(USD: Python runtime error.*There is no writer\); name another place\.$"
    with pytest.raises(OutputError, match=refusal):
        write_usd(clip, tmp_path / "face.usd")


def test_usd_keeps_every_blendshape_also_where_names_differ_in_punctuation_alone(head, tmp_path):
    pytest.importorskip("pxr.Usd")
    from pxr import Usd, UsdSkel

    names = ("あ", "い", "smile-L", "smile_L", "smile.L")
    shown = head.expression_names[: len(names)]
    model = replace(head.with_expressions(shown), expression_names=names)
    track = performance(head, frames=2, gap=None)
    write_usd(make_clip(replace(track, expression=track.expression[:, :5], meta={**track.meta,
              "expression_names": list(names)}), model), tmp_path / "face.usda")  # fmt: skip
    stage = Usd.Stage.Open(str(tmp_path / "face.usda"))
    binding = UsdSkel.BindingAPI(stage.GetPrimAtPath("/performance/face"))
    assert tuple(binding.GetBlendShapesAttr().Get()) == names
    targets = binding.GetBlendShapeTargetsRel().GetTargets()
    assert len(set(targets)) == len(names)
    for target, delta in zip(targets, model.expression_deltas, strict=True):
        moved = len(UsdSkel.BlendShape(stage.GetPrimAtPath(target)).GetOffsetsAttr().Get())
        assert moved == np.count_nonzero(delta.any(axis=1))


def test_a_usd_character_without_a_jaw_is_a_stage_too(head, tmp_path):
    pytest.importorskip("pxr.Usd")
    from pxr import Usd, UsdGeom

    character = other_character(head, np.zeros(50), keep=0.15)
    clip = make_clip(replace(performance(head, frames=2, gap=None), identity=np.zeros((2, 0))), character)
    write_usd(clip, tmp_path / "other.usda")
    stage = Usd.Stage.Open(str(tmp_path / "other.usda"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/performance/face"))
    assert len(mesh.GetPointsAttr().Get()) == len(character.neutral)


# --- meshes ---


@pytest.mark.parametrize("kind", ["obj", "ply"])
def test_trimesh_reads_every_frame_with_a_face_back(kind, clip, tmp_path):
    told = []
    paths = write_meshes(clip, tmp_path / "frames", kind, lambda done, total: told.append((done, total)))
    assert [path.name for path in paths] == [f"{k:06d}.{kind}" for k in range(FRAMES) if k != GAP]
    assert sorted((tmp_path / "frames").iterdir()) == sorted(paths)
    assert told[-1] == (FRAMES - 1, FRAMES - 1)
    mesh = trimesh.load(paths[-1], process=False, maintain_order=True)
    np.testing.assert_allclose(mesh.vertices, clip.vertices_world(FRAMES - 1), atol=1e-6)
    np.testing.assert_array_equal(mesh.faces, clip.person.triangles)
    assert mesh.volume > 0.0  # the outside is outside


def test_a_folder_that_is_there_is_left_alone(clip, tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="already exists"):
        write_meshes(clip, tmp_path / "frames", "obj")
    assert [path.name for path in tmp_path.rglob("*.*")] == ["mine.txt"]


def test_an_interrupted_folder_of_meshes_leaves_nothing(clip, tmp_path):
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_meshes(clip, tmp_path / "frames", "ply", interrupt)
    assert not list(tmp_path.iterdir())


def test_other_kinds_of_mesh_are_refused(clip, tmp_path):
    with pytest.raises(InputError, match="obj or ply, got 'stl'"):
        write_meshes(clip, tmp_path / "frames", "stl")


# --- arrays ---


def test_arrays_rebuild_the_face_with_numpy_alone(clip, tmp_path):
    write_arrays(clip, tmp_path / "face.npz")
    with np.load(tmp_path / "face.npz", allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in stored.files}
    frame = FRAMES - 1
    face = arrays["neutral_mm"] + np.tensordot(arrays["weights"][frame], arrays["shapes_mm"], axes=1)
    camera = face @ arrays["rotation"][frame].T + arrays["translation_mm"][frame]
    np.testing.assert_allclose(camera * [1e-3, -1e-3, -1e-3], clip.vertices_world(frame), atol=1e-6)
    image = camera @ arrays["camera_matrix"][frame].T
    np.testing.assert_allclose(image[:, :2] / image[:, 2:], pixels(clip, camera), atol=1e-6)
    assert np.isnan(arrays["rotation"][GAP]).all()
    assert arrays["names"].tolist() == list(clip.person.expression_names)
    assert arrays["time_s"][frame] == pytest.approx(frame / 25.0)


@pytest.mark.parametrize("change", [None, half_open], ids=["default head", "another model's jaw"])
def test_a_jaw_joint_is_moved_with_numpy_alone(change, head, tmp_path):
    model = head if change is None else change(head)
    clip = make_clip(with_jaw(performance(model)), model)
    write_arrays(clip, tmp_path / "face.npz")
    with np.load(tmp_path / "face.npz", allow_pickle=False) as arrays:
        frame = FRAMES - 1
        jaw, hang = arrays["jaw"][frame], arrays["jaw_weights"][:, None]
        face = arrays["neutral_mm"] + np.tensordot(arrays["weights"][frame], arrays["shapes_mm"], axes=1)
        turned = Rotation.from_rotvec(jaw[:3]).apply(face - arrays["jaw_pivot_mm"]) + arrays["jaw_pivot_mm"] + jaw[3:]
        corrected = np.degrees(jaw[0]) / arrays["jaw_open_deg"] * arrays["jaw_corrective_mm"]
        face = arrays["scale"][frame] * (face + hang * (turned - face) + corrected)
    np.testing.assert_allclose(face, clip.vertices_head(frame), atol=1e-4)


# --- a character in USD ---


@pytest.fixture(scope="module")
def dressed():
    return load_character("kofi")


@pytest.fixture(scope="module")
def worn(clip, dressed, tmp_path_factory):
    """The clip, and the path of a stage on which a character plays it."""
    pytest.importorskip("pxr.Usd")
    path = tmp_path_factory.mktemp("usd") / "kofi.usda"
    played = replace(clip, person=load_default_head().personal(dressed.character.identity))
    write_usd(played, path, dressed)
    return played, path


def bound_material(stage, name):
    from pxr import UsdShade

    return UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(f"/performance/{name}")).ComputeBoundMaterial()[0]


def test_a_usd_character_has_a_mesh_and_a_material_for_each_part(worn, dressed):
    from pxr import Usd, UsdGeom

    _, path = worn
    stage = Usd.Stage.Open(str(path))
    names = ["face", *(part.part.kind for part in dressed.worn)]
    meshes = [prim.GetName() for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    assert sorted(meshes) == sorted(names)
    for name in names:
        surface = bound_material(stage, name).ComputeSurfaceSource()[0]
        threshold, opacity = (surface.GetInput(key) for key in ("opacityThreshold", "opacity"))
        assert (threshold.Get() > 0.0) == (name in ("hair", "clothes"))
        assert opacity.HasConnectedSource() == (name in ("brows", "lashes", "hair", "clothes"))
        assert surface.GetInput("diffuseColor").HasConnectedSource() == (name != "corneas")
    assert bound_material(stage, "corneas").ComputeSurfaceSource()[0].GetInput("opacity").Get() < 0.2
    face = UsdGeom.Mesh(stage.GetPrimAtPath("/performance/face"))
    assert len(face.GetFaceVertexCountsAttr().Get()) == int(dressed.shown.sum())


def test_pictures_of_a_usd_character_lie_beside_the_stage(worn, dressed):
    from pxr import Usd, UsdShade

    _, path = worn
    stage = Usd.Stage.Open(str(path))
    seen = {}
    for prim in stage.Traverse():
        if prim.IsA(UsdShade.Shader) and UsdShade.Shader(prim).GetIdAttr().Get() == "UsdUVTexture":
            file = UsdShade.Shader(prim).GetInput("file").Get()
            assert not Path(file.path).is_absolute()
            seen[prim.GetParent().GetName()] = cv2.imread(file.resolvedPath, cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(seen["face"][..., ::-1], dressed.skin)
    hair = next(part.picture for part in dressed.worn if part.part.kind == "hair")
    np.testing.assert_array_equal(cv2.cvtColor(seen["hair"], cv2.COLOR_BGRA2RGBA), hair)


@pytest.mark.parametrize("broken", ["workbench.export.usd_parts.cv2.imencode", "workbench.export.usd._camera"])
def test_what_breaks_off_over_a_usd_character_leaves_its_stage_and_pictures(
    worn, dressed, tmp_path, monkeypatch, broken
):
    def content():
        return {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}

    played, _ = worn
    write_usd(played, tmp_path / "talk.usda", dressed)
    before = content()
    other, calls = load_character("mei"), []

    def breaks_off(*arguments):
        calls.append(arguments)
        if len(calls) > 3 or broken.endswith("_camera"):
            raise KeyboardInterrupt
        return True, np.zeros(1, np.uint8)

    monkeypatch.setattr(broken, breaks_off)
    with pytest.raises(KeyboardInterrupt):
        write_usd(played, tmp_path / "talk.usda", other)
    assert content() == before


def test_stages_of_one_name_and_two_suffixes_have_pictures_of_their_own(worn, dressed, tmp_path):
    played, _ = worn
    for suffix in (".usda", ".usdc"):
        write_usd(played, tmp_path / f"talk{suffix}", dressed)
    folders = [path for path in tmp_path.iterdir() if path.is_dir()]
    assert sorted(folder.name for folder in folders) == ["talk.usda_textures", "talk.usdc_textures"]


def test_usd_moves_the_parts_where_the_character_has_them(worn, dressed):
    from pxr import Gf, Usd, UsdGeom, UsdSkel

    played, path = worn
    stage = Usd.Stage.Open(str(path))
    UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetPrimAtPath("/performance")), Gf.Interval(0, FRAMES - 1))
    rest = played.person.neutral
    for frame in (0, FRAMES - 1):
        head = played.vertices_head(frame)
        for part, points in zip(dressed.worn, dressed.parts_on(rest, head), strict=True):
            mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/performance/{part.part.kind}"))
            found = 1000.0 * np.array(mesh.GetPointsAttr().Get(frame))
            camera = to_camera(points, played.track.rotation[frame], played.track.translation[frame])
            assert np.abs(found - camera * [1.0, -1.0, -1.0]).max() < 0.5, part.part.kind


def test_a_stage_without_a_character_has_no_materials(stage):
    assert not stage.GetPrimAtPath("/performance/materials")
