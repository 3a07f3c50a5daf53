"""Recording from a camera: start, stop, and save to a folder."""

import html
from collections.abc import Callable
from pathlib import Path

import ipywidgets as widgets

from workbench.errors import InputError, WorkbenchError
from workbench.session.live import LiveSession
from workbench.session.recording import Recording
from workbench.widgets.controls import small_button
from workbench.widgets.live_messages import LiveMessages
from workbench.widgets.slow_jobs import SlowJobs

NOT_RECORDED = "Nothing has been recorded yet; press record while the camera runs."
NOT_STARTED = "Start the camera first."


class RecordBar:
    """Buttons, the folder name and a line of text; `recording` is the last recording.

    `running` returns whether the camera is on, `camera` its name; refused actions are shown in `messages`; saving is
    one of the `slow` jobs.
    """

    def __init__(
        self,
        session: LiveSession,
        running: Callable[[], bool],
        camera: Callable[[], str],
        messages: LiveMessages,
        slow: SlowJobs,
    ) -> None:
        self._session, self._running, self._camera, self._messages = session, running, camera, messages
        self.recording: Recording | None = None
        self._recorded_from = ""
        """The camera of the recording in progress; the menu may show another one when it ends."""
        self.record = widgets.ToggleButton(
            value=False, description="● record", tooltip="keep every frame from now on",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
        )  # fmt: skip
        self.record.observe(self._on_record, "value")
        self.pictures = widgets.Checkbox(
            value=True, description="with pictures", indent=False, tooltip="also keep the camera's pictures",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
        )  # fmt: skip
        self.folder = widgets.Text(
            str(free_folder(Path("recording"))), tooltip="folder to write", layout=widgets.Layout(width="150px")
        )
        self.save = small_button("save", "write the recording as track.npz and clip.mp4")
        self.save.on_click(lambda _button: slow.submit(messages.guarded, self._on_save))
        self.saved = widgets.HTML(layout=widgets.Layout(min_width="0", flex="1 1 auto"))
        self.widgets = (self.record, self.pictures, self.folder, self.save, self.saved)

    @property
    def last(self) -> Recording:
        """The last recording. Raises `InputError` if there is none."""
        if self.recording is None:
            raise InputError(NOT_RECORDED)
        return self.recording

    def end(self) -> None:
        """Stop a recording in progress, if any, and keep it."""
        if self._session.recording is None:
            return
        self._messages.guarded(self._keep)
        self.record.value, self.record.button_style = False, ""

    def _keep(self) -> None:
        self.recording = self._session.stop_recording(self._recorded_from)
        self.saved.value = f"recorded {len(self.recording)} frames, {self.recording.seconds:.1f} s; not saved yet"

    def _on_record(self, change) -> None:
        if not change["new"]:
            self.end()
        elif self._running():
            self._recorded_from = self._camera()
            self._session.start_recording(self.pictures.value)
            self.record.button_style = "danger"
        else:
            self.record.value = False
            self._messages.say(NOT_STARTED, wrong=True)

    def _on_save(self) -> None:
        folder = Path(self.folder.value.strip() or "recording").expanduser()
        self.saved.value = "saving …"
        try:
            self.last.save(folder)
        except (WorkbenchError, OSError):
            self.saved.value = ""
            raise
        files = "track.npz, clip.mp4" if self.recording.jpegs else "track.npz"
        self.saved.value = f"wrote {html.escape(str(folder))} ({files})"
        self.folder.value = str(free_folder(folder))


def free_folder(folder: Path) -> Path:
    """This folder if it contains no track, else the next free number: recording, recording-2, recording-3."""
    stem, number = folder.name, 1
    head, _, tail = stem.rpartition("-")
    if head and tail.isdigit():
        stem, number = head, int(tail)
    while True:
        found = folder.with_name(stem if number == 1 else f"{stem}-{number}")
        if not (found / "track.npz").exists():
            return found
        number += 1
