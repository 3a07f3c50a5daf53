"""Failed frames filled from their neighbours (Deep Energies Sec. 6, 8.3 and Appendix A).

By flow, frame by frame from a known neighbour. In the paper, a gap is solved forward from the good frame before it,
and then backward from the one after it, starting from what the first pass found; both may be repeated
("back-and-forth"). By default both passes start afresh ("meet"), are blended by distance from their anchors, because
flow errors accumulate, and every frame is solved again between its two neighbours. At the ends of a clip there is only
one anchor and one pass. Flow hardly sees eyelids close, so that by default the landmark network looks at them
afterwards.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Bool

from workbench.errors import InputError
from workbench.face import FaceParameters
from workbench.tracking.failures import failures_of, why_failed
from workbench.tracking.filled_lids import free_blinks, with_seen_lids
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.interpolation import SPLINE_FRAMES, between, splined
from workbench.tracking.moments import Moment, PictureSpool
from workbench.tracking.observation import Pictures
from workbench.tracking.plan import InfillPlan
from workbench.tracking.point_links import Neighbour
from workbench.tracking.records import FrameFit, Track

Advanced = Callable[[FrameFit], None]
"""Called with the original fit of each frame when it has been solved (several times with flow)."""


def infilled(
    fitter: FlowFitter,
    stream: Iterable[Moment],
    advanced: Advanced = lambda fit: None,
) -> Iterator[Moment]:
    """The stream with its gaps filled by the configuration's method, frames in order.

    A gap consists of frames that have no face, a failed fit or a large error, or that the configuration names. Frames
    of a shot without any good frame, and gaps longer than configured, stay as they are. A gap and its ends are held in
    memory, the pictures of a long gap on disk.
    """
    ahead = SPLINE_FRAMES if fitter.plan.infill.method == "spline" else 1
    window = _Window()
    try:
        for moment in stream:
            good = usable(moment.fit, fitter.plan.infill)
            another_gap = not good and bool(window.after)  # begins before the spline has all its frames
            if another_gap or (window.shot is not None and moment.fit.shot != window.shot):
                yield from _closed(fitter, window, advanced)
                window = window.continued(moment.fit.shot)
            window.shot = moment.fit.shot
            if not good:
                window.add(moment)
            elif not window.gap:
                window.before.append(moment)
                yield moment
            else:
                window.after.append(moment)
                if len(window.after) == ahead:
                    yield from _closed(fitter, window, advanced)
                    window = window.continued(window.shot)
        yield from _closed(fitter, window, advanced)
    finally:
        window.pictures.close()


def usable(fit: FrameFit, infill: InfillPlan) -> bool:
    """Whether a fit is kept and may be an anchor: not named by the configuration, and not failed (`why_failed`)."""
    return not infill.named(fit.index) and not why_failed(fit, infill.largest_error)


def usable_frames(track: Track, infill: InfillPlan) -> Bool[np.ndarray, "n"]:
    """`usable` for every frame of a track at once."""
    named = np.array([infill.named(int(index)) for index in track.index], bool)
    return ~named & (failures_of(track, infill.largest_error) == "")


@dataclass
class _Window:
    """Good frames, a gap, good frames."""

    shot: int | None = None
    before: deque[Moment] = field(default_factory=lambda: deque(maxlen=SPLINE_FRAMES))
    gap: list[FrameFit] = field(default_factory=list)
    pictures: PictureSpool = field(default_factory=PictureSpool)
    after: list[Moment] = field(default_factory=list)

    def add(self, moment: Moment) -> None:
        self.gap.append(moment.fit)
        self.pictures.append(moment.pictures)

    def continued(self, shot: int) -> "_Window":
        """The window before the next gap; empty in another shot."""
        return _Window(shot, deque(self.after if shot == self.shot else (), maxlen=SPLINE_FRAMES))


def _closed(fitter: FlowFitter, window: _Window, advanced: Advanced) -> Iterator[Moment]:
    if window.gap:
        before, after = window.before, window.after
        ends = (before[-1] if before else None), (after[0] if after else None)
        filled = window.gap
        if any(ends) and len(window.gap) <= fitter.plan.infill.longest:
            like = next(end for end in ends if end is not None).fit
            found = _filled(fitter, window, ends, advanced)
            filled = [fitter.filled(fit, like, at) for fit, at in zip(window.gap, found, strict=True)]
        for k, fit in enumerate(filled):
            yield Moment(fit, window.pictures[k])
        window.pictures.close()
    yield from window.after


def _filled(fitter: FlowFitter, window: _Window, ends, advanced: Advanced) -> list[FaceParameters]:
    method, count = fitter.plan.infill.method, len(window.gap)
    if method == "flow":
        return fill_by_flow(fitter, *ends, window.pictures, lambda k: advanced(window.gap[k]))
    fits = [[moment.fit for moment in side] for side in (window.before, window.after)]
    if method == "spline":
        found = fill_by_spline(*fits, count)
    else:
        found = fill_linearly(fits[0][-1] if fits[0] else None, fits[1][0] if fits[1] else None, count)
    for fit in window.gap:
        advanced(fit)
    return found


def fill_by_flow(
    fitter: FlowFitter,
    before: Moment | None,
    after: Moment | None,
    pictures: Sequence[Pictures] | PictureSpool,
    advanced: Callable[[int], None] = lambda k: None,
) -> list[FaceParameters]:
    """Parameters of the frames between two anchors, or beyond one; eyelids are then set as the plan says.

    `advanced` is called with the position of each frame in the gap after its solve.
    Raises `InputError` without any anchor.
    """
    ends = [end for end in (before, after) if end is not None]
    if not ends:
        raise InputError("A gap needs a good frame at one of its ends; this shot has none.")
    path = _by_flow(fitter, before, after, pictures, advanced)
    names = fitter.model.expression_names
    blinks = free_blinks(names, fitter.free[6 : 6 + len(names)])  # behind the pose
    if fitter.plan.infill.lids == "flow" or not blinks:
        return path
    known = [(parameters_of(end.fit), end.pictures[0]) for end in ends]
    gap = (pictures[k][0] for k in range(len(pictures)))
    return with_seen_lids(blinks, partial(fitter.landmarks, ends[0].fit), known, path, gap)


def _by_flow(fitter: FlowFitter, before, after, pictures, advanced) -> list[FaceParameters]:
    anchor = before or after
    views = fitter.views(anchor.fit, anchor.pictures)
    appearance = fitter.appearance_of_shot(anchor)
    ends = tuple(None if end is None else Neighbour(parameters_of(end.fit), end.pictures) for end in (before, after))
    count = len(pictures)

    def along(
        order: Sequence[int], end: Neighbour, path: Sequence[FaceParameters] | None = None
    ) -> list[FaceParameters]:
        found: list[FaceParameters] = [end.parameters] * count
        neighbour = end
        for k in order:
            start = neighbour.parameters if path is None else path[k]
            solution = fitter.between((neighbour, None), pictures[k], start, start, views, appearance=appearance)
            found[k] = solution.parameters
            neighbour = Neighbour(found[k], pictures[k])
            advanced(k)
        return found

    def polished(order: Sequence[int], path: list[FaceParameters]) -> list[FaceParameters]:
        path = list(path)
        for k in order:
            sides = []
            for other in (k - 1, k + 1):
                if 0 <= other < count:
                    sides.append(Neighbour(path[other], pictures[other]))
                else:
                    sides.append(ends[0 if other < 0 else 1])
            solution = fitter.between(tuple(sides), pictures[k], path[k], expected[k], views, appearance=appearance)
            path[k] = solution.parameters
            advanced(k)
        return path

    forth, back = range(count), range(count - 1, -1, -1)
    if before is None or after is None:
        return along(forth if after is None else back, ends[0] or ends[1])
    if fitter.plan.infill.passes == "back-and-forth":
        path = along(forth, ends[0])
        for turn in range(fitter.plan.infill.rounds):
            path = along(back, ends[1], path) if turn % 2 == 0 else along(forth, ends[0], path)
        return path
    forward, backward = along(forth, ends[0]), along(back, ends[1])
    path = [between(forward[k], backward[k], (k + 1) / (count + 1)) for k in range(count)]
    expected = fill_linearly(before.fit, after.fit, count)
    for turn in range(fitter.plan.infill.rounds):
        path = polished(forth if turn % 2 == 0 else back, path)
    return path


def fill_linearly(before: FrameFit | None, after: FrameFit | None, count: int) -> list[FaceParameters]:
    """t and w linear, θ spherical between two anchors; beyond one the anchor's parameters (Appendix A).

    Raises `InputError` without any anchor.
    """
    if before is None and after is None:
        raise InputError("A gap needs a good frame at one of its ends; this shot has none.")
    if before is None or after is None:
        return [parameters_of(before or after)] * count
    first, last = parameters_of(before), parameters_of(after)
    return [between(first, last, (k + 1) / (count + 1)) for k in range(count)]


def fill_by_spline(before: Sequence[FrameFit], after: Sequence[FrameFit], count: int) -> list[FaceParameters]:
    """Splines through the good frames on both sides; with good frames on one side only, like `fill_linearly`.

    `before` and `after` are in order, and consecutive up to the gap.
    """
    if not before or not after:
        return fill_linearly(before[-1] if before else None, after[0] if after else None, count)
    times = [*range(-len(before), 0), *range(count, count + len(after))]
    return splined(times, [parameters_of(fit) for fit in (*before, *after)], range(count))
