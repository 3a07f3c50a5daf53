"""Infill and refinement in the panel: failed frames, methods, running them, and results before and after."""

import html
from collections.abc import Callable

import ipywidgets as widgets

from workbench.config import Config
from workbench.session import TuningSession
from workbench.session.knobs import METHODS, TIME
from workbench.session.parts import Part, frames_of, parts_of
from workbench.session.worked import Worked
from workbench.tracking import FrameFit
from workbench.widgets.clip_views import ClipViews
from workbench.widgets.controls import small_button
from workbench.widgets.failed_frames import FailedFrames
from workbench.widgets.knob_control import KnobControl, Turned
from workbench.widgets.methods_page import Methods
from workbench.widgets.status_line import LineAbout
from workbench.widgets.stoppable import Stoppable
from workbench.widgets.time_part import AFTER, BEFORE, TimePart

DEEP_FRAMES = 24
"""Length of the initial part with Deep Energies."""
NO_CLIP = (
    "<b>Infill and refinement need a clip.</b><br>They use consecutive frames, but {what}. Open a "
    "video, a folder with the frames of a clip, or its landmark file."
)
DEEP_NOTE = (
    "Deep Energies takes seconds per frame, so the clip is not re-fitted after every change: <i>run</i> first fits "
    "the frames given here, one by one. Start with a short part."
)
POINTS_NOTE = (
    "Only landmarks here: <i>flow</i>, <i>plate</i> and <i>hybrid</i> need pictures; the other methods do not."
)


class TimePage:
    """The controls page (`widget`) and the curves page (`methods`) for the clip of a session.

    `turned` is called with the path and value of a knob, `go` with a frame, `redraw` to show another side or result;
    `views` show the clip. Work is done in a separate thread; only the latest request counts.
    """

    def __init__(
        self, session: TuningSession, turned: Turned, go: Callable[[int], None], redraw: Callable[[], None],
        views: ClipViews,
    ) -> None:  # fmt: skip
        self._session = session
        self.frame, self._busy = 0, False
        self.running = False
        """Whether infill or refinement run."""
        self.knobs: dict[str, KnobControl] = {}
        self._views = views
        self.is_clip = len(session) > 1 and not session.material.stills
        self.played: TimePart | None = None
        """The part of the clip that is worked on and played."""
        layout = widgets.Layout(overflow="hidden auto")
        if not self.is_clip:
            what = "this is one photo" if len(session) == 1 else f"these are {len(session)} unrelated photos"
            self.widget = widgets.VBox([widgets.HTML(NO_CLIP.format(what=what))], layout=layout)
            self.methods = widgets.HTML(NO_CLIP.format(what=what))
            self._worker = None
            return
        self.methods = Methods(session, go)
        self.result = LineAbout(self._shown_now)
        self.cancel = small_button("cancel", "stop; finished results are kept")
        self._worker: Stoppable[str] = Stoppable(self._work, self.result.failed, "panel-time", self.cancel, "cancel")
        self.knobs = {knob.path: KnobControl(knob, turned) for knob in (*METHODS, *TIME)}
        views.timeline.observe(self._on_part, "loop")
        self._marks = FailedFrames(session, self.result, lambda: self.frame, lambda: self.run("flagged"))
        self.played = TimePart(session, self.show_config, go, redraw, views.in_view)
        # For scripts to press and read.
        self.this, self.flagged, self.clear = self._marks.this, self._marks.flagged, self._marks.clear
        self.range, self.mark, self.unmark = self._marks.range, self._marks.mark, self._marks.unmark
        self.summary, self.part, self.view = self._marks.summary, self.played.part, self.played.view
        self.sides, self.play = self.played.sides, self.played.play
        self.widget = widgets.VBox(self._rows(), layout=layout)
        self.show_config()

    # --- for scripts and tests ---

    @property
    def side(self) -> str:
        """`before` or `after`: the side that picture and head show."""
        return self.sides.value if self.is_clip else BEFORE

    def run(self, what: str = "run") -> None:
        """Request `run`, `compare`, `flagged` or `cancel`."""
        if self._worker is not None:
            (self._worker.submit if what == "cancel" else self._worker.ask)(what)

    def fill(self) -> None:
        """Mark the shown frame as failed and fill it and those marked before; one undo step.

        By the chosen method, on straight lines if none is chosen. Raises `InputError` outside the chosen part.
        """
        if not self.is_clip:
            return
        self.played.check(self.frame)
        infill, temporal = self._session.config.infill, self._session.temporal
        method = "linear" if infill.method == "none" else infill.method
        frames = parts_of(frames_of(temporal.marked) | {self.frame})
        self._session.set(f"fill frame {self.frame}", infill={"frames": frames, "method": method})
        self.run()

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait for the work; False if it takes longer."""
        return self._worker is None or self._worker.wait_idle(timeout_s)

    def close(self) -> None:
        """Stop the work and its thread."""
        if self._worker is not None:
            self._worker.close()

    # --- what the panel asks and tells ---

    def fit(self, frame: int) -> FrameFit | None:
        """The fit of a frame on the chosen side; None if the current settings have no result for it."""
        pair = self._pair(frame)
        return None if pair is None else pair[self.side == AFTER]

    def was_changed(self, fit: FrameFit) -> bool:
        """Whether a fit is what infill or refinement made of its frame."""
        before, after = self._pair(fit.index) or (fit, fit)
        return self.side == AFTER and fit is after and after is not before

    def _pair(self, frame: int) -> tuple[FrameFit, FrameFit] | None:
        worked = self._session.temporal.result(self.played.whole) if self.is_clip else None
        return None if worked is None else worked.pair(frame)

    def show_frame(self, frame: int) -> None:
        """Update for the shown frame."""
        self.frame = frame
        if self.is_clip:
            self.played.show_frame(frame)
            self.methods.show_frame(frame)

    def show_config(self) -> None:
        """Update from the configuration and the fits."""
        if not self.is_clip:
            return
        slow = not self._session.config.traits.real_time
        notes = [DEEP_NOTE] if slow else []
        notes += [] if self._session.material.pictures.real else [POINTS_NOTE]
        self.note.value = "<br>".join(notes)
        self.note.layout.display = None if notes else "none"
        self.played.shorten(slow, self.frame, DEEP_FRAMES)
        self._marks.show(self.played.usable)
        self.played.limit_play()
        self._views.timeline.loop = list(self.played.usable or ())
        self.show_result()

    def show_result(self) -> None:
        """Update from the results."""
        if not self.is_clip:
            return
        _, part, worked = self._shown_now()
        if not self._busy:
            self.result.show(result_html(worked))
        self.sides.disabled = worked is None and self.side == BEFORE
        self.sides.tooltips = [
            "the single-frame fits",
            "after infill and refinement" if worked else "not run with these settings yet",
        ]
        self.methods.show(part)

    # --- parts ---

    def _rows(self) -> list[widgets.Widget]:
        self.go = small_button("run", "infill and refine these frames with these settings", "primary")
        self.go.on_click(lambda _button: self.run("run"))
        self.compare = small_button("compare all", "run every method and keep the results; see the page Methods")
        self.compare.on_click(lambda _button: self.run("compare"))
        self.progress = widgets.IntProgress(0, max=1, layout=widgets.Layout(width="100%", height="6px", margin="0"))
        self.progress.layout.visibility = "hidden"
        self.note = widgets.HTML()
        for knob in self.knobs.values():
            knob.widget.layout.flex = "0 0 auto"  # otherwise a short page squeezes them
        return [
            *(in_row(*row) for row in self._marks.rows),
            self._marks.summary,
            *(self.knobs[knob.path].widget for knob in METHODS),
            in_row(*self.played.named),
            self.note,
            in_row(self.go, self.compare, self.cancel),
            self.progress,
            self.result,
            in_row(self.played.sides),
            widgets.HTML("<b>settings of the methods</b>"),
            *(self.knobs[knob.path].widget for knob in TIME),
        ]

    def _on_part(self, change) -> None:
        """A part was chosen in the strip."""
        chosen = tuple(change["new"])
        if chosen != (self.played.usable or ()):
            self.played.part.value = "{}-{}".format(*chosen) if chosen else ""

    def _shown_now(self) -> tuple[Config, Part, Worked | None]:
        """What the line of the result is about."""
        part = self.played.whole
        return self._session.config, part, self._session.temporal.result(part)

    # --- work, in the thread of the page ---

    def _work(self, wanted: str) -> None:
        if wanted == "cancel":
            self.result.say("Cancelled; finished results are kept.")
            return
        temporal, part = self._session.temporal, self.played.wanted
        self.progress.value, self.progress.layout.visibility, self._busy = 0, "visible", True
        try:
            if wanted == "flagged":
                flagged = temporal.mark_flagged(part, self._told, self._worker.newer)
                if not self._worker.newer():
                    self.result.say(f"{len(flagged)} flagged, marked as failed." if flagged else "No frame is flagged.")
                return
            self.running = True
            if wanted == "compare":
                done = temporal.compare(part, self._told, self._worker.newer)
            else:
                done = temporal.run(part, None, self._told, self._worker.newer)
            if done is not None:
                self._busy = False
                self.result.forget()
                self.sides.value = AFTER
                self.show_result()
        finally:
            self.progress.layout.visibility, self._busy, self.running = "hidden", False, False

    def _told(self, step: str, done: int, total: int | None) -> None:
        # Not for every frame, because too many updates make the browser fall behind.
        shown = max((total or len(self._session)) // 40, 1)
        if done % shown == 0 or done == 1:
            self.progress.max, self.progress.value = total or len(self._session), done
            self.result.say(f"{step} {done}" + (f" of {total}" if total else ""))


def in_row(*parts: widgets.Widget) -> widgets.Widget:
    """Controls side by side, at their natural height."""
    return widgets.HBox(parts, layout=widgets.Layout(align_items="center", flex="0 0 auto", width="auto"))


def result_html(worked: Worked | None) -> str:
    """The result of the current settings in one line."""
    if worked is None:
        return "<span style='opacity:.7'>not run with these settings yet</span>"
    first, last = worked.part
    filled = f", {len(worked.filled)} filled" if worked.filled else ""
    return f"<b>{html.escape(worked.name)}</b> {first}-{last}{filled}, {worked.seconds:.1f} s"
