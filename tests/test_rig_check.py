"""Landmarks of synchronised clips against their rig, and `workbench rig`."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.optional_parts import needs_gl
from tests.stereo_scenes import make_rig, make_stereo_scene, picture_in_view
from workbench.errors import InputError
from workbench.geometry import Rig, read_rig, write_rig
from workbench.landmarks.detectors import make_detector
from workbench.landmarks.epipolar import check_rig
from workbench.landmarks.files import LandmarkRecord, write_landmark_file
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures import HeadRenderer

FRAMES = 40
NOISE_PX = 0.5


@pytest.fixture(scope="module")
def stereo(head):
    """A talking head before two cameras 30° apart, with lenses that distort."""
    return make_stereo_scene(head, make_rig(distortion=(-0.2, 0.05)), FRAMES, seed=2)


@pytest.fixture(scope="module")
def three(head):
    return make_stereo_scene(head, make_rig((0.0, 30.0, -25.0)), FRAMES, seed=3)


def clips(scene, noise_px: float = NOISE_PX, **changed):
    return [scene.records(v, noise_px, **(changed if v else {})) for v in range(len(scene.rig))]


def moved(rig: Rig, index: int, turn_deg: float) -> Rig:
    """The rig with one camera tilted where it stands."""
    turn = Rotation.from_euler("x", turn_deg, degrees=True).as_matrix()
    view = rig.views[index]
    rotation, translation = turn @ view.rotation_view_world, turn @ view.translation_view_world_mm
    tilted = replace(view, rotation_view_world=rotation, translation_view_world_mm=translation)
    return Rig((*rig.views[:index], tilted, *rig.views[index + 1 :]))


def scaled(rig: Rig, factor: float) -> Rig:
    views = [replace(v, translation_view_world_mm=factor * v.translation_view_world_mm) for v in rig.views]
    return Rig(tuple(views))


def test_exact_landmarks_fit_to_the_last_digits(stereo):
    found = check_rig(stereo.rig, clips(stereo, 0.0))
    assert found.pairs[0].median_px < 1e-6
    assert max(view.p95_px for view in found.views) < 1e-6
    assert found.eye_distance_mm == pytest.approx(88.5, abs=1.5)
    assert found.warnings == ()


def test_noise_is_measured_and_nothing_stands_out(stereo):
    found = check_rig(stereo.rig, clips(stereo))
    (pair,) = found.pairs
    assert (pair.views, pair.frames, pair.offset) == (("middle", "side"), FRAMES, 0)
    # Across the lines, half a pixel in both pictures: a median of 0.67·√2·0.5.
    assert pair.median_px == pytest.approx(0.48, abs=0.05)
    assert [view.frames for view in found.views] == [FRAMES, FRAMES]
    assert found.warnings == ()


def test_cameras_that_see_profiles_are_not_doubted_for_that(head):
    """Their pictures have hardly any eye distance to divide by: of the distance itself it would be 2.9 %."""
    scene = make_stereo_scene(head, make_rig((-85.0, 85.0)), FRAMES, seed=2)
    assert check_rig(scene.rig, clips(scene)).pairs[0].median_percent < 1.5


@pytest.mark.parametrize("shift", [-4, 1, 3])
def test_a_clip_that_runs_early_or_late_is_told_by_how_many_frames(stereo, shift):
    found = check_rig(stereo.rig, clips(stereo, shift=shift))
    (pair,) = found.pairs
    assert pair.offset == -shift
    assert pair.offset_median_px < 0.6
    assert pair.median_px > 4 * pair.offset_median_px
    (warning,) = found.warnings
    assert f"frame 100 of middle fits frame {100 - shift} of side" in warning


def test_a_head_that_does_not_move_has_no_time_offset(head):
    still = make_stereo_scene(head, frames=30, moving=False)
    assert check_rig(still.rig, clips(still)).pairs[0].offset == 0


def test_a_few_frames_tell_no_time_offset(head):
    short = make_stereo_scene(head, frames=5)
    found = check_rig(short.rig, clips(short, 0.0))
    assert found.pairs[0].offset is None
    assert found.warnings == ()


def test_frames_without_a_face_drop_out(stereo):
    found = check_rig(stereo.rig, clips(stereo, missing=(3, 4, 17)))
    assert found.pairs[0].frames == FRAMES - 3
    assert found.warnings == ()


def test_a_camera_that_was_moved_is_seen_but_not_which_of_two(stereo):
    found = check_rig(moved(stereo.rig, 1, 1.0), clips(stereo))
    assert found.pairs[0].median_percent > 8
    assert any("off their epipolar lines" in text for text in found.warnings)
    assert not any("likely" in text for text in found.warnings)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_of_three_cameras_the_one_that_was_moved_is_named(three, index):
    found = check_rig(moved(three.rig, index, 1.0), clips(three))
    name = three.rig.names[index]
    assert found.views[index].others_px < 0.5
    assert any(text.startswith(f"{name} is likely off") for text in found.warnings)


def test_three_good_cameras_accuse_nobody(three):
    assert check_rig(three.rig, clips(three)).warnings == ()


def test_two_cameras_that_never_see_the_face_together_are_joined_by_a_third(three):
    early = [record for record in three.records(1, NOISE_PX) if record.frame < 20]
    late = [record for record in three.records(2, NOISE_PX) if record.frame >= 20]
    found = check_rig(three.rig, [three.records(0, NOISE_PX), early, late])
    assert [pair.views for pair in found.pairs] == [("middle", "side"), ("middle", "third")]
    assert found.warnings == ()


def test_landmark_files_in_the_wrong_order_turn_the_face_inside_out(stereo):
    first, second = clips(stereo)
    warnings = check_rig(stereo.rig, [second, first]).warnings
    assert any("inside out" in text for text in warnings)
    assert any("middle and side fit better swapped" in text for text in warnings)


def test_poses_that_were_meant_the_other_way_round_are_told(stereo):
    first, second = stereo.rig.views
    rotation, translation = stereo.rig.rotation_view_reference[1], stereo.rig.translation_view_reference_mm[1]
    turned = replace(second, rotation_view_world=rotation.T, translation_view_world_mm=-rotation.T @ translation)
    upright = replace(first, rotation_view_world=np.eye(3), translation_view_world_mm=np.zeros(3))
    warnings = check_rig(Rig((upright, turned)), clips(stereo)).warnings
    assert any("world_from_view" in text for text in warnings)


def test_a_wrong_unit_shows_in_the_size_of_the_face(stereo):
    found = check_rig(scaled(stereo.rig, 0.1), clips(stereo))
    assert found.eye_distance_mm == pytest.approx(8.9, abs=0.2)
    assert any("adults have" in text and "unit" in text for text in found.warnings)


def test_clips_that_were_scaled_down_evenly_are_compared(stereo):
    records = [
        LandmarkRecord(
            r.frame, r.name, Landmarks2D((r.landmarks.points + 0.5) / 2 - 0.5, np.ones(68), (320, 240)), None
        )
        for r in stereo.records(1)
    ]
    assert check_rig(stereo.rig, [stereo.records(0), records]).pairs[0].median_px < 1e-6


@needs_gl
def test_a_detectors_landmarks_on_rendered_pictures_fit_the_rig(head):
    scene = make_stereo_scene(head, make_rig((-15.0, 15.0)), 3, seed=5)
    detector = make_detector("network")
    with HeadRenderer(head, (640, 480)) as renderer:
        pictures = [
            [picture_in_view(renderer, head, p, scene.rig.placed_view(v)) for p in scene.parameters] for v in range(2)
        ]
    clips = [
        [
            LandmarkRecord(k, "", detector.refine(picture, scene.points[v, k]), (640, 480))
            for k, picture in enumerate(pictures[v])
        ]
        for v in range(2)
    ]
    found = check_rig(scene.rig, clips)
    assert found.pairs[0].median_percent < 1.0
    assert found.eye_distance_mm == pytest.approx(88.5, abs=3.0)
    assert found.warnings == ()


def no_faces(scene):
    return [[LandmarkRecord(0, "", None, (640, 480))], scene.records(1)]


def other_size(scene, *sizes):
    points = scene.points[0]
    return [
        [LandmarkRecord(k, "", Landmarks2D(points[k], np.ones(68), size), None) for k, size in enumerate(sizes)],
        scene.records(1),
    ]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda scene: (make_rig((0.0,)), [scene.records(0)]), "the rig has only one"),
        (lambda scene: (scene.rig, [scene.records(0)]), r"2 views \(middle, side\), got 1"),
        (lambda scene: (scene.rig, no_faces(scene)), "'middle' have no face"),
        (
            lambda scene: (scene.rig, [scene.records(0)[:3], scene.records(1)[5:]]),
            "No two of the views middle, side",
        ),
        (lambda scene: (scene.rig, other_size(scene, (640, 360))), "not scaled copies"),
        (lambda scene: (scene.rig, other_size(scene, (640, 480), (320, 240))), "2 sizes"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_one_sentence(stereo, make, message):
    with pytest.raises(InputError, match=message) as refusal:
        check_rig(*make(stereo))
    assert "\n" not in str(refusal.value)


# --- the command line ---


@pytest.fixture
def files(stereo, tmp_path):
    write_rig(stereo.rig, tmp_path / "rig.toml")
    for name, records in zip(("middle.csv", "side.csv"), clips(stereo), strict=True):
        write_landmark_file(tmp_path / name, records)
    write_landmark_file(tmp_path / "late.csv", stereo.records(1, NOISE_PX, shift=3))
    return tmp_path


@pytest.mark.usefixtures("files")
def test_landmarks_of_another_program_are_of_the_size_that_the_rig_says(run, stereo, tmp_path):
    own = run("rig", "check", "rig.toml", "middle.csv", "side.csv")
    for name, records in zip(("middle", "side"), clips(stereo), strict=True):
        np.save(tmp_path / f"{name}.npy", np.array([record.landmarks.points.round(3) for record in records]))
    assert own[0] == 0
    assert run("rig", "check", "rig.toml", "middle.npy", "side.npy") == own


def test_show_prints_a_rig_and_draws_it(run, files):
    code, out, err = run("rig", "show", "rig.toml", "--picture", "rig.png")
    assert (code, err) == (0, "")
    assert "640×480" in out
    assert "310.6 mm" in out
    assert "30.0°" in out
    assert "600 mm away" in out
    assert "wrote rig.png" in out
    picture = cv2.imread(str(files / "rig.png"))
    assert picture.shape[1] > 800
    assert picture.std() > 10


def test_show_warns_in_plain_words(run, tmp_path):
    write_rig(make_rig((0.0, 3.0)), tmp_path / "rig.toml")
    code, out, _ = run("rig", "show", "rig.toml")
    assert code == 0
    assert "warning: middle and side: 3.0° between the axes" in out


def test_a_lens_that_folds_is_told_once_and_without_a_number(run, tmp_path):
    write_rig(make_rig((0.0, 30.0), distortion=(-3.0,)), tmp_path / "rig.toml")
    code, out, _ = run("rig", "show", "rig.toml")
    assert code == 0
    assert "the distortion folds over" in out
    assert "nan" not in out
    assert "is unusual" not in out


def test_check_ends_with_0_where_nothing_stands_out_and_with_1_where_something_does(run, files):
    code, out, err = run("rig", "check", "rig.toml", "middle.csv", "side.csv")
    assert (code, err) == (0, "")
    assert "nothing stands out" in out
    code, out, err = run("rig", "check", "rig.toml", "middle.csv", "late.csv")
    assert (code, err) == (1, "")
    assert "-3 frames" in out
    assert "synchronised?" in out
    assert "two views cannot tell" in out


def test_convert_turns_opencvs_files_into_a_rig(run, tmp_path):
    matrix = np.array([[800.0, 0.0, 640.0], [0.0, 800.0, 360.0], [0.0, 0.0, 1.0]])
    rotation = Rotation.from_euler("y", 20.0, degrees=True).as_matrix()
    moved_cm = np.array([0.0, 0.0, 60.0]) - rotation @ [0.0, 0.0, 60.0]
    for name, entries in {
        "intrinsics.yml": {"M1": matrix, "D1": np.zeros((1, 5)), "M2": matrix, "D2": np.zeros((1, 5))},
        "extrinsics.yml": {"R": rotation, "T": moved_cm},
    }.items():
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for key, value in entries.items():
            storage.write(key, value)
        storage.release()
    files = ("intrinsics.yml", "extrinsics.yml")
    code, out, err = run("rig", "convert", *files, "--unit", "cm", "--size", "1280x720")
    assert (code, err) == (0, "")
    assert "wrote rig.toml" in out
    rig = read_rig(tmp_path / "rig.toml")
    np.testing.assert_allclose(rig.translation_view_reference_mm[1], 10 * moved_cm, atol=1e-9)
    assert rig.views[1].image_size == (1280, 720)
    (tmp_path / "rig.toml").write_text("mine")
    code, _, err = run("rig", "convert", *files, "--unit", "cm", "--size", "1280x720")
    assert code == 2
    assert "rig.toml exists already; name another (--out), or add --overwrite." in err
    assert (tmp_path / "rig.toml").read_text() == "mine"
    assert run("rig", "convert", *files, "--unit", "cm", "--size", "1280x720", "--overwrite")[0] == 0
    assert read_rig(tmp_path / "rig.toml").names == rig.names


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("show", "none.toml"), "does not exist"),
        (("show", "rig.toml", "--picture", "rig.jpg"), "drawn as .png"),
        (("show", "rig.toml", "--size", "big"), "1280x720; got"),
        (("show", "rig.toml", "--unit", "cm"), "gives its own unit"),
        (("check", "rig.toml", "middle.csv"), "2 views (middle, side), got 1"),
        (("convert", "rig.toml", "--out", "rig.yml"), "written as .toml"),
    ],
)
def test_what_cannot_be_done_is_one_sentence_and_exit_code_2(run, files, arguments, message):
    code, out, err = run("rig", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert message in err
    assert len(err.splitlines()) == 1
