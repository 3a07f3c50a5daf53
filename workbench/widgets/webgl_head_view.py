"""The head drawn by the browser (WebGL2). Turning it with the mouse costs the kernel nothing."""

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace

import anywidget
import ipywidgets as widgets
import numpy as np
import traitlets
from jaxtyping import Float, UInt8

from workbench.face.dressed_head import DressedHead
from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.extras import SEGMENT_MM
from workbench.pictures.head_picture import head_painter
from workbench.widgets.browser_program import browser_program
from workbench.widgets.closing import close_all_of
from workbench.widgets.head_mesh import rods_message, surface_message
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
from workbench.widgets.viewpoint import Viewpoint, front_viewpoint
from workbench.widgets.worn_message import person_message

NO_WEBGL_NOTE = "This browser has no WebGL; choose the back end 'pictures' for the 3D view."
NOTHING: dict[str, object] = {}


class WebGLCanvas(anywidget.AnyWidget):
    """The canvas in the browser with everything it draws, so that it shows a head without an answer from the kernel.

    A kernel that runs a cell answers only when it ends: during "Run all", a view that needed an answer would be empty.
    """

    _esm = browser_program("head/webgl.js")
    _size = traitlets.List(traitlets.Int()).tag(sync=True)
    _mesh = traitlets.Dict(help="`surface_message`").tag(sync=True)
    _vertices = traitlets.Bytes(help="float32, head frame, mm").tag(sync=True)
    _person = traitlets.Dict(help="`person_message`, or empty for a plain head").tag(sync=True)
    _colors = traitlets.Bytes(help="RGB of each vertex; empty: the skin").tag(sync=True)
    _points = traitlets.Dict(help="`rods_message`, or empty").tag(sync=True)
    _segments = traitlets.Dict(help="`rods_message`, or empty").tag(sync=True)
    _ghost = traitlets.Dict(help="vertices as above, opacity and outline, or empty").tag(sync=True)
    _viewpoint = traitlets.List(traitlets.Float(), help="`viewpoint_numbers`; the mouse changes it").tag(sync=True)
    _front = traitlets.List(traitlets.Float(), help="the viewpoint after a reset").tag(sync=True)
    _lens = traitlets.List(
        traitlets.Float(), help="focal lengths and principal point of the picture while seen by its camera, or empty"
    ).tag(sync=True)
    _fills = traitlets.Bool(False, help="whether the canvas is as large as its place, not `_size`").tag(sync=True)
    _note = traitlets.Unicode(NO_WEBGL_NOTE).tag(sync=True)
    _missing = traitlets.Bool(False, help="whether WebGL is missing").tag(sync=True)
    _handed: dict[str, object] | None = None
    """What has changed while another widget is to carry it."""

    def __init__(self, **traits: object) -> None:
        self._handing = threading.RLock()
        super().__init__(**traits)

    @contextmanager
    def carried_by(self, carrier: Carrier) -> Iterator[None]:
        """Let another widget's next message carry what is changed within this."""
        with self._handing:
            self._handed = {}
        try:
            yield
        finally:
            with self._handing:
                handed, self._handed = self._handed, None
            if handed:
                carrier.carry(self.model_id, handed)

    def send_state(self, key=None) -> None:
        """Send a part of the state, or let it be carried."""
        with self._handing:
            if self._handed is not None:
                self._handed |= self.get_state(key)
                return
        super().send_state(key)


class WebGLHeadView:
    """A `HeadView` in WebGL. The browser keeps the mesh and the viewpoint; only what changed is sent.

    With `fills` the canvas takes all the place that it is given, and `size` is only what must be in view. Beside a
    photo in a panel, the view "camera" shows the photo's crop and zoom.
    """

    def __init__(
        self, model: FaceModel, size: tuple[int, int], dressed: DressedHead | None = None, fills: bool = False
    ) -> None:
        self._model, self._size, self._dressed = model, size, dressed
        self._lens: list[float] = []
        self._lock = threading.RLock()
        self._shown = Shown(model.neutral.astype(np.float32))
        self._front = viewpoint_numbers(front_viewpoint(model, size))
        self.canvas = WebGLCanvas(
            _size=list(size), _mesh=surface_message(model, dressed), _vertices=_packed(model.neutral),
            _person=self._person(model.neutral), _viewpoint=self._front, _front=self._front, _fills=fills,
            layout=widgets.Layout(width="auto" if fills else f"{size[0]}px", max_width="100%"),
        )  # fmt: skip
        self._legend = Legend(size[0])
        self.widget = widgets.VBox([self.canvas, self._legend], layout=widgets.Layout(overflow="hidden"))

    @property
    def note(self) -> str | None:
        """See `HeadView.note`; the browser reports on WebGL when it first shows the view."""
        return NO_WEBGL_NOTE if self.canvas._missing else None

    def __repr__(self) -> str:
        return f"WebGLHeadView({self._model.name!r}, {self._size[0]} × {self._size[1]})"

    def at_once(self, carrier: Carrier | None = None) -> AbstractContextManager[object]:
        """See `HeadView.at_once`."""
        return self.canvas.hold_sync() if carrier is None else self.canvas.carried_by(carrier)

    def set_vertices(self, vertices: Float[np.ndarray, "v 3"], rest: Float[np.ndarray, "v 3"] | None = None) -> None:
        """See `HeadView.set_vertices`."""
        for points in (vertices,) if rest is None else (vertices, rest):
            check_vertices(points, len(self._model.neutral))
        with self._lock:
            self._shown = replace(self._shown, vertices=vertices.astype(np.float32))
            if rest is not None:
                self._shown = self._shown.with_extras(rest=rest)
                self.canvas._person = self._person(rest)
            self.canvas._vertices = _packed(vertices)

    def set_pose(
        self,
        rotation: Float[np.ndarray, "3"],
        translation: Float[np.ndarray, "3"],
        camera: Camera,
        image_size: tuple[int, int],
    ) -> None:
        """See `HeadView.set_pose`."""
        pose = posed(rotation, translation, camera, image_size, self._size)
        with self._lock:
            self._shown = replace(self._shown, pose=pose)
            self._lens = np.concatenate([camera.focal_px, camera.principal_point_px]).astype(float).tolist()
            self._look_through()
            if self._shown.view == "camera":
                self._look_from(pose)

    def set_view(self, view: str) -> None:
        """See `HeadView.set_view`."""
        check_view(view)
        with self._lock:
            self._shown = replace(self._shown, view=view)
            self._look_through()
            viewpoint = viewpoint_of(self._shown, self._model, self._size)
            if viewpoint is not None:
                self._look_from(viewpoint)

    def set_values(self, values: Float[np.ndarray, "v"] | None, low: Number, high: Number, label: str) -> None:
        """See `HeadView.set_values`."""
        colors = value_colors(values, low, high, len(self._model.neutral))
        with self._lock:
            self._shown = self._shown.with_extras(colors=colors)
            self.canvas._colors = b"" if colors is None else colors.tobytes()
            self._legend.show(None if colors is None else label, low, high)

    def set_points(
        self, points: Float[np.ndarray, "n 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None, size_mm: Number = 2.0
    ) -> None:
        """See `HeadView.set_points`."""
        check_marks(points, colors, (3,), "Points")
        with self._lock:
            self._shown = self._shown.with_extras(points=points, point_colors=colors, point_mm=size_mm)
            some = points is not None and len(points)
            self.canvas._points = rods_message(np.stack([points, points], axis=1), colors, size_mm) if some else NOTHING

    def set_segments(
        self, segments: Float[np.ndarray, "n 2 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None
    ) -> None:
        """See `HeadView.set_segments`."""
        check_marks(segments, colors, (2, 3), "Segments")
        with self._lock:
            self._shown = self._shown.with_extras(segments=segments, segment_colors=colors)
            some = segments is not None and len(segments)
            self.canvas._segments = rods_message(segments, colors, SEGMENT_MM) if some else NOTHING

    def set_ghost(
        self, vertices: Float[np.ndarray, "v 3"] | None, opacity: Number = 0.35, outline: bool = False
    ) -> None:
        """See `HeadView.set_ghost`."""
        check_opacity(opacity)
        if vertices is not None:
            check_vertices(vertices, len(self._model.neutral))
        with self._lock:
            self._shown = self._shown.with_extras(ghost=vertices, ghost_opacity=opacity, ghost_outline=outline)
            given = vertices is not None
            self.canvas._ghost = {"vertices": _packed(vertices), **_shown_as(opacity, outline)} if given else NOTHING

    def snapshot(self) -> UInt8[np.ndarray, "h w 3"]:
        """See `HeadView.snapshot`."""
        with self._lock:
            shown, viewpoint = self._shown, self.viewpoint
        with head_painter(self._model, self._size, fade_neck=True, dressed=self._dressed) as painter:
            return painter.render(shown.vertices.astype(float), viewpoint.camera, *viewpoint.pose, extras=shown.extras)

    @property
    def viewpoint(self) -> Viewpoint:
        """The viewpoint last reported by the browser."""
        numbers = np.array(self.canvas._viewpoint)
        centre = (np.array(self._size, float) - 1) / 2
        return Viewpoint(numbers[0:3], numbers[3:6], numbers[6:9], Camera(numbers[9:11], centre, np.zeros(8)))

    def close(self) -> None:
        """See `HeadView.close`."""
        close_all_of(self)

    def _person(self, rest: Float[np.ndarray, "v 3"]) -> dict[str, object]:
        return NOTHING if self._dressed is None else person_message(self._dressed, rest)

    def _look_through(self) -> None:
        # A reset must not lead to the portrait's viewpoint under the photo's lens, which would have no head in view.
        pose = self._shown.pose if self._shown.view == "camera" else None
        lens, front = ([], self._front) if pose is None else (self._lens, viewpoint_numbers(pose))
        if lens != self.canvas._lens:
            self.canvas._lens = lens
        if front != self.canvas._front:
            self.canvas._front = front

    def _look_from(self, viewpoint: Viewpoint) -> None:
        numbers = viewpoint_numbers(viewpoint)
        if numbers == self.canvas._viewpoint:
            # The mouse may have moved the browser's view, and the report has not arrived yet.
            self.canvas.send_state("_viewpoint")
        else:
            self.canvas._viewpoint = numbers


def viewpoint_numbers(viewpoint: Viewpoint) -> list[float]:
    """Position, target, up (head frame, millimetres) and focal lengths (pixels): eleven numbers."""
    parts = (viewpoint.position, viewpoint.target, viewpoint.up, viewpoint.camera.focal_px)
    return np.concatenate(parts).astype(float).tolist()


def _shown_as(opacity: Number, outline: bool) -> dict[str, object]:
    return {"opacity": float(opacity), "outline": outline}


def _packed(vertices: Float[np.ndarray, "v 3"]) -> bytes:
    return vertices.astype("<f4").tobytes()
