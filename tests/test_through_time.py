"""The papers' figures over time, remade: a film whose detector fails on purpose, its solves, gaps and truth."""

from dataclasses import replace

import numpy as np
import pytest

from tests.films import film_config, landmark_error_px, lost
from workbench.errors import InputError
from workbench.frames import write_picture
from workbench.geometry import write_rig, yaw_pitch_roll_deg
from workbench.landmarks.observations import Landmarks2D
from workbench.planning import plan_of
from workbench.reproduction import Study, film_solves, gaps
from workbench.reproduction.clip_through_time import failing_frames, good_frames, hidden_gaps
from workbench.reproduction.film_solves import ONE_POINTS, TWO, film_parameters, solved
from workbench.reproduction.gaps import FLOW, LINEAR, SPLINE, fill_gap, flow_figure
from workbench.reproduction.stereo_film import AWAY_MM, AXES, two_cameras
from workbench.reproduction.talking_film import FULL, QUICK, TalkingFilm, Timeline, performance, talking_film
from workbench.reproduction.through_time import flow_form_settings
from workbench.tracking import FrameObservation, Track
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.records import stack_fits

SMALL = Timeline(8, (64, 48), opened=1, shut=4, blink=5, nod=6, lost=range(3, 5), stuck=range(6, 8))


def snapping(index: int):
    """A mouth that snaps shut between frames 7 and 9, and a head that jerks about frame 14."""
    jaw = float(np.interp(index, [7, 8, 9], [0.6, 0.15, 0.0]))
    return {"jawOpen": jaw}, (12.0 / (1.0 + np.exp(-3.0 * (index - 14.5))), 0.0, 0.0), (0.4 * index, 0.0, 0.0)


@pytest.fixture(scope="module")
def snap(film_maker):
    """A film whose truth is known: its fits as a track, and its pictures by frame."""
    film = film_maker.film(18, snapping)
    return film, Track(meta={}, **stack_fits(list(film.truth))), [(picture,) for picture in film.pictures]


@pytest.fixture
def talking(head, tmp_path):
    """A small talking film without its person: plain pictures, and landmarks that count the frames."""
    rig, folder = two_cameras(SMALL.size), tmp_path / "film"
    for name in rig.names:
        for k in range(SMALL.frames):
            write_picture(folder / name / f"{k:04d}.png", np.full((48, 64, 3), 10 * k, np.uint8))
    write_rig(rig, folder / "rig.toml")
    seen = tuple(
        tuple(Landmarks2D(np.full((68, 2), 100.0 * view + k), np.ones(68), SMALL.size) for k in range(SMALL.frames))
        for view in range(2)
    )
    identity = 0.3 * np.ones(len(head.identity_deltas))
    return TalkingFilm(SMALL, folder, rig, identity, performance(head.expression_names, SMALL), seen)


class PerfectFitter:
    """Stands in for `DeepFitter`: finds what was rendered, at once, and counts."""

    fitted: tuple[int, ...] = ()
    fails_at: int | None = None

    def __init__(self, head, plan):
        self.like = self.record
        self.plan = plan

    def appearance(self, observations, identity):
        return None

    def fit(self, observation: FrameObservation, context):
        if observation.index == PerfectFitter.fails_at:
            raise KeyboardInterrupt
        PerfectFitter.fitted += (observation.index,)
        fit = replace(self.like, index=observation.index, others=np.zeros((len(observation.others), 68, 3)))
        return (fit if observation.faces else lost(fit)), None


@pytest.fixture
def perfect(monkeypatch, film_maker, head, talking):
    """The stand-in in place of the real one; its record is the film's frame 0."""
    fit = film_maker.film(1, lambda index: ({}, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))).truth[0]
    truth = film_parameters(talking, 0)
    parts = {name: np.asarray(getattr(truth, name), float) for name in ("rotation", "translation", "expression")}
    monkeypatch.setattr(PerfectFitter, "record", replace(fit, identity=talking.identity, **parts), raising=False)
    monkeypatch.setattr(PerfectFitter, "fitted", ())
    monkeypatch.setattr(film_solves, "DeepFitter", PerfectFitter)
    return PerfectFitter


# The film.


@pytest.mark.parametrize("timeline", [FULL, QUICK])
def test_the_mouth_stays_open_and_is_shut_at_once_while_the_gap_is_hidden(head, timeline):
    motion = performance(head.expression_names, timeline)
    jaw = motion.expression[:, head.expression_names.index("jawOpen")]
    first, second, third = timeline.gap
    assert jaw[first] == jaw[second] == jaw.max() > 0.5
    assert jaw[third] < 0.3 * jaw[second]
    assert jaw[timeline.shut] == 0.0
    assert np.abs(motion.expression[0]).max() < 0.05
    np.testing.assert_allclose(motion.translation_mm[0], [0.0, 0.0, AWAY_MM])


def test_the_person_blinks_while_nothing_is_detected_and_nods_while_the_detector_sticks(head):
    motion = performance(head.expression_names, FULL)
    lids = motion.expression[:, head.expression_names.index("eyeBlinkLeft")]
    assert (lids[[*FULL.lost]] > 0.8).all()
    pitch = yaw_pitch_roll_deg(motion.rotation)[:, 1]
    assert abs(pitch[FULL.stuck[-1]] - pitch[FULL.stuck[0] - 1]) > 5.0
    assert not {*FULL.gap} & {*FULL.lost, *FULL.stuck}


def test_a_stuck_detector_repeats_itself_in_both_views_and_a_lost_face_is_in_none(talking):
    observations = talking.observations()
    assert [one.index for one in observations if not one.faces] == [3, 4]
    front = [one.landmarks.points[0, 0] for one in observations if one.faces]
    side = [one.others[0].points[0, 0] for one in observations if one.faces]
    assert front == [0.0, 1.0, 2.0, 5.0, 5.0, 5.0]
    assert side == [100.0, 101.0, 102.0, 105.0, 105.0, 105.0]
    assert [one.index for one in observations if one.picture is not None] == [0]


def test_a_film_that_was_made_is_read_and_a_damaged_one_named(head, tmp_path, talking):
    study = Study(tmp_path, quick=True)
    shape = (2, QUICK.frames, 68)
    confidence = np.ones(shape)
    confidence[1, 3] = 0.0
    np.savez(tmp_path / "film" / "film.npz", points=np.ones((*shape, 2)), confidence=confidence, identity=np.ones(4))
    film = talking_film(head, study)
    assert film.timeline == QUICK
    assert [[each is None for each in view].index(True) for view in film.seen[1:]] == [3]
    assert all(each is not None for each in film.seen[0])
    (tmp_path / "film" / "film.npz").write_bytes(b"no film")
    with pytest.raises(InputError, match=r"film\.npz cannot be read as a film .*; delete .*film and run again\."):
        talking_film(head, study)


# Its solves.


def test_solves_know_the_truth(head, tmp_path, talking, perfect):
    solve = solved(talking, head, ONE_POINTS, Study(tmp_path))
    np.testing.assert_allclose(solve.errors(solve.truth), 0.0, atol=1e-9)
    off = solve.errors(solve.track)
    np.testing.assert_allclose(off[0], 0.0, atol=1e-9)
    assert np.isnan(off[[3, 4]]).all()
    motion = talking.motion
    np.testing.assert_allclose(
        off[2, :3], yaw_pitch_roll_deg(motion.rotation[0]) - yaw_pitch_roll_deg(motion.rotation[2]), atol=1e-9
    )
    np.testing.assert_allclose(off[2, 3:6], motion.translation_mm[0] - motion.translation_mm[2], atol=1e-9)
    assert off[2, len(AXES)] < -15.0  # the mouth is open by then


def test_an_interrupted_solve_goes_on_behind_the_last_frames_that_it_kept(
    head, tmp_path, talking, perfect, monkeypatch
):
    study = Study(tmp_path)
    monkeypatch.setattr(perfect, "fails_at", 6)
    with pytest.raises(KeyboardInterrupt):
        solved(talking, head, ONE_POINTS, study)
    monkeypatch.setattr(perfect, "fails_at", None)
    whole = solved(talking, head, ONE_POINTS, study).track
    assert perfect.fitted == (0, 1, 2, 3, 4, 5, 4, 5, 6, 7)
    again = solved(talking, head, ONE_POINTS, study).track
    assert len(perfect.fitted) == 10
    np.testing.assert_array_equal(again.rotation, whole.rotation)


def test_another_series_and_another_film_are_solved_on_their_own(head, tmp_path, talking, perfect):
    study = Study(tmp_path)
    one = solved(talking, head, ONE_POINTS, study)
    two = solved(talking, head, TWO, study)
    assert len(perfect.fitted) == 16
    assert [solve.track.others.shape[1] for solve in (one, two)] == [0, 1]
    assert [len(solve.pictures[0]) for solve in (one, two)] == [1, 2]
    solved(replace(talking, timeline=SMALL._replace(nod=5)), head, ONE_POINTS, study)
    assert len(perfect.fitted) == 24


def test_a_track_that_was_worked_on_is_kept(head, tmp_path, talking, perfect, monkeypatch):
    solve = solved(talking, head, ONE_POINTS, Study(tmp_path))
    calls = []

    def work_over(track, views, head, config, steps, progress):
        calls.append((*steps, config.infill.method, config.refinement.method))
        return track

    monkeypatch.setattr(film_solves, "work_over", work_over)
    for _ in range(2):
        solve.worked("hybrid", reestimated=True)
    assert calls == [("infill", "flow", "none"), ("refine", "none", "hybrid"), ("reestimate", "none", "none")]


# Gaps.


@pytest.fixture(scope="module")
def fitter(film_maker):
    return FlowFitter(film_maker.head, plan_of(film_config()))


def test_flow_fills_a_gap_better_than_a_line_and_is_timed(snap, fitter):
    film, track, pictures = snap
    gap = range(6, 9)
    filled = {method: fill_gap(fitter, track, pictures, gap, method) for method in (LINEAR, SPLINE, FLOW)}
    errors = {
        method: np.mean([landmark_error_px(fit, film.truth[fit.index]) for fit in each.fits])
        for method, each in filled.items()
    }
    assert errors[FLOW] < 0.5 * errors[LINEAR]
    for each in filled.values():
        assert [fit.index for fit in each.fits] == [*gap]
        assert {fit.source for fit in each.fits} == {"filled"}
        assert each.seconds > 0.0


def test_what_compiles_beforehand_takes_one_iteration_and_what_is_timed_all(snap, fitter, monkeypatch):
    _, track, pictures = snap
    asked = []

    def fill(fitter, before, after, inside):
        asked.append((fitter.plan.flow.iterations, len(inside)))
        return [parameters_of(before.fit)] * len(inside)

    monkeypatch.setattr(gaps, "fill_by_flow", fill)
    fill_gap(fitter, track, pictures, range(6, 9), FLOW)
    assert asked == [(1, 1), (8, 3)]


@pytest.mark.parametrize("quick", [False, True])
def test_forms_of_the_flow_say_how_large_their_cut_outs_are(quick):
    """The network's derivative is compared with a row of the same side."""
    forms = flow_form_settings(quick)
    sides = {label: changes["flow"]["side"] for label, changes in forms.items()}
    assert all(label.endswith(f", {side} px") for label, side in sides.items())
    through = {side for label, side in sides.items() if forms[label]["flow"].get("renders") == "network"}
    cheap = {side for label, side in sides.items() if "photos by the network" in label}
    assert through <= cheap


def test_a_gap_is_filled_from_good_fits_alone(snap, fitter):
    film, _, pictures = snap
    fits = [replace(fit, failure="large error") if fit.index == 9 else fit for fit in film.truth]
    track = Track(meta={}, **stack_fits(fits))
    for gap in (range(6, 9), range(16, 18)):
        with pytest.raises(InputError, match=f"right after frames {gap.start} to {gap.stop - 1}"):
            fill_gap(fitter, track, pictures, gap)


@pytest.mark.parametrize("renders", ["exact", "estimated"])
def test_the_figure_of_a_gap_shows_the_flow_that_is_compared(film_maker, snap, renders):
    """Where the head stands still but for its mouth, flows are pale but for the mouth."""
    film, track, _ = snap
    fitter = FlowFitter(film_maker.head, plan_of(film_config(flow={"renders": renders})))
    figure = flow_figure(fitter, [track[k] for k in range(6, 10)], [film.pictures[k] for k in range(6, 10)])
    panels = np.array([axis.images[0].get_array() for axis in figure.axes])
    rows = panels.reshape(4, 4, *panels.shape[1:])
    titles = [axis.get_title() for axis in figure.axes[:4]]
    assert titles == ["frame 6, anchor", "frame 7", "frame 8", "frame 9, anchor"]
    assert (rows[1:3, 0] == 255).all()
    colour = 255.0 - rows[1:3, 1:3].min(axis=-1)
    about_the_mouth = colour[:, :, colour.shape[2] // 2 :].mean(axis=(2, 3))
    assert (about_the_mouth[:, 1] > 2.0 * about_the_mouth[:, 0]).all()


def test_a_film_can_be_filled_with_other_flow_settings(head, tmp_path, talking, perfect, monkeypatch):
    """What compares forms of the flow energy on one gap: errors and seconds for each."""
    solve, plans = solved(talking, head, ONE_POINTS, Study(tmp_path)), []

    def fill(fitter, track, pictures, frames, method):
        plans.append(fitter.plan.flow)
        return film_solves.FilledGap(frames, tuple(solve.truth[k] for k in frames), 0.5)

    monkeypatch.setattr(film_solves, "fill_gap", fill)
    for changes in ({}, {"flow": {"renders": "estimated", "side": 128}}):
        measured = solve.filled(SMALL.gap, FLOW, **changes)
        np.testing.assert_allclose(measured.errors, 0.0, atol=1e-9)
        assert measured.gap.seconds == 0.5
    assert [(plan.renders, plan.side) for plan in plans] == [("exact", 384), ("estimated", 128)]


# Clips.


def test_a_detector_fails_where_head_and_lips_move_most(snap):
    _, track, _ = snap
    stuck, lost_frames = failing_frames(track)
    assert len(stuck) == 2
    assert set(stuck) & {14, 15}
    assert 8 in lost_frames
    assert len(lost_frames) == 3


def test_gaps_are_hidden_between_good_fits(snap):
    film, track, _ = snap
    assert hidden_gaps(track, 3) == [range(4, 7), range(12, 15)]
    bad = [replace(fit, failure="large error") if fit.index == 7 else fit for fit in film.truth]
    assert hidden_gaps(Track(meta={}, **stack_fits(bad)), 3) == [range(12, 15)]


def test_only_the_first_shot_with_a_face_counts(snap):
    film, _, _ = snap
    fits = [replace(fit, shot=int(fit.index >= 2) + int(fit.index >= 13)) for fit in film.truth]
    fits = [replace(fit, failure="large error") if fit.index < 2 else fit for fit in fits]
    good = good_frames(Track(meta={}, **stack_fits(fits)))
    assert np.flatnonzero(good).tolist() == [*range(2, 13)]


def test_a_clip_without_enough_of_a_face_is_refused(snap):
    film, _, _ = snap
    fits = [replace(fit, failure="large error") if fit.index % 3 == 0 else fit for fit in film.truth]
    with pytest.raises(InputError, match=r"Too few of the clip's first 18 frames have a face .*; name another clip"):
        failing_frames(Track(meta={}, **stack_fits(fits)))
