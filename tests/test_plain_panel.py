"""The panel of core widgets without a browser: what it shows, and that it follows the session."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from workbench.samples import sample
from workbench.session import TuningSession, open_session
from workbench.widgets import PlainPanel

CORE = ("@jupyter-widgets/base", "@jupyter-widgets/controls", "@jupyter-widgets/output")


@pytest.fixture(scope="module")
def panel():
    """A panel on three frames of a clip, the last one without a face."""
    opened = open_session(sample("laugh"), landmarks=sample("laugh-landmarks"))
    first, second, third = opened.material.observations[:3]
    third = replace(third, landmarks=None)
    material = replace(opened.material, observations=(first, second, third))
    made = PlainPanel(TuningSession(opened.model, material, opened.config))
    assert made.wait_idle(300)
    yield made
    made.close()


def picture(panel):
    assert panel.wait_idle(120)
    return cv2.imdecode(np.frombuffer(panel.image.value, np.uint8), cv2.IMREAD_COLOR).astype(int)


def widgets_in(widget):
    yield widget
    for child in getattr(widget, "children", ()):
        yield from widgets_in(child)


def test_it_is_made_of_widgets_that_every_front_end_has(panel):
    assert {widget._view_module for widget in widgets_in(panel)} <= set(CORE)


def test_a_slider_fits_again_and_undo_goes_back(panel):
    before = picture(panel)
    panel.controls.by_path["camera.fov_deg"].turn(90.0)
    after = picture(panel)
    assert panel.session.config.camera.fov_deg == 90.0
    assert np.abs(after - before).max() > 40
    panel.history.undo.click()
    np.testing.assert_allclose(picture(panel), before, atol=2)


def test_a_drag_of_a_slider_is_one_step_of_undo(panel):
    before = panel.session.config
    for value in (50.0, 55.0, 60.0, 65.0):
        panel.controls.by_path["camera.fov_deg"].turn(value)
    assert panel.session.config.camera.fov_deg == 65.0
    panel.session.undo()
    assert panel.session.config == before


def test_a_frame_is_chosen_and_one_without_a_face_says_so(panel):
    panel.frame.value = 1
    shown = picture(panel)
    assert "frame 1/2" in panel.status.value
    assert "error" in panel.status.value
    panel.frame.value = 2
    assert np.abs(picture(panel)[:100, :100] - shown[:100, :100]).max() > 0
    assert "no face" in panel.status.value
    panel.frame.value = 0
    picture(panel)


def test_the_head_is_the_sessions_character(panel):
    before = picture(panel)
    panel.session.set("character", head={"character": "mei"})
    half = before.shape[1] // 2
    after = picture(panel)
    assert np.abs(after - before)[:, half:].mean() > 5
    np.testing.assert_allclose(after[:, :half], before[:, :half], atol=40)
    panel.session.undo()
    picture(panel)


def test_a_value_that_cannot_be_is_told_and_changes_nothing(panel):
    config, knob = panel.session.config, panel.controls.by_path["camera.fov_deg"]
    shown = knob.readout.value
    knob.readout.value = "400"
    assert "fov_deg" in panel.status.value
    assert panel.session.config == config
    assert (knob.value, knob.readout.value) == (config.camera.fov_deg, shown)


def test_a_closed_panel_follows_no_longer():
    made = PlainPanel(open_session(sample("astronaut"), landmarks=sample("astronaut-landmarks")))
    assert made.frame.layout.display == "none"
    assert made.wait_idle(300)
    made.close()
    made.close()
    shown = made.image.value
    made.session.set("lens", camera={"fov_deg": 20.0})
    assert made.image.value == shown
