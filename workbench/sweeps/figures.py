"""Figures of a sweep: curves with bands over frames, maps of two settings, parallel coordinates, Pareto fronts.

All are as wide as a notebook's outputs.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from workbench.errors import InputError
from workbench.objectives import TABLE, pareto_set
from workbench.plots import BLUE, GREY, LIGHT, RED, on_page, styled
from workbench.plots.figures import subplots, without_frame
from workbench.plots.style import page
from workbench.sweeps.outcome import SweepResult
from workbench.sweeps.space import Axis, shown

WIDTH = 8.0
"""Inches; at 100 dots an inch that of a notebook's outputs."""
FIGURES = ("curve-*.png", "map.png", "parallel.png", "pareto.png")
"""What `write_figures` calls its files."""
MOST_TICKS = 9
COLOURS = "viridis_r"
"""Light is good: less is better."""


@styled
def curves_figure(result: SweepResult, axis: Axis | None = None, objectives: Sequence[str] = ()) -> Figure:
    """Each objective over one setting: the mean over frames, and the quartiles as a band; a ring at the lowest mean.

    With several settings, the curve is for the best values of the others: the lowest mean at each value. Samples, which
    have no values in common, are dots. Raises `InputError` for a sweep without settings.
    """
    if not result.axes:
        raise InputError("A curve takes a setting, and the sweep has none.")
    axis = axis or result.axes[0]
    sampled = not on_grid(result, axis)
    names = tuple(objectives) or result.objectives
    rows = -(-len(names) // 2)
    columns = min(2, len(names))
    figure, axes = subplots(rows, columns, (WIDTH, 2.6 * rows + 0.2))
    for name, area in zip(names, axes, strict=False):
        if sampled:
            values, means = [_value(result, point.number, axis) for point in result.points], result.means(name)
        else:
            values, means, bands = _along(result, axis, name)
        places = _places(axis, values)
        if sampled:
            area.plot(places, means, "o", color=BLUE, markersize=4, alpha=0.7, label="mean over frames")
        else:
            area.fill_between(places, *bands.T, color=BLUE, alpha=0.16, linewidth=0, label="half of the frames")
            area.plot(places, means, "-o", color=BLUE, markersize=4, linewidth=1.4, label="mean over frames")
        if np.isfinite(means).any():
            least = int(np.nanargmin(means))
            area.plot(places[least], means[least], "o", color=RED, markersize=10, fillstyle="none", label="least mean")
        _ticks(area, axis, values, places)
        area.set_title(TABLE[name].label, fontsize=10, loc="left")
        area.set_xlabel(axis.path, fontsize=9)
        area.tick_params(labelsize=9)
        without_frame(area)
    for area in axes[len(names) :]:
        area.axis("off")
    # Below all areas: inside of one it would lie on points.
    below = 0.3 / figure.get_figheight()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="lower center", ncols=3, fontsize=8)
    figure.tight_layout(rect=(0.0, below, 1.0, 1.0))
    return figure


@styled
def maps_figure(result: SweepResult, axes: tuple[Axis, Axis] | None = None, objectives: Sequence[str] = ()) -> Figure:
    """Each objective over two settings of a grid, as a map; a ring at the lowest mean.

    With further settings, a cell has the lowest mean over them. Raises `InputError` for fewer than two settings, and
    for samples, which have no values in common.
    """
    if len(result.axes) < 2:
        raise InputError(f"A map takes two settings, the sweep has {len(result.axes)}.")
    across, up = axes or result.axes[:2]
    for axis in (across, up):
        if not on_grid(result, axis):
            raise InputError(f"A map takes the points of a grid, and those of {axis.path!r} are samples; draw curves.")
    names = tuple(objectives) or result.objectives
    rows, columns = -(-len(names) // 2), min(2, len(names))
    figure, areas = subplots(rows, columns, (WIDTH, 3.1 * rows + 0.2))
    for name, area in zip(names, areas, strict=False):
        grid = _grid(result, across, up, name)
        known = grid[np.isfinite(grid)]
        wide = len(known) and known.min() > 0.0 and known.max() > 5.0 * known.min()
        drawn = area.imshow(
            grid,
            origin="lower",
            aspect="auto",
            cmap=COLOURS,
            norm=LogNorm() if wide else Normalize(),
            interpolation="none",
        )
        bar = figure.colorbar(drawn, ax=area, pad=0.02)
        bar.ax.tick_params(labelsize=8)
        if wide:
            bar.ax.yaxis.set_major_formatter("{x:g}")
            bar.ax.yaxis.set_minor_formatter("{x:g}")
        if len(known):
            row, column = np.unravel_index(np.nanargmin(grid), grid.shape)
            area.plot(column, row, "o", color=RED, markersize=11, fillstyle="none", markeredgewidth=1.8)
        for values, set_ticks in ((across.values, area.set_xticks), (up.values, area.set_yticks)):
            chosen = _some(len(values))
            set_ticks(chosen, [shown(values[k]) for k in chosen], fontsize=8)
        area.tick_params(axis="x", rotation=40 if _long(across) else 0)
        area.set_xlabel(across.path, fontsize=9)
        area.set_ylabel(up.path, fontsize=9)
        area.set_title(TABLE[name].label, fontsize=10, loc="left")
    for area in areas[len(names) :]:
        area.axis("off")
    figure.tight_layout()
    return figure


@styled
def parallel_figure(result: SweepResult, wanted: str | None = None) -> Figure:
    """Every point as a line through its settings and its objectives; the tenth with the lowest `wanted` in orange.

    Logarithmic settings have logarithmic axes; objectives go from their minimum at the bottom to their maximum at the
    top.
    """
    wanted = wanted or result.objectives[0]
    means = {name: result.means(name) for name in result.objectives}
    known = np.isfinite(means[wanted])
    scales = [(axis.path, *_share_of_setting(result, axis)) for axis in result.axes]
    scales += [(name, *_share_of_objective(means[name], TABLE[name].digits)) for name in result.objectives]
    figure, (area,) = subplots(1, 1, (WIDTH, 3.9))
    ranks = np.full(len(result.points), np.nan)
    ranks[known] = means[wanted][known].argsort().argsort() / max(1, known.sum() - 1)
    lines = np.stack([shares for _, shares, _, _ in scales], axis=1)
    places = np.arange(len(scales))
    for number in sorted(np.flatnonzero(known), key=lambda number: -ranks[number]):
        good = ranks[number] <= 0.1
        colour, width, opacity = (RED, 1.6, 0.9) if good else (GREY, 0.9, 0.6)
        area.plot(places, lines[number], color=colour, linewidth=width, alpha=opacity)
    for place, (_, _, low, high) in enumerate(scales):
        area.axvline(place, color=page().soft, linewidth=0.8)
        for text, height, align in ((low, -0.03, "top"), (high, 1.03, "bottom")):
            area.text(place, height, text, ha="center", va=align, fontsize=8)
    names = [_folded(path) for path, *_ in scales]
    area.set_xticks(places, names, fontsize=8.5)
    area.tick_params(axis="x", length=0, pad=16)
    area.set_yticks([])
    area.set_ylim(-0.02, 1.02)
    area.set_xlim(-0.4, len(scales) - 0.6)
    area.spines[:].set_visible(False)
    area.set_title(f"orange: the tenth of the points with the lowest {wanted}", fontsize=10, loc="left", pad=22)
    figure.tight_layout()
    return figure


@styled
def pareto_figure(
    result: SweepResult, across: str = "error", up: str = "jitter", colour: str | None = "iterations"
) -> Figure:
    """Two objectives against each other, the colour a third; ringed and joined: points that no other beats in both.

    Points that are unbeaten in all three, but not in the two, have a thin ring.
    """
    x, y = result.means(across), result.means(up)
    figure, (area,) = subplots(1, 1, (WIDTH, 4.2))
    third = result.means(colour) if colour in result.objectives else None
    colours = {"color": BLUE} if third is None else {"c": third, "cmap": COLOURS}
    drawn = area.scatter(x, y, s=34, zorder=3, **colours)
    if third is not None:
        bar = figure.colorbar(drawn, ax=area, pad=0.02)
        bar.set_label(TABLE[colour].label, fontsize=9)
        bar.ax.tick_params(labelsize=8)
        unbeaten = np.flatnonzero(pareto_set(np.stack([x, y, third], axis=1)))
        area.scatter(x[unbeaten], y[unbeaten], s=90, facecolors="none", edgecolors=RED, linewidths=0.7, zorder=4)
    front = np.flatnonzero(pareto_set(np.stack([x, y], axis=1)))
    front = front[np.argsort(x[front])]
    area.step(x[front], y[front], where="post", color=RED, linewidth=1.1, zorder=2)
    area.scatter(x[front], y[front], s=90, facecolors="none", edgecolors=RED, linewidths=1.8, zorder=4)
    named = _name_some(area, result, front, x, y)
    area.set_xlabel(TABLE[across].label, fontsize=9)
    area.set_ylabel(TABLE[up].label, fontsize=9)
    area.tick_params(labelsize=9)
    area.margins(0.08)
    without_frame(area)
    title = [f"points that no other beats in {across} and {up}", *named]
    if third is not None and len(unbeaten) > len(front):
        title.append(f"thin ring: beaten in these two, but not with {colour} as well")
    area.set_title("\n".join(title), fontsize=9, loc="left")
    figure.tight_layout()
    return figure


@on_page(LIGHT)
def write_figures(result: SweepResult, folder: str | Path) -> tuple[str, ...]:
    """Draw what a sweep can show into a folder as PNG; returns the names of the files.

    Objectives without a value at any point, such as the jitter of a photo, are left out.
    """
    made, result = {}, _with_values(result)
    if not result.objectives:
        return ()
    varied = [
        axis for axis in result.axes if len({str(_value(result, k, axis)) for k in range(len(result.points))}) > 1
    ]
    ordered = [axis for axis in varied if on_grid(result, axis)]
    for axis in varied:
        name = "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in axis.path)
        made[f"curve-{name}.png"] = curves_figure(result, axis)
    if len(ordered) > 1:
        made["map.png"] = maps_figure(result, (ordered[0], ordered[1]))
    if len(result.points) > 1 and len(result.axes) + len(result.objectives) > 2:
        made["parallel.png"] = parallel_figure(result)
    both = {"error", "jitter"} <= set(result.objectives)
    if len(result.points) > 1 and both and np.isfinite(result.means("error") + result.means("jitter")).any():
        made["pareto.png"] = pareto_figure(result)
    for name, figure in made.items():
        figure.savefig(Path(folder) / name, dpi=100)
    return tuple(made)


def _with_values(result: SweepResult) -> SweepResult:
    """A result with those of its objectives alone that have a mean at some point."""
    kept = [k for k, name in enumerate(result.objectives) if np.isfinite(result.means(name)).any()]
    values = {place: rows[kept] for place, rows in result.values.items()}
    return replace(result, objectives=tuple(result.objectives[k] for k in kept), values=values)


def on_grid(result: SweepResult, axis: Axis) -> bool:
    """Whether all points take the values that are written for a setting, rather than samples of its scale."""
    return all(_value(result, point.number, axis) in axis.values for point in result.points)


def _value(result: SweepResult, number: int, axis: Axis):
    return dict(result.points[number].values)[axis.path]


def _along(result: SweepResult, axis: Axis, name: str):
    """The values of an axis; at each the mean and band of the point with the least mean."""
    means, bands = result.means(name), result.bands(name)
    best = np.full(len(axis.values), -1)
    for number, mean in enumerate(means):
        if np.isfinite(mean):
            place = axis.values.index(_value(result, number, axis))
            if best[place] < 0 or mean < means[best[place]]:
                best[place] = number
    found = best >= 0
    values = [value for value, there in zip(axis.values, found, strict=True) if there]
    return values, means[best[found]], bands[best[found]]


def _places(axis: Axis, values: Sequence) -> Float[np.ndarray, "n"]:
    return np.array(values, float) if axis.numeric else np.arange(len(values), dtype=float)


def _ticks(area: Axes, axis: Axis, values: Sequence, places: Float[np.ndarray, "n"]) -> None:
    if not axis.numeric:
        area.set_xticks(places, [shown(value) for value in values], rotation=20 if _long(axis) else 0)
    elif axis.scale == "log":
        area.set_xscale("log")
        area.xaxis.set_minor_formatter(NullFormatter())


def _grid(result: SweepResult, across: Axis, up: Axis, name: str) -> Float[np.ndarray, "u a"]:
    grid = np.full((len(up.values), len(across.values)), np.nan)
    for number, mean in enumerate(result.means(name)):
        place = (up.values.index(_value(result, number, up)), across.values.index(_value(result, number, across)))
        grid[place] = np.fmin(grid[place], mean)
    return grid


def _share_of_setting(result: SweepResult, axis: Axis):
    values = [_value(result, number, axis) for number in range(len(result.points))]
    if not axis.numeric:
        kinds = list(dict.fromkeys(map(str, axis.values)))
        shares = np.array([kinds.index(str(value)) / max(1, len(kinds) - 1) for value in values])
        return shares, kinds[0], kinds[-1]
    numbers = np.array(values, float)
    low, high = numbers.min(), numbers.max()
    if axis.scale == "log":
        numbers, ends = np.log(numbers), (np.log(low), np.log(high))
    else:
        ends = (low, high)
    return (numbers - ends[0]) / max(ends[1] - ends[0], 1e-300), f"{low:.3g}", f"{high:.3g}"


def _share_of_objective(means: Float[np.ndarray, "p"], digits: int):
    low, high = np.nanmin(means), np.nanmax(means)
    return (means - low) / max(high - low, 1e-300), f"{low:.{digits}f}", f"{high:.{digits}f}"


def _some(count: int) -> list[int]:
    """Up to `MOST_TICKS` places, evenly."""
    return list(range(0, count, -(-count // MOST_TICKS)))


def _long(axis: Axis) -> bool:
    return sum(len(shown(axis.values[k])) for k in _some(len(axis.values))) > 24


def _folded(name: str) -> str:
    """A name on as many lines as it has parts."""
    section, dot, rest = name.partition(".")
    return f"{section}.\n{rest}" if dot else "-\n".join(name.rsplit("-", 1))


def _name_some(area: Axes, result: SweepResult, front, x, y) -> list[str]:
    """Letters at the two ends and the middle of a front; returns what they stand for."""
    if not len(front) or not result.axes:
        return []
    named = []
    for letter, number in zip("abc", dict.fromkeys((front[0], front[len(front) // 2], front[-1])), strict=False):
        place = {"xytext": (-13, -13), "textcoords": "offset points"}
        area.annotate(letter, (x[number], y[number]), fontsize=11, fontweight="bold", color=RED, **place)
        settings = ", ".join(
            f"{path.split('.')[-1]} {shown(value)}" for path, value in result.points[number].values[:4]
        )
        named.append(f"{letter}: {settings}")
    return named
