"""Infill and refinement in the tuning session: marking, running, comparing, taking back, exporting."""

import shlex
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from workbench.cli import app
from workbench.config import preset, read_config
from workbench.energies.systems import SYSTEMS
from workbench.errors import InputError, StoppedError
from workbench.frames import FrameRange, open_frames
from workbench.pipeline.temporal_run import work_over
from workbench.samples import sample
from workbench.session import (
    Material,
    TuningSession,
    load_material,
    material_of_photo,
    material_of_track,
    open_session,
    temporal,
)
from workbench.session.curves import curve, moving_weights
from workbench.session.material import PictureStore
from workbench.session.parts import parts_of, parts_text, read_parts
from workbench.session.worked import name_of
from workbench.tracking import Track
from workbench.tracking.flow_solver import solve_flow
from workbench.tracking.records import stack_fits
from workbench.tracking.unwatched import never

QUICK = preset("calibrated").changed(identity={"window": 6, "frames": 6}, flow={"side": 128, "points": 64})
COUNT, GAP = 24, (10, 13)


@pytest.fixture(scope="module")
def material():
    """The first second of the sample clip with its pictures; one frame without a face."""
    whole = load_material(sample("performance"), QUICK, sample("performance-landmarks"))
    observations = list(whole.observations[:COUNT])
    observations[18] = type(observations[18])(18, None, observations[18].image_size)
    frames = FrameRange(open_frames(sample("performance")), 0, COUNT - 1)
    pictures = PictureStore(frames, [item.image_size for item in observations])
    return Material("clip", tuple(observations), pictures, stills=False, inputs=(sample("performance"),))


@pytest.fixture(scope="module")
def fitted(head, material):
    """Fitted once; sessions of the tests start from its run."""
    session = TuningSession(head, material, QUICK)
    session.fit_clip()
    return session


@pytest.fixture
def session(head, material, fitted):
    made = TuningSession(head, material, QUICK)
    made.runs.last = fitted.run
    return made


def same(first, second):
    """Whether two rows of fits agree to the bit."""
    names = ("rotation", "translation", "expression", "projected", "observed", "source")
    rows = zip(first, second, strict=True)
    return all(np.array_equal(getattr(a, name), getattr(b, name), equal_nan=name != "source")
               for a, b in rows for name in names)  # fmt: skip


# --- marking ---


def test_parts_are_read_as_they_are_written():
    assert read_parts("40-52, 60 70–71") == ((40, 52), (60, 60), (70, 71))
    assert parts_of([60, 41, 40, 42]) == ((40, 42), (60, 60))
    assert parts_text(((40, 42), (60, 60))) == "40-42, 60"
    assert parts_text([(2 * k, 2 * k) for k in range(9)]) == "0, 2, 4, 6, 8, 10 and 3 more"
    for text in ("52-40", "frame 3", "4-"):
        if text == "4-":
            assert read_parts(text) == ((4, 4),)
            continue
        with pytest.raises(InputError, match="Write frames as 40-52 or 60, got"):
            read_parts(text)


def test_frames_are_marked_by_hand_and_every_mark_is_one_step_of_undo(session):
    session.temporal.mark(range(10, 14))
    session.temporal.mark([14, 20])
    assert session.temporal.marked == session.config.infill.frames == ((10, 14), (20, 20))
    session.temporal.unmark([12])
    assert session.temporal.marked == ((10, 11), (13, 14), (20, 20))
    assert session.undo() == "not failed: 12"
    assert session.undo() == "failed: 14, 20"
    assert session.temporal.marked == ((10, 13),)


def test_frames_outside_the_clip_cannot_be_marked(session):
    with pytest.raises(InputError, match="There is no frame 24; the clip has frames 0 to 23"):
        session.temporal.mark([3, 24])


def test_frames_without_a_face_have_failed_without_being_marked(session):
    session.temporal.mark(range(10, 14))
    assert session.temporal.failed() == (10, 11, 12, 13, 18)
    assert session.temporal.failed((0, 11)) == (10, 11)


def test_diagnosis_marks_the_frames_that_it_flags(session):
    session.move(5, 30, (10.0, 10.0))
    session.set(landmarks={"moved": {"5": {str(point): (40.0 + point, 30.0) for point in range(17, 48)}}})
    flagged = session.temporal.mark_flagged()
    assert 5 in flagged
    assert session.temporal.marked == parts_of(flagged)
    assert session.undo_label.startswith("flagged as failed: ")


# --- running ---


def test_infill_fills_the_marked_frames_and_leaves_the_others(session):
    session.temporal.mark(range(GAP[0], GAP[1] + 1))
    session.set(infill={"method": "flow"})
    worked = session.temporal.run()
    assert worked.filled == (10, 11, 12, 13, 18)
    assert same([worked.after[5]], [worked.before[5]])
    before, after = worked.pair(11)
    assert (before.source, after.source) == ("given", "filled")
    assert np.abs(after.projected - before.projected).mean() < 5.0
    assert session.temporal.current is worked
    numbers = worked.numbers()
    assert numbers["filled"] == 5
    assert 0.0 < numbers["hidden_percent"] < 10.0


def test_a_run_has_the_bits_of_the_pipeline(session, material, head, fitted):
    session.set(infill={"method": "linear"}, refinement={"method": "hybrid", "reestimate": 1})
    worked = session.temporal.run()
    track = Track(meta={}, **stack_fits(list(fitted.run.fits)))
    expected = work_over(track, [material.pictures.frames], head, session.config)
    assert same(worked.after, [expected[k] for k in range(COUNT)])


def test_a_part_is_worked_on_alone(session):
    session.set(refinement={"method": "averaging"})
    worked = session.temporal.run((4, 9))
    assert [fit.index for fit in worked.after] == list(range(4, 10))
    assert worked.pair(3) is None
    assert same([worked.after[0]], [worked.before[0]])
    assert not same([worked.after[1]], [worked.before[1]])
    with pytest.raises(
        InputError, match="A part of this clip must be within 0-23 and have at least two frames, got 5-5"
    ):
        session.temporal.run((5, 5))


def test_a_cancelled_run_leaves_nothing_and_the_next_one_works(session):
    session.set(refinement={"method": "plate"})
    told = []

    def cancelled():
        return len(told) >= 3

    assert session.temporal.run(None, None, lambda *seen: told.append(seen), cancelled) is None
    assert len(told) == 3
    assert session.temporal.current is None
    session.set(refinement={"method": "averaging"})
    assert session.temporal.run() is not None


def test_progress_goes_from_the_first_solve_to_the_last(session):
    session.temporal.mark(range(10, 13))
    session.set(infill={"method": "flow"}, refinement={"method": "averaging"})
    told = []
    session.temporal.run(progress=lambda *seen: told.append(seen))
    assert told[0][0] == "infill"
    assert told[-1][0] == "refine"
    assert told[-1][1:] == (told[-1][2], told[-1][2])
    assert [done for _, done, _ in told] == sorted(done for _, done, _ in told)


def test_undo_brings_the_earlier_result_back(session):
    session.set(refinement={"method": "averaging"})
    first = session.temporal.run()
    session.set(refinement={"sweeps": 2})
    assert session.temporal.current is None
    second = session.temporal.run()
    assert (first.name, second.name) == ("averaging", "averaging ×2")
    session.undo()
    assert session.temporal.current is first
    assert session.temporal.run() is first


def test_settings_of_time_leave_the_fits_of_the_frames_alone(session):
    session.set(infill={"method": "flow"}, refinement={"method": "hybrid"}, flow={"stay": 5.0})
    assert not session.stale.any()
    session.set(weights={"tau": 3.0})
    assert session.stale.all()


def test_nothing_compiles_when_settings_move(session):
    session.set(refinement={"method": "plate"})
    session.temporal.run((2, 6))
    before = solve_flow._cache_size()
    session.temporal.mark([4])
    for changes in (
        {"refinement": {"method": "self", "prior": 2.0}},
        {"refinement": {"method": "plate", "order": "gauss-seidel", "sweeps": 2}},
        {"infill": {"method": "flow", "rounds": 2}, "flow": {"stay": 3.0, "robust": 2.0, "iterations": 4}},
    ):
        session.set(**changes)
        session.temporal.run((2, 6))
    assert solve_flow._cache_size() == before


def test_deep_energies_fits_the_frames_of_the_part_alone_and_once(session, fitted, monkeypatch):
    asked = []

    def fit_frame(frame, config, cancelled):
        asked.append(frame)
        return fitted.run.fits[frame]

    monkeypatch.setattr(session, "fit_frame", fit_frame)
    session.use(preset("deep").changed(refinement={"method": "averaging"}))
    assert session.temporal.run((4, 9), cancelled=lambda: len(asked) == 3) is None
    assert asked == [4, 5, 6]
    assert session.temporal.run((4, 9)).name == "averaging"
    session.set(refinement={"sweeps": 2})
    assert session.temporal.run((4, 9)).name == "averaging ×2"
    assert asked == [4, 5, 6, 7, 8, 9]


@pytest.mark.parametrize("part", [(4, 9), (14, 19)])
def test_a_part_whose_frames_continue_each_other_has_the_fits_of_the_whole_clip(part, head, material, monkeypatch):
    second = replace(material.observations[12], cut=True)
    material = replace(material, observations=(*material.observations[:12], second, *material.observations[13:]))
    linked = QUICK.changed(weights={"tau": 5.0}, refinement={"method": "averaging"})
    expected = TuningSession(head, material, linked).temporal.run(part)
    monkeypatch.setitem(SYSTEMS, "face-it", replace(SYSTEMS["face-it"], real_time=False))
    session = TuningSession(head, material, linked.changed(weights={"tau": 0.0}))
    session.fit_clip()
    session.use(linked)
    counted = []
    assert (
        session.temporal.run(part, cancelled=lambda: len(counted) == 3, progress=lambda *of: counted.append(of)) is None
    )
    found = session.temporal.run(part)
    assert same(found.before, expected.before)
    assert same(found.after, expected.after)


# --- comparing ---


def test_all_methods_are_compared_and_kept(session):
    session.temporal.mark(range(5, 8))
    session.set(infill={"method": "linear"})
    steps = set()
    made = session.temporal.compare((2, 10), lambda step, done, total: steps.add(step.partition(":")[0]))
    expected = ["flow", "linear", "spline", *(f"linear + {name}" for name in ("averaging", "self", "plate", "hybrid"))]
    assert [worked.name for worked in made] == expected
    assert set(session.temporal.comparable()) == set(expected)
    assert session.temporal.current.name == "linear"
    whole = session.temporal.run()
    assert session.temporal.comparable() == {"linear": whole}
    assert set(session.temporal.comparable((2, 10))) == set(expected)
    assert session.temporal.result((2, 10)) is made[1]
    assert {"1 of 7", "7 of 7"} <= steps
    session.set(infill={"method": "spline"})
    assert session.temporal.current.name == "spline"
    session.temporal.unmark([5])
    assert session.temporal.comparable() == {}


def test_results_of_other_settings_of_a_method_are_not_compared(session):
    session.set(refinement={"method": "averaging", "centre": 0.9})
    first = session.temporal.run()
    session.set(refinement={"centre": 0.1})
    second = session.temporal.run()
    assert session.temporal.comparable() == {"averaging": second}
    session.undo()
    assert session.temporal.comparable() == {"averaging": first} == {"averaging": session.temporal.current}


def test_without_a_failed_frame_refinements_alone_are_compared(session):
    names = [name_of(variant) for variant in session.temporal.variants(session.config, (0, 9))]
    assert names == ["averaging", "self", "plate", "hybrid"]


def test_curves_hold_the_pose_in_degrees_and_millimetres_and_the_weights(session, head, fitted):
    fits = fitted.run.fits
    yaw, depth = curve(fits, "yaw"), curve(fits, "z")
    assert np.isnan(yaw[18])
    assert yaw[3] == pytest.approx(fits[3].angles_deg[0])
    assert depth[3] == fits[3].translation[2]
    most = moving_weights(fits, head.expression_names, 2)
    assert np.nanstd(curve(fits, most[0], head.expression_names)) >= np.nanstd(
        curve(fits, most[1], head.expression_names)
    )


# --- what cannot be ---


def test_photos_have_no_neighbours_in_time(head, material):
    stills = TuningSession(head, Material("stills", material.observations[:3], material.pictures, stills=True), QUICK)
    photo = TuningSession(head, material_of_photo(material.pictures[0], material.observations[0].landmarks), QUICK)
    for session in (stills, photo):
        session.set(refinement={"method": "averaging"})
        with pytest.raises(InputError, match="need consecutive frames; open a clip, not photos"):
            session.temporal.run()


def test_nothing_chosen_and_nothing_to_look_at_are_said(head, material, session):
    with pytest.raises(InputError, match="No temporal method is chosen"):
        session.temporal.run()
    blank = PictureStore(None, [item.image_size for item in material.observations])
    blind = TuningSession(head, Material("points", material.observations, blank, stills=False), QUICK)
    blind.set(refinement={"method": "plate"})
    with pytest.raises(InputError, match="'plate' needs pictures, and this material has only landmarks"):
        blind.temporal.run()
    names = [name_of(variant) for variant in blind.temporal.variants(blind.config, (0, 9))]
    assert names == ["averaging", "self"]


def test_the_fits_of_a_clip_are_those_of_its_configuration_whatever_is_run_meanwhile(head, material):
    session, other = TuningSession(head, material, QUICK), QUICK.changed(weights={"tau": 9.0})
    stop = session.listen(lambda what: (stop(), session.fit_clip(config=other)) if what == "run" else None)
    fits = session.temporal.fits_by(QUICK)
    assert session.run.config == other
    assert same(fits, TuningSession(head, material, QUICK).track_fits())


def test_cancelling_where_a_fit_takes_seconds_does_not_wait_for_its_end(head, material, monkeypatch):
    session, asked = TuningSession(head, material, preset("deep-points")), []

    def cancelled():
        asked.append(True)
        return len(asked) > 1

    def slow(frame, coarse=False, config=None, cancelled=never):
        assert cancelled()
        raise StoppedError("The fit was cancelled.")

    monkeypatch.setattr(session, "fit_frame", slow)
    session.set(infill={"method": "linear"})
    assert session.temporal.run((0, 5), cancelled=cancelled) is None


# --- export ---


def test_an_exported_configuration_gives_the_same_bits_on_the_command_line(head, tmp_path):
    clip = tmp_path / "clip.csv"
    clip.write_text("\n".join(sample("performance-landmarks").read_text().splitlines()[:31]) + "\n")
    session = open_session(clip, QUICK, model=head)
    session.temporal.mark(range(10, 14))
    session.set(infill={"method": "spline"}, refinement={"method": "self", "sweeps": 2, "reestimate": 1})
    file = session.export(tmp_path / "tuned.toml")
    stored = read_config(file)
    assert stored.infill.frames == ((10, 13),)
    worked = session.temporal.current
    assert stored.provenance.after["jitter_deg"] == pytest.approx(worked.numbers()["jitter_deg"])
    command = [*shlex.split(session.command(file))[1:], "--no-pictures", "--out", str(tmp_path / "again")]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    again = Track.load(tmp_path / "again" / "track.npz")
    assert same(worked.after, [again[k] for k in range(len(again))])


def test_an_unchanged_configuration_is_exported_with_the_same_metrics_before_and_after(
    head, material, tmp_path, monkeypatch
):
    once, over_time = [], temporal.over_time
    monkeypatch.setattr(temporal, "over_time", lambda *given: once.append(None) or over_time(*given))
    base = QUICK.changed(refinement={"method": "averaging"})
    other = TuningSession(head, material, base)
    provenance = read_config(other.export(tmp_path / "tuned.toml")).provenance
    assert provenance.changed == []
    assert provenance.before == provenance.after
    assert len(once) == 1
    assert provenance.after["jitter_deg"] == other.temporal.current.numbers()["jitter_deg"]
    assert other.run.config == base


def test_a_cancelled_export_writes_nothing(session, tmp_path):
    session.set(refinement={"method": "plate"})
    with pytest.raises(InputError, match=r"The export was cancelled; .*tuned\.toml was not written"):
        session.export(tmp_path / "tuned.toml", cancelled=lambda: True)
    assert not (tmp_path / "tuned.toml").exists()


def test_a_track_of_a_part_shows_the_pictures_of_that_part(head, fitted, material):
    track = fitted.track
    meta = {**track.meta, "inputs": [{"path": str(sample("performance"))}], "frames": [7, 7 + COUNT - 1]}
    tuned_on = material_of_track(Track(meta=meta, **stack_fits(list(fitted.run.fits))))
    np.testing.assert_array_equal(tuned_on.pictures[0], material.pictures[7])
