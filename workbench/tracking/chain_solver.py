"""Many chains of frames in one compiled program: settings × parts of clips as its batch axis, frames in their order.

A frame starts from the one before it, as in `walk.py`, so a chain is run through frame by frame; chains know nothing of
one another. They come as data in blocks of fixed size, each chain with its own person, settings, stages and masks,
each frame with its own camera: no setting and no length of a clip compiles anything. What a chain's frames are does not
depend on the other chains of its block, nor on where the blocks are cut, to the last bit.

The batch is mapped over, not vectorised. Under `vmap` all chains of a block would take the steps of the slowest one
through both branches of every condition, which costs more than wide arithmetic saves: one frame already fills a core.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from workbench.arrays import AnyArray
from workbench.face import FaceParameters, LandmarkModel
from workbench.geometry import Camera
from workbench.runtime import ONE_THREAD
from workbench.tracking.frame_solver import FrameInput, Method, SolveSettings, StageProgram, run_stages

CHAINS = 4
"""Chains of a block: some four settings of a clip make a sweep's task, and fill it."""
FRAMES = 128
"""Frames of a block: a task is done in few calls of the program, each of which begins slowly. A frame that is not there
costs 2 µs."""


class ChainFrames(NamedTuple):
    """Consecutive frames of a chain as its solves need them."""

    measured: Float[AnyArray, "*c f points 3"]
    """x and y in pixels, and what the point counts."""
    present: Bool[AnyArray, "*c f"]
    """False: no face, or beyond the end of the chain; nothing is solved."""
    afresh: Bool[AnyArray, "*c f"]
    """Whether a frame starts from `rotation`, `translation`, `expression` instead of the frame before."""
    rotation: Float[AnyArray, "*c f 3"]
    translation: Float[AnyArray, "*c f 3"]
    expression: Float[AnyArray, "*c f k"]
    camera: Camera
    """That of each frame's picture; (*c, f, …) each."""
    whitening: Float[AnyArray, "*c f points 2 2"] | None = None
    """`Observation.whitening`; None where landmarks have no covariances."""


class ChainState(NamedTuple):
    """What one frame hands to the next."""

    parameters: FaceParameters
    pose: Float[AnyArray, "*c 6"]
    last_pose: Float[AnyArray, "*c 6"]
    count: Int[AnyArray, "*c"]
    """Frames since the chain last started afresh."""


class Chain(NamedTuple):
    """All that a chain's solves need besides its frames."""

    person: LandmarkModel
    settings: SolveSettings
    first: StageProgram
    """The stages of a frame that starts afresh."""
    later: StageProgram


class SolvedFrames(NamedTuple):
    """The fits of a chain's frames; NaN where nothing was solved."""

    rotation: Float[AnyArray, "*c f 3"]
    translation: Float[AnyArray, "*c f 3"]
    expression: Float[AnyArray, "*c f k"]
    projected: Float[AnyArray, "*c f points 2"]
    iterations: Float[AnyArray, "*c f"]
    """Steps over all stages."""


@partial(jax.jit, static_argnames=("method", "terms"), compiler_options=ONE_THREAD)
def solve_chains(
    chains: Chain, states: ChainState, frames: ChainFrames, method: Method, terms: tuple[str, ...]
) -> tuple[ChainState, SolvedFrames]:
    """Run a block of chains through a block of frames; the states after them, and the fits."""

    def through(chain_and_frames):
        chain, state, own = chain_and_frames
        return jax.lax.scan(partial(_next_frame, chain, method, terms), state, own)

    return jax.lax.map(through, (chains, states, frames))


def _next_frame(chain: Chain, method: Method, terms: tuple[str, ...], state: ChainState, frame: ChainFrames):
    return jax.lax.cond(frame.present, partial(_fitted, chain, method, terms), _passed_over, state, frame)


def _fitted(chain: Chain, method: Method, terms: tuple[str, ...], state: ChainState, frame: ChainFrames):
    given = FaceParameters(
        frame.rotation, frame.translation, frame.expression, jnp.zeros(0), jnp.zeros(0), jnp.zeros(0)
    )
    start, program = (
        jax.tree.map(partial(jnp.where, frame.afresh), *pair)
        for pair in ((given, state.parameters), (chain.first, chain.later))
    )
    last_pose, before_last = (jnp.where(frame.afresh, 0.0, pose) for pose in (state.pose, state.last_pose))
    history = (~frame.afresh & (state.count >= 2)).astype(float)
    found = run_stages(
        frame.camera,
        chain.person,
        chain.settings,
        program,
        FrameInput(frame.measured, last_pose, before_last, history, start, whitening=frame.whitening),
        method,
        terms=terms,
    )
    after = ChainState(
        found.parameters,
        found.pose,
        jnp.where(frame.afresh, found.pose, state.pose),
        jnp.where(frame.afresh, 1, state.count + 1),
    )
    rotation, translation, expression, *_ = found.parameters
    return after, SolvedFrames(rotation, translation, expression, found.projected, found.iterations.sum().astype(float))


def _passed_over(state: ChainState, frame: ChainFrames):
    def nothing(like):
        return jnp.full(like.shape, jnp.nan)

    solved = SolvedFrames(
        nothing(frame.rotation),
        nothing(frame.translation),
        nothing(frame.expression),
        nothing(frame.measured[:, :2]),
        jnp.asarray(jnp.nan),
    )
    return state, solved
