"""The tuning panel without a browser: every control reaches the session, every change reaches the views."""

import asyncio
import re
import threading
import time
from dataclasses import replace

import anywidget
import cv2
import ipywidgets as widgets
import numpy as np
import pytest

from tests.scenes import turning_clip
from workbench.config import FACE_IT_PRESETS, PRESETS, differences, preset, read_config
from workbench.diagnosis import Change, Diagnosis, Reason, Uncertainty
from workbench.errors import ConfigError, StoppedError
from workbench.frames import read_picture
from workbench.landmarks.files import read_landmark_file
from workbench.landmarks.scheme import IBUG68
from workbench.landmarks.schemes import DENSE
from workbench.samples import sample
from workbench.session import FittedHead, TuningSession, gesture, material_of_photo, open_session
from workbench.session.knobs import (
    CONSTANTS,
    DEEP,
    KNOBS,
    METHODS,
    OMEGA,
    TIME,
    changed_by,
    effective_weights,
    inert_among,
    value_of,
)
from workbench.tracking.frame_solver import solve_frame
from workbench.tracking.identity import calibrate_identity
from workbench.widgets import FitPlayground, LivePanel, SessionOpener, TuningPanel, knob_control, tuning_panel
from workbench.widgets.chart_view import ChartView
from workbench.widgets.controls import Controls
from workbench.widgets.diagnosis_view import found_text
from workbench.widgets.film_strip import FilmStrip
from workbench.widgets.history_bar import HistoryBar
from workbench.widgets.knob_control import CHANGED, KnobControl, place_of, value_at
from workbench.widgets.landmark_tools import LandmarkTools
from workbench.widgets.latest import LatestWins
from workbench.widgets.light_panel import LightPanel
from workbench.widgets.overlay_view import OverlayEvent
from workbench.widgets.stage_editor import StageEditor, landmarks_text, read_landmarks
from workbench.widgets.status_line import StatusLine
from workbench.widgets.tuning_panel import Show
from workbench.widgets.waiting import OLD, Waiting
from workbench.widgets.webgl_head_view import WebGLCanvas

BY_PATH = {knob.path: knob for knob in KNOBS}


@pytest.fixture(scope="module")
def photo():
    landmarks = next(iter(read_landmark_file(sample("astronaut-landmarks")))).landmarks
    return material_of_photo(read_picture(sample("astronaut")), landmarks, "astronaut")


@pytest.fixture(scope="module")
def clip(head):
    return turning_clip(head, 9, -8.0)


@pytest.fixture(scope="module")
def shared_panel(head, photo):
    made = TuningPanel(TuningSession(head, photo), backend="webgl")
    assert made.wait_idle(550)
    yield made
    made.close()


@pytest.fixture
def panel(shared_panel):
    """One panel for most tests, brought back to the start."""
    yield shared_panel
    shared_panel.session.use(shared_panel.session.base)
    shared_panel.overlay.view.selection = []
    assert shared_panel.wait_idle(60)


@pytest.fixture
def fresh_panel(head, photo):
    """A panel without history, to be spoiled."""
    made = TuningPanel(TuningSession(head, photo), backend="webgl")
    assert made.wait_idle(550)
    yield made
    made.close()


@pytest.fixture
def clip_panel(head, clip):
    made = TuningPanel(TuningSession(head, clip), backend="webgl")
    assert made.wait_idle(550)
    yield made
    made.close()


# --- in the browser ---


def test_the_views_are_made_before_the_controls_so_that_a_browser_has_time_to_load_them(head, clip, monkeypatch):
    """A view whose program is not there within two seconds never hears of the kernel again."""
    opened, usual = [], widgets.Widget.open

    def record(widget):
        opened.append(type(widget))
        usual(widget)

    monkeypatch.setattr(widgets.Widget, "open", record)
    made = TuningPanel(TuningSession(head, clip), backend="webgl")
    made.close()
    views = [k for k, kind in enumerate(opened) if issubclass(kind, anywidget.AnyWidget)]
    assert len(views) >= 11
    assert max(views) < 0.5 * len(opened)
    assert any(issubclass(opened[k], WebGLCanvas) for k in views)


def test_a_notebook_shows_the_first_frame_before_the_parts_are_made(head, clip):
    async def cell():
        made = TuningPanel(TuningSession(head, clip), backend="webgl")
        first = cv2.imdecode(np.frombuffer(made.children[-1].value, np.uint8), cv2.IMREAD_COLOR)
        before = len(made.children)
        await asyncio.sleep(0)
        return made, first, before

    made, first, before = asyncio.run(cell())
    assert np.abs(first[..., ::-1].astype(float) - clip.pictures[0]).mean() < 4
    assert len(made.children) > before
    assert made.children[-1] is made.tabs
    made.close()


def test_a_part_that_a_cell_asks_for_is_made_at_once(head, clip):
    async def cell():
        made = TuningPanel(TuningSession(head, clip), backend="webgl")
        made.turn("weights.tau", 3.0)
        with pytest.raises(AttributeError, match="no attribute 'slidrs'"):
            _ = made.slidrs
        return made

    made = asyncio.run(cell())
    assert made.session.config.weights.tau == 3.0
    assert made.children.count(made.tabs) == 1
    made.close()


def test_a_panel_that_is_closed_before_its_parts_are_made_gets_none(head, clip):
    async def cell():
        made = TuningPanel(TuningSession(head, clip), backend="webgl")
        made.close()
        await asyncio.sleep(0)
        return made

    with pytest.raises(AttributeError, match="tabs"):
        _ = asyncio.run(cell()).tabs


def test_what_a_panel_is_doing_is_cancelled_when_it_is_closed_and_nothing_is_told_any_more(head, photo, told):
    began, ended = threading.Event(), []

    def get_ready(cancelled):
        began.set()
        patience = time.monotonic() + 60.0
        while not cancelled() and time.monotonic() < patience:
            time.sleep(0.01)
        ended.append(cancelled())
        raise StoppedError("Getting ready was cancelled.")

    session = TuningSession(head, photo)
    session.warm_up = get_ready
    made = TuningPanel(session, backend="webgl")
    made._make()
    assert began.wait(60)
    patience = time.monotonic() + 60.0
    while tuning_panel.GETTING_READY not in made.waiting.said.value and time.monotonic() < patience:
        time.sleep(0.01)
    assert tuning_panel.GETTING_READY in made.waiting.said.value
    made.close()
    told.clear()
    made._slow._pool.shutdown(wait=True)
    assert ended == [True]
    assert told == []


def test_a_chart_can_be_drawn_from_what_the_browser_hears_first(monkeypatch):
    first = []
    usual = widgets.Widget.open
    monkeypatch.setattr(widgets.Widget, "open", lambda widget: (first.append(widget.get_state()), usual(widget)))
    ChartView(title="empty")
    (sent,) = [state for state in first if "_series" in state]
    assert sent["_series"]["data"] == b""
    assert sent["_series"]["names"] == []


@pytest.fixture
def told(monkeypatch):
    """Changes of widgets as they are sent to the browser: widget, names of what changed, bytes."""
    sent = []

    def send(widget, key=None):
        names = {key} if isinstance(key, str) else set(widget.keys if key is None else key)
        state = widget.get_state(names)
        sent.append((widget, names, sum(len(part) for part in state.values() if isinstance(part, bytes))))

    monkeypatch.setattr(widgets.Widget, "send_state", send)
    return sent


def test_a_slider_is_answered_by_one_message_for_head_and_picture(panel, told, monkeypatch):
    panel.wait_idle()
    told.clear()
    monkeypatch.setattr(tuning_panel, "FIRST_S", 30.0)
    monkeypatch.setattr(panel.waiting, "_patience_s", 30.0)  # on a busy machine it would tell that it fits
    control = panel.controls.by_path["weights.sigma_smooth"]
    control.input.value += 4 * control.input.step
    panel.wait_idle()
    (slider, *_), picture, *rest = told
    assert slider is control.input
    assert picture == (panel.overlay.view, {"_fit", "_fits", "_carried"}, 68 * 8 * 4)
    head, carried = panel.head.view.canvas, panel.overlay.view._carried
    assert carried == {"to": head.model_id, "state": head.get_state(("_vertices", "_viewpoint", "_front"))}
    assert len(head._vertices) == panel.session.model.neutral.size * 4
    later = {widget for widget, *_ in rest}
    assert later >= {control.readout, panel.history.undo, panel.status}
    assert not later & {panel.head.view.canvas, panel.overlay.view}


def test_waiting_for_the_panel_includes_what_its_fit_requests(panel, monkeypatch):
    shown = []

    def colours():
        time.sleep(0.2)
        shown.append("colours")
        panel._worker.submit(Show(0))

    def show(_fit):
        shown.append("fit")
        if len(shown) == 1:
            panel._slow.submit(colours)

    monkeypatch.setattr(panel, "_show", show)
    panel._worker.submit(Show(0))
    assert panel.wait_idle()
    assert shown == ["fit", "colours", "fit"]
    monkeypatch.setattr(panel, "_show", lambda _fit: time.sleep(0.2))
    panel._worker.submit(Show(0))
    assert not panel.wait_idle(0.05)


def test_a_slider_is_answered_by_the_panel_where_a_fit_takes_long(panel, monkeypatch):
    shown, go_on = [], threading.Event()
    usual = panel.session.fit_frame
    monkeypatch.setattr(panel.session, "fit_frame", lambda *given, **named: (go_on.wait(30), usual(*given, **named))[1])
    monkeypatch.setattr(panel, "_show", lambda fit: shown.append(fit))
    control = panel.controls.by_path["weights.sigma_smooth"]
    control.input.value += 4 * control.input.step
    assert not shown
    assert panel.session.undo_label in panel.history.undo.tooltip
    assert control.readout.value == f"{control.value:.4g}"
    go_on.set()
    panel.wait_idle()
    assert shown


# --- knobs ---


def test_in_a_kernel_a_sliders_number_follows_it_once_however_often_it_moves():
    turned, shown = [], []
    control = KnobControl(BY_PATH["weights.sigma_smooth"], lambda path, value: turned.append(value))
    control.begin_at(1.0)
    control.show(1.0)
    control.readout.observe(lambda change: shown.append(change["new"]), "value")

    async def drag():
        for _ in range(3):
            control.input.value += 2 * control.input.step
        assert not shown
        await asyncio.sleep(4 * knob_control.NUMBER_S)

    asyncio.run(drag())
    assert len(turned) == 3
    assert shown == [f"{turned[-1]:.4g}"]
    assert CHANGED in control.widget._dom_classes


@pytest.mark.parametrize("path", BY_PATH)
def test_every_knob_shows_and_sets_its_number_in_every_preset(path):
    knob = BY_PATH[path]
    other = {"switch": False, "choice": knob.choices[-1:] and knob.choices[-1], "whole": 7}.get(knob.kind, 0.5)
    for config in PRESETS.values():
        changed = config.changed(**changed_by(config, path, other))
        assert value_of(changed, path) == other
    assert len(knob.tip) > 10


def test_the_effective_weight_is_the_product_down_its_branch():
    config = preset("calibrated").changed(weights={"prior": 3.0, "tau": 0.5, "sparse": 2.0, "fit": 0.25})
    effective = effective_weights(config)
    assert effective["weights.tau"] == 1.5
    assert effective["weights.fit"] == 0.5


@pytest.mark.parametrize("value", [0.0, 1e-3, 0.1, 5.0, 20.0, 999.0])
def test_a_logarithmic_slider_has_a_place_for_every_value_and_zero_at_its_end(value):
    knob = BY_PATH["weights.prior"]
    assert value_at(knob, place_of(knob, value)) == pytest.approx(value, rel=0.06)


def test_a_value_between_two_places_stays_until_the_slider_leaves_its_place():
    turned = []
    control = KnobControl(BY_PATH["identity.weight"], lambda path, value: turned.append(value))
    control.show(5.0)
    place = control.input.value
    control.input.value = place  # a browser reports the place it stands at
    assert turned == []
    assert control.readout.value == "5"
    control.input.value = place + 0.05
    assert turned == [pytest.approx(5.62, abs=0.01)]


def test_a_choice_shows_the_path_of_a_weights_file_among_its_own():
    turned = []
    control = KnobControl(BY_PATH["deep.network"], lambda path, value: turned.append(value))
    control.show("nets/fan.safetensors")
    assert control.input.options == ("ensemble", "heat-maps", "landmarks", "dense", "nets/fan.safetensors")
    assert control.input.value == control.value == "nets/fan.safetensors"
    assert turned == []
    control.input.value = "dense"
    assert turned == ["dense"]


def test_a_typed_number_is_taken_as_it_is_and_nonsense_is_put_back():
    turned = []
    control = KnobControl(BY_PATH["weights.tau"], lambda path, value: turned.append(value))
    control.show(0.1)
    control.readout.value = "0,1234"
    assert turned == [0.1234]
    for nonsense in ("much", "nan", "inf"):
        control.readout.value = nonsense
        assert control.readout.value == "0.1234"
        assert turned == [0.1234]


def test_a_refused_number_leaves_the_slider_at_the_old_value(panel):
    knob = panel.controls.by_path["weights.tau"]
    old, shown = knob.value, knob.readout.value
    knob.readout.value = "-3"
    assert "tau" in panel.status.value
    assert (panel.session.config.weights.tau, knob.value, knob.readout.value) == (old, old, shown)


def test_landmark_weights_are_read_as_they_are_written():
    table = {"all": 1.0, "upper lip": 0.25, "30": 2.0}
    assert read_landmarks(landmarks_text(table)) == table
    assert read_landmarks("jaw") == {"jaw": 1.0}
    assert read_landmarks("30 2, 31 2") == {"30": 2.0, "31": 2.0}
    with pytest.raises(ConfigError, match="Write weights with a decimal point"):
        read_landmarks("jaw 0,25")


# --- the panel ---


def test_every_change_of_the_session_reaches_controls_overlay_and_head(panel):
    fits, vertices = panel.overlay.view._fit, drawn_vertices(panel)
    panel.session.set("from another cell", weights={"sigma_smooth": 2.0})
    assert panel.wait_idle()
    assert panel.controls.by_path["weights.sigma_smooth"].readout.value == "2"
    assert panel.overlay.view._fit != fits
    assert np.abs(drawn_vertices(panel) - vertices).max() > 0.05
    np.testing.assert_array_equal(panel.fit.expression, panel.session.fit_frame(0).expression)


@pytest.mark.parametrize("path", [path for path, knob in BY_PATH.items() if knob not in (*METHODS, *TIME)])
def test_turning_a_knob_changes_the_configuration_and_compiles_nothing(path, panel):
    knob = BY_PATH[path]
    before = solve_frame._cache_size(), calibrate_identity._cache_size()
    values = knob.choices if knob.kind == "choice" else [True, False] if knob.kind == "switch" else [knob.high, 1]
    for value in values:
        panel.turn(path, value if knob.kind in ("choice", "switch", "whole") else float(value))
        assert panel.wait_idle()
        assert value_of(panel.session.config, path) == value
    assert (solve_frame._cache_size(), calibrate_identity._cache_size()) == before
    assert panel.fit.found


def test_stages_are_reordered_switched_and_freed_without_compiling(panel):
    panel.session.use(preset("calibrated"))
    before = solve_frame._cache_size()
    editor = panel.stages
    editor._rows[4].buttons["up"].click()
    assert [stage.name for stage in panel.session.config.stages][-2:] == ["expression", "pose"]
    editor._rows[0].enabled.value = False
    editor._rows[4].free["expression"].value = True
    editor._rows[4].landmarks.value = "all 1, jaw 0.25"
    editor._rows[4].limit.value = 7
    editor.add.click()
    assert panel.wait_idle()
    stages = panel.session.config.stages
    assert not stages[0].enabled
    assert stages[4].free == ("rotation", "translation", "expression")
    assert stages[4].landmarks == {"all": 1.0, "jaw": 0.25}
    assert stages[4].limit == 7
    assert len(stages) == 6
    editor._rows[5].buttons["drop"].click()
    assert len(panel.session.config.stages) == 5
    assert panel.wait_idle()
    assert solve_frame._cache_size() == before


@pytest.mark.parametrize("name", PRESETS)
def test_the_stage_table_shows_every_stage_and_what_its_system_can_free(name):
    config = preset(name)
    editor = StageEditor(lambda stages, label: None, lambda what, number: None, 190)
    editor.show(config)
    assert [row.name.value for row in shown_in(editor)] == [stage.name for stage in config.stages]
    free = {"rotation", "translation", "expression"}
    if config.system == "deep-energies":
        free |= {"jaw_open", "jaw", "identity", "scale"}
    for row in shown_in(editor):
        assert {block for block, toggle in row.free.items() if is_shown(toggle)} == free
        assert all(is_shown(button) for button in row.buttons.values())


def test_an_edit_of_a_stage_leaves_its_landmark_weights_unless_their_text_is_changed():
    config, handed = preset("joint"), []
    stages = [stage.model_dump() for stage in config.stages]
    stages[0]["landmarks"] = {"all": 1.0, "jaw": 0.123456789}
    editor = StageEditor(lambda stages, label: handed.append(stages), lambda what, number: None, 190)
    editor.show(config.changed(stages=stages))
    editor._rows[0].limit.value = 7
    assert handed[-1][0]["landmarks"] == {"all": 1.0, "jaw": 0.123456789}
    editor._rows[0].landmarks.value = "all 1, jaw 0.5"
    assert handed[-1][0]["landmarks"] == {"all": 1.0, "jaw": 0.5}


def test_a_stage_can_be_added_to_the_longest_schedule_and_taken_away_again():
    config = preset("deep")
    handed = []
    editor = StageEditor(lambda stages, label: handed.append(stages), lambda what, number: None, 190)
    editor.show(config)
    editor.add.click()
    editor.show(config.changed(stages=handed[-1]))
    assert [row.name.value for row in shown_in(editor)][-1] == "stage 1"
    shown_in(editor)[-1].buttons["drop"].click()
    assert [stage["name"] for stage in handed[-1]] == [stage.name for stage in config.stages]


def shown_in(editor):
    return [row for row in editor._rows if is_shown(row.widget)]


def is_shown(widget):
    return widget.layout.display != "none"


def test_no_two_widgets_share_a_layout_so_that_hiding_one_hides_no_other(panel, clip_panel, head, photo):
    deep = StageEditor(lambda stages, label: None, lambda what, number: None, 190)
    deep.show(preset("deep"))
    landmarks = photo.observations[0].landmarks
    roots = (
        panel, clip_panel, deep.widget, SessionOpener(), LivePanel(sample("performance"), head),
        LightPanel(lambda light: np.zeros((8, 8, 3))), FitPlayground(photo.pictures[0], landmarks, head),
    )  # fmt: skip
    for root in roots:
        owners = {}
        for widget in within(root):
            owners.setdefault(id(widget.layout), []).append(widget)
        assert len(owners) > 5
        assert [shared for shared in owners.values() if len(shared) > 1] == []
    for root in roots[3:]:
        root.close()


def within(widget):
    """A widget and all that it holds, hidden pages too."""
    yield widget
    for child in getattr(widget, "children", ()):
        yield from within(child)


def test_a_stage_names_terms_beside_those_of_its_system():
    handed = []
    editor = StageEditor(lambda stages, label: handed.append(stages), lambda what, number: None, 190)
    editor.show(preset("deep"))
    row = editor._rows[0]
    assert row.terms.value == "edges"
    row.terms.value = "edges, tau"
    assert handed[-1][0]["terms"] == ("edges", "tau")
    for text, said in {"tao": "did you mean 'tau'?", "wings": "the terms are edges, tau"}.items():
        row.terms.value = text
        assert said in row.result.value
    assert len(handed) == 1


def test_a_stage_that_cannot_be_is_explained_and_put_back(panel):
    shown = panel.stages._rows[: len(panel.session.config.stages)]
    for row in shown:
        if row.when.value == "always":
            row.enabled.value = False
    assert "no enabled stage runs on every frame" in panel.status.value
    assert any(row.enabled.value and row.when.value == "always" for row in shown)
    panel.stages._rows[1].landmarks.value = "noose 1"
    assert "did you mean" in panel.status.value


def test_stepping_shows_one_iteration_after_the_other(panel):
    total = sum(panel._iterations.counts.values())
    panel.stages.step.click()
    panel.wait_idle()
    assert f"stopped after 0 of {total}" in panel.stages.place.value
    first = panel.fit.errors[1]
    for _ in range(6):
        panel.stages.step.click()
        panel.wait_idle()
    assert "stopped after 6" in panel.stages.place.value
    assert panel.fit.errors[1] != first
    panel.stages._rows[1].buttons["here"].click()
    panel.wait_idle()
    assert "stopped after" in panel.stages.place.value
    panel.stages.all.click()
    panel.wait_idle()
    np.testing.assert_array_equal(panel.fit.expression, panel.session.fit_frame(0).expression)


def test_the_head_is_drawn_as_the_chosen_character(fresh_panel):
    session, before = fresh_panel.session, fresh_panel.fit
    assert not fresh_panel.head.view.canvas._mesh["worn"]
    fresh_panel.head.character.widget.value = "leila"
    fresh_panel.wait_idle()
    assert session.config.head.character == "leila"
    assert [part["kind"] for part in fresh_panel.head.view.canvas._mesh["worn"]][-1] == "hair"
    assert fresh_panel.head.view.canvas._person["rest"]
    np.testing.assert_array_equal(fresh_panel.fit.expression, before.expression)
    assert not session.stale.any()
    fresh_panel.undo.click()
    fresh_panel.wait_idle()
    assert fresh_panel.head.character.widget.value == "plain"
    assert not fresh_panel.head.view.canvas._mesh["worn"]


def test_undo_redo_presets_and_snapshots(fresh_panel):
    start = fresh_panel.session.config
    fresh_panel.turn("weights.tau", 3.0)
    fresh_panel.name.value = "mine"
    fresh_panel.keep.click()
    fresh_panel.reset.value = "preset:face-it"
    assert fresh_panel.session.config == PRESETS["face-it"]
    assert fresh_panel.reset.value == ""
    fresh_panel.reset.value = "snapshot:mine"
    assert fresh_panel.session.config.weights.tau == 3.0
    for _ in range(3):
        fresh_panel.undo.click()
    assert fresh_panel.session.config == start
    assert fresh_panel.undo.disabled
    assert not fresh_panel.redo.disabled
    fresh_panel.head.compare.value = "mine"
    assert fresh_panel.wait_idle()
    assert fresh_panel.head.view.canvas._ghost["vertices"]
    fresh_panel.session.set(head={"character": "mei"})  # drawn by another view
    assert fresh_panel.wait_idle()
    assert fresh_panel.head.view.canvas._mesh["worn"]
    assert fresh_panel.head.view.canvas._ghost["vertices"]


def test_a_preset_keeps_what_the_landmarks_were_found_with(head, photo):
    found = {"detector": "network", "face": (10.0, 20.0)}
    session = TuningSession(head, photo, preset("joint").changed(landmarks=found))
    HistoryBar(session, StatusLine()).reset.value = "preset:dense"
    assert session.config.stages == PRESETS["dense"].stages
    assert session.config.landmarks.weights == PRESETS["dense"].landmarks.weights
    assert (session.config.landmarks.detector, session.config.landmarks.face) == ("network", (10.0, 20.0))


def test_a_snapshot_without_a_name_replaces_none(head, photo):
    session = TuningSession(head, photo)
    bar = HistoryBar(session, StatusLine())
    session.take_snapshot("snapshot 2")
    session.set(weights={"tau": 3.0})
    for _ in range(2):
        bar.take()
    assert session.snapshots["snapshot 2"] == session.base
    assert list(session.snapshots) == ["snapshot 2", "snapshot 1", "snapshot 3"]


def test_landmarks_are_muted_weighed_moved_put_back_and_named_in_the_picture(panel):
    tools = panel.overlay
    tools._on_event(OverlayEvent("mute", (8, 9), None, None))
    panel.wait_idle()
    assert tools.view.muted == (8, 9)
    tools._on_event(OverlayEvent("mute", (8, 9), None, None))
    tools._on_event(OverlayEvent("weight_up", (30,), None, None))
    assert panel.session.config.point_weights()[30] == 2.0
    tools._on_event(OverlayEvent("drag", (30,), 260.0, 140.0))
    tools._on_event(OverlayEvent("drop", (30,), 262.0, 141.0))
    panel.wait_idle()
    np.testing.assert_array_equal(panel.fit.observed[30], (262.0, 141.0))
    tools._on_event(OverlayEvent("reset", (30,), None, None))
    assert panel.session.config.landmarks.moved == {}
    tools.view.selection = [50, 51, 52]
    tools.name.value = "upper lip"
    tools.save.click()
    assert panel.session.config.subsets == {"upper lip": (50, 51, 52)}
    tools.view.selection = []
    tools.group.value = "upper lip"
    assert tools.view.selection == [50, 51, 52]
    tools.view.selection = []
    tools.mute.click()
    assert "Select landmarks first" in panel.status.value


def drawn_vertices(panel):
    return np.frombuffer(panel.head.view.canvas._vertices, "<f4").reshape(-1, 3)


def test_layers_colours_and_points_are_drawn(panel):
    for name in ("wire", "layer"):
        panel.overlay.layers[name].value = True
    panel.head.color.value = "residual"
    panel.head.points.value = True
    assert panel.wait_idle()
    assert len(panel.overlay.view._wire) > 10_000
    assert len(panel.overlay.view._layer) > 10_000
    colors = panel.head.view.canvas._colors
    assert len(colors) == 3 * len(drawn_vertices(panel))
    assert len(panel.head.view.canvas._points["ends"]) == 68 * 24
    panel.head.color.value = "blendshape"
    panel.head.shape.value = "jawOpen"
    assert panel.wait_idle()
    assert panel.head.view.canvas._colors != colors
    assert "color:var(--jp-error" not in panel.status.value


def test_the_heat_layer_shows_what_the_landmark_network_sees_of_the_selection(panel):
    panel.overlay.layers["heat"].value = True
    assert panel.wait_idle()
    all_of_them = panel.overlay.view._heat
    panel.overlay.view._handle_custom_msg({"kind": "select", "points": [30]}, [])
    assert panel.wait_idle()
    one = cv2.imdecode(np.frombuffer(panel.overlay.view._heat, np.uint8), cv2.IMREAD_UNCHANGED)
    assert one.shape == (512, 512, 4)
    assert panel.overlay.view._heat != all_of_them
    rows, columns = np.nonzero((one[..., 3] > 180) & (one[..., 2] < 50))  # red is low in the heat, not in the outline
    assert np.hypot(columns.mean() - panel.fit.observed[30, 0], rows.mean() - panel.fit.observed[30, 1]) < 8
    panel.overlay.layers["heat"].value = False


def test_without_a_picture_there_is_no_heat(clip_panel):
    clip_panel.overlay.layers["heat"].value = True
    assert clip_panel.wait_idle()
    assert clip_panel.overlay.view._heat == b""
    assert clip_panel.overlay.view.message == "no picture, no heat map"
    clip_panel.overlay.layers["heat"].value = False
    assert clip_panel.wait_idle()
    assert clip_panel.overlay.view.message == ""


def test_colours_and_legend_of_the_head_change_together_while_the_uncertainty_is_worked_out(panel, monkeypatch):
    begun, go_on = threading.Event(), threading.Event()

    def slow(fit):
        begun.set()
        go_on.wait(60)
        return np.linspace(0.0, 1.0, len(panel.head.view._model.neutral))

    monkeypatch.setattr(panel.head, "_uncertainty", slow)
    panel.head.color.value = "residual"
    assert panel.wait_idle()
    assert shown_colors(panel) == ("values", "residual, % of eye distance")
    panel.head.color.value = "uncertainty"
    assert begun.wait(60)
    assert panel._worker.wait_idle()
    assert shown_colors(panel) == ("skin", "")
    assert "computing the uncertainty of frame" in panel.head.working.value
    panel.turn("weights.sigma_smooth", 3.0)
    assert panel._worker.wait_idle()
    assert panel.fit.expression.tolist() == panel.session.fit_frame(0).expression.tolist()
    panel.head.color.value = "residual"
    assert panel._worker.wait_idle()
    assert shown_colors(panel) == ("values", "residual, % of eye distance")
    assert panel.head.working.value == ""
    panel.head.color.value = "uncertainty"
    go_on.set()
    assert panel.wait_idle()
    assert shown_colors(panel) == ("values", "standard deviation, mm")
    assert panel.head.working.value == ""
    panel.head.color.value = "skin"
    assert panel.wait_idle()
    assert shown_colors(panel) == ("skin", "")


def shown_colors(panel):
    """Whether the head has its skin or the colours of values, and the label of its legend."""
    view = panel.head.view
    label = re.search("<span>(.*?)</span>", view._legend.value) if view._legend.layout.display is None else None
    return ("values" if view.canvas._colors else "skin"), label[1] if label else ""


def test_the_head_and_the_fits_do_not_wait_for_a_slow_layer_of_the_picture(panel, monkeypatch):
    begun, go_on = threading.Event(), threading.Event()

    def slow(fit):
        begun.set()
        go_on.wait(60)
        return np.zeros((4, 4, 4), np.uint8)

    monkeypatch.setattr(panel.overlay._pictures, "_face", slow)
    panel.overlay.layers["layer"].value = False
    panel.overlay.layers["layer"].value = True
    assert begun.wait(60)
    patience = time.monotonic() + 10.0
    while "drawing the face" not in panel.waiting.said.value and time.monotonic() < patience:
        time.sleep(0.02)
    assert "drawing the face" in panel.waiting.said.value
    panel.head.color.value = "residual"
    assert panel._worker.wait_idle()
    assert shown_colors(panel)[0] == "values"
    go_on.set()
    assert panel.wait_idle()
    assert "drawing the face" not in panel.waiting.said.value
    panel.overlay.layers["layer"].value = False
    panel.head.color.value = "skin"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name == "gaze" else name for name in FACE_IT_PRESETS]
)
def test_without_stages_to_draw_the_film_strip_is_a_sentence_and_no_broken_picture(name, panel):
    panel.session.use(preset(name))
    assert panel.wait_idle()
    assert "stages of Deep Energies" in panel.strip.note.value
    assert not is_shown(panel.strip.image)


def test_the_film_strip_of_landmarks_alone_says_that_it_needs_pictures(head, clip):
    strip = FilmStrip(TuningSession(head, clip, preset("deep")))
    strip.show_frame(0)
    assert "drawn on the picture" in strip.note.value
    assert not is_shown(strip.image)


def test_the_film_strip_shows_the_stages_and_says_meanwhile_what_it_does(head, monkeypatch):
    config = preset("deep")
    session = open_session(sample("astronaut"), config, landmarks=sample("astronaut-landmarks"), model=head)
    strip, said = FilmStrip(session), []

    def drawn(frame):
        said.append(strip.note.value)
        return np.zeros((40, 60, 3), np.uint8)

    monkeypatch.setattr(session, "stage_strip", drawn)
    strip.show_frame(0)
    assert "Fitting the stages" in said[0]
    assert is_shown(strip.image)
    assert strip.note.value == ""
    assert len(strip.image.value) > 100
    session.use(preset("joint"))
    strip.show_config()
    assert not is_shown(strip.image)


def test_a_drag_of_a_slider_is_one_step_however_slow_and_the_next_drag_another(panel, monkeypatch):
    monkeypatch.setattr(gesture, "GESTURE_S", 0.0)
    for drag, values in ((1, (15.0, 9.0, 4.0)), (2, (3.0, 2.0))):
        panel.page.drag = drag
        for value in values:
            panel.turn("weights.sigma_smooth", value)
    panel.page.drag = 0
    panel.turn("weights.sigma_smooth", 1.0)
    found = []
    while panel.session.undo():
        found.append(panel.session.config.weights.sigma_smooth)
    assert found[:3] == [2.0, 4.0, 20.0]


def test_a_drag_of_a_landmark_is_one_step_and_an_arrow_key_after_it_another(panel, monkeypatch):
    monkeypatch.setattr(gesture, "GESTURE_S", 0.0)
    for kind, x in (
        ("drag", 260.0),
        ("drag", 261.0),
        ("drop", 262.0),
        ("drop", 263.0),
        ("drag", 264.0),
        ("drop", 265.0),
    ):
        panel.overlay._on_event(OverlayEvent(kind, (30,), float(x), 140.0))
    found = []
    while panel.session.undo() and panel.session.config.landmarks.moved:
        found.append(panel.session.config.landmarks.moved["0"]["30"][0])
    assert found == [263.0, 262.0]


def test_arrow_keys_that_follow_each_other_move_all_selected_landmarks_in_one_step(head, photo):
    session = TuningSession(head, photo)
    tools = LandmarkTools(session, FittedHead(head), lambda said: None, Waiting(), lambda: None)
    for press in range(3):
        for point in (30, 31, 32):
            tools._on_event(OverlayEvent("drop", (point,), 260.0 + press, 140.0))
    session.undo()
    assert session.config == session.base
    tools.close()


def test_a_cancelled_drag_leaves_no_trace(head, photo):
    session = TuningSession(head, photo)
    tools = LandmarkTools(session, FittedHead(head), lambda said: None, Waiting(), lambda: None)
    session.set(weights={"tau": 0.5})
    before, steps = session.config, session.undo_steps
    for kind in ("drag", "drag", "cancel"):
        tools.view._handle_custom_msg({"kind": kind, "points": [30], "x": 260.0, "y": 140.0}, [])
    assert session.config == before
    assert session.undo_steps == steps
    tools.view._handle_custom_msg({"kind": "cancel", "points": [30], "x": 260.0, "y": 140.0}, [])  # of no drag
    for kind in ("drag", "drop"):
        tools.view._handle_custom_msg({"kind": kind, "points": [8], "x": 200.0, "y": 240.0}, [])
    assert set(session.config.landmarks.moved["0"]) == {"8"}
    assert len(session.undo_steps) == len(steps) + 1
    tools.close()


NAMED_BY_NO_STAGE = {
    "weights.flow",
    "weights.vergence",
    "weights.opposites",
    "weights.gaze",
    "weights.symmetry",
    "weights.usual",
    "constants.weighted_edges",
}
"""What belongs to terms that no stage of FACE IT!'s presets names."""
OF_BETA = {"constants.a", "constants.b", "constants.c"}
"""What belongs to E_β, whose weight is 0 in the presets that begin."""
UNSEEN = {"group.irises", "group.dense"}
"""The weights of points that detectors of the 68 do not see."""


def test_settings_of_the_other_system_are_greyed_out_and_a_sentence_says_why(panel):
    assert controls_of(panel, enabled=False) == {knob.path for knob in DEEP} | NAMED_BY_NO_STAGE | OF_BETA | UNSEEN
    assert "detector" in panel.controls.notes["points"].value
    assert "Deep Energies" in panel.controls.notes["deep"].value
    assert [title for title, note in panel.controls.notes.items() if is_shown(note)] == ["ω", "points", "a b c", "deep"]
    panel.controls.show(preset("deep"))
    of_face_it = {knob.path for knob in (*OMEGA, *CONSTANTS)} | {"solver.method", "solver.tolerance"}
    assert controls_of(panel, enabled=False) == of_face_it - {"constants.weighted_edges"} | {"deep.prior"} | UNSEEN
    assert [title for title, note in panel.controls.notes.items() if is_shown(note)] == [
        "ω",
        "ρ ε",
        "points",
        "a b c",
        "deep",
    ]
    assert "no stage names" in panel.controls.notes["deep"].value
    panel.controls.show(panel.session.config)
    assert not is_shown(panel.controls.notes["ρ ε"])


def controls_of(panel, enabled):
    return {path for path, control in panel.controls.by_path.items() if control.input.disabled != enabled}


def test_sliders_of_further_points_act_where_there_are_such_points_whatever_the_detector_is_called():
    def greyed(config, scheme):
        controls = Controls(config, lambda path, value: None, scheme=scheme)
        return {path for path in UNSEEN if controls.by_path[path].input.disabled}

    assert greyed(preset("dense"), IBUG68) == UNSEEN
    assert greyed(preset("joint"), DENSE) == set()


@pytest.mark.parametrize(("beta", "prior", "greyed"), [(0.0, 1.0, OF_BETA), (3.0, 0.0, OF_BETA), (3.0, 1.0, set())])
def test_the_constants_of_a_term_act_where_the_product_of_its_weights_is_not_0(beta, prior, greyed):
    controls = Controls(preset("joint").changed(weights={"beta": beta, "prior": prior}), lambda path, value: None)
    assert {path for path in OF_BETA if controls.by_path[path].input.disabled} == greyed


def test_the_note_on_constants_calls_them_settings_and_names_both_reasons(panel):
    assert (
        "Greyed-out settings belong to terms that no stage names, or whose weight"
        in panel.controls.notes["a b c"].value
    )


@pytest.mark.parametrize(("value", "shown"), [(1000.0, "=1000"), (1234.0, "=1230"), (0.05, "=0.05"), (0.0, "=0")])
def test_the_product_beside_a_weight_has_no_exponent(value, shown):
    config = preset("joint").changed(weights={"prior": 1.0, "tau": value})
    controls = Controls(config, lambda path, number: None)
    assert controls.by_path["weights.tau"].effective.value == shown


def test_the_field_of_view_is_that_of_a_measured_camera_where_there_is_one():
    camera = {"matrix": [[900, 0, 320], [0, 900, 240], [0, 0, 1]]}
    controls = Controls(preset("joint").changed(camera=camera), lambda path, value: None)
    assert controls.by_path["camera.fov_deg"].input.disabled
    assert "camera.matrix" in controls.notes["camera"].value
    controls.show(preset("joint"))
    assert not controls.by_path["camera.fov_deg"].input.disabled
    assert controls.notes["camera"].value == ""


def test_what_is_greyed_out_changes_no_fit(head, photo):
    config = other = preset("joint")
    for path in inert_among(config, BY_PATH):
        knob = BY_PATH[path]
        value = {"choice": knob.choices[-1:], "switch": (False,)}.get(knob.kind, (0.7,))[0]
        other = other.changed(**changed_by(other, path, value))
    before, after = (TuningSession(head, photo, made).fit_frame(0) for made in (config, other))
    assert len(differences(config, other)) == len(DEEP) + len(NAMED_BY_NO_STAGE | OF_BETA | UNSEEN)
    np.testing.assert_array_equal(after.expression, before.expression)
    np.testing.assert_array_equal(after.rotation, before.rotation)


def test_a_clip_is_run_again_after_a_change_and_the_frame_follows_the_timeline(clip_panel):
    panel = clip_panel
    assert not panel.session.stale.any()
    panel.turn("weights.sigma_smooth", 1.0)
    assert panel.wait_idle()
    assert not panel.session.stale.any()
    panel.clip.timeline.frame = 6
    assert panel.wait_idle()
    assert panel.frame == panel.fit.index == 6
    np.testing.assert_array_equal(panel.fit.expression, panel.session.run.fits[6].expression)
    panel.transport.steps[-1].click()
    assert panel.frame == 5
    panel.follow.value = False
    panel.turn("weights.sigma_smooth", 9.0)
    assert panel.wait_idle()
    assert panel.session.stale.all()
    panel.run_clip.click()
    assert panel.wait_idle()
    assert not panel.session.stale.any()


def test_the_export_of_the_panel_is_the_configuration_of_the_session(clip_panel, tmp_path):
    clip_panel.turn("weights.tau", 2.0)
    clip_panel.file.value = str(tmp_path / "mine")
    clip_panel.export.click()
    assert clip_panel.wait_idle()
    stored = read_config(tmp_path / "mine.toml")
    assert stored.changed(provenance=None) == clip_panel.session.config
    assert "workbench track" in clip_panel.exported.value


def test_settings_that_were_saved_come_back_in_one_undo_step(clip_panel, tmp_path):
    panel = clip_panel
    panel.turn("weights.tau", 2.0)
    panel.file.value = str(tmp_path / "mine")
    panel.export.click()
    assert panel.wait_idle()
    panel.turn("weights.tau", 7.0)
    before = panel.session.config
    panel.load.click()
    assert panel.wait_idle()
    assert panel.session.config.weights.tau == panel.controls.by_path["weights.tau"].value == 2.0
    assert not panel.session.unexported
    assert panel.session.undo_label == "settings of mine.toml"
    assert panel.exported.value == "now using mine.toml; undo brings back the settings before it"
    panel.undo.click()
    assert panel.session.config == before


def test_a_file_that_holds_no_settings_says_so_and_changes_nothing(clip_panel, tmp_path):
    panel, before = clip_panel, clip_panel.session.config
    (tmp_path / "wrong.toml").write_text("[weights]\ntaw = 3.0\n")
    for name, told in (("wrong", "taw"), ("absent", "does not exist")):
        panel.file.value = str(tmp_path / name)
        panel.load.click()
        assert told in panel.exported.value
    assert panel.session.config == before


@pytest.fixture
def jumping_panel(head, clip, monkeypatch):
    """A clip whose head jumps aside in one frame, in a panel that compiles what it needs only when it needs it."""
    monkeypatch.setattr(TuningSession, "warm_up", lambda session: None)
    observations = list(clip.observations)
    landmarks = observations[JUMP].landmarks
    moved = replace(landmarks, points=landmarks.points + np.array([60.0, 0.0]))
    observations[JUMP] = replace(observations[JUMP], landmarks=moved)
    made = TuningPanel(TuningSession(head, replace(clip, observations=tuple(observations))), backend="webgl")
    assert made.wait_idle(300)
    yield made
    made.close()


JUMP = 4


def test_the_export_offers_a_free_name_or_to_overwrite_what_is_there(jumping_panel, tmp_path):
    panel, taken = jumping_panel, tmp_path / "tuned.toml"
    taken.write_text("of another clip")
    panel.file.value = str(taken)
    panel.export.click()
    assert panel.wait_idle()
    assert taken.read_text() == "of another clip"
    assert "tuned.toml exists already: pressing save again writes clip-tuned.toml." in panel.exported.value
    assert panel.overwrite.description == "overwrite tuned.toml"
    assert panel.overwrite.layout.display is None
    panel.export.click()
    assert panel.wait_idle()
    assert (tmp_path / "clip-tuned.toml").exists()
    assert panel.overwrite.layout.display == "none"
    panel.file.value = str(taken)
    panel.export.click()
    panel.overwrite.click()
    assert panel.wait_idle()
    assert read_config(taken).changed(provenance=None) == panel.session.config


def test_a_flagged_frame_says_why_in_the_diagnosis_and_on_the_strip(jumping_panel):
    panel = jumping_panel
    why = panel.session.run.flags.text[JUMP]
    assert "the pose jumps" in why
    assert panel.clip.timeline.get_state("_why")["_why"][str(JUMP)] == why
    panel.go(JUMP)
    panel.diagnosis.ask.click()
    assert panel.wait_idle(300)
    assert f"Frame {JUMP}: flagged, {why}" in panel.diagnosis.status.value


@pytest.mark.parametrize(
    ("reasons", "flag", "said"),
    [
        (2, "", "2 found, most likely first."),
        (0, "", "no reason found; the frame is unremarkable."),
        (0, "the pose jumps", "flagged, the pose jumps; none of the causes tried explains it."),
        (1, "the pose jumps", "flagged, the pose jumps; 1 found, most likely first."),
    ],
)
def test_a_diagnosis_never_says_that_a_flagged_frame_does_not_stand_out(reasons, flag, said):
    assert found_text(reasons, flag) == said


def test_a_diagnosis_is_shown_and_its_change_applied_and_taken_back(panel):
    panel.diagnosis.ask.click()
    assert panel.wait_idle(300)
    assert "Frame 0" in panel.diagnosis.status.value
    assert "Pull of each group" in panel.diagnosis.tables.value
    before = panel.session.config
    applied = panel.diagnosing.apply(Change("Mute the jaw", config={"landmarks": {"weights": {"jaw": 0.0}}}))
    assert panel.session.config.point_weights()[0] == 0.0
    assert panel.session.undo_label == "Mute the jaw"
    panel.session.set(weights={"tau": 7.0})
    assert not panel.diagnosing.take_back(applied)
    assert "Other changes came after this one" in panel.status.value
    assert panel.session.config.weights.tau == 7.0
    panel.session.set(weights={"tau": before.weights.tau})
    assert not panel.diagnosing.take_back(applied)  # a change there and back is two steps that came after
    panel.session.undo()
    panel.session.undo()
    assert panel.diagnosing.take_back(applied)
    assert panel.session.config == before
    assert panel.diagnosing.take_back(applied)
    assert "undone already" in panel.status.value
    assert panel.session.config == before


@pytest.fixture
def diagnosed(panel, monkeypatch):
    """The panel with a diagnosis of one reason, which mutes the jaw."""
    names, none = ("yaw", "pitch", "roll", "x", "y", "z", "jawOpen"), np.zeros(3)
    uncertainty = Uncertainty(
        names, np.eye(7), np.eye(7), 1.0, none, none, np.zeros(1), np.zeros(1, bool), condition=1.0, pairs=()
    )
    mute = Change("Mute the jaw", config={"landmarks": {"weights": {"jaw": 0.0}}})
    reason = Reason("jaw", "The jaw is off", "by 9 %", 0.9, {}, mute, before_percent=3.0, after_percent=1.0)
    found = Diagnosis((reason,), (), uncertainty, panel.fit)
    monkeypatch.setattr(panel.session, "diagnose", lambda *_: found)
    panel.diagnosis.ask.click()
    assert panel.wait_idle(60)
    yield panel
    panel.diagnosis.clear()


def greyed_out(panel):
    """Whether the diagnosis is pale, its changes cannot be applied, and its line says why."""
    view = panel.diagnosis
    told = OLD in view.reasons._dom_classes, view.apply_buttons[0].disabled, "other settings" in view.status.value
    assert len(set(told)) == 1, told
    return told[0]


def test_a_diagnosis_of_other_settings_is_greyed_out_until_they_are_back_or_it_is_asked_for_again(diagnosed):
    seen = [greyed_out(diagnosed)]
    for change in (
        lambda: diagnosed.session.set(weights={"tau": 7.0}),
        diagnosed.session.undo,
        diagnosed.session.redo,
        diagnosed.diagnosis.ask.click,
    ):
        change()
        assert diagnosed.wait_idle(60)
        seen.append(greyed_out(diagnosed))
    assert seen == [False, True, False, True, False]


def test_settings_that_no_fit_of_a_frame_depends_on_leave_its_diagnosis_as_it_is(diagnosed):
    for section in ({"infill": {"largest_error": 20.0, "frames": [(0, 0)]}}, {"head": {"character": "mei"}}):
        diagnosed.session.set(**section)
    assert diagnosed.wait_idle(60)
    assert not greyed_out(diagnosed)


def test_a_diagnosis_stays_with_its_own_changes(diagnosed):
    (apply,) = diagnosed.diagnosis.apply_buttons
    apply.click()
    assert diagnosed.wait_idle(60)
    assert (OLD in diagnosed.diagnosis.reasons._dom_classes, apply.disabled) == (False, True)
    diagnosed.session.undo()
    assert diagnosed.wait_idle(60)
    assert OLD not in diagnosed.diagnosis.reasons._dom_classes


def test_a_change_that_the_settings_have_already_is_no_step(panel):
    mute = Change("Mute the jaw", config={"landmarks": {"weights": {"jaw": 0.0}}})
    assert panel.diagnosing.apply(mute) is not None
    assert panel.diagnosing.apply(mute) is None
    assert "already have this change" in panel.status.value


def test_a_change_that_the_session_refuses_is_not_taken_for_applied(panel):
    before = panel.session.config
    assert panel.diagnosing.apply(Change("Impossible", config={"weights": {"tau": -1.0}})) is None
    assert panel.session.config == before


def test_callbacks_from_other_threads_end_with_the_last_value(panel):
    values = np.linspace(0.5, 30.0, 24).round(3)
    lock = threading.Lock()

    def drag(part):
        for value in part:
            with lock:
                panel.turn("weights.sigma_smooth", float(value))

    threads = [threading.Thread(target=drag, args=(part,)) for part in (values[:12], values[12:])]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    panel.turn("weights.sigma_smooth", 4.0)
    assert panel.wait_idle()
    np.testing.assert_array_equal(panel.fit.expression, panel.session.fit_frame(0).expression)
    assert panel.session.config.weights.sigma_smooth == 4.0


def test_a_failing_fit_is_said_and_the_panel_goes_on(panel, monkeypatch):
    def broken(*_arguments, **_options):
        raise ValueError("broken on purpose")

    with monkeypatch.context() as patched:
        patched.setattr(panel.session, "fit_frame", broken)
        panel.turn("weights.tau", 1.0)
        assert panel.wait_idle()
        assert "broken on purpose" in panel.status.value
    panel.turn("weights.tau", 2.0)
    assert panel.wait_idle()
    assert "broken" not in panel.status.value


def test_a_browser_without_webgl_gets_pictures(fresh_panel):
    fresh_panel.overlay.view.webgl = False
    assert fresh_panel.wait_idle()
    assert type(fresh_panel.head.view).__name__ == "PictureHeadView"
    assert "no WebGL" in fresh_panel.head.note.value


def test_a_closed_panel_no_longer_follows(head, photo):
    session = TuningSession(head, photo)
    panel = TuningPanel(session, backend="webgl")
    panel.wait_idle(300)
    panel.close()
    panel.close()
    session.set(weights={"tau": 5.0})
    assert panel.controls.by_path["weights.tau"].readout.value == "0.1"


# --- latest wins ---


def test_of_many_requests_the_last_one_is_done_and_at_most_one_waits():
    done, waiting, go = [], [], threading.Event()

    def work(value):
        go.wait(5)
        done.append(value)

    worker = LatestWins(work, lambda error: None)
    for value in range(100):
        worker.submit(value)
        waiting.append(worker.waiting)
    go.set()
    assert worker.wait_idle(5)
    assert done[-1] == 99
    assert len(done) <= 3
    assert max(waiting) <= 1
    worker.close()
    worker.close()


def test_an_exception_does_not_end_the_worker():
    done, failed = [], []

    def work(value):
        if value < 0:
            raise ValueError("negative")
        done.append(value)

    worker = LatestWins(work, failed.append)
    worker.submit(-1)
    assert worker.wait_idle(5)
    worker.submit(1)
    assert worker.wait_idle(5)
    assert done == [1]
    assert str(failed[0]) == "negative"
    worker.close()


def test_submitting_never_waits_for_the_work():
    worker = LatestWins(lambda _value: time.sleep(0.3), lambda error: None)
    began = time.perf_counter()
    for value in range(50):
        worker.submit(value)
    assert time.perf_counter() - began < 0.2
    assert not worker.wait_idle(0.01)
    worker.close()


# --- the fitted head ---


def test_residuals_in_3d_project_to_the_observed_pixels(head, photo):
    from workbench.pictures.mesh import to_camera, to_pixels

    session = TuningSession(head, photo, preset("calibrated").changed(contour={"mode": "fixed"}))
    fit, fitted = session.fit_frame(0), FittedHead(head)
    landmarks = fitted.landmarks(fit)
    ends = [to_pixels(fit.camera, to_camera(part, fit.rotation, fit.translation))
            for part in (landmarks, fitted.observed(fit, landmarks))]  # fmt: skip
    np.testing.assert_allclose(ends[0], fit.projected, atol=0.01)
    np.testing.assert_allclose(ends[1], fit.observed, atol=0.05)


def test_a_head_is_moved_by_its_own_blendshapes_whatever_another_thread_asks_for_meanwhile(head, photo):
    fit, fitted = TuningSession(head, photo).fit_frame(0), FittedHead(head)
    blinking = replace(fit, expression=np.ones(len(fit.expression)))  # lids move as far as a person's eyes are wide
    one, other = (replace(blinking, identity=np.full(50, value)) for value in (-1.0, 1.0))
    waiting = [other]

    class Lock:
        """The other thread has its turn as soon as this one lets go for the first time."""

        def __enter__(self):
            pass

        def __exit__(self, *raised):
            if waiting:
                fitted.vertices(waiting.pop())

    fitted._lock = Lock()
    np.testing.assert_array_equal(fitted.vertices(one), FittedHead(head).vertices(one))


def test_a_number_of_the_landmarks_spreads_over_the_face_and_not_to_the_back(head):
    spread = FittedHead(head).surface_values(np.arange(68.0))
    nose, back = head.landmarks.vertices[30][0], int(np.argmax(head.neutral[:, 2]))
    assert spread[nose] == pytest.approx(30.0, abs=4.0)
    assert np.isnan(spread[back])
