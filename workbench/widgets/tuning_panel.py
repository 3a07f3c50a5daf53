"""The panel: knobs of a session, the picture, the head, the clip and the diagnosis, all kept in step."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import ipywidgets as widgets
import numpy as np

import workbench
from workbench.session import TuningSession
from workbench.session.gesture import Gesture
from workbench.session.knobs import changed_by, label_of
from workbench.widgets.cell_reruns import replace_earlier
from workbench.widgets.encoded_pictures import picture_bytes
from workbench.widgets.kernel_comms import lose_no_messages
from workbench.widgets.late_parts import LateParts
from workbench.widgets.latest import LatestWins
from workbench.widgets.panel_layout import arranged, classed, on_turn, style_sheet, tabs, unloaded_note
from workbench.widgets.time_part import note_of
from workbench.widgets.waiting import Waiting, Work, nothing

HEAD_SIZE, TABS_PX = (304, 308), 170
"""The part of a head that is always in view, pixels; height of the pages below the strip."""
GETTING_READY = "getting ready: the first moves may be slower"
READY_S, DEEP_S = 20.0, 40.0
"""What the first diagnosis, and the first fit by Deep Energies, take with their programs."""
PAUSE_S = 0.1
"""Numbers and curves wait for a pause of this length, because painting them would delay the pictures of a drag."""
FIRST_S = 0.05
"""What follows from a slider elsewhere in the panel waits so long for the pictures, which it would delay."""


@dataclass(frozen=True)
class Show:
    """A request to the worker: fit and show a frame."""

    frame: int
    coarse: bool = False
    """Whether the identity of an earlier configuration may be used."""
    steps: int | None = None
    """Stop after this many iterations; None runs all stages."""


class TuningPanel(LateParts):
    """A view of a `TuningSession` that follows every change of the session.

    Callbacks submit requests to a worker, and only the latest counts; results are shown from its thread. Scripts and
    tests wait for it with `wait_idle`. It is as high as the window, at least `LOWEST_PX`.
    In a notebook it starts as the first frame alone. `close` frees it; in JupyterLab, a rerun of the cell that made it
    closes it, too.
    """

    def __init__(self, session: TuningSession, backend: str = "auto") -> None:
        lose_no_messages()
        self.session, self.frame, self.is_clip = session, 0, len(session) > 1
        self.fit: workbench.tracking.FrameFit | None = None
        self._held, self._behind, self._backend, self._shown = "", "", backend, threading.Event()
        super().__init__([style_sheet(), classed(widgets.Image(value=picture_bytes(session.picture(0))), "fw-first")])
        classed(self, "fw-panel", "fw-whole")
        replace_earlier(self)

    def __repr__(self) -> str:
        return f"TuningPanel({self.session!r})"

    # --- for scripts and tests ---

    def go(self, frame: int) -> None:
        """Show another frame."""
        self._make()
        frame = int(np.clip(frame, 0, len(self.session) - 1))
        if frame != self.frame:
            self.frame, self._iterations.steps = frame, None
            if self.is_clip:
                self.clip.show_frame(frame)
            self.time.show_frame(frame)
            self.diagnosis.clear()
            self._worker.submit(Show(frame))

    def step(self, by: int) -> None:
        """Go one frame (±1), or one flagged frame (±2), forward or back."""
        self.go(self.frame + by if abs(by) == 1 else self.clip.next_flagged(self.frame, by // 2))

    def turn(self, path: str, value: Any) -> None:
        """Turn a knob as a user would; `session.knobs.KNOBS` lists the paths."""
        self.controls.by_path[path].turn(value)

    def wait_idle(self, timeout_s: float | int = 60.0) -> bool:
        """Wait until everything requested is shown; False if that takes longer."""
        self._make()
        return all_idle(self._worker, self._workers, timeout_s)

    # --- parts ---

    def _make_parts(self) -> None:
        from workbench.widgets import panel_parts as parts  # here: the first frame is shown without them

        self.status = classed(parts.StatusLine(), "fw-status")
        self.say, self.waiting = self.status.say, Waiting()
        self._worker: LatestWins[Show] = LatestWins(self._refit, self._failed, "panel-fit")
        self._slow = parts.SlowJobs(self._failed, "panel-slow")
        self._build_views(parts, self._backend)
        self._build_controls(parts)
        shown = (self._clip_bar, self._worker, self.overlay, self.head, self.compare)
        self._workers = (self._slow, self.time, self.sweep, self.tune, *shown)
        self._leave = self.session.listen(self._on_session)
        self.children = (*self.children, unloaded_note(), self.page, *rows_of(self))
        show_session(self)
        self.overlay.show_picture(0)
        self._worker.submit(Show(0))
        self._clip_bar.begin()
        self._later(lambda job: self.session.warm_up(job.cancelled), GETTING_READY)

    def _close_parts(self) -> None:
        self._leave()
        self.export_dialog.stop()
        self.waiting.close()
        for worker in self._workers:
            worker.close()

    def _build_views(self, parts: ModuleType, backend: str) -> None:
        # Shown first, because a browser gives their programs two seconds to load, too little next to hundreds of
        # controls or during the layout of the panel. A view that loads later would never hear from the kernel.
        session, head = self.session, parts.FittedHead(self.session.model)
        self.page, self.clip = parts.PanelPage(keys=True), parts.ClipViews(session, self.go)
        self._iterations = parts.Iterations(session, self.status, self._redraw, TABS_PX)
        self.energy, self.stages = self._iterations.energy, self._iterations.stages
        self.diagnosing = parts.FrameDiagnosis(session, self.status, self._later, lambda: self.frame, TABS_PX)
        self.diagnosis = self.diagnosing.view
        self.time = parts.TimePage(session, self._on_knob, self.go, self._redraw, self.clip)
        self.overlay = parts.LandmarkTools(session, head, self.say, self.waiting, self._redraw)
        self.scale = parts.SharedScale(self.overlay.view, self.clip.timeline, self.overlay.in_percent, self._redraw)
        self.head = parts.HeadColumn(
            session, head, HEAD_SIZE, backend, self.diagnosing.uncertainty, self.waiting, self._redraw,
            lambda: self.scale.end,
        )  # fmt: skip
        self.overlay.view.observe(lambda change: self.head.show_webgl(change["new"]), "webgl")
        self.compare = parts.ComparePage(session, backend, self.waiting, self._later, self._failed)
        self.sweep = parts.SweepPage(session, self._worker.wait_idle, TABS_PX)
        self.tune = parts.TunePage(session, self._worker.wait_idle, TABS_PX)

    def _build_controls(self, parts: ModuleType) -> None:
        session = self.session
        self.controls = parts.Controls(session.base, self._on_knob, scheme=session.material.scheme)
        self.controls.add("time", self.time.widget, self.time.knobs, session.config)
        self.changes = parts.ChangesPage(session, TABS_PX)
        self.history = parts.HistoryBar(session, self.status)
        self.export_dialog = parts.ExportDialog(session, self._slow.submit, self.page.download)
        told = self._redraw, self.changes.show, self._show_run, self._failed
        self._clip_bar = parts.ClipBar(session, self.clip, *told)
        self.transport = parts.Transport(self._clip_bar, self.step, lambda: self.frame, self.time.played)
        self.page.on_reset(self.controls.reset)
        self.page.on_key(lambda action: self.status.guarded(actions_of(self)[action]))
        # For scripts to press and read.
        self.undo, self.redo = self.history.undo, self.history.redo
        self.reset, self.name, self.keep = self.history.reset, self.history.name, self.history.keep
        self.file, self.export, self.load, self.overwrite, _, self.exported = self.export_dialog.settings.widgets
        self.run_clip, self.follow, self.cancel, self.progress = self._clip_bar.widgets

        self.strip = parts.FilmStrip(self.session)
        self.tabs = tabs(pages_of(self))
        on_turn(self.tabs, {"Compare": self.compare.turned, "Sweep": self.sweep.turned})

    # --- what the user does ---

    def _on_knob(self, path: str, value: Any) -> None:
        changes, gesture = changed_by(self.session.config, path, value), Gesture(path, self.page.drag)
        self._held = path
        try:
            taken = self.status.guarded(lambda: self.session.set(label_of(path), gesture, **changes))
        finally:
            self._held = ""
        if not taken:
            self.controls.show(self.session.config)
        self.sweep.moved(path)

    # --- what the session reports ---

    def _on_session(self, what: str) -> None:
        if self._closed:
            return
        if what == "config":
            self._iterations.steps = None
            self._shown.clear()
            self._behind = self._held
            self._worker.submit(Show(self.frame, coarse=self.is_clip))
            if not self._held:
                show_session(self)
            elif not self._shown.wait(FIRST_S):
                self._catch_up()
            self._clip_bar.settle()
        elif what == "run":
            self.status.guarded(self._show_run)
        elif what == "time":
            self.time.show_result()
            self._redraw()
        elif what in ("snapshots", "export"):
            show_kept(self, what)

    def _catch_up(self) -> None:
        """Show in the rest of the panel what a slider has changed, once its pictures are there or take long."""
        held, self._behind = self._behind, ""
        if held:
            show_session(self, held)

    def _show_run(self) -> None:
        if self.is_clip:
            self.clip.show_run()
            self.scale.show_run()
            self.time.show_config()
        # The previous frame may have another pose now, and the identity is now exact.
        self._worker.submit(Show(self.frame, steps=self._iterations.steps))
        self.changes.show()

    # --- work, in the worker's thread ---

    def _refit(self, request: Show) -> None:
        session, frame = self.session, request.frame
        old, system = (self.overlay.view, self.head.view.widget), session.config.traits
        told = (f"fitting frame {frame}", system.title, old, nothing, None if system.real_time else DEEP_S)
        with self.waiting.during(*told) as job:
            if request.steps is None:
                # A temporal result also contains the frame as it was fitted.
                fit = self.time.fit(frame) or session.fit_frame(frame, request.coarse, cancelled=job.cancelled)
            else:
                fit = session.fit_steps(frame, request.steps)
        self._show(fit)
        self._shown.set()
        if self._worker.wait_newer(PAUSE_S):
            return
        self._catch_up()
        self.status.show_fit(fit, len(session), self.time.was_changed(fit), self.clip.why(frame))
        self._iterations.show(fit, session.explain_frame(frame)[1] if fit.found else (), request.steps)
        self.strip.show_frame(frame)
        self.compare.show_frame(frame)

    def _show(self, fit: "workbench.tracking.FrameFit") -> None:
        self.fit, self._iterations.found = fit, fit.found
        with self.overlay.view.hold_sync():  # one message: two arrive milliseconds apart and are drawn a frame apart
            self.head.show(fit, self.overlay.view)
            self.overlay.show(fit, note_of(fit, self.session.config) if self.time.is_clip else "")

    def _redraw(self) -> None:
        if self.fit is not None:
            self._worker.submit(Show(self.frame, steps=self._iterations.steps))

    def _later(self, work: Work, what: str = "looking for reasons", usual_s: float = READY_S) -> None:
        """Do what is slow after what is already waiting, where it can be cancelled."""
        self._slow.submit(self.waiting.running(work, what, usual_s))

    def _failed(self, error: Exception) -> None:
        if self._closed:  # what it was doing has been cancelled
            return
        self._catch_up()
        self._clip_bar.hide_progress()
        self.status.failed(error)


def all_idle(fits: LatestWins[Show], others: Sequence[Any], timeout_s: float | int) -> bool:
    """Wait until a panel's worker for fits and what it requests of the others is done; False if that takes longer."""
    ends = time.monotonic() + timeout_s

    def idle(worker: Any) -> bool:
        return bool(worker.wait_idle(max(ends - time.monotonic(), 0.0)))

    # A fit requests layers and colours, and finished colours request that the fit is shown again.
    while idle(fits):
        shown = fits.started
        if not all(map(idle, others)):
            return False
        if idle(fits) and fits.started == shown:
            return True
    return False


def show_session(panel: TuningPanel, held: str = "") -> None:
    """Show the session's configuration and history in the parts of a panel, but for the knob that is held."""
    config = panel.session.config
    panel.controls.show(config, but=held)
    panel.stages.show(config)
    panel.diagnosing.show_config()
    panel.strip.show_config()
    panel.overlay.refresh_groups()
    panel.time.show_config()
    panel.sweep.show_config()
    panel.tune.show_config()
    panel.clip.timeline.marked = [list(part) for part in config.infill.frames]
    panel.history.show()


def show_kept(panel: TuningPanel, what: str) -> None:
    """Show in the parts of a panel which "snapshots" were kept, or that settings were saved ("export")."""
    panel.changes.show()
    if what == "snapshots":
        panel.history.show_snapshots()
        panel.head.refresh_comparisons()
        panel.compare.refresh()


def pages_of(panel: TuningPanel) -> dict[str, widgets.Widget | None]:
    """The pages at the foot of a panel by title; None where there is no clip."""
    return {
        "Energy": panel.energy, "Stages": panel.stages.widget, "Diagnosis": panel.diagnosis.widget,
        "Curves": panel.clip.curves if panel.is_clip else None,
        "Methods": panel.time.methods if panel.time.is_clip else None,
        "Sweep": panel.sweep, "Tune": panel.tune if panel.time.is_clip else None,
        "Compare": panel.compare, "Film strip": panel.strip, "Changes": panel.changes,
    }  # fmt: skip


def rows_of(panel: TuningPanel) -> list[widgets.Widget]:
    """What stands in a panel, from top to bottom."""
    told = (panel.status, panel.waiting, *panel.export_dialog.buttons)
    top = classed(widgets.HBox([panel.history.widget, *told]), "fw-top-bar")
    clip = [panel.clip.timeline, panel.transport.widget] if panel.is_clip else []
    body = arranged(panel.controls.widget, panel.overlay.widget, panel.head.widget, clip)
    return [top, panel.export_dialog.widget, body, panel.tabs]


def actions_of(panel: TuningPanel) -> dict[str, Callable[[], object]]:
    """What the keys of a panel do: the callback of each of `panel_page.ACTIONS`."""
    transport = panel.transport
    return {
        "play": transport.play,
        "back": lambda: panel.step(-1),
        "forth": lambda: panel.step(1),
        "previous": lambda: panel.step(-2),
        "next": lambda: panel.step(2),
        "in": lambda: transport.mark("in"),
        "out": lambda: transport.mark("out"),
        "fill": panel.time.fill,
        "view": panel.head.next_look,
        "why": lambda: ask_why(panel),
        "keep": panel.history.take,
        "export": panel.export_dialog.fold,
        "undo": panel.session.undo,
        "redo": panel.session.redo,
    }


def ask_why(panel: TuningPanel) -> None:
    """Bring the diagnosis to the front and ask for it."""
    panel.tabs.selected_index = list(panel.tabs.titles).index("Diagnosis")
    panel.diagnosis.ask.click()
