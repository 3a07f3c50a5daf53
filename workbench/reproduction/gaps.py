"""Gaps of solved tracks filled from the frames beside them, timed, and drawn as in Deep Energies Fig. 8."""

import time
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure

from workbench import plots
from workbench.errors import InputError
from workbench.flow import flow_picture, geometric_flow
from workbench.frames import Frames
from workbench.rendering import RenderModel, face_vertices, render_model
from workbench.runtime import COMPUTING
from workbench.tracking import FrameFit, Track
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.flow_renders import rendered_cutout, rendered_view
from workbench.tracking.infill import fill_by_flow, fill_by_spline, fill_linearly, usable_frames
from workbench.tracking.interpolation import SPLINE_FRAMES
from workbench.tracking.moments import Moment
from workbench.tracking.observation import Pictures
from workbench.tracking.photo_flow import Cutout, cutout_about
from workbench.tracking.point_links import flow_views

FLOW, LINEAR, SPLINE = "flow", "linear", "spline"
SIDE = 256
"""Of the pictures of Fig. 8, pixels."""
LONGEST_PX = 10.0
"""Flow in full colour, pixels of these pictures."""


class FilledGap(NamedTuple):
    """Frames filled by one method."""

    frames: range
    fits: tuple[FrameFit, ...]
    seconds: float
    """Per frame, once everything is compiled."""


def fill_gap(
    fitter: FlowFitter, track: Track, pictures: Sequence[Pictures], frames: range, method: str = FLOW
) -> FilledGap:
    """Fill frames of a track as if they had no fits, by "flow", "linear" or "spline" between those beside them.

    `pictures` are those of every frame of the track. Raises `InputError` for a gap without a good fit on both sides.
    """
    before, after = _beside(fitter, track, frames)
    inside = [pictures[k] for k in frames]
    if method == FLOW:
        ends = Moment(before[-1], pictures[frames.start - 1]), Moment(after[0], pictures[frames.stop])
        fill_by_flow(_of_one_step(fitter), *ends, inside[:1])  # compiles
    began = time.perf_counter()
    if method == FLOW:
        found = fill_by_flow(fitter, *ends, inside)
    elif method == LINEAR:
        found = fill_linearly(before[-1], after[0], len(frames))
    else:
        found = fill_by_spline(before, after, len(frames))
    seconds = (time.perf_counter() - began) / len(frames)
    fits = tuple(fitter.filled(track[k], before[-1], at) for k, at in zip(frames, found, strict=True))
    return FilledGap(frames, fits, seconds)


def pictures_by_frame(views: Sequence[Frames]) -> list[Pictures]:
    """The pictures of each frame in every view."""
    streams = [frames.iterate() for frames in views]
    return [tuple(frame.picture for frame in together) for together in zip(*streams, strict=True)]


def flow_figure(fitter: FlowFitter, fits: Sequence[FrameFit], photos: Sequence[UInt8[np.ndarray, "h w 3"]]) -> Figure:
    """Fig. 8: consecutive frames, the first and the last of which are anchors, with the photos of the first view.

    Rows are photos, flow of the photos, flow of the renders, renders. Flows lead to a frame from the one before it; the
    renders' is what the flow settings compare with the photos'.
    """
    cutout = cutout_about(np.concatenate([fit.projected for fit in fits]), SIDE)
    appearance = fitter.appearance(fits[0], photos[0])
    model, views = render_model(fitter.model), fitter.views(fits[0])
    renders = [rendered_cutout(model, parameters_of(fit), views, 0, cutout, appearance) for fit in fits]
    cuts = [cutout.cut(photo) for photo in photos]
    estimate = fitter.linker.estimator
    of_photos = [estimate(*pair) for pair in pairwise(cuts)]
    if fitter.plan.flow.renders == "exact":
        of_renders = [_exact_flow(model, *pair, cutout) for pair in pairwise(fits)]
    else:
        of_renders = [estimate(*pair) for pair in pairwise(renders)]
    blank = np.full_like(cuts[0], 255)
    rows = {
        "photo": cuts,
        "flow of photos": [blank, *map(_colored, of_photos)],
        "flow of renders": [blank, *map(_colored, of_renders)],
        "render": renders,
    }
    ends = (fits[0].index, fits[-1].index)
    return plots.picture_rows(rows, [f"frame {fit.index}" + (", anchor" if fit.index in ends else "") for fit in fits])


def _of_one_step(fitter: FlowFitter) -> FlowFitter:
    """The same fitter with one iteration a solve: it takes the same programs."""
    brief = copy(fitter)
    brief.plan = replace(fitter.plan, flow=replace(fitter.plan.flow, iterations=1))
    return brief


def _beside(fitter: FlowFitter, track: Track, frames: range) -> tuple[list[FrameFit], list[FrameFit]]:
    """The fits next to a gap on both sides, in order: as many as a spline takes, up to the next one that failed."""
    good = usable_frames(track, fitter.plan.infill) & (track.shot == track.shot[frames.start])
    before, after = frames.start, frames.stop
    while before > 0 and good[before - 1] and frames.start - before < SPLINE_FRAMES:
        before -= 1
    while after < len(track) and good[after] and after - frames.stop < SPLINE_FRAMES:
        after += 1
    if before == frames.start or after == frames.stop:
        raise InputError(
            f"There is no good fit right before or right after frames {frames.start} to {frames.stop - 1} to fill them "
            "from; choose other frames."
        )
    return [track[k] for k in range(before, frames.start)], [track[k] for k in range(frames.stop, after)]


def _exact_flow(model: RenderModel, before: FrameFit, now: FrameFit, cutout: Cutout) -> Float[np.ndarray, "s s 2"]:
    """The mesh's flow in a cut-out of the first view."""
    crop = rendered_view(model, flow_views(None, now.camera), 0, cutout).camera
    with COMPUTING:
        places = [face_vertices(model, parameters_of(fit)) for fit in (before, now)]
        moved = geometric_flow(*places, model.topology.triangles, crop, size=(cutout.pixels,) * 2)
        return np.asarray(moved.flow)


def _colored(field: Float[np.ndarray, "h w 2"]) -> UInt8[np.ndarray, "h w 3"]:
    return flow_picture(np.asarray(field), LONGEST_PX)
