"""The frame with its landmarks: coloured residuals, hovering, selecting, and moving detections by hand."""

import logging
import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import anywidget
import numpy as np
import traitlets
from jaxtyping import Float, Num, Shaped, UInt8

from workbench.errors import InputError
from workbench.landmarks.scheme import IBUG68, LandmarkScheme
from workbench.landmarks.schemes import scheme_of_count
from workbench.widgets.browser_program import browser_program, style_text
from workbench.widgets.encoded_pictures import layer_bytes, picture_bytes
from workbench.widgets.head_view import scale_colors
from workbench.widgets.status_line import error_text

SMALLEST_SCALE = 0.5
"""Smallest end of the automatic colour scale, so that a good fit does not look like a bad one."""
CALM_STEPS = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Automatic scales end at one of these values times a power of ten, so that they rarely change between frames."""
TOOLS = ("select", "lasso", "move")
KINDS = ("select", "lasso", "mute", "weight_up", "weight_down", "drag", "drop", "cancel", "reset")
LAYERS: Mapping[str, bool] = {
    "observed": True,
    "model": True,
    "residuals": True,
    "lines": False,
    "labels": False,
    "wire": True,
    "layer": True,
    "heat": True,
    "arrows": False,
    "ellipses": False,
    "bright": False,
}
"""Layers shown initially; the wireframe and the picture layers appear when they are set."""
FINE_GROUPS = (
    *("jaw", "right_brow", "left_brow", "nose_bridge", "nose_base"),
    *("right_eye", "left_eye", "outer_lips", "inner_lips"),
)
COARSE_GROUPS = ("brows", "nose", "eyes", "mouth", "irises", "pupils", "ears", "face")
"""Those of points that no finer group has; of the fine ones none overlap."""


@dataclass(frozen=True)
class OverlayEvent:
    """A user action in an `OverlayView`; `points` are landmark indices, `x` and `y` picture pixels.

    "select" and "lasso" carry the new selection; "mute" (toggle), "weight_up" (double), "weight_down" (halve) and
    "reset" (back to the detected position) carry the selection they apply to; "drag" (while the mouse moves) and
    "drop" (at its end, or after an arrow key) carry one landmark and its new position; "cancel" (a drag that was left)
    carries one landmark and where it was grabbed.
    """

    kind: str
    points: tuple[int, ...]
    x: float | None
    y: float | None


def automatic_scale(values: Num[np.ndarray, "..."]) -> float:
    """Upper end of a colour scale: the 95th percentile of the finite values, rounded up to one of `CALM_STEPS`."""
    finite = values[np.isfinite(values)]
    wanted = max(float(np.percentile(finite, 95)), SMALLEST_SCALE) if finite.size else SMALLEST_SCALE
    decade = 10.0 ** math.floor(math.log10(wanted))
    return next(step * decade for step in CALM_STEPS if step * decade >= wanted * (1 - 1e-9))


def color_table() -> UInt8[np.ndarray, "256 3"]:
    """The colours of residuals from 0 to the end of the scale: viridis as on heads, without its darkest steps."""
    return scale_colors()


def point_groups(scheme: LandmarkScheme = IBUG68) -> list[str]:
    """The name of each landmark's smallest group, with spaces."""
    known = [group for group in (*COARSE_GROUPS, *FINE_GROUPS) if group in scheme.groups]
    names = {index: group.replace("_", " ") for group in known for index in scheme.groups[group]}
    return [names[index] for index in range(len(scheme))]


def float_bytes(values: Num[np.ndarray, "..."]) -> bytes:
    """Little-endian float32, row by row, as a browser reads them."""
    return np.ascontiguousarray(values, "<f4").tobytes()


def fit_table(
    observed: Num[np.ndarray, "..."],
    projected: Num[np.ndarray, "..."] | None,
    values: Num[np.ndarray, "..."] | None,
    confidence: Num[np.ndarray, "..."] | None,
    weights: Num[np.ndarray, "..."] | None,
) -> Float[np.ndarray, "points 8"]:
    """One row per landmark: observed x, y; model x, y; value shown; distance, px; confidence; weight.

    Points are (points, 2), px, the others (points,). Without a model its columns are NaN; values default to the
    distances, confidence and weights to 1. Raises `InputError` for another number of landmarks.
    """
    observed = _checked_points(observed)
    count = len(observed)
    projected = np.full((count, 2), np.nan) if projected is None else _checked_points(projected)
    distance = np.linalg.norm(projected - observed, axis=1)
    columns = [
        _per_point("residuals", values, distance),
        distance,
        _per_point("confidences", confidence, np.ones(count)),
        _per_point("weights", weights, np.ones(count)),
    ]
    return np.column_stack([observed, projected, *columns])


def read_event(content: object, count: int = len(IBUG68)) -> OverlayEvent | None:
    """The event in a message from a browser about this many landmarks; None if it is not one."""
    if not isinstance(content, dict) or content.get("kind") not in KINDS:
        return None
    points, place = content.get("points"), (content.get("x"), content.get("y"))
    if not isinstance(points, list) or not all(type(i) is int and 0 <= i < count for i in points):
        return None
    if not all(value is None or (isinstance(value, int | float) and math.isfinite(value)) for value in place):
        return None
    if content["kind"] in ("drag", "drop", "cancel") and (len(points) != 1 or None in place):
        return None
    x, y = (None if value is None else float(value) for value in place)
    return OverlayEvent(content["kind"], tuple(points), x, y)


class OverlayView(anywidget.AnyWidget):
    """A picture with landmarks over it, to inspect and edit.

    Hovering, zooming and dragging are handled in the browser. User actions are reported to the callbacks of
    `on_event`. Setters may be called from any thread; they do not keep the arrays passed in.
    """

    _esm = browser_program("overlay/view.js")
    _css = style_text("overlay/view.css")

    layers = traitlets.Dict(key_trait=traitlets.Enum(tuple(LAYERS)), value_trait=traitlets.Bool()).tag(sync=True)
    layer_opacity = traitlets.Float(0.6, min=0.0, max=1.0).tag(sync=True)
    scale_max = traitlets.Float(0.0, min=0.0, help="end of the colour scale; 0: automatic").tag(sync=True)
    unit = traitlets.Unicode("px", help="unit of the residuals").tag(sync=True)
    selection = traitlets.List(traitlets.Int(min=0)).tag(sync=True)
    subset = traitlets.List(traitlets.Int(min=0)).tag(sync=True)
    tool = traitlets.Enum(TOOLS, "select").tag(sync=True)
    message = traitlets.Unicode("", help="message over the picture").tag(sync=True)
    webgl = traitlets.Bool(None, allow_none=True, help="WebGL2 in the browser; None until shown").tag(sync=True)
    height_px = traitlets.Int(420, min=0, help="0: as high as its place").tag(sync=True)
    at_face = traitlets.Bool(False, help="start zoomed to the face, not the whole picture").tag(sync=True)
    _picture = traitlets.Bytes(b"").tag(sync=True)
    _size = traitlets.List(traitlets.Int(), [0, 0]).tag(sync=True)
    _layer = traitlets.Bytes(b"").tag(sync=True)
    _heat = traitlets.Bytes(b"").tag(sync=True)
    _wire = traitlets.Bytes(b"").tag(sync=True)
    _ellipses = traitlets.Bytes(b"").tag(sync=True)
    _fit = traitlets.Bytes(b"").tag(sync=True)
    _no_face = traitlets.Bool(False).tag(sync=True)
    # Counts the fits: one equal to the last must still reach a browser in which a landmark has been moved.
    _fits = traitlets.Int(0).tag(sync=True)
    _scale = traitlets.Float(SMALLEST_SCALE).tag(sync=True)
    _scheme = traitlets.Dict().tag(sync=True)
    _carried = traitlets.Dict(help="`to`: the model of another widget, `state`: what has changed in it").tag(sync=True)

    def __init__(self, height_px: int = 420, scheme: LandmarkScheme = IBUG68, **traits: object) -> None:
        self._lock = threading.RLock()
        self._callbacks: list[Callable[[OverlayEvent], object]] = []
        self._failed = False
        self._shown: np.ndarray | None = None
        self._automatic: float | None = None
        self._rows: Float[np.ndarray, "points 8"] | None = None
        told = {"names": list(scheme.point_names), "groups": point_groups(scheme)}
        told |= {"lines": [list(line) for line in scheme.polylines], "colors": color_table().tobytes()}
        traits["layers"] = {**LAYERS, **traits.get("layers", {})}
        super().__init__(height_px=height_px, _scheme=told, **traits)
        self.on_msg(self._on_message)
        self.observe(self._on_scale, "scale_max")

    def __repr__(self) -> str:
        return f"OverlayView({self._size[0]} × {self._size[1]}, {'no face' if self._rows is None else 'face'})"

    @property
    def muted(self) -> tuple[int, ...]:
        """Landmarks with weight zero, drawn hollow, grey and crossed out."""
        rows = self._rows
        return () if rows is None else tuple(np.flatnonzero(rows[:, 7] == 0).tolist())

    @property
    def scale(self) -> float:
        """Residual at the bright end of the colours, in `unit`."""
        return self._scale

    def carry(self, to: str, state: dict[str, object]) -> None:
        """Take along what has changed in another widget (`model_id`), so that both are drawn together."""
        self._carried = {"to": to, "state": state}

    def set_picture(self, rgb: Shaped[np.ndarray, "..."]) -> None:
        """Show an RGB picture, uint8 (h, w, 3); setting the same array object again sends nothing."""
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8:
            raise InputError(f"a picture must be uint8 of shape (h, w, 3); got {rgb.dtype} of shape {rgb.shape}")
        with self._lock:
            if rgb is self._shown:
                return
            encoded = picture_bytes(rgb)
            with self.hold_sync():
                self._picture = encoded
                self._size = [rgb.shape[1], rgb.shape[0]]
            self._shown = rgb

    def set_fit(
        self,
        observed: Num[np.ndarray, "..."] | None,
        projected: Num[np.ndarray, "..."] | None = None,
        values: Num[np.ndarray, "..."] | None = None,
        confidence: Num[np.ndarray, "..."] | None = None,
        weights: Num[np.ndarray, "..."] | None = None,
    ) -> None:
        """Show detections and model landmarks, (points, 2) px, residuals (points,) in `unit`, confidence and weights.

        `observed` None means no face, and a message over the picture says so. The other defaults are those of
        `fit_table`. Raises `InputError` for another number of landmarks.
        """
        rows = None if observed is None else fit_table(observed, projected, values, confidence, weights)
        with self._lock:
            self._rows = rows
            with self.hold_sync():
                self._no_face = rows is None
                self._fit = b"" if rows is None else float_bytes(rows)
                self._scale = self._chosen_scale()
                self._fits += 1

    def set_layer(self, rgba: Shaped[np.ndarray, "..."] | None) -> None:
        """Lay a transparent picture, uint8 (h, w, 4), of any resolution over the whole photo; None removes it."""
        encoded = layer_bytes(rgba)
        with self._lock:
            self._layer = encoded

    def set_heat(self, rgba: Shaped[np.ndarray, "..."] | None) -> None:
        """Like `set_layer`, for a second layer above the first, made by `pictures.heat_layer`; always opaque."""
        encoded = layer_bytes(rgba)
        with self._lock:
            self._heat = encoded

    def set_wire(self, segments: Num[np.ndarray, "..."] | None) -> None:
        """Draw line segments, (n, 2, 2): start and end, px; None removes them. Non-finite segments are left out."""
        if segments is None:
            segments = np.empty((0, 2, 2))
        if segments.ndim != 3 or segments.shape[1:] != (2, 2):
            raise InputError(f"segments must have shape (n, 2, 2); got shape {segments.shape}")
        encoded = float_bytes(segments[np.isfinite(segments).all(axis=(1, 2))])
        with self._lock:
            self._wire = encoded

    def set_ellipses(self, corners: Num[np.ndarray, "..."] | None) -> None:
        """Draw a closed line around each landmark, (points, corners, 2) px; None removes them."""
        if corners is not None and (corners.ndim != 3 or corners.shape[2] != 2):
            raise InputError(f"ellipses must have shape (points, corners, 2); got shape {corners.shape}")
        encoded = b"" if corners is None else float_bytes(corners)
        with self._lock:
            self._ellipses = encoded

    def on_event(self, callback: Callable[[OverlayEvent], object], remove: bool = False) -> None:
        """Call `callback(event)` for every user action; `remove` unregisters it."""
        if remove:
            self._callbacks.remove(callback)
        else:
            self._callbacks.append(callback)

    @traitlets.validate("selection", "subset")
    def _of_the_scheme(self, proposal) -> list[int]:
        count = len(self._scheme["names"])
        if max(proposal["value"], default=0) >= count:
            raise traitlets.TraitError(f"landmarks are numbered from 0 to {count - 1}; got {max(proposal['value'])}")
        return proposal["value"]

    def _chosen_scale(self) -> float:
        if self.scale_max > 0:
            return self.scale_max
        if self._rows is None:
            return self._scale
        return self._automatic or automatic_scale(self._rows[self._rows[:, 7] != 0, 4])

    def scale_with(self, automatic: float | None) -> None:
        """End automatic scales here, as the strip of a clip does; None: by the residuals of the picture."""
        with self._lock:
            self._automatic = automatic
            self._scale = self._chosen_scale()

    def _on_scale(self, _change: object) -> None:
        with self._lock:
            self._scale = self._chosen_scale()

    def _on_message(self, _widget: object, content: object, _buffers: object) -> None:
        event = read_event(content, len(self._scheme["names"]))
        if event is None:
            return
        if self._failed:
            self._failed, self.message = False, ""
        if event.kind in ("select", "lasso"):
            self.selection = list(event.points)
        for callback in tuple(self._callbacks):
            try:
                callback(event)
            except Exception as error:
                # The user sees the error where they clicked, and the widget continues.
                self._failed = True
                self.message = error_text(error)
                logging.getLogger(__name__).debug("callback of OverlayView failed", exc_info=True)


def _checked_points(points: Num[np.ndarray, "..."]) -> Float[np.ndarray, "points 2"]:
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"landmarks are an array of shape (points, 2), x and y in pixels; got shape {points.shape}")
    scheme_of_count(len(points))
    return points


def _per_point(what: str, given: Num[np.ndarray, "..."] | None, otherwise: Float[np.ndarray, "points"]) -> np.ndarray:
    if given is None:
        return otherwise
    if np.shape(given) != np.shape(otherwise):
        count = len(otherwise)
        raise InputError(f"{what} must be one number for each of the {count} landmarks; got shape {np.shape(given)}")
    return np.asarray(given, float)
