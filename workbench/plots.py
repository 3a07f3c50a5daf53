"""Small figures for the notebooks: rows of pictures, bars, curves, matrices. Each function returns a Figure.

The figures are made without pyplot's list of open figures, so a cell that ends with one shows it once.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib import colormaps, pyplot
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.figure import Figure
from matplotlib.patheffects import Normal, Stroke
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from workbench.arrays import AnyArray
from workbench.energies import EnergyConstants, beta_curve, beta_slope
from workbench.errors import InputError
from workbench.face import FaceModel
from workbench.face.jaw import posed_vertices
from workbench.geometry import Camera
from workbench.landmarks.scheme import GROUPS
from workbench.pictures import HeadPanel, OverlayParts, draw_overlay, head_painter
from workbench.tracking import FrameFit, Track

Picture = UInt8[np.ndarray, "_ _ 3"]
BLUE, RED, GREY, GREEN, AMBER = "#2a6f97", "#c0392b", "#8d99a6", "#2d936c", "#e09f3e"
LINES = ((BLUE, "-"), (RED, "--"), (GREEN, "-."), (AMBER, "-"), ("#5e548e", ":"))
"""Colour and dash of the lines of one figure in turn: the dash tells them apart without colour."""
STRIP_ROWS = ("jaw", "brows", "nose", "eyes", "mouth")
WORST_PERCENT = 10.0
"""Bright end of the residual colours, % of the outer-eye distance, as in the overlays."""
DPI = 100
PAGE_WIDTH, GAP, TITLE_HEIGHT = 8.4, 0.04, 0.26
"""Width of a notebook's outputs, space between pictures, and height of a title, inches."""
CLOSE_UP_MARGIN = 1.5
"""Side of a close-up in sides of the box around the landmarks."""
HEAD_CUT = 1.35
"""Side of a rendered head in sides of the part of it that is shown."""
STRIP_LABEL, STRIP_LARGEST = 0.24, 2.0
"""Film strips: room for the rows' names, and the largest side of a picture, inches."""
STRIP_MARGIN, HEAD_SHARE = 1.2, 0.6
"""Film strips: as `CLOSE_UP_MARGIN`, and how much the head hides of the picture."""
LINES_ALONE = OverlayParts(observed=False, model_points=False, residuals=False, axes=False, text=False, legend=False)
ANGLES, PLACES = ("yaw", "pitch", "roll"), ("x", "y", "z")


def close_up(
    picture: Picture,
    fit: FrameFit,
    side: int,
    about: Float[np.ndarray, "n 2"] | None = None,
    margin: float = CLOSE_UP_MARGIN,
) -> tuple[Picture, FrameFit]:
    """The square around the face, `side` pixels wide, and the fit in its pixels: small faces become readable.

    The square is `margin` times as wide as the box of the points `about`, the observed landmarks by default. It stays
    inside the picture where it can; beyond it the picture's edge is repeated.
    """
    points = fit.observed if about is None else about
    low, high = points.min(axis=0), points.max(axis=0)
    # Landmarks end at the brows, so the middle of the face lies above the middle of their box.
    half = 0.5 * margin * float(np.max(high - low))
    corner = (low + high) / 2 - half - np.array([0.0, 0.12 * half])
    room = np.array([picture.shape[1], picture.shape[0]]) - 2 * half
    corner = np.where(room > 0, np.clip(corner, -0.5, room - 0.5), corner)
    scale = side / (2 * half)
    matrix = np.array([[scale, 0.0, -0.5], [0.0, scale, -0.5]])
    matrix[:, 2] += scale * (0.5 - corner)
    size = (side, side)
    cut = cv2.warpAffine(picture, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)

    def moved(points):
        return points @ matrix[:, :2].T + matrix[:, 2]

    camera = Camera(
        np.asarray(fit.camera.focal_px) * scale, moved(np.asarray(fit.camera.principal_point_px)), fit.camera.distortion
    )
    return cut, replace(
        fit, image_size=size, camera=camera, observed=moved(fit.observed), projected=moved(fit.projected)
    )


def pictures_in_a_row(pictures: Sequence[Picture], titles: Sequence[str] = (), columns: int | None = None) -> Figure:
    """Pictures side by side, or in rows of `columns`, each under its title; wide rows are reduced to the page.

    Pictures of one call should have one size.
    """
    columns = min(columns or len(pictures), len(pictures))
    rows = -(-len(pictures) // columns)
    height, width = np.max([picture.shape[:2] for picture in pictures], axis=0) / DPI
    scale = min(1.0, (PAGE_WIDTH - GAP * (columns - 1)) / (columns * width))
    width, height = scale * width, scale * height
    # A row whose titles are all empty needs no room for them.
    titled = [any(titles[row * columns : (row + 1) * columns]) for row in range(rows)]
    heads = [TITLE_HEIGHT if has_title else GAP for has_title in titled]
    total_width, total_height = columns * width + (columns - 1) * GAP, rows * height + sum(heads)
    figure = _figure(total_width, total_height)
    for k, picture in enumerate(pictures):
        row, column = divmod(k, columns)
        bottom = total_height - sum(heads[: row + 1]) - (row + 1) * height
        left = column * (width + GAP)
        axis = figure.add_axes((left / total_width, bottom / total_height, width / total_width, height / total_height))
        axis.imshow(picture)
        axis.axis("off")
        if titled[row]:
            axis.set_title(titles[k], fontsize=9, pad=4)
    return figure


def film_strip(
    model: FaceModel,
    pictures: Sequence[Picture],
    rows: dict[str, Sequence[FrameFit]],
    notes: dict[str, Sequence[str]] | None = None,
) -> Figure:
    """Frames side by side: the pictures, and in a row for each label its fits as heads over them.

    `rows[label][k]` is a fit to `pictures[k]`, and `notes[label][k]` is written into its corner. A column shows the
    same square in all rows. The head lets the picture shine through, so that what does not match looks double; lines
    are the model's landmarks. A frame without a face is dark. Raises `InputError` where no row has a face in a frame.

    Deep Energies Figs. 8, 13, 14 and 18.
    """
    count = len(pictures)
    across = PAGE_WIDTH - STRIP_LABEL - GAP * count
    side = int(min(across / count, STRIP_LARGEST) * DPI)
    fine = 2 * side  # drawn at twice the size, so that lines are thin and smooth
    panels: list[list[Picture]] = [[] for _ in range(len(rows) + 1)]
    with head_painter(model, (fine, fine), texture=False, fade_neck=True) as painter:
        for k, picture in enumerate(pictures):
            column = [fits[k] for fits in rows.values()]
            found = [fit.projected for fit in column if fit.found]
            if not found:
                raise InputError(f"Frame {column[0].index} of the film strip has no face in any row; leave it out.")
            square = {"about": np.median(found, axis=0), "margin": STRIP_MARGIN}
            photo, _ = close_up(picture, column[0], fine, **square)
            panels[0].append(_resized(photo, side))
            for row, fit in zip(panels[1:], column, strict=True):
                row.append(_resized(_head_over(model, painter, *close_up(picture, fit, fine, **square)), side))
    return _labelled_rows(
        panels,
        [f"frame {fit.index}" for fit in next(iter(rows.values()))],
        ["picture", *rows],
        [[""] * count, *(notes.get(label, [""] * count) if notes else [""] * count for label in rows)],
    )


def _head_over(model: FaceModel, painter, photo: Picture, fit: FrameFit) -> Picture:
    """The head of a fit over the picture, drawn by a `HeadPainter` of the picture's size."""
    if not fit.found:
        return photo // 3
    vertices = posed_vertices(model.personal(fit.identity), fit.expression, fit.jaw, fit.scale)
    head = painter.render(vertices, fit.camera, fit.rotation, fit.translation, background=photo)
    mixed = cv2.addWeighted(head, HEAD_SHARE, photo, 1.0 - HEAD_SHARE, 0.0)
    return draw_overlay(mixed, fit, parts=LINES_ALONE)


def _labelled_rows(
    panels: Sequence[Sequence[Picture]], tops: Sequence[str], labels: Sequence[str], notes: Sequence[Sequence[str]]
) -> Figure:
    """Square pictures in a table under their columns' names, rows named on the left."""
    side = len(panels[0][0]) / DPI
    width, height = STRIP_LABEL + len(tops) * (side + GAP), TITLE_HEIGHT + len(panels) * (side + GAP)
    figure = _figure(width, height)
    for row, (pictures, label, said) in enumerate(zip(panels, labels, notes, strict=True)):
        bottom = height - TITLE_HEIGHT - row * (side + GAP) - side
        figure.text(
            0.45 * STRIP_LABEL / width, (bottom + side / 2) / height, label, rotation=90, ha="center", va="center",
            fontsize=9,
        )  # fmt: skip
        for column, (picture, note) in enumerate(zip(pictures, said, strict=True)):
            left = STRIP_LABEL + column * (side + GAP)
            axis = figure.add_axes((left / width, bottom / height, side / width, side / height))
            axis.imshow(picture)
            axis.axis("off")
            axis.text(0.97, 0.03, note, transform=axis.transAxes, ha="right", va="bottom", fontsize=8, color="white",
                      path_effects=[Stroke(linewidth=2, foreground="0.1"), Normal()])  # fmt: skip
            if row == 0:
                axis.set_title(tops[column], fontsize=9, pad=4)
    return figure


def track_curves(
    tracks: dict[str, Track],
    quantities: Sequence[str] = (*ANGLES, *PLACES),
    frames: tuple[int, int] | None = None,
    shaded: Sequence[tuple[int, int]] = (),
    columns: int = 3,
) -> Figure:
    """Parameters of several tracks over their frames, one small plot a quantity (Deep Energies Figs. 15 and 17).

    Quantities are yaw, pitch, roll (degrees), x, y, z (millimetres) and the names of blendshapes. `frames` are the
    first and last one that are shown. A track named "truth" is thick and grey behind the others. `shaded` are parts of
    frames, first and last, on a grey ground.

    Raises `InputError` for a quantity that a track does not have.
    """
    rows = -(-len(quantities) // columns)
    figure, axes = _subplots(rows, columns, (PAGE_WIDTH, 0.35 + 1.75 * rows))
    for axis, quantity in zip(axes, quantities, strict=False):
        styles = iter(LINES)
        for label, track in tracks.items():
            behind = label == "truth"
            color, dash = (GREY, "-") if behind else next(styles)
            shown = slice(None) if frames is None else (track.index >= frames[0]) & (track.index <= frames[1])
            axis.plot(
                track.index[shown], _quantity(track, quantity)[shown], dash, color=color,
                linewidth=3.5 if behind else 1.2,
                alpha=0.6 if behind else 1.0, label=label, zorder=1 if behind else 2,
            )  # fmt: skip
        for first, last in shaded:
            axis.axvspan(first - 0.5, last + 0.5, color="0.93", zorder=0)
        unit = ", °" if quantity in ANGLES else ", mm" if quantity in PLACES else ""
        axis.set_title(quantity + unit, fontsize=9)
        axis.tick_params(labelsize=8)
        axis.xaxis.set_major_locator(MaxNLocator(5, integer=True))
        _plain(axis)
    for axis in axes[len(quantities) :]:
        axis.axis("off")
    for axis in axes[max(0, len(quantities) - columns) : len(quantities)]:
        axis.set_xlabel("frame", fontsize=9)
    lines, labels = axes[0].get_legend_handles_labels()
    figure.legend(lines, labels, frameon=False, fontsize=9, loc="upper center", ncols=len(labels))
    figure.tight_layout(rect=(0.0, 0.0, 1.0, 1.0 - 0.3 / figure.get_figheight()))
    return figure


def _quantity(track: Track, name: str) -> Float[np.ndarray, "n"]:
    if name in ANGLES:
        return track.angles_deg[:, ANGLES.index(name)]
    if name in PLACES:
        return track.translation[:, PLACES.index(name)]
    if name in track.expression_names:
        return track.expression[:, track.expression_names.index(name)]
    raise InputError(
        f"Curves are of {', '.join((*ANGLES, *PLACES))} or a blendshape of the track, got {name!r}; its "
        "expression_names are the blendshapes."
    )


def strongest_weights(
    names: Sequence[str],
    weights: Float[np.ndarray, "k"] | dict[str, np.ndarray],
    count: int = 12,
    x_label: str = "weight",
    in_range: tuple[float, float] | None = (0.0, 1.0),
) -> Figure:
    """Bars of the largest weights by size; for several vectors by label, grouped bars in the order of the largest.

    `in_range` is shaded.
    """
    series = weights if isinstance(weights, dict) else {"": weights}
    values = np.array(list(series.values()))
    order = np.argsort(-np.abs(values).max(axis=0), kind="stable")[:count][::-1]
    figure, axis = _axes(6.4, 0.7 + 0.25 * count * (0.5 + 0.5 * len(series)))
    thick = 0.8 / len(series)
    for k, (label, row) in enumerate(zip(series, values, strict=True)):
        place = np.arange(len(order)) + thick * ((len(series) - 1) / 2 - k)
        axis.barh(place, row[order], thick, color=(BLUE, RED, GREEN, GREY)[k], label=label)
    axis.set_yticks(np.arange(len(order)), [names[k] for k in order], fontsize=9)
    axis.set_xlabel(x_label)
    if in_range is not None:
        axis.axvspan(*in_range, color="0.95", zorder=0)
    axis.axvline(0, color="0.3", linewidth=0.8)
    if len(series) > 1:
        axis.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


def energy_over_iterations(curves: dict[str, np.ndarray], y_label: str = "energy") -> Figure:
    """A number after each iteration, one curve a label; on a logarithmic scale where it falls by more than ten."""
    figure, axis = _axes(6.4, 3.0)
    for (label, energies), (color, dash) in zip(curves.items(), LINES, strict=False):
        axis.plot(np.asarray(energies), dash, marker="o", markersize=3, color=color, label=label)
    positive = np.concatenate([np.asarray(energies, float) for energies in curves.values()])
    if positive.max() > 10.0 * positive.min() > 0.0:
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("iteration")
    axis.set_ylabel(y_label)
    axis.legend(frameon=False, fontsize=9)
    return figure


def curves(
    x: Float[np.ndarray, "n"] | Int[np.ndarray, "n"],
    series: dict[str, Float[np.ndarray, "n"]],
    x_label: str,
    y_label: str,
    size: tuple[float, float] = (7.2, 2.8),
    log: str = "",
) -> Figure:
    """Lines over one axis; a series named "truth" is drawn thick and grey behind the others.

    `log` names the logarithmic axes: "x", "y" or "xy". Whole numbers `x` have ticks at whole numbers.
    """
    figure, axis = _axes(*size)
    styles = iter(LINES)
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
    if len(series) > 3:  # too many to find a free corner for
        axis.legend(frameon=False, fontsize=9, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    else:
        axis.legend(frameon=False, fontsize=9)
    return figure


def energies_over_stages(
    stages: dict[str, Float[np.ndarray, "_ terms"]], terms: Sequence[str], y_label: str = "energy"
) -> Figure:
    """Each term's energy at every step of a solve in stages, one after the other, and their sum in grey.

    A stage's rows are its start and its accepted steps; lines break between stages, where weights change. Terms that
    never change are left out, also of the sum. The scale is logarithmic above a thousandth of the largest value.
    """
    whole = np.concatenate(list(stages.values()))
    shown = np.flatnonzero(np.ptp(whole, axis=0) > 0.0)
    largest = float(whole[:, shown].sum(axis=1).max())
    figure, axis = _axes(PAGE_WIDTH, 3.2)
    start, ticks, known = 0.0, [], set()
    for number, values in enumerate(stages.values()):
        place = start + np.arange(len(values))
        sums = values[:, shown].sum(axis=1)
        axis.plot(place, sums, color=GREY, linewidth=4.0, alpha=0.6, label=None if number else "sum")
        for (color, dash), k in zip(LINES, shown, strict=False):
            if values[:, k].any():
                label = None if k in known else terms[k]
                known.add(k)
                style = {"color": color, "linewidth": 1.2, "marker": "o", "markersize": 2.5, "label": label}
                axis.plot(place, values[:, k], dash, **style)
        ticks.append(place.mean())
        start = place[-1] + 2.0
        if number < len(stages) - 1:
            axis.axvline(start - 1.0, color="0.75", linewidth=0.8)
    axis.set_yscale("symlog", linthresh=max(1e-3 * largest, 1e-12))
    axis.set_ylim(bottom=0.0, top=1.6 * largest)
    axis.set_xlim(-1.0, start - 1.0)
    axis.set_xticks(ticks, [_wrapped(name) for name in stages], fontsize=8)
    axis.tick_params(axis="x", length=0)
    axis.set_ylabel(y_label)
    axis.legend(frameon=False, fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(shown) + 1)
    return figure


def errors_per_stage(
    stages: Sequence[str], errors: dict[str, dict[str, Float[np.ndarray, "stages"]]], log: bool = True
) -> Figure:
    """What each stage left of an error: one small plot a quantity, in it a line for each way to solve, by label."""
    figure, axes = _subplots(1, len(errors), (PAGE_WIDTH, 3.3))
    place = np.arange(len(stages))
    for axis, (title, lines) in zip(axes, errors.items(), strict=True):
        for (label, values), (color, dash) in zip(lines.items(), LINES, strict=False):
            axis.plot(place, values, dash, marker="o", markersize=4, color=color, linewidth=1.4, label=label)
        axis.set_xticks(place, stages, rotation=55, ha="right", rotation_mode="anchor", fontsize=8)
        axis.set_title(title, fontsize=9)
        positive = np.concatenate([np.asarray(values, float) for values in lines.values()])
        if log and positive.max() > 10.0 * positive.min() > 0.0:
            axis.set_yscale("log")
            axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.yaxis.set_major_formatter("{x:g}")
            axis.yaxis.set_minor_formatter(NullFormatter())
        else:
            axis.set_ylim(bottom=0.0)
        axis.grid(axis="y", color="0.92", linewidth=0.8)
        _plain(axis)
    if len(next(iter(errors.values()))) > 1:
        axes[0].legend(frameon=False, fontsize=8, loc="upper right")
    figure.tight_layout()
    return figure


def error_boxes(errors: dict[str, dict[str, Float[np.ndarray, "_"]]]) -> Figure:
    """Errors over frames as boxes with every frame as a dot: one small plot a quantity, a box a label.

    Each box spans the middle half, its line is the median, and its whiskers reach to the least and the largest.
    """
    figure, axes = _subplots(1, len(errors), (min(2.8 * len(errors), PAGE_WIDTH), 3.0))
    rng = np.random.default_rng(0)
    for axis, (title, groups) in zip(axes, errors.items(), strict=True):
        for k, ((label, values), (color, _)) in enumerate(zip(groups.items(), LINES, strict=False)):
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
        axis.set_title(title, fontsize=9)
        _plain(axis)
    figure.tight_layout()
    return figure


def sweep_figure(
    x: Float[np.ndarray, "n"],
    series: dict[str, dict[str, Float[np.ndarray, "n"]]],
    x_label: str,
    levels: dict[str, float] | None = None,
) -> Figure:
    """What a setting does: one small plot a quantity, side by side over one logarithmic axis.

    `series` holds for each quantity a line a label. A first `x` of zero stands one step left of the others. The least
    value of each line has a ring. A quantity that spans more than a factor of ten is logarithmic, too. `levels` are
    dotted lines by quantity, such as what the truth has.
    """
    figure, axes = _subplots(1, len(series), (min(2.85 * len(series), 8.6), 3.0))
    places = np.asarray(x, float).copy()
    if places[0] == 0.0:
        places[0] = places[1] ** 2 / places[2]
    for axis, (title, lines) in zip(axes, series.items(), strict=True):
        for (label, values), (color, dash) in zip(lines.items(), LINES, strict=False):
            least = int(np.nanargmin(values))
            axis.plot(places, values, dash, marker="o", color=color, markersize=3.5, linewidth=1.2, label=label)
            axis.plot(places[least], values[least], "o", color=color, markersize=9, fillstyle="none")
        if levels and title in levels:
            axis.axhline(levels[title], color="0.4", linestyle=":", linewidth=1.4)
        axis.set_xscale("log")
        axis.xaxis.set_minor_formatter(NullFormatter())
        decades = [10.0**power for power in range(-12, 13, 2) if places[1] <= 10.0**power <= places[-1]]
        ticks = {places[0]: f"{x[0]:g}"} | {place: f"{place:g}" for place in decades}
        axis.set_xticks(list(ticks), list(ticks.values()))
        least, most = np.nanmin([*lines.values()]), np.nanmax([*lines.values()])
        if most > 10.0 * least > 0.0:
            axis.set_yscale("log")
            axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axis.yaxis.set_major_formatter("{x:g}")
            axis.yaxis.set_minor_formatter(NullFormatter())
        else:
            axis.set_ylim(bottom=min(0.0, 1.1 * least))
        axis.set_xlabel(x_label)
        axis.set_title(title, fontsize=9)
        _plain(axis)
    if len(next(iter(series.values()))) > 1:
        axes[0].legend(frameon=False, fontsize=8, loc="upper right")
    figure.tight_layout()
    return figure


def heat_map(
    values: Float[np.ndarray, "r c"],
    rows: Sequence[object],
    columns: Sequence[object],
    row_label: str,
    column_label: str,
    value_label: str,
    log: bool = False,
) -> Figure:
    """A table of positive numbers in colour, each number written into its cell."""
    values = np.asarray(values)
    height = 1.1 + 0.36 * len(rows)
    figure, axis = _axes(min(2.4 + 0.72 * len(columns), PAGE_WIDTH), height)
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
    bar.set_label(value_label, fontsize=9)
    return figure


def residual_strip(fits: Sequence[FrameFit], flagged: Sequence[bool] | None = None, frame: int | None = None) -> Figure:
    """Error of every landmark in every frame of a clip, in % of the outer-eye distance, as the panel's timeline.

    Rows are sorted by the parts of the face; grey frames have no face. Triangles mark `flagged` frames, a line `frame`.
    """
    order = [point for group in STRIP_ROWS for point in GROUPS[group]]
    values = np.full((68, len(fits)), np.nan)
    for column, fit in enumerate(fits):
        if fit.found:
            values[:, column] = fit.residuals_percent[order]
    figure, axis = _axes(8.4, 2.5)
    axis.set_facecolor("0.8")
    shown = axis.imshow(
        values, cmap="viridis", vmin=0.0, vmax=WORST_PERCENT, aspect="auto", interpolation="nearest",
        extent=(-0.5, len(fits) - 0.5, 67.5, -0.5),
    )  # fmt: skip
    ends = np.cumsum([0, *(len(GROUPS[group]) for group in STRIP_ROWS)])
    axis.set_yticks((ends[:-1] + ends[1:] - 1) / 2, STRIP_ROWS)
    axis.tick_params(axis="y", length=0)
    for end in ends[1:-1]:
        axis.axhline(end - 0.5, color="white", linewidth=0.8)
    if flagged is not None and any(flagged):
        places = np.flatnonzero(np.asarray(flagged))
        axis.plot(places, np.full(len(places), -3.5), "v", color=RED, markersize=5, clip_on=False)
    if frame is not None:
        axis.axvline(frame, color="white", linewidth=1.6)
        axis.axvline(frame, color="0.1", linewidth=0.8, linestyle="--")
    axis.set_xlim(-0.5, len(fits) - 0.5)
    axis.set_ylim(67.5, -0.5)
    axis.set_xlabel("frame")
    bar = figure.colorbar(shown, pad=0.015, extend="max")
    bar.set_label("error, % of eye distance", fontsize=8)
    return figure


def compared_fits(
    model: FaceModel,
    picture: Picture | None,
    fits: dict[str, FrameFit],
    side: int = 300,
    view: str = "pose",
    columns: int | None = None,
) -> Figure:
    """Fits of one frame side by side under their labels: drawn into the picture, and below as heads in 3D.

    One fit alone has its head beside it; without a picture there are heads only, in rows of `columns`. `view` "pose"
    turns the heads with the face, "front" leaves them frontal. All close-ups show the same square.
    """
    wide = round(HEAD_CUT * side)
    with HeadPanel(model, (wide, wide), view) as panel:
        whole = [panel.submit(fit).result()[0] for fit in fits.values()]
    edge = round(len(whole[0]) * (1.0 - 1.0 / HEAD_CUT) / 2)
    heads = [_resized(head[edge : len(head) - edge, edge : len(head) - edge], side) for head in whole]
    if picture is None:
        return pictures_in_a_row(heads, list(fits), columns)
    parts = OverlayParts(text=False, legend=False)
    overlays = [draw_overlay(*close_up(picture, fit, side), parts=parts) for fit in fits.values()]
    overlays = [_resized(overlay, side) for overlay in overlays]  # small ones come enlarged
    if len(fits) == 1:
        return pictures_in_a_row([*overlays, *heads], [*fits, ""])
    return pictures_in_a_row([*overlays, *heads], [*fits, *([""] * len(fits))], columns=len(fits))


def beta_figure(constants: EnergyConstants) -> Figure:
    """E_β over a weight, and the size of its slope on a logarithmic scale (FACE IT! Eq. 12)."""
    weights = np.sort(np.concatenate([np.linspace(-0.3, 1.3, 2001), 1 - constants.a + np.linspace(-1, 1, 201) * 1e-3,
                                      constants.a + np.linspace(-1, 1, 201) * 1e-3]))  # fmt: skip
    figure, (left, right) = _subplots(1, 2, (9.0, 2.9))
    left.plot(weights, np.asarray(beta_curve(weights, constants)), color=BLUE)
    right.semilogy(weights, np.abs(np.asarray(beta_slope(weights, constants))), color=RED)
    for axis, label in ((left, "E_β"), (right, "|dE_β/dw|")):
        axis.axvspan(0, 1, color="0.95", zorder=0)
        axis.set_xlabel("weight w")
        axis.set_title(label, fontsize=10)
        _plain(axis)
    figure.tight_layout()
    return figure


def beta_step_figure(constants: EnergyConstants, stiffness: float, weight: float = 1.0) -> Figure:
    """How a weight that has left [0, 1] is driven back: slope of E_β and Gauss–Newton steps over its distance.

    Left |dE_β/dw| below zero by `distance`. Right the step of one Gauss–Newton iteration towards zero, where landmarks
    hold the weight with `stiffness` (the weight's diagonal entry of JᵀJ): by `weight`·E_β² and by `weight` times the
    squared distance itself.
    """
    distance = np.logspace(-4, 0, 400)
    value = np.asarray(beta_curve(-distance, constants))
    slope = np.abs(np.asarray(beta_slope(-distance, constants)))
    figure, (left, right) = _subplots(1, 2, (8.4, 3.0))
    left.loglog(distance, slope, color=RED)
    left.set_title("|dE_β/dw|", fontsize=10)
    by_beta = weight * value * slope / (weight * slope**2 + stiffness)
    right.loglog(distance, distance, color=GREY, linewidth=3.0, label="all the way back")
    right.loglog(distance, weight * distance / (weight + stiffness), "-.", color=GREEN, label="range term")
    right.loglog(distance, by_beta, color=RED, label="E_β")
    right.set_title("first Gauss–Newton step towards 0", fontsize=10)
    right.legend(frameon=False, fontsize=8)
    for axis in (left, right):
        axis.set_xlabel("distance of w below 0")
        _plain(axis)
    figure.tight_layout()
    return figure


def matrix_figure(names: Sequence[str], matrix: Float[np.ndarray, "k k"], title: str) -> Figure:
    """A square matrix of values between −1 and 1 in colour, rows and columns by name."""
    side = 1.6 + 0.17 * len(names)
    figure, axis = _axes(side + 0.6, side)
    shown = axis.imshow(matrix, cmap="RdBu", vmin=-1, vmax=1, interpolation="nearest")
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axis.set_yticks(range(len(names)), names, fontsize=7)
    axis.set_title(title, fontsize=10)
    figure.colorbar(shown, shrink=0.6, pad=0.02)
    return figure


def with_points(picture: Picture, points: Float[np.ndarray, "n 2"], color: str, radius: int = 2) -> Picture:
    """A copy of the picture with dots of `radius` pixels at these pixels."""
    drawn = picture.copy()
    for x, y in np.nan_to_num(points):
        cv2.circle(drawn, (round(float(x)), round(float(y))), radius, _rgb(color), -1, cv2.LINE_AA)
    return drawn


def with_arrows(
    picture: Picture, points: Float[np.ndarray, "n 2"], vectors: Float[np.ndarray, "n 2"], color: str
) -> Picture:
    """A copy of the picture with an arrow of `vectors` pixels at each of these pixels."""
    drawn = picture.copy()
    fraction_bits = 4
    ends = np.stack([points, points + vectors], axis=1)
    for tail, tip in np.rint(np.nan_to_num(ends) * 2**fraction_bits).astype(int):
        length = float(np.hypot(*(tip - tail))) / 2**fraction_bits
        head = min(0.4, 4.0 / max(length, 1e-6))
        cv2.arrowedLine(drawn, tuple(tail), tuple(tip), _rgb(color), 1, cv2.LINE_AA, fraction_bits, head)
    return drawn


def as_picture(values: Float[AnyArray, "h w 3"]) -> Picture:
    """Colours of 0 to 1, as the renderer has them, as a picture; beyond the range they are clipped."""
    return np.rint(255.0 * np.clip(np.asarray(values), 0.0, 1.0)).astype(np.uint8)


def signed_picture(values: Float[AnyArray, "h w"], limit: float | None = None) -> Picture:
    """Signed numbers as colours: white is zero, red is `limit` and more, blue is −`limit` and less.

    `limit` is the largest size of all values if it is not given.
    """
    values = np.asarray(values)
    limit = float(np.abs(values).max()) if limit is None else limit
    return as_picture(colormaps["RdBu_r"](0.5 + 0.5 * values / max(limit, 1e-30))[..., :3])


def heat_over(picture: Picture, heat: Float[AnyArray, "m n"], color: str = AMBER) -> Picture:
    """The picture in grey, and over it in colour where `heat` is high: 0 shows none of it, 1 and more all of it.

    A map that is smaller than the picture is enlarged, pixel edges to pixel edges.
    """
    size = picture.shape[1], picture.shape[0]
    share = np.clip(cv2.resize(np.asarray(heat, np.float32), size, interpolation=cv2.INTER_NEAREST), 0.0, 1.0)
    grey = np.repeat(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2) / 255.0
    return as_picture(grey + share[..., None] * (np.array(to_rgb(color)) - grey))


def ball_normals(side: int) -> Float[np.ndarray, "s s 3"]:
    """Camera-frame normals of a ball that fills a square picture of `side` pixels, seen in parallel; NaN around it."""
    y, x = (np.mgrid[:side, :side] - (side - 1) / 2) / (side / 2)
    square = 1.0 - x * x - y * y
    return np.where(square[..., None] > 0.0, np.stack([x, y, -np.sqrt(np.maximum(square, 0.0))], axis=-1), np.nan)


def profiles(shapes: dict[str, Float[np.ndarray, "v 3"]], marked: Int[np.ndarray, "m"]) -> Figure:
    """Heads from the side as clouds of points, with some vertices marked in red: the face looks to the left."""
    figure, axes = _subplots(1, len(shapes), (2.6 * len(shapes), 2.8))
    for axis, (title, shape) in zip(axes, shapes.items(), strict=True):
        axis.plot(shape[:, 2], shape[:, 1], ".", markersize=0.8, color=BLUE)
        axis.plot(shape[marked, 2], shape[marked, 1], ".", markersize=5, color=RED)
        axis.set_title(title, fontsize=9)
        axis.set_aspect("equal")
        axis.invert_yaxis()
        axis.axis("off")
    figure.tight_layout()
    return figure


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Rows as a Markdown table; floats are shown with three digits."""
    lines = [header, ["---"] * len(header), *rows]
    cells = [[_cell(cell) for cell in line] for line in lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in cells)


def _resized(picture: Picture, side: int) -> Picture:
    method = cv2.INTER_AREA if len(picture) > side else cv2.INTER_LINEAR
    return cv2.resize(picture, (side, side), interpolation=method)


def _cell(value: object) -> str:
    text = f"{value:.3g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|")  # a bar would end the cell


def _rgb(color: str) -> tuple[int, int, int]:
    return tuple(round(255 * part) for part in to_rgb(color))


def _axes(width: float, height: float) -> tuple[Figure, Axes]:
    figure, axis = _subplots(1, 1, (width, height))
    _plain(axis[0])
    figure.set_layout_engine("tight")
    return figure, axis[0]


def _subplots(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, np.ndarray]:
    figure = _figure(*size)
    return figure, figure.subplots(rows, columns, squeeze=False).ravel()


def _figure(width: float, height: float) -> Figure:
    figure = pyplot.figure(figsize=(width, height), dpi=DPI)
    pyplot.close(figure)
    return figure


def _wrapped(text: str) -> str:
    """A long name in two lines, broken near its middle."""
    gaps = [k for k, letter in enumerate(text) if letter == " "]
    if len(text) < 9 or not gaps:
        return text
    gap = min(gaps, key=lambda k: abs(2 * k - len(text)))
    return text[:gap] + "\n" + text[gap + 1 :]


def _plain(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)
