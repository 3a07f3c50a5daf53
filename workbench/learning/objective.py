"""An objective of a stretch's fits as a number with a gradient by what is learned."""

import json
from collections.abc import Callable, Sequence
from functools import lru_cache

import jax
import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray, shapes_of
from workbench.config import Config, parse_config
from workbench.errors import ConfigError
from workbench.geometry import Camera
from workbench.landmarks.scheme import IBUG68, LandmarkScheme
from workbench.landmarks.schemes import scheme_of_count
from workbench.learning.chain import FittedStretch, fitted_stretch
from workbench.learning.examples import Example
from workbench.learning.learnable import Logs, weighing_of
from workbench.objectives import FOLDS, FittedClip, WeightedSum, measure
from workbench.planning import plan_of
from workbench.runtime import SMALL_ARRAYS
from workbench.sweeps.results import folds_needed

WITHOUT_GRADIENT = ("mesh", "iterations")
"""Objectives that are not computed from the landmarks of a stretch's fits."""


def check_gradient(objectives: WeightedSum) -> None:
    """Raise `ConfigError` for a sum with an objective that has no gradient."""
    for name in objectives.names:
        if name in WITHOUT_GRADIENT:
            raise ConfigError(f"The objective {name!r} has no gradient here; search with it (--search) instead.")


def example_value(
    config: Config, objectives: WeightedSum, camera: Camera, scheme: LandmarkScheme = IBUG68
) -> Callable[[Logs, Example], Float[AnyArray, ""]]:
    """The mean of a sum of objectives over the counted frames of an example, as a function of what is learned.

    NaN where no counted frame has a value.
    """
    plan, kinds = plan_of(config, scheme), folds_needed(objectives.names)

    def value(logs: Logs, example: Example) -> Float[AnyArray, ""]:
        weighing = weighing_of(config, logs, camera, scheme)
        found = jax.vmap(lambda stretch: fitted_stretch(plan.stages, plan.terms, weighing, stretch))(example.stretches)
        fits = _as_clip(found, kinds, len(example.counted))
        values = objectives.of({name: measure(name)(example.clip, fits) for name in objectives.names})
        known = example.counted & ~jnp.isnan(values)
        mean = jnp.sum(jnp.where(known, values, 0.0)) / jnp.maximum(jnp.sum(known), 1)
        return jnp.where(known.any(), mean, jnp.nan)

    return value


def value_and_slope(
    config: Config, objectives: WeightedSum, camera: Camera, scheme: LandmarkScheme = IBUG68
) -> Callable[[Logs, Example], tuple[Float[AnyArray, ""], Logs]]:
    """The compiled value of an example and its derivative by what is learned."""
    value = example_value(config, objectives, camera, scheme)
    return jax.jit(jax.value_and_grad(value), compiler_options=SMALL_ARRAYS)


def compiled_slope(
    config: Config, objectives: WeightedSum, image_size: tuple[int, int], logs: Logs, example: Example
) -> Callable[[Logs, Example], tuple[Float[AnyArray, ""], Logs]]:
    """`value_and_slope` for arguments of these shapes, compiled; the latest are kept.

    It is compiled while other programs may run, so that a panel beside it goes on.
    """
    text = config.model_dump_json(exclude={"provenance"})
    points = example.stretches.points.shape[-2]
    return _compiled(text, tuple(objectives.factors.items()), image_size, points, *shapes_of((logs, example)))


@lru_cache(maxsize=2)
def _compiled(
    text: str, factors: tuple[tuple[str, float], ...], image_size: tuple[int, int], points: int, tree, shapes
):
    config = parse_config(json.loads(text), "what is learned from")
    camera = plan_of(config).camera.of(image_size)
    slope = value_and_slope(config, WeightedSum(dict(factors)), camera, scheme_of_count(points))
    return slope.lower(*jax.tree.unflatten(tree, shapes)).compile()


def _as_clip(found: FittedStretch, kinds: Sequence[str], frames: int) -> FittedClip:
    """The fits that see everything, and by kind the landmarks of those that do not."""
    whole, folds, first = jax.tree.map(lambda leaf: leaf[0], found), {}, 1
    for kind in kinds:
        count = len(FOLDS[kind](frames))
        folds[kind] = found.projected[first : first + count]
        first += count
    return FittedClip(
        rotation=whole.parameters.rotation,
        translation=whole.parameters.translation,
        expression=whole.parameters.expression,
        projected=whole.projected,
        inner_camera=whole.inner_camera,
        iterations=jnp.full(frames, jnp.nan),
        folds=folds,
    )
