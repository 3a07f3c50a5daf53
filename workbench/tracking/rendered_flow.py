"""What a flow network sees between two renders, N(F₁, F₂), and its derivative by the parameters of one of them.

The chain of Deep Energies Sec. 6: ∂N/∂F₂ · ∂F₂/∂p. Renderer and network are two programs, each in forward mode: as one
they take many times as long to compile. Frame, camera, light and the network's weights are data; only another size or
architecture compiles again.
"""

from functools import partial
from typing import Literal

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from workbench.arrays import AnyArray
from workbench.face import FaceParameters
from workbench.face.unknowns import derivative_by_columns
from workbench.flow import FlowModel, choose_points, seen_surface
from workbench.flow.network_flow import flow_between
from workbench.rendering import RenderModel
from workbench.runtime import COMPUTING
from workbench.tracking.flow_renders import RenderedView, rendered, vertices_in_view
from workbench.tracking.flow_solver import MOVING

STRIDE = 4
"""Flows are compared at every fourth pixel of the cut-out; the network's own finest flow is no denser."""
SAMPLES = 2
"""Samples per pixel and side of the renders: with one, their derivative is that of single points of the mesh's small
triangles, and the flow's follows it less closely."""
Moves = Literal["first", "second"]
"""Which picture of a pair shows the frame that is solved."""


@partial(jax.jit, static_argnames=("moves", "side"))
def seen_flow(
    network: FlowModel,
    known: Float[AnyArray, "s s 3"],
    here: Float[AnyArray, "s s 3"],
    *,
    moves: Moves,
    side: int,
) -> Float[Array, "m m 2"]:
    """N of the `known` render and the one of the frame that is solved, on the grid; pixels of the cut-out."""
    pair = (here, known) if moves == "first" else (known, here)
    return read_grid(flow_between(network, *pair, side))


def look_at(model: RenderModel, view: RenderedView, parameters: FaceParameters, pixels: int) -> Float[Array, "s s 3"]:
    """A frame's render as the network sees it, RGB in 0..1."""
    return rendered(model, view, parameters, pixels=pixels, samples=SAMPLES)


@partial(jax.jit, static_argnames="pixels")
def rendered_derivative(
    model: RenderModel, view: RenderedView, parameters: FaceParameters, columns: Int[AnyArray, "c"], *, pixels: int
) -> Float[Array, "c s s 3"]:
    """Forward-mode derivative of `look_at` by some of the scaled `MOVING` unknowns; 0 for padding columns."""

    def picture(at):
        return look_at(model, view, at, pixels)

    return derivative_by_columns(picture, parameters, columns, MOVING, model.jaw.unit)


@partial(jax.jit, static_argnames=("moves", "side"))
def seen_flow_derivative(
    network: FlowModel,
    known: Float[AnyArray, "s s 3"],
    here: Float[AnyArray, "s s 3"],
    changes: Float[AnyArray, "c s s 3"],
    *,
    moves: Moves,
    side: int,
) -> Float[Array, "c m m 2"]:
    """How `seen_flow` changes with each change of the frame's render."""

    def flow(here):
        return seen_flow(network, known, here, moves=moves, side=side)

    return jax.vmap(lambda change: jax.jvp(flow, (here,), (change,))[1])(changes)


def face_mask(
    model: RenderModel, view: RenderedView, parameters: FaceParameters, wanted: Bool[np.ndarray, "t"], pixels: int
) -> Bool[np.ndarray, "m m"]:
    """Which places of the grid show one of the `wanted` triangles."""
    with COMPUTING:
        vertices = vertices_in_view(model, view, parameters)
        seen = seen_surface(vertices, model.topology.triangles, view.camera, size=(pixels, pixels))
    *_, shown = choose_points(seen, wanted, STRIDE)
    mask = np.zeros(read_grid(np.zeros((pixels, pixels, 2))).shape[:2], bool)
    mask[shown[:, 1] // STRIDE, shown[:, 0] // STRIDE] = True
    return mask


def read_grid(flow: Float[AnyArray, "s s 2"]) -> Float[AnyArray, "m m 2"]:
    """A flow where flows are compared."""
    return flow[STRIDE // 2 :: STRIDE, STRIDE // 2 :: STRIDE]
