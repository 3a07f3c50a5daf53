"""The tuning session without a user interface: material, configuration with undo, fits, diagnosis, export."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
