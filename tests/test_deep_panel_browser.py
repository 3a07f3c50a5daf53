"""Deep Energies in the tuning panel, in a real browser: the energy is a choice, the stages are a film strip."""

import os
import re

import pytest

from tests import browser
from tests.panel_page import CUT, MARKS, PANEL, READY, panel_tab, tab
from workbench.config import preset

lacking = browser.missing()

if lacking and os.environ.get("CI") != "true":
    pytest.skip(f"browser tests: {lacking}", allow_module_level=True)

STRIP = ".fw-panel .fw-film-strip"
CELLS = (
    PANEL.format(name="astronaut").replace('-landmarks"))', '-landmarks"), config="deep")'),
    READY,
    "print(session.config.deep.energy, [step.path for step in session.changes()])",
)


@pytest.fixture(scope="module")
def page(server, chromium):
    """The panel on the portrait under Deep Energies, shown and ready."""
    with panel_tab(server, chromium, "deep.ipynb", CELLS) as page:
        yield page


def strip_source(page):
    return page.page.evaluate("(s) => document.querySelector(s).src", STRIP)


def test_the_film_strip_shows_the_stages_and_follows_the_choice_of_energy(page, screenshots):
    tab(page, "Film strip")
    page.page.wait_for_function(
        "(s) => { const i = document.querySelector(s); return i && i.naturalWidth > 600 && i.naturalHeight > 300; }",
        arg=STRIP,
        timeout=120_000,
    )
    page.page.screenshot(path=screenshots / "deep-panel-strip.png")
    tab(page, "deep")
    before = strip_source(page)
    page.page.screenshot(path=screenshots / "deep-panel.png")
    page.page.locator(".fw-controls select:visible:has(option:text-is('points'))").select_option("points")
    page.page.wait_for_function(
        "([s, before]) => document.querySelector(s).src !== before", arg=[STRIP, before], timeout=120_000
    )
    tab(page, "Stages")
    page.wait_at_rest(".fw-panel")
    page.page.screenshot(path=screenshots / "deep-panel-stages.png")
    assert page.page.locator(MARKS).is_visible()


def test_every_stage_can_be_reached(page, screenshots):
    tab(page, "Stages")
    wanted = [stage.name for stage in preset("deep").stages]
    hidden = page.page.locator(".fw-stages").evaluate("(e) => e.scrollHeight - e.clientHeight")
    rows = page.page.locator(".fw-stages > .widget-hbox:visible").filter(has=page.page.locator("input[type=checkbox]"))
    found = [rows.nth(k).locator("input[type=text]").first.input_value() for k in range(rows.count())]
    assert found == wanted
    assert hidden <= 1
    for width in (1366, 1920):
        page.page.set_viewport_size({"width": width, "height": 768})
        page.page.evaluate("() => document.querySelector('.fw-panel').scrollIntoView({block: 'end'})")
        page.wait_at_rest(".fw-panel")
        page.page.screenshot(path=screenshots / f"deep-panel-stages-{width}.png")
        assert page.page.evaluate(CUT) == []
        titles = page.page.locator(".fw-stages b").filter(has_text=re.compile(r"\w"))
        assert titles.all_inner_texts() == [*("stage", "free", "landmarks", "terms", "limit", "when", "last fit")]
        boxes = [title.bounding_box() for title in titles.all()]
        assert max(box["y"] + box["height"] for box in boxes) - min(box["y"] for box in boxes) < 25  # in one line
        texts = [f"input[type=text] >> nth={k}" for k in range(3)]
        for title, part in ((0, texts[0]), (2, texts[1]), (3, texts[2]), (5, "select")):
            assert abs(boxes[title]["x"] - rows.first.locator(part).bounding_box()["x"]) < 8
        table = page.page.locator(".fw-stages").bounding_box()
        assert boxes[-1]["x"] + boxes[-1]["width"] <= table["x"] + table["width"]
    rows.last.locator("button").filter(has_text="✕").hover()


def test_the_kernel_has_the_chosen_energy_and_nothing_went_wrong(page):
    page.run_cell(2)
    texts = [output.get("text", "") for output in page.outputs()]
    assert any(text.startswith("points ['deep.energy") for text in texts), texts
    assert [output for output in page.outputs() if output["type"] == "error" or output["name"] == "stderr"] == []
    assert page.page_errors == []
    assert page.foreign_requests == []
