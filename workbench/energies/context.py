"""What the residual of a term may look at."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from workbench.arrays import AnyArray, Scalar
from workbench.energies.constants import EnergyConstants
from workbench.energies.flow_link import FlowLink
from workbench.face.jaw import USUAL_JAW, JawUnit
from workbench.face.parameters import FaceParameters
from workbench.face.usual_expressions import UsualExpressions


class LandmarkErrors(NamedTuple):
    """Model landmarks minus observed ones, in every view of a frame."""

    error: Float[AnyArray, "*views points 2"]
    root: Float[AnyArray, "*views points"]
    """√ of what each landmark's squared error counts."""
    unit: Scalar = 1.0
    """What counts as 1, in the unit of the errors."""
    unwhitened: Float[AnyArray, "*views points 2"] | None = None
    """The errors in the unit, before a covariance whitened them: those of neighbours have one frame. None: the same."""
    weighted_edges: Scalar = 1.0
    """1: an edge between landmarks counts as the lesser weight of its ends; 0: all edges between landmarks
    of some weight alike."""


class Gaze(NamedTuple):
    """How eyes turn, and how well a frame shows it."""

    turns: Float[AnyArray, "4 k"]
    """`LandmarkModel.gaze`."""
    hidden: Scalar
    """0 where the place of a pupil is known, 1 where nothing tells that of either."""
    before: Float[AnyArray, "k"]
    """Weights of the frame before; where there is none, those that the frame started from."""


class TermContext(NamedTuple):
    """What a term may know about a frame besides the parameters."""

    constants: EnergyConstants
    before_last_pose: Float[AnyArray, "6"]
    """[r | t] of the frame before the last one; radians, millimetres."""
    last_pose: Float[AnyArray, "6"]
    history: Float[AnyArray, ""]
    """1 where both poses exist, else 0: no E_τ on the first two frames of a shot."""
    start: FaceParameters
    """Where the stage starts, or where an expectation has the face."""
    flow: FlowLink | None = None
    """What ties the frame to the one before it; None where no stage names the flow term."""
    jaw_unit: JawUnit = USUAL_JAW
    """The face model's."""
    gaze: Gaze | None = None
    """None where no landmark shows where the eyes look."""
    usual: UsualExpressions | None = None
    """How the model's blendshapes usually act; None where nothing is known of it."""


def still(start: FaceParameters, constants: EnergyConstants = EnergyConstants()) -> TermContext:  # noqa: B008
    """The context of a frame without any before it."""
    return TermContext(constants, jnp.zeros(6), jnp.zeros(6), jnp.zeros(()), start)
