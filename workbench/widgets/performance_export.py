"""Export of a session's performance: format, file and options as on the command line, and the command itself."""

import html
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import ipywidgets as widgets

from workbench.errors import InputError, StoppedError, WorkbenchError
from workbench.export import export_track
from workbench.export.clip import check_rate
from workbench.export.suffixes import DRESSED, FORMATS, format_of, pictures_folder, place_of
from workbench.face import character_names, dressed_as
from workbench.face.characters import PLAIN
from workbench.files import check_new, check_writable
from workbench.session import TuningSession
from workbench.session.material import Cancelled
from workbench.session.performance import performance_commands, performance_track
from workbench.widgets.controls import menu, small_button
from workbench.widgets.download import Download
from workbench.widgets.export_bar import typed_path
from workbench.widgets.export_requests import ExportRequest, ExportRequests
from workbench.widgets.panel_layout import classed
from workbench.widgets.status_line import StatusLine, error_text

ALL_SHOTS = -1
KINDS = {f"{suffix}  {told}": suffix for suffix, told in FORMATS.items()}


class _CancelledError(Exception):
    """Raised to leave an export that the user cancelled."""


@dataclass(frozen=True)
class PerformanceRequest(ExportRequest):
    """A performance to be exported."""

    shot: int | None
    rate: float | None
    character: str | None

    def check_free(self) -> None:
        """Raise `OutputError` where something is in the way of what is written, or the place cannot be written to."""
        pictures = self.character is not None and format_of(self.path) == ".usd"
        for place in [place_of(self.path), *([pictures_folder(self.path)] if pictures else [])]:
            check_new(place, "name another file, or move that one away")
            check_writable(place)


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
        self._session, self._settings = session, settings
        self._requests = ExportRequests(self._write, later, self._say_waiting, self.stop)
        self._ended: list[str] = []
        """What became of the requests since none was left."""
        self._wrong = False
        """Whether one of them failed."""
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
        self.fps = widgets.Text(placeholder="input's fps", tooltip="frames per second instead of the input's (--fps)",
                                layout=widgets.Layout(width="84px"))  # fmt: skip
        self.go = small_button("export", "write this file", "primary")
        self.go.on_click(lambda _button: self._on_go())
        self.cancel = self._requests.cancel
        self.progress = widgets.IntProgress(0, max=1, layout=widgets.Layout(width="120px"))
        self.progress.layout.display = "none"
        self.said, self.download = StatusLine(), Download(download)
        self.command = classed(widgets.HTML(), "fw-command")
        self.format.observe(self._on_format, "value")
        for control in (self.file, self.character, self.shot, self.fps):
            control.observe(lambda _change: self.show_command(), "value")
        self.show_options()

    @property
    def busy(self) -> bool:
        """Whether something waits or is being written."""
        return self._requests.busy

    def stop(self) -> None:
        """Cancel what waits or is being written."""
        for request in self._requests.drop():
            self._end(_cancelled_text(request))

    def forget(self) -> None:
        """Say nothing any more of what failed, unless something is being written."""
        if self._wrong and not self.busy:
            self._ended, self._wrong = [], False
            self._say()

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

    def _on_go(self) -> None:
        if not self.busy:
            self._ended, self._wrong = [], False
        try:
            request = self._request()
        except WorkbenchError as error:
            self.download.offer(None)
            self._end(error_text(error), wrong=True)
            return
        self._requests.submit(request)

    def _request(self) -> PerformanceRequest:
        """What is chosen. Raises `InputError` and `OutputError` for what cannot be written."""
        path, suffix = typed_path(self.file.value), self.format.value
        if format_of(path) != suffix:
            raise InputError(f"{path} does not end in the chosen format's suffix {suffix}; change one of them.")
        rate = _rate(self.fps.value) if self._takes_rate else None
        check_rate(rate)
        shot = None if self.shot.value == ALL_SHOTS else self.shot.value
        character = self.character.value if self._dressed else None
        request = PerformanceRequest(path, self._session.config, shot, rate, character)
        request.check_free()
        return request

    def _write(self, request: PerformanceRequest, cancelled: Cancelled) -> None:
        """Work, in the thread for slow jobs."""
        self.progress.value, self.progress.layout.display = 0, None
        try:
            self._end(self._written(request, cancelled))
        except (_CancelledError, StoppedError):
            self._end(_cancelled_text(request))
        except (WorkbenchError, OSError) as error:
            self._end(error_text(error), wrong=True)
        finally:
            self.progress.layout.display = "none"

    def _written(self, request: PerformanceRequest, cancelled: Cancelled) -> str:
        def told(step: str, done: int, total: int | None) -> None:
            if cancelled():
                raise _CancelledError
            total = total or len(self._session)
            if done == 1 or done == total or done % max(total // 40, 1) == 0:
                self.progress.max, self.progress.value = total, done
                self._say(f"{step} {done} of {total} …")

        session = self._session
        request.check_free()  # another one may have been written while it waited
        track = performance_track(session, told, cancelled, request.config)
        if track is None or cancelled():
            raise _CancelledError
        dressed = None if request.character is None else dressed_as(request.character, session.model)
        request.check_free()  # … or while it was fitted
        done = export_track(
            track, session.model, request.path, shot=request.shot, rate=request.rate, dressed=dressed, progress=told
        )
        self.download.offer(done.path)
        return " ".join([f"Wrote {done.path.absolute()}.", *done.notes])

    def _say_waiting(self, text: str) -> None:
        if text:
            self.download.offer(None)
        self._say(text)

    def _say(self, text: str = "") -> None:
        """Show a text after those about what ended before."""
        self.said.say(" ".join([*self._ended, *([text] if text else [])]), self._wrong)

    def _end(self, text: str, wrong: bool = False) -> None:
        """Show a text that stays, once, until nothing is left to be written."""
        self._wrong = self._wrong or wrong
        if text not in self._ended:
            self._ended.append(text)
        self._say()


def _cancelled_text(request: PerformanceRequest) -> str:
    return f"Cancelled; {request.path.name} was not written."


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
