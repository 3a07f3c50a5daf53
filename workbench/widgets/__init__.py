"""Widgets for notebooks: a value and a callback each; the arithmetic lives in functions that need no browser."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
