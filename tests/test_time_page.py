"""The panel's page of infill and refinement without a browser: every control reaches the session, results are shown."""

import re

import numpy as np
import pytest

from tests.test_session_temporal import COUNT, QUICK, fitted, material  # noqa: F401 - fixtures
from workbench.config import preset, read_config
from workbench.errors import InputError
from workbench.session import Material, TuningSession
from workbench.session.knobs import METHODS, TIME, value_of
from workbench.session.material import PictureStore
from workbench.widgets import TuningPanel
from workbench.widgets.chart_view import gaps
from workbench.widgets.clip_bar import ClipBar
from workbench.widgets.clip_views import ClipViews
from workbench.widgets.failed_frames import failed_html
from workbench.widgets.methods_page import chosen, colors_of, numbers_html
from workbench.widgets.time_page import TimePage
from workbench.widgets.transport import SPEEDS, Transport


@pytest.fixture(scope="module")
def shared_panel(head, material, fitted):  # noqa: F811 - fixtures
    session = TuningSession(head, material, QUICK)
    session.runs.last = fitted.run
    made = TuningPanel(session, backend="webgl")
    assert made.wait_idle(300)
    yield made
    made.close()


@pytest.fixture
def panel(shared_panel, fitted):  # noqa: F811 - fixture
    """One panel for all tests, brought back to the start and without results."""
    yield shared_panel
    session, page = shared_panel.session, shared_panel.time
    session.runs.last = fitted.run
    session.temporal._kept.clear()
    session.use(session.base)
    page.part.value, page.sides.value, page.methods.shown.value = "", "before", "all"
    assert shared_panel.wait_idle(60)


@pytest.fixture
def alone(head, material):  # noqa: F811 - fixture
    """The page without a panel, the views of its clip, and the session of both."""
    session = TuningSession(head, material, QUICK)
    views = ClipViews(session, lambda frame: None)
    page = TimePage(session, lambda path, value: None, lambda frame: None, lambda: None, views)
    yield page, views, session
    page.close()


def press(panel, button):
    button.click()
    assert panel.wait_idle(300)


def test_a_run_from_before_there_was_a_panel_is_shown_and_not_fitted_again(panel, fitted):  # noqa: F811 - fixture
    assert repr(panel.clip.timeline) == f"TimelineView({COUNT} frames from 0, at 0)"
    assert panel.session.run is fitted.run
    assert "error" in panel.status.value


def test_the_shown_frame_and_ranges_are_marked_and_shown_on_the_strip(panel):
    page = panel.time
    panel.go(7)
    press(panel, page.this)
    page.range.value = "10-13"
    press(panel, page.mark)
    assert panel.session.temporal.marked == ((7, 7), (10, 13))
    assert panel.clip.timeline.marked == [[7, 7], [10, 13]]
    assert page.summary.value == "marked: 7, 10-13 (5 frames); 1 more without a good fit"
    press(panel, page.this)
    page.range.value = "12-13"
    press(panel, page.unmark)
    assert panel.session.temporal.marked == ((10, 11),)
    press(panel, page.clear)
    assert panel.session.temporal.marked == ()
    panel.undo.click()
    assert panel.clip.timeline.marked == [[10, 11]]


def test_the_panel_has_a_page_of_its_own_for_time_and_one_for_all_methods(panel):
    assert panel.controls.pages.titles[-1] == "time"
    assert "Methods" in panel.tabs.titles


def test_the_part_is_what_the_strip_shows(panel):
    panel.clip.timeline.in_view = [3, 12]
    press(panel, panel.time.view)
    assert panel.time.part.value == "3-12"
    panel.clip.timeline.in_view = [0, COUNT - 1]
    press(panel, panel.time.view)
    assert panel.time.part.value == ""


def test_a_part_that_begins_behind_its_end_goes_to_the_end_of_the_clip(panel):
    part = panel.time.part
    for text, frame, what, expected in (
        ("2-4", 8, "in", f"8-{COUNT - 1}"),
        ("6-9", 3, "out", "0-3"),
        ("", COUNT - 1, "in", f"{COUNT - 2}-{COUNT - 1}"),
        ("", 0, "out", "0-1"),
        ("2-9", 4, "in", "4-9"),
    ):
        part.value = text
        panel.go(frame)
        panel.transport.mark(what)
        assert part.value == expected
        assert panel.time.played.usable is not None
    part.value = ""


def test_nonsense_in_a_field_is_said_and_changes_nothing(panel):
    page = panel.time
    page.range.value = "many"
    press(panel, page.mark)
    assert "Write frames as 40-52 or 60" in page.result.value
    page.range.value = ""
    press(panel, page.mark)
    assert "Type frames first" in page.result.value
    page.part.value = "5-99"
    panel.turn("refinement.method", "averaging")
    assert panel.wait_idle(300)
    press(panel, page.go)
    assert "A part of this clip must be within 0-23" in page.result.value
    assert panel.session.temporal.current is None


def test_run_shows_the_result_and_the_toggle_goes_back(panel):
    page = panel.time
    panel.go(11)
    panel.session.temporal.mark(range(10, 14))
    panel.turn("infill.method", "linear")
    assert page.sides.disabled  # there is nothing after yet
    press(panel, page.go)
    assert not page.sides.disabled
    assert page.side == "after", page.result.value
    assert "linear</b> 0-23, 5 filled" in page.result.value
    assert panel.fit.source == "filled"
    assert panel.overlay.view.message == "frame 11: filled"
    assert "filled from its neighbours" in panel.status.value
    filled = panel.head.view.widget, np.array(panel.fit.expression)
    page.sides.value = "before"
    assert panel.wait_idle(60)
    assert panel.fit.source == "given"
    assert panel.overlay.view.message == "frame 11: marked as failed"
    assert not np.array_equal(panel.fit.expression, filled[1])


def test_who_looks_at_the_result_can_go_back_when_a_setting_makes_it_out_of_date(panel):
    page = panel.time
    panel.turn("refinement.method", "averaging")
    press(panel, page.go)
    assert page.side == "after"
    panel.turn("refinement.method", "self")
    assert not page.sides.disabled
    page.sides.value = "before"
    panel.turn("refinement.method", "plate")
    assert panel.wait_idle(60)
    assert page.sides.disabled


def test_playing_goes_through_the_frames_of_the_chosen_side(panel):
    page = panel.time
    panel.turn("refinement.method", "averaging")
    press(panel, page.go)
    for frame in (3, 4, 5):
        page.play.value = frame
    assert panel.wait_idle(60)
    assert panel.frame == panel.clip.timeline.frame == 5
    after = panel.session.temporal.current.after[5]
    np.testing.assert_array_equal(panel.fit.rotation, after.rotation)
    panel.go(9)
    assert page.play.value == 9
    page.part.value = "4-8"
    assert (page.play.min, page.play.max, panel.frame) == (4, 8, 9)


def test_a_moved_setting_shows_the_frames_as_fitted_until_it_runs_again(panel):
    page = panel.time
    panel.go(9)
    panel.turn("refinement.method", "averaging")
    press(panel, page.go)
    result = panel.fit
    assert " · after · " in panel.status.value
    panel.turn("refinement.sweeps", 3)
    assert panel.wait_idle(60)
    assert " · after · " not in panel.status.value
    assert "not run with these settings yet" in page.result.value
    assert not np.array_equal(panel.fit.rotation, result.rotation)
    panel.undo.click()
    assert panel.wait_idle(60)
    np.testing.assert_array_equal(panel.fit.rotation, result.rotation)
    assert page.knobs["refinement.sweeps"].value == 1


def test_frames_that_infill_did_not_touch_are_not_called_after(panel):
    panel.go(9)
    panel.session.temporal.mark(range(4, 6))
    panel.turn("infill.method", "linear")
    press(panel, panel.time.go)
    assert panel.time.side == "after"
    assert panel.time.fit(9) is panel.fit
    assert not panel.time.was_changed(panel.fit)
    assert " · after · " not in panel.status.value
    panel.go(4)
    assert panel.wait_idle(60)
    assert panel.time.was_changed(panel.fit)


@pytest.mark.parametrize("knob", [*METHODS, *TIME], ids=lambda knob: knob.path)
def test_turning_a_knob_changes_the_configuration_and_undo_turns_it_back(knob, panel):
    for value in knob.choices or (knob.high, 1):
        panel.turn(knob.path, value)
        assert value_of(panel.session.config, knob.path) == value
    panel.session.use(panel.session.base)
    assert panel.time.knobs[knob.path].value == value_of(QUICK, knob.path)


def test_settings_of_time_do_not_fit_the_clip_again(panel):
    run = panel.session.run
    panel.turn("refinement.method", "plate")
    panel.turn("infill.method", "flow")
    assert panel.wait_idle(60)
    assert panel.session.run is run


def test_cancel_stops_a_run_and_says_so(panel, monkeypatch):
    page, told = panel.time, []
    panel.turn("refinement.method", "plate")
    panel.turn("refinement.sweeps", 20)
    say = page._told

    def cancelling(*seen):
        say(*seen)
        assert page.running
        assert not page.cancel.disabled
        told.append(seen)
        if len(told) == 2:
            page.cancel.click()

    monkeypatch.setattr(page, "_told", cancelling)
    assert page.cancel.disabled
    press(panel, page.go)
    assert len(told) == 2
    assert not page.running
    assert page.cancel.disabled
    assert panel.session.temporal.current is None
    assert "Cancelled" in page.result.value
    assert page.progress.layout.visibility == "hidden"


def test_what_was_said_of_the_settings_stays_when_the_panel_is_brought_up_to_date_late(panel):
    page = panel.time
    panel.turn("refinement.method", "averaging")
    page.part.value = "5-99"
    press(panel, page.go)
    said = page.result.value
    assert "must be within 0-23" in said
    assert page.cancel.disabled
    page.show_config()
    assert page.result.value == said
    panel.turn("refinement.sweeps", 3)
    assert panel.wait_idle(60)
    assert "not run with these settings yet" in page.result.value


def test_a_result_of_a_script_is_shown_and_running_again_says_it_again(panel):
    page = panel.time
    panel.turn("refinement.method", "averaging")
    assert panel.wait_idle(60)
    panel.session.temporal.run()
    assert "averaging</b> 0-23" in page.result.value
    said = page.result.value
    press(panel, page.go)
    assert page.result.value == said


def test_all_methods_are_compared_line_by_line(panel):
    page, methods = panel.time, panel.time.methods
    panel.session.temporal.mark([5, 6])
    panel.turn("infill.method", "spline")
    page.part.value = "2-10"
    press(panel, page.compare)
    names = methods.charts[0]._series["names"]
    assert names[:4] == ["before", "flow", "linear", "spline"]
    assert len(names) == 8
    assert methods.charts[0]._series["shaded"] == [[4.5, 6.5]]
    assert methods.table.value.count("<tr>") == 9
    methods.shown.value = "infill"
    assert methods.charts[2]._series["names"] == ["before", "flow", "linear", "spline"]
    methods.quantities[0].value = "pitch"
    row = np.frombuffer(methods.charts[0]._series["data"], np.float32).reshape(5, 9)
    pitch = [fit.angles_deg[1] for fit in panel.session.temporal.current.after]
    np.testing.assert_allclose(row[4], pitch, atol=1e-4)


def test_the_chosen_methods_are_exported(panel, tmp_path):
    panel.session.temporal.mark([5, 6])
    panel.turn("infill.method", "linear")
    panel.turn("refinement.method", "averaging")
    panel.turn("refinement.centre", 0.6)
    page = panel.time
    panel.file.value = str(tmp_path / "tuned.toml")
    page.part.value = "2-10"
    press(panel, page.go)
    press(panel, panel.export)
    assert "linear + averaging</b> 2-10" in page.result.value  # and not the whole clip, which the export ran
    written = read_config(tmp_path / "tuned.toml")
    assert (written.infill.method, written.infill.frames) == ("linear", ((5, 6),))
    assert (written.refinement.method, written.refinement.centre) == ("averaging", 0.6)
    assert "workbench track" in panel.exported.value


def test_a_photo_is_told_that_it_needs_a_clip(head, material):  # noqa: F811 - fixture
    pictures = PictureStore(None, [item.image_size for item in material.observations[:3]])
    stills = Material("stills", material.observations[:3], pictures, stills=True)
    made = TuningPanel(TuningSession(head, stills, QUICK), backend="webgl")
    assert made.wait_idle(300)
    assert "need a clip" in made.time.widget.children[0].value
    assert "these are 3 unrelated photos" in made.time.widget.children[0].value
    assert made.time.knobs == {}
    made.close()


def test_a_frame_outside_the_chosen_part_is_refused_and_not_marked(alone):
    page, _, session = alone
    page.part.value = "0-9"
    page.show_frame(15)
    with pytest.raises(InputError, match="Frame 15 is outside frames 0-9; widen them first"):
        page.fill()
    assert session.config == QUICK


def test_under_deep_energies_the_whole_clip_can_be_chosen_and_the_short_part_goes_with_the_preset(alone):
    page, _, session = alone
    session.use(preset("deep"))
    page.show_config()
    assert page.part.value == f"0-{COUNT - 1}"
    page.part.value = ""
    page.show_config()
    assert page.part.value == ""
    for typed, left in (("", ""), ("3-7", "3-7")):
        page.part.value = typed
        for config in (QUICK, preset("deep"), QUICK):
            session.use(config)
            page.show_config()
        assert page.part.value == left


@pytest.mark.parametrize("rate", [24.0, 25.0, 30.0, 50.0, 60.0])
def test_every_speed_plays_at_the_rate_of_the_clip(rate, alone):
    page, views, session = alone
    page.played.rate = rate
    bar = ClipBar(session, views, *[lambda *_: None] * 4)
    transport = Transport(bar, lambda by: None, lambda: 0, page.played)
    play = page.play
    assert play.step * 1000 / play.interval == pytest.approx(rate, rel=0.03)
    for speed in SPEEDS.values():
        transport.speed.value = speed
        assert play.step * 1000 / play.interval == pytest.approx(rate * speed, rel=0.03)
    bar.close()


@pytest.mark.long
def test_deep_energies_says_that_it_works_on_a_short_part(panel):
    panel.session.use(preset("deep"))
    assert "Deep Energies takes seconds per frame" in panel.time.note.value
    assert panel.time.part.value == f"0-{COUNT - 1}"


# --- what is drawn ---


def test_a_method_keeps_its_colour_whatever_is_shown(panel):
    panel.session.temporal.mark([5])
    for method in ("linear", "spline"):
        panel.turn("infill.method", method)
        panel.session.temporal.run((2, 9))
    results = panel.session.temporal.comparable()
    assert list(chosen(results, "infill")) == ["linear", "spline"]
    assert chosen(results, "refinement") == {}
    assert colors_of(results)["before"] == "ink"
    assert len(set(colors_of(results).values())) == 3
    assert gaps(results["linear"].filled) == [(4.5, 5.5)]
    table = numbers_html(results, colors_of(results))
    for name in ("linear", "spline"):  # rows have the colours of the curves
        assert re.search(rf"border-top:3px solid {colors_of(results)[name]}[^<]*></i>{name}</td><td>1</td>", table)
    least = min(worked.numbers()["jitter_deg"] for worked in results.values())
    assert f"<td class='fw-best'>{least:.3f}</td>" in table
    assert failed_html(panel.session, (2, 9)) == "marked: 5"


def test_numbers_that_only_one_method_has_are_not_the_best(panel):
    panel.session.temporal.mark([5])
    panel.turn("infill.method", "linear")
    panel.session.temporal.run((2, 9))
    results = panel.session.temporal.comparable()
    numbers = results["linear"].numbers()
    table = numbers_html(results, colors_of(results))
    row = table.partition("</i>linear</td>")[2]
    hidden, seconds = row.split("</td>")[3:5]
    assert (hidden, seconds) == (f"<td>{numbers['hidden_percent']:.2f}", f"<td>{numbers['seconds']:.1f}")
