"""Descent by the gradient through the solver: Optax's steps in the logarithms of factors, on a few stretches at a time.

Each block (one ω, or the 68 landmarks) moves by steps of one length, which shrinks to nothing (cosine). Within the
landmarks, steps are in proportion to the slope: one that the objective hardly feels hardly moves.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.errors import InputError
from workbench.extras import needs
from workbench.files import atomic_path
from workbench.learning.keys import ANEW
from workbench.learning.learnable import FARTHEST, POINTS, Logs
from workbench.reading import checked_content, checked_json
from workbench.runtime import COMPUTING
from workbench.tracking.unwatched import never

STEP = 0.35
"""Length of the first steps, in logarithms: a factor of 1.4."""
MOMENTUM = 0.6
AT_A_TIME = 2
"""Stretches of a step."""
WATCH_EVERY = 3
FAR_POINTS = 0.1
"""What the mean square of the landmarks' logarithms costs: without it, they wander to fit the noise of a few frames."""
FORMAT = 2

Stretch = TypeVar("Stretch")
"""What one slope is taken on, as an `Example`."""
Slope = Callable[[Logs, Stretch], tuple[Float[jax.Array, ""], Logs]]
Watched = Callable[[Mapping[str, Float[np.ndarray, "m"]]], float]
"""What some logarithms are worth on frames that are not learned on."""
Limits = Mapping[str, tuple[float, float]]
"""By path: the least and the most logarithm."""


@dataclass(frozen=True)
class Learning:
    """The state after some steps; written as JSON, so that it can be inspected and continued."""

    key: str
    """SHA-256 of what is learned, from what and on what."""
    logs: dict[str, list[float]]
    momentum: dict[str, list[float]]
    values: list[float] = field(default_factory=list)
    """The objective on the stretches of each step, before it."""
    watched: list[float | None] = field(default_factory=list)
    """That on the watched frames, where it was looked at."""
    best: dict[str, list[float]] = field(default_factory=dict)
    best_step: int = 0
    best_value: float = float("inf")

    @property
    def kept(self) -> dict[str, Float[np.ndarray, "m"]]:
        """The values that are kept: the best watched ones, or the last."""
        return {path: np.array(log) for path, log in (self.best or self.logs).items()}


Tell = Callable[[Learning, int], None]
"""Called with the learning after each step, and the number of all steps."""


def optimiser(steps: int):
    """The steps as a transformation of Optax's."""
    with needs("learn"):
        import optax
    of_one_length = optax.stateless(lambda slopes, _: jax.tree.map(lambda g: g / (_size(g) + 1e-12), slopes))
    rate = optax.cosine_decay_schedule(STEP, steps)
    return optax.chain(optax.trace(MOMENTUM), of_one_length, optax.scale_by_learning_rate(rate))


def _size(vector):
    return jnp.sqrt(jnp.mean(vector * vector))


def descended(
    slope: Slope[Stretch],
    begun: Learning,
    train: Sequence[Stretch],
    watched: Watched | None,
    steps: int,
    tell: Tell,
    stored: Path | None = None,
    stopped: Callable[[], bool] = never,
    limits: Limits = MappingProxyType({}),
) -> Learning:
    """The learning after `steps` steps in all, or as far as it had come when it was `stopped` or interrupted (Ctrl-C).

    The values kept are the best `watched` ones; without it, the last. `stored` is written after each step. Settings
    without `limits` go as far as `FARTHEST`.
    """
    found, chain = begun, optimiser(steps)
    try:
        while len(found.values) < steps and not stopped():
            found = _stepped(slope, chain, found, _turn(train, len(found.values)), watched, steps, limits)
            if stored is not None:
                store(found, stored)
            tell(found, steps)
    except KeyboardInterrupt:
        pass
    return found


def _turn(train: Sequence[Stretch], step: int) -> list[Stretch]:
    """The stretches of a step: far apart, each as often as any other."""
    count = min(AT_A_TIME, len(train))
    apart = max(len(train) // count, 1)
    return [train[(step + k * apart) % len(train)] for k in range(count)]


def _stepped(
    slope: Slope, chain, before: Learning, examples, watched: Watched | None, steps: int, limits: Limits
) -> Learning:
    logs = {path: jnp.array(log) for path, log in before.logs.items()}
    number = len(before.values)
    value, slopes = _mean(slope, logs, examples)
    if POINTS in logs:
        slopes[POINTS] = slopes[POINTS] + 2.0 * FAR_POINTS * logs[POINTS] / len(logs[POINTS])
    state = chain.init(logs)
    momentum = {path: jnp.array(log) for path, log in before.momentum.items()}
    state = (state[0]._replace(trace=momentum), state[1], state[2]._replace(count=jnp.asarray(number)))
    moves, state = chain.update(slopes, state)
    logs = {path: _kept_in(path, log + moves[path], limits) for path, log in logs.items()}
    after = replace(
        before,
        logs=_listed(logs),
        momentum=_listed(state[0].trace),
        values=[*before.values, value],
        watched=before.watched,
    )
    last = number + 1 == steps
    if watched is None or not (last or (number + 1) % WATCH_EVERY == 0):
        return replace(after, watched=[*after.watched, None])
    seen = watched({path: np.asarray(log) for path, log in logs.items()})
    after = replace(after, watched=[*after.watched, seen])
    better = seen < after.best_value
    return replace(after, best=after.logs, best_step=number + 1, best_value=seen) if better else after


def _kept_in(path: str, log, limits: Limits):
    """The geometric mean of the landmarks' factors stays: one factor for all belongs to ω_sparse."""
    log = jnp.clip(log, *limits.get(path, (-FARTHEST, FARTHEST)))
    return log - jnp.mean(log) if path == POINTS else log


def _mean(slope: Slope[Stretch], logs: Logs, examples: Sequence[Stretch]) -> tuple[float, Logs]:
    """Value and slope over some examples; a stretch without a finite slope does not count."""
    values, slopes = [], []
    for example in examples:
        with COMPUTING:
            value, by = slope(logs, example)
        if np.isfinite(value) and all(np.isfinite(part).all() for part in jax.tree.leaves(by)):
            values.append(float(value))
            slopes.append(by)
    if not values:
        raise InputError("The objective has no value on these frames; choose another part, or another objective.")
    return float(np.mean(values)), jax.tree.map(lambda *parts: sum(parts) / len(parts), *slopes)


def _listed(logs: Mapping[str, Float[AnyArray, "m"]]) -> dict[str, list[float]]:
    return {path: [float(number) for number in np.asarray(log)] for path, log in logs.items()}


def begin(key: str, start: Mapping[str, Float[np.ndarray, "m"]], watched: float | None) -> Learning:
    """The learning before its first step; the start itself may stay the best."""
    logs = _listed(start)
    still = {path: [0.0] * len(log) for path, log in logs.items()}
    if watched is None:
        return Learning(key, logs, still)
    return Learning(key, logs, still, best=logs, best_value=watched)


def store(learning: Learning, path: Path) -> None:
    """Write the learning as JSON. The file is written completely or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps({"format": FORMAT, **asdict(learning)}, indent=1), encoding="utf-8")


def read_learning(path: Path) -> Learning:
    """What `store` wrote. Raises `InputError` for any other file."""
    content = checked_content(path, "a stored learning")
    try:
        held = dict(checked_json(content))
        if held.pop("format") != FORMAT:
            raise ValueError("another format")
        found = Learning(**held)
        if any(len(found.logs[name]) != len(log) for name, log in found.momentum.items()):
            raise ValueError("a different number of factors")
    except (ValueError, TypeError, KeyError) as error:
        raise InputError(f"{path} is not a stored learning ({error}); {ANEW}.") from error
    return found


def stored(path: Path, key: str) -> Learning:
    """A learning to continue from. Raises `InputError` if the file is not one, or of something else."""
    found = read_learning(path)
    if found.key != key:
        raise InputError(f"{path} was learned from another configuration, clip, objective or part; {ANEW}.")
    return found
