"""The quickstart in a real browser: JupyterLab with a token, in Chromium, without the network."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests import browser

ROOT = Path(__file__).resolve().parent.parent
IMAGE = ".jp-OutputArea img.widget-image"
lacking = browser.missing()

if lacking and os.environ.get("CI") != "true":
    pytest.skip(f"browser tests: {lacking}", allow_module_level=True)


@pytest.fixture(scope="module")
def lab(server, chromium):
    """The quickstart, run from top to bottom."""
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        shutil.copyfile(path, server.folder / path.name)
    with browser.lab_tab(server, chromium) as page:
        page.open("00_quickstart.ipynb")
        page.run_all()
        yield page


def test_every_cell_ran_and_none_failed(lab, screenshots):
    lab.screenshots(screenshots, "00_quickstart")
    assert None not in lab.execution_counts()
    wrong = [output for output in lab.outputs() if output["type"] == "error" or output["name"] == "stderr"]
    assert wrong == []


def test_it_shows_pictures_and_the_playground(lab):
    kinds = [mime for output in lab.outputs() for mime in output["mime"]]
    assert kinds.count("image/png") >= 4
    assert "application/vnd.jupyter.widget-view+json" in kinds
    assert lab.page.locator(".widget-slider").count() == 5


def test_the_picture_of_the_playground_is_a_picture(lab):
    """Rendered from a wrong thread it would be constant, or striped: rows or columns that hardly vary."""
    picture = lab.picture(IMAGE).astype(float)
    for half in np.split(picture, 2, axis=1):
        assert half.std() > 20
        assert half.mean(axis=(0, 2)).std() > 5
        assert half.mean(axis=(1, 2)).std() > 5
        assert np.abs(np.diff(half, axis=0)).mean() < 12
        assert np.abs(np.diff(half, axis=1)).mean() < 12


def rested(lab):
    """The picture once it shows the same three times: a moved slider brings several."""
    shown = []

    def same():
        shown.append(lab.picture(IMAGE))
        lab.page.wait_for_timeout(200)
        return len(shown) > 2 and all(np.array_equal(shown[-1], other) for other in shown[-3:-1])

    browser.wait_until(same, "the picture rests")
    return shown[-1]


@pytest.mark.parametrize(("label", "keys"), [("expression steps ε", ["Home"]), ("field of view, °", ["End"])])
def test_a_moved_slider_changes_the_picture(lab, screenshots, label, keys):
    before = lab.picture(IMAGE).astype(float)
    source = lab.page.locator(IMAGE).first.get_attribute("src")
    handle = lab.slider(label)
    for key in keys:
        handle.press(key)
    lab.page.wait_for_function("([s, old]) => document.querySelector(s).src !== old", arg=[IMAGE, source])
    after = rested(lab).astype(float)
    lab.page.screenshot(path=screenshots / f"moved-{label.split()[0]}.png")
    changed = np.mean(np.abs(after - before).max(axis=2) > 8)
    assert 0.02 < changed < 0.60
    assert after[:, after.shape[1] // 2 :].std() > 20


def test_a_preset_of_the_menu_is_fitted(lab):
    status = lab.page.locator(".jp-OutputArea .widget-html code").last
    before = status.inner_text()
    lab.page.locator(".widget-dropdown select").first.select_option("calibrated")
    lab.page.wait_for_function(
        "([s, old]) => [...document.querySelectorAll(s)].pop().innerText !== old",
        arg=[".jp-OutputArea .widget-html code", before],
    )
    assert "px" in status.inner_text()


def test_nothing_came_from_another_host_and_the_page_had_no_errors(lab):
    assert lab.foreign_requests == []
    assert lab.page_errors == []


def test_a_test_that_fails_can_say_what_page_and_kernel_are_doing(lab):
    said = lab.state()
    assert "page: visible" in said
    assert "draws: a frame" in said
    assert "kernel: idle, connected" in said
    assert "answers: answered" in said
    assert 'File "' in said.partition("threads of the kernel")[2]
