"""The 68 landmarks on a mean face, coloured by a number each."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from workbench.landmarks.alignment import MEAN_SHAPE
from workbench.plots.figures import PAGE_WIDTH, subplots
from workbench.plots.style import page, styled

NAMED, APART = 8, 0.09
"""How many of the landmarks with the smallest factors have their numbers, and how far from each other, face widths."""


@styled
def point_factors(
    factors: dict[str, Float[np.ndarray, "68"]], marked: Mapping[str, Sequence[int]] = MappingProxyType({})
) -> Figure:
    """How far each landmark is trusted, one face per labelled set of factors above 0: blue above 1, red below.

    The smallest have their numbers; `marked` landmarks, by label, have a square around them.
    """
    width = min(3.8 * len(factors) + 0.9, PAGE_WIDTH)
    figure, axes = subplots(1, len(factors), (width, 3.9))
    farthest = max(2.0, *(float(np.exp(np.abs(np.log(values)).max())) for values in factors.values()))
    scale = LogNorm(1.0 / farthest, farthest)
    for axis, (title, values) in zip(axes, factors.items(), strict=True):
        shown = _drawn(axis, np.asarray(values), scale, marked.get(title, ()))
        axis.set_title(title)
    figure.tight_layout(rect=(0.0, 0.0, 1.0 - 0.95 / width, 1.0))
    place = figure.add_axes((1.0 - 0.85 / width, 0.15, 0.16 / width, 0.7))
    bar = figure.colorbar(shown, cax=place)
    bar.formatter = bar.minorformatter = "{x:g}"
    bar.set_ticks([1.0 / farthest, 1.0, farthest], labels=[f"{1.0 / farthest:.2g}", "1", f"{farthest:.2g}"])
    bar.ax.minorticks_off()
    bar.set_label("factor")
    return figure


def _drawn(axis: Axes, values: Float[np.ndarray, "68"], scale: LogNorm, marked: Sequence[int]):
    ink, soft = page().ink, page().soft
    shown = axis.scatter(*MEAN_SHAPE.T, s=44, c=values, cmap="RdBu", norm=scale, edgecolors=soft, linewidths=0.6)
    axis.scatter(
        *MEAN_SHAPE[np.array(marked, int)].T,
        s=120,
        marker="s",
        facecolors="none",
        edgecolors=ink,
        linewidths=1.2,
    )
    for point in _named(values):
        axis.annotate(str(point), MEAN_SHAPE[point], (6, 5), textcoords="offset points", fontsize=8, color=ink)
    axis.set_aspect("equal")
    axis.invert_yaxis()
    axis.margins(0.09)
    axis.axis("off")
    return shown


def _named(values: Float[np.ndarray, "68"]) -> list[int]:
    """The landmarks with the smallest factors, none so near to another that their numbers lie on one another."""
    apart, chosen = APART * np.ptp(MEAN_SHAPE[:, 0]), []
    for point in np.argsort(values, kind="stable"):
        far = all(np.linalg.norm(MEAN_SHAPE[point] - MEAN_SHAPE[other]) > apart for other in chosen)
        if far and len(chosen) < NAMED:
            chosen.append(int(point))
    return chosen
