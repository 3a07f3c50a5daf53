"""Infill, refinement, sweeps and tuning in the panel, in a real browser: mark, run, stop, before and after, take."""

import os

import numpy as np
import pytest

from tests import browser
from tests.panel_page import HEAD, MARKS, PANEL, READY, panel_tab, tab, to_top
from tests.test_panel_browser import changed, rested
from workbench.config import read_config

lacking = browser.missing()

if lacking and os.environ.get("CI") != "true":
    pytest.skip(f"browser tests: {lacking}", allow_module_level=True)

CELLS = (
    PANEL.format(name="performance"),
    READY,
    "print(session.temporal.marked, session.config.infill.method, session.temporal.current.name)",
)
PART = "120-136"
"""Frames that are worked on."""


@pytest.fixture(scope="module")
def page(server, chromium):
    """The panel on the sample clip, shown and ready, at its page of infill and refinement."""
    with panel_tab(server, chromium, "clip.ipynb", CELLS) as page:
        page.page.set_default_timeout(60_000)
        yield page


def says(page, text, timeout_s=120):
    """Wait until the panel shows some text."""
    page.page.wait_for_function(
        "(text) => document.querySelector('.fw-panel').innerText.includes(text)", arg=text, timeout=1000 * timeout_s
    )


def press(page, name):
    page.page.locator(".fw-panel").get_by_role("button", name=name, exact=True).last.click()


def type_in(page, placeholder, text):
    field = page.page.locator(f".fw-panel input[placeholder='{placeholder}']")
    field.fill(text)
    field.press("Enter")


def choose(page, label, value):
    row = page.page.locator(".fw-controls .widget-dropdown").filter(has=page.page.get_by_text(label, exact=True))
    row.locator("select").select_option(value)


def test_frames_are_marked_and_shown_on_the_strip(page, screenshots):
    tab(page, "time")
    type_in(page, "40-52, 60", "124-132")
    press(page, "mark")
    says(page, "marked: 124-132 (9 frames)")
    page.page.screenshot(path=screenshots / "time-marked.png")


def test_a_run_is_cancelled(page):
    choose(page, "refine", "plate")
    press(page, "run")
    says(page, "refine 1")
    page.page.locator(".fw-controls").get_by_role("button", name="cancel").click()
    says(page, "Cancelled; finished results are kept.")
    choose(page, "refine", "none")


def test_a_run_fills_the_gap_and_the_toggle_shows_both_sides(page, screenshots):
    choose(page, "infill", "linear")
    type_in(page, "whole clip", PART)
    to_frame(page, 128)
    before = rested(page, MARKS), rested(page, HEAD)
    press(page, "run")
    says(page, "linear 120-136, 9 filled")
    says(page, "filled from its neighbours")
    assert changed(page, MARKS, before[0]) > 0.0
    assert changed(page, HEAD, before[1]) > 0.0
    page.page.screenshot(path=screenshots / "time-after.png")
    after = rested(page, HEAD)
    press(page, "before")
    assert changed(page, HEAD, after) > 0.0
    np.testing.assert_array_equal(rested(page, HEAD), before[1])
    says(page, "frame 128: marked as failed")
    page.page.screenshot(path=screenshots / "time-before.png")


def to_frame(page, frame):
    page.ask_kernel(f"panel.go({frame})")
    says(page, f"frame {frame}/239")


def test_the_part_plays(page):
    press(page, "after")
    to_frame(page, 120)
    play = page.page.locator(".fw-play button").first
    play.click()
    page.page.wait_for_function("() => document.querySelector('.fw-status').innerText.includes('frame 136/')")


def test_all_methods_are_compared(page, screenshots):
    to_frame(page, 128)
    press(page, "compare all")
    tab(page, "Methods")
    page.page.wait_for_function("() => document.querySelectorAll('.fw-methods td').length === 48", timeout=300_000)
    page.page.evaluate("() => document.querySelector('.fw-panel').scrollIntoView({block: 'end'})")
    page.wait_at_rest(".fw-panel")
    page.page.screenshot(path=screenshots / "time-methods.png")
    assert page.page.locator(".fw-methods .fw-key").filter(has_text="spline").count() == 4
    assert "linear + hybrid" in page.page.locator(".fw-methods").inner_text()
    to_top(page)


def pressed(page, name, where):
    page.page.locator(where).get_by_role("button", name=name, exact=True).click()


def test_a_sweep_grows_into_a_curve_whose_points_are_told_and_taken(page, screenshots):
    tab(page, "Sweep")
    setting = page.page.get_by_placeholder("search for a setting to sweep")
    setting.fill("steady head")
    setting.press("Enter")
    pressed(page, "run", ".fw-sweeps")
    says(page, "Lowest error:")

    def drawn():
        return page.page.locator(".fw-sweep").evaluate("(e) => JSON.parse(e.dataset.state)")

    browser.wait_until(lambda: drawn()["known"] == 15, "the whole curve is drawn")
    state = drawn()
    assert (state["kind"], state["count"]) == ("curve", 15)
    stage, (left, top, width, height, _) = page.page.locator(".fw-sweep .fw-stage"), state["box"]
    stage.hover(position={"x": left + 0.9 * width, "y": top + height / 2})
    page.page.get_by_text("half the frames:").wait_for()
    page.page.screenshot(path=screenshots / "sweep-curve.png")
    # From the least mean to its left neighbour, by keys.
    stage.focus()
    stage.press("ArrowLeft")
    stage.press("ArrowLeft")
    stage.press("Enter")
    says(page, "Took steady head")
    browser.wait_until(lambda: page.kernel_value("session.undo_label").startswith("'sweep: steady head"), "it is taken")
    page.ask_kernel("session.undo()")


LEARNING = """
from workbench.learning import Tuned


def learned(objective, learn, progress, cancelled, **options):
    for step in range(3):
        progress("learn", step + 1, 3, 2.0 / (step + 1), 3.0 / (step + 1))
    base = session.config
    told = {"objective": objective, "learned": list(learn), "parts": {"held_out": options["held_out"]}}
    found = base.changed(weights={"tau": 0.2}, provenance=told)
    return Tuned(found, base, {"held_out": np.ones(48)}, {"held_out": np.full(48, 0.9)})


import numpy as np
session.tune = learned
"""
"""Stands for `session.tune`: compiling the gradient takes half a minute, and is tried in `test_tuning.py`."""


def test_what_a_clip_has_chosen_is_shown_and_taken_as_one_step(page, screenshots):
    page.ask_kernel(LEARNING)
    tab(page, "Tune")
    page.page.locator(".fw-tune input").first.fill("jitter + error")
    page.page.locator(".fw-tune input").first.press("Enter")
    says(page, "second difference of the model")
    pressed(page, "few shapes", ".fw-tune")
    pressed(page, "tune", ".fw-tune")
    says(page, "On frames 192-239, held out: −10.0 %")
    said = page.page.locator(".fw-tune").get_by_text("On frames 192-239").bounding_box()
    whole = page.page.locator(".fw-tune").bounding_box()
    assert said["y"] + said["height"] <= whole["y"] + whole["height"]
    page.page.screenshot(path=screenshots / "tune-result.png")
    pressed(page, "take", ".fw-tune")
    says(page, "Taken; undo brings back the previous settings.")
    assert page.kernel_value("(session.undo_label, session.config.weights.tau)") == "('tuned: jitter + error', 0.2)"
    page.ask_kernel("session.undo()")


def test_the_choice_is_exported(page, screenshots):
    press(page, "Save · Export")
    press(page, "save settings")
    says(page, "to reproduce the numbers", 300)
    written = read_config(page.server.folder / "tuned.toml")
    assert written.infill.frames == ((124, 132),)
    assert (written.infill.method, written.refinement.method) == ("linear", "none")
    page.run_cell(2)
    texts = [output["text"] for output in page.outputs()]
    assert any(text.startswith("((124, 132),) linear linear") for text in texts), texts


def test_in_the_dark_theme_all_of_it_can_be_read(page, screenshots):
    page.page.evaluate("() => window.jupyterapp.commands.execute('apputils:change-theme', {theme: 'JupyterLab Dark'})")
    page.page.wait_for_function("() => document.body.dataset.jpThemeLight === 'false'")
    to_top(page)
    page.wait_drawn()
    page.page.screenshot(path=screenshots / "time-dark.png")
    page.page.evaluate("() => document.querySelector('.fw-panel').scrollIntoView({block: 'end'})")
    page.wait_at_rest(".fw-panel")
    page.page.screenshot(path=screenshots / "time-methods-dark.png")
    for title in ("Sweep", "Tune"):
        tab(page, title)
        page.wait_drawn()
        page.page.screenshot(path=screenshots / f"{title.lower()}-dark.png")
    assert page.foreign_requests == []
    assert page.page_errors == []
    assert page.wrong_outputs() == []
