"""The knobs of a configuration in pages, with a search over all of them; helpers for buttons and menus."""

from collections.abc import Mapping, Sequence, Set
from typing import Any

import ipywidgets as widgets
import numpy as np

from workbench.config import FACE_IT_PRESETS, Config
from workbench.landmarks.scheme import LandmarkScheme
from workbench.session.knobs import CAMERA, CONSTANTS, DEEP, IDENTITY, LANDMARKS, OMEGA, SOLVE, inert_among, value_of
from workbench.session.knobs import effective_weights as effective_weights_of
from workbench.widgets.knob_control import KnobControl, Turned

NOT_FOUND = "<span style='opacity:.7'>No setting has these words in its name or description.</span>"
NONE_CHANGED = "<span style='opacity:.7'>Every setting is as it was at the start.</span>"


class Controls:
    """Knobs in tabs with a search field above; `show` sets them from a configuration.

    `config` is the start, which sliders mark and resets go back to.
    """

    def __init__(
        self, config: Config, turned: Turned, height_px: int | None = None, titles: Sequence[str] | None = None,
        scheme: LandmarkScheme | None = None,
    ) -> None:  # fmt: skip
        """`height_px` None: as high as its place; `titles`: the pages of `PAGES` to show, None: all.

        `scheme`: of the landmarks that are fitted; None: of the configuration's detector.
        """
        self._start, self._height_px, self._scheme = config, height_px, scheme
        self.by_path: dict[str, KnobControl] = {}
        self.notes: dict[str, widgets.HTML] = {}
        """The note on each page about knobs that currently have no effect."""
        self.search = widgets.Text(
            placeholder="search all settings", tooltip="words of a setting's name or description, such as jaw or calm",
            layout=widgets.Layout(flex="1 1 0", min_width="0", width="auto"),
        )  # fmt: skip
        self.changed = widgets.ToggleButton(
            description="changed", tooltip="show the settings that differ from the start",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
        )  # fmt: skip
        for asking in (self.search, self.changed):
            asking.observe(lambda _change: self._find(), "value")
        self.found, self._none = widgets.VBox(layout=self._page_layout()), widgets.HTML()
        self.found.layout.display = "none"
        self.pages = widgets.Tab(layout=widgets.Layout(width="100%"))
        asked = widgets.HBox([self.search, self.changed], layout=widgets.Layout(flex="0 0 auto"))
        self.widget = widgets.VBox([asked, self.found, self.pages])
        self.widget.add_class("fw-controls")
        for title in PAGES if titles is None else titles:
            controls = [KnobControl(knob, turned) for knob in PAGES[title]]
            self.notes[title] = widgets.HTML(layout=widgets.Layout(display="none"))
            page = widgets.VBox(
                [self.notes[title], *(control.widget for control in controls)], layout=self._page_layout()
            )
            self.add(title, page, {control.knob.path: control for control in controls}, config)

    def add(self, title: str, page: widgets.Widget, controls: Mapping[str, KnobControl], config: Config) -> None:
        """Add a page with its own controls."""
        self.by_path |= controls
        titles = (*self.pages.titles, title)
        self.pages.children = (*self.pages.children, page)
        self.pages.titles = titles
        for path, control in controls.items():
            control.begin_at(value_of(self._start, path))
        self.show(config)

    def show(self, config: Config, but: str | None = None) -> None:
        """Set the controls from a configuration, except the one at `but`, which the user is holding."""
        inert = inert_among(config, self.by_path, self._scheme)
        for path, control in self.by_path.items():
            value = value_of(config, path)
            if path != but and value != control.value:
                control.show(value)
            control.enable(path not in inert)
        for title, note in self.notes.items():
            greyed = {knob.path for knob in PAGES[title]} & inert
            note.value = _why_inert(config, title, greyed) if greyed else ""
            note.layout.display = None if greyed else "none"
        for path, product in effective_weights_of(config).items():
            if path in self.by_path and self.by_path[path].knob.level:
                self.by_path[path].effective.value = f"={three_digits(product)}"

    def reset(self, path: str) -> None:
        """Set a knob back to the start, as a double click on it does; other paths are ignored."""
        if path in self.by_path:
            self.by_path[path].reset()

    def _find(self) -> None:
        """Show what is asked for in place of the pages."""
        text, changed = self.search.value.strip(), self.changed.value
        found = [
            control.widget
            for control in self.by_path.values()
            if (not text or control.knob.matches(text)) and (not changed or control.value != control.start)
        ]
        asked = bool(text) or changed
        self._none.value = NOT_FOUND if text else NONE_CHANGED
        self.found.children = found or [self._none] if asked else ()
        self.found.layout.display = None if asked else "none"
        self.pages.layout.display = "none" if asked else None

    def _page_layout(self) -> widgets.Layout:
        height = None if self._height_px is None else f"{self._height_px - 62}px"
        return widgets.Layout(height=height, overflow="hidden auto")


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
NO_SUCH_POINTS = (
    "The greyed-out points are not among those of the detector (<i>landmarks.detector</i>), or Deep Energies does not "
    "use them."
)
CAMERA_GIVEN = "The measured camera (<i>camera.matrix</i> or <i>camera.rig</i>) has a field of view of its own."
OF_IDLE_TERMS = "Greyed-out settings belong to terms that no stage names, or whose weight (ω) is 0."
NOT_NAMED = "Greyed-out weights belong to a term that no stage names; add it to a stage's <i>terms</i>."


def _why_inert(config: Config, title: str, greyed: Set[str]) -> str:
    if title == "points":
        return NO_SUCH_POINTS
    if greyed == {"camera.fov_deg"}:
        return CAMERA_GIVEN
    every = len(greyed) == len(PAGES[title])
    if title == "deep":
        own, whole, some = config.traits.reads("deep"), OF_DEEP, SOME_OF_DEEP
    else:
        own, whole, some = not config.traits.reads("deep"), OF_FACE_IT, SOME_OF_FACE_IT
    if own:
        return OF_IDLE_TERMS if title == "a b c" else NOT_NAMED
    return whole if every else some


PAGES = {
    "ω": OMEGA,
    "ρ ε": SOLVE,
    "camera": CAMERA + IDENTITY,
    "points": LANDMARKS,
    "a b c": CONSTANTS,
    "deep": DEEP,
}


def small_button(text: str, tip: str, style: str = "") -> widgets.Button:
    """A button as wide as its text; `style` is one of ipywidgets' `button_style`."""
    layout = widgets.Layout(width="auto", flex="0 0 auto")
    return widgets.Button(description=text, tooltip=tip, button_style=style, layout=layout)


def toggle(text: str, tip: str, value: bool = False) -> widgets.ToggleButton:
    """A button that stays pressed, as wide as its text."""
    layout = widgets.Layout(width="auto", flex="0 0 auto")
    return widgets.ToggleButton(value=value, description=text, tooltip=tip, layout=layout)


def narrow() -> widgets.Layout:
    """Layout of a field that takes the remaining width."""
    return widgets.Layout(width="84px", flex="1 1 auto", min_width="0")


def menu(options: Sequence[Any] | Mapping[str, Any], width: str, tip: str, value: Any = None) -> widgets.Dropdown:
    """A menu of fixed width; the first option is selected unless another is given."""
    chosen = {} if value is None else {"value": value}
    return widgets.Dropdown(
        options=options, tooltip=tip, layout=widgets.Layout(width=width, flex="0 0 auto"), **chosen
    )  # fmt: skip


def three_digits(value: float) -> str:
    """A number to three digits, without an exponent: 1000, not 1e+03."""
    return np.format_float_positional(value, 3, fractional=False, trim="-")


def preset_names(config: Config) -> tuple[str, ...]:
    """The presets of FACE IT!, and what a configuration calls its own."""
    return tuple(dict.fromkeys([*FACE_IT_PRESETS, config.preset]))
