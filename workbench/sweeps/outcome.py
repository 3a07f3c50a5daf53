"""What a sweep found: one number per frame for every objective, point and clip, and the tables of them."""

import csv
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from workbench.config import Config
from workbench.errors import InputError
from workbench.extras import needs
from workbench.files import atomic_path
from workbench.objectives import WeightedSum, drawn_means, interval_of, least_at_equal, pareto_set
from workbench.sweeps.space import Axis, Point, config_at

BAND = (25.0, 75.0)
"""Percentiles of the band over frames."""
SURE_DRAWS = 500
SLACK = 0.05
"""Means that differ by this share count as equal."""
Means = Mapping[str, Float[np.ndarray, "p"]]
"""By objective: the mean over frames at each point."""
Rule = Callable[[Means], int | None]
"""Which point is chosen by its means; None if they say nothing."""


@dataclass(frozen=True, eq=False)
class SweepResult:
    """The objectives of a sweep; points or clips that failed are missing."""

    base: Config
    axes: tuple[Axis, ...]
    points: tuple[Point, ...]
    objectives: tuple[str, ...]
    values: Mapping[tuple[int, str], Float[np.ndarray, "m n"]]
    """By number of the point and name of the clip: a row for each objective, a column for each frame."""
    failures: Mapping[str, str] = field(default_factory=dict)
    """By clip: why it has no numbers."""

    @cached_property
    def clips(self) -> tuple[str, ...]:
        """The clips that have numbers."""
        return tuple(dict.fromkeys(clip for _, clip in self.values))

    def config(self, number: int | None) -> Config:
        """The configuration of a point.

        Raises `InputError` if none was chosen, as can happen with `best` and `steadiest`.
        """
        if number is None:
            raise InputError("No point of the sweep was chosen: none has a value of the objective that chooses.")
        return config_at(self.base, self.points[number])

    def frames(self, objective: str, number: int) -> Float[np.ndarray, "n"]:
        """An objective of a point in all frames of all clips in which it is known."""
        row = self._row(objective)
        found = [self.values[number, clip][row] for clip in self.clips if (number, clip) in self.values]
        whole = np.concatenate(found) if found else np.zeros(0)
        return whole[np.isfinite(whole)]

    def _in_a_row(self, objective: str, number: int) -> Float[np.ndarray, "n"]:
        row = self._row(objective)
        return np.concatenate([self.values[number, clip][row] for clip in self.clips])

    @cached_property
    def _whole(self) -> tuple[Point, ...]:
        """The points with numbers of all clips that have any: only these can be compared."""
        clips = self.clips
        found = [point for point in self.points if all((point.number, clip) in self.values for clip in clips)]
        return tuple(found) if clips else ()

    def _compared(self, objective: str) -> list[Float[np.ndarray, "n"]]:
        """The known frames of an objective at each point; none at one that lacks a clip which others have."""
        whole, nothing = {point.number for point in self._whole}, np.zeros(0)
        return [self.frames(objective, each.number) if each.number in whole else nothing for each in self.points]

    @cached_property
    def _drawn(self) -> dict[str, Float[np.ndarray, "d p"]]:
        """By objective: the means of the points in `_whole` over each of the bootstrap's draws of frames."""
        rows = {name: np.stack([self._in_a_row(name, each.number) for each in self._whole]) for name in self.objectives}
        return {name: drawn_means(values, draws=SURE_DRAWS) for name, values in rows.items()}

    def means(self, objective: str) -> Float[np.ndarray, "p"]:
        """The mean of an objective over all frames at each point; NaN if none is known or a clip is missing there."""
        return np.array([_mean(frames) for frames in self._compared(objective)])

    def bands(self, objective: str) -> Float[np.ndarray, "p 2"]:
        """The quartiles of an objective over all frames at each point; NaN where `means` is."""
        found = self._compared(objective)
        return np.array([np.percentile(each, BAND) if len(each) else (np.nan, np.nan) for each in found])

    def best(self, wanted: WeightedSum | str) -> int | None:
        """The number of the point with the lowest mean of an objective or a sum; None if it has no value."""
        return least(wanted)({name: self.means(name) for name in self.objectives})

    def steadiest(self, slack: float = SLACK) -> int | None:
        """The point with the lowest jitter among those within `slack` of the lowest error; None without either."""
        return steadiest(slack)({name: self.means(name) for name in self.objectives})

    def interval(self, axis: Axis, rule: Rule) -> tuple[float, float] | None:
        """How certain a choice is: in 95 % of the bootstrap's draws of frames, its value of a setting is between these.

        None without a choice, for settings that are not numbers, and with too few frames to tell.
        """
        if not (axis.numeric and self._whole):
            return None
        drawn = (rule({name: found[k] for name, found in self._drawn.items()}) for k in range(SURE_DRAWS))
        values = np.array([dict(self._whole[best].values)[axis.path] for best in drawn if best is not None], float)
        return interval_of(values, of_drawn=True) if len(values) else None

    def pareto(self, objectives: Sequence[str] | None = None) -> tuple[int, ...]:
        """The points that no other beats in these objectives, or in all of them."""
        chosen = self.objectives if objectives is None else tuple(objectives)
        means = np.stack([self.means(name) for name in chosen], axis=1)
        return tuple(int(k) for k in np.flatnonzero(pareto_set(means)))

    def table(self) -> dict[str, list[Any]]:
        """A row for each point and clip: the settings, the frames, and of each objective the mean over frames, the
        quartiles and the 95th percentile; None where nothing is known."""
        columns: dict[str, list[Any]] = {"point": [], "clip": [], **{axis.path: [] for axis in self.axes}, "frames": []}
        for name in self.objectives:
            columns |= {f"{name}{end}": [] for end in ("", "_p25", "_p75", "_p95")}
        for (number, clip), values in sorted(self.values.items()):
            columns["point"].append(number)
            columns["clip"].append(clip)
            for path, value in self.points[number].values:
                columns[path].append(value)
            columns["frames"].append(values.shape[1])
            for name, row in zip(self.objectives, values, strict=True):
                known = row[np.isfinite(row)]
                numbers = [_mean(known), *(np.percentile(known, (25, 75, 95)) if len(known) else [np.nan] * 3)]
                for end, number in zip(("", "_p25", "_p75", "_p95"), numbers, strict=True):
                    columns[f"{name}{end}"].append(float(number) if np.isfinite(number) else None)
        return columns

    def write_csv(self, path: str | Path) -> None:
        """`table` as CSV; an unknown cell is empty."""
        columns = self.table()
        with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(columns)
            for row in zip(*columns.values(), strict=True):
                writer.writerow([_cell(value) for value in row])

    def write_parquet(self, path: str | Path) -> None:
        """`table` as Parquet. Raises `MissingDependencyError` without pyarrow."""
        with needs("parquet"):
            import pyarrow
            from pyarrow import parquet
        # Settings such as tables of weights have no type of their own in a column: they go as text.
        columns = {
            name: values if _one_kind(values) else [_cell(value) for value in values]
            for name, values in self.table().items()
        }
        with atomic_path(path) as temporary:
            parquet.write_table(pyarrow.table(columns), temporary)

    def _row(self, objective: str) -> int:
        _check_measured(objective, self.objectives)
        return self.objectives.index(objective)


def least(wanted: WeightedSum | str) -> Rule:
    """The lowest mean of an objective or a sum. The rule raises `InputError` if one of them was not measured."""
    wanted = WeightedSum({wanted: 1.0}) if isinstance(wanted, str) else wanted

    def rule(means: Means) -> int | None:
        for name in wanted.names:
            _check_measured(name, means)
        values = wanted.of(means)
        return None if np.isnan(values).all() else int(np.nanargmin(values))

    return rule


def steadiest(slack: float = SLACK) -> Rule:
    """The lowest jitter at equal error."""

    def rule(means: Means) -> int | None:
        known = {"error", "jitter"} <= set(means)
        return least_at_equal(means["jitter"], means["error"], slack) if known else None

    return rule


def nearest(distances: Float[np.ndarray, "p"], wanted: str, slack: float = SLACK) -> Rule:
    """The nearest point among those within `slack` of the lowest `wanted`: with distances from present values, a change
    goes only as far as it pays.
    """
    return lambda means: least_at_equal(distances, means[wanted], slack)


def _check_measured(objective: str, measured: Collection[str]) -> None:
    if objective not in measured:
        raise InputError(f"The sweep did not measure {objective!r}; it has {', '.join(measured)}.")


def _mean(values: Float[np.ndarray, "n"]) -> float:
    return float(values.mean()) if len(values) else float("nan")


def _one_kind(values: Sequence[Any]) -> bool:
    kinds = {type(value) for value in values} - {type(None)}
    return (len(kinds) <= 1 and not kinds & {dict, list, tuple}) or kinds == {int, float}


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.9g}" if isinstance(value, float) else str(value)
