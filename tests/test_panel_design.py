"""The panel's design without a browser: plain words, marked starts, search, transport, one colour scale, export."""

import io
import shlex
import threading
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import ipywidgets as widgets
import numpy as np
import pytest

from tests.scenes import turning_clip
from workbench.config import Config, differences, preset, read_config
from workbench.errors import InputError
from workbench.export import export_track
from workbench.export.suffixes import pictures_folder
from workbench.session import TuningSession, material_of_track
from workbench.session.comparing import surface
from workbench.session.knob_words import WORDS, plain_words
from workbench.session.knobs import KNOBS
from workbench.session.performance import performance_commands, performance_track
from workbench.widgets import TuningPanel, panel_page
from workbench.widgets.alarms import ALARMS, Alarm, Alarms
from workbench.widgets.changes_page import change_words, comparison_html
from workbench.widgets.controls import Controls
from workbench.widgets.export_bar import ExportBar
from workbench.widgets.export_dialog import ExportDialog
from workbench.widgets.head_column import FACELESS
from workbench.widgets.knob_control import CHANGED, KnobControl
from workbench.widgets.overlay_view import OverlayView
from workbench.widgets.panel_page import packed
from workbench.widgets.performance_export import PerformanceExport
from workbench.widgets.shared_scale import SharedScale
from workbench.widgets.slow_jobs import SlowJobs
from workbench.widgets.status_line import WRONG, degrees, status_of
from workbench.widgets.timeline_view import TimelineView
from workbench.widgets.waiting import OLD, PATIENCE_S, Job, Waiting, text_of

BY_PATH = {knob.path: knob for knob in KNOBS}
FRAMES = 9


@pytest.fixture(scope="module")
def clip(head):
    return turning_clip(head, FRAMES, -8.0)


@pytest.fixture(scope="module")
def shared_panel(head, clip):
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(TuningSession, "warm_up", lambda session: None)
        made = TuningPanel(TuningSession(head, clip), backend="webgl")
        assert made.wait_idle(550)
        yield made
        made.close()


@pytest.fixture
def panel(shared_panel):
    """One panel for all tests, brought back to the start."""
    yield shared_panel
    shared_panel.session.use(shared_panel.session.base)
    shared_panel.transport.mark("whole")
    shared_panel.overlay.view.scale_max = 0.0
    shared_panel.head.color.value = "skin"
    shared_panel.go(0)
    assert shared_panel.wait_idle(60)


# --- settings ---


@pytest.mark.parametrize("knob", KNOBS, ids=lambda knob: knob.path)
def test_every_setting_has_a_plain_name_and_says_what_it_does_before_its_equation(knob):
    assert knob.path in WORDS or knob.path.startswith("group.")
    effect, equation = knob.help.split("\n")
    assert effect == knob.words.effect
    assert effect.endswith(".")
    assert equation == knob.tip
    assert len(knob.words.name) <= 24  # beside the number, in the width of the settings


def test_a_setting_of_a_new_term_is_called_what_the_term_says():
    assert plain_words("weights.neighbours", "neighbouring weights alike").name == "neighbouring weights alike"


def test_no_words_are_left_of_a_setting_that_is_gone():
    assert set(WORDS) <= set(BY_PATH)


def test_the_start_is_marked_and_what_differs_from_it_is_highlighted_until_it_is_reset():
    turned = []
    control = KnobControl(BY_PATH["identity.jaw"], lambda path, value: turned.append(value))
    control.show(0.75)
    control.begin_at(0.75)
    assert "fw-at-25" in control.widget._dom_classes  # of 0 to 3
    assert CHANGED not in control.widget._dom_classes
    control.input.value = 1.5
    assert CHANGED in control.widget._dom_classes
    control.reset()
    assert turned == [1.5, 0.75]
    assert CHANGED not in control.widget._dom_classes
    control.reset()
    assert turned == [1.5, 0.75]


def test_a_whole_number_stays_whole_when_it_is_typed():
    turned = []
    control = KnobControl(BY_PATH["rho"], lambda path, value: turned.append(value))
    control.show(15)
    control.readout.value = "7.6"
    assert turned == [8]
    assert type(turned[0]) is int


@pytest.fixture
def controls():
    return Controls(preset("joint"), lambda path, value: None)


def found_by(controls, text):
    controls.search.value = text
    shown = {id(widget) for widget in controls.found.children}
    return {path for path, control in controls.by_path.items() if id(control.widget) in shown}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("steady head", {"weights.tau"}),
        ("ω_τ", {"weights.tau", "weights.prior"}),  # the hierarchy names it too
        ("LENS", {"camera.fov_deg", "identity.size"}),
        ("group lips", {"group.outer_lips", "group.inner_lips"}),
    ],
)
def test_settings_are_found_by_plain_words_symbols_and_names(controls, text, wanted):
    assert found_by(controls, text) == wanted
    assert controls.pages.layout.display == "none"
    assert found_by(controls, "") == set()
    assert controls.pages.layout.display is None


def test_a_search_without_a_find_says_so(controls):
    found_by(controls, "moustache")
    assert "No setting has these words" in controls.found.children[0].value


def test_only_the_changed_settings_are_listed_when_asked(controls):
    controls.changed.value = True
    assert "as it was at the start" in controls.found.children[0].value
    controls.changed.value = False
    controls.show(preset("joint").changed(weights={"tau": 3.0}))
    controls.changed.value = True
    assert found_by(controls, "") == {"weights.tau"}


def test_a_double_click_in_the_page_sets_a_setting_back(panel):
    panel.turn("weights.tau", 3.0)
    panel.page._handle_custom_msg({"kind": "reset", "what": "weights.tau"}, [])
    assert panel.session.config.weights.tau == panel.session.base.weights.tau
    before = panel.session.config
    for content in ({"kind": "reset", "what": "weights.nothing"}, {"kind": "reset"}, "reset", {"kind": "key"}):
        panel.page._handle_custom_msg(content, [])
    assert panel.session.config == before


# --- moving through the clip ---


def key(panel, action):
    panel.page._handle_custom_msg({"kind": "key", "what": action}, [])
    assert panel.wait_idle(60)


def test_keys_move_through_the_clip_mark_its_part_and_play_it(panel):
    key(panel, "forth")
    key(panel, "forth")
    key(panel, "in")
    assert panel.frame == 2
    assert (panel.time.play.min, panel.time.play.max) == (2, FRAMES - 1)
    panel.go(6)
    key(panel, "out")
    assert (panel.time.play.min, panel.time.play.max) == (2, 6)
    assert panel.clip.timeline.loop == [2, 6]
    key(panel, "back")
    assert panel.frame == 5
    key(panel, "play")
    assert panel.time.play.playing
    key(panel, "play")
    assert not panel.time.play.playing
    panel.transport.whole.click()
    assert panel.clip.timeline.loop == []
    assert panel.time.play.max == FRAMES - 1


def test_slow_motion_waits_longer_and_double_speed_skips_frames(panel):
    play, normal = panel.time.play, panel.time.play.interval
    panel.transport.speed.value = 0.25
    assert (play.interval, play.step) == (4 * normal, 1)
    panel.transport.speed.value = 2.0
    assert play.interval / play.step == normal / 2
    panel.transport.speed.value = 1.0
    assert (play.interval, play.step) == (normal, 1)


def test_flagged_frames_are_reached_both_ways_and_around_the_ends(panel):
    panel.clip.timeline._flagged[:] = [frame in (2, 7) for frame in range(FRAMES)]
    visited = []
    for action in ("next", "next", "next", "previous", "previous"):
        key(panel, action)
        visited.append(panel.frame)
    panel.clip.timeline._flagged[:] = False
    assert visited == [2, 7, 2, 7, 2]


def test_other_keys_undo_take_snapshots_and_look_from_elsewhere(panel):
    panel.turn("weights.tau", 3.0)
    key(panel, "keep")
    assert panel.session.snapshots["snapshot 1"].weights.tau == 3.0
    key(panel, "undo")
    assert panel.session.config.weights.tau == panel.session.base.weights.tau
    key(panel, "redo")
    assert panel.session.config.weights.tau == 3.0
    before = panel.head.look.value
    key(panel, "view")
    assert panel.head.look.value != before
    panel.head.look.value = before
    key(panel, "export")
    assert panel.export_dialog.widget.layout.display is None
    key(panel, "export")
    assert panel.export_dialog.widget.layout.display == "none"


# --- one colour scale ---


def test_picture_strip_and_head_share_the_end_of_their_scale(panel):
    strip, picture = panel.clip.timeline, panel.overlay.view
    assert picture.scale == strip.scale
    panel.head.color.value = "residual"
    picture.scale_max = 7.0  # as dragged in the picture
    assert panel.wait_idle(60)
    assert strip.scale == 7.0
    assert ">7<" in panel.head.view._legend.value
    strip.scale_max = 3.0  # as dragged at the strip
    assert panel.wait_idle(60)
    assert picture.scale == 3.0
    assert ">3<" in panel.head.view._legend.value
    picture.scale_max = 0.0
    assert panel.wait_idle(60)
    assert picture.scale == strip.scale != 3.0


def test_the_head_is_seen_through_the_lens_of_the_picture(panel):
    canvas, camera = panel.head.view.canvas, panel.fit.camera
    assert canvas._lens == [*camera.focal_px, *camera.principal_point_px]
    panel.head.look.value = "front"
    assert canvas._lens == []
    panel.head.look.value = "camera"
    assert canvas._lens


def test_the_difference_to_a_compared_configuration_colours_the_head(panel):
    panel.turn("weights.sigma_smooth", 2.0)
    panel.head.color.value = "difference"
    assert panel.wait_idle(60)
    assert not panel.head.view.canvas._colors
    assert "compare" in panel.head.working.value
    panel.head.compare.value = "the start"
    assert panel.wait_idle(60)
    assert "difference to the start, mm" in panel.head.view._legend.value
    assert panel.head.view.canvas._colors
    panel.head.compare.value = ""
    assert panel.wait_idle(60)


# --- words ---


def test_the_status_is_in_words(panel):
    said = panel.status.value
    assert "frame 0/8 · error <b>" in said
    assert "% of the eye distance" in said
    assert " ms" in said


def test_angles_have_a_true_minus_and_no_sign_at_zero():
    assert [degrees(angle) for angle in (-4.2, 3.0, -0.3)] == ["−4°", "3°", "0°"]


def test_on_a_frame_without_a_face_no_head_is_left(panel):
    fit = panel.fit
    panel.head.show(replace(fit, found=False))
    assert FACELESS in panel.head._holder._dom_classes
    panel.head.show(fit)
    assert FACELESS not in panel.head._holder._dom_classes


def test_marked_frames_are_ranges_in_the_changes():
    base = preset("joint")
    (marked,) = differences(base, base.changed(infill={"frames": ((36, 43), (50, 50))}))
    assert change_words(marked) == "frames marked as failed: none → 36-43, 50"


def test_where_all_are_equal_none_is_the_best():
    same, better = {"all_68_percent_mean": 2.0}, {"all_68_percent_mean": 1.0}
    assert "fw-best" not in comparison_html({"the start": same, "now": same})
    assert comparison_html({"the start": same, "now": better}).count("fw-best") == 1
    alike = {"all_68_percent_mean": 2.001}
    assert "fw-best" not in comparison_html({"the start": same, "now": alike})
    assert "fw-best" not in comparison_html({"the start": {}, "now": same})
    assert comparison_html({"the start": same, "now": better, "other": alike}).count("fw-best") == 1


def test_a_frame_without_a_face_has_no_numbers(panel):
    assert status_of(replace(panel.fit, found=False), FRAMES) == "frame 0/8 · no face"


def test_a_flagged_frame_says_why_in_the_status_line(panel):
    assert " · <b>flagged</b>: the pose jumps (10°, 10 mm) · " in status_of(
        panel.fit, FRAMES, flag="the pose jumps (10°, 10 mm)"
    )
    assert "flagged" not in status_of(panel.fit, FRAMES)
    assert "flagged" not in status_of(panel.fit, FRAMES, after=True, flag="the pose jumps")
    assert panel.clip.why(0) == panel.session.run.flags.text[0] == ""


def test_in_pixels_the_picture_has_a_scale_of_its_own_and_in_percent_that_of_the_strip():
    picture, strip, percent = OverlayView(), TimelineView(), [True]
    scale = SharedScale(picture, strip, lambda: percent[0], lambda: None)
    points = np.zeros((68, 2))
    strip.set_track(np.full((5, 68), 8.0))
    scale.show_run()

    def shown(unit, residual):
        percent[0], picture.unit = unit == "%", unit
        picture.set_fit(points, points + 1, np.full(68, residual))
        return picture.scale

    assert shown("%", 3.0) == 8.0
    assert shown("px", 0.9) == 1.0
    assert shown("%", 3.0) == 8.0
    strip.scale_max = 5.0
    assert (shown("px", 0.9), strip.scale) == (1.0, 5.0)
    picture.scale_max = 2.0
    assert (shown("%", 3.0), strip.scale) == (5.0, 5.0)


# --- comparison ---


@pytest.fixture
def comparison(panel):
    """The page of comparison in front, the present with less sparsity against the start and a snapshot of it."""
    panel.session.take_snapshot("without smoothness")
    panel.turn("weights.sigma_smooth", 0.5)
    assert panel.wait_idle(120)
    panel.tabs.selected_index = list(panel.tabs.titles).index("Compare")
    panel.compare.choices[2].value = "without smoothness"
    assert panel.wait_idle(120)
    yield panel.compare
    panel.compare.choices[2].value = "–"
    panel.tabs.selected_index = 0


def test_configurations_stand_side_by_side_with_their_distance_from_the_first_in_mm(comparison, panel):
    views, session = comparison.views, panel.session
    here = session.runs.known(session.config).fits[panel.frame]
    start = session.runs.known(session.base).fits[panel.frame]
    difference = np.linalg.norm(surface(session, here) - surface(session, start), axis=1)
    assert difference.max() > 0.05
    assert f"up to {difference.max():.1f} mm" in comparison.captions[1].value
    assert "mm" not in comparison.captions[0].value
    assert not views[0].canvas._colors
    assert len(views[1].canvas._colors) == 3 * len(difference)
    np.testing.assert_allclose(
        np.frombuffer(views[1].canvas._vertices, "<f4"), surface(session, start).ravel(), atol=1e-3
    )
    assert views[1].canvas._viewpoint == views[0].canvas._viewpoint == views[2].canvas._viewpoint
    assert f"{max(difference.max(), 0.5):.3g}</span>" in comparison.scale.value
    comparison.color.value = False
    assert panel.wait_idle(60)
    assert not views[1].canvas._colors
    assert comparison.scale.value == ""
    comparison.color.value = True


def test_a_snapshot_that_is_kept_again_is_compared_anew(comparison, panel):
    panel.head.compare.value = "without smoothness"
    assert panel.wait_idle(60)
    outline = panel.head.view.canvas._ghost["vertices"]
    assert "up to 0.0 mm" not in comparison.captions[2].value
    panel.session.take_snapshot("without smoothness")
    assert panel.wait_idle(60)
    assert "up to 0.0 mm" in comparison.captions[2].value
    assert panel.head.view.canvas._ghost["vertices"] != outline
    panel.head.compare.value = ""


def test_the_changes_follow_snapshots_and_saving(panel, tmp_path):
    assert "not saved yet" not in panel.changes.value
    panel.turn("weights.sigma_smooth", 0.5)
    assert panel.wait_idle(120)
    assert "1 of them not saved yet" in panel.changes.value
    panel.session.set(weights={"tau": 0.7})
    panel.session.export(tmp_path / "two.toml")
    panel.session.undo()
    panel.session.undo()
    panel.changes.show()
    assert "saved settings are different" in panel.changes.value
    panel.turn("weights.sigma_smooth", 0.6)
    assert panel.wait_idle(120)
    assert "1 of them not saved yet" in panel.changes.value
    panel.session.take_snapshot("half as smooth")
    assert "half as smooth" in panel.changes.value
    panel.session.export(tmp_path / "tuned.toml")
    assert "not saved yet" not in panel.changes.value


def test_another_frame_is_compared_as_soon_as_it_is_shown(comparison, panel):
    before = comparison.captions[1].value
    panel.go(6)
    assert panel.wait_idle(60)
    assert comparison.captions[1].value != before


def test_on_a_frame_without_a_face_nothing_of_another_one_is_left(comparison, panel, monkeypatch):
    fit_frame = panel.session.fit_frame
    monkeypatch.setattr(
        panel.session, "fit_frame", lambda *args, **named: replace(fit_frame(*args, **named), found=False)
    )
    monkeypatch.setattr(panel.session.runs, "known", lambda config: None)
    asked = []
    monkeypatch.setattr(panel.strip, "show_frame", asked.append)
    panel.go(2)
    assert panel.wait_idle(60)
    assert asked == [2]
    assert panel.status.value.endswith("no face</span>")
    assert panel.energy._series["count"] == 0
    assert {row.result.value for row in panel.stages._rows} == {""}
    assert comparison.scale.value == "no face in this frame"
    assert {caption.value for caption in comparison.captions} == {""}
    assert {cell.children[1].layout.visibility for cell in comparison._cells} == {"hidden"}


def test_the_metrics_of_the_compared_clips_are_a_table_with_the_best_marked(comparison, panel):
    run = panel.session.run
    comparison.choices[1].value = "–"
    panel.follow.value = False
    try:
        panel.session.set(weights={"sigma_smooth": 11.0})
        panel.session.take_snapshot("never fitted")
        panel.turn("weights.sigma_smooth", 0.5)
        assert panel.wait_idle(60)
        comparison.choices[2].value = "never fitted"
        assert panel.wait_idle(60)
        assert "<td>–</td>" in comparison.table.value
        assert not comparison.fit_all.disabled
        comparison.fit_all.click()
        assert panel.wait_idle(120)
    finally:
        panel.follow.value = True
    assert "<td>–</td>" not in comparison.table.value
    assert comparison.table.value.count("fw-best") >= 3
    assert comparison.fit_all.disabled
    assert panel.session.run is run or panel.session.run.config == panel.session.config


def test_a_single_configuration_is_compared_with_nothing(comparison, panel):
    comparison.choices[1].value = comparison.choices[2].value = "–"
    assert panel.wait_idle(60)
    assert comparison.captions[1].value == comparison.captions[2].value == ""


# --- what takes its time ---


def becomes(state, seconds=5.0):
    """Whether a state is reached in time."""
    end = time.monotonic() + seconds
    while not state() and time.monotonic() < end:
        time.sleep(0.01)
    return bool(state())


def test_alarms_come_at_their_time_from_one_thread_and_not_when_cancelled():
    alarms, came = Alarms(), []

    def call(name):
        return lambda: came.append((name, threading.current_thread()))

    alarms.after(0.5, call("last"))
    alarms.after(0.03, lambda: 1 / 0)
    alarms.after(0.02, call("cancelled")).cancel()
    alarms.after(0.0, call("first"))
    alarms.after(0.04, call("second"))
    assert becomes(lambda: len(came) == 3)
    names, threads = zip(*came, strict=True)
    assert names == ("first", "second", "last")
    assert set(threads) == {alarms._thread}
    alarms.after(0.0, call("again"))
    assert becomes(lambda: came[-1] == ("again", alarms._thread))
    assert alarms._set == []


def test_what_is_quick_is_not_mentioned_and_what_is_slow_is_with_its_last_duration():
    waiting = Waiting(patience_s=0.02)
    shown = widgets.HTML()
    with waiting.during("fitting"):
        pass
    assert waiting.said.value == ""
    with waiting.during("fitting", old=(shown,)):
        assert becomes(lambda: "fitting …" in waiting.said.value)
        assert becomes(lambda: OLD in shown._dom_classes)
        assert waiting.cancel.layout.display == "none"
    assert waiting.said.value == ""
    assert OLD not in shown._dom_classes
    assert text_of("fitting", None) == "fitting …"
    assert text_of("fitting", 12.4) == "fitting … about 12 s"


def test_what_ends_while_it_begins_to_be_slow_is_not_mentioned_either(monkeypatch):
    waiting, shown, late = Waiting(patience_s=0.0), widgets.HTML(), []
    monkeypatch.setattr(ALARMS, "after", lambda _seconds, call: late.append(call) or Alarm(0.0, 0, call))
    with waiting.during("fitting", old=(shown,)):
        pass
    (begin,) = late
    begin()
    assert waiting.said.value == ""
    assert OLD not in shown._dom_classes


def test_what_has_never_run_takes_as_long_as_is_usual_and_then_as_long_as_it_took():
    waiting = Waiting(patience_s=0.0)
    with waiting.during("fitting", expected_s=40.0):
        assert becomes(lambda: "fitting … about 40 s" in waiting.said.value)
    with waiting.during("fitting", expected_s=40.0):
        assert becomes(lambda: "fitting …" in waiting.said.value)
        assert "40 s" not in waiting.said.value


def test_progress_says_how_far_a_job_is_and_how_long_it_still_takes():
    job = Job("fitting the clip")
    assert job.text == "fitting the clip …"
    job._began -= 20.0
    job.progress("fit", 40, 120)
    assert job.text == "fitting the clip: 40 of 120, 40 s left"


def test_cancelling_tells_the_job_that_the_line_is_about_and_is_not_remembered_as_its_duration():
    waiting, pressed = Waiting(patience_s=0.0), []
    with waiting.during("first", expected_s=9.0, cancel=lambda: pressed.append("first")) as first:
        assert becomes(lambda: "first" in waiting.said.value)
        with waiting.during("second", cancel=lambda: pressed.append("second")) as second:
            assert becomes(lambda: "second" in waiting.said.value)
            assert waiting.cancel.layout.display is None
            waiting.cancel.click()
            assert "stopping: second" in waiting.said.value
            assert waiting.cancel.layout.display == "none"
        assert (first.cancelled(), second.cancelled(), pressed) == (False, True, ["second"])
        assert "first" in waiting.said.value
        waiting.cancel.click()
    assert pressed == ["second", "first"]
    with waiting.during("first", expected_s=9.0):
        assert becomes(lambda: "first … about 9 s" in waiting.said.value)


def test_closing_the_line_cancels_what_runs_and_what_begins_afterwards_and_tells_of_neither():
    waiting, pressed = Waiting(patience_s=0.0), []
    with waiting.during("first", cancel=lambda: pressed.append("first")) as first:
        assert becomes(lambda: "first" in waiting.said.value)
        told = waiting.said.value
        waiting.close()
        with waiting.during("second") as second:
            assert second.cancelled()
        assert first.cancelled()
    assert waiting.said.value == told
    assert pressed == []


def test_a_failure_ends_the_waiting_too():
    waiting = Waiting(patience_s=0.0)
    with pytest.raises(ValueError, match="broken"), waiting.during("fitting"):
        raise ValueError("broken")
    assert waiting.said.value == ""
    assert waiting._running == {}


@pytest.fixture
def impatient(panel):
    """The panel, which tells about everything at once."""
    panel.waiting._patience_s = 0.0
    yield panel
    panel.waiting._patience_s = PATIENCE_S


def test_a_cancelled_diagnosis_says_so_and_the_next_one_is_complete(impatient):
    impatient.diagnosis.ask.click()
    assert becomes(lambda: impatient.waiting.cancel.layout.display is None)
    impatient.waiting.cancel.click()
    assert impatient.wait_idle(120)
    assert impatient.diagnosis.status.value == "The diagnosis of frame 0 was cancelled."
    impatient.diagnosis.ask.click()
    assert impatient.wait_idle(300)
    assert "Frame 0" in impatient.diagnosis.status.value


def test_a_cancelled_fit_leaves_what_was_shown_and_the_panel_usable(impatient, monkeypatch):
    before, entered = impatient.fit, threading.Event()
    plain = impatient.session.fit_frame

    def slow(frame, coarse=False, config=None, cancelled=lambda: False):
        entered.set()
        assert becomes(cancelled, 20.0)
        return plain(frame, coarse, config, cancelled)

    monkeypatch.setattr(impatient.session, "fit_frame", slow)
    impatient.go(3)
    assert entered.wait(10)
    assert becomes(lambda: impatient.waiting.cancel.layout.display is None)
    assert OLD in impatient.overlay.view._dom_classes
    impatient.waiting.cancel.click()
    assert impatient.wait_idle(60)
    assert impatient.fit is before
    assert "frame 3 was cancelled; what is shown is from before" in impatient.status.value
    assert "color:var(--jp-error" not in impatient.status.value
    assert OLD not in impatient.overlay.view._dom_classes
    monkeypatch.undo()
    impatient.go(4)
    assert impatient.wait_idle(60)
    assert impatient.fit.index == 4


def test_cancelling_the_uncertainty_goes_back_to_the_skin(impatient, monkeypatch):
    release = threading.Event()
    monkeypatch.setattr(impatient.head, "_uncertainty", lambda fit: release.wait(10) and np.zeros(1))
    impatient.head.color.value = "uncertainty"
    assert becomes(lambda: "computing the uncertainty" in impatient.waiting.said.value)
    impatient.waiting.cancel.click()
    release.set()
    assert impatient.wait_idle(60)
    assert impatient.head.color.value == "skin"


def test_a_clip_that_is_fitted_says_how_long_it_takes_and_marks_the_old_result(panel):
    said = []
    panel._clip_bar.said.observe(
        lambda change: said.append((change["new"], OLD in panel.clip.curves._dom_classes)), "value"
    )
    panel.run_clip.click()
    assert panel.wait_idle(60)
    texts, old = zip(*said, strict=True)
    assert any(f"of {FRAMES}" in text for text in texts)
    assert old[0]
    assert panel._clip_bar.said.value == ""
    assert OLD not in panel.clip.curves._dom_classes


# --- export ---


def export_of(panel, folder, later):
    made = PerformanceExport(panel.session, later, lambda: Path("tuned.toml"), panel.page.download)
    made.file.value = str(folder / "talk.glb")
    return made


@pytest.fixture
def export(panel, tmp_path):
    return export_of(panel, tmp_path, lambda job: job())


def test_the_performance_is_exported_as_the_command_line_would(export, panel, tmp_path):
    export.go.click()
    assert "Wrote" in export.said.value
    session = panel.session
    export_track(performance_track(session), session.model, tmp_path / "other.glb")
    assert (tmp_path / "talk.glb").read_bytes() == (tmp_path / "other.glb").read_bytes()


def test_another_format_brings_its_suffix_and_options(export, tmp_path):
    export.format.value = ".arkit.csv"
    assert export.file.value == str(tmp_path / "talk.arkit.csv")
    assert export.character.layout.display == "none"
    export.fps.value = "12,5"
    export.go.click()
    assert (tmp_path / "talk.arkit.csv").exists()
    assert "--fps 12.5" in export.command.value
    export.format.value = ".html"
    assert export.fps.layout.display == "none"
    assert "--fps" not in export.command.value


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("talk.mp3", "A track is exported as"),
        ("talk.csv", "does not end in the chosen format"),
        ("there.glb", "exists already"),
        ("there.glb/talk.glb", "there.glb/talk.glb cannot be written (Not a directory); a file is in the way"),
        (f"{'x' * 300}.glb", "cannot be written (File name too long); name a shorter one."),
        ("a\0b.glb", "cannot be written (embedded null byte); name another place."),
        (".glb", "got .glb: name the file."),
    ],
)
def test_what_cannot_be_written_is_said_and_writes_nothing(export, tmp_path, name, said):
    (tmp_path / "there.glb").write_text("kept")
    export.file.value = str(tmp_path / name)
    export.go.click()
    assert said in export.said.value
    assert [path.name for path in tmp_path.iterdir()] == ["there.glb"]
    assert (tmp_path / "there.glb").read_text() == "kept"


def test_a_rate_that_is_no_number_is_said(export):
    export.fps.value = "fast"
    export.go.click()
    assert "Frames per second are a number such as 25" in export.said.value


@pytest.fixture
def queued(panel, tmp_path):
    """An export, and the slow jobs that its clicks ask for, none of which has begun."""
    jobs = []
    return export_of(panel, tmp_path, jobs.append), jobs


@pytest.mark.parametrize(("name", "fps"), [("there.glb/talk.glb", ""), ("/proc/talk.glb", ""), ("talk.glb", "nan")])
def test_what_cannot_be_exported_is_refused_by_the_click_and_nothing_is_fitted(queued, tmp_path, name, fps):
    export, jobs = queued
    (tmp_path / "there.glb").write_text("kept")
    export.file.value, export.fps.value = str(tmp_path / name), fps
    export.go.click()
    assert jobs == []


def test_each_export_is_of_the_file_and_options_at_its_click(queued, tmp_path):
    export, jobs = queued
    for suffix in (".csv", ".arkit.csv"):
        export.format.value = suffix
        export.go.click()
    export.file.value = str(tmp_path / "later.arkit.csv")
    for job in jobs:
        job()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["talk.arkit.csv", "talk.csv"]
    assert export.said.value.count("Wrote") == 2


def test_an_export_is_of_the_settings_at_its_click(queued, panel, monkeypatch):
    export, jobs = queued
    asked = []
    monkeypatch.setattr(
        "workbench.widgets.performance_export.performance_track", lambda *arguments: asked.append(arguments[3])
    )
    at_click = panel.session.config
    export.go.click()
    panel.session.set(weights={"tau": 9.0})
    jobs[0]()
    assert asked == [at_click]


def test_an_export_that_waits_says_so_and_can_be_cancelled_for_good(queued, tmp_path):
    export, jobs = queued
    export.go.click()
    assert "waiting to write talk.glb" in export.said.value
    assert export.cancel.layout.display is None
    export.cancel.click()
    assert "Cancelled; talk.glb was not written." in export.said.value
    assert export.cancel.layout.display == "none"
    export.format.value = ".csv"
    export.go.click()
    for job in jobs:
        job()
    assert [path.name for path in tmp_path.iterdir()] == ["talk.csv"]


def test_an_export_that_is_asked_for_twice_is_written_once(queued):
    export, jobs = queued
    export.go.click()
    export.go.click()
    assert len(jobs) == 1


def test_an_export_that_is_asked_for_twice_still_waits_or_is_written_as_it_said(queued, tmp_path):
    export, _ = queued
    export.go.click()
    export.said.say("fit 3 of 9 …")
    export.download.offer(tmp_path)
    export.go.click()
    assert "fit 3 of 9 …" in export.said.value
    assert export.download.layout.display is None


def test_a_refused_export_is_told_once_however_often_it_is_asked_for(queued, tmp_path):
    export, _ = queued
    export.go.click()
    (tmp_path / "there.glb").write_text("kept")
    export.file.value = str(tmp_path / "there.glb")
    export.go.click()
    export.go.click()
    assert export.said.value.count("exists already") == 1


@pytest.mark.parametrize("suffix", [".csv", ".arkit.csv", ".npz", ".glb"])
def test_an_export_that_is_cancelled_once_it_is_fitted_is_not_written(export, tmp_path, monkeypatch, suffix):
    def fitted(*arguments):
        track = performance_track(*arguments)
        export.cancel.click()
        return track

    monkeypatch.setattr("workbench.widgets.performance_export.performance_track", fitted)
    export.format.value = suffix
    export.go.click()
    assert "Cancelled" in export.said.value
    assert list(tmp_path.iterdir()) == []


def test_what_is_cancelled_while_it_is_written_counts_as_being_written_until_it_ends(export, monkeypatch):
    during = []

    def cancelling(*_):
        export.cancel.click()
        during.append((export.busy, export.cancel.layout.display, export.cancel.disabled))

    monkeypatch.setattr("workbench.widgets.performance_export.performance_track", cancelling)
    export.go.click()
    assert during == [(True, None, True)]
    assert (export.busy, export.cancel.layout.display) == (False, "none")


def test_what_was_cancelled_while_it_was_written_can_be_asked_for_again(export, tmp_path, monkeypatch):
    def cancelling(*_):
        monkeypatch.undo()
        export.cancel.click()
        export.go.click()

    monkeypatch.setattr("workbench.widgets.performance_export.performance_track", cancelling)
    export.go.click()
    assert (tmp_path / "talk.glb").exists()


def broken(*_, **__):
    raise RuntimeError("RESOURCE_EXHAUSTED")


def test_an_export_that_fails_unexpectedly_no_longer_waits(queued, monkeypatch):
    export, jobs = queued
    monkeypatch.setattr("workbench.widgets.performance_export.performance_track", broken)
    export.go.click()
    with pytest.raises(RuntimeError, match="RESOURCE_EXHAUSTED"):
        jobs[0]()
    assert "waiting" not in export.said.value
    assert not export.busy


def test_settings_whose_saving_fails_unexpectedly_no_longer_wait(panel, tmp_path, monkeypatch):
    jobs = []
    bar = ExportBar(panel.session, jobs.append, panel.page.download)
    bar.file.value = str(tmp_path / "mine.toml")
    monkeypatch.setattr(panel.session, "export", broken)
    bar.export.click()
    with pytest.raises(RuntimeError, match="RESOURCE_EXHAUSTED"):
        jobs[0]()
    assert bar.exported.value == ""
    assert not bar.busy


def test_nothing_waits_to_be_written_where_no_jobs_are_taken_any_more(panel, tmp_path):
    slow = SlowJobs(lambda error: None, "closed")
    slow.close()
    dialog = ExportDialog(panel.session, slow.submit, panel.page.download)
    dialog.settings.file.value = str(tmp_path / "mine.toml")
    dialog.performance.file.value = str(tmp_path / "talk.glb")
    for ask in (dialog.settings._on_export, dialog.performance._on_go):
        with pytest.raises(RuntimeError):
            ask()
    assert not dialog.writing
    assert dialog.settings.exported.value == ""
    assert "waiting" not in dialog.performance.said.value


def test_settings_saved_again_as_before_the_last_save_are_what_the_file_holds(panel, tmp_path):
    jobs = []
    bar = ExportBar(panel.session, jobs.append, panel.page.download)
    bar.file.value = str(tmp_path / "mine.toml")
    for tau in (1.0, 2.0, 1.0, 1.0):
        panel.session.set(weights={"tau": tau})
        bar.export.click()
    for job in jobs:
        job()
    assert read_config(tmp_path / "mine.toml").weights.tau == 1.0
    assert len(jobs) == 3


def test_what_waited_and_was_cancelled_is_still_told_when_what_was_being_saved_stops(panel, tmp_path, monkeypatch):
    jobs = []
    bar = ExportBar(panel.session, jobs.append, panel.page.download)

    def stopped(path, progress, cancelled, *_):
        bar.cancel.click()
        progress("fit", 10, 20)
        raise InputError(f"The export was cancelled; {path} was not written.")

    monkeypatch.setattr(panel.session, "export", stopped)
    for name in ("a.toml", "b.toml"):
        bar.file.value = str(tmp_path / name)
        bar.export.click()
    with pytest.raises(InputError, match=r"a\.toml was not written"):
        jobs[0]()
    jobs[1]()
    assert bar.exported.value == "Cancelled; b.toml was not written."


def test_what_an_export_that_waited_finds_in_its_way_is_kept(queued, tmp_path):
    export, jobs = queued
    export.go.click()
    (tmp_path / "talk.glb").write_text("kept")
    jobs[0]()
    assert "exists already" in export.said.value
    assert (tmp_path / "talk.glb").read_text() == "kept"


def test_what_an_export_finds_in_its_way_once_it_is_fitted_is_kept(export, tmp_path, monkeypatch):
    def late(*arguments):
        (tmp_path / "talk.glb").write_text("kept")
        return performance_track(*arguments)

    monkeypatch.setattr("workbench.widgets.performance_export.performance_track", late)
    export.go.click()
    assert "exists already" in export.said.value
    assert (tmp_path / "talk.glb").read_text() == "kept"


@pytest.mark.parametrize("cancel", [False, True], ids=["written", "cancelled"])
def test_an_export_makes_its_folders_only_when_it_is_written(queued, tmp_path, cancel):
    export, jobs = queued
    export.file.value = str(tmp_path / "new" / "deep" / "talk.glb")
    export.go.click()
    assert list(tmp_path.iterdir()) == []
    if cancel:
        export.cancel.click()
    jobs[0]()
    assert (tmp_path / "new" / "deep" / "talk.glb").exists() is not cancel
    assert (tmp_path / "new").exists() is not cancel


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("/proc/new/mine.toml", "/proc/new/mine.toml cannot be written"),
        ("link.toml", "link.toml is a link to nothing; remove it or name another file."),
    ],
)
def test_settings_that_cannot_be_written_are_refused_by_the_click(panel, tmp_path, name, said):
    jobs = []
    (tmp_path / "link.toml").symlink_to("nowhere")
    bar = ExportBar(panel.session, jobs.append, panel.page.download)
    bar.file.value = str(tmp_path / name)
    bar.export.click()
    assert said in bar.exported.value
    assert jobs == []


def test_settings_are_saved_as_they_are_and_where_it_was_said_at_the_click(panel, tmp_path):
    jobs = []
    bar = ExportBar(panel.session, jobs.append, panel.page.download)
    bar.file.value = str(tmp_path / "mine.toml")
    panel.session.set(weights={"tau": 1.0})
    bar.export.click()
    panel.session.set(weights={"tau": 9.0})
    bar.file.value = str(tmp_path / "next.toml")
    jobs[0]()
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]
    assert read_config(tmp_path / "mine.toml").weights.tau == 1.0


@pytest.mark.parametrize("late", ["waiting", "fitting"])
@pytest.mark.parametrize("shown", ["mine.toml", "next.toml"])
def test_a_file_that_appears_before_settings_are_saved_is_kept_and_the_choice_offered(panel, tmp_path, late, shown):
    jobs, taken = [], tmp_path / "mine.toml"
    bar = ExportBar(panel.session, jobs.append, panel.page.download)
    bar.file.value = str(taken)
    panel.session.set(weights={"tau": 0.81 if shown == "mine.toml" else 0.82})
    bar.export.click()
    bar.file.value = str(tmp_path / shown)
    if late == "waiting":
        taken.write_text("kept")
    else:
        bar.exported.observe(lambda _change: taken.write_text("kept"), "value")
    jobs[0]()
    assert taken.read_text() == "kept"
    free = "clip-tuned.toml" if shown == "mine.toml" else shown
    assert bar.exported.value == f"mine.toml exists already: pressing save again writes {free}."
    assert bar.path == tmp_path / free
    assert (bar.overwrite.description, bar.overwrite.layout.display) == ("overwrite mine.toml", None)


def test_settings_that_wait_to_be_saved_say_so_and_can_be_cancelled(panel, tmp_path):
    jobs = []
    bar = ExportBar(panel.session, jobs.append, panel.page.download)
    bar.file.value = str(tmp_path / "mine.toml")
    bar.export.click()
    assert bar.exported.value == "waiting to write mine.toml …"
    assert bar.cancel.layout.display is None
    bar.cancel.click()
    assert bar.exported.value == "Cancelled; mine.toml was not written."
    jobs[0]()
    assert list(tmp_path.iterdir()) == []


def test_a_cancelled_export_writes_nothing(export, tmp_path, monkeypatch):
    def cancelling(*arguments):
        export.cancel.click()
        return performance_track(*arguments)

    monkeypatch.setattr("workbench.widgets.performance_export.performance_track", cancelling)
    export._session.set(weights={"sigma_smooth": 7.0})
    export.go.click()
    assert "Cancelled" in export.said.value
    assert list(tmp_path.iterdir()) == []


def test_files_and_commands_have_the_same_names_with_the_users_folder_and_the_suffix(panel, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    dialog = ExportDialog(panel.session, lambda job: job(), panel.page.download)
    dialog.settings.file.value, dialog.performance.file.value = "~/plain", "~/talk.glb"
    dialog.settings.export.click()
    dialog.performance.go.click()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["plain.toml", "talk.glb"]
    for file in ("plain.toml", "talk.glb"):
        assert f" {tmp_path / file}" in dialog.performance.command.value


def test_a_file_that_could_not_be_loaded_is_said_in_red_and_not_named_in_commands_until_it_is_saved(panel, tmp_path):
    dialog = ExportDialog(panel.session, lambda job: job(), panel.page.download)
    settings, command = dialog.settings, dialog.performance.command
    settings.file.value = str(tmp_path / "mine.toml")
    settings.export.click()
    assert WRONG not in settings.exported.value
    settings.file.value = str(tmp_path / "clip.mp4")
    settings.load.click()
    assert WRONG in settings.exported.value
    assert "clip.mp4.toml does not exist" in settings.exported.value
    assert f"--config {tmp_path / 'mine.toml'}" in command.value
    settings.export.click()
    assert WRONG not in settings.exported.value
    assert f"--config {tmp_path / 'clip.mp4.toml'}" in command.value


def test_what_failed_is_said_until_the_next_action(panel, tmp_path):
    dialog = ExportDialog(panel.session, lambda job: job(), panel.page.download)
    settings, performance = dialog.settings, dialog.performance
    settings.file.value, performance.file.value = str(tmp_path / "absent.toml"), "talk.wrong"
    performance.go.click()
    assert WRONG in performance.said.value
    settings.load.click()
    assert "talk.wrong" not in performance.said.value
    assert WRONG in settings.exported.value
    performance.go.click()
    assert WRONG in performance.said.value
    assert settings.exported.value == ""


@pytest.mark.parametrize("taken", [False, True], ids=["written", "refused"])
def test_an_export_is_being_written_from_its_press_to_its_end(panel, tmp_path, taken):
    jobs = []
    dialog = ExportDialog(panel.session, jobs.append, panel.page.download)
    dialog.performance.format.value, dialog.performance.file.value = ".csv", str(tmp_path / "talk.csv")
    writing = [dialog.writing]
    dialog.performance.go.click()
    writing.append(dialog.writing)
    if taken:
        (tmp_path / "talk.csv").write_text("kept")
    jobs.pop()()
    assert [*writing, dialog.writing] == [False, True, False]


def test_nothing_is_being_written_once_what_waited_was_cancelled(panel, tmp_path):
    dialog = ExportDialog(panel.session, lambda job: None, panel.page.download)
    dialog.settings.file.value = str(tmp_path / "mine.toml")
    dialog.settings.export.click()
    dialog.settings.cancel.click()
    assert not dialog.writing


def test_what_cannot_be_written_is_no_longer_in_progress(panel, monkeypatch):
    def denied(path, progress, *_, **__):
        progress("fitting frame", 10, 20)
        raise PermissionError(13, "Permission denied", str(path))

    failed = []
    monkeypatch.setattr(panel.session, "export", denied)
    bar = ExportBar(panel.session, lambda job: refused(job, failed), panel.page.download)
    bar.export.click()
    assert failed
    assert bar.exported.value == ""


def test_saving_settings_can_be_cancelled_and_leaves_no_file(panel, tmp_path):
    bar = ExportBar(panel.session, lambda job: threads.append(threading.Thread(target=lambda: cancelled(job))), None)
    threads, failed, shown = [], [], []

    def cancelled(job):
        try:
            job()
        except InputError as error:
            failed.append(str(error))

    def click(change):
        if f"{FRAMES} of {FRAMES}" in change["new"]:
            bar.cancel.click()

    bar.exported.observe(click, "value")
    bar.cancel.layout.observe(lambda change: shown.append(change["new"]), "display")
    bar.file.value = str(tmp_path / "tuned.toml")
    panel.session.set(weights={"tau": 0.71})
    bar.export.click()
    threads[0].start()
    threads[0].join(300)
    assert "was cancelled" in failed[0]
    assert shown == [None, "none"]
    assert list(tmp_path.iterdir()) == []


def test_a_stage_of_usd_is_downloaded_with_the_pictures_of_its_character(tmp_path):
    stage = tmp_path / "talk.usda"
    stage.write_text("#usda 1.0")
    assert packed(stage) == ("talk.usda", b"#usda 1.0")
    pictures_folder(stage).mkdir()
    (pictures_folder(stage) / "skin.png").write_bytes(b"skin")
    name, content = packed(stage)
    assert name == "talk.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert {"talk.usda", "talk.usda_textures/skin.png"} <= set(archive.namelist())


def refused(job, failed):
    try:
        job()
    except OSError as error:
        failed.append(error)


def test_the_character_of_the_session_plays_it_unless_another_one_is_chosen(head, clip):
    session = TuningSession(head, clip)
    export = PerformanceExport(session, lambda job: job(), lambda: Path("tuned.toml"), lambda path: None)
    session.set(head={"character": "mei"})
    export.show_options()
    assert export.character.value == "mei"
    assert "--character mei" in export.command.value
    export.character.value = "kofi"
    session.set(head={"character": "plain"})
    export.show_options()
    assert export.character.value == "kofi"


def test_the_commands_name_the_same_run(head, clip):
    session = TuningSession(head, clip)
    track, export = performance_commands(session, "my tuned.toml", "a b.glb", ["--shot", "1"]).splitlines()
    words = shlex.split(track)
    assert words[words.index("--out") + 1] == "out/clip"
    assert words[words.index("--config") + 1] == "my tuned.toml"
    assert shlex.split(export) == ["workbench", "export", "out/clip", "--to", "a b.glb", "--shot", "1"]


def test_the_commands_ask_for_the_file_of_another_model(head, clip):
    lines = performance_commands(TuningSession(replace(head, name="flame"), clip), "a.toml", "b.glb").splitlines()
    assert all("--model MODEL" in line for line in lines)


def test_a_part_of_a_clip_stays_one_in_commands_and_exports(panel, tmp_path):
    """Its frames are counted from 0 in a session, and drawn over the pictures of that part."""
    stored = replace(performance_track(panel.session), meta=performance_track(panel.session).meta | {"frames": [7, 9]})
    material = replace(panel.session.material, part=material_of_track(stored).part)
    assert material.part == (7, 9)
    session = TuningSession(panel.session.model, material, panel.session.config)
    assert "--frames 7-9" in performance_commands(session, "a.toml", "b.mp4").splitlines()[0]
    assert performance_track(session).meta["frames"] == [7, 9]
    assert performance_track(panel.session).meta["frames"] is None


def test_what_was_written_can_be_downloaded(export, panel, tmp_path, monkeypatch):
    sent = []
    monkeypatch.setattr(panel.page, "send", lambda content, buffers: sent.append((content, buffers)))
    assert export.download.layout.display == "none"
    export.go.click()
    assert export.download.layout.display is None
    export.download.button.click()
    assert sent == [({"kind": "download", "name": "talk.glb"}, [(tmp_path / "talk.glb").read_bytes()])]
    (tmp_path / "talk.glb").unlink()
    export.download.button.click()
    assert "no longer there; write it again" in export.download.said.value
    assert len(sent) == 1


def test_a_folder_is_downloaded_as_an_archive_and_what_is_too_large_is_refused(tmp_path, monkeypatch):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "0001.obj").write_text("v 0 0 0")
    name, content = packed(tmp_path / "meshes")
    assert name == "meshes.zip"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        assert archive.read("0001.obj") == b"v 0 0 0"
    monkeypatch.setattr(panel_page, "LARGEST_MB", 1e-6)
    with pytest.raises(InputError, match="downloads are limited to"):
        packed(tmp_path / "meshes")


def test_the_performance_carries_what_exports_need(panel):
    track = performance_track(panel.session)
    assert len(track) == FRAMES
    assert track.meta["model"]["name"] == panel.session.model.name
    assert Config.model_validate(track.meta["config"]) == panel.session.config
    np.testing.assert_array_equal(track.expression[3], panel.session.run.fits[3].expression)
    assert track.meta["versions"]["workbench"]
