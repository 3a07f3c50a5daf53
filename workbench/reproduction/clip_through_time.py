"""Infill and refinement after Deep Energies on a clip whose truth is not known: frames are hidden, a detector fails."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from workbench import pipeline, plots
from workbench.config import Config, InfillConfig, preset
from workbench.errors import InputError
from workbench.face import FaceModel, load_default_head
from workbench.frames import Frames
from workbench.landmarks.scheme import lip_distance, outer_eye_distance
from workbench.pipeline.temporal_run import views_of
from workbench.planning import plan_of
from workbench.rendering import Appearance
from workbench.reproduction.film_solves import METHODS, lips_apart_mm
from workbench.reproduction.gaps import FLOW, LINEAR, SPLINE, FilledGap, fill_gap, flow_figure, pictures_by_frame
from workbench.reproduction.rendered_clip import FOV_DEG
from workbench.reproduction.study import NETWORK, Result, Study, Table
from workbench.samples import sample
from workbench.tracker import calibration_window
from workbench.tracking import FrameContext, FrameFit, FrameObservation, Track
from workbench.tracking.deep_fitter import DeepFitter
from workbench.tracking.failures import failures_of
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.observation import Pictures
from workbench.tracking.records import stack_fits

FRAMES, QUICK_FRAMES, LEAST_FRAMES = 36, 18, 16
FIRST_OF_SAMPLE = 180
"""Of the bundled clip: somebody talks, and a yawn ends."""
GAPS, QUICK_GAPS = (1, 3, 5), (1,)
BETWEEN_GAPS = 5
STUCK, LOST = 2, 3
"""Frames in which the detector sticks, and in which it finds nothing."""
MARGIN = 2
"""Frames that are left between them and the ends."""
DISTANCES = ("rotation, °", "position, mm", "lips, mm", "landmarks, %")
SOLVED, FAILING = "solved", "failing, filled"


@dataclass(frozen=True, eq=False)
class _Clip:
    """A clip, solved frame by frame."""

    head: FaceModel
    config: Config
    track: Track
    frames: Frames
    pictures: list[Pictures]
    fitter: FlowFitter

    @property
    def identity(self) -> Float[np.ndarray, "i"]:
        """That of the shot."""
        return np.array(self.track.identity[np.flatnonzero(good_frames(self.track))[0]], float)

    def worked(self, track: Track, step: pipeline.Step, **sections) -> Track:
        return pipeline.work_over(track, [self.frames], self.head, self.config.changed(**sections), [step])

    def filled(self, gap: range, method: str) -> FilledGap:
        return fill_gap(self.fitter, self.track, self.pictures, gap, method)

    def distances(self, fits: Sequence[FrameFit]) -> Float[np.ndarray, "n 4"]:
        """`DISTANCES` from the solved fits of the same frames; of landmarks from what the network saw in the photo."""
        rows, person = [], self.head.personal(self.identity)
        for fit in fits:
            own = self.track[fit.index]
            turn = Rotation.from_rotvec(np.array(fit.rotation)) * Rotation.from_rotvec(np.array(own.rotation)).inv()
            # The mesh's own points for all: a solve records what the network sees in its render.
            off = self.fitter.landmarks(fit, parameters_of(fit)) - own.observed
            rows.append(
                (
                    np.degrees(turn.magnitude()),
                    np.linalg.norm(fit.translation - own.translation),
                    abs(lips_apart_mm(person, fit) - lips_apart_mm(person, own)),
                    100.0 * np.linalg.norm(off, axis=1).mean() / outer_eye_distance(own.observed),
                )
            )
        return np.array(rows)


def hidden_frames(study: Study) -> Result:
    """Sec. 6, 8.3 and 8.5 on a clip of the user's or the bundled one: hidden frames found again, failures repaired."""
    clip = _solved(study)
    stuck, lost = failing_frames(clip.track)
    tracks = _steadied(clip, stuck, lost, study)
    fills = Table(
        "Hidden frames, filled: mean distance from their fits; landmarks from the network's, % of the eye distance",
        ("frames in a gap", "", "gaps", *DISTANCES),
        tuple(_gap_rows(clip, QUICK_GAPS if study.quick else GAPS, study)),
    )
    seen = [k for k in np.flatnonzero(good_frames(clip.track)) if all(track.found[k] for track in tracks.values())]
    rows = []
    for name, track in tracks.items():
        means = [clip.distances([track[k] for k in some]).mean(axis=0) for some in (seen, lost, stuck)]
        numbers = (*(mean[-1] for mean in means), *means[-1][:2], *_jitters(track))
        rows.append((name, *(f"{number:.2f}" for number in numbers)))
    repairs = Table(
        "A detector that fails, repaired: distances from the landmarks and fits of one that does not",
        (
            *("", "landmarks, %", "where it finds nothing", "where it sticks"),
            *(f"there {name}" for name in DISTANCES[:2]),
            *("jitter, °", "jitter, mm"),
        ),
        tuple(rows),
    )
    whose = study.clip.name if study.clip else f"the bundled clip of a rendered head from frame {FIRST_OF_SAMPLE} on"
    return Result(
        data=f"{len(clip.track)} frames of {whose}; preset {clip.config.preset}, one camera.",
        figures=_figures(clip, tracks, stuck, lost),
        tables=(fills, repairs),
        notes=(
            f"The detector fails on purpose: in frames {stuck.start} to {stuck.stop - 1}, where the face moves most, "
            f"it repeats itself, and in {lost.start} to {lost.stop - 1}, where the lips do, it finds nothing. Truth is "
            "not used: fits and landmarks of a detector that does not fail stand for it, with their own errors. Jitter "
            "is the mean second difference over time of angles and position, of which a living head has some.",
            "Where a cut-out reaches beyond the picture it repeats the border: stripes in the photos, and flow there "
            "that is not compared. As in the paper, flow follows lips that interpolation does not, and plate flow and "
            "hybrid repair where the detector sticks by a part.",
            "`--clip FILE` takes a video of one face, of which the first frames count. The paper's clip is not public.",
        ),
    )


def good_frames(track: Track) -> Bool[np.ndarray, "n"]:
    """Frames whose fits can be used, of the first shot that has any."""
    good = failures_of(track, InfillConfig().largest_error) == ""
    return good & (track.shot == track.shot[good.argmax()])


def hidden_gaps(track: Track, length: int) -> list[range]:
    """Gaps of so many frames all over a track, each between good fits and of good fits."""
    good = good_frames(track)
    starts = range(BETWEEN_GAPS - 1, len(track) - length, length + BETWEEN_GAPS)
    return [range(first, first + length) for first in starts if good[first - 1 : first + length + 1].all()]


def failing_frames(track: Track) -> tuple[range, range]:
    """Where a detector that sticks does most harm, and one that finds nothing: where the landmarks, the lips move most.

    Raises `InputError` for a track without enough frames with a face.
    """
    good = good_frames(track)
    eyes = outer_eye_distance(track.observed)
    moved = np.linalg.norm(track.observed[STUCK:] - track.observed[:-STUCK], axis=2).mean(axis=1) / eyes[STUCK:]
    lips = lip_distance(track.observed) / eyes
    stuck = _most(moved, STUCK, good, range(0))
    lost = _most(np.abs(lips[LOST:] - lips[:-LOST]), LOST, good, stuck)
    return stuck, lost


def _most(changes: Float[np.ndarray, "m"], count: int, good: Bool[np.ndarray, "n"], apart_from: range) -> range:
    """The frames over which something changes most; `changes[k]` is that from frame k to k + `count`."""
    taken = range(apart_from.start - 2, apart_from.stop + 2) if len(apart_from) else range(0)
    frames = [range(k + 1, k + 1 + count) for k in np.argsort(-changes, kind="stable").tolist()]
    free = [
        each
        for each in frames
        if each.start >= MARGIN
        and each.stop + MARGIN <= len(good)
        and good[each.start - 1 : each.stop + 1].all()
        and not set(each) & set(taken)
    ]
    if not free:
        raise InputError(
            f"Too few of the clip's first {len(good)} frames have a face to be hidden and found again; name another "
            "clip with --clip."
        )
    return free[0]


def _solved(study: Study) -> _Clip:
    """The clip's first frames by a run of the workbench, which is kept and goes on where it was interrupted."""
    count, path = QUICK_FRAMES if study.quick else FRAMES, study.clip or sample("performance")
    config = preset("deep-points" if study.quick else "deep").changed(deep={"network": NETWORK})
    first = 0
    if study.clip is None:
        config, first = config.changed(camera={"fov_deg": FOV_DEG}), FIRST_OF_SAMPLE
    head = load_default_head()
    result = pipeline.track(
        path,
        study.folder / "run",
        head,
        config,
        pictures=False,
        resume=True,
        overwrite=True,
        frames=(first, first + count - 1),
        progress=study.progress,
    )
    track = result.track
    if (good := int(good_frames(track).sum())) < LEAST_FRAMES:
        raise InputError(
            f"{path} has a fitted face in {good} of its first {len(track)} frames, and {LEAST_FRAMES} of one shot are "
            "needed; name another clip with --clip."
        )
    (frames,) = views_of(track.meta, config)
    return _Clip(head, config, track, frames, pictures_by_frame([frames]), FlowFitter(head, plan_of(config)))


def _gap_rows(clip: _Clip, lengths: Sequence[int], study: Study) -> Iterator[tuple[str, ...]]:
    for length in lengths:
        gaps = hidden_gaps(clip.track, length)
        for method in (LINEAR, SPLINE, FLOW) if gaps else ():
            study.progress(f"gaps of {length}, {method}", 0, None)
            found = [fit for gap in gaps for fit in clip.filled(gap, method).fits]
            means = clip.distances(found).mean(axis=0)
            yield (str(length), method, str(len(gaps)), *(f"{mean:.2f}" for mean in means))


def _steadied(clip: _Clip, stuck: range, lost: range, study: Study) -> dict[str, Track]:
    """What a detector that fails leaves, and what infill, each method and re-estimation make of it."""
    fits = [clip.track[k] for k in range(len(clip.track))]
    fitter = DeepFitter(clip.head, plan_of(clip.config))
    last = fits[stuck.start - 1]
    context = FrameContext(last.shot, clip.identity, None, None, _appearance(clip, fitter))
    for k in (*stuck, *lost):
        seen = FrameObservation(k, last.landmarks if k in stuck else None, last.image_size)
        fits[k] = fitter.fit(seen, context)[0]
    failing = replace(clip.track, **stack_fits(fits))
    before = clip.worked(failing, "infill", infill={"method": "flow"})
    tracks = {SOLVED: clip.track, FAILING: before}
    for done, method in enumerate(METHODS):
        study.progress("refinement", done, len(METHODS))
        tracks[method] = clip.worked(before, "refine", refinement={"method": method})
    tracks["hybrid, re-estimated"] = clip.worked(tracks["hybrid"], "reestimate")
    return tracks


def _appearance(clip: _Clip, fitter: DeepFitter) -> Appearance | None:
    """The colours and light that the run solved with, from the frames of the shot that it took them from."""
    fits = [clip.track[k] for k in np.flatnonzero(clip.track.shot == clip.track.shot[good_frames(clip.track).argmax()])]
    shot = [
        FrameObservation(fit.index, fit.landmarks, fit.image_size, picture=clip.pictures[fit.index][0]) for fit in fits
    ]
    return fitter.appearance(calibration_window(shot, clip.config.identity.window), clip.identity)


def _figures(clip: _Clip, tracks: dict[str, Track], stuck: range, lost: range) -> dict[str, Figure]:
    filled = {method: clip.filled(lost, method).fits for method in (LINEAR, FLOW)}
    whole = range(lost.start - 1, lost.stop + 1)
    photos = [clip.pictures[k][0] for k in whole]
    shown = sorted({*lost, *stuck})
    rows = {name: tracks[name] for name in (SOLVED, FAILING, "plate", "hybrid")}
    marks = [(frames.start, frames.stop - 1) for frames in (lost, stuck)]
    return {
        f"After Fig. 8: frames {lost.start} to {lost.stop - 1} hidden and filled by flow. Hue is direction, colour is "
        "speed (Baker's); flows lead to a frame from the one before it.": flow_figure(
            clip.fitter, [clip.track[whole[0]], *filled[FLOW], clip.track[whole[-1]]], photos
        ),
        "After Fig. 13: as solved, and the same frames hidden and filled.": plots.film_strip(
            clip.head, photos[1:-1], {"solved": [clip.track[k] for k in lost], **filled}
        ),
        "After Fig. 14: frames that were lost or in which the detector sticks; the first row by one that does not "
        "fail.": plots.film_strip(
            clip.head,
            [clip.pictures[k][0] for k in shown],
            {name: [track[k] for k in shown] for name, track in rows.items()},
        ),
        "The pose over time. Grey: frames without a detection, and with one that sticks.": plots.track_curves(
            {name: tracks[name] for name in (SOLVED, FAILING, "hybrid")}, shaded=marks
        ),
    }


def _jitters(track: Track) -> tuple[float, float]:
    angles, places = (np.abs(np.diff(each, n=2, axis=0)) for each in (track.angles_deg, track.translation))
    return float(np.nanmean(angles)), float(np.nanmean(places))
