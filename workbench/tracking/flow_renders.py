"""The face in one view, for optical flow: its visible points, and its render in a cut-out."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

from workbench.arrays import AnyArray
from workbench.energies.flow_link import FlowView
from workbench.face import FaceParameters
from workbench.flow import SurfacePoints, points_in_camera, seen_surface
from workbench.flow.geometric import shown_at
from workbench.geometry import Camera
from workbench.networks.crop import CropBox
from workbench.rendering import Appearance, RenderModel, face_vertices, render, turned_light
from workbench.rendering.camera import CropCamera, to_screen
from workbench.runtime import COMPUTING
from workbench.tracking.deep_views import light_of
from workbench.tracking.photo_flow import Cutout

RENDER_GREY = 0.45
"""Background of renders, 0 to 1."""


class RenderedView(NamedTuple):
    """One view's cut-out as the renderer needs it; float32."""

    camera: CropCamera
    rotation: Float[AnyArray, "3 3"]
    """From the reference camera's frame to this one's."""
    translation: Float[AnyArray, "3"]
    """Millimetres."""
    albedo: Float[AnyArray, "v 3"]
    light: Float[AnyArray, "9 3"]


def rendered_view(
    model: RenderModel, views: FlowView, view: int, cutout: Cutout, appearance: Appearance | None = None
) -> RenderedView:
    """A view's cut-out, with the colours and light of an appearance; the model's own for None."""
    camera = Camera(*(np.asarray(part[view], np.float32) for part in views.camera))
    box = CropBox(*(np.asarray(part, np.float32) for part in (cutout.centre, cutout.side_px, 0.0)))
    crop = CropCamera(camera, box, np.asarray(float(cutout.pixels), np.float32))
    albedo = model.colors if appearance is None else appearance.albedo
    light = turned_light(light_of(appearance), views.rotation[view])
    place = (np.asarray(part[view], np.float32) for part in (views.rotation, views.translation))
    return RenderedView(crop, *place, np.asarray(albedo, np.float32), np.asarray(light, np.float32))


@partial(jax.jit, static_argnames=("pixels", "samples"))
def rendered(
    model: RenderModel, view: RenderedView, parameters: FaceParameters, *, pixels: int, samples: int = 1
) -> Float[Array, "s s 3"]:
    """The face in the cut-out, RGB in 0..1, on plain grey. `samples`: as in `render`."""
    background = jnp.full(3, RENDER_GREY, jnp.float32)
    vertices = vertices_in_view(model, view, parameters)
    return render(
        vertices,
        model.topology,
        view.camera,
        view.albedo,
        view.light,
        background,
        size=(pixels, pixels),
        samples=samples,
    ).color


def vertices_in_view(model: RenderModel, view: RenderedView, parameters: FaceParameters) -> Float[Array, "v 3"]:
    """The face in the frame of a view's camera, millimetres."""
    return face_vertices(model, parameters) @ view.rotation.T + view.translation


def rendered_cutout(
    model: RenderModel,
    parameters: FaceParameters,
    views: FlowView,
    view: int,
    cutout: Cutout,
    appearance: Appearance | None,
) -> UInt8[np.ndarray, "s s 3"]:
    """The face rendered in a view's cut-out, as the picture that an estimator takes."""
    with COMPUTING:
        seen = rendered(model, rendered_view(model, views, view, cutout, appearance), parameters, pixels=cutout.pixels)
        return np.asarray(np.clip(255.0 * np.asarray(seen), 0.0, 255.0), np.uint8)


def points_shown(
    model: RenderModel, points: SurfacePoints, parameters: FaceParameters, views: FlowView, view: int, cutout: Cutout
) -> Bool[np.ndarray, "n"]:
    """Which of the points are visible in a view, not hidden by the head itself."""
    with COMPUTING:
        return np.asarray(
            _shown(model, points, parameters, rendered_view(model, views, view, cutout), pixels=cutout.pixels)
        )


@partial(jax.jit, static_argnames="pixels")
def _shown(
    model: RenderModel, points: SurfacePoints, parameters: FaceParameters, view: RenderedView, *, pixels: int
) -> Bool[Array, "n"]:
    vertices = vertices_in_view(model, view, parameters)
    surface = seen_surface(vertices, model.topology.triangles, view.camera, size=(pixels, pixels))
    at = points_in_camera(points, parameters) @ view.rotation.T + view.translation
    return shown_at(surface, to_screen(view.camera, at).pixels, at[:, 2])
