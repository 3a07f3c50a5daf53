"""Pictures: the 3D head off screen, and overlays on the input frames."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
