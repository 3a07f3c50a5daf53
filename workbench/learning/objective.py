"""An objective of a stretch's fits as a number with a gradient by what is learned."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.config import Config
from workbench.errors import ConfigError
from workbench.learning.chain import FittedStretch, fitted_stretch
from workbench.learning.examples import Example
from workbench.learning.learnable import Logs, weighing_of
from workbench.objectives import FOLDS, FittedClip, WeightedSum, measure, objective
from workbench.planning import plan_of
from workbench.runtime import SMALL_ARRAYS

WITHOUT_GRADIENT = ("mesh", "iterations")
"""Objectives that are not computed from the fits of a stretch."""


def kinds_of(objectives: WeightedSum) -> tuple[str, ...]:
    """The folds that a sum of objectives looks at."""
    return tuple(dict.fromkeys(objective(name).folds for name in objectives.names if objective(name).folds))


def check_gradient(objectives: WeightedSum) -> None:
    """Raise `ConfigError` for a sum with an objective that has no gradient."""
    for name in objectives.names:
        if name in WITHOUT_GRADIENT:
            raise ConfigError(f"The objective {name!r} has no gradient here; search with it (--search) instead.")


def stretch_value(config: Config, objectives: WeightedSum, camera) -> Callable[[Logs, Example], Float[AnyArray, ""]]:
    """The mean of a sum of objectives over the counted frames of an example, as a function of what is learned."""
    plan = plan_of(config)
    kinds = kinds_of(objectives)

    def value(logs: Logs, example: Example) -> Float[AnyArray, ""]:
        weighing = weighing_of(config, logs, camera)

        def fitted(hidden):
            counts = jnp.where(hidden, 0.0, example.stretch.counts)
            return fitted_stretch(plan.stages, plan.terms, weighing, example.stretch._replace(counts=counts))

        found = jax.vmap(fitted)(example.hidden)
        fits = _as_clip(found, kinds, example)
        values = objectives.of({name: measure(name)(example.clip, fits) for name in objectives.names})
        known = example.counted & ~jnp.isnan(values)
        return jnp.sum(jnp.where(known, values, 0.0)) / jnp.maximum(jnp.sum(known), 1)

    return value


def value_and_slope(config: Config, objectives: WeightedSum, camera) -> Callable[[Logs, Example], tuple]:
    """The compiled value of an example and its derivative by what is learned."""
    return jax.jit(jax.value_and_grad(stretch_value(config, objectives, camera)), compiler_options=SMALL_ARRAYS)


def _as_clip(found: FittedStretch, kinds: Sequence[str], example: Example) -> FittedClip:
    """The fits that see everything, and by kind the landmarks of those that do not."""
    whole = jax.tree.map(lambda leaf: leaf[0], found)
    folds: dict[str, AnyArray] = {}
    first = 1
    for kind in kinds:
        count = len(FOLDS[kind](len(example.counted)))
        folds[kind] = found.projected[first : first + count]
        first += count
    return FittedClip(
        rotation=whole.parameters.rotation,
        translation=whole.parameters.translation,
        expression=whole.parameters.expression,
        projected=whole.projected,
        inner_camera=whole.inner_camera,
        iterations=jnp.full(len(example.counted), jnp.nan),
        folds=folds,
    )
