"""Infill and refinement in the panel: what counts as failed, methods, run, before and after, curves of all methods."""

import html
from collections.abc import Callable, Iterable

import ipywidgets as widgets
import numpy as np

from workbench.errors import WorkbenchError
from workbench.session import TuningSession
from workbench.session.knobs import METHODS, TIME
from workbench.session.temporal import (
    ANGLES,
    AS_FITTED,
    PLACES,
    Worked,
    curve,
    moving_weights,
    parts_of,
    parts_text,
    read_parts,
)
from workbench.tracking import FrameFit
from workbench.widgets.chart_view import COLORS, INK, YELLOW, ChartView
from workbench.widgets.controls import KnobControl, Turned, small_button
from workbench.widgets.latest import LatestWins

BEFORE, AFTER = "before", "after"
DEEP_FRAMES = 24
"""Length of the part that Deep Energies begins with."""
RATE = 25.0
"""Frames per second where the clip does not say."""
ONE_LEGEND = "<style>.fw-methods .fw-chart .fw-top { display: none; }</style>"
"""The charts of a row share the legend above them."""
NO_CLIP = (
    "<b>Infill and refinement need a clip.</b><br>They look at frames that follow each other in time; {what}. Open a "
    "video, a folder with the frames of a clip, or a landmark file of one."
)
DEEP_NOTE = (
    "Deep Energies takes seconds per frame, so the clip is not fitted at every change: <i>run</i> first fits the "
    "frames named here, one by one. Begin with a short part."
)
POINTS_NOTE = "Landmarks alone: <i>flow</i>, <i>plate</i> and <i>hybrid</i> look at pictures; the others do not."


class TimePage:
    """The page of controls (`widget`) and the page of curves (`methods`) over the clip of a session.

    `turned` is called with the path and value of a knob, `go` with a frame, `redraw` when another side or result is to
    be shown, `in_view` gives the first and last frame that the strip shows. Work is done in a thread of its own; of
    requests the newest counts.
    """

    def __init__(
        self, session: TuningSession, turned: Turned, go: Callable[[int], None], redraw: Callable[[], None],
        in_view: Callable[[], tuple[int, int]], height_px: int,
    ) -> None:  # fmt: skip
        self._session, self._turned, self._go, self._redraw, self._in_view = session, turned, go, redraw, in_view
        self.frame, self._busy, self._quiet = 0, False, False
        self.knobs: dict[str, KnobControl] = {}
        self.is_clip = len(session) > 1 and not session.material.stills
        layout = widgets.Layout(height=f"{height_px - 34}px", overflow="hidden auto")
        if not self.is_clip:
            what = "this is one photo" if len(session) == 1 else f"these are {len(session)} unrelated photos"
            self.widget = widgets.VBox([widgets.HTML(NO_CLIP.format(what=what))], layout=layout)
            self.methods = widgets.HTML(NO_CLIP.format(what=what))
            self._worker = None
            return
        self._worker: LatestWins[str] = LatestWins(self._work, self._failed, "panel-time")
        self.methods = Methods(session, go)
        self.knobs = {knob.path: KnobControl(knob, turned) for knob in (*METHODS, *TIME)}
        self.widget = widgets.VBox(self._rows(), layout=layout)
        self.show_config()

    # --- for scripts and tests ---

    @property
    def side(self) -> str:
        """`before` or `after`: what picture and head show."""
        return self.sides.value if self.is_clip else BEFORE

    def run(self, what: str = "run") -> None:
        """Ask for `run`, `compare`, `flagged` or `cancel`."""
        if self._worker is not None:
            self._worker.submit(what)

    def wait_idle(self, timeout_s: float | int) -> bool:
        """Wait for the work; False if it takes longer."""
        return self._worker is None or self._worker.wait_idle(timeout_s)

    def close(self) -> None:
        """End the work and its thread."""
        if self._worker is not None:
            self._worker.close()

    # --- what the panel asks and tells ---

    def fit(self, frame: int) -> FrameFit | None:
        """The fit of a frame on the chosen side; None where the present settings have no result for it."""
        if not self.is_clip:
            return None
        worked = self._session.temporal.result(self._worked_part())
        pair = None if worked is None else worked.pair(frame)
        return None if pair is None else pair[self.side == AFTER]

    def note_of(self, fit: FrameFit) -> str:
        """What is special about a frame, in a few words; empty if nothing is."""
        if not self.is_clip:
            return ""
        if fit.source == "filled":
            return f"frame {fit.index}: filled"
        return f"frame {fit.index}: marked as failed" if self._session.config.infill.named(fit.index) else ""

    def show_frame(self, frame: int) -> None:
        """Follow the shown frame."""
        self.frame = frame
        if self.is_clip:
            if not self.play.playing and self.play.min <= frame <= self.play.max:
                self.play.value = frame
            self.methods.show_frame(frame)

    def show_config(self) -> None:
        """Follow the configuration and the fits."""
        if not self.is_clip:
            return
        slow = not self._session.config.traits.real_time
        notes = [DEEP_NOTE] if slow else []
        notes += [] if self._session.material.pictures.real else [POINTS_NOTE]
        self.note.value = "<br>".join(notes)
        self.note.layout.display = None if notes else "none"
        if slow and not self.part.value.strip():
            last = len(self._session) - 1
            first = max(min(self.frame, last - DEEP_FRAMES + 1), 0)
            self.part.value = f"{first}-{min(first + DEEP_FRAMES - 1, last)}"
        self.summary.value = failed_html(self._session, self._part_or_none())
        self._limit_play()
        self.show_result()

    def show_result(self) -> None:
        """Follow the results."""
        if not self.is_clip:
            return
        part = self._worked_part()
        worked = self._session.temporal.result(part)
        if not self._busy:
            self.result.value = result_html(worked)
        self.sides.tooltips = [
            "the fits of single frames",
            "after infill and refinement" if worked else "not run with these settings yet",
        ]
        self.methods.show(part)

    # --- parts ---

    def _rows(self) -> list[widgets.Widget]:
        self.this = small_button("this frame", "toggle failed for the shown frame")
        self.this.on_click(lambda _button: self._guarded(self._mark_this))
        self.flagged = small_button("⚑ flagged", "the frames that diagnosis flags have failed")
        self.flagged.on_click(lambda _button: self.run("flagged"))
        self.clear = small_button("clear", "no frame is marked")
        self.clear.on_click(lambda _button: self._guarded(self._clear))
        self.range = widgets.Text(
            placeholder="40-52, 60", tooltip="frames, first and last", layout=_narrow(), continuous_update=False
        )
        self.mark = small_button("mark", "these frames have failed, whatever their fit")
        self.mark.on_click(lambda _button: self._guarded(self._mark_range, self._session.temporal.mark))
        self.unmark = small_button("unmark", "these frames stand as they were fitted")
        self.unmark.on_click(lambda _button: self._guarded(self._mark_range, self._session.temporal.unmark))
        self.summary = widgets.HTML()
        self.part = widgets.Text(
            placeholder="whole clip", tooltip="frames that are worked on, first and last; empty: the whole clip",
            layout=_narrow(), continuous_update=False,
        )  # fmt: skip
        self.part.observe(lambda _change: self.show_config(), "value")
        self.view = small_button("in view", "the frames that the strip shows")
        self.view.on_click(lambda _button: self._take_view())
        self.go = small_button("▶ run", "work on these frames with these settings", "primary")
        self.go.on_click(lambda _button: self.run("run"))
        self.compare = small_button("compare all", "run every method and keep the results: see the page Methods")
        self.compare.on_click(lambda _button: self.run("compare"))
        self.cancel = small_button("cancel", "stop; finished results stay")
        self.cancel.on_click(lambda _button: self.run("cancel"))
        self.progress = widgets.IntProgress(0, max=1, layout=widgets.Layout(width="100%", height="6px", margin="0"))
        self.progress.layout.visibility = "hidden"
        self.result = widgets.HTML()
        self.note = widgets.HTML()
        self.sides = widgets.ToggleButtons(options=[BEFORE, AFTER], style={"button_width": "auto"})
        self.sides.add_class("fw-sides")
        self.sides.observe(lambda _change: self._redraw(), "value")
        rate = getattr(self._session.material.pictures.frames, "rate", None) or RATE
        self.play = widgets.Play(
            min=0, max=len(self._session) - 1, interval=max(40, round(1000.0 / rate)), show_repeat=True,
            layout=widgets.Layout(width="auto"),
        )  # fmt: skip
        self.play.observe(self._on_play, "value")

        def row(*children) -> widgets.Widget:
            return widgets.HBox(children, layout=widgets.Layout(align_items="center", flex="0 0 auto", width="auto"))

        label = widgets.HTML("<b>failed</b>", layout=widgets.Layout(width="38px", flex="0 0 auto"))
        part = widgets.HTML("<b>frames</b>", layout=widgets.Layout(width="44px", flex="0 0 auto"))
        for knob in self.knobs.values():
            knob.widget.layout.flex = "0 0 auto"  # else a short page presses them flat
        settings = [self.knobs[knob.path].widget for knob in TIME]
        return [
            row(label, self.this, self.flagged, self.clear),
            row(self.range, self.mark, self.unmark),
            self.summary,
            *(self.knobs[knob.path].widget for knob in METHODS),
            row(part, self.part, self.view),
            self.note,
            row(self.go, self.compare, self.cancel),
            self.progress,
            self.result,
            row(self.sides, self.play),
            widgets.HTML("<b>settings of the methods</b>"),
            *settings,
        ]

    # --- what the user does ---

    def _mark_this(self) -> None:
        temporal = self._session.temporal
        marked = any(first <= self.frame <= last for first, last in temporal.marked)
        (temporal.unmark if marked else temporal.mark)([self.frame])

    def _mark_range(self, act: Callable) -> None:
        parts = read_parts(self.range.value)
        if not parts:
            self._say("Name frames first, as 40-52 or 60.", wrong=True)
            return
        act(frame for first, last in parts for frame in range(first, last + 1))

    def _clear(self) -> None:
        marked = self._session.temporal.marked
        self._session.temporal.unmark(frame for first, last in marked for frame in range(first, last + 1))

    def _take_view(self) -> None:
        first, last = self._in_view()
        whole = (first, last) == (0, len(self._session) - 1)
        self.part.value = "" if whole else f"{first}-{last}"

    def _part(self) -> tuple[int, int] | None:
        parts = read_parts(self.part.value)
        return (parts[0][0], parts[-1][1]) if parts else None

    def _part_or_none(self) -> tuple[int, int] | None:
        try:
            part = self._part()
            self._session.temporal.failed(part)
        except WorkbenchError:
            return None
        return part

    def _worked_part(self) -> tuple[int, int]:
        return self._part_or_none() or (0, len(self._session) - 1)

    def _limit_play(self) -> None:
        """Play the part that is worked on."""
        first, last = self._worked_part()
        if (first, last) != (self.play.min, self.play.max):
            self._quiet = True  # the value moves into its range, the shown frame stays
            try:
                self.play.min, self.play.max = 0, last
                self.play.min = first
            finally:
                self._quiet = False

    def _on_play(self, change) -> None:
        if not self._quiet:
            self._go(change["new"])

    def _guarded(self, act: Callable, *arguments: object) -> None:
        try:
            act(*arguments)
        except WorkbenchError as error:
            self._say(str(error), wrong=True)

    # --- work, in the thread of the page ---

    def _work(self, wanted: str) -> None:
        if wanted == "cancel":
            self._say("Cancelled; what was finished stays.")
            return
        temporal, part = self._session.temporal, self._part()
        self.progress.value, self.progress.layout.visibility, self._busy = 0, "visible", True
        try:
            if wanted == "flagged":
                flagged = temporal.mark_flagged(part, self._told, self._worker.newer)
                if not self._worker.newer():
                    self._say(f"{len(flagged)} flagged, marked as failed." if flagged else "No frame is flagged.")
                return
            if wanted == "compare":
                done = temporal.compare(part, self._told, self._worker.newer)
            else:
                done = temporal.run(part, None, self._told, self._worker.newer)
            if done is not None:
                self._busy = False
                self.sides.value = AFTER
                self.show_result()
        finally:
            self.progress.layout.visibility, self._busy = "hidden", False

    def _told(self, step: str, done: int, total: int | None) -> None:
        # Not every frame: a browser that is told too often falls behind.
        shown = max((total or len(self._session)) // 40, 1)
        if done % shown == 0 or done == 1:
            self.progress.max, self.progress.value = total or len(self._session), done
            self._say(f"{step} {done}" + (f" of {total}" if total else ""))

    def _say(self, text: str, wrong: bool = False) -> None:
        color = "color:var(--jp-error-color1, #b3261e)" if wrong else ""
        self.result.value = f"<span style='{color}'>{html.escape(text)}</span>"

    def _failed(self, error: Exception) -> None:
        self._say(str(error) if isinstance(error, WorkbenchError) else f"{type(error).__name__}: {error}", wrong=True)


class Methods(widgets.VBox):
    """The curves of every method that was run on the same part, one line a method, and their numbers."""

    def __init__(self, session: TuningSession, go: Callable[[int], None]) -> None:
        self._session = session
        names = list(session.model.expression_names)
        self.charts = [ChartView(height_px=150, title="") for _ in range(4)]
        first = names.index("jawOpen") if "jawOpen" in names else 0
        turns = [(f"rotation: {name}", name) for name in ANGLES]
        places = [(f"place: {name}", name) for name in PLACES]
        options = [(turns, "yaw"), (places, "z"), (names, names[first]), (names, names[-1])]
        self.quantities = [
            widgets.Dropdown(
                options=choices, value=value, layout=widgets.Layout(width="130px"), tooltip="what is drawn"
            )
            for choices, value in options
        ]
        self._chosen, self._part = False, None
        for chart, quantity in zip(self.charts, self.quantities, strict=True):
            chart.on_pick(lambda x: go(round(x)))
            quantity.observe(lambda _change: self._draw(), "value")
        self.shown = widgets.ToggleButtons(
            options=["all", "infill", "refinement"], style={"button_width": "auto"},
            tooltips=["every result", "results of infill alone", "results with a refinement"],
        )  # fmt: skip
        self.shown.observe(lambda _change: self._draw(), "value")
        self.legend = widgets.HTML(layout=widgets.Layout(min_width="0", flex="1 1 0"))
        self.table = widgets.HTML(layout=widgets.Layout(min_width="0"))
        style = widgets.HTML(ONE_LEGEND, layout=widgets.Layout(display="none"))
        head = widgets.HBox([self.shown, self.legend], layout=widgets.Layout(align_items="center", flex="0 0 auto"))
        cells = [
            widgets.VBox([quantity, chart], layout=widgets.Layout(width="25%", min_width="0"))
            for quantity, chart in zip(self.quantities, self.charts, strict=True)
        ]
        super().__init__([style, head, widgets.HBox(cells), self.table])
        self.add_class("fw-methods")
        self.show()

    def show_frame(self, frame: int) -> None:
        """Move the cursors."""
        for chart in self.charts:
            chart.cursor = float(frame)

    def show(self, part: tuple[int, int] | None = None) -> None:
        """Show what the session keeps, on a part if there are results for it."""
        self._part = part
        results = self._session.temporal.comparable(part)
        self.table.value = numbers_html(results)
        if results and not self._chosen:
            self._chosen = True
            worked = next(iter(results.values()))
            most = moving_weights(worked.before, list(self._session.model.expression_names), 2)
            for quantity, name in zip(self.quantities[2:], most, strict=True):
                quantity.value = name
        self._draw()

    def _draw(self) -> None:
        results = self._session.temporal.comparable(self._part)
        shown = chosen(results, self.shown.value)
        self.legend.value = legend_html(shown, colors_of(results)) if shown else ""
        names = list(self._session.model.expression_names)
        for chart, quantity in zip(self.charts, self.quantities, strict=True):
            unit = "degrees" if quantity.value in ANGLES else "mm" if quantity.value in PLACES else "weight"
            if not shown:
                chart.set_series(np.zeros(0), {})
                continue
            worked = next(iter(shown.values()))
            frames = np.arange(worked.part[0], worked.part[1] + 1, dtype=float)
            lines = {BEFORE: curve(worked.before, quantity.value, names)}
            lines |= {name: curve(item.after, quantity.value, names) for name, item in shown.items()}
            chart.set_series(
                frames, lines, colors=colors_of(results), y_label=unit, x_label="frame", selected=longest_gap(worked)
            )


def _narrow() -> widgets.Layout:
    return widgets.Layout(width="84px", flex="1 1 auto", min_width="0")


def chosen(results: dict[str, Worked], kind: str) -> dict[str, Worked]:
    """The results of a kind: `infill` (without refinement), `refinement`, or `all`."""
    if kind == "all":
        return results
    wanted = {"infill": False, "refinement": True}[kind]
    return {
        name: worked
        for name, worked in results.items()
        if (worked.config.refinement.method != "none" or worked.config.refinement.reestimate > 0) == wanted
    }


def colors_of(results: Iterable[str]) -> dict[str, str]:
    """A colour a method, the same in every chart; the fits of single frames in the ink of the page."""
    return {BEFORE: INK} | {name: LINES[k % len(LINES)] for k, name in enumerate(results)}


def legend_html(names: Iterable[str], colors: dict[str, str]) -> str:
    """What the lines are, for all charts."""
    line = "<i style='display:inline-block;width:16px;border-top:2px solid {};margin:0 4px 3px 10px'></i>{}"
    inks = {name: "currentColor" if color == INK else color for name, color in colors.items()}
    keys = [line.format(inks[name], html.escape(name)) for name in (BEFORE, *names)]
    return "".join(f"<span style='white-space:nowrap'>{key}</span> " for key in keys)


def longest_gap(worked: Worked) -> tuple[float, float] | None:
    """First and last frame of the longest part that was filled, with half a frame on each side."""
    parts = parts_of(worked.filled)
    if not parts:
        return None
    first, last = max(parts, key=lambda part: part[1] - part[0])
    return first - 0.5, last + 0.5


def failed_html(session: TuningSession, part: tuple[int, int] | None) -> str:
    """Which frames are marked, and how many others fail, in a line."""
    temporal = session.temporal
    marked = temporal.marked
    count = sum(last - first + 1 for first, last in marked)
    inside = {frame for first, last in marked for frame in range(first, last + 1)}
    others = len([frame for frame in temporal.failed(part) if frame not in inside])
    text = f"marked: {html.escape(parts_text(marked, 4))}" if count else "none marked"
    if count > 1:
        text += f" ({count} frames)"
    return text + (f"; {others} more without a good fit" if others else "")


def result_html(worked: Worked | None) -> str:
    """The result of the present settings in a line."""
    if worked is None:
        return "<span style='opacity:.7'>not run with these settings yet</span>"
    first, last = worked.part
    filled = f", {len(worked.filled)} filled" if worked.filled else ""
    return f"<b>{html.escape(worked.name)}</b> {first}-{last}{filled}, {worked.seconds:.1f} s"


def numbers_html(results: dict[str, Worked]) -> str:
    """The numbers of every result as a table."""
    if not results:
        return (
            "<span style='opacity:.7'>Nothing to compare yet: on the page <b>time</b> beside the picture, "
            "<i>run</i> a method, or <i>compare all</i>.</span>"
        )

    def cell(numbers: dict[str, float], name: str, form: str) -> str:
        return f"<td>{format(numbers[name], form)}</td>" if name in numbers else "<td>–</td>"

    before = next(iter(results.values()))
    fitted = Worked(AS_FITTED, before.config, before.part, before.before, before.before, 0.0).numbers()
    fitted.pop("seconds")
    rows = []
    for name, numbers in ((AS_FITTED, fitted), *((name, worked.numbers()) for name, worked in results.items())):
        cells = [cell(numbers, *column) for column in COLUMNS]
        rows.append(f"<tr><td>{html.escape(name)}</td>{''.join(cells)}</tr>")
    head = (
        "<tr><th>method</th><th>filled</th><th title='mean second difference of the rotation'>jitter, °</th>"
        "<th title='against the landmarks, filled frames left out'>error, %</th>"
        "<th title='filled frames against landmarks that were hidden from infill'>error of filled, %</th>"
        "<th>seconds</th></tr>"
    )
    return f"<table>{head}{''.join(rows)}</table>"


LINES = (*(color for color in COLORS if color not in (INK, YELLOW)), "#9467d6")
"""A purple stands for the yellow, which is lost on a white page."""
COLUMNS = (
    ("filled", ".0f"), ("jitter_deg", ".3f"), ("error_percent", ".2f"), ("hidden_percent", ".2f"), ("seconds", ".1f")
)  # fmt: skip
"""Numbers of a result and how they are written."""
