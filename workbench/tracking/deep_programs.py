"""The compiled parts of a Deep Energies solve: network landmarks, their derivative, and the normal equations.

A few programs serve everything: free parameters, weights, camera, light and detections are data. Only a change of the
network's architecture, the model's size or the number of views triggers recompilation.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from workbench.arrays import AnyArray, Scalar
from workbench.energies.context import TermContext
from workbench.energies.deep import (
    DEEP_TERMS,
    DeepModel,
    DeepView,
    NetworkView,
    deep_residuals,
    network_view,
    preselected_points,
)
from workbench.face import FaceParameters, pack, typical_sizes, unpack
from workbench.face.unknowns import derivative_by_columns
from workbench.networks import EnergyNetwork
from workbench.rendering import Cover, Texture
from workbench.runtime import SMALL_ARRAYS
from workbench.solvers import DenseSystem, normal_equations

CHUNK = 8
"""Tangents pushed through renderer and network at once: more overflow the CPU cache, fewer waste forward passes."""


class DeepScene(NamedTuple):
    """The data that is constant over the frames of a clip."""

    network: EnergyNetwork
    model: DeepModel
    albedo: Float[AnyArray, "v 3"] | Texture
    sliding: Scalar
    cover: Cover | None = None
    """What hides the face in renders, as hair."""


@partial(jax.jit, static_argnames=("side", "samples"))
def look(
    scene: DeepScene, view: DeepView, parameters: FaceParameters, side: int = 256, samples: int = 1
) -> NetworkView:
    """The network's landmarks in the render of one view."""
    return network_view(scene.network, scene.model, scene.albedo, view, parameters, side, samples, scene.cover)


@partial(jax.jit, static_argnames=("side", "samples"))
def look_derivative(
    scene: DeepScene,
    view: DeepView,
    parameters: FaceParameters,
    columns: Int[AnyArray, "c"],
    side: int = 256,
    samples: int = 1,
) -> Float[Array, "c points 2"]:
    """Forward-mode derivative of the network's landmarks by some of the scaled unknowns; 0 for padding columns.

    Each call takes one chunk of `CHUNK` columns: linearising through a loop takes ten times as long on a CPU.
    """

    def points(at):
        return network_view(scene.network, scene.model, scene.albedo, view, at, side, samples, scene.cover).points

    return derivative_by_columns(points, parameters, columns, jaw_unit=scene.model.render.jaw.unit)


@partial(jax.jit, compiler_options=SMALL_ARRAYS)
def project_points(scene: DeepScene, view: DeepView, parameters: FaceParameters) -> Float[Array, "points 2"]:
    """The preselected points in one view."""
    return preselected_points(scene.model, view, parameters, scene.sliding)


@partial(jax.jit, compiler_options=SMALL_ARRAYS)
def points_derivative(scene: DeepScene, view: DeepView, parameters: FaceParameters) -> Float[Array, "n points 2"]:
    """Derivative of the preselected points by all scaled unknowns."""
    vector = pack(parameters)
    sizes = jnp.asarray(typical_sizes(parameters, jaw_unit=scene.model.render.jaw.unit))
    derivative = jax.jacfwd(
        lambda scaled: preselected_points(scene.model, view, unpack(vector + scaled * sizes, parameters), scene.sliding)
    )(jnp.zeros_like(vector))
    return jnp.moveaxis(derivative, -1, 0)


@partial(jax.jit, static_argnames="terms", compiler_options=SMALL_ARRAYS)
def stage_system(
    views: DeepView,
    omega: Float[AnyArray, "t"],
    predicted: Float[AnyArray, "views points 2"],
    derivative: Float[AnyArray, "views n points 2"],
    parameters: FaceParameters,
    context: TermContext,
    terms: tuple[str, ...] = DEEP_TERMS,
) -> DenseSystem:
    """Normal equations of a stage, from predictions and their derivative by the scaled unknowns."""
    vector = pack(parameters)
    sizes = jnp.asarray(typical_sizes(parameters, jaw_unit=context.jaw_unit))

    def residual(predicted, vector):
        parts = deep_residuals(views, omega, predicted, unpack(vector, parameters), context, terms)
        return jnp.concatenate(list(parts.values()))

    by_column = jnp.moveaxis(derivative, 1, 0).astype(vector.dtype)
    predicted = predicted.astype(vector.dtype)

    def push(tangent, column):
        return jax.jvp(residual, (predicted, vector), (tangent, column))

    values, by_scaled = jax.vmap(push)(by_column, jnp.diag(sizes))
    return normal_equations(values[0], (by_scaled / sizes[:, None]).T)


@partial(jax.jit, static_argnames="terms", compiler_options=SMALL_ARRAYS)
def term_energies(
    views: DeepView,
    omega: Float[AnyArray, "t"],
    predicted: Float[AnyArray, "views points 2"],
    parameters: FaceParameters,
    context: TermContext,
    terms: tuple[str, ...] = DEEP_TERMS,
) -> Float[Array, "t"]:
    """Energy Σr² of each of `terms`."""
    residuals = deep_residuals(views, omega, predicted, parameters, context, terms)
    return jnp.stack([residual @ residual for residual in residuals.values()])
