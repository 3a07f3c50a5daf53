"""The numeric settings of a configuration that a sweep can run through, in plain words and with a usual range."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from workbench.config import Config
from workbench.errors import InputError
from workbench.landmarks.scheme import LandmarkScheme
from workbench.landmarks.schemes import DENSE
from workbench.session.knobs import (
    CAMERA,
    CONSTANTS,
    IDENTITY,
    LANDMARKS,
    OMEGA,
    SOLVE,
    Kind,
    Knob,
    Value,
    inert_among,
    value_of,
)

ITERATIONS, WINDOW, CALIBRATED = (1, 30), (10, 200), (1, 24)
"""Usual ranges of the whole numbers that have no slider."""
NUMBERS: dict[Kind, str] = {"log": "log({low},{high},{count})", "linear": "lin({low},{high},{count})"}


@dataclass(frozen=True)
class SweepSetting:
    """A number of the configuration. `path` is as in `workbench sweep --set`."""

    path: str
    words: str
    symbol: str
    kind: Kind
    low: float | int
    high: float | int
    help: str = ""

    @property
    def title(self) -> str:
        """Plain words, the paper's symbol, and the name in a file."""
        symbol = f" · {self.symbol}" if self.symbol and self.symbol not in self.path else ""
        return f"{self.words}{symbol} · {self.path}"

    def axis(self, low: str, high: str, count: int) -> str:
        """So many values from `low` to `high` in the language of `workbench sweep --set`."""
        if self.kind in NUMBERS:
            return f"{self.path}={NUMBERS[self.kind].format(low=low, high=high, count=count)}"
        try:
            step = max(1, round((int(high) - int(low)) / max(count - 1, 1)))
        except ValueError:
            raise InputError(
                f"{self.words} is a whole number; write its range in whole numbers, got {low} to {high}."
            ) from None
        return f"{self.path}={int(low)}..{int(high)}..{step}"

    def matches(self, text: str) -> bool:
        """Whether every word of a search is in its title or its help."""
        told = f"{self.title} {self.help}".lower().replace("_", " ")
        return all(word in told for word in text.lower().replace("_", " ").replace("·", " ").split())


def sweep_settings(config: Config, scheme: LandmarkScheme | None = None) -> tuple[SweepSetting, ...]:
    """The settings that act on the fits of a configuration, in the order of their sliders; each title is there once.

    `scheme` as for `inert_among`.
    """
    knobs = (*OMEGA, *SOLVE, *CAMERA, *IDENTITY, *CONSTANTS, *LANDMARKS)
    left_out = inert_among(config, (knob.path for knob in knobs), scheme)
    swept = (knob for knob in knobs if knob.kind in ("log", "linear", "whole") and knob.path not in left_out)
    found = [item for knob in swept for item in _of_knob(config, knob)]
    return (*found, *_without_slider(config))


def found_setting(settings: tuple[SweepSetting, ...], text: str) -> SweepSetting:
    """The setting of a title, a path or its plain words, or the only one with all words of a search.

    Raises `InputError` where none or several have them.
    """
    text = text.strip()
    exact = [item for item in settings if text in (item.title, item.path) or text.lower() == item.words.lower()]
    matching = exact or [item for item in settings if item.matches(text)]
    if len(matching) == 1:
        return matching[0]
    if not matching:
        raise InputError(
            f"No setting that can be swept matches the words {text!r}; type others, such as steady or jaw."
        )
    listed = ", ".join(item.words for item in matching[:4]) + (" and more" if len(matching) > 4 else "")
    raise InputError(f"{len(matching)} settings match the words {text!r}: {listed}; choose one of them.")


def value_at(config: Config, path: str) -> Value | None:
    """What a configuration has at the path of a setting: for a group of landmarks what its slider shows.

    None for a stage that it has not.
    """
    section, *keys = path.split(".")
    if keys[:-1] == ["weights"] and keys[-1] in DENSE.groups:
        return value_of(config, f"group.{keys[-1]}")
    if section == "stages":
        name, key = ".".join(keys[:-1]), keys[-1]
        return next((getattr(stage, key) for stage in config.stages if stage.name == name), None)
    held = getattr(config, section)
    for key in keys:
        held = held.get(key, 1.0) if isinstance(held, dict) else getattr(held, key)
    return held


def place_among(values: tuple[Value, ...], value: Value | None, log: bool) -> float | None:
    """Where a value lies among ascending ones, counted from 0; None outside."""
    if value is None or len(values) < 2 or not min(values) <= value <= max(values):
        return None
    scaled = [np.log(each) if log else float(each) for each in (*values, value)]
    return float(np.interp(scaled[-1], scaled[:-1], np.arange(len(values))))


def _of_knob(config: Config, knob: Knob) -> Iterator[SweepSetting]:
    words, symbol = knob.words, knob.label
    if knob.path in ("rho", "epsilon"):
        # The slider sets the limit of several stages; a sweep names each.
        for stage in config.stages:
            if stage.enabled and ("expression" in stage.free) == (knob.path == "epsilon"):
                path = f"stages.{stage.name}.limit"
                yield SweepSetting(path, f"iterations, {stage.name}", symbol, "whole", *ITERATIONS, words.effect)
        return
    path = knob.path
    if path.startswith("group."):
        path, symbol = path.replace("group.", "landmarks.weights."), ""
        yield SweepSetting(path, f"trust of {knob.label}", symbol, knob.kind, knob.low, knob.high, knob.help)
        return
    yield SweepSetting(path, words.name, symbol, knob.kind, knob.low, knob.high, knob.help)


def _without_slider(config: Config) -> Iterator[SweepSetting]:
    if config.identity.calibrate:
        told = "calibration of the person's shape, identity"
        yield SweepSetting("identity.window", "frames to choose from", "", "whole", *WINDOW, told)
        yield SweepSetting("identity.frames", "frames calibrated on", "", "whole", *CALIBRATED, told)
