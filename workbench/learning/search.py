"""Search by Optuna (tree-structured Parzen estimator) for what has no gradient: limits, orders, subsets, switches.

A study is a journal file that can be looked at (`optuna-dashboard FILE`) and continued. A trial whose first stretches
are worse than the median of the earlier trials' is given up (pruning).
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from workbench.config import Config
from workbench.errors import InputError
from workbench.extras import check_installed, needs
from workbench.files import make_folder
from workbench.learning.keys import ANEW, key_of
from workbench.objectives import WeightedSum
from workbench.reading import checked_content, checked_json
from workbench.sweeps.acting import check_axis
from workbench.sweeps.clips import SweptClip
from workbench.sweeps.results import objectives_of
from workbench.sweeps.solving import ClipSolver, check_swept
from workbench.sweeps.space import Axis, Point, config_at

STUDY = "tune"
SEED = 0
PIECES = 3
"""Parts of a trial, after each of which it may be given up."""
KEY, START = "key", "start"
"""What a study keeps beyond its trials: what it is of, and the value of the configuration that it starts from."""

Tell = Callable[[int, int, float], None]
"""Called after each trial with their number, that of all, and the best value."""


class Searched(NamedTuple):
    """What a search found."""

    config: Config
    """The best; the one that it started from where no trial was better."""
    interrupted: bool
    """Whether trials are left (Ctrl-C)."""


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
) -> Searched:
    """The best configuration of a study, which goes on to `trials` trials in all or until an interrupt (Ctrl-C).

    The configuration itself is measured before the first trial, and stays unless a trial is better. The axes are those
    that `check_searchable` lets pass: values that no configuration allows end the search with a `ConfigError`. Raises
    `InputError` for a journal of another search, or that is none.
    """
    spaces, parts = [str(axis) for axis in axes], [[part.start, part.stop] for part in stretches]
    key = key_of(config, clip, solver.model, objectives, axes=spaces, stretches=parts)
    study = _study(journal, key)
    pieces = [list(stretches[k::PIECES]) for k in range(min(PIECES, len(stretches)))]

    def start() -> float:
        if START not in study.user_attrs:
            found = [value_of(solver, config, clip, windows, objectives) for windows in pieces]
            study.set_user_attr(START, mean_of(np.array(found)))
        return study.user_attrs[START]

    def value(trial) -> float:
        import optuna

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
        if not (_complete(study) or np.isfinite(start())):
            raise InputError(f"The objective {objectives} has no value on these frames; choose other ones (--train).")
        raise optuna.TrialPruned

    interrupted = False
    try:
        start()
        # A trial that was interrupted is in the study, but not done.
        while (done := len(_ended(study))) < trials:
            study.optimize(value, n_trials=1)
            tell(done + 1, trials, _least(study))
    except KeyboardInterrupt:
        interrupted = True
    best = _best(study)
    if best is None:
        return Searched(config, interrupted)
    point = _point({axis.path: _value_of(axis, best.params[axis.path]) for axis in axes})
    return Searched(config_at(config, point), interrupted)


def _study(journal: Path, key: str):
    """The study of a journal, a new one where there is none. Raises `InputError` for one of something else."""
    with needs("learn"):
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    make_folder(journal.parent)
    try:
        _check_lines(journal)
        study = optuna.create_study(
            storage=JournalStorage(JournalFileBackend(str(journal))),
            study_name=STUDY,
            pruner=optuna.pruners.MedianPruner(n_startup_trials=5),
            load_if_exists=True,
        )
    except InputError:
        raise
    except (ValueError, TypeError, LookupError, AttributeError) as error:
        raise InputError(f"{journal} is not a stored search ({error}); {ANEW}.") from error
    # A search that continues draws different points from those it started with.
    study.sampler = optuna.samplers.TPESampler(seed=SEED + len(_ended(study)))
    if not (study.user_attrs or study.trials):
        study.set_user_attr(KEY, key)
    if study.user_attrs.get(KEY) != key:
        raise InputError(f"{journal} was searched with another configuration, clip, objective, part or space; {ANEW}.")
    return study


def _check_lines(journal: Path) -> None:
    """Raise `ValueError` unless each line is JSON to its end: Optuna notices one that was torn only after it has added
    more."""
    lines = checked_content(journal, "a stored search").splitlines(True) if journal.exists() else []
    for line in lines:
        checked_json(line)
    if lines and not lines[-1].endswith(b"\n"):
        raise ValueError("the last line is incomplete")


def value_of(
    solver: ClipSolver, config: Config, clip: SweptClip, windows: Sequence[range], objectives: WeightedSum
) -> float:
    """The mean of a sum of objectives over some stretches, fitted as configured; NaN if no frame has a value."""
    rows = objectives_of(solver, [config], clip, windows, objectives.names)[0]
    return mean_of(objectives.of(dict(zip(objectives.names, rows, strict=True))))


def mean_of(values: Float[np.ndarray, "n"]) -> float:
    """The mean of what is known; NaN if nothing is."""
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def check_searchable(config: Config, axes: Sequence[Axis]) -> None:
    """Raise `ConfigError` unless all that the axes set acts on fits to landmarks and is allowed, as far as one look at
    each tells, and `MissingDependencyError` without Optuna.
    """
    check_installed("learn", "optuna")
    for axis in axes:
        check_axis(axis, config)
    looked_at = {axis.path: _looked_at(axis) for axis in axes}
    for k in range(max(map(len, looked_at.values()))):
        point = _point({path: values[k % len(values)] for path, values in looked_at.items()})
        check_swept(config_at(config, point))


def _looked_at(axis: Axis) -> Sequence[Any]:
    """Values that tell whether an axis is allowed: all of a list, the first and last of a range, two of a scale."""
    if axis.between is not None:
        # Within the ends, which may themselves not be allowed and are hardly ever drawn.
        return [axis.at(0.01), axis.at(0.99)]
    return axis.values if axis.scale == "list" else [axis.values[0], axis.values[-1]]


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


def _best(study):
    """The trial with the least value; None unless one is below that of the start."""
    best = min(_complete(study), key=lambda trial: trial.value, default=None)
    return None if best is None or study.user_attrs.get(START, np.inf) <= best.value else best


def _least(study) -> float:
    best = _best(study)
    return study.user_attrs[START] if best is None else best.value
