"""The knobs of a live session, its preset, and undo."""

from collections.abc import Callable
from typing import Any

import ipywidgets as widgets

from workbench.config import FACE_IT_PRESETS, Config
from workbench.errors import WorkbenchError
from workbench.session.gesture import Gesture
from workbench.session.knobs import changed_by
from workbench.session.live import LiveSession
from workbench.session.tuned_config import preset_on
from workbench.widgets.controls import Controls, menu, preset_names, small_button
from workbench.widgets.panel_page import PanelPage

PAGES = ("ω", "ρ ε", "camera", "points", "a b c")


class LiveSettings:
    """The controls and buttons for the configuration of a session.

    `page` numbers the drags of sliders and asks for resets; `guarded` is called with actions that may be refused,
    `write` with a short status text.
    """

    def __init__(
        self,
        session: LiveSession,
        page: PanelPage,
        guarded: Callable[..., None],
        write: Callable[[str], None],
        height_px: int,
    ) -> None:
        self._session, self._page, self._guarded, self._write, self._quiet = session, page, guarded, write, False
        self.preset = menu(preset_names(session.config), "96px", "preset", session.config.preset)
        self.preset.observe(self._on_preset, "value")
        self.undo = small_button("↶ undo", "undo the last change or neutral calibration")
        self.undo.on_click(lambda _button: self._guarded(self._on_undo))
        self.defaults = small_button("defaults", "back to the initial settings; undo brings yours back")
        self.defaults.on_click(lambda _button: guarded(self._use, session.base))
        self.controls = Controls(session.config, self._on_knob, height_px, PAGES, session.model.scheme)
        page.on_reset(self.controls.reset)
        self.widgets: tuple[widgets.Widget, ...] = (self.preset, self.undo, self.defaults)

    def _on_knob(self, path: str, value: Any) -> None:
        self._guarded(self._turn, path, value)

    def _turn(self, path: str, value: Any) -> None:
        try:
            config = self._session.config.changed(**changed_by(self._session.config, path, value))
            self._session.use(config, Gesture(path, self._page.drag))
        except WorkbenchError:
            self._show()
            raise
        self._show(but=path)

    def _on_preset(self, change) -> None:
        if not self._quiet:
            name, base = change["new"], self._session.base
            self._guarded(self._use, preset_on(name, base) if name in FACE_IT_PRESETS else base)

    def _use(self, config: Config) -> None:
        try:
            self._session.use(config)
        finally:
            self._show()

    def _on_undo(self) -> None:
        if not self._session.undo():
            self._write("nothing to undo")
            return
        self._show()

    def _show(self, but: str | None = None) -> None:
        config = self._session.config
        self.controls.show(config, but)
        self._quiet = True
        try:
            if config.preset not in self.preset.options:
                self.preset.options = preset_names(config)
            self.preset.value = config.preset
        finally:
            self._quiet = False
