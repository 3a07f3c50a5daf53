"""Line plots over frames, iterations, stages and settings, and related figures."""

from collections.abc import Sequence
from itertools import cycle, pairwise

import numpy as np
from jaxtyping import Float, Int
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

from workbench.energies import EnergyConstants, beta_curve, beta_slope
from workbench.errors import InputError
from workbench.plots.figures import PAGE_WIDTH, log_where_wide, one_axis, subplots, without_frame
from workbench.plots.style import BLUE, GREEN, GREY, LINES, RED, page, styled, term_line
from workbench.tracking import Track

ANGLES, PLACES = ("yaw", "pitch", "roll"), ("x", "y", "z")


@styled
def track_curves(
    tracks: dict[str, Track],
    quantities: Sequence[str] = (*ANGLES, *PLACES),
    frames: tuple[int, int] | None = None,
    shaded: Sequence[tuple[int, int]] = (),
    columns: int = 3,
    truth: Track | None = None,
) -> Figure:
    """Parameters of several tracks over their frames, one small plot per quantity (Deep Energies Figs. 15 and 17).

    Quantities are yaw, pitch, roll (degrees), x, y, z (millimetres) and the names of blendshapes. `frames` are the
    first and last frame shown. A track named "truth" is thick and grey behind the others. `shaded` are frame ranges,
    first and last, with a grey background. With `truth`, a track of the same frames, the curves are the distances from
    it (Fig. 16).

    Raises `InputError` for a quantity that a track does not have, and for a `truth` of other frames.
    """
    for label, track in tracks.items():
        if truth is not None and len(track) != len(truth):
            raise InputError(
                f"The truth has {len(truth)} frames and the track {label!r} {len(track)}; take the same part of both."
            )
    rows = -(-len(quantities) // columns)
    figure, axes = subplots(rows, columns, (PAGE_WIDTH, 0.35 + 1.75 * rows))
    for axis, quantity in zip(axes, quantities, strict=False):
        styles = cycle(LINES)
        for label, track in tracks.items():
            behind = label == "truth"
            color, dash = (GREY, "-") if behind else next(styles)
            shown = slice(None) if frames is None else (track.index >= frames[0]) & (track.index <= frames[1])
            values = _quantity(track, quantity)
            if truth is not None:
                values = np.abs(values - _quantity(truth, quantity))
            axis.plot(
                track.index[shown], values[shown], dash, color=color,
                linewidth=3.5 if behind else 1.2,
                alpha=0.6 if behind else 1.0, label=label, zorder=1 if behind else 2,
            )  # fmt: skip
        for first, last in shaded:
            axis.axvspan(first - 0.5, last + 0.5, color=page().band, zorder=0)
        unit = ", °" if quantity in ANGLES else ", mm" if quantity in PLACES else ""
        axis.set_title(quantity + unit)
        axis.tick_params(labelsize=8)
        axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        without_frame(axis)
    for axis in axes[len(quantities) :]:
        axis.axis("off")
    for axis in axes[max(0, len(quantities) - columns) : len(quantities)]:
        axis.set_xlabel("frame")
    lines, labels = axes[0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="upper center", ncols=len(labels))
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 1.0 - 0.3 / figure.get_figheight()))
    return figure


@styled
def energy_over_iterations(curves: dict[str, np.ndarray], y_label: str = "energy") -> Figure:
    """A number after each iteration, one curve per label; logarithmic if it falls by more than a factor of ten."""
    figure, axis = one_axis(6.4, 3.0)
    for (label, energies), (color, dash) in zip(curves.items(), cycle(LINES), strict=False):
        axis.plot(np.asarray(energies), dash, marker="o", markersize=3, color=color, label=label)
    log_where_wide(axis, np.concatenate([np.asarray(energies, float) for energies in curves.values()]))
    axis.set_xlabel("iteration")
    axis.set_ylabel(y_label)
    axis.legend()
    return figure


@styled
def curves(
    x: Float[np.ndarray, "n"] | Int[np.ndarray, "n"],
    series: dict[str, Float[np.ndarray, "n"]],
    x_label: str,
    y_label: str,
    size: tuple[float, float] = (7.2, 2.8),
    log: str = "",
) -> Figure:
    """Lines over one axis; a series named "truth" is drawn thick and grey behind the others.

    `log` names the logarithmic axes: "x", "y" or "xy". If all `x` are integers, ticks are at integers.
    """
    figure, axis = one_axis(*size)
    styles = cycle(LINES)
    for label, values in series.items():
        behind = label == "truth"
        color, dash = (GREY, "-") if behind else next(styles)
        axis.plot(
            x, values, dash, color=color, linewidth=3.0 if behind else 1.4, label=label, zorder=1 if behind else 2
        )
    for name in log:
        getattr(axis, f"set_{name}scale")("log")
    if np.issubdtype(np.asarray(x).dtype, np.integer) and "x" not in log:
        axis.xaxis.set_major_locator(MaxNLocator(integer=True))
    axis.set_xlabel(x_label)
    axis.set_ylabel(y_label)
    if len(series) > 3:  # too many to fit into a corner
        axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    else:
        axis.legend()
    return figure


@styled
def energies_over_stages(
    stages: dict[str, Float[np.ndarray, "_ terms"]], terms: Sequence[str], y_label: str = "energy"
) -> Figure:
    """Each term's energy at every step of successive stages, and the sum in grey.

    A stage's rows are its start and its accepted steps; lines break between stages, where weights change. Terms that
    never change are left out of the plot and the sum. The scale is logarithmic above a thousandth of the largest value.
    """
    whole = np.concatenate(list(stages.values()))
    shown = np.flatnonzero(np.ptp(whole, axis=0) > 0.0)
    largest = float(whole[:, shown].sum(axis=1).max())
    figure, axis = one_axis(PAGE_WIDTH, 3.2)
    start, ticks, known = 0.0, [], set()
    for number, values in enumerate(stages.values()):
        place = start + np.arange(len(values))
        sums = values[:, shown].sum(axis=1)
        axis.plot(place, sums, color=GREY, linewidth=4.0, alpha=0.6, label=None if number else "sum")
        for k in shown:
            color, dash = term_line(terms[k])
            if values[:, k].any():
                label = None if k in known else terms[k]
                known.add(k)
                style = {"color": color, "linewidth": 1.2, "marker": "o", "markersize": 2.5, "label": label}
                axis.plot(place, values[:, k], dash, **style)
        ticks.append(place.mean())
        start = place[-1] + 2.0
        if number < len(stages) - 1:
            axis.axvline(start - 1.0, color=page().faint, linewidth=0.8)
    axis.set_yscale("symlog", linthresh=max(1e-3 * largest, 1e-12))
    axis.set_ylim(bottom=0.0, top=1.6 * largest)
    axis.set_xlim(-1.0, start - 1.0)
    axis.set_xticks(ticks, [_wrapped(name) for name in stages], fontsize=8)
    axis.tick_params(axis="x", length=0)
    axis.set_ylabel(y_label)
    axis.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(shown) + 1)
    return figure


@styled
def errors_per_stage(
    stages: Sequence[str], errors: dict[str, dict[str, Float[np.ndarray, "stages"]]], log: bool = True
) -> Figure:
    """Error remaining after each stage: one small plot per quantity, with one line per solver, by label."""
    figure, axes = subplots(1, len(errors), (PAGE_WIDTH, 3.3))
    place = np.arange(len(stages))
    for axis, (title, lines) in zip(axes, errors.items(), strict=True):
        for (label, values), (color, dash) in zip(lines.items(), cycle(LINES), strict=False):
            axis.plot(place, values, dash, marker="o", markersize=4, color=color, linewidth=1.4, label=label)
        axis.set_xticks(place, stages, rotation=55, ha="right", rotation_mode="anchor", fontsize=8)
        axis.set_title(title)
        left = np.concatenate([np.asarray(values, float) for values in lines.values()])
        if not (log and log_where_wide(axis, left)):
            axis.set_ylim(bottom=0.0)
        axis.grid(axis="y", color=page().faint, linewidth=0.8)
        without_frame(axis)
    if len(next(iter(errors.values()))) > 1:
        axes[0].legend(fontsize=8, loc="upper right")
    figure.tight_layout()
    return figure


@styled
def error_boxes(errors: dict[str, dict[str, Float[np.ndarray, "_"]]]) -> Figure:
    """Errors over frames as boxes with every frame as a dot: one small plot per quantity, one box per label.

    Each box spans the middle half, its line is the median, and its whiskers reach to the smallest and largest values.
    """
    figure, axes = subplots(1, len(errors), (min(2.8 * len(errors), PAGE_WIDTH), 3.0))
    rng = np.random.default_rng(0)
    for axis, (title, groups) in zip(axes, errors.items(), strict=True):
        for k, ((label, values), (color, _)) in enumerate(zip(groups.items(), cycle(LINES), strict=False)):
            drawn = axis.boxplot(
                np.asarray(values), positions=[k], widths=0.5, whis=(0, 100), showfliers=False, patch_artist=True,
                tick_labels=[_wrapped(label)], medianprops={"color": color, "linewidth": 1.8},
            )  # fmt: skip
            for part in ("boxes", "whiskers", "caps"):
                for line in drawn[part]:
                    line.set_color(color)
            drawn["boxes"][0].set_facecolor((*to_rgb(color), 0.12))
            apart = k + rng.uniform(-0.14, 0.14, len(values))
            axis.plot(apart, values, ".", color=color, markersize=4, alpha=0.7)
        axis.set_ylim(bottom=0.0)
        axis.tick_params(axis="x", length=0, labelsize=8)
        axis.set_title(title)
        without_frame(axis)
    figure.tight_layout()
    figure.draw_without_rendering()
    if any(_names_overlap(axis) for axis in axes):
        for axis in axes:
            axis.tick_params(axis="x", rotation=90)
        figure.tight_layout()
    return figure


def _names_overlap(axis: Axes) -> bool:
    """Whether names below a drawn axis lie on one another."""
    places = [label.get_window_extent() for label in axis.get_xticklabels()]
    return any(one.x1 >= other.x0 for one, other in pairwise(places))


@styled
def sweep_figure(
    x: Float[np.ndarray, "n"],
    series: dict[str, dict[str, Float[np.ndarray, "n"]]],
    x_label: str,
    levels: dict[str, float] | None = None,
) -> Figure:
    """The effect of a setting: one small plot per quantity, side by side over one logarithmic axis.

    `series` holds one line per label for each quantity. A first `x` of zero is drawn one step left of the others. The
    lowest value of each line has a ring. A quantity that spans more than a factor of ten is also logarithmic. `levels`
    are dotted lines by quantity, such as the value for the truth. Raises `InputError` without an `x` above zero.
    """
    places = np.asarray(x, float).copy()
    positive = places[places > 0.0]
    if not len(positive):
        raise InputError("A logarithmic axis needs at least one value above zero.")
    figure, axes = subplots(1, len(series), (min(2.85 * len(series), 8.6), 3.0))
    if places[0] == 0.0:
        places[0] = positive[0] ** 2 / positive[1] if len(positive) > 1 else 0.1 * positive[0]
    for axis, (title, lines) in zip(axes, series.items(), strict=True):
        for (label, values), (color, dash) in zip(lines.items(), cycle(LINES), strict=False):
            least = int(np.nanargmin(values))
            axis.plot(places, values, dash, marker="o", color=color, markersize=3.5, linewidth=1.2, label=label)
            axis.plot(places[least], values[least], "o", color=color, markersize=9, fillstyle="none")
        if levels and title in levels:
            axis.axhline(levels[title], color=page().soft, linestyle=":", linewidth=1.4)
        axis.set_xscale("log")
        axis.xaxis.set_minor_formatter(NullFormatter())
        decades = [10.0**power for power in range(-12, 13, 2) if positive[0] <= 10.0**power <= positive[-1]]
        ticks = {places[0]: f"{x[0]:g}"} | {place: f"{place:g}" for place in decades}
        axis.set_xticks(list(ticks), list(ticks.values()))
        if not log_where_wide(axis, np.array([*lines.values()])):
            axis.set_ylim(bottom=min(0.0, 1.1 * np.nanmin([*lines.values()])))
        axis.set_xlabel(x_label)
        axis.set_title(title)
        without_frame(axis)
    if len(next(iter(series.values()))) > 1:
        axes[0].legend(fontsize=8, loc="upper right")
    figure.tight_layout()
    return figure


@styled
def beta_figure(constants: EnergyConstants) -> Figure:
    """E_β over a weight, and the magnitude of its slope on a logarithmic scale (FACE IT! Eq. 12)."""
    weights = np.sort(np.concatenate([np.linspace(-0.3, 1.3, 2001), 1 - constants.a + np.linspace(-1, 1, 201) * 1e-3,
                                      constants.a + np.linspace(-1, 1, 201) * 1e-3]))  # fmt: skip
    figure, (left, right) = subplots(1, 2, (9.0, 2.9))
    left.plot(weights, np.asarray(beta_curve(weights, constants)), color=BLUE)
    right.semilogy(weights, np.abs(np.asarray(beta_slope(weights, constants))), color=RED)
    for axis, label in ((left, "E_β"), (right, "|dE_β/dw|")):
        axis.axvspan(0, 1, color=page().band, zorder=0)
        axis.set_xlabel("weight w")
        axis.set_title(label)
        without_frame(axis)
    figure.tight_layout()
    return figure


@styled
def beta_step_figure(constants: EnergyConstants, stiffness: float, weight: float = 1.0) -> Figure:
    """How a weight that has left [0, 1] is driven back: slope of E_β and Gauss–Newton steps over its distance.

    Left: |dE_β/dw| at `distance` below zero. Right: the step of one Gauss–Newton iteration towards zero if landmarks
    hold the weight with `stiffness` (the weight's diagonal entry of JᵀJ), for `weight`·E_β² and for `weight` times the
    squared distance itself.
    """
    distance = np.logspace(-4, 0, 400)
    value = np.asarray(beta_curve(-distance, constants))
    slope = np.abs(np.asarray(beta_slope(-distance, constants)))
    figure, (left, right) = subplots(1, 2, (8.4, 3.0))
    left.loglog(distance, slope, color=RED)
    left.set_title("|dE_β/dw|")
    by_beta = weight * value * slope / (weight * slope**2 + stiffness)
    right.loglog(distance, distance, color=GREY, linewidth=3.0, label="all the way back")
    right.loglog(distance, weight * distance / (weight + stiffness), "-.", color=GREEN, label="range term")
    right.loglog(distance, by_beta, color=RED, label="E_β")
    right.set_title("first Gauss–Newton step towards 0")
    right.legend(fontsize=8)
    for axis in (left, right):
        axis.set_xlabel("distance of w below 0")
        without_frame(axis)
    figure.tight_layout()
    return figure


@styled
def profiles(shapes: dict[str, Float[np.ndarray, "v 3"]], marked: Int[np.ndarray, "m"]) -> Figure:
    """Side views of heads as point clouds, with some vertices marked in red; the face looks to the left."""
    figure, axes = subplots(1, len(shapes), (2.6 * len(shapes), 2.8))
    for axis, (title, shape) in zip(axes, shapes.items(), strict=True):
        axis.plot(shape[:, 2], shape[:, 1], ".", markersize=0.8, color=BLUE)
        axis.plot(shape[marked, 2], shape[marked, 1], ".", markersize=5, color=RED)
        axis.set_title(title)
        axis.set_aspect("equal")
        axis.invert_yaxis()
        axis.axis("off")
    figure.tight_layout()
    return figure


def _quantity(track: Track, name: str) -> Float[np.ndarray, "n"]:
    if name in ANGLES:
        return track.angles_deg[:, ANGLES.index(name)]
    if name in PLACES:
        return track.translation[:, PLACES.index(name)]
    if name in track.expression_names:
        return track.expression[:, track.expression_names.index(name)]
    raise InputError(
        f"A curve shows {', '.join((*ANGLES, *PLACES))} or a blendshape of the track, got {name!r}; see the track's "
        "expression_names."
    )


def _wrapped(text: str) -> str:
    """A long name on two lines, broken near its middle."""
    gaps = [k for k, letter in enumerate(text) if letter == " "]
    if len(text) < 9 or not gaps:
        return text
    gap = min(gaps, key=lambda k: abs(2 * k - len(text)))
    return text[:gap] + "\n" + text[gap + 1 :]
