"""Estimators of dense flow from two pictures, all called alike.

Deep Energies (Sec. 6) sends the pair of photos and the pair of renders through the same estimator. Those of OpenCV have
no derivative: they serve for the photos, beside the exact `geometric_flow` of the render pair.
"""

from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

from workbench.errors import InputError

Picture = UInt8[np.ndarray, "_ _ _"] | Float[np.ndarray, "_ _ _"]
"""Height, width, RGB: bytes, or numbers in 0..1."""
BRIGHTEST = 2.0
"""Numbers in 0..1 may lie a little beyond, as after resampling; beyond this they are of another range."""
SMALLEST_SIDE = 16
"""Pixels below which there is no flow to find."""


@runtime_checkable
class FlowEstimator(Protocol):
    """Two pictures of one size to the flow from the first to the second."""

    @property
    def name(self) -> str:
        """As in configurations and tables."""
        ...

    def __call__(self, first: Picture, second: Picture) -> Float32[np.ndarray, "h w 2"]:
        """Flow in pixels of the pictures: what the first shows at (x, y), the second shows at (x, y) + flow[y, x].

        Raises `InputError` for pictures of two sizes, without three channels, under 16 pixels wide or high, or of
        another range.
        """
        ...


@dataclass(frozen=True)
class DisFlow:
    """Dense inverse search (Kroeger et al., ECCV 2016) by OpenCV: patches matched coarse to fine, then smoothed."""

    preset: Literal["fast", "medium"] = "medium"
    name: str = field(default="dis", init=False)

    def __call__(self, first: Picture, second: Picture) -> Float32[np.ndarray, "h w 2"]:
        """As in `FlowEstimator`."""
        kinds = {"fast": cv2.DISOPTICAL_FLOW_PRESET_FAST, "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM}
        # Made for each call: an instance keeps state and belongs to one thread.
        return cv2.DISOpticalFlow_create(kinds[self.preset]).calc(*greys(first, second), None)


@dataclass(frozen=True)
class FarnebackFlow:
    """Farnebäck's polynomial expansion (SCIA 2003) by OpenCV."""

    levels: int = 5
    window: int = 15
    iterations: int = 5
    polynomial: int = 7
    """Pixels of the neighbourhood of each polynomial."""
    sigma: float = 1.5
    name: str = field(default="farneback", init=False)

    def __call__(self, first: Picture, second: Picture) -> Float32[np.ndarray, "h w 2"]:
        """As in `FlowEstimator`."""
        options = (0.5, self.levels, self.window, self.iterations, self.polynomial, self.sigma, 0)
        return cv2.calcOpticalFlowFarneback(*greys(first, second), None, *options)


def greys(first: Picture, second: Picture) -> tuple[UInt8[np.ndarray, "h w"], UInt8[np.ndarray, "h w"]]:
    """Both pictures in grey, after a check that they belong together."""
    check_pair(first, second)
    grey, other = (cv2.cvtColor(as_bytes(picture), cv2.COLOR_RGB2GRAY) for picture in (first, second))
    return grey, other


def check_pair(first: np.ndarray, second: np.ndarray) -> None:
    """Raise `InputError` unless flow can be estimated between these two."""
    if first.shape != second.shape or first.ndim != 3 or first.shape[2] != 3:
        raise InputError(
            f"Flow needs two RGB pictures of one size, got shapes {first.shape} and {second.shape}; resize one of them."
        )
    if min(first.shape[:2]) < SMALLEST_SIDE:
        raise InputError(
            f"Flow needs pictures of at least {SMALLEST_SIDE} × {SMALLEST_SIDE} pixels, got "
            f"{first.shape[1]} × {first.shape[0]}; use larger ones."
        )
    for picture in map(np.asarray, (first, second)):
        if picture.dtype == np.uint8:
            continue
        if not np.issubdtype(picture.dtype, np.floating) or picture.max() > BRIGHTEST:
            raise InputError(
                f"Flow needs pictures of bytes (uint8) or of numbers in 0..1, got {picture.dtype} up to "
                f"{picture.max():g}; divide by the value of white."
            )


def as_bytes(picture: Picture) -> UInt8[np.ndarray, "h w 3"]:
    """A picture's bytes; numbers beyond 0..1 are clipped."""
    picture = np.asarray(picture)
    if picture.dtype == np.uint8:
        return picture
    return np.clip(np.rint(255.0 * picture), 0, 255).astype(np.uint8)


def as_floats(picture: Picture) -> Float32[np.ndarray, "h w 3"]:
    """A picture's numbers in 0..1."""
    picture = np.asarray(picture)
    return picture.astype(np.float32) / np.float32(255 if picture.dtype == np.uint8 else 1)
