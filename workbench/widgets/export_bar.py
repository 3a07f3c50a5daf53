"""Export of the configuration: its file name, the choice if the file exists, and the result."""

import html
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import ipywidgets as widgets

from workbench.errors import OutputError, WorkbenchError
from workbench.files import check_writable
from workbench.session import TuningSession
from workbench.session.exports import TakenError, exported_for, free_file
from workbench.session.material import Cancelled
from workbench.widgets.controls import small_button
from workbench.widgets.download import Download
from workbench.widgets.export_requests import ExportRequest, ExportRequests
from workbench.widgets.status_line import StatusLine, error_text


@dataclass(frozen=True)
class SettingsRequest(ExportRequest):
    """Settings to be saved."""

    overwrite: bool
    """Whether the user has agreed to replace what is there."""


class ExportBar:
    """The file name, buttons and a line of text; `later` is called with slow jobs, `download` with a written file."""

    def __init__(
        self, session: TuningSession, later: Callable[[Callable[[], None]], None], download: Callable[[Path], None]
    ) -> None:
        self._session = session
        self._taken = Path()
        self._unread: set[Path] = set()
        """Files that could not be loaded."""
        self._wrong = False
        """Whether what is said is an error."""
        self.file = widgets.Text(
            "tuned.toml", tooltip="file for the configuration", continuous_update=False,
            layout=widgets.Layout(width="150px"),
        )  # fmt: skip
        self.export = small_button("save settings", "write the configuration with its provenance")
        self.export.on_click(lambda _button: self._on_export())
        self.load = small_button("load", "use the settings of this file; undo brings back the settings before it")
        self.load.on_click(lambda _button: self._on_load())
        self.overwrite = small_button("overwrite", "replace the existing file")
        self.overwrite.layout.display = "none"
        self.overwrite.on_click(lambda _button: self._on_overwrite())
        self._requests = ExportRequests(self._write, later, self._say, self.stop)
        self.cancel = self._requests.cancel
        self.download = Download(download)
        self.exported = StatusLine(layout=widgets.Layout(min_width="0", flex="1 1 auto"))
        self._known = self.path
        """The file that was loaded or saved last, or at first the one that is offered."""
        self.widgets = (self.file, self.export, self.load, self.overwrite, self.download, self.exported)

    @property
    def path(self) -> Path:
        """The file that is named, with its suffix."""
        path = typed_path(self.file.value.strip() or "tuned.toml")
        return path if path.suffix == ".toml" else path.parent / f"{path.name}.toml"

    @property
    def named(self) -> Path:
        """The file that commands name: not one that could not be loaded, unless settings were saved there since."""
        return self._known if self.path in self._unread else self.path

    @property
    def busy(self) -> bool:
        """Whether something waits or is being written."""
        return self._requests.busy

    def stop(self) -> None:
        """Cancel what waits or is being written."""
        if waiting := self._requests.drop():
            names = ", ".join(request.path.name for request in waiting)
            self._say(f"Cancelled; {names} {'was' if len(waiting) == 1 else 'were'} not written.")
        elif self.busy:
            self._say("")

    def forget(self) -> None:
        """Say nothing any more of what failed."""
        if self._wrong:
            self._say("")

    def _on_export(self) -> None:
        path = self.path
        if self._session.may_write(path):
            self._ask(path)
        else:
            self._offer(path)

    def _offer(self, taken: Path) -> None:
        """Offer the choice between a free name, filled into the field unless it names another file, and this one."""
        whose = exported_for(taken)
        if self.path == taken:
            self.file.value = str(free_file(taken.parent, self._session.material.name))
        self._taken = taken
        self.overwrite.description, self.overwrite.layout.display = f"overwrite {taken.name}", None
        self._say(
            f"{taken.name} exists already{f', exported for {whose}' if whose else ''}: "
            f"pressing save again writes {self.path.name}."
        )

    def _on_overwrite(self) -> None:
        self.file.value = str(self._taken)
        self._ask(self._taken, overwrite=True)

    def _ask(self, path: Path, overwrite: bool = False) -> None:
        self.overwrite.layout.display = "none"
        try:
            check_writable(path)
        except OutputError as error:
            self._say(error_text(error), wrong=True)
            return
        self._requests.submit(SettingsRequest(path, self._session.config, overwrite))

    def _on_load(self) -> None:
        path = self.path
        self.overwrite.layout.display = "none"
        try:
            self._session.load(path)
        except WorkbenchError as error:
            self._unread.add(path)
            self._say(error_text(error), wrong=True)
        else:
            self._holds_settings(path)
            self._say(f"now using {path.name}; undo brings back the settings before it")

    def _holds_settings(self, path: Path) -> None:
        """Commands may name a file: it was loaded or saved."""
        self._known = path
        self._unread.discard(path)

    def _say(self, text: str, wrong: bool = False) -> None:
        """Show a text in place of what was written last; `wrong`: in red."""
        self.download.offer(None)
        self._wrong = wrong
        if wrong:
            self.exported.say(text, wrong)
        else:
            self.exported.value = html.escape(text)

    def _write(self, request: SettingsRequest, cancelled: Cancelled) -> None:
        """Work, in the thread for slow jobs."""
        path, config = request.path, request.config

        def progress(step: str, done: int, total: int | None) -> None:
            if not cancelled() and (done % 10 == 0 or done == total):
                self.exported.value = f"{step} {done} of {total} …"

        try:
            self._session.export(path, progress, cancelled, request.overwrite, config)
        except TakenError:
            self._offer(path)
            return
        self._holds_settings(path)
        self.download.offer(path)
        command = html.escape(self._session.command(path, config))
        self.exported.value = f"wrote {html.escape(str(path))}; to reproduce the numbers: <code>{command}</code>"


def typed_path(text: str) -> Path:
    """The path that is typed into a field, where ~ is the user's folder."""
    return Path(os.path.expanduser(text.strip()))
