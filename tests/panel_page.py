"""A tuning panel in a notebook in a real browser: what the tests and the benchmark of its latency share."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from textwrap import dedent

import nbformat

from tests import browser

MARKS, HEAD = ".fw-overlay .fw-marks", ".fw-head3d > canvas"
PANEL = """
    import time
    import workbench
    from workbench.session import open_session
    from workbench.widgets import TuningPanel

    session = open_session(workbench.sample("{name}"), landmarks=workbench.sample("{name}-landmarks"))
    panel = TuningPanel(session, backend="webgl")
    panel
    """
CUT = """() => {
  const context = document.createElement("canvas").getContext("2d");
  const wide = (select) => {
    const style = getComputedStyle(select);
    context.font = style.font;
    const words = context.measureText(select.selectedOptions[0]?.text ?? "").width;
    return words > select.clientWidth - parseFloat(style.paddingLeft) - parseFloat(style.paddingRight) + 1;
  };
  const cut = (e) => e.tagName === "SELECT" ? wide(e) : e.scrollWidth > e.clientWidth + 1;
  const texts = "button, select, input[type=text], .lm-TabBar-tabLabel, .fw-below span, .widget-html-content";
  return [...document.querySelectorAll(`.fw-panel :is(${texts})`)]
    .filter((e) => e.offsetWidth && getComputedStyle(e).overflow !== "visible" && cut(e) && !e.closest(".fw-status"))
    .map((e) => e.selectedOptions?.[0]?.text ?? (e.value || e.textContent));
}"""
"""Texts of a panel that are cut; the status line is told whole where the mouse rests on it."""
READY = "ready = panel.wait_idle(300)\nassert ready"
PARTS = """() => [...document.querySelectorAll(".fw-panel, .fw-panel :is(.fw-first, .fw-overlay, .fw-head3d, canvas)")]
  .map((e) => `${e.className} ${e.offsetWidth}x${e.offsetHeight} of ${e.children.length}`)"""


def write_notebook(path: Path, cells: Sequence[str]) -> None:
    """A notebook of these code cells, each without the indentation that all its lines share."""
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    made = [nbformat.v4.new_code_cell(dedent(cell).strip()) for cell in cells]
    nbformat.write(nbformat.v4.new_notebook(cells=made, metadata=kernel), path)


@contextmanager
def notebook_page(name: str, cells: Sequence[str], prompt: bool = True) -> Iterator[browser.LabPage]:
    """A page at 1366×768 of a JupyterLab of its own, beside a notebook of these cells that is not open yet.

    `prompt` is as for `browser.lab_server`.
    """
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "notebooks").mkdir()
        write_notebook(folder / "notebooks" / name, cells)
        with (
            browser.lab_server(folder / "notebooks", folder / "settings", prompt) as server,
            browser.lab_page(server, folder / "profile") as page,
        ):
            page.page.set_viewport_size({"width": 1366, "height": 768})
            yield page


@contextmanager
def panel_tab(server, chromium, notebook, cells):
    """A page of 1366 × 768 pixels with a panel, shown and ready. Its notebook has the kernel of all such pages."""
    write_notebook(server.folder / notebook, cells)
    with browser.lab_tab(server, chromium, notebook) as page:
        page.page.set_viewport_size({"width": 1366, "height": 768})
        page.page.add_init_script(browser.KEEP_PIXELS)
        page.open(notebook)
        page.ask_kernel(f"import os; os.chdir({str(server.folder)!r})")
        yield shown(page, 0)


def opened(page, notebook):
    """Open a notebook and run its first two cells: the panel, shown and ready."""
    page.open(notebook)
    return shown(page, 0)


def shown(page, cell):
    """Run the two cells that make a panel and wait for it.

    Raises `AssertionError` that says what the cells and the page had to say, if it does not come into view.
    """
    from playwright.sync_api import TimeoutError  # here: machines without a browser import this file, too

    for each in (cell, cell + 1):
        page.run_cell(each)
        assert page.wrong_outputs() == [], page.state()
    try:
        for selector in (MARKS, HEAD):
            page.page.wait_for_selector(selector)
        page.page.wait_for_function("(s) => new Set(window.readCanvas(s, 100)).size > 60", arg=HEAD)
    except TimeoutError as error:
        parts = page.page.evaluate(PARTS)
        raise AssertionError(f"{error}\nparts: {parts}\noutputs: {page.outputs()}\n{page.state()}") from error
    to_top(page)
    return page


def to_top(page):
    """Scroll to the panel."""
    page.page.evaluate("() => document.querySelector('.fw-panel').scrollIntoView({block: 'start'})")
    page.wait_at_rest(".fw-panel")


def tab(page, title):
    """Bring a page of a tab to the front, unfolded."""
    found = page.page.locator(".fw-panel .lm-TabBar-tab").filter(has_text=title).first
    if not found.evaluate("(e) => e.matches('.lm-mod-current') && !e.closest('.fw-folded')"):
        found.click()


def fold(page):
    """Fold the pages below the strip away."""
    page.page.locator(".fw-pages .lm-TabBar-tab.lm-mod-current").click()


def press(page, label, *keys):
    """Press keys on a slider."""
    handle = page.slider(label)
    for key in keys:
        handle.press(key)


def latencies(page, label, count):
    """Milliseconds from a key on a slider of a panel at rest until the pixels of overlay and head have both changed."""
    press(page, label, "Home")
    for _ in range(6):
        press(page, label, "PageUp")
    handle, found = page.slider(label).element_handle(), []
    for k in range(count):
        page.ask_kernel("panel.wait_idle(300)")
        page.wait_drawn()
        key = "ArrowRight" if (k // 10) % 2 == 0 else "ArrowLeft"
        found.append(page.page.evaluate("([h, k, s]) => window.timeToPixels(h, k, s)", [handle, key, [MARKS, HEAD]]))
    return found
