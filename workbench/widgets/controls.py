"""Controls for the knobs of a configuration: sliders, boxes and menus that call back with a path and a value."""

import math
from collections.abc import Callable, Mapping, Sequence

import ipywidgets as widgets

from workbench.config import Config
from workbench.session.knobs import (
    CAMERA,
    CONSTANTS,
    DEEP,
    IDENTITY,
    LANDMARKS,
    OMEGA,
    SOLVE,
    Knob,
    Value,
    is_inert,
    value_of,
)
from workbench.session.knobs import effective_weights as effective_weights_of

Turned = Callable[[str, Value], None]
"""Called with the path of a knob and its new value."""
STEPS_PER_DECADE = 20
LABEL_PX = 72


class KnobControl:
    """One knob as a widget. Setting it from a configuration does not call back."""

    def __init__(self, knob: Knob, turned: Turned) -> None:
        self.knob, self._turned, self._quiet = knob, turned, False
        self.value: Value | None = None
        self.input = _input(knob)
        self.readout = widgets.Text(
            continuous_update=False,
            tooltip=f"{knob.label}: type a number",
            layout=widgets.Layout(width="50px", flex="0 0 auto"),
        )  # fmt: skip
        self.effective = widgets.Label(
            layout=widgets.Layout(width="40px", flex="0 0 auto"), tooltip="product down its branch of ω"
        )
        self.input.observe(self._on_input, "value")
        self.readout.observe(self._on_typed, "value")
        parts = [self.input, self.readout] if knob.kind in ("log", "linear") else [self.input]
        if knob.path.startswith("weights.") and knob.level:
            parts.append(self.effective)
        self.widget = widgets.HBox(parts, layout=widgets.Layout(margin=f"0 0 0 {8 * knob.level}px", width="auto"))

    def show(self, value: Value) -> None:
        """Show a value without calling back."""
        self.value, self._quiet = value, True
        try:
            self.input.value = place_of(self.knob, value)
            self._read_out(value)
        finally:
            self._quiet = False

    def enable(self, on: bool) -> None:
        """Enable it, or grey it out."""
        self.input.disabled = self.readout.disabled = not on

    def turn(self, value: Value) -> None:
        """Set a value as if the user had typed it."""
        self.show(value)
        self._turned(self.knob.path, value)

    def _read_out(self, value: Value) -> None:
        if self.knob.kind in ("log", "linear"):
            quiet, self._quiet = self._quiet, True
            self.readout.value = f"{value:.4g}"
            self._quiet = quiet

    def _on_input(self, change) -> None:
        # A value between two slider positions is kept until the slider moves. Browsers return a position with
        # different last digits.
        if self._quiet or (self.value is not None and _same(change["new"], place_of(self.knob, self.value))):
            return
        self.value = value_at(self.knob, change["new"])
        self._read_out(self.value)
        self._turned(self.knob.path, self.value)

    def _on_typed(self, change) -> None:
        if self._quiet:
            return
        try:
            value = float(change["new"].replace(",", "."))
        except ValueError:
            if self.value is not None:
                self._read_out(self.value)
            return
        self.show(value)
        self._turned(self.knob.path, value)


class Controls:
    """Knobs in tabs; `show` sets them from a configuration."""

    def __init__(self, config: Config, turned: Turned, height_px: int, titles: Sequence[str] | None = None) -> None:
        """`titles`: the pages of `PAGES` to show; None: all."""
        self.by_path: dict[str, KnobControl] = {}
        self.notes: dict[str, widgets.HTML] = {}
        """The note on each page about knobs that currently have no effect."""
        pages = []
        for title in PAGES if titles is None else titles:
            knobs = PAGES[title]
            controls = [KnobControl(knob, turned) for knob in knobs]
            self.by_path |= {control.knob.path: control for control in controls}
            self.notes[title] = widgets.HTML(layout=widgets.Layout(display="none"))
            layout = widgets.Layout(height=f"{height_px - 34}px", overflow="hidden auto")
            held = [self.notes[title], *(control.widget for control in controls)]
            pages.append((title, widgets.VBox(held, layout=layout)))
        self.widget = widgets.Tab(
            children=[page for _, page in pages], titles=[title for title, _ in pages],
            layout=widgets.Layout(width="100%"),
        )  # fmt: skip
        self.widget.add_class("fw-controls")
        self.show(config)

    def add(self, title: str, page: widgets.Widget, controls: Mapping[str, KnobControl], config: Config) -> None:
        """Add a page with its own controls."""
        self.by_path |= controls
        titles = (*self.widget.titles, title)
        self.widget.children = (*self.widget.children, page)
        self.widget.titles = titles
        self.show(config)

    def show(self, config: Config, but: str | None = None) -> None:
        """Set the controls from a configuration, except the one at `but`, which the user is holding."""
        for path, control in self.by_path.items():
            value = value_of(config, path)
            if path != but and value != control.value:
                control.show(value)
            control.enable(not is_inert(config, path))
        for title, note in self.notes.items():
            inert = [is_inert(config, knob.path) for knob in PAGES[title]]
            note.value = "" if not any(inert) else _why_inert(config, title, all(inert))
            note.layout.display = None if any(inert) else "none"
        for path, product in effective_weights_of(config).items():
            self.by_path[path].effective.value = f"={product:.3g}"


OF_DEEP = (
    "These are settings of <b>Deep Energies</b>. This configuration fits by FACE IT!; choose <i>preset "
    "deep</i> under <i>go to…</i> to use them."
)
OF_FACE_IT = (
    "These are settings of <b>FACE IT!</b>. This configuration fits by Deep Energies; its settings are on the page "
    "<b>deep</b>."
)
SOME_OF_FACE_IT = "Greyed-out settings belong to <b>FACE IT!</b>; those of Deep Energies are on the page <b>deep</b>."
SOME_OF_DEEP = "Greyed-out settings belong to <b>Deep Energies</b>, or to terms that no stage names."
NOT_NAMED = "Greyed-out weights belong to a term that no stage names; add it to a stage's <i>terms</i>."


def _why_inert(config: Config, title: str, every: bool) -> str:
    if title == "deep":
        own, whole, some = config.traits.reads("deep"), OF_DEEP, SOME_OF_DEEP
    else:
        own, whole, some = not config.traits.reads("deep"), OF_FACE_IT, SOME_OF_FACE_IT
    return NOT_NAMED if own else whole if every else some


PAGES = {
    "ω": OMEGA,
    "ρ ε": SOLVE,
    "camera": CAMERA + IDENTITY,
    "points": LANDMARKS,
    "a b c": CONSTANTS,
    "deep": DEEP,
}


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
        "tooltip": knob.tip,
        "style": {"description_width": f"{LABEL_PX - 8 * knob.level}px"},
        "layout": widgets.Layout(width="auto", flex="1 1 auto", min_width="0"),
    }
    if knob.kind == "log":
        low, high = _lowest(knob), math.log10(knob.high)
        return widgets.FloatSlider(low, min=low, max=high, step=1.0 / STEPS_PER_DECADE, readout=False, **common)
    if knob.kind == "linear":
        return widgets.FloatSlider(knob.low, min=knob.low, max=knob.high, step=knob.step, readout=False, **common)
    if knob.kind == "whole":
        return widgets.IntSlider(int(knob.low), min=int(knob.low), max=int(knob.high), **common)
    if knob.kind == "switch":
        return widgets.Checkbox(False, indent=True, **common)
    return widgets.Dropdown(options=knob.choices, **common)


def small_button(text: str, tip: str, style: str = "") -> widgets.Button:
    """A button as wide as its text; `style` is one of ipywidgets' `button_style`."""
    layout = widgets.Layout(width="auto", flex="0 0 auto")
    return widgets.Button(description=text, tooltip=tip, button_style=style, layout=layout)


def narrow() -> widgets.Layout:
    """Layout of a field that takes the remaining width."""
    return widgets.Layout(width="84px", flex="1 1 auto", min_width="0")


def menu(
    options: Sequence[str] | Mapping[str, str], width: str, tip: str, value: str | None = None
) -> widgets.Dropdown:
    """A menu of fixed width; the first option is selected unless another is given."""
    chosen = {} if value is None else {"value": value}
    return widgets.Dropdown(
        options=options, tooltip=tip, layout=widgets.Layout(width=width, flex="0 0 auto"), **chosen
    )  # fmt: skip
