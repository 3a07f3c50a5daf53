"""What an objective looks at: a clip's observations with what else is known of it, and the fits of its frames.

Arrays of NumPy, or of JAX under a trace: an objective can be differentiated by the fits.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from jaxtyping import Bool, Float

from workbench.arrays import AnyArray
from workbench.geometry import PlacedCamera


class Truth(NamedTuple):
    """What is known about the frames of a clip; None and NaN where nothing is known."""

    rotation: Float[AnyArray, "n 3"] | None = None
    """Axis-angle, head to camera, radians."""
    translation: Float[AnyArray, "n 3"] | None = None
    """Millimetres, camera frame."""
    expression: Float[AnyArray, "n k"] | None = None
    """Blendshape weights, in the order of the fitted model's."""
    surface: Float[AnyArray, "n v 3"] | None = None
    """Points of the mesh (`surface_points`), camera frame, millimetres."""
    labels: Float[AnyArray, "n 68 2"] | None = None
    """Landmarks placed by hand or known from a render, pixels."""


class SecondView(NamedTuple):
    """The same performance seen by another camera, which the fits did not use."""

    placed: PlacedCamera
    points: Float[AnyArray, "n 68 2"]
    """Its landmarks, pixels; NaN without a face. The jaw contour is not compared: each camera sees another edge."""


class ObservedClip(NamedTuple):
    """The observations of a clip, frame by frame."""

    points: Float[AnyArray, "n 68 2"]
    """Detected landmarks, pixels; NaN without a face."""
    confidence: Float[AnyArray, "n 68"]
    """Of each detection, 0 to 1."""
    follows: Bool[AnyArray, "n"]
    """Whether a frame follows the one before it in the same shot."""
    truth: Truth = Truth()
    flow: Float[AnyArray, "n 68 2"] | None = None
    """How far the picture moved at each landmark since the frame before, pixels; NaN where that is not known."""
    second: SecondView | None = None


class FittedClip(NamedTuple):
    """The fits of a clip's frames; NaN without a face."""

    rotation: Float[AnyArray, "n 3"]
    """Axis-angle, head to camera, radians."""
    translation: Float[AnyArray, "n 3"]
    """Millimetres."""
    expression: Float[AnyArray, "n k"]
    projected: Float[AnyArray, "n 68 2"]
    """The model's landmarks in the picture, pixels."""
    inner_camera: Float[AnyArray, "n 51 3"]
    """The model's landmarks without the jaw contour in the camera frame, millimetres."""
    iterations: Float[AnyArray, "n"]
    """Steps of the solver, over all stages."""
    surface: Float[AnyArray, "n v 3"] | None = None
    """Points of the mesh (`surface_points`), camera frame, millimetres; None unless an objective asks for them."""
    folds: Mapping[str, Float[AnyArray, "f n 68 2"]] = MappingProxyType({})
    """By kind of fold: the model's landmarks of the fits that did not see what each fold hides."""
