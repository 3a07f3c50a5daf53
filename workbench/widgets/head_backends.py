"""A live 3D head in the notebook: drawn by the browser (k3d), or as pictures from the kernel."""

import importlib.util
import os
import sys

from workbench.errors import InputError, MissingDependencyError
from workbench.face.model import FaceModel
from workbench.widgets.head_view import HeadView
from workbench.widgets.picture_head_view import PictureHeadView

BACKENDS = ("auto", "k3d", "pictures")
VSCODE_VARIABLES = ("VSCODE_PID", "VSCODE_CWD", "VSCODE_HANDLES_UNCAUGHT_ERRORS")
"""Set where VS Code starts a kernel; its terminal does not pass them on to a JupyterLab."""


def make_head_view(model: FaceModel, size: tuple[int, int] = (440, 440), backend: str = "auto") -> HeadView:
    """A live view of the model's head, (width, height) in pixels.

    "k3d" draws in the browser, "pictures" in the kernel; "auto" takes k3d unless the notebook runs where it is known
    to fail. Raises `InputError` for an unknown back end or size, `MissingDependencyError` for k3d without the package.
    """
    if not all(64 <= side <= 4096 for side in size):
        raise InputError(f"A 3D view has sides of 64 to 4096 pixels, got {size[0]} × {size[1]}.")
    chosen, note = chosen_backend(backend)
    if chosen == "k3d":
        from workbench.widgets.k3d_head_view import K3dHeadView  # here: pictures do without the package k3d

        return K3dHeadView(model, size)
    return PictureHeadView(model, size, note)


def chosen_backend(backend: str = "auto") -> tuple[str, str | None]:
    """The back end to use here, and why it is not k3d. Raises as `make_head_view`."""
    if backend not in BACKENDS:
        raise InputError(f"The back end of a 3D view is one of {', '.join(BACKENDS)}, got {backend!r}.")
    installed = "k3d" in sys.modules or importlib.util.find_spec("k3d") is not None
    if backend == "k3d" and not installed:
        raise MissingDependencyError("The 3D view in the browser needs k3d; pip install k3d, or use 'pictures'.")
    if backend != "auto":
        return backend, None
    if "google.colab" in sys.modules:
        return "pictures", "3D view as pictures from the kernel: k3d needs code from other sites in Colab."
    if any(os.environ.get(name) for name in VSCODE_VARIABLES):
        return "pictures", "3D view as pictures from the kernel, as in all notebooks of VS Code; JupyterLab has k3d."
    if not installed:
        return "pictures", "3D view as pictures from the kernel; pip install k3d for one drawn by the browser."
    return "k3d", None
