"""Export of a session's performance: format, file and options as on the command line, and the command itself."""

import html
import threading
from collections.abc import Callable
from pathlib import Path

import ipywidgets as widgets

from workbench.errors import InputError, WorkbenchError
from workbench.export import export_track
from workbench.export.suffixes import DRESSED, FORMATS, format_of, pictures_folder, place_of
from workbench.face import character_names, dressed_as
from workbench.face.characters import PLAIN
from workbench.session import TuningSession
from workbench.session.performance import performance_commands, performance_track
from workbench.widgets.controls import menu, small_button
from workbench.widgets.download import Download
from workbench.widgets.export_bar import typed_path
from workbench.widgets.panel_layout import classed
from workbench.widgets.status_line import StatusLine

ALL_SHOTS = -1
KINDS = {f"{suffix}  {told}": suffix for suffix, told in FORMATS.items()}


class _CancelledError(Exception):
    """Raised to leave an export that the user cancelled."""


class PerformanceExport:
    """The options, a button, progress and the commands; `later` is called with slow jobs, `settings` returns the file
    of the settings that the commands name, `download` is called with a written file.
    """

    def __init__(
        self,
        session: TuningSession,
        later: Callable[[Callable[[], None]], None],
        settings: Callable[[], Path],
        download: Callable[[Path], None],
    ) -> None:
        self._session, self._settings, self._cancelled = session, settings, threading.Event()
        self.format = menu(KINDS, "440px", "format of the file")
        self.file = widgets.Text(
            f"{session.material.name}.glb", tooltip="file or folder to write", layout=widgets.Layout(width="180px")
        )
        people = character_names() if session.model.name == "default-head" else ()
        self._followed = session.config.head.character
        """The session's character as it was shown last."""
        self.character = menu(
            list(dict.fromkeys([PLAIN, *people, self._followed])), "110px", "who plays it (--character)", self._followed
        )
        shots = {"all shots": ALL_SHOTS} | {f"shot {k}": k for k in range(len(session.material.shots))}
        self.shot = menu(shots, "92px", "frames of one shot only (--shot)")
        self.fps = widgets.Text(placeholder="input's fps", tooltip="frames per second in place of the input's (--fps)",
                                layout=widgets.Layout(width="84px"))  # fmt: skip
        self.go = small_button("export", "write this file", "primary")
        self.go.on_click(lambda _button: later(self._export))
        self.cancel = small_button("cancel", "stop; no file is written")
        self.cancel.on_click(lambda _button: self.stop())
        self.progress = widgets.IntProgress(0, max=1, layout=widgets.Layout(width="120px"))
        self.cancel.layout.display = self.progress.layout.display = "none"
        self.said, self.download = StatusLine(), Download(download)
        self.command = classed(widgets.HTML(), "fw-command")
        self.format.observe(self._on_format, "value")
        for control in (self.file, self.character, self.shot, self.fps):
            control.observe(lambda _change: self.show_command(), "value")
        self.show_options()

    def stop(self) -> None:
        """Stop a running export."""
        self._cancelled.set()

    def show_options(self) -> None:
        """Show the options that the format has, and the command."""
        self._follow_character()
        self.character.layout.display = None if self.format.value in DRESSED else "none"
        self.shot.layout.display = None if len(self._session.material.shots) > 1 else "none"
        self.fps.layout.display = "none" if self.format.value in (".mp4", ".html") else None
        self.show_command()

    def show_command(self) -> None:
        """Show the commands that do the same."""
        options = [*(["--shot", str(self.shot.value)] if self.shot.value != ALL_SHOTS else [])]
        rate = _with_point(self.fps.value)
        options += ["--fps", rate] if rate and self._takes_rate else []
        options += ["--character", self.character.value] if self._dressed else []
        text = performance_commands(self._session, self._settings(), typed_path(self.file.value), options)
        self.command.value = f"<code>{html.escape(text)}</code>"

    def _follow_character(self) -> None:
        """Let the session's character play it, unless another one was chosen here."""
        if self.character.value == self._followed:
            self._followed = self._session.config.head.character
            if self._followed not in self.character.options:
                self.character.options = (*self.character.options, self._followed)
            self.character.value = self._followed

    @property
    def _takes_rate(self) -> bool:
        return self.format.value not in (".mp4", ".html")

    @property
    def _dressed(self) -> bool:
        return self.format.value in DRESSED and self.character.value != PLAIN

    def _on_format(self, change) -> None:
        stem = self.file.value
        for suffix in sorted(FORMATS, key=len, reverse=True):
            stem = stem.removesuffix(suffix)
        self.file.value = f"{stem or self._session.material.name}{change['new']}"
        self.show_options()

    def _export(self) -> None:
        """Work, in the thread for slow jobs."""
        self._cancelled.clear()
        self.download.offer(None)
        self.cancel.layout.display = self.progress.layout.display = None
        try:
            self.said.say(self._write())
        except _CancelledError:
            self.said.say("Cancelled; nothing was written.")
        except (WorkbenchError, OSError) as error:
            self.said.failed(error)
        finally:
            self.cancel.layout.display = self.progress.layout.display = "none"

    def _write(self) -> str:
        path, session = typed_path(self.file.value), self._session
        if format_of(path) != self.format.value:
            raise InputError(
                f"{path} does not end in the chosen format's suffix {self.format.value}; change one of them."
            )
        written = [place_of(path), *([pictures_folder(path)] if self._dressed and self.format.value == ".usd" else [])]
        for taken in written:
            if taken.exists():
                raise InputError(f"{taken} exists already; name another file, or move that one away.")
        rate = _rate(self.fps.value) if self._takes_rate else None
        track = performance_track(session, self._told, self._cancelled.is_set)
        if track is None:
            raise _CancelledError
        dressed = dressed_as(self.character.value, session.model) if self._dressed else None
        shot = None if self.shot.value == ALL_SHOTS else self.shot.value
        path.parent.mkdir(parents=True, exist_ok=True)
        done = export_track(
            track, session.model, path, shot=shot, rate=rate, dressed=dressed, progress=self._told
        )  # fmt: skip
        self.download.offer(done.path)
        return " ".join([f"Wrote {done.path.absolute()}.", *done.notes])

    def _told(self, step: str, done: int, total: int | None) -> None:
        if self._cancelled.is_set():
            raise _CancelledError
        total = total or len(self._session)
        if done == 1 or done == total or done % max(total // 40, 1) == 0:
            self.progress.max, self.progress.value = total, done
            self.said.say(f"{step} {done} of {total} …")


def _with_point(text: str) -> str:
    """A typed number as the command line reads it."""
    return text.strip().replace(",", ".")


def _rate(text: str) -> float | None:
    """Frames per second as typed; None for an empty field. Raises `InputError` for other texts."""
    if not text.strip():
        return None
    try:
        return float(_with_point(text))
    except ValueError:
        raise InputError(f"Frames per second are a number such as 25, got {text!r}.") from None
