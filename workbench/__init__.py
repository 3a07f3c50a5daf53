"""Face Energy Workbench: facial performance capture by optimisation."""

from workbench.runtime import configure_jax

configure_jax()

__version__ = "0.1.0"
