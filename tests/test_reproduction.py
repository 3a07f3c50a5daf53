"""`workbench reproduce`: the papers' figures and tables remade, kept, and shown beside the printed numbers."""

import csv
import json
import os
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from workbench import reproduction
from workbench.config import preset
from workbench.errors import InputError
from workbench.face import FaceParameters
from workbench.geometry import Camera, axis_angle_from_yaw_pitch_roll, project, yaw_pitch_roll_deg
from workbench.landmarks.observations import Landmarks2D
from workbench.pictures.lighting import Light, Lighting
from workbench.reproduction import (
    Item,
    Result,
    Study,
    Table,
    boston_camera,
    clip_solves,
    face_it,
    notebook,
    pose_errors,
)
from workbench.reproduction import study as studies
from workbench.reproduction.boston import INCH_MM, NAMES, BostonSequence, read_set
from workbench.reproduction.differences import FEW_FRAMES, deep_configs, deep_rows, face_it_configs
from workbench.reproduction.head_pose import POSE_COLUMNS, errors_of, poses_by_pnp, read_poses
from workbench.reproduction.items import ITEMS
from workbench.reproduction.rendered_clip import SEVEN_FRAMES, clip_truth, errors_of_pose_and_jaw
from workbench.reproduction.simulated_boston import (
    DISTANCE_MM,
    SHIFT_MM,
    TURN_DEG,
    motion_of,
    sensor_head_mm,
    simulate_set,
)
from workbench.reproduction.stereo_film import APART_DEG, AWAY_MM, turned_lighting, two_cameras
from workbench.samples import sample

FRAMES = 4


@pytest.fixture(scope="module")
def simulated(head, tmp_path_factory):
    """A short simulated set: one person who turns, one who nods."""
    folder = tmp_path_factory.mktemp("set")
    simulate_set(folder, head, ("jam5", "jim6"), FRAMES)
    return folder


@pytest.fixture
def counted(monkeypatch):
    """An item that counts how often it is made."""
    item = Item("counted", "FACE IT!", "Fig. 0", "A count", "counting:make", "Nothing.")
    calls = []

    def make(study: Study) -> Result:
        calls.append(study)
        rows = (("<first>", "1.0"),)
        picture = np.zeros((8, 8, 3), np.uint8)
        return Result(
            "two numbers & more.", {"A black square.": picture}, (Table("Counts", ("", "n"), rows),), ("So.",)
        )

    monkeypatch.setattr(studies, "import_module", lambda name: type("Module", (), {"make": staticmethod(make)}))
    monkeypatch.setattr(studies, "ITEMS", (item,))
    return item, calls


def test_every_item_has_a_function_of_its_own():
    for item in ITEMS:
        module, function = item.make.split(":")
        assert callable(getattr(studies.import_module(f"workbench.reproduction.{module}"), function))
    assert len({item.name for item in ITEMS}) == len({item.make for item in ITEMS}) == len(ITEMS)


def test_items_are_chosen_by_name_in_the_papers_order():
    names = [item.name for item in ITEMS]
    assert [item.name for item in reproduction.choose(names[2::-1])] == names[:3]
    assert reproduction.choose(()) == ITEMS


def test_an_unknown_item_is_refused():
    with pytest.raises(InputError, match="There is no item 'figure-99'; `workbench reproduce --list` names them"):
        reproduction.choose(["figure-99"])


def test_figures_tables_and_result_are_files_and_a_page_shows_them(counted, tmp_path):
    item, _ = counted
    reproduction.run([item], tmp_path, quick=True)
    with (tmp_path / "counted" / "counted-1.csv").open() as stream:
        assert list(csv.reader(stream)) == [["", "n"], ["<first>", "1.0"]]
    assert (tmp_path / "counted" / "counted-1.png").stat().st_size > 0
    page = reproduction.write_page(tmp_path).read_text()
    assert "<td>&lt;first&gt;</td><td>1.0</td>" in page
    assert '<img src="counted/counted-1.png" alt="A black square.">' in page
    assert "two numbers &amp; more. A quick run" in page


def test_a_notebook_shows_text_tables_and_figures_on_a_screen(counted, tmp_path, monkeypatch):
    item, calls = counted
    monkeypatch.setattr(notebook, "choose", lambda names: (item,))
    told, table, caption, figure, notes = reproduction.shown("counted", tmp_path)
    assert told.data == "**The paper:** Nothing.\n\n**Here:** two numbers & more."
    assert "| <first> | 1.0 |" in table.data
    assert (caption.data, notes.data) == ("*A black square.*", "So.")
    assert (figure.width, figure.height) == (8, 8)
    (left_out,) = reproduction.shown("counted", tmp_path, left_out=True)
    assert "`workbench reproduce counted` makes it" in left_out.data
    assert len(calls) == 1


def test_what_was_made_from_the_same_inputs_is_left_as_it_is(counted, tmp_path):
    item, calls = counted
    assert reproduction.run([item], tmp_path, quick=True) == ((item, True),)
    assert reproduction.run([item], tmp_path, quick=True) == ((item, False),)
    assert len(calls) == 1
    reproduction.run([item], tmp_path)
    reproduction.run([item], tmp_path, overwrite=True)
    assert [study.quick for study in calls] == [True, False, False]


def test_a_quick_run_leaves_what_was_made_on_all_of_the_data(counted, tmp_path):
    item, calls = counted
    reproduction.run([item], tmp_path)
    assert reproduction.run([item], tmp_path, quick=True) == ((item, False),)
    assert reproduction.run([item], tmp_path, quick=True, overwrite=True) == ((item, True),)
    assert [study.quick for study in calls] == [False, True]


def test_figures_of_an_earlier_result_do_not_stay(counted, tmp_path, monkeypatch):
    item, _ = counted
    square = np.zeros((8, 8, 3), np.uint8)
    captions = [("one", "two"), ("one",)]
    module = type("Module", (), {"make": lambda study: Result("x", dict.fromkeys(captions.pop(0), square))})
    monkeypatch.setattr(studies, "import_module", lambda name: module)
    for _ in range(2):
        reproduction.run([item], tmp_path, overwrite=True)
    assert sorted(path.name for path in (tmp_path / "counted").glob("*.png")) == ["counted-1.png"]


def test_a_set_whose_files_changed_makes_an_item_anew(counted, tmp_path):
    item, calls = counted
    item, folder = replace(item, reads_set=True), tmp_path / "set"
    folder.mkdir()
    for text in ("damaged", "damaged", "whole again"):
        (folder / "jam1.dat").write_text(text)
        os.utime(folder / "jam1.dat", (1.0, 1.0))
        reproduction.run([item], tmp_path / "out", boston=folder)
    assert len(calls) == len({study.folder for study in calls}) == 2


def test_what_an_item_keeps_is_for_one_set_and_ends_with_overwrite(counted, tmp_path):
    """Landmarks found on one set are none of another's."""
    item, calls = counted
    item = replace(item, reads_set=True)
    for boston in (None, tmp_path / "first", tmp_path / "second", tmp_path / "first"):
        reproduction.run([item], tmp_path, boston=boston)
    simulated, first, second, again = (study.folder for study in calls)
    assert first == again
    assert len({simulated, first, second}) == 3
    first.mkdir()
    (first / "kept.csv").touch()
    reproduction.run([item], tmp_path, boston=tmp_path / "first", overwrite=True)
    assert not (first / "kept.csv").exists()


def test_poses_that_changed_make_an_item_anew(counted, tmp_path):
    item, calls = counted
    item, path = replace(item, reads_set=True), tmp_path / "other.csv"
    for text in ("one", "one", "two"):
        path.write_text(text)
        reproduction.run([item], tmp_path, poses=[path])
    assert len(calls) == 2
    assert calls[0].folder == calls[1].folder


def test_another_clip_makes_an_item_anew_and_is_kept_apart(counted, tmp_path):
    item, calls = counted
    item = replace(item, reads_clip=True)
    for clip in (None, tmp_path / "talk.mp4", tmp_path / "talk.mp4", tmp_path / "speech.mp4"):
        reproduction.run([item], tmp_path, clip=clip)
    assert [study.clip and study.clip.name for study in calls] == [None, "talk.mp4", "speech.mp4"]
    assert len({study.folder for study in calls}) == 3


def test_items_that_share_a_folder_find_there_what_the_first_one_kept(counted, tmp_path):
    item, calls = counted
    other = replace(item, name="another", shares="counted")
    reproduction.run([item, other], tmp_path)
    first, second = calls
    assert first.folder == second.folder
    first.folder.mkdir()
    (first.folder / "kept.npz").touch()
    reproduction.run([other], tmp_path, overwrite=True)
    assert (first.folder / "kept.npz").exists()
    reproduction.run([item], tmp_path, overwrite=True)
    assert not (first.folder / "kept.npz").exists()


def test_an_item_shares_the_folder_of_one_that_comes_before_it():
    """With `overwrite` the first one empties it."""
    names = [item.name for item in ITEMS]
    for place, item in enumerate(ITEMS):
        assert not item.shares or names.index(item.shares) < place


def test_meshes_that_changed_make_an_item_anew(counted, tmp_path):
    item, calls = counted
    item, folder = replace(item, reads_meshes=True), tmp_path / "meshes"
    (folder / "PRNet").mkdir(parents=True)
    for text in ("", "one", "one", "one and two"):
        if text:
            (folder / "PRNet" / "frame_200.obj").write_text(text)
            os.utime(folder / "PRNet" / "frame_200.obj", (1.0, 1.0))
        reproduction.run([item], tmp_path, meshes=folder)
    assert len(calls) == 3
    assert {study.meshes for study in calls} == {folder}


def test_a_damaged_result_is_named(counted, tmp_path):
    item, _ = counted
    reproduction.run([item], tmp_path)
    (tmp_path / "counted" / "result.json").write_text('{"inputs": ')
    with pytest.raises(InputError, match=r"result\.json cannot be read as a result .*; delete it and run again\."):
        reproduction.run([item], tmp_path)


@pytest.mark.parametrize(("number", "axis"), [(4, 2), (5, 0), (6, 1)], ids=["roll", "yaw", "pitch"])
def test_a_sequence_turns_the_head_about_its_axis(head, number, axis):
    motion, angles_deg = motion_of(number, 200, head.expression_names, np.random.default_rng(number))
    largest = np.abs(angles_deg).max(axis=0)
    assert largest[axis] > 0.7 * TURN_DEG[axis]
    assert (np.delete(largest / TURN_DEG, axis) < 0.1).all()
    np.testing.assert_allclose(yaw_pitch_roll_deg(motion.rotation), angles_deg, atol=1e-9)
    np.testing.assert_allclose(angles_deg[0], 0.0, atol=1e-9)


@pytest.mark.parametrize(("number", "axis"), [(1, 0), (2, 1), (3, 2)], ids=["X", "Y", "Z"])
def test_a_sequence_moves_the_head_along_its_axis(head, number, axis):
    motion, _ = motion_of(number, 200, head.expression_names, np.random.default_rng(number))
    moved = np.abs(motion.translation_mm - [0.0, 0.0, DISTANCE_MM]).max(axis=0) / SHIFT_MM
    assert moved[axis] > 0.7
    assert (np.delete(moved, axis) < 0.1).all()


def test_the_simulated_set_is_read_like_the_real_one(simulated, head):
    sequences, problems = read_set(simulated)
    assert [one.name for one in sequences] == ["jam5", "jim6"]
    assert len(problems) == len(NAMES) - 2
    assert [len(one.angles_deg) for one in sequences] == [FRAMES, FRAMES]
    np.testing.assert_allclose(sequences[0].places_mm[0, 2], DISTANCE_MM, atol=4 * INCH_MM)
    assert sensor_head_mm(head)[1] < head.neutral[head.regions["scalp"]][:, 1].mean()


def test_without_opengl_there_are_no_simulated_people(head, tmp_path, monkeypatch):
    monkeypatch.setenv("WORKBENCH_NO_GL", "1")
    with pytest.raises(InputError, match="drawn by OpenGL, which does not work here; install Mesa's drivers"):
        simulate_set(tmp_path, head, ("jam5",), FRAMES)


def test_a_set_that_is_there_is_not_simulated_again(simulated, head):
    before = (simulated / "jam5.avi").stat().st_mtime_ns
    simulate_set(simulated, head, ("jam5", "jim6"), FRAMES)
    assert (simulated / "jam5.avi").stat().st_mtime_ns == before


def test_an_interrupted_sequence_is_simulated_again_to_the_same_readings(simulated, head):
    readings = (simulated / "jim6.dat").read_bytes()
    (simulated / "jim6.dat").unlink()
    simulate_set(simulated, head, ("jam5", "jim6"), FRAMES)
    assert (simulated / "jim6.dat").read_bytes() == readings


def test_pnp_finds_the_pose_of_the_mean_face(head):
    turn = axis_angle_from_yaw_pitch_roll(np.array([20.0, -10.0, 5.0]))
    points = Rotation.from_rotvec(turn).apply(head.landmarks.of(head.neutral)) + np.array([10.0, -20.0, 700.0])
    seen = Landmarks2D(np.asarray(project(boston_camera(), points)), np.ones(68), (320, 240))
    rotations, translations = poses_by_pnp(head, [seen, None])
    np.testing.assert_allclose(rotations[0], turn, atol=1e-5)
    np.testing.assert_allclose(translations[0], [10.0, -20.0, 700.0], atol=1e-2)
    assert np.isnan(rotations[1]).all()


def sequence(frames: int = 3) -> BostonSequence:
    return BostonSequence("jam1", None, np.zeros((frames, 3)), np.zeros((frames, 3)))


def rows_of(*rows) -> str:
    return "\n".join([",".join(POSE_COLUMNS), *rows]) + "\n"


def test_poses_of_another_program_are_read_and_frames_left_out_count_as_missed(tmp_path):
    path = tmp_path / "other.csv"
    path.write_text(rows_of("jam1,0,0,0,0,0,0,700", "jam1,2,10,0,0,25.4,0,700"))
    poses = read_poses(path, [sequence()])
    found = pose_errors(sequence(), *poses["jam1"])
    assert found.missed == 1
    np.testing.assert_allclose(found.angles_deg[-1], [10.0, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(found.places_in[-1], [1.0, 0.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("frame,yaw_deg\n1,2\n", "has no column 'sequence'; give the columns sequence, frame, yaw_deg"),
        (rows_of("jam1,3,0,0,0,0,0,0"), "has frame 3 of 'jam1' in line 2, which the set does not have."),
        (rows_of("tom,0,0,0,0,0,0,0"), "has frame 0 of 'tom' in line 2, which the set does not have."),
        (rows_of("jam1,0,nan,0,0,0,0,0"), "has numbers in line 2 that are not finite; leave such rows out."),
        (rows_of("jam1,first,0,0,0,0,0,0"), "cannot be read as a table of head poses"),
        (rows_of(), "other.csv has no rows; give a row for each frame with a pose."),
    ],
    ids=["columns", "frame", "name", "not finite", "words", "empty"],
)
def test_poses_that_do_not_fit_the_set_are_refused_in_one_sentence(tmp_path, text, words):
    path = tmp_path / "other.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        read_poses(path, [sequence()])
    assert words in str(refused.value)


class TestTheTableOfHeadPoses:
    """On a set of three sequences of which `quick` uses the first; presets and PnP find nothing."""

    @pytest.fixture(autouse=True)
    def small_set(self, monkeypatch):
        self.solved = []
        whole = [replace(sequence(), name=name) for name in ("jam1", "jam2", "jam3")]
        still = pose_errors(sequence(), np.zeros((3, 3)), np.zeros((3, 3)))
        monkeypatch.setattr(face_it, "read_set", lambda folder: (whole, ()))
        monkeypatch.setattr(face_it, "landmarks_of_sequence", lambda one, store: self.solved.append(one.name))
        monkeypatch.setattr(face_it, "errors_of", lambda sequences, way, store: [still])

    def made(self, tmp_path, *rows):
        path = tmp_path / "other.csv"
        path.write_text(rows_of(*rows))
        return face_it.head_pose(Study(tmp_path, quick=True, boston=tmp_path, poses=(path,)))

    def test_a_table_of_the_whole_set_serves_a_quick_run_and_the_page_says_how_much_was_used(self, tmp_path):
        found = self.made(tmp_path, "jam1,0,0,0,0,0,0,700", "jam3,0,0,0,0,0,0,700")
        assert found.data == "Boston University's set, 1 of its 45 sequences of uniform light."
        (row,) = [row for row in found.tables[0].rows if row[0] == "other.csv"]
        assert row[-2:] == ("1", "2")

    def test_a_row_that_the_set_does_not_have_is_told_before_anything_is_solved(self, tmp_path):
        with pytest.raises(InputError, match="frame 3 of 'jam3' in line 2, which the set does not have"):
            self.made(tmp_path, "jam3,3,0,0,0,0,0,700")
        with pytest.raises(InputError, match=r"other.csv has no pose in the sequences that are used \(jam1\)"):
            self.made(tmp_path, "jam3,0,0,0,0,0,0,700")
        assert self.solved == []


def test_poses_are_computed_once(tmp_path):
    calls = []

    def poses_of(one):
        calls.append(one.name)
        return np.zeros((3, 3)), np.zeros((3, 3))

    first = errors_of([sequence()], poses_of, tmp_path / "store")
    second = errors_of([sequence()], poses_of, tmp_path / "store")
    assert calls == ["jam1"]
    np.testing.assert_array_equal(first[0].angles_deg, second[0].angles_deg)


def test_the_command_lists_items(run):
    code, out, _ = run("reproduce", "--list")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()[1:]] == [item.name for item in ITEMS]


def test_the_command_remakes_a_figure_and_says_what_to_open(run, tmp_path):
    code, out, _ = run("reproduce", "beta-curve", "--out", "made")
    assert code == 0
    assert "beta-curve: FACE IT! Fig. 2, The range function E_β" in out
    assert "Open made/index.html" in out
    stored = json.loads((tmp_path / "made" / "beta-curve" / "result.json").read_text())
    assert stored["tables"][0]["rows"][5][0] == "1.002"
    code, out, _ = run("reproduce", "beta-curve", "--out", "made")
    assert "made before; --overwrite remakes it" in out
    assert "Open [made]/index.html" in run("reproduce", "beta-curve", "--out", "[made]")[1]


def test_the_command_refuses_an_unknown_item(run):
    code, _, err = run("reproduce", "fig-1")
    assert code == 2
    assert "There is no item 'fig-1'" in err


@pytest.mark.parametrize("option", ["--boston", "--poses", "--meshes", "--clip"])
def test_the_command_refuses_data_that_does_not_exist_before_it_starts(run, option):
    code, _, err = run("reproduce", option, "mistyped")
    assert code == 2
    assert "mistyped does not exist; check the name and the folder." in err


@pytest.mark.parametrize(
    ("option", "reader"),
    [
        ("--boston", "head-pose"),
        ("--poses", "head-pose"),
        ("--meshes", "other-meshes"),
        ("--clip", "clip-through-time"),
    ],
)
def test_the_command_refuses_data_that_no_chosen_item_reads(run, tmp_path, option, reader):
    (tmp_path / "data").mkdir()
    code, _, err = run("reproduce", "beta-curve", option, "data")
    assert code == 2
    assert f"None of these items reads {option}; choose {reader} as well." in err


# Deep Energies.


def test_both_cameras_of_the_stereo_film_look_at_the_head():
    rig = two_cameras()
    for view in rig.views:
        seen = view.rotation_view_world @ [0.0, 0.0, AWAY_MM] + view.translation_view_world_mm
        np.testing.assert_allclose(seen, [0.0, 0.0, AWAY_MM], atol=1e-9)
    front, side = (view.position_world_mm - [0.0, 0.0, AWAY_MM] for view in rig.views)
    cosine = front @ side / np.linalg.norm(front) / np.linalg.norm(side)
    assert np.degrees(np.arccos(cosine)) == pytest.approx(APART_DEG)


def test_a_light_turns_with_the_camera():
    turn = Rotation.from_euler("y", 90.0, degrees=True).as_matrix()
    (light,) = turned_lighting(Lighting((Light((1.0, 0.0, 0.0), 1.0),), 0.2), turn).lights
    np.testing.assert_allclose(light.direction, [0.0, 0.0, -1.0], atol=1e-12)


@pytest.mark.parametrize("frame", [0, 200])
def test_the_truth_of_the_clip_has_no_errors(head, frame):
    truth = clip_truth()
    jaw = np.array([np.radians(truth.jaw_deg[frame]), *np.zeros(5)])
    parts = truth.rotation[frame], truth.translation_mm[frame], truth.expression[frame], truth.identity, jaw
    parameters = FaceParameters(*parts, np.ones(1))
    np.testing.assert_allclose(errors_of_pose_and_jaw(parameters, frame), 0.0, atol=1e-9)
    person = head.personal(truth.identity)
    focal, middle = truth.camera_matrix[[0, 1], [0, 1]], truth.camera_matrix[:2, 2]
    turn = Rotation.from_rotvec(truth.rotation[frame]).as_matrix()
    points = person.landmarks.of(person.vertices(truth.expression[frame])) @ turn.T + truth.translation_mm[frame]
    with np.load(sample("performance-truth"), allow_pickle=False) as stored:
        exact = stored["landmarks"][frame]
        seen = project(Camera(focal, middle, stored["distortion"]), points)
    np.testing.assert_allclose(np.asarray(seen)[17:], exact[17:], atol=0.05)


@pytest.mark.parametrize("configs", [face_it_configs, deep_configs])
def test_every_row_of_the_differences_is_another_configuration(configs):
    made = [config.model_dump_json(exclude={"preset"}) for config in configs().values()]
    assert len(set(made)) == len(made)


def test_the_derivative_through_the_network_is_taken_on_few_frames_and_the_label_says_so():
    rows = {label: (config.deep.derivative, tuple(frames)) for label, config, frames in deep_rows(quick=False)}
    few = {label: kind for label, (kind, frames) in rows.items() if frames != SEVEN_FRAMES}
    assert {rows[label][1] for label in few} == {FEW_FRAMES}
    assert set(few.values()) == {"forward", "broyden"}
    assert all(f"frames {FEW_FRAMES[0]} and {FEW_FRAMES[1]} alone" in label for label in few)
    assert not any("alone" in label for label in rows.keys() - few.keys())
    assert {config.deep.derivative for _, config, _ in deep_rows(quick=True)} == {"broyden"}


class TestNotesOnIterations:
    """A note says what the numbers of its own run show."""

    @pytest.mark.parametrize(
        ("errors", "told"),
        [((4.3, 4.28, 4.28), "after 1 iteration where"), ((9.0, 4.3, 4.28), "after 5 iterations where")],
    )
    def test_the_pose_converges_after_as_many_as_the_errors_say(self, errors, told):
        assert told in face_it.pose_notes((1, 5, 15), errors)[0]

    def test_a_pose_that_needs_as_many_as_the_papers_is_not_said_to_need_fewer(self):
        assert not any("converged" in note for note in face_it.pose_notes((1, 5, 15), (9.0, 6.0, 4.0)))

    @pytest.mark.parametrize("errors", [(4.0, 6.0, 4.0), (3.0, 4.0, 4.3), (np.nan, np.nan, np.nan), (4.0, 4.0, np.nan)])
    def test_a_pose_whose_errors_rise_again_or_are_none_is_not_said_to_converge(self, errors):
        assert not any("converged" in note for note in face_it.pose_notes((1, 5, 15), errors))

    def test_the_expression_is_said_not_to_converge_within_the_iterations_that_were_run(self):
        assert face_it.expression_notes((1, 5, 15), (4.3, 4.2, 3.6)) == ["The expression has not converged after 15."]

    def test_an_expression_that_converges_is_not_said_not_to(self):
        assert face_it.expression_notes((1, 15, 40, 50), (4.3, 3.01, 3.0, 3.0)) == []

    def test_fifteen_iterations_are_too_few_where_more_give_a_smaller_error(self):
        assert face_it.expression_notes((1, 15, 40, 50), (4.3, 4.0, 3.0, 2.0)) == [
            "As in the paper, the expression has not converged after 50.",
            "Unlike in the paper, 15 iterations of the expression are not enough.",
        ]

    @pytest.mark.parametrize(
        ("by_rho", "by_epsilon", "told"),
        [
            ((2.0, 2.1, 2.0), (2.0, 3.0, 5.0), ["Time grows with ε; iterations of the pose"]),
            ((5.6, 7.3, 4.8), (2.0, 3.0, 5.0), ["Time grows with ε."]),
            ((5.6, 7.3, 4.8), (2.4, 1.9, 3.4), []),
        ],
    )
    def test_times_are_said_to_grow_where_they_do(self, by_rho, by_epsilon, told):
        notes = face_it.time_notes(np.array(by_rho), np.array(by_epsilon))
        assert [note[: len(words)] for note, words in zip(notes, told, strict=True)] == told


def test_a_frame_of_the_clip_is_solved_once_under_each_configuration(monkeypatch):
    """Unless it is seen in another picture."""
    asked = []

    class Fitter:
        def __init__(self, head, plan):
            self.name = plan.deep.energy

        def appearance(self, observations, identity):
            return None

        def problem(self, observation, context):
            return observation

        def solve(self, observation):
            asked.append((self.name, observation))
            return (self.name, observation)

    seen = lambda frame: frame  # noqa: E731
    monkeypatch.setattr(clip_solves, "DeepFitter", Fitter)
    monkeypatch.setattr(clip_solves, "observed", seen)
    solver, study, name = clip_solves.ClipSolver(), Study("nowhere"), preset("deep").deep.energy
    first = solver.solve(preset("deep"), (60, 140), study, "", seen)
    again = solver.solve(preset("deep"), (140, 200), study, "", seen)
    assert asked == [(name, 60), (name, 140), (name, 200)]
    assert again.solutions[140] is first.solutions[140]
    assert solver.solve(preset("deep-points"), (140,), study, "", seen).solutions == {140: ("points", 140)}
    assert solver.solve(preset("deep"), (140,), study, "", lambda frame: -frame).solutions == {140: (name, -140)}
    assert solver.solve(preset("deep"), (140,), study, "", seen).solutions == {140: (name, 140)}
