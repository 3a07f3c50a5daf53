"""What a run does, as data: camera, schedule of stages, ω weights, identity, landmarks. Stored as commented TOML."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
