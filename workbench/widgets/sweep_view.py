"""An objective over one setting as a curve, or over two as a map, that grows while a sweep runs and can be clicked."""

import logging
from collections.abc import Callable
from typing import Any

import anywidget
import numpy as np
import traitlets

from workbench.objectives import TABLE
from workbench.sweeps import Axis, SweepResult
from workbench.sweeps.space import shown
from workbench.widgets.browser_program import browser_program, style_text
from workbench.widgets.overlay_view import float_bytes

NOTHING = {"kind": "", "axes": [], "label": "", "count": 0, "data": b"", "now": None}


class SweepView(anywidget.AnyWidget):
    """A curve with the band that holds half of the frames, or a map; the least is ringed, what is not known yet is left
    out. Hovering tells a value, a click or Enter calls the `on_pick` callback with the number of its point.
    """

    _esm = browser_program("sweep/view.js")
    _css = style_text("sweep/view.css")

    height_px = traitlets.Int(150, min=80).tag(sync=True)
    _sent = traitlets.Dict(NOTHING).tag(sync=True)

    def __init__(self, height_px: int = 150) -> None:
        self._pick: Callable[[int], object] = lambda number: None
        super().__init__(height_px=height_px)
        self.on_msg(self._on_message)

    def __repr__(self) -> str:
        return f"SweepView({self._sent['kind'] or 'nothing'}, {self._sent['count']} points)"

    def show(self, result: SweepResult, objective: str, names: tuple[str, ...], now: float | None = None) -> None:
        """Show an objective of a grid over one or two settings; `names`: what these are called.

        `now` is where the present value lies among those of a curve, counted from 0; None: not among them.
        """
        self._sent = packed(result, objective, names) | {"now": now}

    def mark(self, now: float | None) -> None:
        """Show where the present value lies."""
        if self._sent["now"] != now:
            self._sent = self._sent | {"now": now}

    def on_pick(self, callback: Callable[[int], object]) -> None:
        """Call `callback(number)` when the user chooses a point."""
        self._pick = callback

    def _on_message(self, _widget: object, content: object, _buffers: object) -> None:
        number = content.get("pick") if isinstance(content, dict) else None
        if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < self._sent["count"]:
            return
        try:
            self._pick(number)
        except Exception:
            logging.getLogger(__name__).exception("a callback of SweepView failed")


def packed(result: SweepResult, objective: str, names: tuple[str, ...]) -> dict[str, Any]:
    """What is drawn, as a message: axes, and float32 rows of means and both quartiles, NaN where nothing is known."""
    rows = np.stack([result.means(objective), *result.bands(objective).T])
    row = TABLE[objective]
    return {
        "kind": "curve" if len(result.axes) == 1 else "map",
        "axes": [_axis(axis, name) for axis, name in zip(result.axes, names, strict=True)],
        "label": row.name,
        "unit": row.unit,
        "count": len(result.points),
        "data": float_bytes(rows),
        "now": None,
    }


def _axis(axis: Axis, name: str) -> dict[str, Any]:
    return {"name": name, "values": [shown(value) for value in axis.values]}
