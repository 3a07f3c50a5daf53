"""The head drawn by the browser: k3d (WebGL). Turning it with the mouse costs the kernel nothing."""

import threading
from dataclasses import replace

import anywidget
import cv2
import ipywidgets as widgets
import k3d
import numpy as np
import traitlets
from jaxtyping import Float, Integer, UInt8

from workbench.face.model import FaceModel
from workbench.geometry import Camera
from workbench.pictures.background import SLATE
from workbench.pictures.extras import GHOST_COLOR, SEGMENT_MM, outer_triangles
from workbench.pictures.head_picture import bundled_texture, head_painter
from workbench.pictures.mesh import neck_opacity, split_seams
from workbench.widgets.browser_program import browser_program
from workbench.widgets.head_view import (
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
from workbench.widgets.k3d_plot import ReadyPlot
from workbench.widgets.viewpoint import Viewpoint, front_viewpoint

WORLD = np.array([1.0, -1.0, -1.0])
"""WebGL's world has y up and z towards the viewer, the head frame y down and z away: half a turn about x."""
MATRIX = np.diag([*WORLD, 1.0]).astype(np.float32)
GRID_MM = 20_000.0
"""Half width of the box from which k3d takes its clipping planes: the near one lies 7 mm before the camera. So a plain
depth buffer resolves a hundredth of a millimetre; the logarithmic one is slower and leaks with anti-aliasing."""
ANTIALIAS = 1
"""Level of k3d: two samples a pixel. Four cost a browser without a GPU a third more time a frame."""
LIGHTING, ROUGHNESS = 1.5, 0.6
COLLAR_TILT, COLLAR_MM = 0.25, 600.0
"""The neck is cut by a plane that falls towards the front, just above the ragged rim of the mesh. The opacity that
marks it goes from 0 to 1 over a length of more than a head: linear in every triangle, it makes the cut straight."""
JPEG_QUALITY = 90
NO_WEBGL_NOTE = "This browser shows no WebGL; choose the back end 'pictures' for the 3D view."


class WebGLProbe(anywidget.AnyWidget):
    """Nothing to see, unless the browser lacks WebGL."""

    _esm = browser_program("head/probe.js")
    _note = traitlets.Unicode(NO_WEBGL_NOTE).tag(sync=True)
    _missing = traitlets.Bool(False).tag(sync=True)


class K3dHeadView:
    """A `HeadView` in WebGL. The browser keeps the mesh and the camera; only what changed is sent."""

    def __init__(self, model: FaceModel, size: tuple[int, int]) -> None:
        self._model, self._size = model, size
        self._lock = threading.RLock()
        self._shown = Shown(model.neutral.astype(np.float32))
        viewpoint = front_viewpoint(model, size)
        self._probe = WebGLProbe()  # before k3d's program keeps the browser busy
        self.plot = ReadyPlot(
            height=size[1], antialias=ANTIALIAS, logarithmic_depth_buffer=False, lighting=LIGHTING,
            background_color=_packed(np.array([SLATE]))[0].item(),
            menu_visibility=False, grid_visible=False, grid_auto_fit=False, camera_auto_fit=False, axes_helper=0,
            grid=(-GRID_MM, -GRID_MM, -GRID_MM, GRID_MM, GRID_MM, GRID_MM), camera_mode="orbit", camera_up_axis="none",
            camera_rotate_speed=0.5,  # half a turn for the height of the view
            camera_fov=viewpoint.vertical_fov_deg(size[1]), camera=_camera_array(viewpoint),
        )  # fmt: skip
        self.plot.layout = widgets.Layout(width=f"{size[0]}px", max_width="100%", height=f"{size[1]}px")
        self.plot.add_class("fw-head3d")
        self._opacities = collar_opacity(model)
        self._textured, self._order = _textured_mesh(model, self._opacities)
        self._colored = self._ghost = self._points = self._segments = None
        if self._textured is None:
            self._colored = self._colored_mesh(model.colors)
        self.plot += self.mesh
        self._legend = Legend(size[0])
        self.widget = widgets.VBox([self.plot, self._probe, self._legend], layout=widgets.Layout(overflow="hidden"))

    @property
    def note(self) -> str | None:
        """See `HeadView.note`; the browser tells about WebGL when it first shows the view."""
        return NO_WEBGL_NOTE if self._probe._missing else None

    @property
    def mesh(self) -> k3d.objects.Mesh:
        """The mesh that is seen: with the texture, or, for values and models without one, with vertex colours."""
        textured = self._textured is not None and self._shown.extras.colors is None
        return self._textured if textured else self._colored

    def __repr__(self) -> str:
        return f"K3dHeadView({self._model.name!r}, {self._size[0]} × {self._size[1]})"

    def set_vertices(self, vertices: Float[np.ndarray, "v 3"]) -> None:
        """See `HeadView.set_vertices`."""
        check_vertices(vertices, len(self._model.neutral))
        with self._lock:
            self._shown = replace(self._shown, vertices=vertices.astype(np.float32))
            _update(self.mesh, {"vertices": self._vertices_of(self.mesh)})

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
            if self._shown.view == "camera":
                self._look_from(pose)

    def set_view(self, view: str) -> None:
        """See `HeadView.set_view`."""
        check_view(view)
        with self._lock:
            self._shown = replace(self._shown, view=view)
            viewpoint = viewpoint_of(self._shown, self._model, self._size)
            if viewpoint is not None:
                self._look_from(viewpoint)

    def set_values(self, values: Float[np.ndarray, "v"] | None, low: Number, high: Number, label: str) -> None:
        """See `HeadView.set_values`."""
        colors = value_colors(values, low, high, len(self._model.neutral))
        with self._lock:
            before = self.mesh
            self._shown = self._shown.with_extras(colors=colors)
            if colors is not None and self._colored is None:
                self._colored = self._colored_mesh(colors)
                self.plot += self._colored
            shown = {"vertices": self._vertices_of(self.mesh)}
            if self.mesh is self._colored:
                shown["colors"] = _packed(self._model.colors if colors is None else colors)
            _update(self.mesh, shown)
            if before is not self.mesh:
                before.visible = False
            self._legend.show(None if colors is None else label, low, high)

    def set_points(
        self, points: Float[np.ndarray, "n 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None, size_mm: Number = 2.0
    ) -> None:
        """See `HeadView.set_points`."""
        check_marks(points, colors, (3,), "Points")
        with self._lock:
            self._shown = self._shown.with_extras(points=points, point_colors=colors, point_mm=size_mm)
            if points is None or not len(points):
                _hide(self._points)
                return
            state = {"positions": points.astype(np.float32), "colors": _packed(colors), "point_size": float(size_mm)}
            if self._points is None:
                self._points = k3d.points(**state, shader="3d", model_matrix=MATRIX)
                self.plot += self._points
            else:
                _update(self._points, state)

    def set_segments(
        self, segments: Float[np.ndarray, "n 2 3"] | None, colors: UInt8[np.ndarray, "_ 3"] | None
    ) -> None:
        """See `HeadView.set_segments`."""
        check_marks(segments, colors, (2, 3), "Segments")
        with self._lock:
            self._shown = self._shown.with_extras(segments=segments, segment_colors=colors)
            if segments is None or not len(segments):
                _hide(self._segments)
                return
            ends = np.arange(2 * len(segments), dtype=np.uint32).reshape(-1, 2)
            packed = np.repeat(_packed(colors), 2)
            state = {"vertices": segments.astype(np.float32).reshape(-1, 3), "indices": ends, "colors": packed}
            if self._segments is None:
                self._segments = k3d.lines(
                    **state, indices_type="segment", shader="mesh", width=SEGMENT_MM / 2, model_matrix=MATRIX
                )
                self.plot += self._segments
            else:
                _update(self._segments, state)

    def set_ghost(self, vertices: Float[np.ndarray, "v 3"] | None, opacity: Number = 0.35) -> None:
        """See `HeadView.set_ghost`."""
        check_opacity(opacity)
        if vertices is not None:
            check_vertices(vertices, len(self._model.neutral))
        with self._lock:
            self._shown = self._shown.with_extras(ghost=vertices, ghost_opacity=opacity)
            if vertices is None:
                _hide(self._ghost)
                return
            state = {"vertices": vertices.astype(np.float32), "opacity": float(opacity)}
            if self._ghost is None:
                color = _packed(np.array([GHOST_COLOR]))[0].item()
                self._ghost = _mesh(
                    **state, triangles=outer_triangles(self._model), color=color, **_cut_off(self._opacities)
                )
                self.plot += self._ghost
            else:
                _update(self._ghost, state)

    def snapshot(self) -> UInt8[np.ndarray, "h w 3"]:
        """See `HeadView.snapshot`."""
        with self._lock:
            shown, viewpoint = self._shown, self.viewpoint
        with head_painter(self._model, self._size, fade_neck=True) as painter:
            return painter.render(shown.vertices.astype(float), viewpoint.camera, *viewpoint.pose, extras=shown.extras)

    @property
    def viewpoint(self) -> Viewpoint:
        """From where the browser looks, as far as it has told."""
        position, target, up = np.reshape(self.plot.camera, (3, 3)) * WORLD
        width, height = self._size
        focal = 0.5 * height / np.tan(0.5 * np.radians(self.plot.camera_fov))
        centre = np.array([(width - 1) / 2, (height - 1) / 2])
        return Viewpoint(position, target, up, Camera(np.full(2, focal), centre, np.zeros(8)))

    def close(self) -> None:
        """See `HeadView.close`."""
        meshes = (self._textured, self._colored, self._ghost, self._points, self._segments)
        for part in (*meshes, self.plot, self._probe, self._legend, self.widget):
            if part is not None:
                widgets.Widget.close(part)

    def _vertices_of(self, mesh: k3d.objects.Mesh) -> Float[np.ndarray, "n 3"]:
        vertices = self._shown.vertices
        return vertices[self._order] if mesh is self._textured else vertices

    def _colored_mesh(self, colors: UInt8[np.ndarray, "v 3"]) -> k3d.objects.Mesh:
        return _mesh(
            self._shown.vertices, self._model.triangles, colors=_packed(colors), side="double",
            **_cut_off(self._opacities),
        )  # fmt: skip

    def _look_from(self, viewpoint: Viewpoint) -> None:
        fov, camera = viewpoint.vertical_fov_deg(self._size[1]), _camera_array(viewpoint)
        if fov != self.plot.camera_fov:
            self.plot.camera_fov = fov
        if camera == list(self.plot.camera):
            # The mouse may have moved the browser's camera without telling yet.
            self.plot.send_state("camera")
        else:
            self.plot.camera = camera


def _camera_array(viewpoint: Viewpoint) -> list[float]:
    """k3d's nine numbers: position, target, up."""
    return (np.stack([viewpoint.position, viewpoint.target, viewpoint.up]) * WORLD).ravel().tolist()


def collar_opacity(model: FaceModel) -> Float[np.ndarray, "v"]:
    """More than 0.5 above the plane that cuts the neck off and less below it; 1 for a head without a rim."""
    height = model.neutral[:, 1] + COLLAR_TILT * model.neutral[:, 2]
    rim = neck_opacity(model) == 0.0
    if not rim.any():
        return np.ones(len(model.neutral))
    return np.clip(0.5 + (height[rim].min() - 1.0 - height) / COLLAR_MM, 0.0, 1.0)


def _textured_mesh(
    model: FaceModel, opacities: Float[np.ndarray, "v"]
) -> tuple[k3d.objects.Mesh | None, Integer[np.ndarray, "n"]]:
    """The mesh with its texture, and the vertex of each point: all vertices, then the doubles along UV seams."""
    picture = bundled_texture(model)
    if picture is None:
        return None, np.arange(len(model.neutral))
    vertex, uv, triangles = split_seams(model.triangles, model.triangles_uv)
    first = np.zeros(len(vertex), bool)
    first[np.unique(vertex, return_index=True)[1]] = True
    order = np.lexsort([vertex, ~first])
    rank = np.argsort(order)
    encoded = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    mesh = _mesh(
        model.neutral[vertex[order]].astype(np.float32), rank[triangles], texture=encoded, texture_file_format="jpeg",
        uvs=(model.uv[uv[order]] * [1.0, -1.0] + [0.0, 1.0]).astype(np.float32), side="double",
        **_cut_off(opacities[vertex[order]]),
    )  # fmt: skip
    return mesh, vertex[order]


def _cut_off(opacities: Float[np.ndarray, "n"]) -> dict:
    return {"alpha_mode": "mask", "alpha_cutoff": 0.5, "opacities": opacities.astype(np.float32)}


def _mesh(vertices: np.ndarray, triangles: np.ndarray, **state: object) -> k3d.objects.Mesh:
    return k3d.mesh(
        vertices, triangles.astype(np.uint32), flat_shading=False, roughness=ROUGHNESS, model_matrix=MATRIX, **state
    )


def _packed(colors: np.ndarray) -> np.ndarray:
    """0xRRGGBB of each RGB row."""
    red, green, blue = colors.astype(np.uint32).T
    return (red << 16) | (green << 8) | blue


def _update(part: k3d.objects.Drawable, state: dict) -> None:
    """Show it with this state; what differs goes in one message. Array traits do not notice equal values themselves."""
    with part.hold_sync():
        for name, value in state.items():
            if not np.array_equal(getattr(part, name), value):
                setattr(part, name, value)
        part.visible = True


def _hide(part: k3d.objects.Drawable | None) -> None:
    if part is not None:
        part.visible = False
