"""Slider to pixels: from a key event in a real browser to changed pixels of the overlay and of the 3D head."""

import statistics
import sys
import tempfile
from pathlib import Path

import numpy as np
from result import print_result

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from tests import browser
from tests.panel_page import PANEL, READY, latencies, opened, write_notebook

SAMPLES = 50
AGAINST = "a key on ω_σ in JupyterLab, Chromium with software WebGL; single-frame fit, overlay and 3D"


def main() -> None:
    """Open the panel on the portrait and move one slider 50 times."""
    lacking = browser.missing()
    if lacking:
        return print_result("panel_latency", None, "ms", "<= 100", AGAINST, {"skipped": lacking})
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "notebooks").mkdir()
        write_notebook(folder / "notebooks" / "photo.ipynb", (PANEL.format(name="astronaut"), READY))
        with (
            browser.lab_server(folder / "notebooks", folder / "settings") as server,
            browser.lab_page(server, folder / "profile") as page,
        ):
            page.page.set_viewport_size({"width": 1366, "height": 768})
            page.page.add_init_script(browser.KEEP_PIXELS)
            opened(page, "photo.ipynb")
            found = latencies(page, "ω_σ L1", SAMPLES)
    unchanged = found.count(None)
    found = [milliseconds for milliseconds in found if milliseconds is not None]
    details = {"p95_ms": float(np.percentile(found, 95)), "p95_goal_ms": 200.0, "unchanged": unchanged}
    print_result("panel_latency", statistics.median(found), "ms", "<= 100", AGAINST, details)


if __name__ == "__main__":
    main()
