"""What a training leaves to look at: its curves, the confidence against the truth, and the tables of the model card."""

import csv
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from workbench.files import atomic_path

CURVES = {"loss": "loss", "inner_percent": "inner 51, % of the outer-eye distance"}
DENSE_CURVES = {**CURVES, "dense_percent": "dense points, % of the outer-eye distance"}
EYE_CURVES = {"loss": "loss", "pupil_percent": "pupils of open eyes, % of the eye's width"}
"""Columns of the curves that are drawn, and what they are."""

FEW = 10
"""Up to so many rows of the curves are drawn as points, too."""
SHARES = {"inside", "right"}
"""Words of columns that are shares."""


def write_report(folder: Path, numbers: dict, curves: Path) -> None:
    """Write `curves.png`, `reliability.png` and `tables.md` into the folder."""
    for name, figure in (("curves", curves_figure(curves)), ("reliability", reliability_figure(numbers))):
        with atomic_path(folder / f"{name}.png") as temporary:
            figure.savefig(temporary, dpi=100)
    with atomic_path(folder / "tables.md") as temporary:
        temporary.write_text(tables(numbers), encoding="utf-8")


def write_regression_report(
    folder: Path, name: str, tables: Mapping[str, Mapping[str, float]], curves: Mapping[str, str]
) -> None:
    """Write a network's `NAME_curves.png`, `NAME_numbers.json` and `NAME_tables.md` into the folder."""
    with atomic_path(folder / f"{name}_curves.png") as temporary:
        curves_figure(folder / name / "curves.csv", curves).savefig(temporary, dpi=100)
    write_tables(folder, name, tables)


def write_tables(folder: Path, name: str, tables: Mapping[str, Mapping[str, float]]) -> None:
    """Write `NAME_numbers.json` and `NAME_tables.md` into the folder."""
    with atomic_path(folder / f"{name}_numbers.json") as temporary:
        temporary.write_text(json.dumps(tables, indent=1), encoding="utf-8")
    columns = list(next(iter(tables.values())))
    lines = ["| | " + " | ".join(columns) + " |", "|" + "---|" * (len(columns) + 1)]
    for title, row in tables.items():
        cells = [f"{value:.0%}" if SHARES & set(column.split()) else f"{value:.2f}" for column, value in row.items()]
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    with atomic_path(folder / f"{name}_tables.md") as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def curves_figure(path: Path, curves: Mapping[str, str] = CURVES) -> Figure:
    """Loss and error of the training pictures over the steps: columns of the file with their titles.

    A few rows are points, too: of a quick training there is one, and no line. Without the file, nothing is drawn.
    """
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    rows = list(csv.DictReader(lines))
    steps = [int(row["step"]) for row in rows]
    figure = Figure(figsize=(8, 3), layout="constrained")
    for axis, (name, title) in zip(figure.subplots(1, len(curves)), curves.items(), strict=True):
        axis.plot(steps, [float(row[name]) for row in rows], color="#2a6f97", marker="o" if len(rows) <= FEW else "")
        axis.set_yscale("log")
        axis.set_xlabel("step")
        axis.set_title(title)
        axis.grid(alpha=0.3, which="both")
    return figure


def reliability_figure(numbers: dict) -> Figure:
    """Share of landmarks that were found against the confidence that was told."""
    told, found, count = np.asarray(numbers["reliability"]).T
    figure = Figure(figsize=(4, 4), layout="constrained")
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color="#8d99a6", linestyle="--")
    axis.plot(told, found, color="#2a6f97", marker="o")
    axis.bar(told, count / count.sum(), width=0.06, color="#8d99a6", alpha=0.4, label="share of the landmarks")
    axis.set_xlabel("confidence")
    axis.set_ylabel(f"found within {numbers['confident_percent']:g} %")
    axis.set_xlim(0, 1)
    axis.set_ylim(0, 1)
    axis.legend(loc="upper left", frameon=False)
    return figure


def tables(numbers: dict) -> str:
    """The errors as Markdown."""
    lines = [
        "| % of the outer-eye distance | clean: mean | median | p90 | damaged: mean | median | p90 |",
        "|" + "---|" * 7,
    ]
    for row, clean in numbers["clean"].items():
        damaged = numbers["damaged"][row]
        cells = [f"{part[key]:.2f}" for part in (clean, damaged) for key in ("mean", "median", "p90")]
        lines.append(f"| {row} | " + " | ".join(cells) + " |")
    value = {name: number for name, number in numbers.items() if isinstance(number, float)}
    lines += [
        "",
        "- eye aspect ratio: {eye_aspect_open:.3f} on open eyes (truth {eye_aspect_open_true:.3f}), "
        "{eye_aspect_closed:.3f} on closed ones (truth {eye_aspect_closed_true:.3f})".format(**value),
        "- lids as read and as they are, in widths of the eye: "
        + ", ".join(f"{read:g} {true:.3f} ({eyes:.0f} eyes)" for read, true, eyes in numbers["lids"]),
        "- mouth opening: error {mouth_opening_error:.1%}, bias {mouth_opening_bias:+.1%}".format(**value),
        "- rank correlation of confidence and accuracy: {rank_correlation:.2f}".format(**value),
    ]
    return "\n".join(lines) + "\n"
