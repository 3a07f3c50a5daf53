"""The panel's design in a real browser: the face is large, nothing is cut, and common tasks take few actions."""

import json
import os
import re

import numpy as np
import pytest

from tests import browser
from tests.panel_page import CUT, HEAD, MARKS, fold, panel_tab, tab, to_top
from tests.test_panel_browser import changed, rested

lacking = browser.missing()

if lacking and os.environ.get("CI") != "true":
    pytest.skip(f"browser tests: {lacking}", allow_module_level=True)

JUMP = 120
"""The frame whose head jumps aside, so that it is flagged."""
CELLS = (
    f"""
    from dataclasses import replace
    import numpy as np
    import workbench
    from workbench.session import TuningSession, open_session
    from workbench.widgets import TuningPanel

    opened = open_session(workbench.sample("performance"), landmarks=workbench.sample("performance-landmarks"))
    observations = list(opened.material.observations)
    landmarks = observations[{JUMP}].landmarks
    moved = replace(landmarks, points=landmarks.points + np.array([60.0, 0.0]))
    observations[{JUMP}] = replace(observations[{JUMP}], landmarks=moved)
    session = TuningSession(opened.model, replace(opened.material, observations=tuple(observations)))
    panel = TuningPanel(session, backend="webgl")
    panel
    """,
    "ready = panel.wait_idle(300)",
)
SMALL, LARGE = {"width": 1366, "height": 768}, {"width": 1920, "height": 1080}
ABOVE = 1.33
"""From the chin to the hairline, in heights from the chin to the brows."""
OUTSIDE = """() => {
  const panel = document.querySelector('.fw-panel').getBoundingClientRect();
  const rows = '.fw-top-bar, .fw-photo, .fw-head, .fw-transport, .fw-controls, .fw-pages > .lm-TabBar';
  return [...document.querySelectorAll('.fw-panel :is(button, input, select, canvas, .noUi-target, .lm-TabBar-tab)')]
    .filter((e) => e.offsetWidth && e.closest(rows)).filter((e) => {
      const own = e.getBoundingClientRect(), row = e.closest(rows).getBoundingClientRect();
      const scrolls = e.closest('.fw-controls .jupyter-widget-TabPanel-tabContents, .fw-controls .widget-tab-contents');
      return own.left < panel.left - 1 || own.right > panel.right + 1 || own.right > row.right + 1
        || (!scrolls && own.bottom > row.bottom + 1);
    }).map((e) => `${e.tagName} ${e.textContent || e.className}`.slice(0, 60));
}"""
UNNAMED = """() => [...document.querySelectorAll('.fw-panel :is(button, input, select)')]
  .filter((e) => e.offsetWidth && !e.labels?.length && !e.ariaLabel && !/[\\p{L}]{2}/u.test(e.textContent))
  .map((e) => e.outerHTML.slice(0, 200))"""


@pytest.fixture(scope="module")
def page(server, chromium):
    """The panel on the sample clip with a flagged frame, shown and ready at 1366 × 768."""
    with panel_tab(server, chromium, "design.ipynb", CELLS) as page:
        page.page.set_default_timeout(60_000)
        yield page


@pytest.fixture
def small(page):
    """The page at 1366 × 768, at frame 0 and the start, with the focus in the panel."""
    page.page.set_viewport_size(SMALL)
    page.ask_kernel(
        "session.use(session.base)\npanel.go(0)\npanel.transport.mark('whole')\nready = panel.wait_idle(60)"
    )
    to_top(page)
    page.page.locator(".fw-status").click()
    return page


NARROW_PX = 720
"""Width of a panel in a window of 900 pixels, or in one of 1100 with JupyterLab's list of files open."""


@pytest.fixture
def narrow(small):
    """The page in a window in which the panel is narrow."""
    outside = SMALL["width"] - small.page.locator(".fw-panel").bounding_box()["width"]
    small.page.set_viewport_size({"width": round(NARROW_PX + outside), "height": 1000})
    small.page.wait_for_function(f"() => Math.abs(document.querySelector('.fw-panel').offsetWidth - {NARROW_PX}) < 3")
    small.wait_at_rest(".fw-views")
    return small


def state(page):
    return json.loads(page.page.locator(".fw-overlay").get_attribute("data-state"))


def face_height(page):
    """From the chin to the hairline on the screen, pixels."""
    points = np.array(json.loads(page.kernel_value("panel.fit.observed.tolist()")))
    return ABOVE * float(np.ptp(points[:, 1])) * state(page)["scale"]


def becomes(page, expression, wanted):
    browser.wait_until(
        lambda: page.kernel_value(expression) == wanted, f"{expression} is {wanted}",
        pause=lambda: page.page.wait_for_timeout(60),
    )  # fmt: skip


class Actions:
    """What a user does, counted."""

    def __init__(self, page):
        self._page, self.count = page.page, 0

    def key(self, key):
        self.count += 1
        self._page.keyboard.press(key)

    def click(self, locator, **options):
        self.count += 1
        assert_in_window(self._page, locator)
        locator.click(**options)

    def type(self, text):
        self.count += 1
        self._page.keyboard.type(text)

    def choose(self, locator, option):
        self.count += 1
        assert_in_window(self._page, locator)
        locator.select_option(option)


def assert_in_window(page, locator):
    """No scrolling is needed to reach it."""
    box, size = locator.bounding_box(), page.viewport_size
    assert box is not None
    assert box["y"] >= 0
    assert box["y"] + box["height"] <= size["height"]
    assert box["x"] + box["width"] <= size["width"]


@pytest.fixture(scope="module")
def counts():
    """The actions of each task, by the name of its test."""
    return {}


@pytest.fixture
def actions(small, counts, request):
    made = Actions(small)
    yield made
    counts[request.node.name] = made.count


def button(page, name):
    return page.page.locator(".fw-panel").get_by_role("button", name=name, exact=True).first


def place_of(page, point):
    box, seen = page.page.locator(MARKS).bounding_box(), state(page)
    x, y = json.loads(page.kernel_value(f"panel.fit.observed[{point}].tolist()"))
    return box["x"] + seen["scale"] * x + seen["x"], box["y"] + seen["scale"] * y + seen["y"]


# --- the page ---


@pytest.mark.parametrize("size", [SMALL, LARGE], ids=["1366", "1920"])
def test_the_face_has_a_third_of_the_height_and_the_panel_fits_into_the_window(page, screenshots, size):
    page.page.set_viewport_size(size)
    to_top(page)
    browser.wait_until(
        lambda: face_height(page) >= size["height"] / 3, "the face has a third of the height",
        pause=lambda: page.page.wait_for_timeout(60),
    )  # fmt: skip
    for theme in ("Light", "Dark"):
        page.page.evaluate(
            f"() => window.jupyterapp.commands.execute('apputils:change-theme', {{theme: 'JupyterLab {theme}'}})"
        )
        page.page.wait_for_function(
            f"() => document.body.dataset.jpThemeLight === '{'true' if theme == 'Light' else 'false'}'"
        )
        to_top(page)
        page.wait_drawn()
        page.page.screenshot(path=screenshots / f"design-{size['width']}-{theme}.png")
        # Not the head from so near that it fills its place with skin.
        assert page.page.evaluate("(s) => new Set(window.readCanvas(s, 100)).size > 60", HEAD)
    box = page.page.locator(".fw-panel").bounding_box()
    assert box["y"] + box["height"] <= size["height"]
    page.page.evaluate("() => window.jupyterapp.commands.execute('apputils:change-theme', {theme: 'JupyterLab Light'})")


@pytest.mark.parametrize("percent", [125, 200])
def test_where_the_browser_zooms_nothing_is_outside_of_the_panel_or_its_row(small, screenshots, percent):
    small.page.set_viewport_size({side: round(100 * length / percent) for side, length in SMALL.items()})
    to_top(small)
    small.wait_at_rest(".fw-views")
    small.page.screenshot(path=screenshots / f"design-zoom-{percent}.png")
    assert small.page.evaluate(OUTSIDE) == []
    for place in (".fw-photo", ".fw-head"):
        box = small.page.locator(place).bounding_box()
        assert min(box["width"], box["height"]) > 130, (place, box)


def test_sliders_are_long_and_no_text_is_cut(small):
    for title in ("ω", "ρ ε", "camera", "points", "a b c", "deep", "time"):
        tab(small, title)
        widths = small.page.locator(".fw-controls .noUi-target:visible").evaluate_all(
            "(all) => all.map((e) => e.offsetWidth)"
        )
        assert all(width >= 150 for width in widths), (title, widths)
        assert small.page.evaluate(CUT) == [], title
    tab(small, "ω")


@pytest.mark.parametrize("size", ["small", "narrow"])
def test_no_text_of_the_pages_is_cut(small, request, size):
    request.getfixturevalue(size)
    for title in ("Stages", "Diagnosis", "Curves", "Methods", "Sweep", "Tune", "Compare", "Film strip", "Changes"):
        tab(small, title)
        small.wait_at_rest(".fw-pages")
        if title == "Sweep":
            setting = small.page.get_by_placeholder("search for a setting to sweep")
            setting.fill("steady head")
            setting.press("Enter")
            small.page.wait_for_function("(e) => e.value.includes('ω_τ')", arg=setting.element_handle())
        assert small.page.evaluate(CUT) == [], title
    fold(small)


def test_on_a_narrow_page_titles_of_stages_stand_above_their_columns_and_every_button_is_reached(narrow, screenshots):
    tab(narrow, "Stages")
    narrow.wait_at_rest(".fw-stages")
    begin, beginnings = narrow.page.evaluate(
        """() => [...document.querySelectorAll('.fw-stages > .widget-hbox')].slice(1, 3).map(
          (row) => [...row.children].filter((e) => e.offsetWidth).map((e) => e.getBoundingClientRect().left))"""
    )
    assert begin == pytest.approx(beginnings, abs=1.0)
    for last in ("button[title='remove this stage']", ".widget-label"):
        narrow.page.locator(f".fw-stages {last}:visible").last.scroll_into_view_if_needed()
        end = narrow.page.locator(f".fw-stages {last}:visible").last.bounding_box()
        table = narrow.page.locator(".fw-stages").bounding_box()
        assert end["x"] + end["width"] <= table["x"] + table["width"] + 1.0
    narrow.page.screenshot(path=screenshots / "design-narrow-stages.png")
    fold(narrow)


@pytest.mark.parametrize(("title", "view"), [("Sweep", ".fw-sweeps canvas"), ("Tune", ".fw-tune canvas")])
def test_on_a_narrow_page_the_curve_of_a_page_is_wide(narrow, screenshots, title, view):
    tab(narrow, title)
    narrow.wait_at_rest(".fw-pages")
    narrow.page.screenshot(path=screenshots / f"design-narrow-{title}.png")
    curve, pages = (narrow.page.locator(place).first.bounding_box() for place in (view, ".fw-pages"))
    assert curve["width"] >= 240
    assert curve["height"] >= 100
    assert curve["x"] + curve["width"] <= pages["x"] + pages["width"]
    assert curve["y"] + curve["height"] <= pages["y"] + pages["height"]
    fold(narrow)


def test_on_a_narrow_page_scale_and_metrics_of_compared_heads_are_whole(narrow, screenshots):
    narrow.ask_kernel("panel.turn('weights.sigma_smooth', 0.5)\nready = panel.wait_idle(60)")
    tab(narrow, "Compare")
    becomes(narrow, "'<table>' in panel.compare.table.value and 'distance' in panel.compare.scale.value", "True")
    narrow.wait_at_rest(".fw-pages")
    narrow.page.screenshot(path=screenshots / "design-narrow-Compare.png")
    pages = narrow.page.locator(".fw-pages").bounding_box()
    for place in (".fw-compare th:last-child", ".fw-compare span[style*=gradient]"):
        box = narrow.page.locator(place).bounding_box()
        assert box["width"] > 20
        assert box["x"] + box["width"] <= pages["x"] + pages["width"]
    fold(narrow)


def test_below_a_high_page_the_window_scrolls_and_strip_and_transport_are_whole(small, screenshots):
    small.ask_kernel("for _ in range(6): panel.stages.add.click()")
    tab(small, "Stages")
    small.wait_at_rest(".fw-pages")
    to_top(small)
    small.page.screenshot(path=screenshots / "design-high-page.png")
    small.ask_kernel("panel._clip_bar.said.value = 'fitting the clip, frame 120 of 240, about 12 s left; ' * 3")
    small.wait_drawn()
    transport, pages = (small.page.locator(place).bounding_box() for place in (".fw-transport", ".fw-pages"))
    assert pages["height"] > 250
    assert transport["height"] < 40
    assert transport["y"] + transport["height"] <= pages["y"] + 1
    small.ask_kernel("panel._clip_bar.said.value = ''")
    fold(small)


def test_every_control_has_a_name_for_screen_readers(small):
    for title in ("ρ ε", "camera", "points", "a b c", "deep", "time", "ω", "Stages", "Diagnosis", "Methods"):
        tab(small, title)
        browser.wait_until(
            lambda: small.page.evaluate(UNNAMED) == [], f"every control of {title} has a name",
            timeout_s=20, pause=lambda: small.page.wait_for_timeout(60),
        )  # fmt: skip
    fold(small)


def test_the_head_lies_where_the_face_is_and_follows_its_zoom(small):
    """Both are seen by the same camera: the middle of the head's skin moves and grows with the photo's crop."""
    before = rested(small, HEAD)
    small.page.locator(MARKS).hover()
    small.page.mouse.wheel(0, -300)
    assert changed(small, HEAD, before) > 0.05
    small.page.locator(MARKS).dblclick(position={"x": 5, "y": 5})
    small.page.locator(MARKS).dblclick(position={"x": 5, "y": 5})


def test_a_border_moves_and_goes_back(small):
    border = small.page.locator(".fw-views > .fw-split")
    width = lambda: small.page.locator(".fw-photo").bounding_box()["width"]  # noqa: E731 - asked three times
    before, box = width(), border.bounding_box()
    small.page.mouse.move(box["x"] + 3, box["y"] + 40)
    small.page.mouse.down()
    small.page.mouse.move(box["x"] - 57, box["y"] + 40, steps=4)
    small.page.mouse.up()
    assert width() == pytest.approx(before - 60, abs=3)
    border.focus()
    small.page.keyboard.press("ArrowRight")
    assert width() == pytest.approx(before - 36, abs=3)
    border.dblclick()
    assert width() == pytest.approx(before, abs=3)


def test_pages_fold_away_and_come_back(small):
    pages = small.page.locator(".fw-pages")
    assert "fw-folded" in pages.get_attribute("class")  # at first in a low window
    height = small.page.locator(".fw-photo").bounding_box()["height"]
    tab(small, "Stages")
    small.page.locator(".fw-stages").wait_for()
    assert small.page.locator(".fw-photo").bounding_box()["height"] < height
    fold(small)
    browser.wait_until(
        lambda: small.page.locator(".fw-photo").bounding_box()["height"] == height, "the views have their height again",
        pause=lambda: small.page.wait_for_timeout(40),
    )  # fmt: skip


def test_a_double_click_on_a_slider_goes_back_to_the_start(small):
    tab(small, "ω")
    handle = small.slider("ω_τ")
    handle.press("PageUp")
    knob = small.page.locator(".fw-knob").filter(has_text="ω_τ").first
    small.page.wait_for_function("(e) => e.classList.contains('fw-changed')", arg=knob.element_handle())
    small.page.locator(".fw-knob").filter(has_text="ω_τ").first.locator(".noUi-target").dblclick(
        position={"x": 4, "y": 2}
    )
    small.page.wait_for_function("(e) => !e.classList.contains('fw-changed')", arg=knob.element_handle())
    becomes(small, "session.config.weights.tau == session.base.weights.tau", "True")


def test_the_end_of_the_colours_is_dragged_in_the_picture_and_followed_by_the_strip(small):
    small.page.mouse.move(*place_of(small, 30))
    handle = small.page.locator(".fw-overlay .fw-limit")
    box = handle.bounding_box()
    small.page.mouse.move(box["x"] + 5, box["y"] + 5)
    small.page.mouse.down()
    small.page.mouse.move(box["x"] + 65, box["y"] + 5, steps=5)
    small.page.mouse.up()
    becomes(small, "panel.clip.timeline.scale == panel.overlay.view.scale > 8", "True")
    handle.dblclick()
    becomes(small, "panel.overlay.view.scale_max", "0.0")


def test_the_marks_fade_at_rest_and_vanish_with_a_key(small):
    small.page.mouse.move(20, 20)
    small.page.wait_for_function("() => document.querySelector('.fw-overlay').classList.contains('fw-rest')")
    small.page.mouse.move(*place_of(small, 30))
    small.page.wait_for_function("() => !document.querySelector('.fw-overlay').classList.contains('fw-rest')")
    small.page.locator(".fw-status").click()
    small.page.keyboard.press("h")
    small.wait_drawn()
    assert small.pixels(MARKS).std(axis=(0, 1)).max() < 1.0
    small.page.keyboard.press("h")
    small.wait_drawn()
    assert small.pixels(MARKS).std(axis=(0, 1)).max() > 1.0


def test_the_question_mark_lists_the_keys(small, screenshots):
    small.page.keyboard.press("?")
    shown = small.page.locator(".fw-help-box")
    shown.wait_for()
    assert "next, previous flagged frame" in shown.inner_text()
    small.page.screenshot(path=screenshots / "design-keys.png")
    small.page.keyboard.press("Escape")
    shown.wait_for(state="hidden")


def controls(page):
    """A button, a slider and a menu of the panel."""
    return button(page, "changed"), page.slider("ω_τ"), page.page.locator(".fw-go-to select")


@pytest.mark.parametrize("which", range(3), ids=["button", "slider", "menu"])
def test_keys_on_a_control_of_the_panel_are_no_commands_of_the_notebook(small, which):
    """M would make the cell Markdown, and B insert another one."""
    tab(small, "ω")
    controls(small)[which].focus()
    for key in ("m", "b"):
        small.page.keyboard.press(key)
    small.wait_drawn()
    cells = "() => window.jupyterapp.shell.currentWidget.content.widgets.map((cell) => cell.model.type)"
    assert small.page.evaluate(cells) == ["code", "code"]


@pytest.mark.parametrize("which", range(3), ids=["button", "slider", "menu"])
def test_keys_of_the_selected_landmarks_work_on_every_control_of_the_panel(small, which):
    tab(small, "ω")
    small.page.mouse.click(*place_of(small, 8))
    becomes(small, "panel.overlay.view.selection", "[8]")
    controls(small)[which].focus()
    small.page.keyboard.press("m")
    becomes(small, "panel.overlay.view.muted", "(8,)")
    small.page.keyboard.press("m")
    small.page.keyboard.press("+")
    becomes(small, "session.config.landmarks.weights", "{'8': 2.0}")
    small.page.keyboard.press("-")
    small.page.keyboard.press("Escape")
    becomes(small, "(panel.overlay.view.selection, session.config.landmarks.weights)", "([], {})")


def test_keys_of_the_selected_landmarks_are_letters_in_a_field(small):
    small.page.mouse.click(*place_of(small, 8))
    becomes(small, "panel.overlay.view.selection", "[8]")
    small.page.keyboard.press("/")
    small.page.keyboard.type("m-")
    becomes(small, "(panel.controls.search.value, panel.overlay.view.muted)", "('m-', ())")
    small.page.get_by_placeholder("search all settings").fill("")
    small.page.locator(".fw-status").click()
    small.page.keyboard.press("Escape")


# --- tasks: at most three actions each on average, without scrolling ---


TASKS = 10
MOST = 3.0


def go_to(page, actions, share):
    """Click at a share of the strip's width and wait for the frame: its number."""
    strip = page.page.locator(".fw-timeline canvas").last
    box, before = strip.bounding_box(), page.kernel_value("panel.frame")
    actions.click(strip, position={"x": share * box["width"], "y": 0.5 * box["height"]})
    browser.wait_until(
        lambda: page.kernel_value("panel.frame") != before, "a click in the strip shows another frame",
        pause=lambda: page.page.wait_for_timeout(60),
    )  # fmt: skip
    return int(page.kernel_value("panel.frame"))


def test_find_the_worst_frame(small, actions):
    actions.key("n")  # the frame before it has a jump ahead, and is flagged too
    becomes(small, "panel.frame", str(JUMP - 1))
    actions.key("n")
    becomes(small, "panel.frame", str(JUMP))


def test_find_out_why(small, actions, screenshots):
    actions.key("n")
    actions.key("w")
    small.page.wait_for_function(
        "() => document.querySelector('.fw-diagnosis').innerText.includes('flagged, ')", timeout=120_000
    )
    small.page.locator(".fw-diagnosis .fw-reason, .fw-diagnosis table").first.wait_for(timeout=60_000)
    small.page.screenshot(path=screenshots / "design-why.png")
    fold(small)


def test_mute_two_points(small, actions):
    actions.count += 3
    small.page.mouse.click(*place_of(small, 8))
    small.page.keyboard.down("Control")
    small.page.mouse.click(*place_of(small, 9))
    small.page.keyboard.up("Control")
    small.page.keyboard.press("m")
    becomes(small, "panel.overlay.view.muted", "(8, 9)")
    small.page.keyboard.press("Escape")


def test_free_the_weights_in_a_stage(small, actions):
    actions.click(small.page.locator(".fw-pages .lm-TabBar-tab").filter(has_text="Stages"))
    row = small.page.locator(".fw-stages > .widget-hbox:has(input[type=text])").first
    actions.click(row.locator("button").filter(has_text=re.compile("^w$")))
    becomes(small, "'expression' in session.config.stages[0].free", "True")
    fold(small)


def test_compare_two_weights(small, actions):
    tab(small, "ω")
    actions.count += 1
    small.slider("ω_σ L1").press("PageDown")
    actions.choose(small.page.locator(".fw-head select").filter(has_text="compare…"), "the start")
    becomes(small, "bool(panel.head.view.canvas._ghost)", "True")
    small.ask_kernel("panel.head.compare.value = ''")


def test_fill_a_gap(small, actions):
    frame = go_to(small, actions, 0.4)
    actions.key("f")
    becomes(small, "panel.fit.source", "'filled'")
    becomes(small, "session.config.infill.frames", f"(({frame}, {frame}),)")
    small.ask_kernel("panel.time.sides.value = 'before'")
    tab(small, "ω")


def test_export_an_animation(small, actions, screenshots):
    actions.key("e")
    actions.click(button(small, "export"))
    small.page.get_by_text("Wrote ").wait_for(timeout=120_000)
    assert (small.server.folder / "performance.glb").stat().st_size > 100_000
    small.page.screenshot(path=screenshots / "design-export.png")
    assert "workbench export out/performance --to performance.glb" in small.page.locator(".fw-command").inner_text()
    small.page.keyboard.press("e")


def test_the_chosen_format_of_an_export_is_not_cut(small):
    small.page.keyboard.press("e")
    menu = small.page.locator(".fw-export select").first
    cut = []
    for number in range(menu.locator("option").count()):
        menu.select_option(index=number)
        cut += small.page.evaluate(CUT)
    small.page.locator(".fw-status").click()
    small.page.keyboard.press("e")
    assert cut == []


def test_find_a_setting_and_raise_it(small, actions):
    actions.key("/")
    actions.type("steady head")
    # What is found stands in place of the pages, which have a view of the same slider.
    small.page.locator(".fw-controls > .widget-tab").wait_for(state="hidden")
    small.wait_at_rest(".fw-controls .widget-slider")  # the last letters find anew
    actions.count += 1
    small.slider("ω_τ").press("PageUp")
    becomes(small, "session.config.weights.tau > session.base.weights.tau", "True")
    small.page.locator(".fw-controls input").first.fill("")


def test_undo(small, actions):
    small.ask_kernel("panel.turn('weights.tau', 3.0)")
    actions.key("Control+z")
    becomes(small, "session.config.weights.tau == session.base.weights.tau", "True")


def test_play_a_part(small, actions):
    strip = small.page.locator(".fw-timeline canvas").last
    box = strip.bounding_box()
    actions.count += 1
    small.page.keyboard.down("Shift")
    small.page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    small.page.mouse.down()
    small.page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 0.5 * box["height"], steps=4)
    small.page.mouse.up()
    small.page.keyboard.up("Shift")
    browser.wait_until(
        lambda: small.kernel_value("(panel.time.play.max - panel.time.play.min) > 10 and panel.time.play.max < 200")
        == "True", "a drag with Shift in the strip is the part to play", pause=lambda: small.page.wait_for_timeout(60),
    )  # fmt: skip
    first, last = json.loads(small.kernel_value("[panel.time.play.min, panel.time.play.max]"))
    actions.key(" ")
    browser.wait_until(lambda: first < int(small.kernel_value("panel.frame")) < last, "it plays the part")
    small.ask_kernel("panel.time.play.playing = False")


def test_the_tasks_take_three_actions_each_on_average(counts):
    if len(counts) < TASKS:
        pytest.skip("only some of the tasks have run")
    assert len(counts) == TASKS
    assert sum(counts.values()) / TASKS <= MOST, counts


def test_no_note_tells_that_programs_are_missing(small):
    assert not small.page.locator(".fw-unloaded").first.is_visible()


def test_compared_heads_are_turned_together(small, screenshots):
    small.ask_kernel("panel.turn('weights.sigma_smooth', 0.5)\npanel.go(60)\nready = panel.wait_idle(60)")
    tab(small, "Compare")
    becomes(small, "len(panel.compare.views) == 3 and bool(panel.compare.views[1].canvas._colors)", "True")
    small.ask_kernel("before = list(panel.compare.views[0].canvas._viewpoint)")
    place = small.page.locator(".fw-compare canvas").nth(1).bounding_box()
    x, y = place["x"] + 0.5 * place["width"], place["y"] + 0.5 * place["height"]
    small.page.mouse.move(x, y)
    small.page.mouse.down()
    small.page.mouse.move(x + 40, y, steps=4)
    small.page.mouse.up()
    becomes(small, "panel.compare.views[1].canvas._viewpoint != before", "True")
    becomes(small, "len({tuple(view.canvas._viewpoint) for view in panel.compare.views})", "1")
    small.page.screenshot(path=screenshots / "design-compare.png")
    fold(small)


def test_what_was_saved_is_downloaded(small):
    small.page.keyboard.press("e")
    small.ask_kernel("panel.file.value = 'mine.toml'")
    button(small, "save settings").click()
    small.page.get_by_text("to reproduce the numbers").wait_for(timeout=120_000)
    with small.page.expect_download() as download:
        button(small, "download").click()
    assert download.value.suggested_filename == "mine.toml"
    assert download.value.path().read_bytes() == (small.server.folder / "mine.toml").read_bytes()
    small.page.keyboard.press("e")


def test_nothing_failed_and_nothing_came_from_another_host(page):
    assert page.foreign_requests == []
    assert page.page_errors == []
    assert [text for text in page.console_errors if "404" not in text] == []
    assert page.wrong_outputs() == []
