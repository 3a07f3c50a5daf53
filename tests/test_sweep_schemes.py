"""Sweeps and learning on clips whose landmarks go beyond the 68: all points are fitted, the 68 are judged."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scheme_clips import FRAMES, NOBODY, clip_for, config_of
from workbench.face import in_scheme
from workbench.landmarks.schemes import DENSE, IBUG68_PUPILS
from workbench.objectives import Truth, folds_of, observed_clip
from workbench.samples import sample
from workbench.session import Material, TuningSession
from workbench.session.material import PictureStore
from workbench.sweeps import ClipSolver, SweptClip
from workbench.sweeps.storage import Storage
from workbench.sweeps.stored_clips import ClipSource, observe, store_clip, stored_clip

NAMES = ("rotation", "translation", "expression")


@pytest.fixture(scope="module")
def solver(head):
    return ClipSolver(head)


@pytest.fixture(scope="module", params=["dense", pytest.param("gaze", marks=pytest.mark.long)])
def seen(request):
    """The name of a preset, and the clip as its detector sees it."""
    return request.param, clip_for(request.param)


def test_fits_are_those_of_the_tracker_with_all_points(solver, head, seen):
    name, clip = seen
    config = config_of(name)
    sizes = [each.image_size for each in clip.observations]
    session = TuningSession(head, Material("clip", clip.observations, PictureStore(None, sizes), False), config)
    track = session.track
    (fits,) = solver.fits([config], clip, clip.shots)
    for part in NAMES:
        np.testing.assert_allclose(getattr(fits, part), getattr(track, part), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(fits.projected, track.projected[:, :68], atol=1e-7)
    assert np.isnan(fits.rotation[NOBODY]).all()
    eyes = [k for k, shape in enumerate(track.expression_names) if shape.startswith("eyeLook")]
    assert np.nanmax(fits.expression[:, eyes]) > 0.01


def test_configurations_with_and_without_covariances_are_solved_together(solver, seen):
    name, clip = seen
    configs = [config_of(name), config_of(name).changed(landmarks={"confidence": False})]
    together = solver.fits(configs, clip, clip.shots)
    for config, fits in zip(configs, together, strict=True):
        (alone,) = solver.fits([config], clip, clip.shots)
        np.testing.assert_array_equal(fits.projected, alone.projected)
    assert np.nanmax(np.abs(together[0].projected - together[1].projected)) > 0.01


@pytest.mark.parametrize("change", [{"weights": {"irises": 0.0}}, {"confidence": False}], ids=str)
def test_what_the_face_shape_depends_on_is_never_taken_from_other_settings(head, seen, change):
    name, clip = seen
    config = config_of(name)
    changed = config.changed(landmarks=change)
    solver = ClipSolver(head)
    solver.fits([config], clip, clip.shots)
    (after,), (alone,) = (each.fits([changed], clip, clip.shots) for each in (solver, ClipSolver(head)))
    np.testing.assert_array_equal(after.projected, alone.projected)


def test_folds_hide_the_points_of_a_part_in_every_scheme():
    for scheme in (IBUG68_PUPILS, DENSE):
        hidden = folds_of(("parts",), 2, scheme)[1:, 0]
        assert (hidden[:, :68].sum(0) == 1).all()
        assert hidden[3, list(scheme.groups["irises"])].all()
        assert hidden[:, 68:].sum(0).max() == 1
        assert folds_of(("points",), 2, scheme)[1:].sum(0).min() == 1


def test_what_a_fold_hides_has_no_effect_on_its_fits(solver, seen):
    name, clip = seen
    scheme, config = clip.scheme, config_of(name)
    hidden = folds_of(("parts",), 1, scheme)[1:, 0]
    moved = []
    for each in clip.observations:
        face = each.landmarks
        if face is not None:
            face = replace(face, points=face.points + np.where(hidden[4], 3.0, 0.0)[:, None])
        moved.append(replace(each, landmarks=face))
    other = SweptClip("clip", f"{name} moved", tuple(moved), False)
    (before,), (after,) = (solver.fits([config], each, each.shots, ("parts",)) for each in (clip, other))
    np.testing.assert_array_equal(before.folds["parts"][4], after.folds["parts"][4])
    assert np.nanmax(np.abs(before.folds["parts"][3] - after.folds["parts"][3])) > 0.01
    assert before.folds["parts"].shape == (5, FRAMES, 68, 2)


def test_objectives_look_at_the_68(seen):
    _, clip = seen
    known = observed_clip(clip.observations)
    assert known.points.shape == (FRAMES, 68, 2)
    np.testing.assert_array_equal(known.points[0], clip.observations[0].landmarks.points[:68])
    assert known.confidence.shape == (FRAMES, 68)


def test_a_stored_clip_keeps_scheme_and_covariances(seen, tmp_path):
    name, clip = seen
    store_clip(Storage(str(tmp_path)), replace(clip, truth=Truth()))
    read = stored_clip(Storage(str(tmp_path)), clip.digest, "clip")
    assert read.scheme is clip.scheme is (DENSE if name == "dense" else IBUG68_PUPILS)
    assert read.observations[NOBODY].landmarks is None
    for ours, stored in zip(clip.observations, read.observations, strict=True):
        if ours.landmarks is not None:
            np.testing.assert_array_equal(stored.landmarks.points, ours.landmarks.points)
            if name == "dense":
                np.testing.assert_array_equal(stored.landmarks.covariance, ours.landmarks.covariance)


def test_a_clip_with_truth_has_it_for_the_eyes_too(head):
    """The truth of the bundled clip names 52 blendshapes, and so do fits whose eyes turn."""
    source = ClipSource(str(sample("performance")), truth=str(sample("performance-truth")))
    clip = observe(source, config_of("gaze"), head)
    assert clip.scheme is IBUG68_PUPILS
    assert clip.truth.expression.shape[1] == len(in_scheme(head, IBUG68_PUPILS).expression_names)
