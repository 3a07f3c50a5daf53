"""The face in one view, for optical flow: its visible points, and its render in a cut-out."""

from functools import partial

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


def points_shown(
    model: RenderModel, points: SurfacePoints, parameters: FaceParameters, views: FlowView, view: int, cutout: Cutout
) -> Bool[np.ndarray, "n"]:
    """Which of the points are visible in a view, not hidden by the head itself."""
    camera, place = _view(views, view)
    crop = _crop(camera, cutout)
    with COMPUTING:
        return np.asarray(_shown(model, points, parameters, crop, *place, size=(cutout.pixels,) * 2))


def rendered_cutout(
    model: RenderModel,
    parameters: FaceParameters,
    views: FlowView,
    view: int,
    cutout: Cutout,
    appearance: Appearance | None,
) -> UInt8[np.ndarray, "s s 3"]:
    """The face rendered in a view's cut-out, with the colours and light of an appearance; the model's own for None."""
    camera, place = _view(views, view)
    albedo = model.colors if appearance is None else appearance.albedo
    light = turned_light(light_of(appearance), views.rotation[view])
    with COMPUTING:
        seen = _look(
            model,
            parameters,
            _crop(camera, cutout),
            *place,
            np.asarray(albedo, np.float32),
            np.asarray(light, np.float32),
            size=(cutout.pixels,) * 2,
        )
        return np.asarray(np.clip(255.0 * np.asarray(seen), 0.0, 255.0), np.uint8)


def _view(views: FlowView, view: int):
    camera = Camera(*(np.asarray(part[view], np.float32) for part in views.camera))
    return camera, (np.asarray(views.rotation[view], np.float32), np.asarray(views.translation[view], np.float32))


def _crop(camera: Camera, cutout: Cutout) -> CropCamera:
    box = CropBox(*(np.asarray(part, np.float32) for part in (cutout.centre, cutout.side_px, 0.0)))
    return CropCamera(camera, box, np.asarray(float(cutout.pixels), np.float32))


@partial(jax.jit, static_argnames=("size",))
def _shown(
    model: RenderModel,
    points: SurfacePoints,
    parameters: FaceParameters,
    camera: CropCamera,
    rotation: Float[AnyArray, "3 3"],
    translation: Float[AnyArray, "3"],
    *,
    size: tuple[int, int],
) -> Bool[Array, "n"]:
    vertices = face_vertices(model, parameters) @ rotation.T + translation
    surface = seen_surface(vertices, model.topology.triangles, camera, size=size)
    at = points_in_camera(points, parameters) @ rotation.T + translation
    return shown_at(surface, to_screen(camera, at).pixels, at[:, 2])


@partial(jax.jit, static_argnames=("size",))
def _look(model, parameters, camera: CropCamera, rotation, translation, albedo, light, *, size: tuple[int, int]):
    vertices = face_vertices(model, parameters) @ rotation.T + translation
    background = jnp.full(3, RENDER_GREY, jnp.float32)
    return render(vertices, model.topology, camera, albedo, light, background, size=size).color
