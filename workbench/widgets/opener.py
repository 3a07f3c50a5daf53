"""A chooser of material to tune on: samples or a typed path; the panel appears below it."""

import html
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import ipywidgets as widgets

from workbench.config import DEFAULT_PRESET, Config, preset
from workbench.landmarks.files import SUFFIXES
from workbench.samples import sample
from workbench.session import TuningSession, open_session
from workbench.session.material import stored_track
from workbench.widgets.cell_reruns import replace_earlier
from workbench.widgets.closing import close_all_of
from workbench.widgets.controls import small_button
from workbench.widgets.detection_preview import DetectionPreview
from workbench.widgets.latest import LatestWins
from workbench.widgets.status_line import error_text
from workbench.widgets.tuning_panel import TuningPanel
from workbench.widgets.upload import Upload

PATH_HINT = "photo, clip, folder, track or landmark file"
PATH_TIP = (
    "a file or folder on the computer where Python runs; tracks are .npz files or folders of runs, landmarks "
    f"{', '.join(SUFFIXES)}"
)

RUNNING = {
    "sweep": "the sweep that is running",
    "tune": "the tuning that is running",
    "time": "the infill or refinement that is running",
}
"""Pages of a panel whose work takes long, and what closing the panel would end."""


@dataclass(frozen=True)
class Wanted:
    """A request to open material."""

    path: Path
    landmarks: Path | None = None
    config: Config | None = None
    session: TuningSession | None = None
    """What it opened as, where that is known."""
    anyway: bool = False
    """Whether what that loses is no reason to ask."""


class _SupersededError(Exception):
    """Raised when a newer choice replaces this one."""


def sample_choices() -> dict[str, Wanted]:
    """The bundled material, by button label."""
    known_lens = preset(DEFAULT_PRESET).changed(camera={"fov_deg": 33.0})
    return {
        "sample portrait": Wanted(sample("astronaut"), sample("astronaut-landmarks")),
        "sample clip": Wanted(sample("laugh"), sample("laugh-landmarks"), known_lens),
        "sample glasses": Wanted(sample("glasses"), sample("glasses-landmarks"), known_lens),
        "sample speech": Wanted(sample("speech-landmarks")),
    }


class SessionOpener(widgets.VBox):
    """Opens a session from a sample or a path and shows `make_panel(session)` below the chooser.

    Opening runs in its own thread; a newer choice cancels an older one, and the previous panel is closed. Where that
    would lose work, it stays until the button `anyway` is pressed. An error is shown as one sentence below the chooser;
    the open panel stays. `session` and `panel` are None until something is open. In JupyterLab, a rerun of the cell
    that made it closes it with its panel; the session stays open for any other user of it.
    """

    def __init__(self, make_panel: Callable[[TuningSession], widgets.Widget] = TuningPanel) -> None:
        self.session: TuningSession | None = None
        self.panel: widgets.Widget | None = None
        self._make_panel = make_panel
        self._worker: LatestWins[Wanted] = LatestWins(self._open, self._failed, "session-opener")
        # A panel that is still getting ready takes seconds to close, so that is done in the background.
        self._closer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="opener-close")
        self.samples = {text: small_button(text, "opens at once") for text in sample_choices()}
        for text, button in self.samples.items():
            button.on_click(lambda _button, text=text: self.open_sample(text))
        self.path = _text(PATH_HINT, PATH_TIP, "300px")
        self.landmarks = _text(
            "landmark file (optional)", "landmarks of the pictures, used instead of a detector", "170px"
        )
        self.upload = Upload(self.open_path, self._failed)
        self.open_button = small_button("Open", "open this path", "primary")
        self.open_button.on_click(lambda _button: self._on_open())
        self.progress = widgets.IntProgress(0, max=1, layout=widgets.Layout(width="140px", display="none"))
        self.message = widgets.HTML(layout=widgets.Layout(min_width="0", flex="1 1 auto"))
        self.anyway, self.stay = small_button("", "close what is open", "warning"), small_button("stay", "open nothing")
        self.anyway.on_click(lambda _button: self._on_anyway())
        self.stay.on_click(lambda _button: self._on_stay())
        self._asked: Wanted | None = None
        """What `anyway` would open."""
        self._ask(None)
        self.preview, self.place = DetectionPreview(), widgets.VBox()
        choices = [*self.samples.values(), self.upload, self.path, self.landmarks, self.open_button]
        said = [self.progress, self.message, self.anyway, self.stay]
        super().__init__([_row(choices), _row(said), self.preview, self.place])
        replace_earlier(self)

    def __repr__(self) -> str:
        return f"SessionOpener({self.session!r})"

    def open_sample(self, text: str) -> None:
        """Open bundled material by its button label."""
        self._worker.submit(sample_choices()[text])

    def open_path(self, path: str | Path, landmarks: str | Path | None = None) -> None:
        """Open a photo, a clip, a folder, a track or a landmark file."""
        self._worker.submit(Wanted(_path(path), None if landmarks is None else _path(landmarks)))

    def wait_idle(self, timeout_s: float = 120.0) -> bool:
        """Wait until the last request is open or has failed; False if that takes longer."""
        return self._worker.wait_idle(timeout_s)

    def close(self) -> None:
        """Close the panel and stop the threads."""
        self._worker.close()
        self._closer.shutdown(wait=True)
        self.upload.close()
        if self.panel is not None:
            self.panel.close()
        close_all_of(self)

    def _on_open(self) -> None:
        if not self.path.value.strip():
            self._say("Type the path of a photo, a clip or a file first.", wrong=True)
            return
        self.open_path(self.path.value, self.landmarks.value if self.landmarks.value.strip() else None)

    def _on_anyway(self) -> None:
        if self._asked is not None:
            self._worker.submit(replace(self._asked, anyway=True))

    def _on_stay(self) -> None:
        self._ask(None)
        self._say_open()

    def _ask(self, wanted: Wanted | None) -> None:
        """Show the buttons that open this or do not; None hides them."""
        self._asked = wanted
        self.anyway.layout.display = self.stay.layout.display = "none" if wanted is None else None
        if wanted is not None:
            self.anyway.description = f"open {_name(wanted)} anyway"

    # --- in the worker's thread ---

    def _open(self, wanted: Wanted) -> None:
        self._ask(None)
        if os.path.exists(wanted.path) and self._loses_work(wanted):  # what is not there closes nothing
            return
        self._say(f"Opening {_name(wanted)} …")
        try:
            session = self._session_of(wanted)
        except _SupersededError:
            return
        if self._loses_work(replace(wanted, session=session)):  # done while this was opened
            return
        before, self.panel, self.session = self.panel, self._make_panel(session), session
        self.place.children = (self.panel,)
        if before is not None:
            self._closer.submit(before.close)
        self._rest()
        self._say_open()

    def _loses_work(self, wanted: Wanted) -> bool:
        """Whether opening this would lose work unasked; if so, say what and ask."""
        lost = [] if self.session is None or wanted.anyway else lost_work(self.session, self.panel)
        if lost:
            self._rest()
            losing = " and ".join(filter(None, [", ".join(lost[:-1]), lost[-1]]))
            name = self.session.material.name
            self._say(f"Opening {_name(wanted)} would close {name} and lose {losing}.", wrong=True)
            self._ask(wanted)
        return bool(lost)

    def _session_of(self, wanted: Wanted) -> TuningSession:
        if wanted.session is not None:
            return wanted.session
        if stored_track(wanted.path) is None:
            self.preview.begin(wanted.path)
        return open_session(
            wanted.path, wanted.config, landmarks=wanted.landmarks, progress=self._on_progress, seen=self.preview.see
        )

    def _on_progress(self, _step: str, done: int, total: int | None) -> None:
        if self._worker.newer():
            raise _SupersededError
        shown = max((total or 0) // 50, 1)
        if done % shown:
            return
        self.progress.max, self.progress.value = total or done, done
        self.progress.layout.display = None
        self._say(f"Finding landmarks: frame {done}{f' of {total}' if total else ''}")

    def _rest(self) -> None:
        self.progress.layout.display = "none"
        self.preview.end()

    def _failed(self, error: Exception) -> None:
        self._rest()
        self._say(error_text(error), wrong=True)

    def _say_open(self) -> None:
        self._say(f"{self.session.material.name}: {_counted(len(self.session), 'frame')}.")

    def _say(self, text: str, wrong: bool = False) -> None:
        style = " role='alert' style='color:var(--jp-error-color1, #b3261e)'" if wrong else ""
        self.message.value = f"<span{style}>{html.escape(text)}</span>"


def lost_work(session: TuningSession, panel: widgets.Widget) -> list[str]:
    """What closing a session's panel would lose, in words."""
    unsaved = session.unexported if session.changes() else []
    exports = vars(panel).get("export_dialog")  # asked for by their names, a panel would make its parts now
    return [
        *([_counted(len(unsaved), "unsaved change")] if unsaved else []),
        *([_counted(len(session.snapshots), "snapshot")] if session.snapshots else []),
        *(["the file that is being written"] if exports is not None and exports.writing else []),
        *(what for page, what in RUNNING.items() if getattr(vars(panel).get(page), "running", False)),
    ]


def _name(wanted: Wanted) -> str:
    return wanted.path.absolute().name


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _path(text: str | Path) -> Path:
    """A path as users paste it: possibly with a pair of quotes, surrounding blanks or ~."""
    typed = str(text).strip()
    quoted = len(typed) > 1 and typed[0] == typed[-1] and typed[0] in "'\""
    return Path(typed[1:-1] if quoted else typed).expanduser()


def _row(children: list[widgets.Widget]) -> widgets.HBox:
    return widgets.HBox(children, layout=widgets.Layout(flex_flow="row wrap", align_items="center"))


def _text(placeholder: str, tip: str, width: str) -> widgets.Text:
    return widgets.Text(placeholder=placeholder, tooltip=tip, layout=widgets.Layout(width=width, flex="1 1 auto"))
