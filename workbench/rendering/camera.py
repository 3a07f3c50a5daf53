"""Where points of the camera frame appear in the picture, and how near they are."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.errors import InputError
from workbench.geometry import Camera, project
from workbench.networks import CropBox, to_crop

NEAREST_MM = 1.0
"""Triangles with a corner nearer than this to a perspective camera, or behind it, are not drawn."""


class OrthographicCamera(NamedTuple):
    """Parallel projection along the camera's z axis; arrays, so that a new scale compiles nothing."""

    scale_px_per_mm: Float[AnyArray, "2"]
    principal_point_px: Float[AnyArray, "2"]
    """The pixel of the camera frame's origin."""


class CropCamera(NamedTuple):
    """What a camera sees inside of a crop, as a picture of `side` × `side` pixels: a render needs no more pixels."""

    camera: Camera | OrthographicCamera
    box: CropBox
    side: Float[AnyArray, ""]


AnyCamera = Camera | OrthographicCamera | CropCamera


class ScreenPoints(NamedTuple):
    """Points of a mesh in the picture. All three depend differentiably on points and camera."""

    pixels: Float[AnyArray, "v 2"]
    """Pixel (0, 0) is the centre of the top-left pixel."""
    weight: Float[AnyArray, "v"]
    """1/z in a perspective view, 1 in a parallel one: attributes times it are linear in the picture."""
    nearness: Float[AnyArray, "v"]
    """Linear in the picture, larger is nearer: 1/z in a perspective view, −z in a parallel one."""
    drawable: Float[AnyArray, "v"]
    """1 where the point can be drawn, 0 at or behind a perspective camera and where a number is not finite."""


def to_screen(camera: AnyCamera, points_camera: Float[AnyArray, "v 3"]) -> ScreenPoints:
    """Project camera-frame points (millimetres) in float32."""
    if isinstance(camera, CropCamera):
        screen = to_screen(camera.camera, points_camera)
        box = CropBox(*(jnp.asarray(part, jnp.float32) for part in camera.box))
        return screen._replace(pixels=to_crop(screen.pixels, box, jnp.asarray(camera.side, jnp.float32)))
    points = jnp.asarray(points_camera, jnp.float32)
    finite = jnp.isfinite(points).all(axis=1)
    points = jnp.where(finite[:, None], points, 1.0)
    depth = points[:, 2]
    if isinstance(camera, OrthographicCamera):
        scale, centre = (jnp.asarray(array, jnp.float32) for array in camera)
        return ScreenPoints(
            points[:, :2] * scale + centre, jnp.ones_like(depth), -depth, finite.astype(jnp.float32)
        )  # fmt: skip
    in_front = depth > NEAREST_MM
    # A point behind the camera gets harmless numbers instead of infinite ones, also in derivatives.
    points = jnp.where(in_front[:, None], points, 1.0)
    pixels = project(Camera(*(jnp.asarray(array, jnp.float32) for array in camera)), points)
    inverse = 1.0 / points[:, 2]
    return ScreenPoints(pixels, inverse, inverse, (finite & in_front).astype(jnp.float32))


def orthographic_camera(
    image_size: tuple[int, int], scale_px_per_mm: float, centre_mm: tuple[float, float] = (0.0, 0.0)
) -> OrthographicCamera:
    """Parallel view of a picture (width, height) with square pixels, centred on camera-frame (x, y) in millimetres.

    Raises `InputError` unless the scale is positive.
    """
    if not scale_px_per_mm > 0.0:
        raise InputError(f"A scale is a positive number of pixels per millimetre, got {scale_px_per_mm:g}.")
    middle = (np.asarray(image_size, float) - 1.0) / 2.0
    return OrthographicCamera(np.full(2, float(scale_px_per_mm)), middle - scale_px_per_mm * np.asarray(centre_mm))
