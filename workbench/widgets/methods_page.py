"""Comparison of infill and refinement results: the curves and numbers of every method."""

import html
from collections.abc import Callable, Iterable

import ipywidgets as widgets
import numpy as np

from workbench.session import TuningSession
from workbench.session.curves import ANGLES, PLACES, curve, moving_weights
from workbench.session.worked import AS_FITTED, Worked
from workbench.widgets.chart_view import COLORS, INK, YELLOW, ChartView, gaps
from workbench.widgets.number_cells import column_cells
from workbench.widgets.time_part import BEFORE

ONE_LEGEND = "<style>.fw-methods .fw-chart .fw-top { display: none; }</style>"
"""Hides the legends of single charts, because all share the one above them."""


class Methods(widgets.VBox):
    """The curves of every method that was run on the same part, one line per method, and their numbers."""

    def __init__(self, session: TuningSession, go: Callable[[int], None]) -> None:
        self._session = session
        names = list(session.model.expression_names)
        self.charts = [ChartView(height_px=150, title="") for _ in range(4)]
        first = names.index("jawOpen") if "jawOpen" in names else 0
        turns = [(f"rotation: {name}", name) for name in ANGLES]
        places = [(f"position: {name}", name) for name in PLACES]
        options = [(turns, "yaw"), (places, "z"), (names, names[first]), (names, names[-1])]
        self.quantities = [
            widgets.Dropdown(
                options=choices, value=value, layout=widgets.Layout(width="150px"), tooltip="quantity to plot"
            )
            for choices, value in options
        ]
        self._chosen, self._part = False, None
        for chart, quantity in zip(self.charts, self.quantities, strict=True):
            chart.on_pick(lambda x: go(round(x)))
            quantity.observe(lambda _change: self._draw(), "value")
        self.shown = widgets.ToggleButtons(
            options=["all", "infill", "refinement"], style={"button_width": "auto"},
            tooltips=["all results", "results of infill only", "results with refinement"],
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
        """Show the session's results, on a part if there are results for it."""
        self._part = part
        results = self._session.temporal.comparable(part)
        self.table.value = numbers_html(results, colors_of(results))
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
                frames, lines, colors=colors_of(results), y_label=unit, x_label="frame", shaded=gaps(worked.filled)
            )


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
    """One colour per method, the same in every chart; single-frame fits are in the page's text colour."""
    return {BEFORE: INK} | {name: LINES[k % len(LINES)] for k, name in enumerate(results)}


def legend_html(names: Iterable[str], colors: dict[str, str]) -> str:
    """The legend for all charts, as HTML."""
    line = "<i style='display:inline-block;width:16px;border-top:2px solid {};margin:0 4px 3px 10px'></i>{}"
    inks = {name: "currentColor" if color == INK else color for name, color in colors.items()}
    keys = [line.format(inks[name], html.escape(name)) for name in (BEFORE, *names)]
    return "".join(f"<span style='white-space:nowrap'>{key}</span> " for key in keys)


def numbers_html(results: dict[str, Worked], colors: dict[str, str]) -> str:
    """The numbers of every result as a table: rows in the colours of their curves, the best of a column marked."""
    if not results:
        return (
            "<span style='opacity:.7'>Nothing to compare yet: on the page <b>time</b> next to the picture, "
            "<i>run</i> a method, or <i>compare all</i>.</span>"
        )

    before = next(iter(results.values()))
    fitted = Worked(AS_FITTED, before.config, before.part, before.before, before.before, 0.0).numbers()
    fitted.pop("seconds")
    every = {AS_FITTED: fitted} | {name: worked.numbers() for name, worked in results.items()}
    columns = [
        column_cells(
            [format(numbers[name], form) if name in numbers else None for numbers in every.values()], name in RANKED
        )
        for name, form in COLUMNS
    ]
    rows = []
    for name, cells in zip(every, zip(*columns, strict=True), strict=True):
        color = colors.get(BEFORE if name == AS_FITTED else name, INK)
        line = LINE.format("currentColor" if color == INK else color)
        rows.append(f"<tr><td>{line}{html.escape(name)}</td>{''.join(cells)}</tr>")
    head = (
        "<tr><th>method</th><th>filled</th>"
        "<th title='mean change from one turn of the head to the next'>jitter, °</th>"
        "<th title='landmark error without filled frames'>error, %</th>"
        "<th title='error of filled frames to landmarks that infill did not use'>error of filled, %</th>"
        "<th>seconds</th></tr>"
    )
    return f"<table>{head}{''.join(rows)}</table>"


LINE = "<i style='display:inline-block;width:14px;border-top:3px solid {};margin:0 6px 3px 0'></i>"
RANKED = ("jitter_deg", "error_percent", "hidden_percent", "seconds")
"""Columns in which less is better."""
LINES = (*(color for color in COLORS if color not in (INK, YELLOW)), "#9467d6")
"""Purple replaces yellow, which is hard to see on a white page."""
COLUMNS = (
    ("filled", ".0f"), ("jitter_deg", ".3f"), ("error_percent", ".2f"), ("hidden_percent", ".2f"), ("seconds", ".1f")
)  # fmt: skip
"""The numbers of a result and their format."""
