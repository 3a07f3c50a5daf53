"""Objectives: zero for the truth, right for known faults, blind where they say so, and differentiable."""

from dataclasses import replace
from itertools import islice

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.landmark_layouts import dlib_box, dlib_xml
from workbench.errors import ConfigError, InputError
from workbench.face import load_default_head
from workbench.frames import FrameRange, image_names, open_frames, write_picture
from workbench.geometry import PlacedCamera, camera_from_fov, project
from workbench.landmarks.files import read_landmark_file
from workbench.objectives import (
    TABLE,
    FittedClip,
    ObservedClip,
    SecondView,
    Truth,
    bootstrap,
    drawn_means,
    flow_of_pictures,
    folds_of,
    inner_landmarks,
    interval_of,
    least_at_equal,
    measure,
    measured_by,
    observed_clip,
    pareto_set,
    read_sum,
    read_truth,
    surface_points,
    usable,
    without_hidden,
)
from workbench.samples import sample
from workbench.session import open_session

FRAMES = 9
PARTS_OF_FITS = {
    "rotation": "rotation",
    "position": "translation",
    "weights": "expression",
    "second-view": "inner_camera",
}
"""By objective, what of the fits it looks at, if not at their landmarks in the picture."""


@pytest.fixture(scope="module")
def head():
    return load_default_head()


@pytest.fixture(scope="module")
def true_clip(head):
    """The first frames of the sample clip as its truth has them: the clip, and fits that are the truth."""
    truth = read_truth(sample("performance-truth"), head, range(FRAMES))
    with np.load(sample("performance-truth")) as stored:
        identity = np.tile(stored["identity"], (FRAMES, 1))
    points = truth.labels
    inner = inner_landmarks(head, truth.rotation, truth.translation, truth.expression, identity)
    second = PlacedCamera(camera_from_fov((640, 480), 40.0), np.eye(3), np.array([-100.0, 0.0, 0.0]))
    there = np.asarray(project(second.camera, inner @ second.rotation_view_reference.T + np.array([-100.0, 0, 0])))
    jaw = points[:, :17] + np.array([40.0, 0.0])  # counts for the size of the face alone
    others = np.concatenate([jaw, there], axis=1)
    flow = np.concatenate([np.full((1, 68, 2), np.nan), np.diff(points, axis=0)])
    follows = np.arange(FRAMES) > 0
    clip = ObservedClip(points, np.ones((FRAMES, 68)), follows, truth, flow, SecondView(second, others))
    folds = dict.fromkeys(("points", "parts"), np.tile(points, (5, 1, 1, 1))) | {
        "frames": np.tile(points, (3, 1, 1, 1))
    }
    fits = FittedClip(
        truth.rotation,
        truth.translation,
        truth.expression,
        points,
        inner,
        np.full(FRAMES, 12.0),
        truth.surface,
        folds,
    )
    return clip, fits


@pytest.mark.parametrize("name", sorted(set(TABLE) - {"iterations", "jitter", "left-out-frames"}))
def test_the_truth_itself_has_no_error(true_clip, name):
    values = measure(name)(*true_clip)
    assert values.shape == (FRAMES,)
    assert np.nanmax(values) < 1e-5


def test_a_turned_head_is_off_by_its_angle_whatever_its_own_rotation(true_clip):
    clip, fits = true_clip
    turned = Rotation.from_rotvec([0.0, np.radians(2.0), 0.0]) * Rotation.from_rotvec(fits.rotation)
    np.testing.assert_allclose(measure("rotation")(clip, fits._replace(rotation=turned.as_rotvec())), 2.0)


def test_a_moved_head_is_off_by_its_distance_and_its_mesh_by_nothing(true_clip):
    clip, fits = true_clip
    by = np.array([3.0, 0.0, 4.0])
    moved = fits._replace(translation=fits.translation + by, surface=fits.surface + by)
    np.testing.assert_allclose(measure("position")(clip, moved), 5.0)
    np.testing.assert_allclose(measure("mesh")(clip, moved), 0.0, atol=1e-9)


@pytest.mark.parametrize("kind", ["points", "parts"])
def test_only_hidden_points_count_when_some_are_left_out(true_clip, kind):
    clip, fits = true_clip
    hidden = folds_of((kind,), FRAMES)[1:]
    assert (hidden.sum(0) == 1).all()
    seen_moved = np.where(hidden[..., None], fits.folds[kind], fits.folds[kind] + 50.0)
    blind = fits._replace(folds={kind: seen_moved})
    np.testing.assert_allclose(measure(f"left-out-{kind}")(clip, blind), 0.0, atol=1e-9)
    off = fits._replace(folds={kind: fits.folds[kind] + [3.0, 4.0]})
    eyes = np.linalg.norm(clip.points[:, 36] - clip.points[:, 45], axis=1)
    np.testing.assert_allclose(measure(f"left-out-{kind}")(clip, off), 500.0 / eyes)


def test_a_part_of_the_face_is_hidden_as_a_whole():
    hidden = folds_of(("parts",), 1)[1:, 0]
    assert hidden[:, :17].sum(1).tolist() == [17, 0, 0, 0, 0]
    assert hidden.sum(1).tolist() == [17, 10, 9, 12, 20]


def test_a_hidden_frame_is_predicted_by_fits_that_did_not_see_it(true_clip):
    clip, fits = true_clip
    hidden = folds_of(("frames",), FRAMES)[1:, :, 0]
    assert (hidden.sum(0) == 1).all()
    straight = clip.points[:1] + 2.0 * np.arange(FRAMES)[:, None, None]
    noise = np.where(hidden[..., None, None], 1e3, 0.0)  # what a fold says of its own hidden frames does not matter
    clip = clip._replace(points=straight)
    values = measure("left-out-frames")(clip, fits._replace(folds={"frames": straight + noise}))
    assert np.isnan(values[[0, -1]]).all()
    np.testing.assert_allclose(values[1:-1], 0.0, atol=1e-9)


def test_steady_motion_has_no_jitter_and_a_cut_does_not_count(true_clip):
    clip, fits = true_clip
    straight = clip.points[:1] + np.arange(FRAMES)[:, None, None] * [2.0, 1.0]
    straight[5:] += 100.0
    clip = clip._replace(follows=np.array([False, *[True] * 4, False, True, True, True]))
    values = measure("jitter")(clip, fits._replace(projected=straight))
    assert np.isnan(values[[0, 1, 5, 6]]).all()
    np.testing.assert_allclose(values[[2, 3, 4, 7, 8]], 0.0, atol=1e-9)


def test_the_motion_of_a_shifted_picture_is_found(true_clip):
    clip, fits = true_clip
    noise = np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)
    first = np.kron(noise, np.ones((8, 8, 1), np.uint8))
    pictures = [first, np.roll(first, 3, axis=1)]
    two = observed_two(clip, 3.0)
    flow = flow_of_pictures(pictures, two)
    assert np.isnan(flow[0]).all()
    np.testing.assert_allclose(np.nanmedian(flow[1], axis=0), [3.0, 0.0], atol=0.1)
    moved = fits._replace(projected=two.points)
    assert measure("flow")(two._replace(flow=flow), moved)[1] < 0.3


def observed_two(clip, shift):
    points = np.stack([clip.points[0], clip.points[0] + [shift, 0.0]])
    return ObservedClip(points, np.ones((2, 68)), np.array([False, True]))


def test_frames_without_a_face_are_not_measured(head):
    session = open_session(sample("performance-landmarks"))
    observations = list(session.material.observations[:6])
    observations[3] = replace(observations[3], landmarks=None)
    clip = observed_clip(observations)
    assert clip.follows.tolist() == [False, True, True, True, True, True]
    fits = _fits_with_nan(clip)
    for name in ("error", "jitter"):
        assert np.isnan(measure(name)(clip, fits)[3])
    assert np.isfinite(measure("error")(clip, fits)[[0, 1, 2, 4, 5]]).all()


def _fits_with_nan(clip):
    count = len(clip.points)
    return FittedClip(*(np.zeros((count, n)) for n in (3, 3, 44)), clip.points + 1.0, None, np.zeros(count))


@pytest.mark.parametrize("name", sorted(set(TABLE) - {"iterations", "mesh", "left-out-frames"}))
def test_objectives_can_be_differentiated_by_the_fits_even_where_nothing_is_wrong_or_known(true_clip, name):
    clip, fits = true_clip
    clip = clip._replace(
        truth=Truth(*map(_without_frame, clip.truth)),
        flow=_without_frame(clip.flow),
        second=clip.second._replace(points=_without_frame(clip.second.points)),
    )
    kind = name.removeprefix("left-out-")
    part = PARTS_OF_FITS.get(name, "projected")

    def mean(values):
        changed = {"folds": {kind: values}} if kind in fits.folds else {part: values}
        return jnp.nanmean(measure(name)(clip, fits._replace(**changed)))

    at = jnp.asarray(fits.folds[kind] if kind in fits.folds else getattr(fits, part))
    slope = jax.grad(mean)(at)
    assert np.isfinite(slope).all()
    off = at + 0.1 * np.random.default_rng(1).normal(size=at.shape)
    along = np.random.default_rng(2).normal(size=at.shape)
    numeric = (mean(off + 1e-6 * along) - mean(off - 1e-6 * along)) / 2e-6
    np.testing.assert_allclose(jnp.vdot(jax.grad(mean)(off), along), numeric, rtol=1e-4, atol=1e-9)


def _without_frame(values):
    values = values.copy()
    values[4] = np.nan
    return values


def test_what_a_clip_lacks_is_named(true_clip):
    clip, fits = true_clip
    bare = clip._replace(truth=Truth(), flow=None, second=None)
    assert [name for name, row in TABLE.items() if not usable(row, bare)] == [
        name for name, row in TABLE.items() if row.needs
    ]
    with pytest.raises(InputError, match="the clip's pictures"):
        measured_by(["error", "flow"], bare, fits)
    with pytest.raises(ConfigError, match="no objective 'eror'; the objectives are error"):
        measured_by(["eror"], bare, fits)


def test_hiding_takes_points_out_of_a_fit_and_leaves_the_clip_alone(true_clip):
    session = open_session(sample("performance-landmarks"))
    observation = session.material.observations[0]
    hidden = np.arange(68) < 10
    masked = without_hidden(observation, hidden)
    assert (masked.landmarks.confidence[:10] == 0.0).all()
    assert (masked.landmarks.confidence[10:] == observation.landmarks.confidence[10:]).all()
    assert (observation.landmarks.confidence[:10] > 0.0).any()


def test_a_track_is_a_truth_and_a_landmark_file_has_labels(tmp_path, head):
    session = open_session(sample("performance-landmarks"))
    material = replace(session.material, observations=session.material.observations[:3])
    labels = read_truth(sample("performance-landmarks"), head, [2, 400])
    np.testing.assert_allclose(labels.labels[0], material.observations[2].landmarks.points)
    assert np.isnan(labels.labels[1]).all()
    track = open_session(material).track
    track.save(tmp_path / "track.npz")
    truth = read_truth(tmp_path / "track.npz", head, [1])
    np.testing.assert_array_equal(truth.rotation[0], track.rotation[1])
    expected = surface_points(head, *(getattr(track, n)[1:2] for n in ("rotation", "translation", "expression")),
                              track.identity[1:2])  # fmt: skip
    np.testing.assert_array_equal(truth.surface, expected)


def test_labels_are_of_the_photos_that_they_name_in_a_part_of_a_folder_too(tmp_path, head):
    faces = [record.landmarks.points for record in islice(read_landmark_file(sample("performance-landmarks")), 2)]
    named = zip(("a", "c"), faces, strict=True)
    (tmp_path / "some.xml").write_text(
        dlib_xml([(f"file='{name}.png' width='640' height='480'", [dlib_box(face)]) for name, face in named])
    )
    for name in "abcd":
        write_picture(tmp_path / f"{name}.png", np.zeros((480, 640, 3), np.uint8))

    def labels_from(first):
        names = image_names(FrameRange(open_frames(tmp_path), first, 3))
        return read_truth(tmp_path / "some.xml", head, range(4 - first), pictures=names, first=first).labels

    two = labels_from(1)
    np.testing.assert_allclose(two[1], faces[1], atol=1e-3)
    assert np.isnan(two[[0, 2]]).all()
    assert np.isnan(labels_from(3)).all()  # the file names none of these
    np.save(tmp_path / "two.npy", np.array(faces))
    unnamed = read_truth(tmp_path / "two.npy", head, range(3), (640, 480), image_names(open_frames(tmp_path)), first=1)
    np.testing.assert_allclose(unnamed.labels[:2], faces, atol=1e-3)


def test_a_file_that_is_no_truth_says_what_it_should_be(tmp_path, head):
    np.savez(tmp_path / "other.npz", rotation=np.zeros((4, 2)))
    with pytest.raises(InputError, match=r"rotation has shape \(4, 2\), expected \(4, 3\)"):
        read_truth(tmp_path / "other.npz", head, [0])
    np.savez(tmp_path / "nothing.npz", colours=np.zeros(3))
    with pytest.raises(InputError, match="says nothing about a face"):
        read_truth(tmp_path / "nothing.npz", head, [0])


def test_sums_are_read_as_they_are_written():
    wanted = read_sum("jitter + 0.5*left-out-points")
    assert dict(wanted.factors) == {"jitter": 1.0, "left-out-points": 0.5}
    assert str(wanted) == "jitter + 0.5*left-out-points"
    assert wanted.of({"jitter": np.array([1.0]), "left-out-points": np.array([4.0])}) == [3.0]
    with pytest.raises(ConfigError, match="no objective 'jiter'"):
        read_sum("jiter")
    with pytest.raises(ConfigError, match=r"NAME or 0\.5\*NAME"):
        read_sum("jitter - error")


def test_a_pareto_set_holds_what_nothing_beats():
    values = np.array([[1.0, 5.0], [2.0, 2.0], [3.0, 3.0], [5.0, 1.0], [np.nan, 0.0], [2.0, 2.0]])
    assert pareto_set(values).tolist() == [True, True, False, True, False, True]


def test_the_steadiest_is_chosen_among_those_of_equal_error():
    error = np.array([1.0, 1.04, 2.0, np.nan])
    jitter = np.array([0.5, 0.3, 0.1, 0.0])
    assert least_at_equal(jitter, error, 0.05) == 1
    assert least_at_equal(jitter, np.full(4, np.nan)) is None


def test_every_row_says_what_it_cannot_see_and_has_a_function():
    for name, row in TABLE.items():
        assert row.blind
        assert not (row.says + row.blind).endswith(".")
        assert callable(measure(name))


@pytest.mark.parametrize("frames", [8, 12, 20, 40, 100])
def test_an_interval_of_independent_frames_mostly_holds_the_true_mean_in_short_clips_too(frames):
    rng = np.random.default_rng(frames)
    ends = [interval_of(drawn_means(rng.normal(size=(1, frames)), trial, draws=300)[:, 0]) for trial in range(300)]
    assert np.mean([low < 0.0 < high for low, high in ends]) > 0.82


def test_each_frame_is_drawn_as_often_as_every_other():
    only = np.eye(25)
    drawn = drawn_means(only, draws=4000).mean(axis=0)
    np.testing.assert_allclose(drawn, 1.0 / 25, rtol=0.1)


def test_of_four_frames_no_interval_is_known():
    assert np.isnan(interval_of(drawn_means(np.ones((1, 4)))[:, 0])).all()


def test_draws_of_a_long_clip_are_made_a_few_at_a_time(monkeypatch):
    values = np.random.default_rng(3).normal(size=(3, 400))
    values[1, 20:60] = np.nan
    at_once = drawn_means(values, draws=40)
    monkeypatch.setattr(bootstrap, "MOST_AT_ONCE", 3 * 40 * 7)
    np.testing.assert_array_equal(drawn_means(values, draws=40), at_once)
    assert np.abs(at_once.mean(0) - np.nanmean(values, axis=1)).max() < 0.05
