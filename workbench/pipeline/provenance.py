"""What a run was made with: versions of its packages."""

import importlib.metadata

from workbench import __version__

PACKAGES = ("jax", "optimistix", "numpy", "scipy", "opencv-contrib-python-headless", "pyvista")


def software_versions() -> dict[str, str]:
    """Versions of what the numbers of a run depend on."""
    return {"workbench": __version__} | {name: importlib.metadata.version(name) for name in PACKAGES}
