"""A live 3D head in the notebook: the interface of its back ends, and their shared parts."""

import html
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Protocol, runtime_checkable

import cv2
import ipywidgets as widgets
import numpy as np
from jaxtyping import Float, UInt8

from workbench.errors import InputError
from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.extras import NOTHING, Extras
from workbench.widgets.viewpoint import Viewpoint, camera_viewpoint, front_viewpoint

Number = float | int
VIEWS = ("free", "front", "camera")
DARKEST = 42
"""First step of viridis in use, of 256, because darker ones look like shadow."""


class Carrier(Protocol):
    """A widget whose next message takes along what has changed in another one."""

    def carry(self, to: str, state: dict[str, object]) -> None:
        """Take along the `state` of the widget with the `model_id` `to`."""


@runtime_checkable
class HeadView(Protocol):
    """A head that can be viewed from all sides. Every method may be called from any thread and returns at once."""

    widget: widgets.Widget
    """The widget for a cell to display."""
    note: str | None
    """A message for the user; None if there is nothing to report."""

    def at_once(self, carrier: Carrier | None = None) -> AbstractContextManager[object]:
        """What is set within this is drawn together; together with the `carrier`, too, if it goes to the browser."""

    def set_vertices(self, vertices: Float[np.ndarray, "v 3"], rest: Float[np.ndarray, "v 3"] | None = None) -> None:
        """Show the head with these vertices: head frame, millimetres.

        `rest` is the person without an expression, whom a character's hair follows; None: as before, or the model.
        """

    def set_pose(
        self,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        camera: Camera,
        image_size: tuple[int, int],
    ) -> None:
        """Set the fitted pose (head to camera; axis-angle, millimetres) and its camera; moves the "camera" view."""

    def set_view(self, view: str) -> None:
        """View from "front", from the input "camera", or as set with the mouse ("free")."""

    def set_values(self, values: Float[np.ndarray, "v"] | None, low: Number, high: Number, label: str) -> None:
        """Colour the surface by a number per vertex, viridis from `low` to `high`; None shows the skin again."""

    def set_points(
        self, points: Float[np.ndarray, "n 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None, size_mm: Number = 2.0
    ) -> None:
        """Show points as balls of this diameter: head frame, millimetres; None removes them."""

    def set_segments(
        self, segments: Float[np.ndarray, "n 2 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None
    ) -> None:
        """Show segments, such as residual vectors in 3D: head frame, millimetres; None removes them."""

    def set_ghost(
        self, vertices: Float[np.ndarray, "v 3"] | None, opacity: Number = 0.35, outline: bool = False
    ) -> None:
        """Show a second, translucent head, such as the fit before a change; None removes it.

        `outline`: only its outline, over the head; from within, a surface looks like a bruise.
        """

    def snapshot(self) -> UInt8[np.ndarray, "h w 3"]:
        """An RGB picture of the current view, rendered off screen."""

    def close(self) -> None:
        """Free the resources of browser and kernel; closing twice is fine."""


@dataclass(frozen=True)
class Shown:
    """The content of a view; replaced by a changed copy on every change."""

    vertices: Float[np.ndarray, "v 3"]
    extras: Extras = NOTHING
    view: str = "front"
    pose: Viewpoint | None = None
    """The viewpoint of the input camera."""
    scale: tuple[str | None, float, float] = (None, 0.0, 1.0)
    """The colour scale, as arguments of `Legend.show`."""

    def with_extras(self, **changes: object) -> "Shown":
        """A copy with these extras changed."""
        return replace(self, extras=replace(self.extras, **changes))


def viewpoint_of(shown: Shown, model: FaceModel, size: tuple[int, int]) -> Viewpoint | None:
    """The viewpoint of "front" or "camera"; "camera" is like "front" until a pose is known; None for "free"."""
    if shown.view == "free":
        return None
    if shown.view == "camera" and shown.pose is not None:
        return shown.pose
    return front_viewpoint(model, size)


def posed(
    rotation: np.ndarray, translation: np.ndarray, camera: Camera, image_size: tuple[int, int], size: tuple[int, int]
) -> Viewpoint:
    """`camera_viewpoint` after checking the numbers."""
    numbers = (rotation, translation, camera.focal_px, camera.principal_point_px, camera.distortion)
    if not all(np.isfinite(array).all() for array in numbers) or translation[2] <= 0.0:
        raise InputError(
            "A pose needs finite numbers and depth > 0 (in front of the camera); frames without a face have no pose."
        )
    return camera_viewpoint(rotation, translation, camera, image_size, size)


def check_view(view: str) -> None:
    """Raise `InputError` for an unknown view."""
    if view not in VIEWS:
        raise InputError(f"The view must be one of {', '.join(VIEWS)}, got {view!r}.")


def check_vertices(vertices: np.ndarray, vertex_count: int) -> None:
    """Raise `InputError` for a shape other than (vertex_count, 3) and for non-finite numbers."""
    if vertices.shape != (vertex_count, 3):
        raise InputError(f"This head has {vertex_count} vertices (x, y, z), got an array of shape {vertices.shape}.")
    if not np.isfinite(vertices).all():
        raise InputError("The vertices of a head must be finite, got NaN; frames without a face have no mesh.")


def check_marks(marks: np.ndarray | None, colors: np.ndarray | None, shape: tuple[int, ...], what: str) -> None:
    """Raise `InputError` for marks of a shape other than (n, *shape), without one colour each, or not finite."""
    if marks is None:
        return
    if marks.shape[1:] != shape:
        raise InputError(f"{what} need shape (n, {', '.join(map(str, shape))}), got {marks.shape}.")
    if colors is None or colors.shape != (len(marks), 3):
        came = "none" if colors is None else f"an array of shape {colors.shape}"
        raise InputError(f"{len(marks)} {what.lower()} need as many RGB colours, shape ({len(marks)}, 3), got {came}.")
    if not np.isfinite(marks).all():
        raise InputError(f"{what} must have finite positions, got NaN; leave the unknown ones out.")


def check_opacity(opacity: Number) -> None:
    """Raise `InputError` for an opacity outside 0..1."""
    if not 0.0 <= opacity <= 1.0:
        raise InputError(f"The opacity of a ghost must be between 0 and 1, got {opacity:g}.")


def value_colors(
    values: Float[np.ndarray, "v"] | None, low: Number, high: Number, vertex_count: int
) -> UInt8[np.ndarray, "v 3"] | None:
    """Viridis colours of numbers from `low` to `high`, grey for NaN; None for None.

    Raises `InputError` for a count other than `vertex_count` and for a scale that does not ascend.
    """
    if values is None:
        return None
    if values.shape != (vertex_count,):
        raise InputError(
            f"This head needs one number for each of {vertex_count} vertices, got an array of shape {values.shape}."
        )
    if not low < high:
        raise InputError(f"A colour scale must ascend from low to high, got {low:g} to {high:g}.")
    places = np.clip((np.nan_to_num(values, nan=low) - low) / (high - low), 0.0, 1.0)
    colors = scale_colors()[np.rint(places * 255).astype(int)]
    colors[np.isnan(values)] = 128
    return colors


def legend(label: str, low: Number, high: Number) -> str:
    """The colour scale as one line of HTML."""
    stops = ", ".join("#{:02x}{:02x}{:02x}".format(*color) for color in scale_colors()[::51].tolist())
    bar = f"flex:1; max-width:320px; height:8px; border-radius:4px; background:linear-gradient(to right, {stops})"
    style = (
        "display:flex; align-items:center; gap:8px; font-size:12px; line-height:18px; "
        "color:var(--jp-ui-font-color1, #333); font-variant-numeric:tabular-nums"
    )
    return (
        f"<div class='fw-head3d-legend' style='{style}'><span>{html.escape(label)}</span>"
        f"<span>{low:.3g}</span><span style='{bar}'></span><span>{high:.3g}</span></div>"
    )


class Legend(widgets.HTML):
    """The colour scale below a view of this width; hidden if there are no values."""

    def __init__(self, width_px: int) -> None:
        super().__init__(layout=widgets.Layout(display="none", margin="2px 4px 0 4px", max_width=f"{width_px}px"))

    def show(self, label: str | None, low: Number = 0.0, high: Number = 1.0) -> None:
        """Show this scale, or none if the label is None."""
        self.value = "" if label is None else legend(label, low, high)
        self.layout.display = "none" if label is None else None


@lru_cache(maxsize=1)
def scale_colors() -> UInt8[np.ndarray, "256 3"]:
    """The colours of numbers on heads, pictures and strips, from the least to the largest."""
    steps = np.linspace(DARKEST, 255, 256).astype(np.uint8)[:, None]
    return cv2.applyColorMap(steps, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].copy()
