"""Explaining a fit: reasons for bad frames, pulls of landmark groups, uncertainty, indistinguishable blendshapes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
