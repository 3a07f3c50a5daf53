"""What changed since the start of a session, and how the configurations that ran compare in numbers."""

import html

import ipywidgets as widgets

from workbench.config import Config, Difference
from workbench.session import TuningSession
from workbench.session.knobs import KNOBS
from workbench.session.parts import parts_text
from workbench.session.tuned_config import NOW, START
from workbench.widgets.number_cells import column_cells

COLUMNS = {
    "all_68_percent_mean": "error, %",
    "all_68_percent_p95": "worst 5 %",
    "inner_51_percent_mean": "without jaw line, %",
    "jitter_deg": "jitter, °",
}
"""Metrics of a run, all better when lower, and what they are called."""
MARKED, SHOWN_PARTS = "infill.frames", 4
BY_PATH = {knob.path: knob for knob in KNOBS}


class ChangesPage(widgets.HTML):
    """A list of changes, and a table of the start, the snapshots and the present."""

    def __init__(self, session: TuningSession, height_px: int) -> None:
        self._session = session
        super().__init__(layout=widgets.Layout(height=f"{height_px}px", overflow="auto"))

    def show(self) -> None:
        """Update from the session."""
        session = self._session
        rows = {name: metrics_under(session, config) for name, config in configurations(session).items()}
        self.value = (
            f"<div style='display:flex;gap:32px;align-items:flex-start'><div>{changes_html(session)}</div>"
            f"<div>{comparison_html(rows)}</div></div>"
        )


def configurations(session: TuningSession) -> dict[str, Config]:
    """What can be compared, by name: the start, the snapshots and the present."""
    return {START: session.base, **session.snapshots, NOW: session.config}


def metrics_under(session: TuningSession, config: Config) -> dict[str, float]:
    """Metrics of the run under a configuration; empty if it has not run."""
    run = session.runs.known(config)
    return {} if run is None else run.metrics


def changes_html(session: TuningSession) -> str:
    """The changes since the start as HTML."""
    changes, unsaved = session.changes(), {item.path for item in session.unexported}
    rows = "".join(f"<li>{html.escape(change_words(item))}</li>" for item in changes)
    count = sum(item.path in unsaved for item in changes)
    told = f"{count} of them not saved yet." if count else "The saved settings are different." if unsaved else ""
    return (
        f"<b>Changed since the start</b><ul style='margin:2px 0;padding-left:18px'>{rows or '<li>nothing</li>'}</ul>"
        f"{told}"
    )


def change_words(item: Difference) -> str:
    """A change in words: moved points are counted, frames are ranges, settings have their symbol and plain name."""
    if item.path == MARKED:
        before, after = (parts_text(parts, SHOWN_PARTS) if parts else "none" for parts in (item.before, item.after))
        return f"frames marked as failed: {before} → {after}"
    knob = BY_PATH.get(item.path)
    if knob is None or item.moved_points:
        return str(item)
    return f"{knob.label} ({knob.words.name}): {str(item).partition(': ')[2]}"


def comparison_html(rows: dict[str, dict[str, float]]) -> str:
    """Metrics of each configuration as a table with the best of a column marked; a dash where it has not run."""
    columns = [name for name in COLUMNS if any(name in numbers for numbers in rows.values())]
    if not columns:
        return ""
    cells = [
        column_cells([f"{numbers[name]:.2f}" if name in numbers else None for numbers in rows.values()])
        for name in columns
    ]
    head = "".join(f"<th>{COLUMNS[name]}</th>" for name in columns)
    lines = [
        f"<tr><td>{html.escape(row)}</td>{''.join(line)}</tr>"
        for row, line in zip(rows, zip(*cells, strict=True), strict=True)
    ]
    return f"<table><tr><th>configuration</th>{head}</tr>{''.join(lines)}</table>"
