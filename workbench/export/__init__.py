"""What leaves the workbench: animation, tables, films, reports, and performances on other characters."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
