"""Export of the configuration: its file name, the choice if the file exists, and the result."""

import html
import os
import threading
from collections.abc import Callable
from pathlib import Path

import ipywidgets as widgets

from workbench.errors import WorkbenchError
from workbench.session import TuningSession
from workbench.session.exports import exported_for, free_file
from workbench.widgets.controls import small_button
from workbench.widgets.download import Download


class ExportBar:
    """The file name, buttons and a line of text; `later` is called with slow jobs, `download` with a written file."""

    def __init__(
        self, session: TuningSession, later: Callable[[Callable[[], None]], None], download: Callable[[Path], None]
    ) -> None:
        self._session = session
        self._stop = threading.Event()
        self._taken = Path()
        self.file = widgets.Text(
            "tuned.toml", tooltip="file for the configuration", continuous_update=False,
            layout=widgets.Layout(width="150px"),
        )  # fmt: skip
        self.export = small_button("save settings", "write the configuration with its provenance")
        self.export.on_click(lambda _button: later(self._on_export))
        self.overwrite = small_button("overwrite", "replace the existing file")
        self.overwrite.layout.display = "none"
        self.overwrite.on_click(lambda _button: later(self._on_overwrite))
        self.cancel = small_button("cancel", "stop; no file is written")
        self.cancel.layout.display = "none"
        self.cancel.on_click(lambda _button: self.stop())
        self.download = Download(download)
        self.exported = widgets.HTML(layout=widgets.Layout(min_width="0", flex="1 1 auto"))
        self.widgets = (self.file, self.export, self.overwrite, self.download, self.exported)

    @property
    def path(self) -> Path:
        """The file that is named, with its suffix."""
        path = typed_path(self.file.value.strip() or "tuned.toml")
        return path if path.suffix == ".toml" else path.parent / f"{path.name}.toml"

    def stop(self) -> None:
        """Stop a running export."""
        self._stop.set()

    def _on_export(self) -> None:
        path = self.path
        if self._session.may_write(path):
            self._write(path)
        else:
            self._offer(path)

    def _offer(self, taken: Path) -> None:
        """Offer the choice between a free name, filled into the field, and the existing file."""
        free = free_file(taken.parent, self._session.material.name)
        whose = exported_for(taken)
        self._taken, self.file.value = taken, str(free)
        self.overwrite.description, self.overwrite.layout.display = f"overwrite {taken.name}", None
        self.exported.value = html.escape(
            f"{taken.name} exists already{f', exported for {whose}' if whose else ''}: "
            f"pressing save again writes {free.name}."
        )

    def _on_overwrite(self) -> None:
        self.file.value = str(self._taken)
        self._write(self._taken)

    def _write(self, path: Path) -> None:
        self._stop.clear()
        self.download.offer(None)
        self.overwrite.layout.display, self.cancel.layout.display = "none", None

        def progress(step: str, done: int, total: int | None) -> None:
            if done % 10 == 0 or done == total:
                self.exported.value = f"{step} {done} of {total} …"

        try:
            self._session.export(path, progress, self._stop.is_set, overwrite=True)
        except (WorkbenchError, OSError):
            self.exported.value = ""
            raise
        finally:
            self.cancel.layout.display = "none"
        self.download.offer(path)
        command = html.escape(self._session.command(path))
        self.exported.value = f"wrote {html.escape(str(path))}; to reproduce the numbers: <code>{command}</code>"


def typed_path(text: str) -> Path:
    """The path that is typed into a field, where ~ is the user's folder."""
    return Path(os.path.expanduser(text.strip()))
