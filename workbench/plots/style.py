"""How figures look: the colours of lines and terms, the sizes of letters, and ink on a page that is light or dark."""

import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import ParamSpec

from matplotlib import rc_context
from matplotlib.figure import Figure

Given = ParamSpec("Given")
BLUE, RED, GREY, GREEN, AMBER = "#0072B2", "#D55E00", "#8d99a6", "#009E73", "#E69F00"
"""Okabe and Ito's colours, which colour-blind readers tell apart, as in the panel's charts; grey: the truth, sums."""
PURPLE, SKY = "#CC79A7", "#56B4E9"
LINES = ((BLUE, "-"), (RED, "--"), (GREEN, "-."), (AMBER, "-"), (PURPLE, ":"), (SKY, "--"))
"""Colour and dash pattern of the lines of a figure, in order; dashes distinguish them without colour."""
TERMS = {
    "landmarks": (BLUE, "-"),
    "edges": (RED, "--"),
    "tau": (GREEN, "-."),
    "beta": (AMBER, "--"),
    "sigma": (PURPLE, ":"),
    "sigma_smooth": (PURPLE, "-"),
    "range": (AMBER, ":"),
    "regularisation": (AMBER, "-"),
    "identity": (SKY, "-"),
    "prior": (GREEN, ":"),
    "stay": (SKY, ":"),
    "vergence": (SKY, "--"),
    "gaze": (SKY, "-."),
    "opposites": (GREEN, "--"),
    "symmetry": (GREY, "--"),
    "usual": (GREY, "-"),
    "flow": (RED, "-"),
}
"""Terms of the energy, the same in every figure and in the panel; any other looks like `flow`."""
TITLE_PT, LABEL_PT, TICK_PT = 9.5, 9, 8
"""Sizes of letters, points."""


@dataclass(frozen=True)
class Page:
    """The colours of what is neither line nor picture."""

    paper: str
    ink: str
    soft: str
    """Less than ink: reference lines."""
    faint: str
    """Grids and borders."""
    band: str
    """Ranges behind the lines."""


LIGHT = Page(paper="#ffffff", ink="#212121", soft="#666666", faint="#d0d0d0", band="#efefef")
DARK = Page(paper="#111111", ink="#e0e0e0", soft="#a8a8a8", faint="#4a4a4a", band="#262626")
THEMES = "@jupyterlab/apputils-extension/themes.jupyterlab-settings"
_chosen: ContextVar[Page | None] = ContextVar("page", default=None)


def page() -> Page:
    """The page that figures are drawn on: dark in a notebook of a JupyterLab with a dark theme, else light.

    `WORKBENCH_FIGURES` says `light` or `dark` where the theme is not JupyterLab's.
    """
    told = {"light": LIGHT, "dark": DARK}.get(os.environ.get("WORKBENCH_FIGURES", ""))
    return _chosen.get() or told or (DARK if _is_lab_dark() else LIGHT)


@contextmanager
def on_page(chosen: Page) -> Iterator[None]:
    """Draw on this page, whatever the theme is: for files."""
    token = _chosen.set(chosen)
    try:
        yield
    finally:
        _chosen.reset(token)


def styled(draw: Callable[Given, Figure]) -> Callable[Given, Figure]:
    """The function, whose figures have the ink, the paper and the letters of the page."""

    @wraps(draw)
    def drawn(*args: Given.args, **options: Given.kwargs) -> Figure:
        with rc_context(_settings(page())):
            figure = draw(*args, **options)
        for axis in figure.axes:  # ticks are made when they are drawn, after the settings are gone
            axis.tick_params(which="both", color=page().soft, labelcolor=page().ink)
        return figure

    return drawn


def term_line(name: str) -> tuple[str, str]:
    """Colour and dash pattern of a term of the energy."""
    return TERMS.get(name, TERMS["flow"])


def _settings(page: Page) -> dict[str, object]:
    inks = ("text.color", "axes.labelcolor", "axes.titlecolor", "xtick.labelcolor", "ytick.labelcolor")
    papers = ("figure.facecolor", "axes.facecolor", "savefig.facecolor")
    sizes = {"font.size": LABEL_PT, "axes.titlesize": TITLE_PT, "axes.labelsize": LABEL_PT, "legend.fontsize": LABEL_PT}
    return {
        **dict.fromkeys(inks, page.ink),
        **dict.fromkeys(papers, page.paper),
        **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), page.soft),
        **dict.fromkeys(("xtick.labelsize", "ytick.labelsize"), TICK_PT),
        **sizes,
        "grid.color": page.faint,
        "legend.frameon": False,
    }


def _is_lab_dark() -> bool:
    """Whether the notebook's server keeps a dark theme among its user's settings, in JSON with comments."""
    if "JPY_SESSION_NAME" not in os.environ:  # which a Jupyter server gives to its notebooks' kernels
        return False
    from jupyter_core.paths import jupyter_config_dir

    folder = os.environ.get("JUPYTERLAB_SETTINGS_DIR") or Path(jupyter_config_dir()) / "lab" / "user-settings"
    try:
        kept = (Path(folder) / THEMES).read_text(encoding="utf-8")
    except OSError:
        return False
    theme = re.search(r'^\s*"theme"\s*:\s*"([^"]*)"', kept, re.M)
    return theme is not None and "dark" in theme[1].lower()
