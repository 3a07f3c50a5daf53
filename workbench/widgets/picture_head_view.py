"""The head drawn by the kernel: pictures in a canvas that sends mouse movements back. It needs no WebGL."""

import threading
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

import anywidget
import cv2
import ipywidgets as widgets
import numpy as np
import traitlets
from jaxtyping import Float, UInt8

from workbench.errors import WorkbenchError
from workbench.face.dressed_head import DressedHead
from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.head_picture import head_painter
from workbench.widgets.browser_program import browser_program
from workbench.widgets.closing import close_all_of
from workbench.widgets.head_view import (
    Carrier,
    Legend,
    Number,
    Shown,
    check_marks,
    check_opacity,
    check_vertices,
    check_view,
    posed,
    value_colors,
    viewpoint_of,
)
from workbench.widgets.viewpoint import Viewpoint, front_viewpoint, orbited, panned, zoomed

JPEG_QUALITY = 88
IDLE_S = 30.0


class PictureCanvas(anywidget.AnyWidget):
    """The canvas in the browser: the latest JPEG, and the number of the last mouse movement it includes."""

    _esm = browser_program("head/pictures.js")
    _jpeg = traitlets.Bytes().tag(sync=True)
    _done = traitlets.Int(0).tag(sync=True)
    _size = traitlets.List(traitlets.Int()).tag(sync=True)
    _message = traitlets.Unicode().tag(sync=True)


@dataclass(frozen=True)
class _Scene:
    """The content of the next picture."""

    shown: Shown
    viewpoint: Viewpoint
    move: int = 0
    """Number of the last mouse movement it includes."""


class PictureHeadView:
    """A `HeadView` made of pictures. One thread draws the latest state; changes made while it draws are drawn next."""

    def __init__(
        self,
        model: FaceModel,
        size: tuple[int, int],
        note: str | None = None,
        dressed: DressedHead | None = None,
    ) -> None:
        self._model, self._size = model, size
        self._painter = head_painter(model, size, fade_neck=True, dressed=dressed)
        self.note = " ".join(part for part in (note, self._painter.note) if part) or None
        self._scene = _Scene(Shown(model.neutral.astype(np.float32)), front_viewpoint(model, size))
        self._changed = threading.Condition(threading.RLock())
        self._dirty, self._drawing, self._closed = False, False, False
        self.canvas = PictureCanvas(
            _size=list(size), _jpeg=_jpeg(self._draw(self._scene)),
            layout=widgets.Layout(width=f"{size[0]}px", max_width="100%"),
        )  # fmt: skip
        self.canvas.on_msg(self._on_message)
        self._legend = Legend(size[0])
        self.widget = widgets.VBox([self.canvas, self._legend], layout=widgets.Layout(overflow="hidden"))
        self._worker = threading.Thread(target=self._work, name="head-pictures", daemon=True)
        self._worker.start()

    def __repr__(self) -> str:
        return f"PictureHeadView({self._model.name!r}, {self._size[0]} × {self._size[1]})"

    @property
    def viewpoint(self) -> Viewpoint:
        """The current viewpoint."""
        return self._scene.viewpoint

    def at_once(self, carrier: Carrier | None = None) -> AbstractContextManager[object]:
        """See `HeadView.at_once`; a thread that waits for the lock draws only the last state."""
        return self._changed

    def set_vertices(self, vertices: Float[np.ndarray, "v 3"], rest: Float[np.ndarray, "v 3"] | None = None) -> None:
        """See `HeadView.set_vertices`."""
        for points in (vertices,) if rest is None else (vertices, rest):
            check_vertices(points, len(self._model.neutral))
        with self._changed:
            shown = replace(self._scene.shown, vertices=vertices.astype(np.float32))
            self._show(shown if rest is None else shown.with_extras(rest=rest))

    def set_pose(
        self,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        camera: Camera,
        image_size: tuple[int, int],
    ) -> None:
        """See `HeadView.set_pose`."""
        pose = posed(rotation, translation, camera, image_size, self._size)
        with self._changed:
            shown = replace(self._scene.shown, pose=pose)
            if shown.view == "camera":
                self._show(shown, pose)
            else:
                self._scene = replace(self._scene, shown=shown)

    def set_view(self, view: str) -> None:
        """See `HeadView.set_view`."""
        check_view(view)
        with self._changed:
            shown = replace(self._scene.shown, view=view)
            self._show(shown, viewpoint_of(shown, self._model, self._size))

    def set_values(self, values: Float[np.ndarray, "v"] | None, low: Number, high: Number, label: str) -> None:
        """See `HeadView.set_values`."""
        colors = value_colors(values, low, high, len(self._model.neutral))
        with self._changed:
            scale = (None if colors is None else label, float(low), float(high))
            self._show(replace(self._scene.shown.with_extras(colors=colors), scale=scale))

    def set_points(
        self, points: Float[np.ndarray, "n 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None, size_mm: Number = 2.0
    ) -> None:
        """See `HeadView.set_points`."""
        check_marks(points, colors, (3,), "Points")
        with self._changed:
            self._show(self._scene.shown.with_extras(points=points, point_colors=colors, point_mm=size_mm))

    def set_segments(
        self, segments: Float[np.ndarray, "n 2 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None
    ) -> None:
        """See `HeadView.set_segments`."""
        check_marks(segments, colors, (2, 3), "Segments")
        with self._changed:
            self._show(self._scene.shown.with_extras(segments=segments, segment_colors=colors))

    def set_ghost(
        self, vertices: Float[np.ndarray, "v 3"] | None, opacity: Number = 0.35, outline: bool = False
    ) -> None:
        """See `HeadView.set_ghost`."""
        check_opacity(opacity)
        if vertices is not None:
            check_vertices(vertices, len(self._model.neutral))
        with self._changed:
            self._show(self._scene.shown.with_extras(ghost=vertices, ghost_opacity=opacity, ghost_outline=outline))

    def snapshot(self) -> UInt8[np.ndarray, "h w 3"]:
        """See `HeadView.snapshot`."""
        return self._draw(self._scene)

    def wait_idle(self, timeout_s: float = IDLE_S) -> None:
        """Wait until the picture shows the latest state. Raises `WorkbenchError` if that takes longer."""
        with self._changed:
            if not self._changed.wait_for(lambda: self._closed or not (self._dirty or self._drawing), timeout_s):
                raise WorkbenchError(f"The 3D view was not drawn within {timeout_s:g} s; make it smaller.")

    def close(self) -> None:
        """See `HeadView.close`."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._worker:
            self._worker.join(IDLE_S)
        self._painter.close()
        close_all_of(self)

    def _show(self, shown: Shown, viewpoint: Viewpoint | None = None) -> None:
        viewpoint = self._scene.viewpoint if viewpoint is None else viewpoint
        self._scene = replace(self._scene, shown=shown, viewpoint=viewpoint)
        self._dirty = True
        self._changed.notify_all()

    def _on_message(self, _canvas, content: dict, _buffers) -> None:
        if content.get("kind") != "move":
            return
        with self._changed:
            viewpoint = _moved(self._scene.viewpoint, content, self._model, self._size)
            self._scene = replace(self._scene, move=int(content["number"]))
            self._show(self._scene.shown, viewpoint)

    def _work(self) -> None:
        while True:
            with self._changed:
                self._drawing = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._dirty or self._closed)
                if self._closed:
                    return
                self._dirty, self._drawing, scene = False, True, self._scene
            state = {"_done": scene.move, "_message": ""}
            try:
                state["_jpeg"] = _jpeg(self._draw(scene))
                self._legend.show(*scene.shown.scale)  # with the picture, not before it
            except Exception as error:
                # A thread cannot raise to a caller, so the browser shows the error in place of the picture.
                state["_message"] = f"The head could not be drawn: {error}"
            with self.canvas.hold_sync():
                for name, value in state.items():
                    setattr(self.canvas, name, value)

    def _draw(self, scene: _Scene) -> UInt8[np.ndarray, "h w 3"]:
        viewpoint = scene.viewpoint
        vertices = scene.shown.vertices.astype(float)
        return self._painter.render(vertices, viewpoint.camera, *viewpoint.pose, extras=scene.shown.extras)


def _moved(viewpoint: Viewpoint, move: dict, model: FaceModel, size: tuple[int, int]) -> Viewpoint:
    """The viewpoint after a movement in the canvas: rotation and panning in pixels, and a zoom factor."""
    if move["reset"]:
        viewpoint = front_viewpoint(model, size)
    # Dragging over the height of the view is half a turn.
    yaw, pitch = (np.pi * float(pixels) / size[1] for pixels in move["turn"])
    return panned(orbited(zoomed(viewpoint, float(move["zoom"])), yaw, pitch), *map(float, move["pan"]))


def _jpeg(picture: UInt8[np.ndarray, "h w 3"]) -> bytes:
    return cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
