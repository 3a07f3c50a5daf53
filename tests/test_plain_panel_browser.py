"""A front end that loads no program of ours: the plain panel works there, and the other one says what is missing."""

import os

import numpy as np
import pytest

from tests import browser
from tests.panel_page import write_notebook

lacking = browser.missing()

if lacking and os.environ.get("CI") != "true":
    pytest.skip(f"browser tests: {lacking}", allow_module_level=True)

CELLS = (
    """
    import workbench
    from workbench.session import open_session
    from workbench.widgets import PlainPanel, TuningPanel

    session = open_session(workbench.sample("astronaut"), landmarks=workbench.sample("astronaut-landmarks"))
    plain = PlainPanel(session)
    plain
    """,
    "ready = plain.wait_idle(300)",
    """
    panel = TuningPanel(session, backend="pictures")
    panel
    """,
)
IMAGE = ".jp-OutputArea img.widget-image"


@pytest.fixture(scope="module")
def bare(server, chromium):
    """A notebook in a JupyterLab whose page gets nothing of anywidget."""
    write_notebook(server.folder / "bare.ipynb", CELLS)
    with browser.lab_tab(server, chromium, "bare.ipynb") as page:
        page.page.route("**/extensions/anywidget/**", lambda route: route.abort())
        page.open("bare.ipynb")
        page.run_cell(0)
        page.run_cell(1)
        yield page
        page.page.unroute_all(behavior="ignoreErrors")


def test_a_slider_of_the_plain_panel_changes_its_picture(bare, screenshots):
    before = bare.picture(IMAGE).astype(float)
    assert before.std() > 20
    source = bare.page.locator(IMAGE).first.get_attribute("src")
    bare.slider("ω_σ L1").press("Home")
    bare.page.wait_for_function("([s, old]) => document.querySelector(s).src !== old", arg=[IMAGE, source])
    bare.page.screenshot(path=screenshots / "plain-panel.png")
    assert np.abs(bare.picture(IMAGE) - before).max() > 40


def test_a_panel_whose_programs_do_not_come_says_so_and_what_to_do(bare, screenshots):
    bare.run_cell(2)
    note = bare.page.locator(".fw-unloaded").last
    note.wait_for(state="attached")
    bare.page.evaluate("() => document.getAnimations().find((each) => each.animationName === 'fw-late').finish()")
    browser.wait_until(lambda: note.bounding_box()["height"] > 20, "the note is seen")
    assert "PlainPanel(session)" in note.inner_text()
    note.scroll_into_view_if_needed()
    bare.page.screenshot(path=screenshots / "plain-note.png")
    bare.ask_kernel("panel.close()")
