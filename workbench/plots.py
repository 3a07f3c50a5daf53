"""Small figures for the notebooks: rows of pictures, bars, curves, matrices. Each function returns a Figure.

The figures are made without pyplot's list of open figures, so a cell that ends with one shows it once.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from workbench.energies import EnergyConstants, beta_curve, beta_slope
from workbench.geometry import Camera
from workbench.tracking import FrameFit

Picture = UInt8[np.ndarray, "_ _ 3"]
BLUE, RED, GREY, GREEN = "#2a6f97", "#c0392b", "#8d99a6", "#2d936c"
DPI = 100
PAGE_WIDTH, GAP, TITLE_HEIGHT = 8.4, 0.04, 0.26
"""Width of a notebook's outputs, space between pictures, and height of a title, inches."""
CLOSE_UP_MARGIN = 1.5
"""Side of a close-up in sides of the box around the landmarks."""


def close_up(picture: Picture, fit: FrameFit, side: int) -> tuple[Picture, FrameFit]:
    """The square around the face, `side` pixels wide, and the fit in its pixels: small faces become readable.

    The square stays inside the picture where it can; beyond it the picture's edge is repeated.
    """
    low, high = fit.observed.min(axis=0), fit.observed.max(axis=0)
    # Landmarks end at the brows, so the middle of the face lies above the middle of their box.
    half = 0.5 * CLOSE_UP_MARGIN * float(np.max(high - low))
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
        axis.legend(frameon=False, fontsize=9)
    return figure


def energy_over_iterations(curves: dict[str, np.ndarray], y_label: str = "energy") -> Figure:
    """A number after each iteration, one curve a label, on a logarithmic scale."""
    figure, axis = _axes(6.4, 3.0)
    for (label, energies), color in zip(curves.items(), (BLUE, RED, GREEN, GREY, "#e09f3e"), strict=False):
        axis.plot(np.asarray(energies), "o-", markersize=3, color=color, label=label)
    axis.set_yscale("log")
    axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.yaxis.set_major_formatter("{x:g}")
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_xlabel("iteration")
    axis.set_ylabel(y_label)
    axis.legend(frameon=False, fontsize=9)
    return figure


def curves(
    x: Float[np.ndarray, "n"],
    series: dict[str, Float[np.ndarray, "n"]],
    x_label: str,
    y_label: str,
    size: tuple[float, float] = (7.2, 2.8),
) -> Figure:
    """Lines over one axis; a series named "truth" is drawn thick and grey behind the others."""
    figure, axis = _axes(*size)
    colors = iter((BLUE, RED, GREEN, "#e09f3e"))
    for label, values in series.items():
        behind = label == "truth"
        axis.plot(
            x, values, color=GREY if behind else next(colors), linewidth=3.0 if behind else 1.2,
            label=label, zorder=1 if behind else 2,
        )  # fmt: skip
    axis.set_xlabel(x_label)
    axis.set_ylabel(y_label)
    axis.legend(frameon=False, fontsize=9)
    return figure


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


def with_points(picture: Picture, points: Float[np.ndarray, "n 2"], color: str) -> Picture:
    """A copy of the picture with dots at these pixels."""
    drawn = picture.copy()
    for x, y in np.nan_to_num(points):
        cv2.circle(drawn, (round(float(x)), round(float(y))), 2, _rgb(color), -1, cv2.LINE_AA)
    return drawn


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
    cells = [[f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in line] for line in lines]
    return "\n".join("| " + " | ".join(line) + " |" for line in cells)


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


def _plain(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)
