"""Steadier tracks (Deep Energies Sec. 7 and Appendix B): averaging, self flow, plate flow, and both in turn.

Every method is a pass over the stream with a window of three frames, so that passes follow each other without holding
the clip. The first and last frame of a shot, and frames beside one without a face, stay as they are.

A remark on Jacobi sweeps: where both neighbours' flows agree with the pictures, the new error of a frame is the mean of
its neighbours' old errors. Noise that changes sign from frame to frame is then handed on and not damped, which is why
averaging goes first in the hybrid: weights of ¼, ½, ¼ take out exactly that noise.
"""

from collections.abc import Callable, Iterable, Iterator

from workbench.energies.flow import FlowTargets
from workbench.tracking.failures import why_failed
from workbench.tracking.flow_fitter import FlowFitter, Neighbour, parameters_of
from workbench.tracking.interpolation import averaged
from workbench.tracking.moments import Moment
from workbench.tracking.plan import RefinementPlan
from workbench.tracking.records import FrameFit

LEAST_POINTS = 0.1
"""Share of the surface points that flow must follow to both neighbours; below it a frame stays."""


def refined(
    fitter: FlowFitter, stream: Iterable[Moment], advanced: Callable[[FrameFit], None] = lambda fit: None
) -> Iterator[Moment]:
    """The stream after the configuration's method and sweeps. `advanced` is called with each frame of each pass."""
    for make in passes(fitter.plan.refinement):
        stream = make(fitter, stream, advanced)
    yield from stream


def passes(refinement: RefinementPlan) -> list[Callable[..., Iterator[Moment]]]:
    """The passes of a method in order, each once for every sweep but the hybrid's averaging, which runs once."""
    flow = {"self": self_flow_pass, "plate": plate_flow_pass, "hybrid": plate_flow_pass}
    if refinement.method == "none":
        return []
    if refinement.method == "averaging":
        return [averaging_pass] * refinement.sweeps
    first = [averaging_pass] if refinement.method == "hybrid" else []
    return first + [flow[refinement.method]] * refinement.sweeps


def averaging_pass(
    fitter: FlowFitter, stream: Iterable[Moment], advanced: Callable[[FrameFit], None] = lambda fit: None
) -> Iterator[Moment]:
    """Each frame the weighted mean of itself and its neighbours (Appendix B)."""
    centre = fitter.plan.refinement.centre
    side = 0.5 * (1.0 - centre)

    def mean(before: Moment, here: Moment, after: Moment) -> FrameFit:
        three = [parameters_of(moment.fit) for moment in (before, here, after)]
        return fitter.placed(here.fit, averaged(three, (side, centre, side)))

    yield from _windowed(stream, mean, advanced, newest=False)


def self_flow_pass(
    fitter: FlowFitter, stream: Iterable[Moment], advanced: Callable[[FrameFit], None] = lambda fit: None
) -> Iterator[Moment]:
    """Each frame where ‖N(F₁, F₂) − N(F₂, F₃)‖ (Sec. 7) is least for the exact flow of the mesh: the points midway
    between the neighbours'."""

    def midway(before: Moment, here: Moment, after: Moment) -> FrameFit:
        views = fitter.views(here.fit)
        targets = fitter.midway_targets(parameters_of(before.fit), parameters_of(after.fit), views)
        return _moved(fitter, here, targets, views)

    yield from _windowed(stream, midway, advanced, fitter.plan.refinement.order == "gauss-seidel")


def plate_flow_pass(
    fitter: FlowFitter, stream: Iterable[Moment], advanced: Callable[[FrameFit], None] = lambda fit: None
) -> Iterator[Moment]:
    """Each frame where the renders' flow from both neighbours to it is that of the pictures.

    Sec. 7 has the flow from the frame to the later neighbour in its second term.
    """

    def between(before: Moment, here: Moment, after: Moment) -> FrameFit:
        views, guess = fitter.views(here.fit), parameters_of(here.fit)
        neighbours = [Neighbour(parameters_of(moment.fit), moment.pictures) for moment in (before, after)]
        sides = tuple((end, fitter.links(end, here.pictures, guess, views)) for end in neighbours)
        if any(links.weights.mean() < LEAST_POINTS for _, links in sides):
            return here.fit
        appearance = fitter.appearance_of_shot(here)
        stay = fitter.plan.refinement.prior
        solution = fitter.solve(sides, guess, guess, views, stay_pose=stay, appearance=appearance)
        return fitter.placed(here.fit, solution.parameters)

    yield from _windowed(stream, between, advanced, fitter.plan.refinement.order == "gauss-seidel")


def _moved(fitter: FlowFitter, here: Moment, targets: FlowTargets, views) -> FrameFit:
    start = parameters_of(here.fit)
    solution = fitter.solve_targets(targets, start, start, views, fitter.plan.refinement.prior)
    return fitter.placed(here.fit, solution.parameters)


def _windowed(
    stream: Iterable[Moment],
    solve: Callable[[Moment, Moment, Moment], FrameFit],
    advanced: Callable[[FrameFit], None],
    newest: bool,
) -> Iterator[Moment]:
    """`solve` of every frame that has both neighbours, in order; `newest`: the one before as already solved."""
    before: Moment | None = None
    here: Moment | None = None
    for after in stream:
        if here is not None:
            solved = here
            if before is not None and _joined(before.fit, here.fit) and _joined(here.fit, after.fit):
                solved = here._replace(fit=solve(before, here, after))
            advanced(here.fit)
            yield solved
            before = solved if newest else here
        here = after
    if here is not None:
        advanced(here.fit)
        yield here


def _joined(first: FrameFit, second: FrameFit) -> bool:
    """Whether two frames that follow each other show the same shot and both have a fit to use."""
    return first.shot == second.shot and not any(why_failed(fit) for fit in (first, second))
