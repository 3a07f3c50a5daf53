"""The panel: every knob of a session, the picture, the head, the clip and the diagnosis, all following each other."""

import html
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ipywidgets as widgets
import numpy as np

from workbench.config import PRESETS, preset
from workbench.diagnosis import Change, vertex_uncertainty
from workbench.errors import WorkbenchError
from workbench.session import FittedHead, TuningSession
from workbench.session.exports import exported_for, free_file
from workbench.session.gesture import Gesture
from workbench.session.knobs import changed_by
from workbench.tracking import FrameFit, StageTrace
from workbench.tracking.failures import why_failed
from workbench.widgets.chart_view import ChartView
from workbench.widgets.clip_views import ClipViews
from workbench.widgets.controls import Controls, small_button
from workbench.widgets.diagnosis_view import DiagnosisView
from workbench.widgets.drag_watch import DragWatch
from workbench.widgets.film_strip import FilmStrip
from workbench.widgets.head_column import HeadColumn
from workbench.widgets.landmark_tools import LandmarkTools
from workbench.widgets.latest import LatestWins
from workbench.widgets.stage_editor import StageEditor
from workbench.widgets.time_page import AFTER, TimePage

CONTROLS_PX, HEAD_PX = 262, 304
TABS_PX = 190
STYLE = """<style>
.fw-panel { --jp-widgets-inline-height: 24px; --jp-widgets-font-size: 12px; max-width: 1500px; }
.fw-panel .jupyter-button { padding: 0 5px; line-height: 22px; }
.fw-panel .jupyter-widget-Tab > .jupyter-widget-TabPanel-tabContents, .fw-panel .widget-tab-contents { padding: 4px; }
.fw-panel .lm-TabBar-tab { min-width: 0; flex: 0 1 auto; padding: 0 6px; font-size: 12px; }
.fw-panel .fw-controls .lm-TabBar-tab { flex: 1 1 auto !important; padding: 0 3px !important; }
.fw-panel .widget-html-content, .fw-panel .jupyter-widget-html-content { line-height: 18px; font-size: 12px; }
.fw-panel .fw-status code { white-space: nowrap; font-size: 12px; }
.fw-panel table { font-size: 12px; }
.fw-panel td, .fw-panel th { padding: 0 6px; text-align: left; }
</style>"""
PAUSE_S = 0.1
SETTLED_S = 0.3
"""Quiet time after the last change before the whole clip, or an exact identity, is fitted."""
LIVE_CLIP_FRAMES = 1500
"""Clips up to this length are re-fitted after each change unless the user switches that off."""
STATUS_NAMES = {-1: "", 1: "converged", 2: "limit", 3: "stalled", 4: "not finite"}


@dataclass(frozen=True)
class Show:
    """What the worker is asked for: the fit of a frame."""

    frame: int
    coarse: bool = False
    """Whether the identity may be that of an earlier configuration."""
    steps: int | None = None
    """Stop after that many iterations; None runs all stages."""


class TuningPanel(widgets.VBox):
    """A view on a `TuningSession`: whoever changes the session, the panel follows.

    Callbacks hand over to a worker, of which only the newest request counts; results are shown from its thread.
    `wait_idle` waits for it, for scripts and tests.
    """

    def __init__(self, session: TuningSession, backend: str = "auto", height_px: int = 372) -> None:
        self.session, self.frame = session, 0
        self._stop_export = threading.Event()
        self._taken = Path()
        self._head = FittedHead(session.model)
        self._held: str | None = None
        self._steps: int | None = None
        self._closed = False
        self.fit: FrameFit | None = None
        self._traces: tuple[StageTrace, ...] = ()
        self.status = widgets.HTML(layout=widgets.Layout(min_width="0", flex="1 1 0", overflow="hidden"))
        self.status.add_class("fw-status")
        self._worker: LatestWins[Show] = LatestWins(self._refit, self._failed, "panel-fit")
        self._clip_worker: LatestWins[str] = LatestWins(self._run_clip, self._failed, "panel-clip")
        self._slow = ThreadPoolExecutor(max_workers=1, thread_name_prefix="panel-slow")
        self._build(backend, height_px)
        self._leave = session.listen(self._on_session)
        style = widgets.HTML(STYLE, layout=widgets.Layout(display="none"))
        strip = [self.clip.timeline] if self._is_clip else []
        self.drags = DragWatch()
        super().__init__([style, self.drags, self._history_bar(), self._file_bar(), self._main, *strip, self.tabs])
        self.add_class("fw-panel")
        self._show_session()
        self.overlay.show_picture(0)
        self._worker.submit(Show(0))
        self._clip_worker.submit("settle" if self._is_slow else "run")
        self._later(self._warm_up)

    def __repr__(self) -> str:
        return f"TuningPanel({self.session!r})"

    # --- for scripts and tests ---

    def go(self, frame: int) -> None:
        """Show another frame."""
        frame = int(np.clip(frame, 0, len(self.session) - 1))
        if frame != self.frame:
            self.frame, self._steps = frame, None
            if self._is_clip:
                self.clip.show_frame(frame)
            self.time.show_frame(frame)
            self.diagnosis.clear()
            self._worker.submit(Show(frame))

    def turn(self, path: str, value: Any) -> None:
        """Turn a knob as a user would; `session.knobs.KNOBS` lists the paths."""
        self.controls.by_path[path].turn(value)

    def wait_idle(self, timeout_s: float | int = 60.0) -> bool:
        """Wait until everything that was asked for is shown; False if that takes longer."""
        try:
            self._slow.submit(int).result(timeout_s)
        except TimeoutError:
            return False
        # A fit asks for layers and colours, and finished colours for the fit to be shown again.
        workers = (self.time, self._clip_worker, self._worker, self.overlay, self.head, self._worker)
        return all(worker.wait_idle(timeout_s) for worker in workers)

    def close(self) -> None:
        """Stop following the session, end the threads and free the views."""
        if self._closed:
            return
        self._closed = True
        self._leave()
        self._stop_export.set()
        for worker in (self.time, self._worker, self._clip_worker):
            worker.close()
        self._slow.shutdown(wait=False, cancel_futures=True)
        self.overlay.close()
        self.head.close()
        super().close()

    # --- parts ---

    @property
    def _is_clip(self) -> bool:
        return len(self.session) > 1

    @property
    def _is_slow(self) -> bool:
        """Whether a clip is only run when asked for: Deep Energies takes seconds per frame."""
        return self._is_clip and self.session.config.system == "deep-energies"

    def _build(self, backend: str, height_px: int) -> None:
        session = self.session
        self.controls = Controls(session.config, self._on_knob, height_px)
        self.overlay = LandmarkTools(session, self._head, height_px - 96, self.say, self._redraw)
        self.overlay.view.observe(self._on_webgl, "webgl")
        size = (HEAD_PX, height_px - 64)
        self.head = HeadColumn(session, self._head, size, backend, self._uncertainty, self._redraw)
        self.clip = ClipViews(session, self.go)
        self.time = TimePage(session, self._on_knob, self.go, self._redraw, self._in_view, height_px)
        self.controls.add("time", self.time.widget, self.time.knobs, session.config)
        self.stages = StageEditor(self._on_stages, self._on_run, TABS_PX)
        self.diagnosis = DiagnosisView(self._on_why, self._on_apply, self._on_take_back, TABS_PX)
        self.energy = ChartView(height_px=TABS_PX - 20, y_log=True, title="energy per term against iteration")
        self.strip = FilmStrip(session)
        self.changes = widgets.HTML(layout=widgets.Layout(height=f"{TABS_PX}px", overflow="auto"))
        columns = f"{CONTROLS_PX}px minmax(240px, 1fr) {HEAD_PX + 6}px"
        self._main = widgets.GridBox(
            [self.controls.widget, self.overlay.widget, self.head.widget],
            layout=widgets.Layout(grid_template_columns=columns, grid_gap="6px", width="100%"),
        )
        pages = {"Energy": self.energy, "Stages": self.stages.widget, "Diagnosis": self.diagnosis.widget}
        if self._is_clip:
            pages["Curves"] = self.clip.curves
        if self.time.is_clip:
            pages["Methods"] = self.time.methods
        pages["Film strip"] = self.strip
        pages["Changes"] = self.changes
        self.tabs = widgets.Tab(children=list(pages.values()), titles=list(pages))

    def _history_bar(self) -> widgets.Widget:
        self.undo, self.redo = (
            small_button("↶ undo", "take back the last change"),
            small_button("↷ redo", "make it again"),
        )
        self.undo.on_click(lambda _button: self.session.undo())
        self.redo.on_click(lambda _button: self.session.redo())
        self.reset = widgets.Dropdown(
            options=self._resets(), value="", tooltip="go to a preset, the start or a snapshot; undo brings you back",
            layout=widgets.Layout(width="88px"),
        )  # fmt: skip
        self.reset.observe(self._on_reset, "value")
        self.name = widgets.Text(
            placeholder="snapshot name", tooltip="name of a snapshot", layout=widgets.Layout(width="92px")
        )
        self.keep = small_button("keep", "keep the present configuration under this name")
        self.keep.on_click(lambda _button: self._guarded(self._on_keep))
        return widgets.HBox(
            [self.undo, self.redo, self.reset, self.name, self.keep, self.status],
            layout=widgets.Layout(align_items="center"),
        )

    def _file_bar(self) -> widgets.Widget:
        self.run_clip = small_button("▶ run clip" if self._is_clip else "▶ run", "fit all frames")
        self.run_clip.on_click(lambda _button: self._clip_worker.submit("run"))
        self.cancel = small_button("cancel", "stop the run or the export; the last whole run stays")
        self.cancel.on_click(lambda _button: self._on_cancel())
        self.follow = widgets.ToggleButton(
            value=len(self.session) <= LIVE_CLIP_FRAMES, description="live",
            layout=widgets.Layout(width="auto", flex="0 0 auto"),
            tooltip="fit the whole clip again after each change",
        )  # fmt: skip
        self.progress = widgets.IntProgress(
            0, max=len(self.session), layout=widgets.Layout(width="120px", visibility="hidden")
        )
        self.step_buttons = [
            small_button("◀", "frame before"),
            small_button("▶", "next frame"),
            small_button("⚑", "next flagged frame"),
        ]
        for button, to in zip(self.step_buttons, (-1, 1, 0), strict=True):
            button.on_click(lambda _button, to=to: self.go(self.frame + to if to else self._next_flagged()))
        self.file = widgets.Text(
            "tuned.toml", tooltip="file of the configuration", continuous_update=False,
            layout=widgets.Layout(width="150px"),
        )  # fmt: skip
        self.export = small_button("export", "write the configuration with its provenance")
        self.export.on_click(lambda _button: self._later(self._on_export))
        self.overwrite = small_button("overwrite", "write over the file that is there")
        self.overwrite.layout.display = "none"
        self.overwrite.on_click(lambda _button: self._later(self._on_overwrite))
        self.exported = widgets.HTML(layout=widgets.Layout(min_width="0", flex="1 1 auto"))
        clip = [*self.step_buttons, self.run_clip, self.follow, self.cancel, self.progress] if self._is_clip else []
        return widgets.HBox(
            [*clip, self.file, self.export, self.overwrite, self.exported], layout=widgets.Layout(align_items="center")
        )

    # --- what the user does ---

    def _later(self, job: Callable[[], None]) -> None:
        """Do a slow job in order, apart from the fits."""

        def guarded() -> None:
            try:
                job()
            except Exception as error:
                self._failed(error)

        self._slow.submit(guarded)

    def _guarded(self, act, *arguments) -> None:
        try:
            act(*arguments)
        except WorkbenchError as error:
            self.say(str(error), wrong=True)

    def _on_knob(self, path: str, value: Any) -> None:
        self._held = path
        try:
            gesture = Gesture(path, self.drags.drag)
            self._guarded(lambda: self.session.set(path, gesture, **changed_by(self.session.config, path, value)))
        finally:
            self._held = None

    def _on_stages(self, stages: list[dict], label: str) -> None:
        try:
            self.session.set(label, stages=stages)
        except WorkbenchError as error:
            self.say(str(error), wrong=True)
            self.stages.show(self.session.config)

    def _on_run(self, what: str, number: int) -> None:
        if self.fit is None or not self.fit.found:
            return
        counts = self._counts()
        total = sum(counts.values())
        if what == "all":
            self._steps = None
        elif what == "here":
            names = [stage.name for stage in self.session.config.stages[: number + 1]]
            self._steps = sum(count for name, count in counts.items() if name in names)
        else:
            now = total if self._steps is None else self._steps
            self._steps = int(np.clip(now + (1 if what == "step" else -1), 0, total))
            if what == "step" and now == total:
                self._steps = 0  # from the end a step begins again at the start
        self._worker.submit(Show(self.frame, steps=self._steps))

    def _on_reset(self, change) -> None:
        if change["new"]:
            kind, _, name = change["new"].partition(":")
            self.reset.value = ""
            if kind == "preset":
                self.session.use(preset(name), f"preset {name}")
            elif kind == "start":
                self.session.use(self.session.base, "the start")
            else:
                self._guarded(self.session.restore_snapshot, name)

    def _on_keep(self) -> None:
        name = self.name.value.strip() or f"snapshot {len(self.session.snapshots) + 1}"
        self.session.take_snapshot(name)
        self.name.value = ""
        self.say(f"Kept {name!r}: the menus go back to it and compare with it.")

    def _on_why(self) -> None:
        self.diagnosis.clear(f"Looking at frame {self.frame} …")
        self._later(self._diagnose)

    def _on_apply(self, change: Change) -> None:
        self._guarded(self.session.apply, change, self.frame)

    def _on_take_back(self) -> None:
        self.session.undo()

    def _on_export(self) -> None:
        path = Path(self.file.value.strip() or "tuned.toml")
        if path.suffix != ".toml":
            path = path.with_name(path.name + ".toml")
        if self.session.may_write(path):
            self._export(path)
        else:
            self._offer(path)

    def _offer(self, taken: Path) -> None:
        """A choice between a free name, which stands in the field now, and the file that is there."""
        free = free_file(taken.parent, self.session.material.name)
        whose = exported_for(taken)
        self._taken, self.file.value = taken, str(free)
        self.overwrite.description, self.overwrite.layout.display = f"overwrite {taken.name}", None
        self.exported.value = html.escape(
            f"{taken.name} is there already{f', exported for {whose}' if whose else ''}: "
            f"export again writes {free.name}."
        )

    def _on_overwrite(self) -> None:
        self.file.value = str(self._taken)
        self._export(self._taken)

    def _export(self, path: Path) -> None:
        self._stop_export.clear()
        self.overwrite.layout.display = "none"

        def progress(step: str, done: int, total: int | None) -> None:
            if done % 10 == 0 or done == total:
                self.exported.value = f"{step} {done} of {total} …"

        try:
            self.session.export(path, progress, self._stop_export.is_set, overwrite=True)
        except WorkbenchError:
            self.exported.value = ""
            raise
        command = html.escape(self.session.command(path))
        self.exported.value = f"wrote {html.escape(str(path))}; the same numbers headless: <code>{command}</code>"

    def _on_cancel(self) -> None:
        self._stop_export.set()
        self._clip_worker.submit("cancel")

    def _on_webgl(self, change) -> None:
        if change["new"] is False and self.head.view.note is None:
            self.head.use_pictures("This browser has no WebGL: the head comes as pictures from the kernel.")

    def _in_view(self) -> tuple[int, int]:
        first, last = self.clip.timeline.in_view
        return (first, last) if last > first else (0, len(self.session) - 1)

    def _next_flagged(self) -> int:
        flagged = self.clip.timeline.flagged
        return next((frame for frame in flagged if frame > self.frame), flagged[0] if flagged else self.frame)

    # --- what the session tells ---

    def _on_session(self, what: str) -> None:
        if self._closed:
            return
        if what == "config":
            self._steps = None
            self._show_session()
            self._worker.submit(Show(self.frame, coarse=self._is_clip))
            self._clip_worker.submit("settle")
        elif what == "run":
            self._guarded(self._show_run)
        elif what == "time":
            self.time.show_result()
            self._redraw()
        elif what == "snapshots":
            self.reset.options = self._resets()
            self.head.refresh_comparisons()

    def _show_session(self) -> None:
        config = self.session.config
        self.controls.show(config, but=self._held)
        self.stages.show(config)
        self.strip.show_config()
        self.overlay.refresh_groups()
        self.time.show_config()
        self.clip.timeline.marked = [list(part) for part in config.infill.frames]
        self.undo.disabled, self.redo.disabled = not self.session.undo_label, not self.session.redo_label
        self.undo.tooltip = f"take back: {self.session.undo_label}" if self.session.undo_label else "nothing to undo"
        self.redo.tooltip = f"make again: {self.session.redo_label}" if self.session.redo_label else "nothing to redo"

    # --- work, in the workers' threads ---

    def _refit(self, request: Show) -> None:
        session = self.session
        if request.steps is None:
            # A result over time holds the frame as it was fitted, too.
            fit = self.time.fit(request.frame) or session.fit_frame(request.frame, request.coarse)
        else:
            fit = session.fit_steps(request.frame, request.steps)
        self._show(fit)
        # Numbers and curves wait for a pause: painting them would hold up the pictures of a drag.
        if self._worker.wait_newer(PAUSE_S):
            return
        self.say(self._status(fit))
        if fit.found:
            self._traces = session.explain_frame(request.frame)[1]
            self._show_energy(self._traces, request.steps)
            self.strip.show_frame(request.frame)

    def _show(self, fit: FrameFit) -> None:
        self.fit = fit
        self.overlay.show(fit)
        if note := self.time.note_of(fit):
            self.overlay.view.message = note
        self.head.show(fit)

    def _status(self, fit: FrameFit) -> str:
        return status_of(fit, len(self.session)) + ("  after" if self.time.side == AFTER else "")

    def _redraw(self) -> None:
        if self.fit is not None:
            self._worker.submit(Show(self.frame, steps=self._steps))

    def _run_clip(self, wanted: str) -> None:
        if wanted == "cancel":
            return
        if wanted == "settle":
            if self._clip_worker.wait_newer(SETTLED_S):
                return
            if not self._is_clip:  # the fit that is shown is the whole run
                self._show_changes()
                return
            if not self.session.stale.any():  # the fits are what they were: a setting of infill or refinement
                self.clip.show_stale()
                self._show_changes()
                return
            if not self.follow.value or self._is_slow:
                self._worker.submit(Show(self.frame))
                self.clip.show_stale()
                self._show_changes()
                return
        self.progress.value, self.progress.layout.visibility = 0, "visible"
        shown = max(len(self.session) // 20, 1)

        def progress(_step: str, done: int, _total: int | None) -> None:
            if done % shown == 0:
                self.progress.value = done

        self.session.fit_clip(progress, cancelled=self._clip_worker.newer)
        self.progress.layout.visibility = "hidden"

    def _show_run(self) -> None:
        if self._is_clip:
            self.clip.show_run()
            self.time.show_config()
        # The frame before may have another pose now, and the identity is the exact one.
        self._worker.submit(Show(self.frame, steps=self._steps))
        self._show_changes()

    def _show_energy(self, traces: tuple[StageTrace, ...], steps: int | None) -> None:
        terms = self.session.terms
        series, marks, results, x = {term: [] for term in terms}, [], {}, 0
        status = dict(zip([trace.stage for trace in traces], self.fit.status[-len(traces) :], strict=False))
        for trace in traces:
            marks.append((x, trace.stage))
            for term, column in zip(terms, trace.energies.T, strict=True):
                series[term].append(column)
            count = len(trace.energies) - 1
            results[trace.stage] = f"{count} steps {STATUS_NAMES.get(int(status.get(trace.stage, -1)), '')}"
            x += len(trace.energies)
        joined = {term: np.concatenate(columns) for term, columns in series.items()}
        seen = {"total": sum(joined.values())} | {term: values for term, values in joined.items() if values.any()}
        total = sum(len(trace.energies) - 1 for trace in traces)
        self.energy.set_series(np.arange(x, dtype=float), seen, marks=marks, x_label="iteration", y_label="energy")
        place = f"stopped after {steps} of {total} iterations" if steps is not None else f"{total} iterations"
        self.stages.show_results(results, place)

    def _counts(self) -> dict[str, int]:
        return {trace.stage: len(trace.energies) - 1 for trace in self._traces}

    def _warm_up(self) -> None:
        self.exported.value = "getting ready in the background: the first moves may be slower …"
        self.session.warm_up()
        self.exported.value = ""

    def _diagnose(self) -> None:
        frame = self.frame
        try:
            found = self.session.diagnose(frame)
        except WorkbenchError as error:
            self.diagnosis.clear(str(error))
            return
        if frame == self.frame:
            self.diagnosis.show(frame, found)

    def _uncertainty(self, fit: FrameFit) -> np.ndarray:
        frame = fit.index if self._is_clip else 0
        return vertex_uncertainty(self.session.model, self.session.diagnose(frame).uncertainty, fit)

    def _show_changes(self) -> None:
        self.changes.value = changes_html(self.session)

    def say(self, text: str, wrong: bool = False) -> None:
        """One line of status."""
        color = "color:var(--jp-error-color1, #b3261e)" if wrong else ""
        self.status.value = f"<code style='{color}'>{html.escape(text)}</code>"

    def _failed(self, error: Exception) -> None:
        self.progress.layout.visibility = "hidden"
        self.say(str(error) if isinstance(error, WorkbenchError) else f"{type(error).__name__}: {error}", wrong=True)

    def _resets(self) -> list[tuple[str, str]]:
        presets = [(f"preset {name}", f"preset:{name}") for name in PRESETS]
        snapshots = [(f"snapshot {name}", f"snapshot:{name}") for name in self.session.snapshots]
        return [("go to…", ""), ("the start", "start:"), *presets, *snapshots]


def status_of(fit: FrameFit, frames: int) -> str:
    """Error, pose and time of a fit in one line."""
    where = f"frame {fit.index}/{frames - 1}  " if frames > 1 else ""
    if not fit.found:
        return f"{where}no face"
    why = why_failed(fit)
    failed = f"  FAILED: {why}" if why else ""
    yaw, pitch, roll = fit.angles_deg
    if fit.source == "filled":
        return f"{where}filled from its neighbours  yaw {yaw:+.0f}° pitch {pitch:+.0f}° roll {roll:+.0f}°"
    pixels, inner, every = fit.errors
    return (
        f"{where}{pixels:.2f} px = {every:.2f} % (inner {inner:.2f} %)  yaw {yaw:+.0f}° pitch {pitch:+.0f}° "
        f"roll {roll:+.0f}°  {fit.milliseconds[2]:.0f} ms{failed}"
    )


def changes_html(session: TuningSession) -> str:
    """What changed since the start, and the metrics then and now."""
    rows = "".join(f"<li><code>{html.escape(str(item))}</code></li>" for item in session.changes())
    unexported = len(session.unexported)
    text = f"<b>Changed since the start</b><ul style='margin:2px 0'>{rows or '<li>nothing</li>'}</ul>"
    if session.run is not None and not session.stale.any():
        numbers = ", ".join(f"{name} {value:g}" for name, value in session.metrics().items())
        text += f"<b>Last run</b>: {html.escape(numbers)}"
    return text + f"<br>{unexported} change(s) not exported yet."
