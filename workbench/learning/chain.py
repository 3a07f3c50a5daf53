"""The fits of consecutive frames as a function of what their energies are weighed with.

Every stage of every frame is an `implicit.optimum` whose energy depends on what came before: on the pose of the last
two frames (E_τ), on the weights that the stage holds, and on where it starts, which places the jaw contour and sets the
unit of the residuals. The derivative goes through all of these. Backward it is the adjoint recursion

    λ_t = ∂L/∂x_t + (∂x_t+1/∂x_t)ᵀ λ_t+1 + (∂x_t+2/∂x_t)ᵀ λ_t+2,

one linear system a stage and frame, which reverse differentiation of `jax.lax.scan` runs from the last frame to the
first.

Exact where each stage reaches its optimum. A schedule that stops its stages early, or alternates pose and expression
once a frame, has its fits elsewhere than at the least of the joint energy: the derivative is that of the optima of its
stages, in their order, which is what such a fit comes near.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.energies import EnergyConstants, points_head, project_landmarks
from workbench.face import FaceParameters, LandmarkModel, contour_blend, model_landmarks, unpack
from workbench.geometry import Camera, head_yaw, rotation_matrix
from workbench.landmarks.scheme import POINT_COUNT
from workbench.learning.implicit import Box, optimum
from workbench.tracking.frame_solver import FrameInput, SolveSettings, stage_problem, within_range
from workbench.tracking.plan import StagePlan


class Weighing(NamedTuple):
    """Everything that multiplies, bends or projects the energies of a clip's fits and can be differentiated by."""

    omega: Float[AnyArray, "s t"]
    """Factor in front of each term, by stage."""
    landmark_weights: Float[AnyArray, "s points"]
    constants: EnergyConstants
    camera: Camera


class Stretch(NamedTuple):
    """Consecutive frames with a face of one shot; the first is fitted from scratch."""

    points: Float[AnyArray, "n points 2"]
    """Pixels."""
    counts: Float[AnyArray, "n points"]
    """What each detection counts; 0 hides it."""
    start: FaceParameters
    """Where the first frame starts."""
    person: LandmarkModel
    settings: SolveSettings
    whitening: Float[AnyArray, "n points 2 2"] | None = None
    """`Observation.whitening`; None where landmarks have no covariances."""


class FittedStretch(NamedTuple):
    """The fits of a stretch."""

    parameters: FaceParameters
    """(n, …) each."""
    projected: Float[AnyArray, "n 68 2"]
    """The model's 68 landmarks in the picture, pixels."""
    inner_camera: Float[AnyArray, "n 51 3"]
    """Its landmarks without the jaw contour in the camera frame, millimetres."""


class _State(NamedTuple):
    """What a frame hands to the next one."""

    parameters: FaceParameters
    pose: Float[AnyArray, "6"]
    last_pose: Float[AnyArray, "6"]
    history: Float[AnyArray, ""]
    """1 once two frames came before."""


def fitted_stretch(
    stages: Sequence[StagePlan], terms: tuple[str, ...], weighing: Weighing, stretch: Stretch
) -> FittedStretch:
    """The fits of a stretch under enabled stages; differentiable by `weighing`, forward and backward.

    `terms` names the columns of `weighing.omega`. A term that compares pictures is not among them.
    """
    settings = within_range(stretch.settings, stretch.person)
    stretch = stretch._replace(settings=settings._replace(constants=weighing.constants))
    held = settings.lower == settings.upper
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), stretch.start)
    start = start._replace(expression=jnp.where(held, settings.lower, start.expression))
    nowhere, no = jnp.zeros(6), jnp.zeros(())

    def step(state: _State, seen):
        number, *seen = seen
        parameters, found = _fitted_frame(stages, number == 0, terms, weighing, stretch, state, *seen)
        pose = jnp.concatenate([parameters.rotation, parameters.translation])
        last_pose = jnp.where(number == 0, pose, state.pose)
        return _State(parameters, pose, last_pose, (number > 0).astype(float)), found

    seen = (jnp.arange(len(stretch.points)), stretch.points, stretch.counts, stretch.whitening)
    seen = jax.tree.map(jnp.asarray, seen)
    return jax.lax.scan(step, _State(start, nowhere, nowhere, no), seen)[1]


def _fitted_frame(stages, is_first, terms, weighing, stretch, state, points, counts, whitening):
    """The enabled stages of one frame, each from the result of the one before."""
    measured = jnp.concatenate([points, counts[:, None]], axis=1)
    parameters = state.parameters
    turned = parameters.rotation
    for k, stage in enumerate(stages):
        if not stage.enabled:
            continue

        def solved(before: FaceParameters, k=k, free=stage.free):
            moves_pose = "rotation" in free or "translation" in free
            history = state.history * moves_pose
            frame = FrameInput(measured, state.pose, state.last_pose, history, state.parameters, whitening=whitening)
            weights, omega = weighing.landmark_weights[k], weighing.omega[k]
            problem = stage_problem(weighing.camera, stretch.person, stretch.settings, weights, omega, frame, before)
            x = optimum(free, terms, problem, before, _box_of(stretch.settings, before, free))
            return unpack(x, before, free), before.rotation

        if stage.first_only:
            skipped = (parameters, turned)
            parameters, turned = jax.lax.cond(is_first, solved, lambda _, skipped=skipped: skipped, parameters)
        else:
            parameters, turned = solved(parameters)
    # The contour is where the last stage had it: at the yaw that this started from.
    blend = contour_blend(stretch.person.contour_yaw, head_yaw(turned), stretch.settings.sliding)
    places = model_landmarks(stretch.person, blend, parameters.identity)
    projected = project_landmarks(weighing.camera, places, parameters)[:POINT_COUNT]
    inner = points_head(places, parameters)[17:POINT_COUNT] @ rotation_matrix(parameters.rotation).T
    return parameters, FittedStretch(parameters, projected, inner + parameters.translation)


def _box_of(settings: SolveSettings, parameters: FaceParameters, free: tuple[str, ...]) -> Box:
    def limits(pose: float, expression):
        return jnp.concatenate(
            [
                jnp.broadcast_to(expression if name == "expression" else pose, getattr(parameters, name).shape)
                for name in free
            ]
        )

    lower, upper = limits(-jnp.inf, settings.lower), limits(jnp.inf, settings.upper)
    return Box(lower, upper)
