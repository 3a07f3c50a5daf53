"""Learning: the settings of a fit from an objective of a clip, by gradients through the solver or by search."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
