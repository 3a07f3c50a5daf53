"""Objectives: how good the fits of a clip are, one number per frame, with or without a known truth."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
