"""Temporal refinement (Deep Energies Sec. 7 and Appendix B): averaging, self flow, plate flow, or a hybrid.

Every method is a pass over the stream with a window of three frames, so that passes can be chained without holding
the clip. The first and last frame of a shot, and frames next to one without a face, are unchanged.

A note on Jacobi sweeps: if the flow from both neighbours agrees with the pictures, the new error of a frame is the mean
of its neighbours' old errors. Noise that alternates in sign is then passed on undamped. This is why averaging comes
first in the hybrid: weights of ¼, ½, ¼ remove exactly that noise.
"""

from collections.abc import Callable, Iterable, Iterator

from workbench.tracking.failures import why_failed
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.interpolation import averaged
from workbench.tracking.moments import Moment
from workbench.tracking.plan import RefinementPlan
from workbench.tracking.point_links import Neighbour
from workbench.tracking.records import FrameFit

LEAST_POINTS = 0.1
"""Fraction of the surface points with valid flow to both neighbours below which a frame is left unchanged."""


def refined(
    fitter: FlowFitter, stream: Iterable[Moment], advanced: Callable[[FrameFit], None] = lambda fit: None
) -> Iterator[Moment]:
    """The stream after the configured method and sweeps. `advanced` is called with each frame of each pass."""
    for make in passes(fitter.plan.refinement):
        stream = make(fitter, stream, advanced)
    yield from stream


def passes(refinement: RefinementPlan) -> list[Callable[..., Iterator[Moment]]]:
    """The passes of a method in order, repeated for every sweep, except the hybrid's averaging, which runs once."""
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
    """Each frame becomes the weighted mean of itself and its neighbours (Appendix B)."""
    centre = fitter.plan.refinement.centre
    side = 0.5 * (1.0 - centre)

    def mean(before: Moment, here: Moment, after: Moment) -> FrameFit:
        three = [parameters_of(moment.fit) for moment in (before, here, after)]
        return fitter.placed(here.fit, averaged(three, (side, centre, side)))

    yield from _windowed(stream, mean, advanced, newest=False)


def self_flow_pass(
    fitter: FlowFitter, stream: Iterable[Moment], advanced: Callable[[FrameFit], None] = lambda fit: None
) -> Iterator[Moment]:
    """Each frame is fitted to minimise ‖N(F₁, F₂) − N(F₂, F₃)‖ (Sec. 7). For the exact flow of the mesh its points move
    midway between those of its neighbours."""

    def midway(before: Moment, here: Moment, after: Moment) -> FrameFit:
        ends = (parameters_of(moment.fit) for moment in (before, after))
        solution = fitter.midway(
            *ends,
            parameters_of(here.fit),
            fitter.views(here.fit, here.pictures),
            fitter.plan.refinement.prior,
            fitter.appearance_of_shot(here),
        )
        return fitter.placed(here.fit, solution.parameters)

    yield from _windowed(stream, midway, advanced, fitter.plan.refinement.order == "gauss-seidel")


def plate_flow_pass(
    fitter: FlowFitter, stream: Iterable[Moment], advanced: Callable[[FrameFit], None] = lambda fit: None
) -> Iterator[Moment]:
    """Each frame is fitted so that the flow of the renders from both neighbours matches the flow of the pictures.

    In Sec. 7, the second flow leads from the frame to the later neighbour. So it does where renders go through the
    network; at surface points it leads from the neighbour to the frame.
    """

    def between(before: Moment, here: Moment, after: Moment) -> FrameFit:
        views, guess = fitter.views(here.fit, here.pictures), parameters_of(here.fit)
        neighbours = tuple(Neighbour(parameters_of(moment.fit), moment.pictures) for moment in (before, after))
        stay, appearance = fitter.plan.refinement.prior, fitter.appearance_of_shot(here)
        solution = fitter.between(
            neighbours, here.pictures, guess, guess, views, stay, appearance, least_points=LEAST_POINTS
        )
        if solution is None:
            return here.fit
        return fitter.placed(here.fit, solution.parameters)

    yield from _windowed(stream, between, advanced, fitter.plan.refinement.order == "gauss-seidel")


def _windowed(
    stream: Iterable[Moment],
    solve: Callable[[Moment, Moment, Moment], FrameFit],
    advanced: Callable[[FrameFit], None],
    newest: bool,
) -> Iterator[Moment]:
    """Apply `solve` to every frame with both neighbours, in order; `newest`: use the solved previous frame."""
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
    """Whether two consecutive frames belong to the same shot and both have a usable fit."""
    return first.shot == second.shot and not any(why_failed(fit) for fit in (first, second))
