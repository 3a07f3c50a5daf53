"""Several objectives at once: weighted sums, Pareto sets, and the least of one at equal values of another."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Bool, Float

from workbench.arrays import AnyArray
from workbench.errors import ConfigError
from workbench.objectives.table import objective

_PART = re.compile(r"\s*(?:(?P<factor>[0-9.]+(?:e[+-]?[0-9]+)?)\s*\*\s*)?(?P<name>[a-z][a-z-]*)\s*", re.IGNORECASE)


@dataclass(frozen=True)
class WeightedSum:
    """A sum of objectives with a factor each."""

    factors: Mapping[str, float]

    def __str__(self) -> str:
        return " + ".join(name if factor == 1.0 else f"{factor:g}*{name}" for name, factor in self.factors.items())

    @property
    def names(self) -> tuple[str, ...]:
        """Its objectives."""
        return tuple(self.factors)

    def of(self, values: Mapping[str, Float[AnyArray, "*n"]]) -> Float[AnyArray, "*n"]:
        """The sum, from the values of its objectives."""
        return sum(factor * values[name] for name, factor in self.factors.items())


def read_sum(text: str) -> WeightedSum:
    """The sum that a text such as `jitter + 0.5*left-out-points` names.

    Raises `ConfigError` for an unknown objective or anything but factors and names.
    """
    factors: dict[str, float] = {}
    for part in text.split("+"):
        found = _PART.fullmatch(part)
        if found is None:
            raise ConfigError(f"An objective is written as NAME or 0.5*NAME + NAME, got {text!r}.")
        name = objective(found["name"]).name
        factors[name] = factors.get(name, 0.0) + _factor(found["factor"], text)
    return WeightedSum(MappingProxyType(factors))


def _factor(text: str | None, whole: str) -> float:
    try:
        return 1.0 if text is None else float(text)
    except ValueError:
        raise ConfigError(f"A factor is a number, got {text!r} in {whole!r}; for example 0.5*jitter.") from None


def pareto_set(values: Float[np.ndarray, "p m"]) -> Bool[np.ndarray, "p"]:
    """Which points no other point beats, that is, is as good in all of the `m` objectives and better in one.

    Less is better. A point with NaN is never among them.
    """
    values = np.asarray(values, float)
    known = ~np.isnan(values).any(axis=1)
    as_good = (values[:, None] <= values[None]).all(axis=2)
    better = (values[:, None] < values[None]).any(axis=2)
    return known & ~(as_good & better).any(axis=0)


def least_at_equal(wanted: Float[np.ndarray, "p"], kept: Float[np.ndarray, "p"], slack: float = 0.05) -> int | None:
    """The point with the lowest `wanted` among those whose `kept` is within `slack` of the lowest; None if all are NaN.

    For jitter at equal error: any setting can be steady if the error may grow.
    """
    if np.isnan(kept).all():
        return None
    equal = kept <= (1.0 + slack) * np.nanmin(kept)
    if np.isnan(wanted[equal]).all():
        return None
    return int(np.nanargmin(np.where(equal, wanted, np.nan)))
