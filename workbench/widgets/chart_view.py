"""A small line chart fast enough to follow a fit: energies over iterations, weights over frames."""

import logging
import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import anywidget
import numpy as np
import traitlets
from jaxtyping import Num

from workbench.errors import InputError
from workbench.session.parts import parts_of
from workbench.widgets.browser_program import browser_program, style_text
from workbench.widgets.overlay_view import float_bytes

Number = float | int
INK = "ink"
"""Placeholder for the colour of the page's text, black or white."""
YELLOW = "#F0E442"
COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", YELLOW, INK)
"""The Okabe–Ito palette, safe for colour-blind readers; its black follows the theme. Further series reuse it with
dashed lines."""
UNMARKED = {"marks": [], "shaded": [], "x_label": "", "y_label": ""}
"""Empty values of everything that a chart shows besides its series."""


def series_colors(count: int) -> list[str]:
    """A colour for each of `count` series."""
    return [COLORS[k % len(COLORS)] for k in range(count)]


def pack_series(
    x: Num[np.ndarray, "..."], series: Mapping[str, Num[np.ndarray, "..."]], colors: Mapping[str, str] | None = None
) -> dict[str, object]:
    """Series as a message: names, colours, and float32 rows, first `x` and then one per series.

    Raises `InputError` if lengths differ or `x` is not ascending.
    """
    x = np.asarray(x, float)
    if x.ndim != 1 or not np.isfinite(x).all() or np.any(np.diff(x) < 0):
        raise InputError("x of a chart must be one row of ascending numbers; sort the series before showing them")
    rows = [x]
    for name, values in series.items():
        if np.shape(values) != x.shape:
            raise InputError(f"series {name!r} has shape {np.shape(values)}, but x has {len(x)} values")
        rows.append(np.asarray(values, float))
    chosen = dict(zip(series, series_colors(len(series)), strict=True)) | dict(colors or {})
    # Values beyond the range of float32 become infinite, which the chart leaves out like NaN.
    with np.errstate(over="ignore"):
        data = float_bytes(np.stack(rows))
    return {"names": list(series), "colors": [chosen[name] for name in series], "count": len(x), "data": data}


def gaps(frames: Iterable[int]) -> list[tuple[float, float]]:
    """Ends of each part that these frames make, half a frame beyond its first and last one, to be shaded."""
    return [(first - 0.5, last + 0.5) for first, last in parts_of(frames)]


class ChartView(anywidget.AnyWidget):
    """Lines over a common x, with a legend to toggle them and a readout under the mouse.

    NaN leaves a gap. With `y_log`, zeros and negative values are drawn on the lower edge. A click calls the `on_pick`
    callbacks with the nearest x and moves `cursor` there. Setters may be called from any thread.
    """

    _esm = browser_program("chart/view.js")
    _css = style_text("chart/view.css")

    title = traitlets.Unicode("").tag(sync=True)
    y_log = traitlets.Bool(False).tag(sync=True)
    height_px = traitlets.Int(180, min=80).tag(sync=True)
    cursor = traitlets.Float(None, allow_none=True, help="x of the vertical line").tag(sync=True)
    hidden = traitlets.List(traitlets.Unicode(), help="names of series that are switched off").tag(sync=True)
    _series = traitlets.Dict().tag(sync=True)

    def __init__(self, height_px: int = 180, y_log: bool = False, title: str = "", **traits: object) -> None:
        self._callbacks: list[Callable[[float], object]] = []
        # Starts with empty series, because a browser may draw the chart before it receives the first change.
        traits["_series"] = pack_series(np.zeros(0), {}) | UNMARKED
        super().__init__(height_px=height_px, y_log=y_log, title=title, **traits)
        self.on_msg(self._on_message)

    def __repr__(self) -> str:
        return f"ChartView({self.title!r}, {len(self._series['names'])} series of {self._series['count']})"

    def set_series(
        self,
        x: Num[np.ndarray, "..."],
        series: Mapping[str, Num[np.ndarray, "..."]],
        *,
        colors: Mapping[str, str] | None = None,
        y_label: str = "",
        x_label: str = "",
        marks: Sequence[tuple[Number, str]] = (),
        cursor: Number | None = None,
        shaded: Sequence[tuple[Number, Number]] = (),
    ) -> None:
        """Show named series over ascending `x`, in the order given.

        `colors` are CSS colours by name (default: `series_colors`); `marks` are vertical lines with a label, such as
        the starts of stages; `shaded` are ranges of x with a darker ground; `cursor` None leaves the line where it is.
        """
        packed = pack_series(x, series, colors)
        packed["marks"] = [[float(place), str(label)] for place, label in marks]
        packed["shaded"] = [[float(first), float(last)] for first, last in shaded]
        packed |= {"x_label": x_label, "y_label": y_label}
        self._series = packed
        if cursor is not None:
            self.cursor = float(cursor)

    def on_pick(self, callback: Callable[[float], object], remove: bool = False) -> None:
        """Call `callback(x)` when the user clicks; `remove` unregisters it."""
        if remove:
            self._callbacks.remove(callback)
        else:
            self._callbacks.append(callback)

    def _on_message(self, _widget: object, content: object, _buffers: object) -> None:
        picked = content.get("pick") if isinstance(content, dict) else None
        if not isinstance(picked, int | float) or isinstance(picked, bool) or not math.isfinite(picked):
            return
        self.cursor = float(picked)
        for callback in tuple(self._callbacks):
            try:
                callback(float(picked))
            except Exception:
                logging.getLogger(__name__).exception("a callback of ChartView failed")
