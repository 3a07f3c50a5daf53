"""Widgets for notebooks, each with a value and a callback; computations are in functions that need no browser."""

import lazy_loader

from workbench.extras import check_installed

check_installed("lab", "anywidget", "ipywidgets")

from workbench.widgets.kernel_comms import (  # noqa: E402 - needs the packages checked above
    answer_while_cells_run,
    lose_no_messages,
)

answer_while_cells_run()
lose_no_messages()
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
