"""Widgets for notebooks, each with a value and a callback; computations are in functions that need no browser."""

import lazy_loader

from workbench.extras import check_installed

check_installed("lab", "anywidget", "ipywidgets")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
