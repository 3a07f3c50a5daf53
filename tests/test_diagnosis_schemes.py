"""Diagnosis with more points than the 68: fits are those of the session, hypotheses take the further points along."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from workbench.diagnosis import Change, FrameCase, diagnose_frame, leave_one_group_out, reference_of
from workbench.diagnosis.causes.gaze import stray_pupil
from workbench.diagnosis.causes.groups import SIDES, mask_of, muted
from workbench.diagnosis.diagnose import start_trial
from workbench.diagnosis.group_pull import pulling_groups
from workbench.face import in_scheme, load_default_head
from workbench.face.gaze import angle_between_deg, gaze_deg
from workbench.landmarks.scheme import IBUG68, POINT_COUNT
from workbench.landmarks.schemes import DENSE, IBUG68_PUPILS, PUPILS
from workbench.planning import plan_of
from workbench.tracking import FaceItFitter
from workbench.tracking.fitting import BY_HAND_PX, corrected

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
import planted_faults as faults

PRESETS = {"gaze": IBUG68_PUPILS, "dense": DENSE}
AT_ONCE = [("dense", "10-px bias of a brow")]
LATER = [(name, fault) for name in PRESETS for fault in faults.FAULTS if (name, fault) not in AT_ONCE]


@pytest.fixture(scope="module")
def fitters():
    heads = {name: in_scheme(load_default_head(), scheme) for name, scheme in PRESETS.items()}
    return {name: FaceItFitter(head, plan_of(faults.good_config(name), head.scheme)) for name, head in heads.items()}


@pytest.fixture(scope="module")
def case():
    """A frame of the clip without a fault, by its dense points."""
    config = faults.good_config("dense")
    return faults.case_at(40, faults.clip(config).noisy(np.random.default_rng(2)), config)


@pytest.fixture(scope="module")
def trial(case, fitters):
    return start_trial(fitters["dense"].model, case, fitters["dense"])


@pytest.mark.parametrize(
    ("name", "fault"), [*AT_ONCE, *(pytest.param(*later, marks=pytest.mark.long) for later in LATER)]
)
def test_the_right_reason_is_named_and_its_change_does_what_a_session_would(fitters, name, fault):
    config = faults.good_config(name)
    planted = faults.planted(fault, 0, config=config)
    found = diagnose_frame(fitters[name].model, planted.case, fitters[name])
    assert len(found.fit.observed) == len(PRESETS[name])
    reasons = [reason for reason in found.reasons if reason.code == planted.code]
    assert reasons
    assert found.reasons.index(reasons[0]) < 2
    reason = reasons[0]
    # The points of a hand are fitted as well as those of a face: there the truth tells what the change is worth.
    if fault != "hand before the mouth":
        assert reason.after_percent < reason.before_percent
    if reason.measure == "landmark error" and not reason.change.config:
        context = reason.change.applied(planted.case.context)
        observation = reason.change.moved(planted.case.observation)
        changed = reason.change.apply_to(planted.case.config)
        fitter = FaceItFitter(fitters[name].model, plan_of(changed, PRESETS[name]))
        fits = [fitter.fit(observation, each)[0] for each in (context, context._replace(last=None))]
        promised = min(fits, key=lambda fit: abs(fit.errors[2] - reason.after_percent))
        assert abs(promised.errors[2] - reason.after_percent) < 0.05
        if fault == "hand before the mouth" and name == "dense":
            truth = faults.clip(config).parameters[found.fit.index].expression
            after, before = (np.abs(fit.expression - truth).mean() for fit in (promised, found.fit))
            assert after < 0.8 * before


@pytest.mark.parametrize("name", [pytest.param("gaze", marks=pytest.mark.long), "dense"])
def test_a_pupil_on_a_reflection_is_named_and_the_eyes_look_where_they_do(fitters, name):
    head, config = fitters[name].model, faults.good_config(name)
    planted = faults.planted("pupil on a reflection", 2, config=config)
    found = diagnose_frame(head, planted.case, fitters[name])
    reason = found.reasons[0]
    assert (reason.code, reason.title) == ("stray_pupil", "The right pupil is not where the other eye looks")
    assert reason.numbers["pupil"] == PUPILS[0]
    assert reason.after_percent < 0.2 * reason.before_percent
    assert all(point in PRESETS[name].groups["irises"] for point in reason.change.landmarks)
    mended, _ = fitters[name].fit(reason.change.moved(planted.case.observation), planted.case.context)
    truth = gaze_deg(head, faults.clip(config).parameters[found.fit.index].expression)
    before, after = (angle_between_deg(gaze_deg(head, fit.expression), truth) for fit in (found.fit, mended))
    assert before.max() > 5.0
    assert after.max() < 0.5 * before.max()


def test_an_eye_that_is_not_seen_is_not_accused(fitters):
    config = faults.good_config("dense")
    case = faults.planted("pupil on a reflection", 2, config=config).case
    landmarks = case.observation.landmarks
    sure = np.where(np.arange(len(DENSE)) == PUPILS[0], 0.1, landmarks.confidence)
    unsure = replace(case, observation=replace(case.observation, landmarks=replace(landmarks, confidence=sure)))
    trial = start_trial(fitters["dense"].model, unsure, fitters["dense"])
    assert list(stray_pupil(trial)) == []


def test_the_fit_under_diagnosis_is_that_of_the_session(case, fitters, trial):
    fit, _ = fitters["dense"].fit(case.observation, case.context)
    np.testing.assert_array_equal(trial.fit.projected, fit.projected)
    assert trial.error_percent(trial.fit) == pytest.approx(fit.errors[2])


@pytest.mark.parametrize("name", [pytest.param("gaze", marks=pytest.mark.long), "dense"])
def test_a_clean_frame_has_no_reason(fitters, name):
    config = faults.good_config(name)
    clip = faults.clip(config)
    observations = faults.observations_of(clip.noisy(np.random.default_rng(5)))
    fits = faults.follow(observations, config, until=104)
    reference = reference_of(clip.head, config, observations, fitters[name])
    for index in (40, 104):
        pictures = (clip.pictures[index], clip.pictures[index - 1], clip.pictures.__getitem__)
        clean = FrameCase(observations[index], fits[index][1], config, observations, *pictures)
        assert diagnose_frame(clip.head, clean, fitters[name], reference).reasons == ()


def test_the_pulls_go_on_with_the_parts_that_only_this_scheme_has(case, fitters):
    pulls = leave_one_group_out(fitters["dense"].model, case, fitters["dense"])
    assert [pull.group for pull in pulls] == list(pulling_groups(DENSE))
    assert pulling_groups(DENSE)[-3:] == ("irises", "ears", "face")
    assert pulling_groups(IBUG68_PUPILS)[-1] == "irises"
    assert not set(pulling_groups(IBUG68)) & {"irises", "ears", "face"}
    assert all(np.isfinite(pull.distance_percent) for pull in pulls)


def test_a_muted_part_has_no_weight_at_any_of_its_points(trial, case):
    for name in ("mouth", "chin", "left_side"):
        mask = mask_of(trial, name)
        weights = np.array(muted(trial, name).apply_to(case.config).point_weights(DENSE))
        assert mask[POINT_COUNT:].any()
        assert (weights[mask] == 0.0).all()
        assert (weights[~mask] > 0.0).all()


def test_a_side_has_the_further_points_that_are_nearest_to_it(trial):
    head = in_scheme(load_default_head(), DENSE)
    neutral = head.landmarks.of(head.neutral)
    mask = mask_of(trial, "right_side")
    assert np.flatnonzero(mask[:POINT_COUNT]).tolist() == sorted(SIDES["right_side"])
    for point in range(POINT_COUNT, len(DENSE)):
        nearest = np.linalg.norm(neutral[:POINT_COUNT] - neutral[point], axis=1).argmin()
        assert mask[point] == (nearest in SIDES["right_side"])
    # The subject's right is at negative x of the head.
    assert (neutral[POINT_COUNT:][mask[POINT_COUNT:], 0] < 0.0).mean() > 0.95


def test_less_weight_for_a_group_keeps_the_proportions_in_it(case, fitters):
    config = case.config.changed(landmarks={"weights": {**case.config.landmarks.weights, "mouth": 0.5, "5": 0.3}})
    changed = start_trial(fitters["dense"].model, FrameCase(case.observation, case.context, config), fitters["dense"])
    before = np.array(config.point_weights(DENSE))
    for group, chosen in (("all", np.ones(len(DENSE), bool)), ("non_jaw", DENSE.group_mask("non_jaw"))):
        less = Change("", config={"landmarks": {"weights": changed.lessened(group, 0.2)}}).apply_to(config)
        np.testing.assert_allclose(less.point_weights(DENSE), np.where(chosen, 0.2 * before, before))


def test_a_change_has_the_last_word_on_weights_that_were_set_before():
    config = faults.good_config("dense").changed(landmarks={"weights": {"mouth": 0.5, "dense": 0.05}})
    change = Change("Mute the mouth", config={"landmarks": {"weights": {"mouth": 0.0}}})
    weights = np.array(change.apply_to(config).point_weights(DENSE))
    assert (weights[DENSE.group_mask("mouth")] == 0.0).all()


def test_moved_points_are_as_sure_as_those_that_a_session_moves(case):
    places = {3: (1.0, 2.0), 200: (5.0, 6.0)}
    moved = Change("Move two points", landmarks=places).moved(case.observation).landmarks
    np.testing.assert_array_equal(moved.covariance[[3, 200]], np.tile(BY_HAND_PX**2 * np.eye(2), (2, 1, 1)))
    by_hand = corrected(case.observation, places).landmarks
    np.testing.assert_array_equal(moved.points, by_hand.points)
    np.testing.assert_array_equal(moved.covariance, by_hand.covariance)
