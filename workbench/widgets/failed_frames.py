"""Controls to mark frames of a clip as failed, by hand or from the flags of the diagnosis."""

import html
from collections.abc import Callable

import ipywidgets as widgets

from workbench.session import TuningSession
from workbench.session.parts import frames_of, parts_text, read_parts
from workbench.widgets.controls import narrow, small_button
from workbench.widgets.status_line import StatusLine


class FailedFrames:
    """Buttons that mark frames (`rows`), and a line about the marked frames.

    `frame` returns the number of the shown frame; `flag` is called to mark the frames that diagnosis flags.
    """

    def __init__(
        self, session: TuningSession, status: StatusLine, frame: Callable[[], int], flag: Callable[[], None]
    ) -> None:
        self._session, self._status, self._frame = session, status, frame
        temporal = session.temporal
        self.this = small_button("this frame", "mark or unmark the shown frame as failed")
        self.this.on_click(lambda _button: status.guarded(self._mark_this))
        self.flagged = small_button("⚑ flagged", "mark the frames that diagnosis flags as failed")
        self.flagged.on_click(lambda _button: flag())
        self.clear = small_button("clear", "unmark all frames")
        self.clear.on_click(lambda _button: status.guarded(self._clear))
        self.range = widgets.Text(
            placeholder="40-52, 60", tooltip="first and last frames of ranges", layout=narrow(), continuous_update=False
        )
        self.mark = small_button("mark", "mark these frames as failed, whatever their fit")
        self.mark.on_click(lambda _button: status.guarded(self._mark_range, temporal.mark))
        self.unmark = small_button("unmark", "unmark these frames; their fits count again")
        self.unmark.on_click(lambda _button: status.guarded(self._mark_range, temporal.unmark))
        self.summary = widgets.HTML()
        label = widgets.HTML("<b>failed</b>", layout=widgets.Layout(width="38px", flex="0 0 auto"))
        self.rows = ((label, self.this, self.flagged, self.clear), (self.range, self.mark, self.unmark))

    def show(self, part: tuple[int, int] | None) -> None:
        """Update from the session; unmarked frames that failed are counted in `part` (None: the whole clip)."""
        self.summary.value = failed_html(self._session, part)

    def _mark_this(self) -> None:
        temporal, frame = self._session.temporal, self._frame()
        marked = any(first <= frame <= last for first, last in temporal.marked)
        (temporal.unmark if marked else temporal.mark)([frame])

    def _mark_range(self, act: Callable) -> None:
        parts = read_parts(self.range.value)
        if not parts:
            self._status.say("Type frames first, such as 40-52 or 60.", wrong=True)
            return
        act(frames_of(parts))

    def _clear(self) -> None:
        temporal = self._session.temporal
        temporal.unmark(frames_of(temporal.marked))


def failed_html(session: TuningSession, part: tuple[int, int] | None) -> str:
    """The marked frames and the number of other failed frames, in one line."""
    temporal = session.temporal
    marked = temporal.marked
    inside = frames_of(marked)
    others = len([frame for frame in temporal.failed(part) if frame not in inside])
    text = f"marked: {html.escape(parts_text(marked, 4))}" if inside else "none marked"
    if len(inside) > 1:
        text += f" ({len(inside)} frames)"
    return text + (f"; {others} more without a good fit" if others else "")
