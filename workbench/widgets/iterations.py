"""The iterations of the shown fit: their energies, the result of each stage, and stepping through them."""

from collections.abc import Callable

import numpy as np

from workbench.energies.terms import TABLE
from workbench.errors import WorkbenchError
from workbench.plots import term_line
from workbench.session import TuningSession
from workbench.tracking import FrameFit, StageTrace
from workbench.widgets.chart_view import INK, ChartView
from workbench.widgets.stage_editor import StageEditor
from workbench.widgets.status_line import StatusLine

STATUS_NAMES = {-1: "", 1: "converged", 2: "limit", 3: "stalled", 4: "not finite"}


class Iterations:
    """The energy chart and the stage table; `refit` is called when the fit should stop at another iteration.

    `steps`: the number of iterations after which the fit stops; None: it runs to the end.
    """

    def __init__(self, session: TuningSession, status: StatusLine, refit: Callable[[], None], height_px: int) -> None:
        self._session, self._status, self._refit = session, status, refit
        self._traces: tuple[StageTrace, ...] = ()
        self.steps: int | None = None
        self.found = False
        """Whether there is a fit to step through."""
        self.energy = ChartView(height_px=height_px - 20, y_log=True, title="energy per term over iterations")
        self.stages = StageEditor(self._on_stages, self._on_run, height_px)

    @property
    def counts(self) -> dict[str, int]:
        """Iterations of each stage."""
        return {trace.stage: len(trace.energies) - 1 for trace in self._traces}

    def show(self, fit: FrameFit, traces: tuple[StageTrace, ...], steps: int | None) -> None:
        """Show the stages of a fit that was stopped after `steps` iterations; no traces: there is no face to fit."""
        self._traces = traces
        if not traces:
            self.energy.set_series(np.zeros(0), {})
            self.stages.show_results({})
            return
        self._show_energy(traces)
        total = sum(self.counts.values())
        place = f"stopped after {steps} of {total} iterations" if steps is not None else f"{total} iterations"
        self.stages.show_results(stage_results(fit, traces), place)

    def _show_energy(self, traces: tuple[StageTrace, ...]) -> None:
        terms = self._session.config.terms
        columns = {term: [] for term in terms}
        for trace in traces:
            for term, column in zip(terms, trace.energies.T, strict=True):
                columns[term].append(column)
        lengths = [len(trace.energies) for trace in traces]
        marks = [(sum(lengths[:k]), trace.stage) for k, trace in enumerate(traces)]
        joined = {term: np.concatenate(parts) for term, parts in columns.items()}
        names = {term: f"{TABLE[term].symbol} {term.replace('_', ' ')}" for term in terms}
        seen = {"total": sum(joined.values())} | {names[term]: row for term, row in joined.items() if row.any()}
        x = np.arange(sum(lengths), dtype=float)
        colors = {"total": INK} | {name: term_line(term)[0] for term, name in names.items()}
        self.energy.set_series(x, seen, colors=colors, marks=marks, x_label="iteration", y_label="energy")

    def _on_stages(self, stages: list[dict], label: str) -> None:
        try:
            self._session.set(label, stages=stages)
        except WorkbenchError as error:
            self._status.failed(error)
            self.stages.show(self._session.config)

    def _on_run(self, what: str, number: int) -> None:
        if not self.found:
            return
        counts = self.counts
        total = sum(counts.values())
        if what == "all":
            self.steps = None
        elif what == "here":
            names = [stage.name for stage in self._session.config.stages[: number + 1]]
            self.steps = sum(count for name, count in counts.items() if name in names)
        else:
            now = total if self.steps is None else self.steps
            self.steps = int(np.clip(now + (1 if what == "step" else -1), 0, total))
            if what == "step" and now == total:
                self.steps = 0  # a step after the last iteration starts again from the beginning
        self._refit()


def stage_results(fit: FrameFit, traces: tuple[StageTrace, ...]) -> dict[str, str]:
    """Number of steps and final status of each stage, by name."""
    ran = fit.status[fit.status >= 0]
    status = dict(zip([trace.stage for trace in traces], ran, strict=False))
    return {
        trace.stage: f"{len(trace.energies) - 1} steps {STATUS_NAMES.get(int(status.get(trace.stage, -1)), '')}"
        for trace in traces
    }
