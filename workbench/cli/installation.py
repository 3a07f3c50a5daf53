"""`workbench info` and `workbench --version`."""

import hashlib
import importlib.metadata
import importlib.util
import platform
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

import workbench
from workbench.cli import screen
from workbench.config import PRESETS
from workbench.errors import MissingDependencyError
from workbench.extras import install_command
from workbench.runtime import cache_folder
from workbench.samples import samples_folder

PACKAGES = (
    "jax",
    "equinox",
    "optimistix",
    "opencv-contrib-python-headless",
    "pyvista",
    "vtk",
    "dlib-bin",
    "jupyterlab",
    "voila",
)


def _print_version(asked: bool) -> None:
    if asked:
        screen.console.print(workbench.__version__)
        raise typer.Exit


def of_the_program(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """The options that stand before a command."""


def info() -> None:
    """Versions, what is installed, and where things are."""

    bundled = workbench.landmarks.network_detector.BUNDLED
    head = workbench.load_default_head()
    rows = {
        "workbench": workbench.__version__,
        "Python": platform.python_version(),
        **{name: _version(name) for name in PACKAGES},
        "auto detector": workbench.landmarks.chosen_detector(),
        "dlib detector": "installed" if _has_dlib() else f"missing: {install_command('dlib')}",
        **{f"network {path.stem}": _network(path) for path in sorted(bundled.glob("*.safetensors"))},
        "app": "installed" if _has("voila") else f"missing: {install_command('app')}",
        "3D pictures": "VTK off screen"
        if workbench.pictures.gl_available()
        else "plain (VTK found no usable OpenGL library)",
        "default head": f"{len(head.neutral)} vertices, {len(head.expression_names)} blendshapes",
        "presets": ", ".join(PRESETS),
        "samples": str(samples_folder()),
        "cache": str(cache_folder()),
    }
    longest = max(map(len, rows))
    for name, value in rows.items():
        # A table would cut a path or break it in two, and neither can be copied.
        screen.console.print(f"[bold]{name:{longest}}[/bold]  {escape(value)}", soft_wrap=True)


def _network(path: Path) -> str:
    """Architecture, size and identity of a weights file."""

    weights = workbench.networks.read_weights(path)
    numbers = sum(array.size for array in weights.arrays.values())
    content = path.read_bytes()
    digest = hashlib.sha256(content).hexdigest()[:12]
    return f"{weights.architecture}, {numbers:,} parameters, {len(content) / 2**20:.1f} MiB, SHA-256 {digest}…"


def _has_dlib() -> bool:
    """Whether dlib can be used, with its model files."""

    try:
        workbench.landmarks.dlib_detector.check_installed()
    except MissingDependencyError:
        return False
    return True


def _has(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
