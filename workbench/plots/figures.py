"""Shared parts of the figures: sizes, empty figures and axes, the logarithmic scale."""

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from workbench.plots.style import TICK_PT

Picture = UInt8[np.ndarray, "_ _ 3"]
DPI = 100
PAGE_WIDTH, GAP, TITLE_HEIGHT = 8.4, 0.04, 0.26
"""Width of a notebook's outputs, space between pictures, and height of a title, inches."""


def log_where_wide(axis: Axes, values: Float[np.ndarray, "..."]) -> bool:
    """Make the y axis logarithmic if positive values span more than a factor of ten. Returns whether they do."""
    least, most = np.nanmin(values), np.nanmax(values)
    wide = bool(most > 10.0 * least > 0.0)
    if wide:
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())
    return wide


def one_axis(width: float, height: float) -> tuple[Figure, Axes]:
    figure, axis = subplots(1, 1, (width, height))
    without_frame(axis[0])
    figure.set_layout_engine("tight")
    return figure, axis[0]


def subplots(rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, np.ndarray]:
    figure = empty_figure(*size)
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes:
        axis.tick_params(labelsize=TICK_PT)
    return figure, axes


def empty_figure(width: float, height: float) -> Figure:
    figure = pyplot.figure(figsize=(width, height), dpi=DPI)
    pyplot.close(figure)
    return figure


def without_frame(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)
