"""From running a cell that opens a clip to its first frame in a real browser, in a warm kernel and in a new one."""

import statistics
import sys
from pathlib import Path

from result import print_result

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests import browser
from tests.panel_page import PANEL, READY, notebook_page

ROUNDS = 7
AGAINST = "a cell that opens a clip with its landmarks, JupyterLab in Chromium; the kernel has shown a panel before"
CELLS = (PANEL.format(name="laugh"), READY, "panel.close()")
MEASURE = """(index) => new Promise((resolve) => {
  const start = performance.now(), found = {};
  const shown = (selector) => [...document.querySelectorAll(selector)].some((e) => e.offsetWidth);
  const looks = {
    first_ms: () => [...document.querySelectorAll('.fw-first')].some((e) => e.naturalWidth && e.offsetWidth),
    picture_ms: () => shown(`.fw-overlay[data-state*='"decoded":true']`),
    sliders_ms: () => shown('.fw-controls .noUi-handle'),
  };
  const look = () => {
    for (const [name, there] of Object.entries(looks)) {
      if (!(name in found) && there()) found[name] = performance.now() - start;
    }
    if (found.picture_ms && found.sliders_ms) resolve(found);
    else requestAnimationFrame(look);
  };
  window.jupyterapp.shell.currentWidget.content.activeCellIndex = index;
  window.jupyterapp.commands.execute('notebook:run-cell');
  requestAnimationFrame(look);
})"""


def main() -> None:
    """Open the clip in a new kernel, then again and again."""
    lacking = browser.missing()
    if lacking:
        return print_result("panel_opening", None, "s", "<= 1", AGAINST, {"skipped": lacking})
    with notebook_page("clip.ipynb", CELLS) as page:
        page.open("clip.ipynb")
        new, *warm = [opened(page) for _ in range(1 + ROUNDS)]
    details = {name: statistics.median(each[name] for each in warm) for name in new}
    details |= {"longest_ms": max(each["first_ms"] for each in warm), "new_kernel": new}
    print_result("panel_opening", details["first_ms"] / 1000, "s", "<= 1", AGAINST, details)


def opened(page: browser.LabPage) -> dict[str, float]:
    """Milliseconds until the first frame, the picture with its landmarks, and sliders; the panel is closed again."""
    found = page.page.evaluate(MEASURE, 0)
    page.run_cell(1)
    page.run_cell(2)
    page.page.evaluate("() => window.jupyterapp.commands.execute('notebook:clear-all-cell-outputs')")
    page.page.wait_for_function("() => !document.querySelector('.fw-panel')")
    return found


if __name__ == "__main__":
    main()
