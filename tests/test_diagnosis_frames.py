"""Why a frame fails: planted faults and their reasons, changes that mend, group pulls, flags over a track."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from workbench.config import preset
from workbench.diagnosis import (
    Change,
    FrameCase,
    diagnose_frame,
    flag_frames,
    leave_one_group_out,
    reference_of,
)
from workbench.diagnosis.causes.order import exchanged_pairs, turning
from workbench.diagnosis.causes.person import best_factor, fov_with
from workbench.diagnosis.picture_evidence import carried_by_flow, directional_blur, gradient_energy
from workbench.errors import InputError
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.scheme import GROUPS, MIRROR, face_size
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.session import Material, TuningSession
from workbench.session.material import PictureStore
from workbench.tracking import FaceItFitter, FrameContext, Track
from workbench.tracking.records import stack_fits
from workbench.tracking.track_layout import model_record

# The benchmark's own faults: what it reports and what is tested here cannot drift apart.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
import planted_faults as faults


@pytest.fixture(scope="module")
def config():
    return faults.good_config()


@pytest.fixture(scope="module")
def fitter(head, config):
    return FaceItFitter(head, plan_of(config))


@pytest.fixture(scope="module")
def clean(config):
    """Observations, fits and contexts of the clip without a fault."""
    observations = faults.observations_of(faults.clip().noisy(np.random.default_rng(5)))
    return observations, faults.follow(observations, config)


@pytest.fixture(scope="module")
def reference(head, config, clean, fitter):
    return reference_of(head, config, clean[0], fitter)


def clean_case(clean, config, index: int) -> FrameCase:
    observations, fits = clean
    pictures = faults.clip().pictures
    shown = (pictures[index], pictures[index - 1], pictures.__getitem__)
    return FrameCase(observations[index], fits[index][1], config, observations, *shown)


def track_of(fits, head) -> Track:
    return Track(**stack_fits([fit for fit, _ in fits]), meta={"expression_names": list(head.expression_names)})


@pytest.mark.parametrize("fault", faults.FAULTS)
def test_the_right_reason_comes_first_and_its_change_mends(head, fitter, fault):
    planted = faults.planted(fault, 0)
    case = planted.case
    found = diagnose_frame(head, case, fitter)
    reason = found.reasons[0]
    assert reason.code == planted.code
    assert 0.3 <= reason.score <= 1.0
    assert reason.title
    assert any(character.isdigit() for character in reason.evidence)
    assert reason.after_percent < reason.before_percent
    # The words tell the same two errors as the numbers beside them.
    for told in re.findall(r"from ([\d.]+) to ([\d.]+) % of", reason.evidence):
        assert told == (f"{reason.before_percent:.1f}", f"{reason.after_percent:.1f}")
    # Applied as a session would, the change leads to the error that was promised.
    if reason.measure == "landmark error" and not reason.change.config:
        context = reason.change.applied(case.context)
        observation = reason.change.moved(case.observation)
        contexts = [context, context._replace(last=None)]
        fitter = FaceItFitter(head, plan_of(reason.change.apply_to(case.config)))
        fits = [fitter.fit(observation, each)[0] for each in contexts]
        assert min(abs(fit.errors[2] - reason.after_percent) for fit in fits) < 0.05


@pytest.mark.parametrize("fault", faults.UNMENDED)
def test_the_right_reason_comes_first_where_no_change_mends(head, fitter, fault):
    planted = faults.planted(fault, 0)
    reason = diagnose_frame(head, planted.case, fitter).reasons[0]
    assert reason.code == planted.code
    assert 0.3 <= reason.score <= 1.0
    assert any(character.isdigit() for character in reason.evidence)


@pytest.fixture(scope="module")
def recorded():
    """The points of a clip of 60 frames, as a landmark file holds them."""
    return np.stack([record.landmarks.points for record in read_landmark_file(sample("performance-landmarks"))][:60])


def session_on(points, head, name="joint", **sections):
    observations = tuple(faults.observations_of(points))
    pictures = PictureStore(None, [faults.clip().size] * len(observations))
    config = faults.good_config(name).changed(**sections)
    return TuningSession(head, Material("clip", observations, pictures, stills=False), config)


@pytest.mark.parametrize(
    ("bad", "identity", "changed"),
    [(6, {"window": 8}, {"window": 60}), (0, {"calibrate": False}, {"calibrate": True}), (12, {"window": 60}, None)],
    ids=["a bad beginning", "no calibration", "the whole shot already"],
)
def test_another_identity_is_promised_where_a_setting_brings_it(head, recorded, bad, identity, changed):
    points, middle = recorded.copy(), recorded.mean(axis=1, keepdims=True)
    points[:bad] = ((points - middle) * [1.35, 0.8] + middle)[:bad]
    session = session_on(points, head, identity=identity)
    reason = next(item for item in session.diagnose(45).reasons if item.code == "wrong_identity")
    if changed is None:
        assert reason.change is None
        assert reason.after_percent == reason.before_percent
        assert "Settings do not bring it" in reason.evidence
        return
    assert reason.change.config == {"identity": changed}
    assert reason.after_percent < 0.7 * reason.before_percent
    session.apply(reason.change, 45)
    assert session.fit_frame(45).errors[2] == pytest.approx(reason.after_percent, rel=0.05)


def test_a_shot_in_mirrored_order_is_told_and_no_change_of_one_frame_is_offered_for_it(head, fitter):
    case = faults.planted("mirrored shot", 0).case
    reason = diagnose_frame(head, case, fitter).reasons[0]
    assert "in the whole shot" in reason.evidence
    assert reason.change is None
    assert reason.after_percent == reason.before_percent


def test_a_face_that_is_wholly_outside_is_told_and_not_muted(head, recorded):
    points = recorded[:20].copy()
    points[10] += [2000.0, 0.0]
    reason = next(item for item in session_on(points, head).diagnose(10).reasons if item.code == "face_outside")
    assert reason.change is None
    assert "the others" not in reason.evidence


@pytest.mark.parametrize("fault", ["shifted jaw", "occluded mouth", "face out of frame"])
def test_a_change_of_a_weight_says_that_it_holds_in_all_frames(head, fitter, fault):
    reasons = diagnose_frame(head, faults.without_pictures(faults.planted(fault, 0).case), fitter).reasons
    labels = [item.change.label for item in reasons if item.change and "landmarks" in item.change.config]
    assert labels
    assert all(label.endswith("in all frames") for label in labels)


def test_landmarks_that_do_not_count_at_all_are_diagnosed(head, recorded):
    session = session_on(recorded[:20], head, landmarks={"weights": {"all": 0.0}})
    assert "wrong_focal" not in [item.code for item in session.diagnose(10).reasons]


def test_a_dark_photo_is_compared_with_no_frames(head, recorded):
    (observation,) = faults.observations_of(recorded[:1])
    config = faults.good_config()
    context = FrameContext(0, FaceItFitter(head, plan_of(config)).mean_identity(), None, None)
    black = np.zeros((480, 640, 3), np.uint8)
    found = diagnose_frame(head, FrameCase(observation, context, config, (observation,), picture=black))
    (reason,) = (item for item in found.reasons if item.code == "dark_face")
    assert reason.evidence == "Its median lightness is 0 of 255."


@pytest.mark.parametrize("place", [1, 4, 7], ids="{} frames after the freeze began".format)
def test_thawed_landmarks_move_with_the_picture_wherever_the_frame_is_in_the_freeze(head, config, fitter, place):
    landmarks = faults.clip().landmarks
    steps = np.linalg.norm(np.diff(landmarks, axis=0), axis=2).mean(axis=1)
    first = 20 + int(np.argmax(np.convolve(steps[20:-10], np.ones(9), "valid")))
    points = faults.clip().noisy(np.random.default_rng(9))
    points[first : first + 9] = points[first]
    found = diagnose_frame(head, faults.case_at(first + place, points, config), fitter)
    reason = next(reason for reason in found.reasons if reason.code == "frozen_detector")
    assert reason.after_percent < 0.65 * reason.before_percent


def test_black_pictures_say_nothing_of_blur(head, config, clean, fitter):
    case = clean_case(clean, config, 104)
    black = np.zeros_like(case.picture)
    blank = replace(case, picture=black, previous_picture=black, pictures=lambda index: black)
    assert "blurred_face" not in [reason.code for reason in diagnose_frame(head, blank, fitter).reasons]


@pytest.mark.parametrize("index", [40, 104, 170, 214])
def test_a_clean_frame_has_no_reason(head, config, clean, fitter, reference, index):
    found = diagnose_frame(head, clean_case(clean, config, index), fitter, reference)
    assert found.reasons == ()
    assert found.summary == "No reason found: the frame is unremarkable"
    assert found.fit.index == index


def test_a_clean_frame_has_no_reason_without_pictures_and_without_a_shot(head, config, clean, fitter):
    case = faults.without_pictures(clean_case(clean, config, 104))
    assert diagnose_frame(head, case, fitter).reasons == ()
    assert diagnose_frame(head, replace(case, shot=()), fitter).reasons == ()


def test_without_pictures_less_is_said(head, fitter):
    case = faults.planted("motion blur", 0).case
    seen = diagnose_frame(head, case, fitter)
    unseen = diagnose_frame(head, faults.without_pictures(case), fitter)
    assert seen.reasons[0].code == "motion_blur"
    assert "motion_blur" not in [reason.code for reason in unseen.reasons]


def test_the_alternation_of_the_calibrated_preset_is_accused_where_the_truth_says_so(head):
    config = faults.good_config("calibrated")
    observations = faults.observations_of(faults.clip().noisy(np.random.default_rng(5)))
    fits = faults.follow(observations, config)
    worst = int(np.argmax([fit.errors[2] for fit, _ in fits]))
    found = diagnose_frame(head, FrameCase(observations[worst], fits[worst][1], config, observations))
    reason = found.reasons[0]
    assert reason.code == "pose_expression_tradeoff"
    mended, _ = FaceItFitter(head, plan_of(reason.change.apply_to(config))).fit(observations[worst], fits[worst][1])
    truth = faults.clip().parameters[worst].rotation
    before, after = (np.degrees(np.linalg.norm(fit.rotation - truth)) for fit in (found.fit, mended))
    assert after < 0.5 * before


def test_a_face_that_the_detector_hardly_sees_is_taken_from_the_nearest_frame_where_it_was_sure(
    head, config, clean, fitter
):
    observations = list(clean[0])
    for k in range(58, 63):
        landmarks = observations[k].landmarks
        observations[k] = replace(observations[k], landmarks=replace(landmarks, confidence=np.full(68, 0.01)))
    fits = faults.follow(observations, config)
    found = diagnose_frame(head, FrameCase(observations[61], fits[61][1], config, observations), fitter)
    reason = found.reasons[0]
    assert (reason.code, reason.title) == ("occluded", "The face is hardly visible")
    assert "mean confidence is 0.01" in reason.evidence
    assert reason.evidence.endswith("; the nearest frame where it is high is 63.")
    moved = reason.change.moved(observations[61]).landmarks
    np.testing.assert_array_equal(moved.points, observations[63].landmarks.points)
    assert (moved.confidence == 1.0).all()


def test_a_doubted_face_that_no_other_frame_replaces_is_told_by_the_part_that_is_muted(
    head, config, clean, fitter, reference
):
    observation, (_, context) = clean[0][60], clean[1][60]
    doubted = replace(observation, landmarks=replace(observation.landmarks, confidence=np.full(68, 0.35)))
    found = diagnose_frame(head, FrameCase(doubted, context, config, (doubted,)), fitter, reference)
    (reason,) = (reason for reason in found.reasons if reason.code == "doubted_part")
    part = reason.title.removeprefix("The detector doubts the ")
    assert part != "whole face"
    assert part in reason.change.label


def test_a_frame_without_landmarks_cannot_be_diagnosed(head, config, clean):
    observations, fits = clean
    case = FrameCase(replace(observations[7], landmarks=None), fits[7][1], config)
    for ask in (diagnose_frame, leave_one_group_out):
        with pytest.raises(InputError, match="needs landmarks, but frame 7 has none; choose"):
            ask(head, case)
    with pytest.raises(InputError, match="needs landmarks; none of these frames has any"):
        reference_of(head, config, [case.observation])


def test_diagnosing_leaves_the_fitter_as_it_was(head, config, clean, reference):
    plan = plan_of(config)
    fitter = FaceItFitter(head, plan)
    case = clean_case(clean, config, 60)
    before, _ = fitter.fit(case.observation, case.context)
    diagnose_frame(head, case, fitter, reference)
    after, _ = fitter.fit(case.observation, case.context)
    assert fitter.plan is plan
    np.testing.assert_array_equal(after.expression, before.expression)


# --- changes ---


def test_a_change_moves_only_its_points_and_leaves_the_observation(clean):
    observation = clean[0][10]
    moved = Change("Move two points", landmarks={3: (1.0, 2.0), 40: (5.0, 6.0)}).moved(observation)
    different = np.flatnonzero((moved.landmarks.points != observation.landmarks.points).any(axis=1))
    assert different.tolist() == [3, 40]
    assert moved.landmarks.points[40].tolist() == [5.0, 6.0]
    assert Change("Nothing").moved(observation) is observation


def test_a_change_keeps_the_rest_of_the_configuration():
    config = preset("calibrated").changed(landmarks={"weights": {"nose": 0.5}})
    change = Change("Mute the jaw", config={"landmarks": {"weights": {"jaw": 0.0}}}, limits={"pose": 40})
    changed = change.apply_to(config)
    assert changed.landmarks.weights == {"nose": 0.5, "jaw": 0.0}
    assert {stage.name: stage.limit for stage in changed.stages if stage.limit != 15} == {"pose": 40}
    assert Change("Nothing").apply_to(config) is config


def test_a_new_identity_starts_the_pose_afresh(clean):
    context = clean[1][50][1]
    identity = np.ones_like(context.identity)
    changed = Change("Calibrate", calibrate=True, identity=identity).applied(context)
    assert context.last is not None
    assert changed.last is None
    assert changed.identity is identity


# --- group pulls ---


def test_the_pull_of_a_biased_group_is_its_offset(head, config, clean, fitter):
    case = clean_case(clean, config, 30)
    shift = np.array([9.0, 0.0])
    points = case.observation.landmarks.points.copy()
    points[list(GROUPS["nose"])] += shift
    moved = Change("Move", landmarks={k: tuple(points[k]) for k in GROUPS["nose"]}).moved(case.observation)
    pulls = {pull.group: pull for pull in leave_one_group_out(head, replace(case, observation=moved), fitter)}
    assert set(pulls) == {"jaw", "right_brow", "left_brow", "nose", "eyes", "mouth"}
    percent = 100.0 / np.linalg.norm(points[45] - points[36])
    np.testing.assert_allclose(pulls["nose"].offset_percent, shift * percent, atol=1.0)
    others = [pull for group, pull in pulls.items() if group != "nose"]
    assert pulls["nose"].error_without_percent < 0.6 * pulls["nose"].error_with_percent
    assert all(name in head.expression_names for pull in others for name, _ in pull.weights)


# --- flags ---


def test_a_clean_clip_flags_nothing(head, config, clean):
    flags = flag_frames(track_of(clean[1], head), config)
    assert not flags.flagged.any()
    assert flags.text == ("",) * len(clean[0])


def test_weights_are_at_their_bound_where_the_models_range_ends(head, config, clean):
    fits = [fit for fit, _ in clean[1][:6]]
    count = len(head.expression_names)
    for weight in (1.0, 1.5, 3.0):
        fits[3] = replace(fits[3], expression=np.full(count, weight))
        both_ways = replace(head, expression_range=np.tile([-3.0, 3.0], (count, 1)))
        for model, bound in ((head, 1.0), (both_ways, 3.0)):
            meta = {"expression_names": list(head.expression_names), "model": model_record(model)}
            flags = flag_frames(Track(**stack_fits(fits), meta=meta), config)
            assert ("weights are at their bound" in flags.text[3]) == (weight >= bound)
    fits[3] = replace(fits[3], expression=np.full(count, -3.0))
    assert "weights are at their bound" in flag_frames(Track(**stack_fits(fits), meta=meta), config).text[3]


def test_flags_name_what_stands_out(head, config):
    points = faults.clip().noisy(np.random.default_rng(8))
    points[60:64] = points[59]
    points[100] = points[100][list(MIRROR)]
    points[150, :25] += np.array([0.0, -400.0])
    fits = faults.follow(faults.observations_of(points), config)
    flags = flag_frames(track_of(fits, head), config)
    assert "repeat the previous frame" in flags.text[60]
    assert not flags.flagged[59]
    assert "the pose jumps" in flags.text[100]
    assert "outside the picture" in flags.text[150]
    assert (flags.severity[flags.flagged] >= 0.5).all()
    assert (flags.severity[~flags.flagged] == 0.0).all()
    assert set(np.flatnonzero(flags.flagged)) <= {*range(60, 66), *range(98, 104), *range(148, 154)}


def test_filled_frames_that_stand_still_are_no_frozen_detector(head, config, clean):
    """As infill leaves them at the end of a shot without flow: all are like the last good one."""
    fits = list(clean[1][:20])
    for index in range(15, 20):
        filled = replace(fits[14][0], index=index, source="filled", confidence=np.zeros(68))
        fits[index] = replace(filled, observed=filled.projected), fits[index][1]
    assert not flag_frames(track_of(fits, head), config).flagged.any()


def test_frames_without_a_face_are_not_flagged(head, config, clean):
    observations = [replace(found, landmarks=None) if found.index in (5, 6) else found for found in clean[0][:20]]
    fitter, fits, last = FaceItFitter(head, plan_of(config)), [], None
    for observation in observations:
        fit, last = fitter.fit(observation, clean[1][observation.index][1]._replace(last=last))
        fits.append((fit, None))
    assert not flag_frames(track_of(fits, head)).flagged.any()


# --- evidence ---


def test_the_turning_of_a_face_is_that_of_its_points_however_it_is_turned(clean):
    for observation in clean[0][::20]:
        points = observation.landmarks.points
        assert turning(points) > 0.8
        assert turning(points[list(MIRROR)]) < -0.8
        assert turning((points - points.mean(0)) @ np.array([[0.0, 1.0], [-1.0, 0.0]])) > 0.8


def test_exchanged_points_are_found_in_pairs():
    predicted = np.random.default_rng(0).uniform(0, 400, (68, 2))
    points = predicted.copy()
    points[[20, 50]] = points[[50, 20]]
    points[30] += 60.0
    assert exchanged_pairs(points, predicted, 5.0) == [(20, 50)]


def test_the_size_of_a_face_does_not_depend_on_the_order_of_its_points(clean):
    points = clean[0][0].landmarks.points
    assert face_size(points) == pytest.approx(face_size(points[list(MIRROR)]))
    assert face_size(points) == pytest.approx(np.linalg.norm(points[45] - points[36]), rel=0.1)


def test_flow_carries_points_with_the_picture():
    clip = faults.clip()
    carried = carried_by_flow(clip.pictures[39], clip.pictures[40], clip.landmarks[39], 140.0)
    moved = np.linalg.norm(clip.landmarks[40] - clip.landmarks[39], axis=1)
    away = np.linalg.norm(carried - clip.landmarks[40], axis=1)[17:]
    assert np.isfinite(away).mean() > 0.7
    assert np.nanmedian(away) < 0.5
    assert np.median(moved) > 2.0 * np.nanmedian(away)


@pytest.mark.parametrize("angle", [0.0, 60.0, 135.0])
def test_the_direction_of_a_blur_is_found(angle):
    clip, direction = faults.clip(), np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    blurred = faults.smeared(clip.pictures[30], direction, 20.0)
    sharp, soft = (gradient_energy(picture, clip.landmarks[30], 140.0) for picture in (clip.pictures[30], blurred))
    found = directional_blur(soft, sharp)
    assert abs(found.direction @ direction) > 0.95
    assert found.sharpness < 0.3 < found.across


def test_the_best_focal_length_is_between_the_tried_ones():
    factors = np.array([0.5, 1.0, 2.0])
    factor, cost = best_factor(factors, 100.0 + 50.0 * np.log(factors / 1.3) ** 2)
    assert factor == pytest.approx(1.3)
    assert cost == pytest.approx(100.0)
    assert fov_with(60.0, 1.0) == 60.0
    assert np.tan(np.radians(fov_with(60.0, 2.0) / 2)) == pytest.approx(0.5 * np.tan(np.radians(30.0)), rel=1e-2)
