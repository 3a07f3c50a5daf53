"""Points of the face's surface followed from picture to picture by optical flow, in every view of a frame."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from workbench.energies.flow import choose_surface, points_in_views
from workbench.energies.flow_link import FlowTargets, FlowView
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters
from workbench.flow import SurfacePoints, flow_estimator, surface_points
from workbench.geometry import Camera, Rig
from workbench.landmarks.scheme import LEFT_EYE_OUTER_CORNER, RIGHT_EYE_OUTER_CORNER
from workbench.rendering import RenderModel
from workbench.runtime import COMPUTING
from workbench.tracking.flow_renders import points_shown
from workbench.tracking.observation import Pictures
from workbench.tracking.photo_flow import Cutout, cutout_about, photo_flow
from workbench.tracking.plan import FlowPlan

VISIBILITY_SIDE = 128
"""Size of the depth map, in pixels across the face, that decides which points are hidden."""


class Neighbour(NamedTuple):
    """A frame next to the one being solved."""

    parameters: FaceParameters
    pictures: Pictures


class Links(NamedTuple):
    """What the pictures say about one frame: one neighbour's points moved by flow to positions in each view."""

    places: Float[np.ndarray, "views n 2"]
    weights: Float[np.ndarray, "views n"]
    starts: Float[np.ndarray, "views n 2"]
    """The points in the neighbour's pictures."""
    cutouts: tuple[Cutout, ...]


class PointLinker:
    """Follows chosen points of one model's surface with one estimator."""

    def __init__(self, model: FaceModel, render: RenderModel, flow: FlowPlan):
        """`render`: the model's arrays for the renderer. Raises `InputError` for settings that cannot be used."""
        self.estimator = flow_estimator(flow.estimator, flow.side)
        self.points = surface_points(render, *choose_surface(model, flow.points))
        self._render, self._side, self._estimates_renders = render, flow.side, flow.renders == "estimated"
        corners = model.landmarks.vertices[[RIGHT_EYE_OUTER_CORNER, LEFT_EYE_OUTER_CORNER]]
        self._eyes_mm = float(np.linalg.norm(np.diff(model.neutral[corners].mean(axis=1), axis=0)))

    def links(self, neighbour: Neighbour, pictures: Pictures, guess: FaceParameters, views: FlowView) -> Links:
        """Positions of the face's points in these pictures, by flow from a neighbour's pictures.

        `guess` is the approximate position of the face, to choose cut-outs that contain it. Raises `InputError` if the
        numbers of pictures and views differ.
        """
        count = len(views.rotation)
        check_pictures(neighbour.pictures, pictures, count)
        with COMPUTING:
            here = np.asarray(places_of(self.points, views, neighbour.parameters), float)
            there = np.asarray(places_of(self.points, views, guess), float)
        places, weights, cutouts = [], [], []
        for view in range(count):
            cutout = cutout_about(np.stack([here[view], there[view]]), self._side)
            found = photo_flow(self.estimator, neighbour.pictures[view], pictures[view], here[view], cutout)
            close = cutout_about(here[view], VISIBILITY_SIDE)
            visible = points_shown(self._render, self.points, neighbour.parameters, views, view, close)
            places.append(found.places)
            # An estimator applied to both pairs makes the same errors at occlusions: those points stay, as published.
            trusted = found.inside if self._estimates_renders else found.consistent
            weights.append((visible & trusted).astype(float))
            cutouts.append(cutout)
        return Links(np.stack(places), np.stack(weights), here, tuple(cutouts))

    def targets(self, sides: Sequence[Links | None], guess: FaceParameters, views: FlowView) -> FlowTargets:
        """The targets of a frame from the links to its neighbours; None for a missing one, whose weights are 0."""
        shape = (len(sides), len(views.rotation), len(self.points.barycentric))
        places, weights = np.zeros((*shape, 2)), np.zeros(shape)
        for k, side in enumerate(sides):
            if side is not None:
                places[k], weights[k] = side.places, side.weights
        return FlowTargets(places, weights, np.zeros_like(places), self.unit_px(guess, views))

    def unit_px(self, guess: FaceParameters, views: FlowView) -> Float[np.ndarray, "views"]:
        """One percent of the outer-eye distance in each view's picture."""
        places = np.asarray(views.rotation) @ np.asarray(guess.translation, float) + np.asarray(views.translation)
        percent_mm = 0.01 * self._eyes_mm * np.asarray(guess.scale, float)
        return percent_mm * np.mean(views.camera.focal_px, axis=1) / np.linalg.norm(places, axis=1)


def check_pictures(before: Pictures, now: Pictures, views: int) -> None:
    """Raises `InputError` unless two frames have one picture for each view."""
    if not len(before) == len(now) == views:
        raise InputError(
            f"There are {views} views, but {len(before)} and {len(now)} pictures; give one picture for each view."
        )


def flow_views(rig: Rig | None, camera: Camera, sizes: Sequence[tuple[int, int] | None] = ()) -> FlowView:
    """The cameras of a rig for pictures of these sizes, stacked; without one the single camera."""
    if rig is None:
        cameras, rotations, translations = [camera], np.eye(3)[None], np.zeros((1, 3))
    else:
        rig = rig.resized(sizes)
        cameras = [view.camera for view in rig.views]
        rotations, translations = rig.rotation_view_reference, rig.translation_view_reference_mm
    stacked = Camera(*(np.stack([np.asarray(part, float) for part in parts]) for parts in zip(*cameras, strict=True)))
    return FlowView(stacked, np.asarray(rotations, float), np.asarray(translations, float))


@jax.jit
def places_of(points: SurfacePoints, views: FlowView, parameters: FaceParameters) -> Float[Array, "views n 2"]:
    """The surface points in the picture of each view, pixels."""
    return points_in_views(points, views, parameters)[0]
