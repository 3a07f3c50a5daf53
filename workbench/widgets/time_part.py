"""The part of a clip for infill and refinement: typed, played, and shown before and after."""

from collections.abc import Callable

import ipywidgets as widgets

import workbench
from workbench.config import Config
from workbench.errors import InputError, WorkbenchError
from workbench.session import TuningSession
from workbench.session.parts import read_parts
from workbench.widgets.controls import narrow, small_button

BEFORE, AFTER = "before", "after"
RATE = 25.0
"""Frames per second if the clip does not say."""


class TimePart:
    """The field with first and last frame, the player limited to them (`play`), and the choice of a side.

    `changed` is called when another part is typed, `go` with the frame being played, `redraw` to show another side;
    `in_view` returns the first and last frame in view in the strip.
    """

    def __init__(
        self,
        session: TuningSession,
        changed: Callable[[], None],
        go: Callable[[int], None],
        redraw: Callable[[], None],
        in_view: Callable[[], tuple[int, int]],
    ) -> None:
        self._session, self._go, self._in_view, self._quiet = session, go, in_view, False
        self._slow, self._short = False, ""
        self.part = widgets.Text(
            placeholder="whole clip", tooltip="first and last frame to work on; empty: the whole clip",
            layout=narrow(), continuous_update=False,
        )  # fmt: skip
        self.part.observe(lambda _change: changed(), "value")
        self.view = small_button("in view", "use the frames in view in the strip")
        self.view.on_click(lambda _button: self._take_view())
        self.sides = widgets.ToggleButtons(options=[BEFORE, AFTER], style={"button_width": "auto"})
        self.sides.add_class("fw-sides")
        self.sides.observe(lambda _change: redraw(), "value")
        self.rate = session.material.rate or RATE
        """Frames per second of the clip."""
        self.play = widgets.Play(min=0, max=len(session) - 1, show_repeat=True, layout=widgets.Layout(width="auto"))
        self.play.observe(self._on_play, "value")
        label = widgets.HTML("<b>frames</b>", layout=widgets.Layout(width="44px", flex="0 0 auto"))
        self.named = (label, self.part, self.view)

    @property
    def wanted(self) -> tuple[int, int] | None:
        """First and last frame as typed; None for the whole clip. Raises `WorkbenchError` for other texts."""
        parts = read_parts(self.part.value)
        return (parts[0][0], parts[-1][1]) if parts else None

    @property
    def usable(self) -> tuple[int, int] | None:
        """Like `wanted`, but None if the text is not a part of the clip."""
        try:
            part = self.wanted
            self._session.temporal.failed(part)
        except WorkbenchError:
            return None
        return part

    @property
    def whole(self) -> tuple[int, int]:
        """First and last frame, typed or of the whole clip."""
        return self.usable or (0, len(self._session) - 1)

    def begin_at(self, frame: int) -> None:
        """Begin the part at a frame, and end it with the clip if it ended by then; it has two frames at least."""
        end = len(self._session) - 1
        if end == 0:
            return
        frame, last = min(frame, end - 1), self.whole[1]
        self.part.value = f"{frame}-{last if last > frame else end}"

    def end_at(self, frame: int) -> None:
        """End the part at a frame, and begin it with the clip if it began there or later; two frames at least."""
        if len(self._session) == 1:
            return
        frame, first = max(frame, 1), self.whole[0]
        self.part.value = f"{first if first < frame else 0}-{frame}"

    def shorten(self, slow: bool, frame: int, length: int) -> None:
        """Fill in a short part around a frame once fits are slow, if none is typed; clear it once they are quick."""
        if slow == self._slow:
            return
        self._slow = slow
        if slow and not self.part.value.strip():
            last = len(self._session) - 1
            first = max(min(frame, last - length + 1), 0)
            self._short = f"{first}-{min(first + length - 1, last)}"
            self.part.value = self._short
        elif not slow:
            filled_in, self._short = self._short, ""
            if self.part.value == filled_in:
                self.part.value = ""

    def check(self, frame: int) -> None:
        """Raise `InputError` for a frame outside the chosen part."""
        first, last = self.whole
        if not first <= frame <= last:
            raise InputError(f"Frame {frame} is outside frames {first}-{last}; widen them first.")

    def show_frame(self, frame: int) -> None:
        """Update for the shown frame."""
        if not self.play.playing and self.play.min <= frame <= self.play.max:
            self.play.value = frame

    def limit_play(self) -> None:
        """Limit the player to the chosen part."""
        first, last = self.whole
        if (first, last) != (self.play.min, self.play.max):
            self._quiet = True  # the value moves into the range, but the shown frame stays
            try:
                self.play.min, self.play.max = 0, last
                self.play.min = first
            finally:
                self._quiet = False

    def _take_view(self) -> None:
        first, last = self._in_view()
        whole = (first, last) == (0, len(self._session) - 1)
        self.part.value = "" if whole else f"{first}-{last}"

    def _on_play(self, change) -> None:
        if not self._quiet:
            self._go(change["new"])


def note_of(fit: "workbench.tracking.FrameFit", config: Config) -> str:
    """A short note on a filled or marked frame of a clip; empty for others."""
    if fit.source == "filled":
        return f"frame {fit.index}: filled"
    return f"frame {fit.index}: marked as failed" if config.infill.named(fit.index) else ""
