"""What a run was made from and with: hashes of its inputs, versions of its packages."""

import hashlib
import importlib.metadata
from pathlib import Path

from workbench import __version__
from workbench.reading import reading

PACKAGES = ("jax", "optimistix", "numpy", "scipy", "opencv-contrib-python-headless", "pyvista")


def software_versions() -> dict[str, str]:
    """Versions of what the numbers of a run depend on."""
    return {"workbench": __version__} | {name: importlib.metadata.version(name) for name in PACKAGES}


def content_hash(path: Path) -> str:
    """SHA-256 of a file, or of the files of a folder in order. Raises `InputError` for one that may not be read."""
    digest = hashlib.sha256()
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    for file in files:
        if file.is_file():
            with reading(file, "an input", "check that you may read it"), file.open("rb") as stream:
                digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()
