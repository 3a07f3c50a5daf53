"""The button that hands a written file to the browser, for those who sit at a different computer from Python's."""

from collections.abc import Callable
from pathlib import Path

import ipywidgets as widgets

from workbench.errors import WorkbenchError
from workbench.widgets.status_line import error_text


class Download(widgets.HBox):
    """Hidden until a file is offered; `download` is called with it. What went wrong is said beside the button."""

    def __init__(self, download: Callable[[Path], None]) -> None:
        self._download, self._path = download, Path()
        self.button = widgets.Button(
            description="download",
            tooltip="save it on the computer of this browser",
            layout=widgets.Layout(width="auto"),
        )
        self.button.on_click(lambda _button: self._on_click())
        self.said = widgets.HTML()
        super().__init__([self.button, self.said], layout=widgets.Layout(display="none", flex="0 0 auto"))

    def offer(self, path: Path | None) -> None:
        """Offer a file or folder that was written; None: none."""
        self._path, self.said.value = path or Path(), ""
        self.layout.display = "none" if path is None else None

    def _on_click(self) -> None:
        try:
            self._download(self._path)
        except WorkbenchError as error:
            self.said.value = error_text(error)
