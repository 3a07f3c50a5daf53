"""Every energy term as a small pure residual function; weights are applied last, in `total`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
