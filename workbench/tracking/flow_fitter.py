"""Placing a frame from its neighbours by optical flow: combines photos, surface points, renders and solver."""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Array, Float, UInt8

from workbench.energies.deep import DeepView, deep_model, preselected_points
from workbench.energies.flow import FlowWeights
from workbench.energies.flow_link import FlowTargets, FlowView
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters, free_parameters, parameter_range
from workbench.rendering import Appearance, estimate_appearance, face_vertices
from workbench.runtime import COMPUTING
from workbench.tracking.flow_renders import rendered_cutout
from workbench.tracking.flow_solver import MOVING, FlowLimits, FlowSolution, solve_flow
from workbench.tracking.moments import view_sizes
from workbench.tracking.observation import Pictures
from workbench.tracking.photo_flow import read_at
from workbench.tracking.plan import Plan
from workbench.tracking.point_links import Links, Neighbour, PointLinker, flow_views, places_of
from workbench.tracking.records import FrameFit
from workbench.tracking.rendered_flow_problem import MovingFrame, RenderedFlow
from workbench.tracking.rendered_flow_solver import solve_rendered_flow

ESTIMATED_PASSES = 3
"""Number of solves; the estimator's flow of the renders is updated between them."""
TOLERANCE = 1e-4
"""A solve ends when a step lowers the energy by less than this fraction."""


class FlowFitter:
    """Solves frames from the flow to their neighbours. Holds the arrays of one model and one plan."""

    def __init__(self, model: FaceModel, plan: Plan):
        """Raises `InputError` and `ConfigError` for weights or settings that cannot be used."""
        self.model, self.plan, self.rig = model, plan, plan.camera.rig
        self._model = deep_model(model)
        self._render = self._model.render
        self.linker = PointLinker(model, self._render, plan.flow)
        self._points = self.linker.points
        freed = [
            free_parameters(model, stage.free, stage.shapes, plan.camera.parallel, stage.name)
            for stage in plan.stages
            if stage.enabled
        ]
        self.free = np.any([np.concatenate(self._of_moving(one)) for one in freed], axis=0)
        """Which entries of rotation, translation, expression and jaw are free in any stage of the plan."""
        self._by_network = (
            RenderedFlow(model, self._render, self.linker, plan.flow) if plan.flow.renders == "network" else None
        )
        self._appearances: dict[int, Appearance | None] = {}

    def views(self, fit: FrameFit, pictures: Pictures = ()) -> FlowView:
        """The cameras of a fit, stacked; `pictures` are its own, in each view of a rig."""
        return flow_views(self.rig, fit.camera, view_sizes(fit, self.rig, pictures))

    def links(self, neighbour: Neighbour, pictures: Pictures, guess: FaceParameters, views: FlowView) -> Links:
        """As `PointLinker.links`."""
        return self.linker.links(neighbour, pictures, guess, views)

    def between(
        self,
        neighbours: tuple[Neighbour | None, Neighbour | None],
        pictures: Pictures,
        start: FaceParameters,
        prior: FaceParameters,
        views: FlowView,
        stay_pose: float | int = 0.0,
        appearance: Appearance | None = None,
        least_points: float = 0.0,
    ) -> FlowSolution | None:
        """The frame of these pictures between two neighbours (None for a missing one), near `prior`.

        `appearance`: needed where renders go through an estimator. At surface points, None if either flow is valid for
        less than the fraction `least_points` of them; through the network every frame is solved.
        """
        if self._by_network is not None:
            frame = MovingFrame(start, prior, views, self._weights(stay_pose), self._limits(start), appearance)
            return solve_rendered_flow(self._by_network.between(neighbours, pictures, frame), start)
        sides = tuple(None if end is None else (end, self.links(end, pictures, start, views)) for end in neighbours)
        if any(side is not None and side[1].weights.mean() < least_points for side in sides):
            return None
        return self.solve(sides, start, prior, views, stay_pose, appearance)

    def midway(
        self,
        before: FaceParameters,
        after: FaceParameters,
        start: FaceParameters,
        views: FlowView,
        stay_pose: float | int = 0.0,
        appearance: Appearance | None = None,
    ) -> FlowSolution:
        """The frame near `start` that minimises ‖N(F₁, F₂) − N(F₂, F₃)‖ (Sec. 7); N is the mesh's exact flow unless
        renders go through the network."""
        if self._by_network is not None:
            frame = MovingFrame(start, start, views, self._weights(stay_pose), self._limits(start), appearance)
            return solve_rendered_flow(self._by_network.midway(before, after, frame), start)
        return self.solve_targets(self.midway_targets(before, after, views), start, start, views, stay_pose)

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
        targets = self.linker.targets([None if side is None else side[1] for side in sides], start, views)
        solution = self.solve_targets(targets, start, prior, views, stay_pose)
        if self.plan.flow.renders == "estimated":
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
            ends = [np.asarray(places_of(self._points, views, state), float) for state in (before, after)]
        targets = self.linker.targets((None, None), before, views)
        targets.places[0] = 0.5 * (ends[0] + ends[1])
        targets.weights[0] = 4.0
        return targets

    def appearance_of_shot(self, moment) -> Appearance | None:
        """Colours and light of a shot, from the first of its frames requested; None if not needed or not available."""
        if self.plan.flow.renders == "exact" or not moment.pictures:
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
        return replace(
            like,
            projected=projected,
            observed=like.observed if like.seen else projected,
            energies=np.full_like(like.energies, np.nan),
            status=np.full_like(like.status, -1),
            iterations=np.zeros_like(like.iterations),
            scale=float(np.asarray(parameters.scale).item()),
            **parts,
        )

    def filled(self, empty: FrameFit, like: FrameFit, parameters: FaceParameters) -> FrameFit:
        """The record of a frame without landmarks: the model's are used in their place, with confidence 0.

        `empty` provides the frame's number and times; `like` (an anchor) provides camera, person and layout.
        """
        made = self.placed(replace(like, index=empty.index, milliseconds=empty.milliseconds), parameters)
        return replace(
            made,
            found=True,
            failure="",
            source="filled",
            observed=made.projected,
            confidence=np.zeros(len(like.confidence)),
            others=np.zeros_like(like.others),
            covariance=np.full_like(like.covariance, np.nan),
        )

    def landmarks(self, fit: FrameFit, parameters: FaceParameters) -> Float[np.ndarray, "points 2"]:
        """The model's landmarks in the reference picture, pixels."""
        nothing = np.zeros((68, 2)), np.zeros(68), np.zeros(68), np.ones(()), np.zeros((9, 3)), np.zeros(3)
        view = DeepView(fit.camera, np.eye(3), np.zeros(3), *nothing)
        sliding = float(self.plan.sliding)
        with COMPUTING:
            return np.asarray(_landmarks(self._model, view, parameters, sliding), float)

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
        bias = np.zeros((2, len(views.rotation), count, 2))
        with COMPUTING:
            there = np.asarray(places_of(self._points, views, parameters), float)
        for k, side in enumerate(sides):
            if side is None:
                continue
            neighbour, links = side
            for view, cutout in enumerate(links.cutouts):
                renders = [
                    rendered_cutout(self._render, state, views, view, cutout, appearance)
                    for state in (neighbour.parameters, parameters)
                ]
                flow = self.linker.estimator(*renders)
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
def _landmarks(model, view: DeepView, parameters: FaceParameters, sliding) -> Float[Array, "points 2"]:
    return preselected_points(model, view, parameters, sliding)
