"""The data of the flow term: where the frame before and the flow from its picture have the face of a frame."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.energies.flow_link import FlowLink, FlowTargets, FlowView
from workbench.errors import InputError
from workbench.face import FaceModel, FaceParameters
from workbench.flow import SurfacePoints, personal_points
from workbench.rendering import RenderModel, render_model
from workbench.tracking.observation import FrameObservation, PicturePair
from workbench.tracking.plan import FlowPlan, Plan
from workbench.tracking.point_links import Neighbour, PointLinker


class FlowTerm:
    """Links frames to those before them. Keeps the latest flow, because panels and diagnoses fit a frame repeatedly."""

    def __init__(self, model: FaceModel, flow: FlowPlan, render: RenderModel | None = None):
        """`render`: the model's arrays for the renderer, if there are some already."""
        self.flow = flow
        # What an estimator finds on renders changes with the unknowns: in a term the mesh's exact flow stands for it.
        exact = replace(flow, renders="exact")
        self._linker = PointLinker(model, render_model(model) if render is None else render, exact)
        self._person: tuple[np.ndarray, SurfacePoints] | None = None
        self._latest: tuple[PicturePair, tuple[FaceParameters, FlowView], FlowTargets] | None = None

    @property
    def points(self) -> SurfacePoints:
        """The surface points, for any identity."""
        return self._linker.points

    def points_of(self, identity: Float[np.ndarray, "i"]) -> SurfacePoints:
        """The surface points of one person; persons come one after the other, so only the latest are kept."""
        if self._person is None or not np.array_equal(self._person[0], identity):
            self._person = np.array(identity), jax.tree.map(jnp.asarray, personal_points(self.points, identity))
        return self._person[1]

    def link(
        self,
        observation: FrameObservation,
        last: FaceParameters | None,
        views: FlowView,
        points: SurfacePoints,
        beyond_mm: float | int = 0.0,
    ) -> FlowLink:
        """The link of a frame to the one before it; without one (`last` None) the same arrays with weights of 0.

        `last` has all blocks. `beyond_mm`: how much farther than in a solve the cameras are from the head. Raises
        `InputError` if there is a frame before, but no picture of it.
        """
        if last is None:
            targets = _nothing(len(views.rotation), len(points.barycentric))
        elif observation.motion is None:
            raise InputError(
                f"The flow term compares the picture of frame {observation.index} with the one before, but they are "
                "not given; open the clip together with its pictures, or take 'flow' out of the stages' terms."
            )
        else:
            last = jax.tree.map(lambda part: np.array(part, float), last)
            last.translation[2] += beyond_mm
            targets = self._targets(observation.motion, last, views)
        solved = views._replace(translation=views.translation + np.array([0.0, 0.0, beyond_mm]))
        return FlowLink(points, solved, targets, np.asarray(self.flow.robust))

    def _targets(self, motion: PicturePair, last: FaceParameters, views: FlowView) -> FlowTargets:
        if self._latest is None or not (
            _same_pictures(self._latest[0], motion) and _equal(self._latest[1], last, views)
        ):
            links = self._linker.links(Neighbour(last, motion.before), motion.now, last, views)
            self._latest = motion, (last, views), self._linker.targets((links,), last, views)
        return self._latest[2]


def flow_term(
    model: FaceModel, plan: Plan, earlier: FlowTerm | None = None, render: RenderModel | None = None
) -> FlowTerm | None:
    """What links the frames of a plan: the earlier one if it still fits, None if no stage names the term."""
    if "flow" not in plan.terms:
        return None
    return earlier if earlier is not None and earlier.flow == plan.flow else FlowTerm(model, plan.flow, render)


def blank_motion(image_size: tuple[int, int]) -> PicturePair:
    """Two blank pictures, to compile with."""
    blank = np.zeros((image_size[1], image_size[0], 3), np.uint8)
    return PicturePair((blank,), (blank,))


def _nothing(views: int, count: int) -> FlowTargets:
    places = np.zeros((1, views, count, 2))
    return FlowTargets(places, np.zeros(places.shape[:3]), np.zeros_like(places), np.ones(views))


def _same_pictures(first: PicturePair, second: PicturePair) -> bool:
    return all(
        one is other for one, other in zip((*first.before, *first.now), (*second.before, *second.now), strict=True)
    )


def _equal(known, *trees) -> bool:
    leaves = zip(jax.tree.leaves(known), jax.tree.leaves(trees), strict=True)
    return all(np.array_equal(one, other) for one, other in leaves)
