"""What the flow from a neighbouring frame says of a frame, as data of the flow energies."""

from typing import NamedTuple

from jaxtyping import Float

from workbench.arrays import AnyArray, Scalar
from workbench.flow import SurfacePoints
from workbench.geometry import Camera


class FlowView(NamedTuple):
    """A camera and its place: x_view = rotation · x_reference + translation."""

    camera: Camera
    rotation: Float[AnyArray, "3 3"]
    translation: Float[AnyArray, "3"]


class FlowTargets(NamedTuple):
    """Where neighbours and flow say that the face's points are, in each view of a frame; pixels."""

    places: Float[AnyArray, "sides views n 2"]
    weights: Float[AnyArray, "sides views n"]
    """0 where a point is hidden, or a side or view has nothing to say."""
    bias_px: Float[AnyArray, "sides views n 2"]
    """The estimator's difference from the mesh's exact flow on the rendered pair; 0: the exact flow counts."""
    unit_px: Float[AnyArray, "views"]
    """One percent of the outer-eye distance in each view."""


class FlowLink(NamedTuple):
    """What ties a frame to the one before it: points of the face, and where the pictures' flow took them."""

    points: SurfacePoints
    views: FlowView
    """The cameras, stacked."""
    targets: FlowTargets
    """One side, the frame before; all weights are 0 where no frame before is known."""
    robust: Scalar
    """Distance from which a point counts less and less, percent of the outer-eye distance (Cauchy)."""
