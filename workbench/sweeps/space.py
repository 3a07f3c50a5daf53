"""The language of a sweep's space: settings, the values that each takes, and how points are chosen among them.

| written | values |
|---|---|
| `weights.tau=log(1e-3,10,13)` | 13, evenly on a logarithmic scale |
| `camera.fov_deg=lin(25,65,9)` | 9, evenly |
| `stages.pose.limit=1..30` | whole numbers; `1..30..5` every fifth |
| `solver.bounded=true,false` | these |
| `stages.pose.landmarks=[{robust=1.0}, {all=1.0}]` | a TOML array, for tables and lists |
| `preset=joint,calibrated` | presets, under the other settings |
| `schedule=joint,face-it` | the stages of presets |

A stage is named as in the configuration (`stages.pose and expression.limit`), or by its number.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Literal

import numpy as np

from workbench.config import Config, preset
from workbench.errors import ConfigError

_CALL = re.compile(r"(?P<scale>log|lin)\((?P<numbers>[^()]*)\)")
_WHOLE = re.compile(r"(?P<first>-?\d+)\.\.(?P<last>-?\d+)(?:\.\.(?P<step>\d+))?")
_RANGE = re.compile(r"-?\d[\d.]*\.\.")
"""What begins as a range of numbers does."""
MOST_VALUES = 100_000


@dataclass(frozen=True)
class Axis:
    """One setting and the values that it takes."""

    path: str
    values: tuple[Any, ...]
    """In the order in which they are written."""
    scale: Literal["log", "lin", "whole", "list"]
    between: tuple[float, float] | None = None
    """Least and most of a scale that samples draw from; None: they draw among the values."""

    @property
    def numeric(self) -> bool:
        """Whether its values can be drawn on an axis of numbers."""
        return all(isinstance(value, int | float) and not isinstance(value, bool) for value in self.values)

    def at(self, share: float) -> Any:
        """The value at a fraction of the axis, from 0 to 1."""
        if self.between is None:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        first, last = self.between
        if self.scale == "log":
            return float(first * (last / first) ** share)
        return float(first + share * (last - first))


@dataclass(frozen=True)
class Sampling:
    """How points are chosen: all of the grid, or a number of samples."""

    kind: Literal["grid", "random", "sobol"] = "grid"
    count: int = 0
    seed: int = 0


@dataclass(frozen=True)
class Point:
    """One setting of all axes."""

    number: int
    values: tuple[tuple[str, Any], ...]
    """By path, in the order of the axes."""

    def __str__(self) -> str:
        return ", ".join(f"{path} = {shown(value)}" for path, value in self.values)


def shown(value: Any) -> str:
    """A value as tables and figures show it."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def read_axis(text: str) -> Axis:
    """The axis that `PATH=VALUES` names. Raises `ConfigError` for anything else, and for an empty range."""
    path, sign, values = (part.strip() for part in text.partition("="))
    if not (path and sign and values):
        raise ConfigError(f"A setting is swept as PATH=VALUES, got {text!r}; for example weights.tau=log(1e-3,10,13).")
    if call := _CALL.fullmatch(values):
        return _scale(path, call["scale"], call["numbers"], text)
    if whole := _WHOLE.fullmatch(values):
        first, last, step = int(whole["first"]), int(whole["last"]), int(whole["step"] or 1)
        if step < 1 or last < first or (last - first) // step >= MOST_VALUES:
            raise ConfigError(
                f"{text}: the range is empty; write FIRST..LAST with FIRST below LAST, for example 1..30."
            )
        return Axis(path, tuple(range(first, last + 1, step)), "whole")
    if _RANGE.match(values):
        raise ConfigError(f"{text}: FIRST..LAST..STEP is for whole numbers; write others as lin(0.5,3,6).")
    return Axis(path, _listed(values, text), "list")


def _scale(path: str, scale: str, numbers: str, text: str) -> Axis:
    try:
        first, last, *rest = (float(part) for part in numbers.split(","))
        count = _whole_number(*rest) if rest else None
    except ValueError:
        raise ConfigError(
            f"{text}: a scale is {scale}(FIRST,LAST,COUNT) with numbers, COUNT a whole one, for example "
            "log(1e-3,10,13)."
        ) from None
    if not (np.isfinite([first, last]).all() and first < last) or (count is not None and not 1 < count <= MOST_VALUES):
        raise ConfigError(
            f"{text}: the range is empty; write {scale}(FIRST,LAST,COUNT), FIRST below LAST, COUNT above 1."
        )
    if scale == "log" and first <= 0.0:
        raise ConfigError(f"{text}: a logarithmic scale starts above 0, got {first:g}.")
    spaced = np.geomspace if scale == "log" else np.linspace
    values = () if count is None else tuple(float(value) for value in spaced(first, last, count))
    return Axis(path, values, scale, (first, last))


def _whole_number(number: float, *more: float) -> int:
    """Raises `ValueError` for another number, and for more than one."""
    if more or not number.is_integer():
        raise ValueError("not one whole number")
    return int(number)


def _listed(values: str, text: str) -> tuple[Any, ...]:
    """Values of a list: a TOML array, or words and numbers with commas between."""
    if values.startswith("["):
        try:
            found = tomllib.loads(f"values = {values}")["values"]
        except tomllib.TOMLDecodeError as error:
            raise ConfigError(f"{text}: the list cannot be read ({error}); write it as a TOML array.") from None
    else:
        found = [_word(part.strip()) for part in values.split(",") if part.strip()]
    if not found:
        raise ConfigError(f"{text}: the range is empty; name at least one value.")
    return tuple(found)


def _word(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def read_sampling(text: str | None, seed: int = 0) -> Sampling:
    """The sampling that `grid`, `random:N` or `sobol:N` names. Raises `ConfigError` for anything else."""
    if text in (None, "grid"):
        return Sampling(seed=seed)
    kind, _, count = text.partition(":")
    if kind not in ("random", "sobol") or not count.isdigit() or not 0 < int(count) <= MOST_VALUES:
        raise ConfigError(f"Points are chosen by grid, random:N or sobol:N, got {text!r}; for example sobol:64.")
    return Sampling(kind, int(count), seed)


def points_of(axes: Sequence[Axis], sampling: Sampling = Sampling()) -> tuple[Point, ...]:
    """The points of a space, in an order that is always the same.

    Sobol' points fill the space evenly: any power of two of them is balanced in every axis (SciPy's, scrambled by the
    seed). Raises `ConfigError` for a scale without a count in a grid, and for more points than `MOST_VALUES`.
    """
    twice = [axis.path for k, axis in enumerate(axes) if axis.path in [other.path for other in axes[:k]]]
    if twice:
        raise ConfigError(f"The setting {twice[0]!r} is swept twice; write all its values in one list.")
    if sampling.kind == "grid":
        endless = [axis for axis in axes if not axis.values]
        if endless:
            raise ConfigError(
                f"A grid needs the number of values on {endless[0].path!r}: {endless[0].scale}(FIRST,LAST,COUNT); or "
                "choose points by --sample sobol:64."
            )
        size = int(np.prod([len(axis.values) for axis in axes], dtype=object))
        if size > MOST_VALUES:
            raise ConfigError(
                f"The grid has {size} points, more than {MOST_VALUES}; take fewer, or --sample sobol:1024."
            )
        chosen: Iterator = product(*(axis.values for axis in axes))
    else:
        chosen = (
            tuple(axis.at(share) for axis, share in zip(axes, row, strict=True)) for row in _shares(axes, sampling)
        )
    return tuple(
        Point(number, tuple(zip((axis.path for axis in axes), values, strict=True)))
        for number, values in enumerate(chosen)
    )


def _shares(axes: Sequence[Axis], sampling: Sampling) -> np.ndarray:
    if sampling.kind == "random" or not axes:
        return np.random.default_rng(sampling.seed).random((sampling.count, len(axes)))
    from scipy.stats import qmc  # here: all of SciPy's statistics come with it, and every panel imports this module

    whole = int(np.ceil(np.log2(sampling.count)))
    return qmc.Sobol(len(axes), rng=sampling.seed).random_base2(whole)[: sampling.count]


def config_at(base: Config, point: Point) -> Config:
    """The configuration of a point. Raises `ConfigError` for an unknown setting or a value out of range."""
    values = dict(point.values)
    if "preset" in values:
        # What belongs to the clip stays; everything else is the preset's.
        of_clip = {name: getattr(base, name) for name in ("camera", "subsets", "head")}
        chosen = preset(str(values.pop("preset"))).model_copy(update=of_clip)
        base = chosen.changed(landmarks=base.landmarks.kept_by_presets())
    if "schedule" in values:
        base = base.model_copy(update={"stages": preset(str(values.pop("schedule"))).stages})
    stored = base.model_dump()
    for path, value in values.items():
        _put(stored, path, value)
    return base.changed(**{key: stored[key] for key in {path.split(".")[0] for path in values}})


def _put(stored: dict[str, Any], path: str, value: Any) -> None:
    """Set an entry of a dumped configuration; what is not known there is left to the configuration's own check."""
    section, *rest = path.split(".")
    if section == "stages":
        if len(rest) < 2:
            raise ConfigError(f"{path!r} names no setting of a stage; write stages.NAME.limit, for example.")
        *name, key = _stage_and_key(stored["stages"], rest)
        _entry(stored["stages"][name[0]], key, value)
        return
    if not rest:
        stored[section] = value
        return
    if not isinstance(stored.get(section), Mapping):
        known = ", ".join(name for name, held in stored.items() if isinstance(held, Mapping))
        raise ConfigError(f"There is no section {section!r} in {path!r}; the sections are {known}, stages.")
    _entry(stored[section], rest, value)


def _stage_and_key(stages: Sequence[Mapping[str, Any]], rest: Sequence[str]) -> tuple[int, list[str]]:
    # Names of stages may have dots in them.
    for cut in range(len(rest) - 1, 0, -1):
        name = ".".join(rest[:cut])
        for number, stage in enumerate(stages):
            if name in (stage["name"], str(number)):
                return number, list(rest[cut:])
    names = ", ".join(repr(stage["name"]) for stage in stages)
    raise ConfigError(f"There is no stage {rest[0]!r}; the stages are {names}.")


def _entry(table: dict[str, Any], keys: Sequence[str], value: Any) -> None:
    for key in keys[:-1]:
        if not isinstance(table.get(key), dict):
            table[key] = {}
        table = table[key]
    # Set last: among weights of landmarks, later entries win.
    table.pop(keys[-1], None)
    table[keys[-1]] = value
