"""Named numbers: bars, matrices, heat maps, the residual strip, Markdown tables."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
from jaxtyping import Float
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from workbench.landmarks.scheme import IBUG68
from workbench.pictures.overlay import WORST_PERCENT
from workbench.plots.figures import PAGE_WIDTH, one_axis
from workbench.plots.style import LINES, RED, page, styled
from workbench.tracking import FrameFit


@styled
def strongest_weights(
    names: Sequence[str],
    weights: Float[np.ndarray, "k"] | dict[str, np.ndarray],
    count: int = 12,
    x_label: str = "weight",
    in_range: tuple[float, float] | None = (0.0, 1.0),
) -> Figure:
    """Bars of the weights with the largest magnitude; for several labelled vectors, grouped bars in that order.

    `in_range` is shaded.
    """
    series = weights if isinstance(weights, dict) else {"": weights}
    values = np.array(list(series.values()))
    order = np.argsort(-np.abs(values).max(axis=0), kind="stable")[:count][::-1]
    figure, axis = one_axis(6.4, 0.7 + 0.25 * count * (0.5 + 0.5 * len(series)))
    thick = 0.8 / len(series)
    for k, (label, row, (color, _)) in enumerate(zip(series, values, cycle(LINES), strict=False)):
        place = np.arange(len(order)) + thick * ((len(series) - 1) / 2 - k)
        axis.barh(place, row[order], thick, color=color, label=label)
    axis.set_yticks(np.arange(len(order)), [names[k] for k in order], fontsize=9)
    axis.set_xlabel(x_label)
    if in_range is not None:
        axis.axvspan(*in_range, color=page().band, zorder=0)
    axis.axvline(0, color=page().soft, linewidth=0.8)
    if len(series) > 1:
        axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


@styled
def heat_map(
    values: Float[np.ndarray, "r c"],
    rows: Sequence[object],
    columns: Sequence[object],
    row_label: str,
    column_label: str,
    value_label: str,
    log: bool = False,
) -> Figure:
    """A coloured table of positive numbers, with each number written in its cell."""
    values = np.asarray(values)
    height = 1.1 + 0.36 * len(rows)
    figure, axis = one_axis(min(2.4 + 0.72 * len(columns), PAGE_WIDTH), height)
    norm = LogNorm(values.min(), max(values.max(), 1.0001 * values.min())) if log else None
    shown = axis.imshow(values, cmap="viridis", norm=norm, aspect="auto", interpolation="nearest")
    for row, column in np.ndindex(values.shape):
        light = shown.norm(values[row, column]) > 0.6
        axis.text(
            column, row, f"{values[row, column]:.3g}", ha="center", va="center", fontsize=8,
            color="0.05" if light else "white",
        )  # fmt: skip
    axis.set_xticks(range(len(columns)), [str(name) for name in columns])
    axis.set_yticks(range(len(rows)), [str(name) for name in rows])
    axis.set_xlabel(column_label)
    axis.set_ylabel(row_label)
    bar = figure.colorbar(shown, pad=0.02)
    bar.formatter = bar.minorformatter = "{x:g}"
    bar.ax.tick_params(which="both", labelsize=8)
    bar.set_label(value_label)
    return figure


@styled
def residual_strip(fits: Sequence[FrameFit], flagged: Sequence[bool] | None = None, frame: int | None = None) -> Figure:
    """Error of every landmark in every frame of a clip, in % of the outer-eye distance, like the panel's timeline.

    Rows are sorted by face part; grey frames have no landmarks. Triangles mark `flagged` frames; a line marks `frame`.
    """
    parts = fits[0].scheme.parts if len(fits) else IBUG68.parts
    order = [point for points in parts.values() for point in points]
    rows = len(order)
    values = np.full((rows, len(fits)), np.nan)
    for column, fit in enumerate(fits):
        if fit.found and fit.seen:
            values[:, column] = fit.residuals_percent[order]
    figure, axis = one_axis(8.4, 2.5)
    axis.set_facecolor(page().faint)
    shown = axis.imshow(
        values, cmap="viridis", vmin=0.0, vmax=WORST_PERCENT, aspect="auto", interpolation="nearest",
        extent=(-0.5, len(fits) - 0.5, rows - 0.5, -0.5),
    )  # fmt: skip
    ends = np.cumsum([0, *map(len, parts.values())])
    axis.set_yticks((ends[:-1] + ends[1:] - 1) / 2, parts)
    axis.tick_params(axis="y", length=0)
    for end in ends[1:-1]:
        axis.axhline(end - 0.5, color="white", linewidth=0.8)
    if flagged is not None and any(flagged):
        places = np.flatnonzero(np.asarray(flagged))
        axis.plot(places, np.full(len(places), -3.5 / 68 * rows), "v", color=RED, markersize=5, clip_on=False)
    if frame is not None:
        axis.axvline(frame, color="white", linewidth=1.6)
        axis.axvline(frame, color="0.1", linewidth=0.8, linestyle="--")
    axis.set_xlim(-0.5, len(fits) - 0.5)
    axis.set_ylim(rows - 0.5, -0.5)
    axis.set_xlabel("frame")
    bar = figure.colorbar(shown, pad=0.015, extend="max")
    bar.set_label("error, % of eye distance")
    return figure


@styled
def matrix_figure(names: Sequence[str], matrix: Float[np.ndarray, "k k"], title: str) -> Figure:
    """A square matrix of values between −1 and 1 in colour, rows and columns by name."""
    side = 1.6 + 0.17 * len(names)
    figure, axis = one_axis(side + 0.6, side)
    shown = axis.imshow(matrix, cmap="RdBu", vmin=-1, vmax=1, interpolation="nearest")
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axis.set_yticks(range(len(names)), names, fontsize=7)
    axis.set_title(title)
    figure.colorbar(shown, shrink=0.6, pad=0.02)
    return figure


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Rows as a Markdown table; floats are shown with three digits."""
    lines = [header, ["---"] * len(header), *rows]
    cells = [[_cell(cell) for cell in line] for line in lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in cells)


def _cell(value: object) -> str:
    text = f"{value:.3g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|")  # a vertical bar would end the cell
