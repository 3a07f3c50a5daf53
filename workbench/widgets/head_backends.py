"""A live 3D head in the notebook, drawn by the browser (WebGL) or sent as pictures from the kernel."""

import os
import sys

from workbench.errors import InputError
from workbench.face.dressed_head import DressedHead
from workbench.face.model import FaceModel
from workbench.widgets.head_view import HeadView
from workbench.widgets.picture_head_view import PictureHeadView
from workbench.widgets.webgl_head_view import WebGLHeadView

BACKENDS = ("auto", "webgl", "pictures")
VSCODE_VARIABLES = ("VSCODE_PID", "VSCODE_CWD", "VSCODE_HANDLES_UNCAUGHT_ERRORS")
"""Set in kernels started by VS Code; its terminal does not pass them on to JupyterLab."""
UNTRIED_NOTE = 'The 3D view uses pictures from the kernel: WebGL is untested in {place}; backend="webgl" tries it.'


def make_head_view(
    model: FaceModel,
    size: tuple[int, int] = (440, 440),
    backend: str = "auto",
    dressed: DressedHead | None = None,
    fills: bool = False,
) -> HeadView:
    """A live view of the model's head, (width, height) in pixels; `dressed`: as a character.

    `fills`: where the browser draws, as large as the place that it is given.

    "webgl" draws in the browser, "pictures" in the kernel; "auto" uses WebGL unless the notebook runs where that is
    untested. Raises `InputError` for an unknown back end or size.
    """
    if not all(64 <= side <= 4096 for side in size):
        raise InputError(f"The sides of a 3D view must be 64 to 4096 pixels, got {size[0]} × {size[1]}.")
    chosen, note = chosen_backend(backend)
    if chosen == "webgl":
        return WebGLHeadView(model, size, dressed, fills)
    return PictureHeadView(model, size, note, dressed)


def chosen_backend(backend: str = "auto") -> tuple[str, str | None]:
    """The back end to use here, and the reason if it is not WebGL. Raises like `make_head_view`."""
    if backend == "k3d":
        raise InputError("The back end 'k3d' of a 3D view is now called 'webgl'; use that, or leave it at 'auto'.")
    if backend not in BACKENDS:
        raise InputError(f"The back end of a 3D view must be one of {', '.join(BACKENDS)}, got {backend!r}.")
    if backend != "auto":
        return backend, None
    if "google.colab" in sys.modules:
        return "pictures", UNTRIED_NOTE.format(place="Colab")
    if any(os.environ.get(name) for name in VSCODE_VARIABLES):
        return "pictures", UNTRIED_NOTE.format(place="VS Code")
    return "webgl", None
