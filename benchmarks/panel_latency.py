"""Slider to pixels in a real browser: the tuning panel, in turns with the least that a kernel can redraw."""

import os
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from result import print_result

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests import browser
from tests.panel_page import HEAD, MARKS, notebook_page, opened, press

TURNS, MOVES = 5, 10
BARE = (".bare-canvas", ".bare-head")
AGAINST = (
    "a bare canvas and a bare WebGL head (bare_views.py) of the same sizes, redrawn by a slider through the kernel"
)
CELLS = (
    """
    import ipywidgets
    import workbench
    from benchmarks.bare_views import bare_panel
    from workbench.session import open_session
    from workbench.widgets import TuningPanel

    session = open_session(workbench.sample("astronaut"), landmarks=workbench.sample("astronaut-landmarks"))
    panel, floor = TuningPanel(session, backend="webgl"), ipywidgets.VBox()
    ipywidgets.VBox([panel, floor])
    """,
    "ready = panel.wait_idle(300)",
)
FLOOR = "floor.children = (bare_panel(session.model, session.picture(0), panel.fit.observed, {sizes}),)"


def main() -> None:
    """Open the panel on the portrait, the bare views below it, and move the sliders of both in turns."""
    lacking = browser.missing()
    if lacking:
        return print_result("panel_latency", None, "×", "<= 1.3", AGAINST, {"skipped": lacking})
    with notebook_page("photo.ipynb", CELLS) as page:
        page.page.add_init_script(browser.KEEP_PIXELS)
        opened(page, "photo.ipynb")
        sizes = [size_of(page, selector) for selector in (MARKS, HEAD)]
        page.ask_kernel(FLOOR.format(sizes=sizes))
        page.page.wait_for_selector(BARE[1])
        panel, floor = in_turns(page)
    ratio = statistics.median(panel) / statistics.median(floor)
    print_result("panel_latency", ratio, "×", "<= 1.3", AGAINST, details_of(panel, floor, sizes))


def size_of(page: browser.LabPage, selector: str) -> list[int]:
    """Width and height of a canvas, in its own pixels."""
    return page.page.locator(selector).first.evaluate("(canvas) => [canvas.width, canvas.height]")


def in_turns(page: browser.LabPage) -> tuple[list[float], list[float]]:
    """Milliseconds of each move of the panel's slider and of the bare one; the first turn of both does not count."""
    press(page, "ω_σ L1", "Home", *["PageUp"] * 6)
    found: tuple[list[float], list[float]] = [], []
    for turn in range(TURNS + 1):
        key = ("ArrowRight", "ArrowLeft")[turn % 2]
        for times, label, canvases in zip(found, ("ω_σ L1", "bare"), ((MARKS, HEAD), BARE), strict=True):
            moved = moves(page, label, canvases, key)
            times += moved if turn else []
    return found


def moves(page: browser.LabPage, label: str, canvases: Sequence[str], key: str) -> list[float]:
    """Milliseconds from a key on a slider at rest until both canvases have other pixels, for each move of a turn."""
    handle, times = page.slider(label).element_handle(), []
    for _ in range(MOVES):
        page.ask_kernel("panel.wait_idle(300)")
        page.wait_drawn()
        times.append(page.page.evaluate("([h, k, s]) => window.timeToPixels(h, k, s)", [handle, key, canvases]))
    if None in times:
        raise RuntimeError(f"the slider {label} moved, and after 5 s {' or '.join(canvases)} had not changed")
    return times


def details_of(panel: list[float], floor: list[float], sizes: list[list[int]]) -> dict[str, object]:
    """Medians and 95th percentiles, the sizes of picture and head, and how busy the machine was."""
    named = {"panel": np.array(panel), "floor": np.array(floor)}
    spread = {f"{name}_p95_ms": float(np.percentile(times, 95)) for name, times in named.items()}
    medians = {f"{name}_ms": float(np.median(times)) for name, times in named.items()}
    return medians | spread | {"moves": len(panel), "sizes_px": str(sizes), "load": os.getloadavg()[0]}


if __name__ == "__main__":
    main()
