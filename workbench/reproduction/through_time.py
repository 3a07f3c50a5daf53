"""Deep Energies on a moving picture: Figs. 8, 11, 13 to 18, Sec. 8.4, on a film by two cameras with a known truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from workbench import plots
from workbench.face import FaceModel, load_default_head
from workbench.plots import Picture
from workbench.reproduction.film_solves import (
    METHODS,
    MOUTH,
    ONE,
    ONE_POINTS,
    TWO,
    TWO_POINTS,
    FilmSolve,
    lips_apart_mm,
    solved,
)
from workbench.reproduction.gaps import FLOW, LINEAR, SPLINE, flow_figure
from workbench.reproduction.stereo_film import APART_DEG, AXES
from workbench.reproduction.study import Result, Study, Table
from workbench.reproduction.talking_film import RATE, TalkingFilm, talking_film
from workbench.tracking import FrameFit, Track

QUANTITIES = (*AXES, MOUTH)
JITTERS = ("jitter, °", "jitter, mm")
PITCH, DEPTH, LIPS_APART = 1, 5, 6
"""Their places in `QUANTITIES`."""
OTHER_PARTS = (
    "The paper's film is of a real performer, with motion blur, and measured against an artist's alignment; ours is "
    "measured against what was rendered. The landmark network is the workbench's own, in place of 3D-FAN. Presets are "
    "deep, with one network and not its ensemble, and deep-points, our versions of the paper's; the person's shape is "
    "given, as in the paper."
)
USUAL_FLOW = (
    "Flow is OpenCV's dense inverse search, in place of FlowNet2, and that of the renders the mesh's exact one; "
    "film-flow-forms compares it with the paper's."
)
BEFORE_AND_AFTER = {"before": "none", "hybrid": "hybrid"}
SMALL_SIDE, SIDE = 128, 256
"""Cut-outs in which the forms of the flow are compared, pixels; through the network in small ones, as a quarter of the
pixels takes a quarter of the time."""
QUICK_ITERATIONS = 4
QUICK_NOTE = "A quick run solves by preselected points alone: renders seen by the network take longer."


@dataclass(frozen=True, eq=False)
class _Films:
    """What the items have in common: the film and its solves, made when asked for and kept in the study's folder."""

    study: Study
    head: FaceModel
    film: TalkingFilm

    @property
    def names(self) -> tuple[str, ...]:
        """The series of solves."""
        return (ONE_POINTS, TWO_POINTS) if self.study.quick else (ONE, TWO, ONE_POINTS, TWO_POINTS)

    def solve(self, name: str) -> FilmSolve:
        return solved(self.film, self.head, name, self.study)

    @cached_property
    def one(self) -> FilmSolve:
        """By the front camera."""
        return self.solve(self.names[0])

    @cached_property
    def two(self) -> FilmSolve:
        """By both cameras."""
        return self.solve(self.names[1])

    @property
    def plain(self) -> list[int]:
        """Frames in which the detector works."""
        timeline = self.film.timeline
        return [k for k in range(timeline.frames) if k not in (*timeline.stuck, *timeline.lost)]

    def result(self, figures: Mapping[str, Figure], tables: Sequence[Table], *notes: str) -> Result:
        """With the film's description and what all items note."""
        timeline = self.film.timeline
        width, height = timeline.size
        data = (
            f"a rendered film of {timeline.frames} frames, {width} × {height}, {RATE} a second, by two cameras "
            f"{APART_DEG:g}° apart: a person talks, snaps the mouth shut, blinks and nods."
        )
        failing = (
            f"The detector fails on purpose: in frames {_listed(timeline.stuck)} it repeats what it said in "
            f"{timeline.stuck.start - 1}, for both cameras, and in {_listed(timeline.lost)} it finds nothing. In the "
            "blink no solve can follow the lids: as in the paper, only jaw and mouth are free."
        )
        quick = (QUICK_NOTE,) if self.study.quick else ()
        return Result(data, figures, tuple(tables), (*notes, OTHER_PARTS, failing, *quick))


def alignment(study: Study) -> Result:
    """Sec. 8.4: every frame on its own, by one camera and by two, over the picture."""
    films = _films(study)
    one, two = films.one, films.two
    solves = [films.solve(name) for name in films.names]
    shown = [films.plain[k] for k in np.linspace(1, len(films.plain) - 1, 5).round().astype(int)]
    strip = _strip(two, shown, {"truth": two.truth, ONE: one.track, TWO: two.track}, DEPTH, "z {:+.1f} mm")
    tables = [
        Table(
            f"Mean absolute errors, {where}",
            ("", *QUANTITIES, "frames", "failed"),
            tuple(
                (
                    solve.series,
                    *_means(solve.errors(solve.track)[chosen]),
                    str(len(chosen)),
                    str(int((solve.track.failure[chosen] != 0).sum())),
                )
                for solve in solves
            ),
        )
        for where, chosen in (
            ("frames in which the detector works", films.plain),
            ("frames in which it sticks", [*films.film.timeline.stuck]),
        )
    ]
    return films.result(
        {"Sec. 8.4: what was rendered, and the solves by one camera and by two; errors in depth.": strip},
        tables,
        "As in the paper, rotations are alike by one camera and by two, and two find the depth much better; that a "
        "detector sticks harms both. Failed: fits that say so themselves, by their residuals.",
    )


def infill(study: Study) -> Result:
    """Figs. 8 and 13: gaps filled by flow and by interpolation, between solved frames."""
    films = _films(study)
    timeline, two = films.film.timeline, films.two
    gaps = {
        "the mouth snaps shut": timeline.gap,
        "a blink, nothing detected": timeline.lost,
        "a nod, the detector sticks": timeline.stuck,
    }
    tables, strips = [], {}
    for solve in (films.one, two):
        rows, strips = [], {}
        for done, (label, gap) in enumerate(gaps.items()):
            study.progress(f"{solve.series}: gaps", done, len(gaps))
            own = [solve.track[k] for k in gap]
            strips[label] = {"solved": own}
            if all(fit.found for fit in own):
                rows.append((label, "solved", *_means(solve.errors(own)), ""))
            for method in (LINEAR, SPLINE, FLOW):
                found = solve.filled(gap, method)
                rows.append((label, method, *_means(found.errors), f"{found.gap.seconds:.2f}"))
                strips[label][method] = found.gap.fits
        header = ("gap", "", *QUANTITIES, "s per frame")
        tables.append(Table(f"Mean absolute errors in the gaps, {solve.series}", header, tuple(rows)))
    snap, nod = (strips[label] for label in ("the mouth snaps shut", "a nod, the detector sticks"))
    whole = range(timeline.gap.start - 1, timeline.gap.stop + 1)
    figures = {
        f"Fig. 8: frames {_listed(timeline.gap)} filled by flow between {whole.start} and {whole.stop - 1}. Hue is "
        "direction, colour is speed (Baker's); flows lead to a frame from the one before it.": flow_figure(
            two.flow_fitter(),
            [two.track[whole.start], *snap[FLOW], two.track[whole.stop - 1]],
            _front(two, whole),
        ),
        "Fig. 13: what was solved, and the same frames filled; errors of the mouth's opening.": _strip(
            two, timeline.gap, {name: snap[name] for name in ("solved", LINEAR, FLOW)}, LIPS_APART, "mouth {:+.1f} mm"
        ),
        "The same in the nod. Solved: from the landmarks at which the detector sticks. Errors of the pitch.": _strip(
            two, timeline.stuck, {name: nod[name] for name in ("solved", LINEAR, FLOW)}, PITCH, "pitch {:+.1f}°"
        ),
    }
    return films.result(
        figures,
        tables,
        "As in the paper, flow keeps the mouth open until it snaps shut, where interpolation shuts it evenly. In the "
        "nod splines come about as close as flow. The photos' flow beside the face is that of a plain wall and not "
        "compared. Passes meet in the middle of the gap; the paper's go back and forth.",
        USUAL_FLOW,
        "Times are those of the computer that made this page.",
    )


def flow_forms(study: Study) -> Result:
    """Sec. 6: the flow of the renders in three forms, in the same gap."""
    films = _films(study)
    gap, solve = films.film.timeline.gap, films.one
    gap = gap[1:2] if study.quick else gap
    own, line = [solve.track[k] for k in gap], solve.filled(gap, LINEAR)
    rows = [("solved", *_means(solve.errors(own)), ""), ("linear", *_means(line.errors), f"{line.gap.seconds:.2f}")]
    shown = {"solved": own, "linear": line.gap.fits}
    for done, (label, changes) in enumerate(flow_form_settings(study.quick).items()):
        study.progress(f"{solve.series}: forms of the flow", done, None)
        found = solve.filled(gap, FLOW, **changes)
        rows.append((label, *_means(found.errors), f"{found.gap.seconds:.2f}"))
        shown[label] = found.gap.fits
    header = ("N(F₁, F₂)", *QUANTITIES, "s per frame")
    left_out = (
        f"A quick run has {QUICK_ITERATIONS} iterations, and leaves out the network's derivative with our settings."
    )
    quick = (left_out,) if study.quick else ()
    strip = _strip(solve, gap, shown, LIPS_APART, "mouth {:+.1f} mm")
    return films.result(
        {"The gap filled with each form; errors of the mouth's opening.": strip},
        [Table(f"Mean absolute errors in frames {_listed(gap)}, {solve.series}", header, tuple(rows))],
        "The flow network is the workbench's own, in place of FlowNet2; in the first form, dense inverse search is on "
        "the photos. As published: by the network's derivative, forward and then backward over the filled frames, all "
        "compared pixels alike, nothing that holds the blendshapes. The sides of cut-outs are in the labels, in the "
        "paper 512; through the network they are small, because it takes long: compare with the row of the same side. "
        "Times are those of the computer that made this page.",
        "Where something holds the blendshapes the mouth keeps its shape; as published it may be drawn out of it, "
        "unlike in the paper's pictures, which are of 512 pixels and by FlowNet2.",
        *quick,
    )


def smoothing(study: Study) -> Result:
    """Figs. 11 and 14 to 17: the four methods of temporal refinement, on frames whose gaps are filled."""
    films = _films(study)
    timeline, two = films.film.timeline, films.two
    before, truth = two.worked(), two.truth
    tracks = {method: two.worked(method) for method in METHODS}
    every = {"before": before, **tracks}
    shown = sorted({*range(timeline.shut - 2, timeline.shut + 1), *range(timeline.nod - 1, timeline.nod + 2)})
    around = range(timeline.stuck.start - 2, min(timeline.stuck.stop + 2, timeline.frames))
    marks = {"shaded": [(frames.start, frames.stop - 1) for frames in (timeline.lost, timeline.stuck)]}
    pitch = {"column": PITCH, "note": "pitch {:+.1f}°"}
    figures = {
        "Fig. 11: before and after plate flow, where the detector sticks; errors of the pitch.": _strip(
            two, around, {"before": before, "plate": tracks["plate"]}, **pitch
        ),
        "Fig. 14: the methods over the pictures, about the mouth's snap and in the nod; errors of the pitch.": _strip(
            two, shown, tracks, **pitch
        ),
        "Fig. 15: the pose before and after hybrid. Grey: frames without a detection, and with one that sticks.": (
            plots.track_curves({"truth": truth, "before": before, "hybrid": tracks["hybrid"]}, **marks)
        ),
        "Fig. 16: distance from the truth before and after hybrid.": plots.track_curves(
            {"before": before, "hybrid": tracks["hybrid"]}, truth=truth, **marks
        ),
        "Fig. 17: the pose by each method.": plots.track_curves({"truth": truth, **tracks}, **marks),
    }
    stuck = [*timeline.stuck]
    pairs = {}
    for name in films.names:
        solve = films.solve(name)
        pairs |= {f"{name}, {label}": (solve, solve.worked(method)) for label, method in BEFORE_AND_AFTER.items()}
    tables = [
        Table(
            f"Mean absolute errors, {two.series}",
            ("", *QUANTITIES, *JITTERS),
            tuple((name, *_means(two.errors(track)), *_jitters(two, track)) for name, track in every.items()),
        ),
        Table(
            "The same in frames in which the detector sticks",
            ("", *QUANTITIES),
            tuple((name, *_means(two.errors(track)[stuck])) for name, track in every.items()),
        ),
        Table(
            "By one camera and by two, before and after hybrid",
            ("", *QUANTITIES, *JITTERS),
            tuple((name, *_means(one.errors(track)), *_jitters(one, track)) for name, (one, track) in pairs.items()),
        ),
    ]
    return films.result(
        figures,
        tables,
        USUAL_FLOW,
        "As in the paper, averaging and hybrid are smooth, hybrid does not increase the errors of the pose, and errors "
        "of the landmarks propagate: plate flow repairs frames in which the detector sticks by a part only, and in the "
        "full film the first of them not at all. Unlike there, self flow has some effect on noise.",
        "Before: frames without a detection are filled by flow. Jitter: mean second difference over time of the errors "
        "of angles and position.",
    )


def reestimation(study: Study) -> Result:
    """Fig. 18 and Appendix B.1: the expression fitted again with the steadied poses held."""
    films = _films(study)
    timeline, two = films.film.timeline, films.two
    tracks = {"before": two.worked()}
    for method in ("averaging", "hybrid"):
        tracks |= {method: two.worked(method), f"{method}, re-estimated": two.worked(method, reestimated=True)}
    snap = range(timeline.shut - 3, timeline.shut + 2)
    rows = []
    for name, track in tracks.items():
        off = two.errors(track)[:, LIPS_APART]
        means = (np.abs(off[frames]).mean() for frames in (slice(None), films.plain, [*snap]))
        rows.append((name, *(f"{mean:.2f}" for mean in means), f"{np.abs(np.diff(off, n=2)).mean():.2f}"))
    person = films.head.personal(films.film.identity)
    apart = {
        name: np.array([lips_apart_mm(person, track[k]) for k in range(len(track))])
        for name, track in {"truth": two.truth, **tracks}.items()
    }
    figures = {
        "Fig. 18: expression estimation, temporal smoothing and re-estimation; errors of the mouth's opening.": _strip(
            two, snap, tracks, LIPS_APART, "{:+.1f} mm"
        ),
        "How far the lips are apart.": plots.curves(np.arange(timeline.frames), apart, "frame", "mm", (8.0, 3.6)),
    }
    header = ("", "all frames", "detector works", "about the snap", "jitter")
    return films.result(
        figures,
        [Table("Mean absolute error of the mouth's opening, mm", header, tuple(rows))],
        USUAL_FLOW,
        "As in the paper, what averaging dampens is captured again, and on average the mouth is closer than before the "
        "refinement; after hybrid, which dampens little, there is little to win.",
        "Re-estimation looks at each frame's own landmarks again: frames without any stay as they are, and where the "
        "detector sticks, what it said returns.",
    )


def flow_form_settings(quick: bool) -> dict[str, dict[str, dict[str, Any]]]:
    """Changes to the configuration by form, as for `Config.changed`."""
    side, limit = (SMALL_SIDE, {"iterations": QUICK_ITERATIONS}) if quick else (SIDE, {})
    network, small = ({"side": pixels, "estimator": "network", **limit} for pixels in (side, SMALL_SIDE))
    through = {**small, "renders": "network"}
    published = {**through, "robust": 1000.0, "stay": 0.0}
    forms: dict[str, dict[str, dict[str, Any]]] = {
        f"exact, of the mesh, {side} px": {"flow": {"side": side, **limit}},
        f"exact, photos by the network, {side} px": {"flow": network},
        f"estimated, the mesh's derivative, {side} px": {"flow": {**network, "renders": "estimated"}},
    }
    if not quick:
        forms |= {
            f"exact, photos by the network, {SMALL_SIDE} px": {"flow": small},
            f"the network's derivative, {SMALL_SIDE} px": {"flow": through},
        }
    passes = {"passes": "back-and-forth", "lids": "flow"}
    return forms | {f"as published, {SMALL_SIDE} px": {"flow": published, "infill": passes}}


def _films(study: Study) -> _Films:
    head = load_default_head()
    return _Films(study, head, talking_film(head, study))


def _listed(frames: range) -> str:
    return ", ".join(map(str, frames))


def _means(errors: Float[np.ndarray, "n 7"]) -> tuple[str, ...]:
    return tuple(f"{value:.2f}" for value in np.nanmean(np.abs(errors), axis=0))


def _jitters(solve: FilmSolve, track: Track) -> tuple[str, str]:
    second = np.abs(np.diff(solve.errors(track)[:, : len(AXES)], n=2, axis=0)).mean(axis=0)
    return f"{second[:3].mean():.2f}", f"{second[3:].mean():.2f}"


def _front(solve: FilmSolve, frames: Sequence[int]) -> list[Picture]:
    return [solve.pictures[k][0] for k in frames]


def _strip(
    solve: FilmSolve, frames: Sequence[int], tracks: Mapping[str, Track | Sequence[FrameFit]], column: int, note: str
) -> Figure:
    """Fits of these frames over the front camera's pictures, each with one of its errors.

    `tracks`: whole tracks, or fits of these frames alone.
    """
    rows = {
        name: [track[k] for k in frames] if isinstance(track, Track) else list(track) for name, track in tracks.items()
    }
    notes = {name: [note.format(row[column]) for row in solve.errors(fits)] for name, fits in rows.items()}
    return plots.film_strip(solve.head, _front(solve, frames), rows, notes)
