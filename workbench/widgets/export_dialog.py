"""What is written to files: the settings, and the performance. Folded away until it is asked for."""

from collections.abc import Callable
from pathlib import Path

import ipywidgets as widgets

from workbench.session import TuningSession
from workbench.widgets.controls import small_button
from workbench.widgets.export_bar import ExportBar
from workbench.widgets.panel_layout import classed, in_line, wrapped
from workbench.widgets.performance_export import PerformanceExport

TITLE = "<b style='display:inline-block;width:84px'>{}</b>"


class ExportDialog:
    """Buttons for the top of a panel (`buttons`) and what they unfold (`widget`); `later` is called with slow
    jobs, `download` with files for the browser to save.
    """

    def __init__(
        self, session: TuningSession, later: Callable[[Callable[[], None]], None], download: Callable[[Path], None]
    ) -> None:
        self.settings = ExportBar(session, later, download)
        self.performance = PerformanceExport(session, later, lambda: self.settings.named, download)
        self.settings.file.observe(lambda _change: self.performance.show_command(), "value")
        for button in (self.settings.export, self.settings.load, self.settings.overwrite):
            button.on_click(lambda _button: self._on_settings())
        self.performance.go.on_click(lambda _button: self.settings.forget())
        self.open = small_button("Save · Export", "save the settings, export the animation, a film or a report (E)",
                                 "primary")  # fmt: skip
        self.open.on_click(lambda _button: self.fold())
        self.help = classed(small_button("?", "keys (?)"), "fw-help-button")
        self.buttons = (self.open, self.help)
        copy = classed(small_button("copy", "copy the commands"), "fw-copy")
        made = self.performance
        options = widgets.HBox(
            [made.format, made.file, made.character, made.shot, made.fps, made.go, made.cancel, made.progress],
            layout=wrapped(),
        )
        close = small_button("✕", "fold this away (E)")
        close.on_click(lambda _button: self.fold())
        rows = [
            in_line(widgets.HTML(TITLE.format("settings")), *self.settings.widgets, self.settings.cancel, close),
            in_line(widgets.HTML(TITLE.format("performance")), options),
            in_line(made.said, made.download),
            in_line(widgets.HTML(TITLE.format("commands")), made.command, copy),
        ]
        self.widget = classed(widgets.VBox(rows, layout=widgets.Layout(display="none")), "fw-export")

    @property
    def writing(self) -> bool:
        """Whether something is being written, or waits for its turn."""
        return self.settings.busy or self.performance.busy

    def fold(self) -> None:
        """Unfold it, or fold it away."""
        folded = self.widget.layout.display == "none"
        if folded:
            self.performance.show_options()
        self.widget.layout.display = None if folded else "none"

    def _on_settings(self) -> None:
        """Settings were loaded or saved, or could not be."""
        self.performance.forget()
        self.performance.show_command()

    def stop(self) -> None:
        """Stop what is being written."""
        self.settings.stop()
        self.performance.stop()
