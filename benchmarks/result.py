"""The one line of JSON that each benchmark prints."""

import json
from typing import Any


def print_result(
    name: str, value: float | None, unit: str, goal: str | None, against: str, details: dict[str, Any] | None = None
) -> None:
    """Print a result. `goal` is a bound such as "<= 1.0"; a `value` of None needs a `skipped` reason in `details`."""
    line = {"name": name, "value": _rounded(value), "unit": unit, "goal": goal, "against": against}
    print(json.dumps(line | {"details": _rounded(details or {})}), flush=True)


def meets(value: float, goal: str) -> bool:
    """Whether a value keeps a bound such as "<= 1.0" or ">= 60"."""
    relation, bound = goal.split()
    return value <= float(bound) if relation == "<=" else value >= float(bound)


def _rounded(value: Any) -> Any:
    # Four significant digits: more would only be noise of the clock.
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value
