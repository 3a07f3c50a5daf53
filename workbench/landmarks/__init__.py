"""The 68-point scheme, landmark records and files, detectors, and tracking by optical flow."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
