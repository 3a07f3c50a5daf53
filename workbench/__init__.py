"""Face Energy Workbench: facial performance capture by optimisation.

The names in `__init__.pyi` are the front door, loaded when they are first used; everything else is imported from its
folder, for example `workbench.energies`.
"""

import lazy_loader

from workbench.runtime import prepare_blas, prepare_jax

__version__ = "0.3.0"

prepare_blas()
prepare_jax()
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
