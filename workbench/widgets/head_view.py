"""A live 3D head in the notebook: one interface, drawn by the browser (k3d) or as pictures from the kernel."""

import html
import importlib.util
import os
import sys
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol, runtime_checkable

import cv2
import ipywidgets as widgets
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import InputError, MissingDependencyError
from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.extras import NOTHING, Extras
from workbench.widgets.viewpoint import Viewpoint, camera_viewpoint, front_viewpoint

Number = float | int
BACKENDS = ("auto", "k3d", "pictures")
VIEWS = ("free", "front", "camera")
VSCODE_VARIABLES = ("VSCODE_PID", "VSCODE_CWD", "VSCODE_HANDLES_UNCAUGHT_ERRORS")
"""Set where VS Code starts a kernel; its terminal does not pass them on to a JupyterLab."""
DARKEST = 42
"""First step of viridis that is used, of 256: the darker ones are lost in shadow."""


@runtime_checkable
class HeadView(Protocol):
    """A head that can be looked at from all sides. Every method may be called from any thread and returns at once."""

    widget: widgets.Widget
    """What a cell displays."""
    note: str | None
    """What the user should know, None if all is well."""

    def set_vertices(self, vertices: Float[np.ndarray, "v 3"]) -> None:
        """Show the head with these vertices: head frame, millimetres."""

    def set_pose(
        self,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        camera: Camera,
        image_size: tuple[int, int],
    ) -> None:
        """The fitted pose (head to camera; axis-angle, millimetres) and its camera; moves the "camera" view."""

    def set_view(self, view: str) -> None:
        """Look from "front", from the input "camera", or leave the mouse's view alone ("free")."""

    def set_values(self, values: Float[np.ndarray, "v"] | None, low: Number, high: Number, label: str) -> None:
        """Colour the surface by a number per vertex, viridis from `low` to `high`; None shows the skin again."""

    def set_points(
        self, points: Float[np.ndarray, "n 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None, size_mm: Number = 2.0
    ) -> None:
        """Points as balls of this diameter: head frame, millimetres; None removes them."""

    def set_segments(
        self, segments: Float[np.ndarray, "n 2 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None
    ) -> None:
        """Segments, such as residual vectors in 3D: head frame, millimetres; None removes them."""

    def set_ghost(self, vertices: Float[np.ndarray, "v 3"] | None, opacity: Number = 0.35) -> None:
        """A second, translucent head, such as the fit before a change; None removes it."""

    def snapshot(self) -> UInt8[np.ndarray, "h w 3"]:
        """A still RGB picture of what is shown, from the current point of view, rendered off screen."""

    def close(self) -> None:
        """Free the browser's and the kernel's resources; closing twice is fine."""


def make_head_view(model: FaceModel, size: tuple[int, int] = (440, 440), backend: str = "auto") -> HeadView:
    """A live view of the model's head, (width, height) in pixels.

    "k3d" draws in the browser, "pictures" in the kernel; "auto" takes k3d unless the notebook runs where it is known
    to fail. Raises `InputError` for an unknown back end or size, `MissingDependencyError` for k3d without the package.
    """
    if not all(64 <= side <= 4096 for side in size):
        raise InputError(f"A 3D view has sides of 64 to 4096 pixels, got {size[0]} × {size[1]}.")
    chosen, note = chosen_backend(backend)
    # Each back end is imported only where it is used: either may be missing a package.
    if chosen == "k3d":
        from workbench.widgets.k3d_head_view import K3dHeadView

        return K3dHeadView(model, size)
    from workbench.widgets.picture_head_view import PictureHeadView

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


@dataclass(frozen=True)
class Shown:
    """What a view shows; a changed copy replaces it."""

    vertices: Float[np.ndarray, "v 3"]
    extras: Extras = NOTHING
    view: str = "front"
    pose: Viewpoint | None = None
    """The input camera's point of view."""
    scale: tuple[str | None, float, float] = (None, 0.0, 1.0)
    """What the colours mean, as `Legend.show` takes it."""

    def with_extras(self, **changes: object) -> "Shown":
        """A copy with these extras changed."""
        return replace(self, extras=replace(self.extras, **changes))


def viewpoint_of(shown: Shown, model: FaceModel, size: tuple[int, int]) -> Viewpoint | None:
    """From where "front" or "camera" looks, the camera as the front while no pose is known; None for "free"."""
    if shown.view == "free":
        return None
    if shown.view == "camera" and shown.pose is not None:
        return shown.pose
    return front_viewpoint(model, size)


def posed(
    rotation: np.ndarray, translation: np.ndarray, camera: Camera, image_size: tuple[int, int], size: tuple[int, int]
) -> Viewpoint:
    """`camera_viewpoint` of numbers that have been checked."""
    numbers = (rotation, translation, camera.focal_px, camera.principal_point_px, camera.distortion)
    if not all(np.isfinite(array).all() for array in numbers) or translation[2] <= 0.0:
        raise InputError(
            "A pose needs finite numbers and a head before the camera (depth > 0); frames without a face have none."
        )
    return camera_viewpoint(rotation, translation, camera, image_size, size)


def check_view(view: str) -> None:
    """Raise `InputError` for an unknown view."""
    if view not in VIEWS:
        raise InputError(f"A 3D view looks {', '.join(VIEWS)}, got {view!r}.")


def check_vertices(vertices: np.ndarray, vertex_count: int) -> None:
    """Raise `InputError` for another shape than (vertex_count, 3) and for numbers that are not finite."""
    if vertices.shape != (vertex_count, 3):
        raise InputError(f"This head has {vertex_count} vertices (x, y, z), got an array of shape {vertices.shape}.")
    if not np.isfinite(vertices).all():
        raise InputError("A head can only be shown with finite numbers, got NaN; frames without a face have no mesh.")


def check_marks(marks: np.ndarray | None, colors: np.ndarray | None, shape: tuple[int, ...], what: str) -> None:
    """Raise `InputError` for marks of another shape than (n, *shape), without a colour each, or not finite."""
    if marks is None:
        return
    if marks.shape[1:] != shape:
        raise InputError(f"{what} need shape (n, {', '.join(map(str, shape))}), got {marks.shape}.")
    if colors is None or colors.shape != (len(marks), 3):
        came = "none" if colors is None else f"an array of shape {colors.shape}"
        raise InputError(f"{len(marks)} {what.lower()} need as many RGB colours, shape ({len(marks)}, 3), got {came}.")
    if not np.isfinite(marks).all():
        raise InputError(f"{what} can only be shown at finite places, got NaN; leave the unknown ones out.")


def check_opacity(opacity: Number) -> None:
    """Raise `InputError` for an opacity outside 0..1."""
    if not 0.0 <= opacity <= 1.0:
        raise InputError(f"The opacity of a ghost lies between 0 and 1, got {opacity:g}.")


def value_colors(
    values: Float[np.ndarray, "v"] | None, low: Number, high: Number, vertex_count: int
) -> UInt8[np.ndarray, "v 3"] | None:
    """Viridis colours of numbers from `low` to `high`, grey where they are NaN; None for None.

    Raises `InputError` for another count than `vertex_count` and for a scale that does not ascend.
    """
    if values is None:
        return None
    if values.shape != (vertex_count,):
        raise InputError(f"This head has {vertex_count} vertices, a number each, got an array of shape {values.shape}.")
    if not low < high:
        raise InputError(f"A colour scale ascends from low to high, got {low:g} to {high:g}.")
    places = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0.0, 1.0)
    colors = _scale()[np.rint(places * 255).astype(int)]
    colors[np.isnan(values)] = 128
    return colors


def legend(label: str, low: Number, high: Number) -> str:
    """The colour scale as one line of HTML."""
    stops = ", ".join("#{:02x}{:02x}{:02x}".format(*color) for color in _scale()[::51].tolist())
    bar = f"flex:1; height:8px; border-radius:4px; background:linear-gradient(to right, {stops})"
    style = (
        "display:flex; align-items:center; gap:8px; font-size:12px; line-height:18px; "
        "color:var(--jp-ui-font-color1, #333); font-variant-numeric:tabular-nums"
    )
    return (
        f"<div class='fw-head3d-legend' style='{style}'><span>{html.escape(label)}</span>"
        f"<span>{low:.3g}</span><span style='{bar}'></span><span>{high:.3g}</span></div>"
    )


class Legend(widgets.HTML):
    """The colour scale under a view of this width; hidden while there are no values."""

    def __init__(self, width_px: int) -> None:
        super().__init__(layout=widgets.Layout(display="none", margin="2px 4px 0 4px", max_width=f"{width_px}px"))

    def show(self, label: str | None, low: Number = 0.0, high: Number = 1.0) -> None:
        """Show this scale, or none for the label None."""
        self.value = "" if label is None else legend(label, low, high)
        self.layout.display = "none" if label is None else None


@lru_cache(maxsize=1)
def _scale() -> UInt8[np.ndarray, "256 3"]:
    steps = np.linspace(DARKEST, 255, 256).astype(np.uint8)[:, None]
    return cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].copy()
