"""One knob of a configuration as a widget: a slider with its number below, a box, or a menu."""

import html
import math
from collections.abc import Callable

import ipywidgets as widgets

from workbench.session.knobs import Knob, Value
from workbench.widgets.kernel_comms import after_message

Turned = Callable[[str, Value], None]
"""Called with the path of a knob and its new value."""
STEPS_PER_DECADE = 20
LABEL_PX = 66
NUMBERS = ("log", "linear", "whole")
"""Kinds of knobs with a slider and a number."""
KNOB, CHANGED = "fw-knob", "fw-changed"
NUMBER_S = 0.05
"""A slider's number follows it after this time, in a drag once in this time: a browser that lays it out in the frame of
what follows from the slider shows both later."""


class KnobControl:
    """One knob as a widget. Setting it from a configuration does not call back.

    The start's value is marked on the slider; the browser resets to it on a double click. `KNOB` and `KNOB--path` are
    classes of the widget, and `CHANGED` while it shows another value than the start's.
    """

    def __init__(self, knob: Knob, turned: Turned) -> None:
        self.knob, self._turned, self._quiet, self._late = knob, turned, False, False
        self.value: Value | None = None
        self.start: Value | None = None
        self._mark = ""
        self.input = _input(knob)
        self.readout = widgets.Text(
            continuous_update=False,
            tooltip=f"{knob.label}: type a number",
            layout=widgets.Layout(width="68px", flex="0 0 auto"),
        )  # fmt: skip
        self.name = widgets.HTML(
            f"<span title='{html.escape(knob.help, quote=True)}'>{html.escape(knob.words.name)}</span>",
            layout=widgets.Layout(flex="1 1 auto", min_width="0"),
        )
        self.effective = widgets.Label(
            layout=widgets.Layout(width="auto", flex="0 0 auto"), tooltip="product down its branch of ω"
        )
        self.input.observe(self._on_input, "value")
        self.readout.observe(self._on_typed, "value")
        below = [self.name, self.effective, self.readout] if knob.kind in NUMBERS else [self.name]
        line = widgets.HBox(below, layout=widgets.Layout(align_items="center"))
        line.add_class("fw-below")
        self.widget = widgets.VBox([self.input, line], layout=widgets.Layout(flex="0 0 auto", width="auto"))
        for name in (KNOB, f"{KNOB}--{knob.path}", f"fw-level-{knob.level}"):
            self.widget.add_class(name)

    def show(self, value: Value) -> None:
        """Show a value without calling back."""
        self.value, self._quiet = value, True
        try:
            if self.knob.kind == "choice" and value not in self.input.options:  # the path of a weights file
                self.input.options = (*self.knob.choices, value)
            self.input.value = place_of(self.knob, value)
            self._read_out(value)
        finally:
            self._quiet = False
        self._show_changed()

    def begin_at(self, start: Value) -> None:
        """Mark the value that it had at the start."""
        self.start = start
        if self.knob.kind in NUMBERS:
            share = (place_of(self.knob, start) - self.input.min) / (self.input.max - self.input.min)
            self.widget.remove_class(self._mark)
            self._mark = f"fw-at-{round(100 * share)}"
            self.widget.add_class(self._mark)
            self.readout.tooltip = f"{self.knob.label}: type a number; at the start {start:.4g}"
        self._show_changed()

    def enable(self, on: bool) -> None:
        """Enable it, or grey it out."""
        self.input.disabled = self.readout.disabled = not on

    def turn(self, value: Value) -> None:
        """Set a value as if the user had typed it."""
        self.show(value)
        self._turned(self.knob.path, value)

    def reset(self) -> None:
        """Go back to the start's value."""
        if self.start is not None and not self.input.disabled and self.value != self.start:
            self.turn(self.start)

    def _show_changed(self) -> None:
        changed = self.start is not None and self.value != self.start
        (self.widget.add_class if changed else self.widget.remove_class)(CHANGED)

    def _read_out(self, value: Value) -> None:
        if self.knob.kind in NUMBERS:
            quiet, self._quiet = self._quiet, True
            self.readout.value = f"{value:.4g}"
            self._quiet = quiet

    def _on_input(self, change) -> None:
        # A value between two slider positions is kept until the slider moves. Browsers return a position with
        # different last digits.
        if self._quiet or (self.value is not None and _same(change["new"], place_of(self.knob, self.value))):
            return
        self.value = value_at(self.knob, change["new"])
        self._turned(self.knob.path, self.value)
        if not self._late:
            self._late = True
            after_message(self._follow, NUMBER_S)

    def _follow(self) -> None:
        """Show the slider's number."""
        self._late = False
        self._read_out(self.value)
        self._show_changed()

    def _on_typed(self, change) -> None:
        if self._quiet:
            return
        try:
            value = float(change["new"].replace(",", "."))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            if self.value is not None:
                self._read_out(self.value)
            return
        self.turn(round(value) if self.knob.kind == "whole" else value)


def value_at(knob: Knob, place: Value) -> Value:
    """The value at a slider position; the lowest position of a logarithmic slider is zero."""
    if knob.kind != "log":
        return place
    if place <= _lowest(knob) + 1e-9:
        return 0.0
    return float(f"{10.0**place:.3g}")


def place_of(knob: Knob, value: Value) -> Value:
    """The slider position for a value, rounded to the nearest step as the browser would do."""
    if knob.kind in ("switch", "choice"):
        return value
    if knob.kind == "whole":
        return int(min(max(value, knob.low), knob.high))
    low, high, step = knob.low, knob.high, knob.step
    if knob.kind == "log":
        low, high, step = _lowest(knob), math.log10(knob.high), 1.0 / STEPS_PER_DECADE
        value = math.log10(value) if value > 0.0 else low
    place = round(low + round((min(max(value, low), high) - low) / step) * step, 9)
    return float(min(max(place, low), high))


def _same(place: Value, other: Value) -> bool:
    if isinstance(place, str) or isinstance(other, str):
        return place == other
    return math.isclose(place, other, abs_tol=1e-6)


def _lowest(knob: Knob) -> float:
    """Position of zero: one step below the smallest value."""
    return round(math.log10(knob.low) - 1.0 / STEPS_PER_DECADE, 9)


def _input(knob: Knob) -> widgets.Widget:
    common = {
        "description": knob.label,
        "tooltip": knob.help,
        "style": {"description_width": f"{LABEL_PX}px" if len(knob.label) < 10 else "initial"},
        "layout": widgets.Layout(width="auto", flex="1 1 auto", min_width="0"),
    }
    if knob.kind == "log":
        low, high = _lowest(knob), math.log10(knob.high)
        return widgets.FloatSlider(low, min=low, max=high, step=1.0 / STEPS_PER_DECADE, readout=False, **common)
    if knob.kind == "linear":
        return widgets.FloatSlider(knob.low, min=knob.low, max=knob.high, step=knob.step, readout=False, **common)
    if knob.kind == "whole":
        return widgets.IntSlider(int(knob.low), min=int(knob.low), max=int(knob.high), readout=False, **common)
    if knob.kind == "switch":
        return widgets.Checkbox(False, indent=False, **common)
    return widgets.Dropdown(options=knob.choices, **common)
