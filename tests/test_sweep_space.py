"""The language of a sweep's space, the points in it, and the configurations that they are."""

import itertools

import numpy as np
import pytest

from workbench.config import preset
from workbench.errors import ConfigError
from workbench.sweeps import Sampling, config_at, points_of, read_axis, read_sampling
from workbench.sweeps.acting import check_axis
from workbench.sweeps.clips import chosen_windows, parts_of

JOINT = preset("joint")


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("weights.tau=log(1e-3,10,5)", (1e-3, 1e-2, 0.1, 1.0, 10.0)),
        ("camera.fov_deg = lin(20, 60, 3)", (20.0, 40.0, 60.0)),
        ("stages.0.limit=1..4", (1, 2, 3, 4)),
        ("stages.0.limit=1..10..4", (1, 5, 9)),
        ("solver.bounded=true,false", (True, False)),
        ("solver.tolerance=1e-4, 1e-6", (1e-4, 1e-6)),
        ("preset=joint, face-it", ("joint", "face-it")),
        ("stages.0.landmarks=[{robust=1.0}, {all=1.0, jaw=0.1}]", ({"robust": 1.0}, {"all": 1.0, "jaw": 0.1})),
    ],
)
def test_ranges_are_read_as_they_are_written(text, values):
    found = read_axis(text).values
    if isinstance(values[0], float):
        np.testing.assert_allclose(found, values)
    else:
        assert found == values


@pytest.mark.parametrize(
    "text",
    [
        "weights.tau=log(10,1e-3,13)",
        "weights.tau=log(1e-3,10,1)",
        "weights.tau=log(0,10,3)",
        "weights.tau=lin(5,5,3)",
        "weights.tau=lin(a,5,3)",
        "weights.tau=lin(1,nan,3)",
        "weights.tau=log(1,2,inf)",
        "weights.tau=lin(1,2,3.7)",
        "weights.tau=lin(1,2,3,4)",
        "stages.0.limit=9..1",
        "stages.0.limit=1..9..0",
        "weights.tau=0.5..3/6",
        "weights.tau=",
        "weights.tau",
        "weights.tau=[]",
        "weights.tau=[1, 2",
        "weights.tau=,",
    ],
)
def test_an_empty_or_broken_range_is_one_sentence(text):
    with pytest.raises(ConfigError, match=r"tau|limit") as caught:
        read_axis(text)
    assert "\n" not in str(caught.value)


def test_a_grid_has_all_combinations_in_an_order_that_stays():
    points = points_of([read_axis("weights.tau=1.0,2.0"), read_axis("stages.0.limit=3..5")])
    assert [point.number for point in points] == list(range(6))
    assert [tuple(value for _, value in point.values) for point in points] == [
        (1.0, 3), (1.0, 4), (1.0, 5), (2.0, 3), (2.0, 4), (2.0, 5)
    ]  # fmt: skip
    assert str(points[1]) == "weights.tau = 1, stages.0.limit = 4"
    assert len(points_of([])) == 1


def test_sobol_points_are_balanced_and_repeat_with_their_seed():
    spaces = ("weights.tau=log(1e-3,1e3)", "camera.fov_deg=lin(20,60)", "stages.0.limit=1..4")
    axes = [read_axis(space) for space in spaces]
    points = points_of(axes, Sampling("sobol", 16, 3))
    tau, fov, limit = (np.array(column) for column in zip(*([v for _, v in p.values] for p in points), strict=True))
    # Of 16 points, each sixteenth of an axis of numbers has one.
    assert sorted(np.floor((np.log10(tau) + 3) / 6 * 16)) == list(range(16))
    assert sorted(np.floor((fov - 20) / 40 * 16)) == list(range(16))
    assert np.bincount(limit)[1:].tolist() == [4, 4, 4, 4]
    assert points == points_of(axes, Sampling("sobol", 16, 3))
    assert points != points_of(axes, Sampling("sobol", 16, 4))
    assert len(points_of(axes, Sampling("random", 5))) == 5


def test_a_grid_needs_counts_and_a_setting_comes_once():
    with pytest.raises(ConfigError, match=r"log\(FIRST,LAST,COUNT\); or choose points by --sample"):
        points_of([read_axis("weights.tau=log(1e-3,10)")])
    with pytest.raises(ConfigError, match="swept twice"):
        points_of([read_axis("weights.tau=1,2"), read_axis("weights.tau=3")])
    with pytest.raises(ConfigError, match="1000000 points"):
        points_of([read_axis(f"weights.{name}=lin(0,1,100)") for name in ("tau", "beta", "sigma")])
    for text in ("sobol", "sobol:0", "halton:3", "random:x"):
        with pytest.raises(ConfigError, match="sobol:64"):
            read_sampling(text)


def at(text, base=JOINT):
    return config_at(base, points_of([read_axis(text)])[-1])


def test_every_kind_of_setting_can_be_swept():
    assert at("weights.tau=0.5").weights.tau == 0.5
    assert at("stages.pose and expression.limit=7").stages[1].limit == 7
    assert at("stages.1.enabled=false,true").stages[1].enabled
    assert at("stages.pose and expression.landmarks.jaw=0.3").stages[1].landmarks == {"all": 1.0, "jaw": 0.3}
    assert at("stages.0.landmarks=[{all=1.0}]").stages[0].landmarks == {"all": 1.0}
    assert at("landmarks.weights.mouth=2.0").landmarks.weights == {"mouth": 2.0}
    assert at("subsets.tip=[[30]]").subsets == {"tip": (30,)}
    assert at("schedule=face-it").stages == preset("face-it").stages


def test_a_swept_weight_of_landmarks_is_not_covered_by_a_later_entry():
    base = JOINT.changed(landmarks={"weights": {"mouth": 2.0, "all": 0.5}})
    weights = at("landmarks.weights.mouth=4.0", base).point_weights()
    assert weights[60] == 4.0
    assert weights[0] == 0.5


def test_a_preset_is_taken_with_the_clips_camera():
    landmarks = {"face": (3.0, 4.0), "face_landmarker": "face_landmarker.task"}
    base = JOINT.changed(camera={"fov_deg": 33.0}, landmarks=landmarks, head={"character": "amara"})
    found = at("preset=face-it", base)
    assert found.weights == preset("face-it").weights
    assert not found.landmarks.confidence
    assert found.landmarks.face == (3.0, 4.0)
    assert found.landmarks.face_landmarker == "face_landmarker.task"
    assert found.head == base.head
    assert found.camera.fov_deg == 33.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("weights.tua=1.0", "did you mean 'tau'"),
        ("wieghts.tau=1.0", "no section 'wieghts'"),
        ("weights.tau=-1.0", "weights.tau"),
        ("weights.tau=word", "weights.tau"),
        ("stages.poze.limit=3", "there is no stage 'poze'; the stages are 'initial pose', 'pose and expression'"),
        ("stages.0=3", "write stages.NAME.limit"),
        ("stages.0.limit=501", "limit"),
        ("preset=fast", "no preset 'fast'"),
        ("landmarks.weights.muoth=1.0", "muoth"),
    ],
)
def test_an_unknown_setting_or_a_value_out_of_range_is_one_sentence(text, said):
    with pytest.raises(ConfigError, match="(?i)" + said.replace(".", r"\.")):
        at(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("landmarks.detector=dlib,network", "landmarks are found once per clip, before all fits; start from another"),
        ("landmarks.face_landmarker=a.task,b.task", "landmarks are found once per clip"),
        ("landmarks=[{confidence=true}, {detector='dlib'}]", "'landmarks.detector' cannot be varied"),
        ("deep.edges=1,2", "'deep.edges' has no effect here: fits to landmarks do not read 'deep'; leave it out."),
        ("flow.side=64,128", "do not read 'flow'"),
        ("infill.method=none,flow", "do not read 'infill'"),
        ("refinement.sweeps=1..3", "do not read 'refinement'"),
        (
            "preset=joint,dense",
            "'dense' takes the landmarks of 'dense', .* here by 'auto'; start from it with --preset dense",
        ),
        ("camera.fov_deg=30,40", "no effect with a camera's matrix"),
    ],
)
def test_a_setting_without_effect_is_said(text, said):
    base = JOINT.changed(camera={"matrix": [[900, 0, 9], [0, 900, 9], [0, 0, 1]]})
    with pytest.raises(ConfigError, match=said):
        check_axis(read_axis(text), base)


def test_presets_and_parts_of_the_landmarks_that_act_are_not_refused():
    for text in ("preset=joint,face-it", "landmarks=[{weights={mouth=2.0}}]", "landmarks.confidence=true,false"):
        check_axis(read_axis(text), JOINT)
    check_axis(read_axis("preset=joint,dense"), preset("dense"))


def test_a_budget_picks_runs_spread_over_the_clip_inside_shots():
    shots = (range(0, 300), range(300, 345))
    windows = chosen_windows(shots, 60)
    assert sum(map(len, windows)) == 60
    assert len(windows) == 3
    assert all(any(w.start >= s.start and w.stop <= s.stop for s in shots) for w in windows)
    assert windows[0].start < 100 < windows[1].start < 230 < windows[2].start
    assert chosen_windows(shots, None) == shots == chosen_windows(shots, 345)
    assert sum(map(len, chosen_windows(shots, 7))) == 7
    stills = tuple(range(k, k + 1) for k in range(50))
    assert [window.start for window in chosen_windows(stills, 5)] == [5, 15, 25, 35, 45]
    with pytest.raises(ConfigError, match="at least one frame"):
        chosen_windows(shots, 0)


@pytest.mark.parametrize(
    ("lengths", "budget"),
    [([15] * 60 + [20], 200), ([30] * 10, 250), ([219], 210), ([3, 9], 11), ([1] * 30 + [40], 50)],
)
def test_a_budget_is_reached_with_short_pieces_where_whole_ones_do_not_suffice(lengths, budget):
    ends = np.cumsum([0, *lengths])
    shots = [range(*pair) for pair in itertools.pairwise(ends.tolist())]
    windows = chosen_windows(shots, budget)
    frames = [frame for window in windows for frame in window]
    assert len(frames) == budget
    assert frames == sorted(set(frames))
    assert all(any(w.start >= s.start and w.stop <= s.stop for s in shots) for w in windows)


def test_parts_are_small_and_never_cut_a_run():
    windows = [range(0, 600), *(range(600 + 20 * k, 620 + 20 * k) for k in range(40))]
    parts = parts_of(windows)
    assert [window for part in parts for window in part] == windows
    assert [len(part) for part in parts] == [1, 12, 12, 12, 4]
