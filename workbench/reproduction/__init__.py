"""The papers' figures, tables and experiments, remade; published data sets and simulated ones."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
