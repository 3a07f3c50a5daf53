"""Search by Optuna (tree-structured Parzen estimator) for what has no gradient: limits, orders, subsets, switches.

A study is a journal file that can be looked at (`optuna-dashboard FILE`) and continued. A trial whose first stretches
are worse than the median of the earlier trials' is given up (pruning).
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from workbench.config import Config
from workbench.errors import ConfigError
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
            trial.report(float(np.nanmean(found)), number)
            if trial.should_prune():
                raise optuna.TrialPruned
        return float(np.nanmean(found))

    try:
        while len(study.trials) < trials:
            study.optimize(value, n_trials=1)
            tell(len(study.trials), trials, _best_value(study))
    except KeyboardInterrupt:
        pass
    done = [trial for trial in study.trials if trial.state == optuna.trial.TrialState.COMPLETE]
    if not done:
        return config
    best = min(done, key=lambda trial: trial.value)
    return config_at(config, _point({axis.path: _value_of(axis, best.params[axis.path]) for axis in axes}))


def value_of(
    solver: ClipSolver, config: Config, clip: SweptClip, windows: Sequence[range], objectives: WeightedSum
) -> float:
    """The mean of a sum of objectives over some stretches, fitted as configured."""
    rows = objectives_of(solver, [config], clip, windows, objectives.names)[0]
    return float(np.nanmean(objectives.of(dict(zip(objectives.names, rows, strict=True)))))


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


def _best_value(study) -> float:
    values = [trial.value for trial in study.trials if trial.value is not None]
    return min(values, default=float("nan"))
