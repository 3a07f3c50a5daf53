"""The differences between two configurations."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from workbench.config.configuration import Config

MOVED = "landmarks.moved"


@dataclass(frozen=True)
class Difference:
    """One value that differs between two configurations."""

    path: str
    """For example `weights.tau`, or `stages.pose.limit` for the stage named pose."""
    before: Any
    """None if the value is new."""
    after: Any
    """None if the value was removed."""

    def __str__(self) -> str:
        return self.moved_points or f"{self.path}: {_short(self.before)} → {_short(self.after)}"

    @property
    def moved_points(self) -> str:
        """The number of moved points in words, because nobody reads 136 numbers; empty for other settings."""
        if not self.path.startswith(MOVED):
            return ""
        frame, points = self.path.removeprefix(MOVED).strip("."), self.after or self.before or {}
        count = f"{len(points)} point{'s' if len(points) > 1 else ''}"
        return f"frame {frame}: {count} " + ("moved" if self.after else "back at their detections")


def differences(before: Config, after: Config) -> list[Difference]:
    """The settings that differ, in the order of the file; `provenance` and `preset` are not settings."""
    old, new = _flat(before), _flat(after)
    paths = [*new, *(path for path in old if path not in new)]
    found = [Difference(path, old.get(path), new.get(path)) for path in paths if old.get(path) != new.get(path)]
    return [*found, *_reordered(before, after)]


def _reordered(before: Config, after: Config) -> Iterator[Difference]:
    """The tables of weights, whose later entries overrule earlier ones, that differ by their order alone."""
    others = {stage.name: stage.landmarks for stage in after.stages}
    tables = [("landmarks.weights", before.landmarks.weights, after.landmarks.weights)]
    tables += [
        (f"stages.{stage.name}.landmarks", stage.landmarks, others.get(stage.name, {})) for stage in before.stages
    ]
    for path, old, new in tables:
        if old == new and list(old) != list(new):
            yield Difference(path, old, new)


def _flat(config: Config) -> dict[str, Any]:
    stored = config.model_dump(exclude={"version", "preset", "provenance", "stages"})
    found: dict[str, Any] = {}
    for section, values in stored.items():
        if not isinstance(values, dict):
            found[section] = values
            continue
        for key, value in values.items():
            if isinstance(value, dict):
                found |= {f"{section}.{key}.{name}": entry for name, entry in value.items()}
            else:
                found[f"{section}.{key}"] = value
    found["stages"] = [stage.name for stage in config.stages]
    for stage in config.stages:
        for key, value in stage.model_dump(exclude={"name"}).items():
            found[f"stages.{stage.name}.{key}"] = value
    return found


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(str(entry) for entry in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_short(entry)}" for key, entry in value.items()) + "}"
    return "(none)" if value is None else str(value)
