"""The flow energy through the network, made from photos and neighbours: Deep Energies Secs. 6 and 7 as printed.

The pair of photos and the pair of renders are cut out alike and go through the same network. A frame stands second in a
pair with the frame before it and first in one with the frame after it. In a backward pass the known frame comes first,
as in a forward one. Flows are compared where the first render shows the face, in self flow where the frame's own does:
behind it photos show what no render has.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from workbench.energies.flow import FlowWeights, face_triangles
from workbench.energies.flow_link import FlowView
from workbench.errors import ConfigError
from workbench.face import FaceModel, FaceParameters
from workbench.flow import NetworkFlow
from workbench.rendering import Appearance, RenderModel
from workbench.runtime import COMPUTING
from workbench.tracking.flow_renders import RenderedView, rendered_view
from workbench.tracking.flow_solver import FlowLimits
from workbench.tracking.observation import Pictures
from workbench.tracking.photo_flow import Cutout, cutout_about
from workbench.tracking.plan import FlowPlan
from workbench.tracking.point_links import Neighbour, PointLinker, check_pictures, places_of
from workbench.tracking.rendered_flow import face_mask, look_at, read_grid
from workbench.tracking.rendered_flow_solver import FlowDifference, RenderedFlowProblem, RenderedPair


class MovingFrame(NamedTuple):
    """The frame that is solved, besides its neighbours."""

    start: FaceParameters
    """Roughly where it is, for the cut-outs and for what shows in its render."""
    prior: FaceParameters
    views: FlowView
    weights: FlowWeights
    limits: FlowLimits
    appearance: Appearance | None
    """Colours and light of the renders; the model's own for None."""


class RenderedFlow:
    """Makes the problems of one model and one network."""

    def __init__(self, model: FaceModel, render: RenderModel, linker: PointLinker, flow: FlowPlan):
        """Raises `ConfigError` for an estimator that has no derivative."""
        estimator = linker.estimator
        if not isinstance(estimator, NetworkFlow):
            raise ConfigError(
                'flow.renders = "network" takes the derivative of the flow network, and the estimator '
                f'{flow.estimator!r} has none; set flow.estimator to "network" or to the weights of one.'
            )
        self._estimator, self._linker, self._pixels = estimator, linker, flow.side
        self._render = render
        self._wanted = face_triangles(model)

    def between(
        self,
        neighbours: tuple[Neighbour | None, Neighbour | None],
        pictures: Pictures,
        frame: MovingFrame,
    ) -> RenderedFlowProblem:
        """Renders that flow from the first neighbour, and on to the second, as the photos do (Secs. 6 and 7).

        Raises `InputError` if the numbers of pictures and views differ.
        """
        before, after = neighbours
        start, views = frame.start, frame.views
        for end in neighbours:
            if end is not None:
                check_pictures(end.pictures, pictures, len(views.rotation))
        cutouts = self._cutouts([end.parameters for end in neighbours if end is not None] + [start], views)
        seen = self._rendered_views(views, cutouts, frame.appearance)
        here = self._cut(pictures, cutouts)
        pairs, differences = [], []
        if before is not None:
            pairs.append(RenderedPair("second", self._renders(seen, before.parameters)))
            flow = self._photo_flow(self._cut(before.pictures, cutouts), here)
            shown = self._masks(seen, before.parameters) * self._within(before.pictures, cutouts)
            differences.append((flow, shown))
        if after is not None:
            pairs.append(RenderedPair("first", self._renders(seen, after.parameters)))
            flow = self._photo_flow(here, self._cut(after.pictures, cutouts))
            differences.append((flow, self._masks(seen, start) * self._within(pictures, cutouts)))
        terms = tuple(
            FlowDifference(tuple(np.eye(len(pairs))[k].tolist()), *difference)
            for k, difference in enumerate(differences)
        )
        return self._problem(frame, cutouts, seen, pairs, terms)

    def midway(self, before: FaceParameters, after: FaceParameters, frame: MovingFrame) -> RenderedFlowProblem:
        """A render that flows on as it flowed from the one before: ‖N(F₁, F₂) − N(F₂, F₃)‖ (Sec. 7)."""
        cutouts = self._cutouts([before, after, frame.start], frame.views)
        seen = self._rendered_views(frame.views, cutouts, frame.appearance)
        pairs = RenderedPair("second", self._renders(seen, before)), RenderedPair("first", self._renders(seen, after))
        mask = self._masks(seen, frame.start)
        term = FlowDifference((1.0, -1.0), np.zeros((*mask.shape, 2)), mask)
        return self._problem(frame, cutouts, seen, pairs, [term])

    def _problem(self, frame: MovingFrame, cutouts, seen, pairs, terms) -> RenderedFlowProblem:
        return RenderedFlowProblem(
            network=self._estimator.network,
            side=self._estimator.side,
            model=self._render,
            views=seen,
            pairs=tuple(pairs),
            differences=tuple(terms),
            unit_px=self._unit_px(frame.start, frame.views, cutouts),
            weights=frame.weights,
            prior=frame.prior,
            limits=frame.limits,
        )

    def _cutouts(self, states: Sequence[FaceParameters], views: FlowView) -> list[Cutout]:
        """One cut-out per view that holds the face of every state."""
        with COMPUTING:
            places = np.stack([np.asarray(places_of(self._linker.points, views, state), float) for state in states])
        return [cutout_about(places[:, view], self._pixels) for view in range(places.shape[1])]

    def _rendered_views(self, views: FlowView, cutouts, appearance) -> tuple[RenderedView, ...]:
        return tuple(rendered_view(self._render, views, k, cutout, appearance) for k, cutout in enumerate(cutouts))

    def _renders(self, seen: tuple[RenderedView, ...], parameters: FaceParameters):
        with COMPUTING:
            return tuple(look_at(self._render, view, parameters, self._pixels) for view in seen)

    def _masks(self, seen: tuple[RenderedView, ...], parameters: FaceParameters):
        masks = [face_mask(self._render, view, parameters, self._wanted, self._pixels) for view in seen]
        return np.stack(masks).astype(float)

    def _within(self, pictures: Pictures, cutouts: Sequence[Cutout]):
        """Where the grid lies in the pictures: beyond their border a cut-out repeats pixels."""
        grid = read_grid(np.stack(np.meshgrid(*[np.arange(self._pixels, dtype=float)] * 2), axis=-1))
        within = []
        for picture, cutout in zip(pictures, cutouts, strict=True):
            places = (grid - 0.5 * (cutout.pixels - 1)) / cutout.scale + cutout.centre
            largest = np.array(picture.shape[1::-1]) - 1
            within.append(((places >= 0.0) & (places <= largest)).all(axis=-1))
        return np.stack(within).astype(float)

    def _cut(self, pictures: Pictures, cutouts: Sequence[Cutout]):
        return [cutout.cut(picture) for cutout, picture in zip(cutouts, pictures, strict=True)]

    def _photo_flow(self, first, second):
        with COMPUTING:
            flows = [read_grid(self._estimator(one, other)) for one, other in zip(first, second, strict=True)]
        return np.stack(flows).astype(float)

    def _unit_px(self, guess: FaceParameters, views: FlowView, cutouts: Sequence[Cutout]):
        return self._linker.unit_px(guess, views) * np.array([cutout.scale for cutout in cutouts])
