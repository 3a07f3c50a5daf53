"""Sweeps: the tracker's numbers many at once, each result stored once, and what goes wrong told in a sentence."""

import csv
import json
import os
import re
import shutil
import weakref
from dataclasses import replace

import numpy as np
import pytest
from matplotlib import image

from tests.landmark_layouts import dlib_box, dlib_xml
from tests.short_clips import observations, write_clip
from tests.small_disk import small_disk
from tests.stereo_scenes import make_rig
from workbench.config import preset, read_config
from workbench.errors import ConfigError, InputError, OutputError
from workbench.frames import FrameRange, open_frames, write_picture
from workbench.geometry import write_rig
from workbench.landmarks import detectors
from workbench.landmarks.files import LandmarkRecord, read_landmark_file, write_landmark_file
from workbench.objectives import WeightedSum, drawn_means, folds_of
from workbench.samples import sample
from workbench.session import Material, TuningSession, sweeping
from workbench.session.material import PictureStore, load_material
from workbench.sweeps import (
    ClipSolver,
    ClipSource,
    Sampling,
    Sweep,
    SweepResult,
    SweptClip,
    chosen_windows,
    curves_figure,
    least,
    maps_figure,
    nearest,
    outcome,
    points_of,
    read_axis,
    run_sweep,
    solving,
    sources_of,
    storage,
    stored_clips,
    tasks,
    write_figures,
    write_outcome,
)
from workbench.sweeps import sweep as sweep_module
from workbench.sweeps.results import result_key
from workbench.sweeps.storage import Storage
from workbench.sweeps.stored_clips import digest_of
from workbench.sweeps.tasks import FitTask, ModelSource, ObserveTask, model_source, solver_of
from workbench.tracking.records import frame_errors
from workbench.workers import Failed, ThisProcess

FOV = {"camera": {"fov_deg": 33.0}}
FACE_IT = preset("face-it").changed(**FOV)
TAU = "weights.tau=log(1e-2,10,4)"
NAMES = ("rotation", "translation", "expression", "projected", "iterations")


@pytest.fixture(scope="module")
def solver(head):
    return ClipSolver(head)


def swept(frames, gaps=(), cuts=()):
    return SweptClip("clip", f"{frames}{gaps}{cuts}", tuple(observations(frames, gaps, cuts)), False)


def test_the_order_of_landmark_weights_is_part_of_a_results_key():
    """Later entries overrule earlier ones."""
    first, second = (
        preset("joint").changed(landmarks={"weights": weights})
        for weights in ({"mouth": 2.0, "all": 1.0}, {"all": 1.0, "mouth": 2.0})
    )
    keys = {result_key(config, "clip", [range(3)], ["error"], "head") for config in (first, second)}
    assert len(keys) == 2


@pytest.mark.parametrize("name", ["joint", "face-it", "calibrated"])
def test_fits_are_those_of_the_tracker_to_the_last_bit(solver, head, name, monkeypatch):
    monkeypatch.setattr(solving, "FRAMES", 32)
    # A gap, a cut, a jump to another pose, and more frames than a block.
    clip = swept([*range(20), *range(100, 122)], gaps=(5, 6), cuts=(12,))
    assert len(clip.observations) > solving.FRAMES
    config = preset(name).changed(**FOV)
    sizes = [observation.image_size for observation in clip.observations]
    session = TuningSession(head, Material("clip", clip.observations, PictureStore(None, sizes), False), config)
    track = session.track
    (fits,) = solver.fits([config], clip, clip.shots)
    for part in NAMES[:4]:
        np.testing.assert_array_equal(getattr(fits, part), getattr(track, part))
    np.testing.assert_array_equal(fits.iterations[track.found], track.iterations[track.found].sum(1))
    assert np.isnan(fits.iterations[[5, 6]]).all()


def test_pictures_of_two_sizes_are_fitted_with_a_camera_each_as_the_tracker_does(solver, head):
    frames = observations(range(12))
    clip = replace(swept(()), observations=(*frames[:6], *map(enlarged, frames[6:])), digest="two sizes")
    track = session_of(head, clip.observations).track
    (fits,) = solver.fits([FACE_IT], clip, clip.shots)
    for part in NAMES[:4]:
        np.testing.assert_array_equal(getattr(fits, part), getattr(track, part))


def enlarged(frame):
    size = tuple(2 * side for side in frame.image_size)
    return replace(
        frame, image_size=size, landmarks=replace(frame.landmarks, points=2 * frame.landmarks.points, image_size=size)
    )


def test_fits_do_not_depend_on_what_else_is_solved_with_them(solver):
    clip = swept(range(0, 60, 2))
    configs = [FACE_IT.changed(weights={"tau": float(tau)}) for tau in np.geomspace(1e-3, 10, 21)]
    together = solver.fits(configs, clip, clip.shots)
    for number in (0, 7, 20):
        (alone,) = solver.fits([configs[number]], clip, clip.shots)
        for part in NAMES:
            np.testing.assert_array_equal(getattr(alone, part), getattr(together[number], part))
    assert np.abs(together[0].rotation - together[20].rotation).max() > 1e-4


def test_a_run_inside_a_shot_starts_afresh_with_the_shots_identity(solver):
    clip = swept(range(30))
    config = preset("joint").changed(**FOV)
    (whole,) = solver.fits([config], clip, clip.shots)
    (part,) = solver.fits([config], clip, [range(10, 20)])
    assert len(part.rotation) == 10
    np.testing.assert_allclose(part.projected, whole.projected[10:20], atol=2.0)


@pytest.mark.parametrize("name", ["joint", "face-it"])
def test_what_a_fold_hides_has_no_effect_on_its_fits(solver, name):
    clip = swept(range(9))
    hidden = folds_of(("points",), 9)[1:]
    moved = []
    for observation in clip.observations:
        points = observation.landmarks.points + np.where(hidden[0, 0], 0.8, 0.0)[:, None]
        face = type(observation.landmarks)(points, observation.landmarks.confidence, observation.image_size)
        moved.append(type(observation)(observation.index, face, observation.image_size))
    other = SweptClip("clip", "moved", tuple(moved), False)
    config = preset(name).changed(**FOV)
    (before,), (after,) = (solver.fits([config], each, each.shots, ("points",)) for each in (clip, other))
    np.testing.assert_array_equal(before.folds["points"][0], after.folds["points"][0])
    assert np.abs(before.folds["points"][1] - after.folds["points"][1]).max() > 0.01


def test_hidden_frames_are_not_seen_either(solver):
    clip = swept(range(9))
    (fits,) = solver.fits([FACE_IT], clip, clip.shots, ("points", "frames"))
    assert fits.folds["points"].shape == (5, 9, 68, 2)
    assert fits.folds["frames"].shape == (3, 9, 68, 2)
    # A hidden frame keeps the pose of the one before, which its neighbour's prediction does not look at.
    assert np.isfinite(fits.folds["frames"]).all()


def plan(*clips, axes=(TAU,), objectives=("error", "jitter"), base=FACE_IT, **more):
    return Sweep(
        sources_of([str(clip) for clip in clips]), tuple(map(read_axis, axes)), base, objectives=objectives, **more
    )


class Counting(ThisProcess):
    """This process, with the fits that were made."""

    def __init__(self):
        self.fits = 0

    def results(self, tasks, **how):
        for number, result in super().results(tasks, **how):
            if isinstance(tasks[number], FitTask) and isinstance(result, int):
                self.fits += result
            yield number, result


def do(sweep, folder, **options):
    workers = Counting()
    return run_sweep(sweep, folder, workers, **options), workers.fits


def same(one, other):
    assert one.values.keys() == other.values.keys()
    for key, values in one.values.items():
        np.testing.assert_array_equal(values, other.values[key])


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    folder = tmp_path_factory.mktemp("clips")
    return [write_clip(folder / f"{name}.csv", range(first, first + 12)) for name, first in (("one", 0), ("two", 60))]


@pytest.fixture(scope="module")
def done(clips, tmp_path_factory):
    """A finished sweep over two clips, and its folder."""
    folder = tmp_path_factory.mktemp("sweep")
    return do(plan(*clips), folder)[0], folder


def test_a_sweep_has_a_number_a_frame_for_every_point_and_clip(done):
    result, _ = done
    assert result.clips == ("one", "two")
    assert set(result.values) == {(number, clip) for number in range(4) for clip in ("one", "two")}
    assert all(values.shape == (2, 12) for values in result.values.values())
    assert result.means("jitter")[3] < result.means("jitter")[0]
    assert result.best("jitter") == int(np.argmin(result.means("jitter")))
    assert result.steadiest() is not None
    assert result.best("error") in result.pareto()


def test_a_choice_is_as_sure_as_the_frames_agree():
    """Two clips of 100 frames, four values: one is always best by `error`; by `jitter` two are, by turns."""
    axis = read_axis("weights.tau=1,2,4,8")
    points = points_of((axis,), Sampling())
    turns = np.arange(100) // 10 % 2
    rows = {0: (3.0, 5.0), 1: (1.0, turns), 2: (1.04, 1.0 - turns), 3: (2.0, 5.0)}
    values = {
        (k, clip): np.stack([np.broadcast_to(each, 100).astype(float) for each in row])
        for k, row in rows.items()
        for clip in "ab"
    }
    found = SweepResult(preset("joint"), (axis,), points, ("error", "jitter"), values)
    assert found.interval(axis, least("error")) == (2.0, 2.0)
    assert found.interval(axis, least("jitter")) == (2.0, 4.0)
    # Within 5 % of the least, and nearest to 8.
    from_eight = np.abs(np.log([1 / 8, 2 / 8, 4 / 8, 1.0]))
    rule = nearest(from_eight, "error")
    assert rule({name: found.means(name) for name in found.objectives}) == 2
    assert found.interval(axis, rule) == (4.0, 4.0)
    assert found.interval(read_axis("preset=joint,face-it"), least("error")) is None


def made_up(values, objectives=("error",), failures=None, axis="weights.tau=1,2"):
    axes = (read_axis(axis),)
    rows = {place: np.atleast_2d(np.asarray(row, float)) for place, row in values.items()}
    return SweepResult(preset("joint"), axes, points_of(axes), objectives, rows, failures or {})


def test_a_point_without_the_hard_clip_does_not_win():
    found = made_up({(0, "easy"): np.ones(5), (1, "easy"): np.full(5, 2.0), (1, "hard"): np.full(5, 9.0)})
    assert np.isnan(found.means("error")).tolist() == [True, False]
    assert np.isnan(found.bands("error")[0]).all()
    assert found.best("error") == 1


class Losing(Counting):
    """The first fits of a clip are lost."""

    def __init__(self, clip):
        super().__init__()
        self.clip = clip

    def results(self, tasks, **how):
        of_clip = [k for k, task in enumerate(tasks) if isinstance(task, FitTask) and task.name == self.clip]
        kept = [k for k in range(len(tasks)) if k not in of_clip[:1]]
        yield from ((k, Failed("It died.")) for k in of_clip[:1])
        for number, result in super().results([tasks[k] for k in kept], **how):
            yield kept[number], result


def test_the_failure_of_a_clip_says_how_many_points_are_without_it(clips, tmp_path, monkeypatch):
    monkeypatch.setattr(sweep_module, "FITS", 12)
    wanted = plan(*clips, axes=["weights.tau=1,2"], objectives=("error",))
    result = run_sweep(wanted, tmp_path / "s", Losing("two"))
    assert result.failures == {"two": "It died. 1 of 2 points are without this clip, and are compared with no other."}
    assert np.isnan(result.means("error")).tolist() == [True, False]


def test_what_was_not_measured_is_said():
    found = made_up({(0, "a"): np.ones(5), (1, "a"): np.ones(5)})
    with pytest.raises(InputError, match="did not measure 'jitter'; it has error"):
        found.best(WeightedSum({"error": 1.0, "jitter": 0.5}))


def test_an_objective_that_is_named_twice_counts_once(clips):
    assert plan(clips[0], objectives=("error", "jitter", "error")).objectives == ("error", "jitter")


def test_frames_are_drawn_once_however_many_choices_are_judged(monkeypatch):
    drawn = []
    monkeypatch.setattr(outcome, "drawn_means", lambda *given, **how: drawn.append(1) or drawn_means(*given, **how))
    found = made_up({(k, "a"): np.arange(10.0) + k for k in range(2)})
    for _ in range(3):
        assert found.interval(found.axes[0], least("error")) == (1.0, 1.0)
    assert len(drawn) == 1


def test_a_map_of_samples_is_refused():
    axes = (read_axis("weights.tau=log(1,2)"), read_axis("weights.range=log(1,2)"))
    points = points_of(axes, Sampling("random", 4))
    found = SweepResult(preset("joint"), axes, points, ("error",), {(k, "a"): np.ones((1, 4)) for k in range(4)})
    with pytest.raises(InputError, match=r"those of 'weights\.tau' are samples; draw curves"):
        maps_figure(found)


@pytest.mark.filterwarnings("error")
def test_a_photo_has_figures_of_what_it_has_values_of(clips, tmp_path):
    photo = write_clip(tmp_path / "photo.csv", [40])
    result, _ = do(plan(photo, axes=["weights.tau=0.01,1.0", "weights.range=0.1,1"]), tmp_path / "s")
    assert np.isnan(result.means("jitter")).all()
    assert set(write_figures(result, tmp_path)) == {
        "curve-weights.tau.png", "curve-weights.range.png", "map.png", "parallel.png"
    }  # fmt: skip
    nothing = replace(result, values={place: np.full_like(rows, np.nan) for place, rows in result.values.items()})
    assert write_figures(nothing, tmp_path) == ()


def test_a_sweep_that_never_began_leaves_its_folder_free(clips, tmp_path):
    with pytest.raises(InputError, match="None of the clips can be used"):
        do(plan(tmp_path / "misspelt.csv"), tmp_path / "s")
    assert do(plan(clips[0], axes=["weights.tau=1"]), tmp_path / "s")[1] == 12


def test_landmarks_belong_to_the_detector_that_runs(head, monkeypatch):
    """A sweep resumed by a workbench whose "auto" is another detector finds them anew."""
    pictures, file = (str(sample(name)) for name in ("performance", "performance-landmarks"))

    def digests(runs, detector="auto"):
        monkeypatch.setattr(detectors, "RECOMMENDED", runs)
        config = FACE_IT.changed(landmarks={"detector": detector})
        return [digest_of(source, config, head) for source in (ClipSource(pictures), ClipSource(pictures, file))]

    detected, given = digests("network")
    assert digests("dlib+network")[0] != detected
    assert digests("dlib+network")[1] == given
    assert detected == digests("network", "network")[0]


def test_landmarks_belong_to_the_file_that_found_them(head, clips, tmp_path):
    (source,) = sources_of([str(clips[0])])
    file, digests = tmp_path / "face_landmarker.task", set()
    config = preset("joint").changed(landmarks={"detector": "mediapipe", "face_landmarker": str(file)})
    for content in (None, "one", "other"):
        if content:
            file.write_text(content)
        digests.add(digest_of(source, config, head))
    assert len(digests) == 3


def test_what_names_pictures_belongs_to_their_names(head, tmp_path):
    (photos := tmp_path / "photos").mkdir()
    for name in "ab":
        write_picture(photos / f"{name}.png", np.zeros((480, 640, 3), np.uint8))
    face = dlib_box(observations([0])[0].landmarks.points)
    named, counted = tmp_path / "labels.xml", write_clip(tmp_path / "points.csv", range(2))
    named.write_text(dlib_xml([("file='b.png' width='640' height='480'", [face])]))
    sources = [ClipSource(str(photos), str(counted), str(named)), ClipSource(str(photos), str(named))]
    sources += [ClipSource(str(photos), str(counted)), ClipSource(str(photos))]
    before = [digest_of(source, FACE_IT, head) for source in sources]
    (photos / "b.png").rename(photos / "c.png")
    (photos / "a.png").rename(photos / "b.png")
    after = [digest_of(source, FACE_IT, head) for source in sources]
    assert [one == other for one, other in zip(before, after, strict=True)] == [False, False, True, True]


def test_labels_are_compared_with_the_photos_that_they_name(head, tmp_path):
    faces = dict(zip("abc", (frame.landmarks.points for frame in observations([0, 40, 90])), strict=True))

    def labelled(names):
        path = tmp_path / f"{names}.xml"
        size = "width='640' height='480'"
        path.write_text(dlib_xml([(f"file='{name}.png' {size}", [dlib_box(faces[name])]) for name in names]))
        return str(path)

    photos = tmp_path / "photos"
    photos.mkdir()
    for name in faces:
        write_picture(photos / f"{name}.png", np.zeros((480, 640, 3), np.uint8))
    source = ClipSource(str(photos), landmarks=labelled("abc"), truth=labelled("ac"), stills=True)
    labels = stored_clips.observe(source, FACE_IT, head).truth.labels
    np.testing.assert_allclose(labels[[0, 2]], [faces["a"], faces["c"]], atol=1e-3)
    assert np.isnan(labels[1]).all()
    material = load_material(photos, FACE_IT, source.landmarks, stills=True)
    in_session = sweeping.SessionSweeps(head, material).clip(("labels",), source.truth)
    np.testing.assert_array_equal(in_session.truth.labels, labels)
    seen = tuple(replace(each, index=k) for k, each in enumerate(material.observations[1:]))
    pictures = PictureStore(FrameRange(open_frames(photos), 1, 2), [(640, 480)] * 2)
    last_two = sweeping.SessionSweeps(head, replace(material, observations=seen, pictures=pictures, part=(1, 2)))
    np.testing.assert_array_equal(last_two.clip(("labels",), source.truth).truth.labels, labels[1:])
    assert np.isnan(last_two.clip(("labels",), labelled("a")).truth.labels).all()


def test_a_face_model_that_changed_under_its_name_is_another_one(clips, tmp_path):
    path = tmp_path / "head.npz"
    with np.load(sample("head")) as stored:
        arrays = dict(stored)

    def errors(width):
        np.savez(path, **{**arrays, "neutral": arrays["neutral"] * np.array([width, 1.0, 1.0], np.float32)})
        return do(replace(plan(clips[0]), model=str(path)), tmp_path / "s", resume=True)[0].means("error")

    first, wider = errors(1.0), errors(1.3)
    assert (wider > 1.1 * first).all()
    np.testing.assert_array_equal(errors(1.0), first)


def test_a_worker_with_another_face_model_says_so():
    with pytest.raises(InputError, match=r"head\.npz is not the face model that the sweep started with"):
        solver_of(ModelSource(str(sample("head")), "the command's"))


def test_nothing_is_done_twice_and_points_can_be_added(done, clips, tmp_path):
    result, folder = done
    with pytest.raises(OutputError, match=r"holds a sweep; continue it with --resume \(.*name all values, old and new"):
        do(plan(*clips), folder)
    again, fits = do(plan(*clips), folder, resume=True)
    assert fits == 0
    same(result, again)
    more, fits = do(plan(*clips, axes=["weights.tau=log(1e-2,10,7)"]), folder, resume=True)
    assert fits == 3 * 2 * 12
    np.testing.assert_array_equal(more.values[2, "two"], result.values[1, "two"])


def test_a_torn_result_is_recognised_and_made_again(done, clips):
    result, folder = done
    more = plan(*clips, axes=["weights.tau=log(1e-2,10,7)"])
    do(more, folder, resume=True)
    files = sorted((folder / "results").rglob("*.npz"))
    whole = files[0].read_bytes()
    files[0].write_bytes(whole[: len(whole) // 2])
    files[1].write_bytes(b"")
    damaged = bytearray(files[2].read_bytes())
    damaged[-5] ^= 1
    files[2].write_bytes(damaged)
    clip = next((folder / "clips").glob("*.npz"))
    clip.write_bytes(clip.read_bytes()[:-9])
    _, fits = do(more, folder, resume=True)
    assert fits == 3 * 12
    same(result, do(plan(*clips), folder, resume=True)[0])
    assert files[0].read_bytes() == whole


def test_an_interrupted_sweep_goes_on_with_the_same_bits(done, clips, tmp_path, monkeypatch):
    monkeypatch.setattr(sweep_module, "FITS", 12)

    def stop(step, done, total):
        if step == "fits" and done >= 36:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        do(plan(*clips), tmp_path / "s", progress=stop)
    result, fits = do(plan(*clips), tmp_path / "s", resume=True)
    assert fits == 4 * 2 * 12 - 36
    same(done[0], result)


def test_a_sweep_is_the_same_by_url(done, clips, tmp_path):
    urls = plan(*[clip.as_uri() for clip in clips])
    result, _ = do(urls, (tmp_path / "s").as_uri())
    same(done[0], result)
    names = write_outcome(result, (tmp_path / "s").as_uri())
    assert {"table.csv", "best.toml"} <= set(names)
    assert all((tmp_path / "s" / name).stat().st_size for name in names)
    assert not list((tmp_path / "s").rglob("*partial*"))


def test_a_clip_without_faces_or_files_is_told_and_the_rest_goes_on(done, clips, tmp_path):
    empty = write_clip(tmp_path / "empty.csv", range(4), faceless=True)
    broken = tmp_path / "broken.csv"
    broken.write_text("frame,width\n0,nonsense\n")
    result, _ = do(plan(clips[0], empty, broken, tmp_path / "absent.mp4"), tmp_path / "s")
    assert result.clips == ("one",)
    assert set(result.failures) == {"empty", "broken", "absent"}
    assert (
        "empty.csv has no face in any frame: its points are missing, all at one place or without any confidence"
        in result.failures["empty"]
    )
    assert all("\n" not in reason for reason in result.failures.values())
    np.testing.assert_array_equal(result.values[0, "one"], done[0].values[0, "one"])
    with pytest.raises(InputError, match=r"None of the clips can be used: .*no face in any frame"):
        do(plan(empty), tmp_path / "t")


@pytest.fixture
def late(tmp_path):
    """A clip with a face in its last frame only."""
    path, frames = tmp_path / "late.csv", observations(range(12), gaps=range(11))
    write_landmark_file(path, [LandmarkRecord(each.index, "", each.landmarks, each.image_size) for each in frames])
    return path


def test_a_clip_in_whose_fitted_frames_nothing_has_a_value_is_told(clips, late, tmp_path):
    result, _ = do(plan(clips[0], late, frames=2), tmp_path / "s")
    assert result.clips == ("one",)
    assert "No objective has a value in the frames that were fitted" in result.failures["late"]
    with pytest.raises(InputError, match="None of the clips can be fitted: No objective has a value"):
        do(plan(late, frames=2), tmp_path / "t")


def test_a_sweep_that_found_no_value_leaves_its_folder_free(tmp_path):
    one_frame = write_clip(tmp_path / "single.csv", range(1))
    wrong, right = (plan(one_frame, axes=["weights.tau=0.1,1"], objectives=(name,)) for name in ("jitter", "error"))
    for folder in (tmp_path / "s", (tmp_path / "by-url").as_uri()):
        with pytest.raises(InputError, match="None of the clips can be fitted: No objective has a value"):
            do(wrong, folder)
        assert do(right, folder)[0].clips == ("single",)
    with pytest.raises(InputError, match="None of the clips can be fitted"):
        do(wrong, tmp_path / "s", resume=True)
    with pytest.raises(OutputError, match="holds a sweep"):
        do(right, tmp_path / "s")


def test_a_sweep_of_which_a_part_is_stored_can_be_gone_on_with(clips, tmp_path, monkeypatch):
    monkeypatch.setattr(sweep_module, "parts_of", lambda windows: ((range(4),), (range(4, 12),)))
    wanted = plan(clips[0], axes=["weights.tau=0.1"], objectives=("error",))
    with pytest.raises(InputError, match="None of the clips can be fitted: It died"):
        run_sweep(wanted, tmp_path / "s", Losing("one"))
    with pytest.raises(OutputError, match="holds a sweep"):
        do(wanted, tmp_path / "s")
    assert do(wanted, tmp_path / "s", resume=True)[1] == 4


def test_a_rig_that_is_not_there_is_told_before_any_landmark_is_found(clips, tmp_path):
    wanted = plan(clips[0], base=FACE_IT.changed(camera={"rig": str(tmp_path / "gone.toml")}))
    with pytest.raises(InputError, match=r"^The rig file .*gone\.toml does not exist"):
        do(wanted, tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_what_went_wrong_is_told_of_a_clip_without_values_too(clips, late, tmp_path, monkeypatch):
    monkeypatch.setattr(sweep_module, "FITS", 2)
    wanted = plan(clips[0], late, axes=["weights.tau=1,2"], objectives=("error",), frames=2)
    assert run_sweep(wanted, tmp_path / "s", Losing("late")).failures == {"late": "It died."}


def test_a_full_disk_ends_a_sweep_in_a_sentence_and_what_was_done_stays(done, clips, tmp_path):
    do(plan(clips[0], axes=["weights.tau=0.01,0.1"]), tmp_path / "s")
    with (
        small_disk(300),
        pytest.raises(OutputError, match=r"cannot be written .*--resume goes on from there") as caught,
    ):
        _full(plan(*clips), tmp_path / "s")
    assert "\n" not in str(caught.value)
    result, fits = do(plan(*clips), tmp_path / "s", resume=True)
    assert fits == 72
    same(done[0], result)


def _full(sweep, folder):
    # The definition is there already; it is the landmarks of the second clip that find no room.
    original = sweep_module._claim
    try:
        sweep_module._claim = lambda *given: None
        do(sweep, folder, resume=True)
    finally:
        sweep_module._claim = original


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"axes": ["weights.tua=1,2"]}, "did you mean 'tau'"),
        ({"axes": ["landmarks.detector=dlib,network"]}, "landmarks are found once"),
        ({"objectives": ("eror",)}, "no objective 'eror'"),
        ({"axes": ["preset=deep,joint"]}, "Deep Energies renders"),
        ({"frames": 0}, "at least one frame"),
    ],
)
def test_what_cannot_be_swept_is_told_before_anything_is_done(clips, tmp_path, changes, said):
    with pytest.raises(ConfigError, match=said):
        do(plan(*clips, **changes), tmp_path / "s")


def test_an_objective_that_a_clip_cannot_have_is_told(clips, tmp_path):
    with pytest.raises(InputError, match=r"needs the true rotation of the head \(--truth\)"):
        do(plan(clips[0], objectives=("error", "rotation")), tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_motion_that_is_asked_for_without_pictures_is_told_before_any_fit(clips, tmp_path):
    with pytest.raises(InputError, match=r"None of the clips can be used: .*needs the clip's pictures"):
        do(plan(clips[0], objectives=("error", "flow")), tmp_path / "s")
    do(plan(clips[0]), tmp_path / "s")  # the folder is still free


class Elsewhere(ThisProcess):
    """Workers that run in another folder."""

    def __init__(self, monkeypatch, folder):
        self._monkeypatch, self._folder = monkeypatch, folder

    def results(self, tasks, **how):
        self._monkeypatch.chdir(self._folder)
        yield from super().results(tasks, **how)


def test_clips_are_found_by_workers_in_another_folder(clips, tmp_path, monkeypatch):
    monkeypatch.chdir(clips[0].parent)
    wanted = plan(clips[0].name, axes=["weights.tau=1"], objectives=("error",))
    assert run_sweep(wanted, tmp_path / "s", Elsewhere(monkeypatch, tmp_path)).clips == ("one",)


def test_a_configurations_rig_is_found_by_workers_in_another_folder(clips, tmp_path, monkeypatch):
    write_rig(make_rig(), tmp_path / "here" / "rig.toml")
    monkeypatch.chdir(tmp_path / "here")
    wanted = plan(clips[0], axes=["weights.tau=1"], objectives=("error",))
    wanted = replace(wanted, base=wanted.base.changed(camera={"rig": "rig.toml"}))
    assert run_sweep(wanted, tmp_path / "s", Elsewhere(monkeypatch, tmp_path)).clips == ("one",)


def test_clips_of_one_name_are_numbered_past_those_that_are_called_so():
    names = plan("x/talk.mp4", "y/talk.mp4", "talk-1.mp4", "z/walk.mp4").names
    assert names == ("talk-2", "talk-3", "talk-1", "walk")


def test_points_moved_by_hand_are_what_is_measured(head):
    session = session_of(head, observations(range(4)))
    point = session.observation(2).landmarks.points[30] + 40.0
    session.move(2, 30, tuple(point))
    found = session.sweep("weights.tau=1", objectives=("error",), frames=None)
    fits = session.fit_clip(config=found.config(0))
    np.testing.assert_allclose(found.frames("error", 0), frame_errors(fits)[:, 3], atol=1e-6)


def test_no_more_than_three_pictures_are_held_where_their_motion_is_measured(head, monkeypatch):
    alive = weakref.WeakSet()

    class Opened:
        single_picture = False

        def observations(self, first, kept, stills):
            for frame in observations(range(5)):
                picture = np.zeros((*frame.image_size[::-1], 3), np.uint8).view(Picture)
                alive.add(picture)
                assert len(alive) <= 3
                yield replace(frame, picture=picture)
                del picture

    class Picture(np.ndarray):
        __hash__ = object.__hash__

    monkeypatch.setattr(stored_clips, "open_source", lambda *given, **how: Opened())
    clip = stored_clips.observe(stored_clips.ClipSource("clip", flow=True), FACE_IT, head)
    assert clip.flow.shape == (5, 68, 2)
    assert np.isnan(clip.flow[0]).all()


def test_a_choice_that_was_not_made_and_a_curve_of_nothing_are_told():
    found = made_up({(0, "a"): np.ones(5)})
    with pytest.raises(InputError, match="No point of the sweep was chosen"):
        found.config(found.steadiest())
    with pytest.raises(InputError, match="A curve takes a setting"):
        curves_figure(replace(found, axes=()))


def test_figures_of_other_settings_do_not_stay_beside_a_new_table(clips, done, tmp_path):
    result, _ = done
    earlier = ("curve-weights.range.png", "map.png", "mine.png")
    for folder, before in ((tmp_path / "mine", earlier), (tmp_path / "sweep", (*earlier, "table.csv"))):
        folder.mkdir()
        for name in before:
            (folder / name).write_bytes(b"")
    # In a folder without an earlier sweep they are somebody else's.
    names = write_outcome(result, tmp_path / "mine")
    assert {path.name for path in (tmp_path / "mine").iterdir()} == {*names, *earlier}
    write_outcome(result, tmp_path / "sweep")
    assert {path.name for path in (tmp_path / "sweep").iterdir()} == {*names, "mine.png"}


def test_the_best_of_other_settings_does_not_stay_beside_a_table_without_a_best(done, tmp_path):
    result, _ = done
    assert "best.toml" in write_outcome(result, tmp_path)
    nothing = replace(result, values={place: np.full_like(rows, np.nan) for place, rows in result.values.items()})
    write_outcome(nothing, tmp_path)
    assert not (tmp_path / "best.toml").exists()


def test_the_tables_hold_settings_means_and_quartiles(done, tmp_path):
    from pyarrow import parquet

    result, _ = done
    names = write_outcome(result, tmp_path)
    with (tmp_path / "table.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 8
    first = result.values[0, "one"][0]
    assert float(rows[0]["error"]) == pytest.approx(first.mean())
    assert float(rows[0]["error_p75"]) == pytest.approx(np.percentile(first, 75))
    assert [row["weights.tau"] for row in rows[::2]] == ["0.01", "0.1", "1", "10"]
    table = parquet.read_table(tmp_path / "table.parquet").to_pydict()
    assert table["clip"] == ["one", "two"] * 4
    assert table["error"] == pytest.approx([float(row["error"]) for row in rows])
    best = read_config(tmp_path / "best.toml")
    assert best.weights.tau == result.config(result.best("error")).weights.tau
    assert best.provenance.after["error"] == pytest.approx(result.means("error").min())
    for name in names:
        if name.endswith(".png"):
            assert image.imread(tmp_path / name).shape[1] == 800


def test_figures_of_two_settings_words_and_samples(clips, tmp_path):
    axes, objectives = ["weights.tau=0.01,1.0", "solver.bounded=true,false"], ("error", "jitter", "iterations")
    two = plan(clips[0], axes=axes, objectives=objectives)
    result, _ = do(two, tmp_path / "s")
    assert set(write_outcome(result, tmp_path / "s")) >= {
        "map.png", "parallel.png", "pareto.png", "curve-weights.tau.png", "curve-solver.bounded.png"
    }  # fmt: skip
    from workbench.sweeps import Sampling

    result, _ = do(plan(clips[0], axes=["weights.tau=log(0.01,1)", "weights.range=log(0.1,10)"],
                         sampling=Sampling("sobol", 4)), tmp_path / "t")  # fmt: skip
    assert "map.png" not in write_outcome(result, tmp_path / "t")


def test_mixed_values_go_into_parquet_as_text(clips, tmp_path):
    from pyarrow import parquet

    result, _ = do(plan(clips[0], axes=["landmarks.weights=[{}, {mouth=2.0}]"]), tmp_path / "s")
    write_outcome(result, tmp_path / "s")
    assert parquet.read_table(tmp_path / "s" / "table.parquet").to_pydict()["landmarks.weights"] == [
        "{}",
        "{'mouth': 2.0}",
    ]


def test_what_a_url_names_is_fetched_again_once_it_has_changed(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "cache_folder", lambda: tmp_path / "cache")
    file = tmp_path / "points.csv"

    def fetched(text, changed_s):
        file.write_text(text)
        os.utime(file, (changed_s, changed_s))
        return storage.local_file(f"file://{file}")

    copy = fetched("1.0", 10)
    first = copy.stat().st_ino
    assert (copy.read_text(), fetched("2.0", 20).read_text()) == ("1.0", "2.0")
    second = copy.stat().st_ino
    assert storage.local_file(f"file://{file}").stat().st_ino == second != first


def test_a_clip_by_url_that_changes_while_it_is_read_is_not_stored_under_the_digest_of_the_earlier_one(
    tmp_path, clips, monkeypatch
):
    monkeypatch.setattr(storage, "cache_folder", lambda: tmp_path / "cache")
    file = tmp_path / "points.csv"
    shutil.copy(clips[0], file)

    def changed_meanwhile(*given):
        digest = digest_of(*given)
        shutil.copy(clips[1], file)
        return digest

    monkeypatch.setattr(tasks, "digest_of", changed_meanwhile)
    task = ObserveTask(ClipSource(f"file://{file}"), FACE_IT.model_dump_json(), str(tmp_path), model_source(""))
    stored = stored_clips.stored_clip(Storage(str(tmp_path)), task.run().digest, "points")
    earlier = next(read_landmark_file(clips[0])).landmarks
    np.testing.assert_array_equal(stored.observations[0].landmarks.points, earlier.points)


def test_what_a_server_does_not_date_is_fetched_each_time(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "cache_folder", lambda: tmp_path / "cache")
    (file := tmp_path / "points.csv").write_text("1.0")
    undated, dated, later = ({"size": 3, **told} for told in ({}, {"ETag": "a"}, {"ETag": "b"}))
    assert storage._version_of(undated) == ""
    assert storage._version_of(dated) != storage._version_of(later)
    monkeypatch.setattr(storage, "_version_of", lambda info: "")
    first, second = (storage.local_file(f"file://{file}").stat().st_ino for _ in range(2))
    assert first != second


def test_storage_reads_only_what_was_written_whole(tmp_path):
    storage = Storage(str(tmp_path))
    storage.write("a/b", b"content")
    assert storage.read("a/b") == b"content"
    assert storage.read("a/c") is None
    (tmp_path / "a" / "b").write_bytes(b"content")
    assert storage.read("a/b") is None
    with pytest.raises(OutputError, match="check the address"):
        Storage("nonsense://x").write("a", b"")


class TestTheCommand:
    def test_it_measures_prints_the_best_and_writes(self, run, clips, tmp_path):
        measured = ["--objective", "error", "--objective", "jitter", "--best", "error + 2*jitter"]
        where = ["--set", TAU, "--out", str(tmp_path / "s")]
        code, out, err = run("sweep", str(clips[0]), "--preset", "face-it", *measured, *where)
        assert (code, err) == (0, "")
        assert "error + 2*jitter" in out
        assert "jitter at equal error" in out
        # More smoothing is steadier in whichever frames are drawn.
        assert "weights.tau = 10 (10 to 10)" in out
        assert "table.csv" in out
        assert json.loads(Storage(str(tmp_path / "s")).read("sweep.json"))["objectives"] == ["error", "jitter"]

    def test_what_the_best_is_chosen_by_is_measured_too_and_a_folder_may_be_called_anything(self, run, clips, tmp_path):
        measured = ["--objective", "error", "--objective", "error", "--best", "jitter"]
        code, out, err = run(
            "sweep", str(clips[0]), "--set", "landmarks.weights=[{}, {nose=2.0}]", *measured, "--out", "out/[x]"
        )
        assert (code, err) == (0, "")
        assert "in out/[x]" in out
        stored = Storage(str(tmp_path / "out" / "[x]")).read("sweep.json")
        assert json.loads(stored)["objectives"] == ["error", "jitter"]

    @pytest.mark.parametrize(
        ("arguments", "said"),
        [
            (["--set", "weights.tua=1,2"], "did you mean 'tau'"),
            (["--set", "weights.tau=log(3,1,5)"], "the range is empty"),
            (["--set", TAU, "--objective", "eror"], "no objective"),
            (["--set", TAU, "--sample", "sobol"], "sobol:64"),
            (["--set", TAU, "--backend", "threads"], "auto, pool or dask"),
            (["--set", TAU, "--truth", "a.npz", "--truth", "b.npz"], "1 clips and 2 truths"),
            (["--set", TAU, "--config", "a.toml", "--preset", "joint"], "not both"),
        ],
    )
    def test_what_is_wrong_is_one_sentence_and_exit_code_2(self, run, clips, tmp_path, arguments, said):
        code, _, err = run("sweep", str(clips[0]), "--out", str(tmp_path / "s"), *arguments)
        assert code == 2
        assert said in err
        assert len(err.strip().splitlines()) == 1

    def test_no_face_at_all_is_exit_code_2_and_a_bad_clip_among_others_1(self, run, clips, tmp_path):
        empty = str(write_clip(tmp_path / "empty.csv", range(4), faceless=True))
        given = ["--preset", "face-it", "--set", "weights.tau=0.01,1", "--objective", "error"]
        code, _, err = run("sweep", empty, *given, "--out", str(tmp_path / "s"))
        assert code == 2
        assert "no face in any frame" in err
        code, out, err = run("sweep", str(clips[0]), empty, *given, "--out", str(tmp_path / "t"))
        assert code == 1
        assert "no face in any frame" in err
        assert "table.csv" in out

    def test_a_full_disk_is_one_sentence_and_exit_code_2_and_resume_goes_on(self, run, clips, tmp_path):
        given = ["--preset", "face-it", "--set", TAU, "--objective", "error", "--out", str(tmp_path / "s")]
        assert run("sweep", str(clips[0]), *given)[0] == 0
        before = {path: path.read_bytes() for path in (tmp_path / "s" / "results").rglob("*.npz")}
        # Room for the definition, but not for the landmarks of the second clip.
        with small_disk((tmp_path / "s" / "sweep.json").stat().st_size + 200):
            code, _, err = run("sweep", *map(str, clips), *given, "--resume")
        assert code == 2
        assert "cannot be written" in err
        assert "Finished work is kept; --resume goes on from there." in err
        assert len(err.strip().splitlines()) == 1
        assert {path: path.read_bytes() for path in before} == before
        code, out, err = run("sweep", *map(str, clips), *given, "--resume")
        assert (code, err) == (0, "")
        assert "table.csv" in out

    def test_the_objectives_are_listed_with_what_they_cannot_see(self, run):
        code, out, _ = run("sweep", "--objective", "list")
        assert code == 0
        assert "left-out-points" in out
        assert re.search(r"what it cannot\s+see", out)


def test_windows_of_a_budget_are_what_is_measured(clips, tmp_path):
    long = write_clip(tmp_path / "long.csv", range(0, 120))
    result, fits = do(plan(long, frames=40, axes=["weights.tau=0.1"]), tmp_path / "s")
    assert fits == 40
    assert result.values[0, "long"].shape == (2, 40)
    # Two runs of twenty: neither of their first two frames has two frames before it.
    assert np.flatnonzero(np.isnan(result.values[0, "long"][1])).tolist() == [0, 1, 20, 21]
    assert len(chosen_windows([range(120)], 40)) == 2


def session_of(head, frames):
    sizes = [frame.image_size for frame in frames]
    return TuningSession(head, Material("clip", tuple(frames), PictureStore(None, sizes), False), FACE_IT)


class TestInASession:
    def test_it_finds_what_the_command_finds_and_grows(self, head, done, monkeypatch):
        session = session_of(head, observations(range(12)))
        monkeypatch.setattr(sweeping, "FITS", 12)
        grown = []
        result = session.sweep(TAU, objectives=("error", "jitter"), grown=grown.append)
        assert [len(part.values) for part in grown] == [1, 2, 3, 4]
        for number in range(4):
            np.testing.assert_array_equal(result.values[number, "clip"], done[0].values[number, "one"])
        assert np.isnan(grown[0].means("error")).tolist() == [False, True, True, True]

    def test_a_point_can_be_taken_and_undone(self, head):
        session = session_of(head, observations(range(12)))
        before = session.config
        result = session.sweep(TAU, objectives=("error",))
        session.use(result.config(2), "sweep")
        assert session.config.weights.tau == pytest.approx(1.0)
        session.undo()
        assert session.config == before

    def test_it_stops_and_keeps_what_was_done(self, head, monkeypatch):
        session = session_of(head, observations(range(12)))
        monkeypatch.setattr(sweeping, "FITS", 12)
        asked = iter([False, False, True])
        result = session.sweep(TAU, objectives=("error",), cancelled=lambda: next(asked))
        assert len(result.values) == 2

    def test_without_a_face_it_says_so(self, head):
        with pytest.raises(InputError, match="clip has no face in any frame"):
            session_of(head, observations(range(2), gaps=(0, 1))).sweep(TAU)
