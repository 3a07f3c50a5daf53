"""Infill by flow against linear interpolation and splines, on films whose truth is known and on hidden detections.

Films (`moving_people.py`): a mouth held open that snaps shut, a blink, a nod; gaps of 1, 3, 5 and 9 frames about the
event, between true frames. Clips (`--clips`, default the bundled one): gaps of the same lengths all over a tracked
clip; the error is the distance from the fits that were hidden, and beside it that from the detections.
"""

import argparse
import time
from functools import partial
from pathlib import Path

import numpy as np
from moving_people import EVENT, MOTIONS, MovingPeople, config, landmark_error, weights_at
from result import print_result

from workbench.config import DEFAULT_PRESET, preset
from workbench.face import FaceParameters, load_default_head
from workbench.frames import open_frames
from workbench.landmarks.detectors import make_detector
from workbench.pipeline.picture_source import PictureSource
from workbench.pipeline.sources import FileSource
from workbench.planning import plan_of
from workbench.samples import sample
from workbench.tracker import FaceTracker
from workbench.tracking import FrameFit
from workbench.tracking.flow_fitter import FlowFitter
from workbench.tracking.infill import fill_by_flow, fill_by_spline, fill_linearly
from workbench.tracking.interpolation import SPLINE_FRAMES
from workbench.tracking.moments import Moment

GAPS = (1, 3, 5, 9)
METHODS = ("flow", "linear", "spline")
SPACING = 14
"""Frames of a clip from one hidden gap to the next."""


def main() -> None:
    """Print one line for the films and one for each clip."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--people", type=int, default=4, help="films of each motion")
    parser.add_argument("--clips", nargs="*", type=Path, default=[sample("performance")])
    parser.add_argument("--estimator", default="dis")
    parser.add_argument("--renders", default="exact")
    parser.add_argument("--detector", default="auto")
    options = parser.parse_args()
    flow = {"estimator": options.estimator, "renders": options.renders}
    if options.people:
        films(options.people, flow)
    for clip in options.clips:
        hidden(clip, flow, options.detector)


def films(people: int, flow: dict) -> None:
    """The table of the films."""
    made = MovingPeople()
    fitter = FlowFitter(made.head, plan_of(config().changed(flow=flow)))
    rows: dict[tuple[str, int], list[dict[str, float]]] = {}
    seconds = []
    for motion in MOTIONS:
        for seed in range(people):
            film = made.film(seed, partial(weights_at, motion))
            stream = [Moment(fit, (picture,)) for fit, picture in zip(film.truth, film.pictures, strict=True)]
            for gap in GAPS:
                first = EVENT - gap // 2
                began = time.perf_counter()
                found = filled(fitter, stream, first, gap)
                seconds.append((time.perf_counter() - began) / gap)
                rows.setdefault((motion, gap), []).append(mean_errors(fitter, found, film.truth[first : first + gap]))
    made.close()
    table = {
        f"{motion}_{gap}": {name: float(np.mean([row[name] for row in found])) for name in METHODS}
        for (motion, gap), found in rows.items()
    }
    report("infill_films", table, {"people": people, "seconds_a_frame": float(np.median(seconds))})


def hidden(clip: Path, flow: dict, detector: str) -> None:
    """The same table for a clip whose fits are hidden and filled again."""
    settings = preset(DEFAULT_PRESET).changed(flow=flow, landmarks={"detector": detector})
    head, frames = load_default_head(), open_frames(clip)
    source = PictureSource(frames, make_detector(detector), settings)
    if clip == sample("performance"):
        settings = settings.changed(camera={"fov_deg": 33.0})
        source = FileSource([sample("performance-landmarks")], frames)
    fits = list(FaceTracker(head, settings).fit_all(source.observations(0, {}, False)))
    pictures = [frame.picture for frame in frames.iterate()]
    stream = [Moment(fit, (picture,)) for fit, picture in zip(fits, pictures, strict=True)]
    fitter = FlowFitter(head, plan_of(settings))
    rows: dict[int, list[dict[str, float]]] = {gap: [] for gap in GAPS}
    against: dict[int, list[dict[str, float]]] = {gap: [] for gap in GAPS}
    for gap in GAPS:
        for first in range(SPLINE_FRAMES, len(fits) - gap - SPLINE_FRAMES, SPACING):
            around = fits[first - SPLINE_FRAMES : first + gap + SPLINE_FRAMES]
            if all(fit.found and fit.shot == around[0].shot and fit.errors[2] < 5.0 for fit in around):
                found = filled(fitter, stream, first, gap)
                truth = fits[first : first + gap]
                rows[gap].append(mean_errors(fitter, found, truth))
                against[gap].append(mean_errors(fitter, found, truth, detections=True))
    table = {str(gap): {name: float(np.mean([row[name] for row in rows[gap]])) for name in METHODS} for gap in GAPS}
    seen = {str(gap): {name: float(np.mean([row[name] for row in against[gap]])) for name in METHODS} for gap in GAPS}
    report(f"infill_{clip.stem}", table, {"gaps": len(rows[GAPS[0]]), "against_detections": seen})


def filled(fitter: FlowFitter, stream: list[Moment], first: int, gap: int) -> dict[str, list[FaceParameters]]:
    """Frames `first` to `first + gap − 1` by each method."""
    before, after = stream[first - SPLINE_FRAMES : first], stream[first + gap : first + gap + SPLINE_FRAMES]
    inside = [moment.pictures for moment in stream[first : first + gap]]
    known = [[moment.fit for moment in side] for side in (before, after)]
    return {
        "flow": fill_by_flow(fitter, before[-1], after[0], inside),
        "linear": fill_linearly(known[0][-1], known[1][0], gap),
        "spline": fill_by_spline(*known, gap),
    }


def mean_errors(
    fitter: FlowFitter, found: dict[str, list[FaceParameters]], truth: list[FrameFit], detections: bool = False
) -> dict[str, float]:
    """Mean landmark error of each method over a gap; against the observed landmarks if `detections`."""
    if detections:
        truth = [FrameFit(**{**vars(fit), "projected": fit.observed}) for fit in truth]
    return {
        name: float(np.mean([landmark_error(fitter.placed(fit, at), fit) for at, fit in zip(path, truth, strict=True)]))
        for name, path in found.items()
    }


def report(name: str, table: dict[str, dict[str, float]], details: dict) -> None:
    """One line: the ratio to linear over gaps of 3 and 5."""
    middle = [row for key, row in table.items() if key.split("_")[-1] in ("3", "5")]
    ratio = np.mean([row["flow"] for row in middle]) / np.mean([row["linear"] for row in middle])
    worst = max(row["flow"] / row["linear"] for row in table.values())
    worded = "linear/slerp on the same gaps of 3 and 5 frames"
    print_result(name, float(ratio), "ratio", "<= 0.5", worded, details | {"worst_row": worst, "percent": table})


if __name__ == "__main__":
    main()
