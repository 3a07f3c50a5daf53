"""Search by Optuna (tree-structured Parzen estimator) for what has no gradient: limits, orders, subsets, switches.

A study is a journal file that can be looked at (`optuna-dashboard FILE`) and continued. A trial whose first stretches
are worse than the median of the earlier trials' is given up (pruning).
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from workbench.config import Config
from workbench.errors import ConfigError, InputError
from workbench.extras import needs
from workbench.files import make_folder
from workbench.objectives import WeightedSum
from workbench.sweeps.clips import SweptClip
from workbench.sweeps.results import objectives_of
from workbench.sweeps.solving import ClipSolver, check_swept
from workbench.sweeps.space import Axis, Point, config_at

STUDY = "tune"
SEED = 0
PIECES = 3
"""Parts of a trial, after each of which it may be given up."""

Tell = Callable[[int, int, float], None]
"""Called after each trial with their number, that of all, and the best value."""


def searched(
    solver: ClipSolver,
    config: Config,
    axes: Sequence[Axis],
    objectives: WeightedSum,
    clip: SweptClip,
    stretches: Sequence[range],
    trials: int,
    journal: Path,
    tell: Tell,
) -> Config:
    """The best configuration of a study, which goes on to `trials` trials in all or until an interrupt (Ctrl-C).

    The configuration itself is the first trial where its values lie on the axes. Values that no configuration allows,
    such as an unknown landmark group, end the search with a `ConfigError`.
    """
    with needs("learn"):
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend
    check_axes(axes)
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    make_folder(journal.parent)
    study = optuna.create_study(
        storage=JournalStorage(JournalFileBackend(str(journal))),
        study_name=STUDY,
        sampler=optuna.samplers.TPESampler(seed=SEED),
        pruner=optuna.pruners.MedianPruner(n_startup_trials=5),
        load_if_exists=True,
    )
    pieces = [list(stretches[k::PIECES]) for k in range(min(PIECES, len(stretches)))]

    def value(trial) -> float:
        chosen = config_at(config, _suggested(trial, axes))
        check_swept(chosen)
        found: list[float] = []
        for number, windows in enumerate(pieces):
            found.append(value_of(solver, chosen, clip, windows, objectives))
            so_far = mean_of(np.array(found))
            trial.report(so_far, number)
            if trial.should_prune():
                raise optuna.TrialPruned
        if np.isfinite(so_far):
            return so_far
        if not _complete(study):
            raise InputError(f"The objective {objectives} has no value on these frames; choose other ones (--train).")
        raise optuna.TrialPruned

    try:
        # A trial that was interrupted is in the study, but not done.
        while (done := len(_ended(study))) < trials:
            study.optimize(value, n_trials=1)
            tell(done + 1, trials, _best_value(study))
    except KeyboardInterrupt:
        pass
    if not _complete(study):
        return config
    best = min(_complete(study), key=lambda trial: trial.value)
    return config_at(config, _point({axis.path: _value_of(axis, best.params[axis.path]) for axis in axes}))


def value_of(
    solver: ClipSolver, config: Config, clip: SweptClip, windows: Sequence[range], objectives: WeightedSum
) -> float:
    """The mean of a sum of objectives over some stretches, fitted as configured; NaN if no frame has a value."""
    rows = objectives_of(solver, [config], clip, windows, objectives.names)[0]
    return mean_of(objectives.of(dict(zip(objectives.names, rows, strict=True))))


def mean_of(values: Float[np.ndarray, "n"]) -> float:
    """The mean of what is known; NaN if nothing is."""
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def check_axes(axes: Sequence[Axis]) -> None:
    """Raise `ConfigError` unless there is something to search."""
    if not axes:
        raise ConfigError("There is nothing to search; name settings with their values, as stages.pose.limit=1..30.")


def _suggested(trial, axes: Sequence[Axis]) -> Point:
    return _point({axis.path: _value_of(axis, _drawn(trial, axis)) for axis in axes})


def _drawn(trial, axis: Axis) -> Any:
    if axis.between is not None:
        return trial.suggest_float(axis.path, *axis.between, log=axis.scale == "log")
    if axis.scale == "whole":
        step = axis.values[1] - axis.values[0] if len(axis.values) > 1 else 1
        return trial.suggest_int(axis.path, axis.values[0], axis.values[-1], step=step)
    # Tables and lists go by their number, for a study holds plain values.
    return trial.suggest_categorical(axis.path, list(range(len(axis.values))))


def _value_of(axis: Axis, drawn: Any) -> Any:
    return axis.values[drawn] if axis.scale == "list" else drawn


def _point(values: dict[str, Any]) -> Point:
    return Point(0, tuple(values.items()))


def _ended(study) -> list:
    """The trials that ran to their end or were given up by comparison."""
    return [trial for trial in study.trials if trial.state.name in ("COMPLETE", "PRUNED")]


def _complete(study) -> list:
    return [trial for trial in study.trials if trial.state.name == "COMPLETE"]


def _best_value(study) -> float:
    return min((trial.value for trial in _complete(study)), default=float("nan"))
