"""The transport below the strip: play, step, speed, loop, first and last frame, and running the clip."""

from collections.abc import Callable

import ipywidgets as widgets

from workbench.widgets.clip_bar import ClipBar
from workbench.widgets.controls import menu, small_button
from workbench.widgets.panel_layout import classed, group
from workbench.widgets.time_part import TimePart

SPEEDS = {"¼×": 0.25, "½×": 0.5, "1×": 1.0, "2×": 2.0}
FASTEST_MS = 40
"""About the shortest time between two frames: rather than ask for more, the browser skips frames."""


class Transport:
    """A line of controls that moves through a clip: `step` is called with -1 or 1 for a frame, -2 or 2 for a flag.

    `part` is the part of the clip that is played and worked on; None for photos, which are only stepped through.
    """

    def __init__(self, bar: ClipBar, step: Callable[[int], None], frame: Callable[[], int], part: TimePart | None):
        self._frame, self._part = frame, part
        texts = (
            ("⚑◂", "previous flagged frame (P)", -2), ("◂", "previous frame (,)", -1),
            ("▸", "next frame (.)", 1), ("▸⚑", "next flagged frame (N)", 2),
        )  # fmt: skip
        self.steps = {by: small_button(text, tip) for text, tip, by in texts}
        for by, button in self.steps.items():
            button.on_click(lambda _button, by=by: step(by))
        parts = [group(*self.steps.values(), name="fw-steps")]
        if part is not None:
            self.speed = menu(SPEEDS, "58px", "playback speed", 1.0)
            self.speed.observe(lambda _change: self._show_speed(), "value")
            self._show_speed()
            self.first = small_button("[", "first frame to play and to work on: this one (I)")
            self.last = small_button("]", "last frame to play and to work on: this one (O)")
            self.whole = small_button("[ ]", "play and work on the whole clip")
            for button, what in ((self.first, "in"), (self.last, "out"), (self.whole, "whole")):
                button.on_click(lambda _button, what=what: self.mark(what))
            parts = [
                classed(part.play, "fw-play"), parts[0], group(self.speed), group(self.first, self.last, self.whole),
            ]  # fmt: skip
        parts += [group(bar.run_clip, bar.follow), bar.cancel, bar.progress, classed(bar.said, "fw-said")]
        self.widget = classed(widgets.HBox(parts), "fw-transport")

    def play(self) -> None:
        """Play, or pause."""
        if self._part is not None:
            self._part.play.playing = not self._part.play.playing

    def mark(self, what: str) -> None:
        """Begin ("in") or end ("out") the part at the shown frame, or take the "whole" clip."""
        if self._part is None:
            return
        if what == "whole":
            self._part.part.value = ""
        elif what == "in":
            self._part.begin_at(self._frame())
        else:
            self._part.end_at(self._frame())

    def _show_speed(self) -> None:
        play = self._part.play
        play.interval, play.step = paced(self._part.rate * self.speed.value)


def paced(rate: float) -> tuple[int, int]:
    """The milliseconds between two shown frames, and how many frames further the second is, for frames per second."""
    wanted = 1000.0 / rate
    step = max(1, round(FASTEST_MS / wanted))
    return round(step * wanted), step
