"""Tuning as a whole: what is learned or searched, on which part of a clip, and the configuration that comes of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from jaxtyping import Float

from workbench.config import Config, Hashed, differences
from workbench.errors import ConfigError, InputError
from workbench.extras import check_installed
from workbench.face import FaceModel
from workbench.files import writing
from workbench.learning.descent import Learning, Watched, begin, descended, read_learning, stored
from workbench.learning.examples import example_of, size_of, spread, stretches_in
from workbench.learning.keys import key_of
from workbench.learning.learnable import Logs, learned, limits_of, start_of
from workbench.learning.objective import check_gradient, compiled_slope
from workbench.learning.parts import Parts
from workbench.learning.report import Change, change_of
from workbench.learning.search import Searched, check_searchable, mean_of, searched, value_of
from workbench.objectives import WeightedSum, check_usable
from workbench.pipeline import software_versions
from workbench.reading import content_hash
from workbench.sweeps.clips import SweptClip
from workbench.sweeps.results import clip_in, folds_needed, objectives_of
from workbench.sweeps.solving import ClipSolver
from workbench.sweeps.space import Axis
from workbench.sweeps.stored_clips import ClipSource, digest_of, observe
from workbench.tracking.unwatched import never

STEPS, TRIALS = 24, 40
TRAINED, WATCHED = 12, 4
"""Stretches that are learned on, and that choose the step, at most."""
OF_LEARNING, OF_SEARCH = ".learning.json", ".study.log"
"""Endings of the files that an interrupted tuning continues from."""

Tell = Callable[[str, int, int, float, float | None], None]
"""Called with what is done ("learn", "search"), how many steps of how many, the value and the watched value."""


def silent(what: str, done: int, total: int, value: float, watched: float | None) -> None:
    """The default for `tell`."""


@dataclass(frozen=True)
class Wanted:
    """What a tuning is asked for."""

    objectives: WeightedSum
    parts: Parts
    learn: tuple[str, ...] = ()
    """Settings by gradient."""
    search: tuple[Axis, ...] = ()
    """Settings by search, before the gradient."""
    steps: int = STEPS
    trials: int = TRIALS


@dataclass(frozen=True, eq=False)
class Tuned:
    """A tuned configuration, and what is known of it."""

    config: Config
    """With its provenance."""
    base: Config
    before: dict[str, Float[np.ndarray, "n"]]
    """By part: the objective of each frame under `base`, fitted as `workbench track` does."""
    after: dict[str, Float[np.ndarray, "n"]]
    learning: Learning | None = None
    search: Searched | None = None

    @property
    def change(self) -> Change:
        """How the objective changed on the held-out part."""
        return change_of(self.before["held_out"], self.after["held_out"])

    def __str__(self) -> str:
        lines = [f"{name}: {mean_of(self.before[name]):.4g} → {mean_of(self.after[name]):.4g}" for name in self.before]
        return "\n".join([*lines, f"held-out change: {self.change}", *map(str, differences(self.base, self.config))])


def tuned(
    model: FaceModel,
    config: Config,
    clip: SweptClip,
    wanted: Wanted,
    tell: Tell = silent,
    place: Path | None = None,
    resume: bool = False,
    inputs: Sequence[Hashed] = (),
    stopped: Callable[[], bool] = never,
) -> Tuned:
    """The configuration with the settings that its objective likes best on the part to learn on.

    `place`: files of what was learned and searched start with it (`kept_beside`); `resume` continues from them,
    otherwise those of an earlier tuning are removed. An interrupt (Ctrl-C) keeps what was found, and so does `stopped`,
    which is asked before each step of a gradient; after an interrupted search no gradient is started, because the
    search may still find a better start. Raises `ConfigError` for settings that cannot be learned or searched, and
    `InputError` for a clip without frames to learn on or without what an objective needs, and for files of another
    tuning.
    """
    if not (wanted.learn or wanted.search):
        raise ConfigError("There is nothing to tune; name settings to learn (--learn) or to search (--search).")
    check_usable(wanted.objectives.names, clip_in(clip, clip.shots, config))
    trained = trained_on(clip, wanted)
    if wanted.learn:
        # Before a search, which may stay at its start.
        check_learnable(config, clip, wanted)
    if wanted.search:
        if place is None:
            raise ConfigError("A search keeps its study in a file; name the result (--out, place=).")
        check_searchable(config, wanted.search)
    # Not before: a slip costs nothing that is stored.
    if place is not None and not resume:
        for earlier in kept_beside(place):
            with writing(earlier):
                earlier.unlink(missing_ok=True)
    solver, found, search, learning = ClipSolver(model), config, None, None
    if wanted.search:
        study = place.with_suffix(OF_SEARCH)
        search = searched(
            solver, config, wanted.search, wanted.objectives, clip, trained, wanted.trials, study,
            lambda done, total, value: tell("search", done, total, value, None),
        )  # fmt: skip
        found = search.config
    if wanted.learn and not (search and search.interrupted):
        learning = learn_on(solver, found, clip, wanted, tell, place, resume, stopped)
        found = learned(found, learning.kept)
    before, after = measured(solver, (config, found), clip, wanted)
    result = Tuned(found, config, before, after, learning, search)
    return replace(result, config=found.changed(provenance=_provenance(result, model, wanted, inputs)))


def kept_beside(place: Path) -> list[Path]:
    """The files that an interrupted tuning continues from, whether they exist or not."""
    return [place.with_suffix(suffix) for suffix in (OF_LEARNING, OF_SEARCH)]


def observed(source: ClipSource, config: Config, model: FaceModel) -> SweptClip:
    """A clip to tune on. Raises `InputError` if it cannot be read or has no face."""
    source = source.local
    return observe(source, config, model, digest_of(source, config, model))


def inputs_of(source: ClipSource) -> list[Hashed]:
    """A clip's files, for the provenance."""
    places = [Path(place) for place in source.places]
    return [Hashed(str(place), content_hash(place)) for place in places if place.exists()]


def check_learnable(config: Config, clip: SweptClip, wanted: Wanted) -> None:
    """Raise `ConfigError` for settings, fits and objectives without a gradient, `InputError` for such frames, and
    `MissingDependencyError` without Optax.
    """
    check_installed("learn", "optax")
    start_of(config, wanted.learn)
    check_gradient(wanted.objectives)
    size_of(clip, trained_on(clip, wanted))
    if wanted.parts.watch is not None:
        stretches_in(clip, wanted.parts.watch, "watch")


def trained_on(clip: SweptClip, wanted: Wanted) -> list[range]:
    """The stretches that are searched and learned on. Raises `InputError` for a part without any."""
    return spread(stretches_in(clip, wanted.parts.train, "train"), TRAINED)


def learn_on(
    solver: ClipSolver,
    config: Config,
    clip: SweptClip,
    wanted: Wanted,
    tell: Tell,
    place: Path | None,
    resume: bool,
    stopped: Callable[[], bool] = never,
) -> Learning:
    """The learning of a configuration's settings by gradient."""
    start = start_of(config, wanted.learn)
    kinds = folds_needed(wanted.objectives.names)

    windows = trained_on(clip, wanted)
    image_size = size_of(clip, windows)
    train = [example_of(solver, config, clip, window, kinds) for window in windows]
    watched = None if wanted.parts.watch is None else watched_on(solver, config, clip, wanted)
    slope = compiled_slope(config, wanted.objectives, image_size, start, train[0])
    parts = {name: [frames.start, frames.stop] for name, frames in wanted.parts.named.items()}
    key = key_of(config, clip, solver.model, wanted.objectives, learn=list(wanted.learn), parts=parts)
    file = None if place is None else place.with_suffix(OF_LEARNING)
    goes_on = resume and file is not None and file.exists()
    # A search that went on may have found another start.
    if goes_on and not (wanted.search and read_learning(file).key != key):
        begun = stored(file, key)
    else:
        begun = begin(key, start, None if watched is None else watched(start))

    def told(learning: Learning, steps: int) -> None:
        seen = [] if watched is None else [begun.best_value]
        seen += [value for value in learning.watched if value is not None]
        tell("learn", len(learning.values), steps, learning.values[-1], seen[-1] if seen else None)

    limits = limits_of(config, wanted.learn)
    return descended(slope, begun, train, watched, wanted.steps, told, file, stopped, limits)


def watched_on(solver: ClipSolver, config: Config, clip: SweptClip, wanted: Wanted) -> Watched:
    """What learned values are worth on the frames that choose the step, fitted as `workbench track` does.

    The identity is calibrated with these values: where the gradient holds it, a step may look better than it is.
    """
    windows = spread(stretches_in(clip, wanted.parts.watch, "watch"), WATCHED)

    def watched(logs: Logs) -> float:
        value = value_of(solver, learned(config, logs), clip, windows, wanted.objectives)
        if not np.isfinite(value):
            raise InputError(
                f"The objective {wanted.objectives} has no value on the frames that choose the step; choose other ones "
                "(--watch), or another objective."
            )
        return value

    return watched


def measured(
    solver: ClipSolver, configs: Sequence[Config], clip: SweptClip, wanted: Wanted
) -> list[dict[str, Float[np.ndarray, "n"]]]:
    """The objective of each frame of every part under some configurations, all fitted as `workbench track` does."""
    names = wanted.objectives.names
    found = []
    for rows in objectives_of(solver, configs, clip, clip.shots, names):
        values = wanted.objectives.of(dict(zip(names, rows, strict=True)))
        found.append({part: values[frames.start : frames.stop] for part, frames in wanted.parts.named.items()})
    return found


def _provenance(result: Tuned, model: FaceModel, wanted: Wanted, inputs: Sequence[Hashed]) -> dict:
    change, learned_paths = result.change, () if result.learning is None else wanted.learn
    return {
        "exported": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": software_versions(),
        "model": str(Hashed(model.name, model.fingerprint())),
        "inputs": list(map(str, inputs)),
        "changed": [str(item) for item in differences(result.base, result.config)],
        "before": {name: round(mean_of(values), 5) for name, values in result.before.items()},
        "after": {name: round(mean_of(values), 5) for name, values in result.after.items()},
        "objective": str(wanted.objectives),
        "learned": [*learned_paths, *(axis.path for axis in wanted.search)],
        "parts": {name: f"{frames.start}:{frames.stop}" for name, frames in wanted.parts.named.items()},
        "change_percent": {"held_out": change.percent, "low": change.low, "high": change.high},
    }
