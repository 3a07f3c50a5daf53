"""Placing a frame from its neighbours by optical flow: combines photos, surface points, renders and solver."""

from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, UInt8

from workbench.energies.deep import DeepView, deep_model, preselected_points
from workbench.energies.flow import FlowTargets, FlowView, FlowWeights, choose_surface, points_in_views
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, free_parameters, parameter_range
from workbench.flow import SurfacePoints, flow_estimator, surface_points
from workbench.geometry import Camera
from workbench.landmarks.scheme import LEFT_EYE_OUTER_CORNER, RIGHT_EYE_OUTER_CORNER
from workbench.rendering import Appearance, estimate_appearance, face_vertices
from workbench.runtime import COMPUTING
from workbench.tracking.flow_renders import points_shown, rendered_cutout
from workbench.tracking.flow_solver import MOVING, FlowLimits, FlowSolution, solve_flow
from workbench.tracking.photo_flow import Cutout, cutout_about, photo_flow, read_at
from workbench.tracking.plan import Plan
from workbench.tracking.records import FrameFit

VISIBILITY_SIDE = 128
"""Size of the depth map, in pixels across the face, that decides which points are hidden."""
ESTIMATED_PASSES = 3
"""Number of solves; the estimator's flow of the renders is updated between them."""
TOLERANCE = 1e-4
"""A solve ends when a step lowers the energy by less than this fraction."""

Pictures = tuple[UInt8[np.ndarray, "_ _ 3"], ...]
"""The pictures of one frame, one for each view of a rig; a single one without a rig."""


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


class FlowFitter:
    """Solves frames from the flow to their neighbours. Holds the arrays of one model and one plan."""

    def __init__(self, model: FaceModel, plan: Plan):
        """Raises `InputError` and `ConfigError` for weights or settings that cannot be used."""
        self.model, self.plan, self.rig = model, plan, plan.camera.rig
        self.estimator = flow_estimator(plan.flow.estimator, plan.flow.side)
        self._model = deep_model(model)
        self._render = self._model.render
        self._points = surface_points(self._render, *choose_surface(model, plan.flow.points))
        corners = model.landmarks.vertices[[RIGHT_EYE_OUTER_CORNER, LEFT_EYE_OUTER_CORNER]]
        self._eyes_mm = float(np.linalg.norm(np.diff(model.neutral[corners].mean(axis=1), axis=0)))
        freed = [
            free_parameters(model, stage.free, stage.shapes, plan.camera.parallel, stage.name)
            for stage in plan.stages
            if stage.enabled
        ]
        self.free = np.any([np.concatenate(self._of_moving(one)) for one in freed], axis=0)
        """Which entries of rotation, translation, expression and jaw are free in any stage of the plan."""
        self._appearances: dict[int, Appearance | None] = {}

    @property
    def _estimates_renders(self) -> bool:
        return self.plan.flow.renders == "estimated"

    @property
    def view_count(self) -> int:
        """Number of cameras."""
        return 1 if self.rig is None else len(self.rig)

    def views(self, fit: FrameFit) -> FlowView:
        """The cameras of a fit, stacked."""
        if self.rig is None:
            cameras, rotations, translations = [fit.camera], np.eye(3)[None], np.zeros((1, 3))
        else:
            cameras = [view.camera for view in self.rig.views]
            rotations, translations = self.rig.rotation_view_reference, self.rig.translation_view_reference_mm
        stacked = Camera(
            *(np.stack([np.asarray(part, float) for part in parts]) for parts in zip(*cameras, strict=True))
        )
        return FlowView(stacked, np.asarray(rotations, float), np.asarray(translations, float))

    def links(self, neighbour: Neighbour, pictures: Pictures, guess: FaceParameters, views: FlowView) -> Links:
        """Positions of the face's points in these pictures, by flow from a neighbour's pictures.

        `guess` is the approximate position of the face, to choose cut-outs that contain it. Raises `InputError` if the
        numbers of pictures and views differ.
        """
        if not len(neighbour.pictures) == len(pictures) == self.view_count:
            raise InputError(
                f"There are {self.view_count} views, but {len(neighbour.pictures)} and {len(pictures)} pictures; "
                "give one picture for each view."
            )
        with COMPUTING:
            here = np.asarray(_places(self._points, views, neighbour.parameters), float)
            there = np.asarray(_places(self._points, views, guess), float)
        places, weights, cutouts = [], [], []
        for view in range(self.view_count):
            cutout = cutout_about(np.stack([here[view], there[view]]), self.plan.flow.side)
            found = photo_flow(self.estimator, neighbour.pictures[view], pictures[view], here[view], cutout)
            close = cutout_about(here[view], VISIBILITY_SIDE)
            visible = points_shown(self._render, self._points, neighbour.parameters, views, view, close)
            places.append(found.places)
            # An estimator applied to both pairs makes the same errors at occlusions: those points stay, as published.
            weights.append((visible & (found.consistent | self._estimates_renders)).astype(float))
            cutouts.append(cutout)
        return Links(np.stack(places), np.stack(weights), here, tuple(cutouts))

    def solve(
        self,
        sides: tuple[tuple[Neighbour, Links] | None, tuple[Neighbour, Links] | None],
        start: FaceParameters,
        prior: FaceParameters,
        views: FlowView,
        stay_pose: float | int = 0.0,
        appearance: Appearance | None = None,
    ) -> FlowSolution:
        """The frame between two neighbours (None for a missing one), near `prior`.

        `appearance`: needed if the configuration runs the estimator on renders.
        """
        targets = self._targets(sides, start, views)
        solution = self.solve_targets(targets, start, prior, views, stay_pose)
        if self._estimates_renders:
            for _ in range(ESTIMATED_PASSES):
                bias = self._bias(sides, solution.parameters, views, appearance)
                biased = targets._replace(bias_px=bias)
                solution = self.solve_targets(biased, solution.parameters, prior, views, stay_pose)
        return solution

    def solve_targets(
        self,
        targets: FlowTargets,
        start: FaceParameters,
        prior: FaceParameters,
        views: FlowView,
        stay_pose: float | int = 0.0,
    ) -> FlowSolution:
        """The frame whose points lie closest to the targets, near `prior`."""
        limits, weights = self._limits(start), self._weights(stay_pose)
        with COMPUTING:
            solution = solve_flow(self._points, views, targets, weights, start, prior, limits)
            return jax.tree.map(np.asarray, solution)

    def midway_targets(self, before: FaceParameters, after: FaceParameters, views: FlowView) -> FlowTargets:
        """Targets midway between each point's positions in the neighbours: they minimise ‖N(F₁, F₂) − N(F₂, F₃)‖.

        The two flows at a point differ by twice its distance from the target; hence the weight of 4.
        """
        with COMPUTING:
            ends = [np.asarray(_places(self._points, views, state), float) for state in (before, after)]
        targets = self._targets((None, None), before, views)
        targets.places[0] = 0.5 * (ends[0] + ends[1])
        targets.weights[0] = 4.0
        return targets

    def appearance_of_shot(self, moment) -> Appearance | None:
        """Colours and light of a shot, from the first of its frames requested; None if they are not needed."""
        if not self._estimates_renders:
            return None
        if moment.fit.shot not in self._appearances:
            self._appearances[moment.fit.shot] = self.appearance(moment.fit, moment.pictures[0])
        return self._appearances[moment.fit.shot]

    def appearance(self, fit: FrameFit, picture: UInt8[np.ndarray, "h w 3"]) -> Appearance | None:
        """Colours and light for renders, from a fitted frame; None if the face is too small."""
        person = self.model.personal(fit.identity)
        vertices = np.asarray(face_vertices(self._render, parameters_of(fit)), float)
        try:
            return estimate_appearance(picture, person, vertices, fit.camera)
        except InputError:
            return None

    def placed(self, like: FrameFit, parameters: FaceParameters) -> FrameFit:
        """A fit moved to other parameters. Its landmarks are kept; the reports of the stages are removed.

        A fit without landmarks of its own continues to use the model's in their place.
        """
        parts = {name: np.asarray(getattr(parameters, name), float) for name in MOVING}
        projected = self.landmarks(like, parameters)
        seen = np.nan_to_num(like.confidence).max() > 0.0
        return replace(
            like,
            projected=projected,
            observed=like.observed if seen else projected,
            energies=np.full_like(like.energies, np.nan),
            status=np.full_like(like.status, -1),
            iterations=np.zeros_like(like.iterations),
            **parts,
        )

    def filled(self, empty: FrameFit, like: FrameFit, parameters: FaceParameters) -> FrameFit:
        """The record of a frame without landmarks: the model's are used in their place, with confidence 0.

        `empty` provides the frame's number and times; `like` (an anchor) provides camera, person and layout.
        """
        made = self.placed(replace(like, index=empty.index, milliseconds=empty.milliseconds), parameters)
        return replace(made, found=True, failure="", source="filled", observed=made.projected, confidence=np.zeros(68))

    def landmarks(self, fit: FrameFit, parameters: FaceParameters) -> Float[np.ndarray, "68 2"]:
        """The model's landmarks in the reference picture, pixels."""
        nothing = np.zeros((68, 2)), np.zeros(68), np.zeros(68), np.ones(()), np.zeros((9, 3)), np.zeros(3)
        view = DeepView(fit.camera, np.eye(3), np.zeros(3), *nothing)
        sliding = float(self.plan.sliding)
        with COMPUTING:
            return np.asarray(_landmarks(self._model, view, parameters, sliding), float)

    def _targets(self, sides, guess: FaceParameters, views: FlowView) -> FlowTargets:
        count = len(self._points.barycentric)
        places = np.zeros((2, self.view_count, count, 2))
        weights = np.zeros((2, self.view_count, count))
        for k, side in enumerate(sides):
            if side is not None:
                places[k], weights[k] = side[1].places, side[1].weights
        depth = np.linalg.norm(np.asarray(guess.translation, float))
        unit = [0.01 * self._eyes_mm * float(np.mean(focal)) / depth for focal in np.asarray(views.camera.focal_px)]
        return FlowTargets(places, weights, np.zeros_like(places), np.array(unit))

    def _weights(self, stay_pose: float) -> FlowWeights:
        flow = self.plan.flow
        return FlowWeights(*(np.asarray(weight, float) for weight in (1.0, flow.stay, stay_pose, flow.robust)))

    def _limits(self, start: FaceParameters) -> FlowLimits:
        lower, upper = (
            np.concatenate(self._of_moving(limit)) for limit in parameter_range(self.model, self.plan.solver.bounded)
        )
        held = np.concatenate([np.asarray(part, float) for part in self._of_moving(start)])
        # Fixed parameters get equal bounds; for values already outside their range the range is extended.
        lower, upper = np.minimum(lower, held), np.maximum(upper, held)
        return FlowLimits(
            np.where(self.free, lower, held),
            np.where(self.free, upper, held),
            np.asarray(self.plan.flow.iterations),
            np.asarray(TOLERANCE),
        )

    @staticmethod
    def _of_moving(parameters: FaceParameters) -> tuple[np.ndarray, ...]:
        return tuple(getattr(parameters, name) for name in MOVING)

    def _bias(self, sides, parameters: FaceParameters, views: FlowView, appearance: Appearance | None):
        """The estimator's flow of the rendered pair minus the exact flow, at the neighbour's points; pixels."""
        count = len(self._points.barycentric)
        bias = np.zeros((2, self.view_count, count, 2))
        with COMPUTING:
            there = np.asarray(_places(self._points, views, parameters), float)
        for k, side in enumerate(sides):
            if side is None:
                continue
            neighbour, links = side
            for view, cutout in enumerate(links.cutouts):
                renders = [
                    rendered_cutout(self._render, state, views, view, cutout, appearance)
                    for state in (neighbour.parameters, parameters)
                ]
                flow = self.estimator(*renders)
                said = read_at(flow, cutout.inside(links.starts[view])) / cutout.scale
                bias[k, view] = said - (there[view] - links.starts[view])
        return bias


def parameters_of(fit: FrameFit) -> FaceParameters:
    """The parameters recorded in a fit."""
    return FaceParameters(
        rotation=np.asarray(fit.rotation, float),
        translation=np.asarray(fit.translation, float),
        expression=np.asarray(fit.expression, float),
        identity=np.asarray(fit.identity, float),
        jaw=np.asarray(fit.jaw, float),
        scale=np.full(1, fit.scale),
    )


@jax.jit
def _places(points: SurfacePoints, views: FlowView, parameters: FaceParameters) -> Float[Array, "views n 2"]:
    return points_in_views(points, views, parameters)[0]


@jax.jit
def _landmarks(model, view: DeepView, parameters: FaceParameters, sliding) -> Float[Array, "68 2"]:
    return preselected_points(model, view, parameters, sliding)
