"""A frame whose jaw the network misreads, as in Deep Energies Fig. 7, and the two repairs of Sec. 8.2."""

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import UInt8

from workbench import plots
from workbench.config import preset
from workbench.face import load_default_head
from workbench.landmarks.scheme import GROUPS, outer_eye_distance
from workbench.reproduction.clip_solves import QUANTITIES, ClipSolves, clip_solver, seen_in
from workbench.reproduction.rendered_clip import clip_pictures, clip_truth, errors_of_pose_and_jaw, true_parameters
from workbench.reproduction.study import Result, Study, Table
from workbench.tracking import FrameFit, FrameObservation
from workbench.tracking.failures import why_failed
from workbench.tracking.flow_fitter import FlowFitter, parameters_of
from workbench.tracking.infill import fill_by_flow
from workbench.tracking.moments import Moment

FRAME = 148
"""The person talks, turned to the side a little."""
BLUR_PX, BLUR_DEG = 51, 20.0
"""The jolt of the camera while this frame is exposed; half as long in the frames next to it."""
REACH, QUICK_REACH = 2, 1
"""Frames from `FRAME` to the sharp ones that the flow starts from."""
PARTS = ("jaw", "brows", "eyes", "nose", "mouth")
RIGID, WHOLE = "rigid alignment", "expression estimation"
WITHOUT_JAW, FILLED, RENDERED = "jaw at weight 0", "filled by flow", "as rendered"
Picture = UInt8[np.ndarray, "h w 3"]


def worked_failure(study: Study) -> Result:
    """Fig. 7: what the wrong markers make of the solve, and what is left of it after either repair."""
    reach = QUICK_REACH if study.quick else REACH
    sharp = clip_pictures(range(FRAME - reach, FRAME + reach + 1))
    shot = {k: picture if abs(k - FRAME) == reach else jolted(picture, _blur_px(k)) for k, picture in sharp.items()}
    observations = {"sharp": seen_in(sharp[FRAME], FRAME), "blurred": seen_in(shot[FRAME], FRAME)}
    fits = _fits(shot, observations["blurred"], study)
    markers = observations["blurred"].landmarks.points
    shown = {label: replace(fits[label], observed=markers) for label in (RIGID, WHOLE, WITHOUT_JAW, FILLED, RENDERED)}
    figure = plots.compared_fits(load_default_head(), shot[FRAME], shown, about=clip_truth().landmarks[FRAME])
    header = ("", *QUANTITIES, "landmarks, %", "called a failure")
    rows = tuple((label, *_errors(fit), _verdict(fit)) for label, fit in fits.items() if label != RENDERED)
    marker_rows = tuple((label, *_marker_errors(observation)) for label, observation in observations.items())
    return Result(
        data=f"frame {FRAME} of the bundled clip of a rendered head, blurred over {BLUR_PX} pixels as if the camera "
        "had been jolted, which leads the network astray along the jaw; identity and camera given, preset deep with "
        "one network and without confidences.",
        figures={
            "After the rigid alignment, after the expression estimation, the two repairs, and the truth. White rings "
            "are the network's markers, the same in all columns; lines lead from them to the model's points.": figure
        },
        tables=(
            Table("Errors of the solve against what was rendered", header, rows),
            Table("Errors of the network's markers, % of the eye distance", ("picture", *PARTS), marker_rows),
        ),
        notes=(
            "The paper's frame is one of a real performer with motion blur, and its network 3D-FAN. It names both "
            "repairs and shows neither on this frame; and there is no truth to compare with. Here the flow starts from "
            f"the solves of frames {FRAME - reach} and {FRAME + reach}, which are sharp.",
            "With the jaw's markers at weight 0 the solve comes closer, but keeps what is wrong with the others, as "
            "the paper expects. No stage moves the lids.",
        ),
    )


def jolted(picture: Picture, length_px: int) -> Picture:
    """The picture as a camera sees it that moves by so many pixels during the exposure."""
    line = np.zeros((length_px, length_px), np.float32)
    line[length_px // 2] = 1.0
    middle = ((length_px - 1) / 2,) * 2
    line = cv2.warpAffine(line, cv2.getRotationMatrix2D(middle, BLUR_DEG, 1.0), line.shape)
    return cv2.filter2D(picture, -1, line / line.sum(), borderType=cv2.BORDER_REPLICATE)


def _fits(shot: Mapping[int, Picture], observation: FrameObservation, study: Study) -> dict[str, FrameFit]:
    """The blurred frame by everything that is compared, and as rendered."""
    first, last = min(shot), max(shot)
    seen = {FRAME: observation, **{k: seen_in(shot[k], k) for k in (first, last)}}
    head, alike = load_default_head(), preset("deep").changed(landmarks={"confidence": False})
    configs = {WHOLE: alike, WITHOUT_JAW: alike.changed(landmarks={"weights": {"jaw": 0.0}})}
    if not study.quick:
        configs |= {"with confidences": preset("deep"), "preset deep-energies": preset("deep-energies")}
    solver = clip_solver()
    solves = {label: solver.solve(config, (FRAME,), study, label, seen.get) for label, config in configs.items()}
    ends = solver.solve(preset("deep"), (first, last), study, "neighbours", seen.get)
    fitter = FlowFitter(head, ends.fitter.plan)
    filled = _filled(fitter, ends, shot, study)
    return {
        RIGID: _rigid_part(solves[WHOLE]),
        **{label: each.fitter.record(each.solutions[FRAME]) for label, each in solves.items()},
        FILLED: filled,
        RENDERED: fitter.placed(filled, true_parameters(FRAME)),
    }


def _blur_px(frame: int) -> int:
    return BLUR_PX if frame == FRAME else BLUR_PX // 2


def _rigid_part(solves: ClipSolves) -> FrameFit:
    """What the stages leave that move the head alone."""
    solution = solves.solutions[FRAME]
    count = next(k for k, stage in enumerate(solution.stages) if not {"rotation", "translation"} >= set(stage.free))
    return solves.fitter.record(replace(solution, results=solution.results[:count]))


def _filled(fitter: FlowFitter, ends: ClipSolves, shot: Mapping[int, Picture], study: Study) -> FrameFit:
    """The frame by the flow from its sharp neighbours."""
    before, after = (Moment(ends.fitter.record(solution), (shot[k],)) for k, solution in sorted(ends.solutions.items()))
    gap = range(before.fit.index + 1, after.fit.index)
    found = fill_by_flow(
        fitter, before, after, [(shot[k],) for k in gap], lambda k: study.progress("flow", k, len(gap))
    )
    return fitter.filled(replace(before.fit, index=FRAME), before.fit, found[gap.index(FRAME)])


def _errors(fit: FrameFit) -> tuple[str, ...]:
    true = clip_truth().landmarks[FRAME]
    apart = 100.0 * np.linalg.norm(fit.projected - true, axis=1).mean() / outer_eye_distance(true)
    return tuple(f"{value:.2f}" for value in (*errors_of_pose_and_jaw(parameters_of(fit), FRAME), apart))


def _marker_errors(observation: FrameObservation) -> tuple[str, ...]:
    true = clip_truth().landmarks[FRAME]
    percent = 100.0 * np.linalg.norm(observation.landmarks.points - true, axis=1) / outer_eye_distance(true)
    return tuple(f"{percent[list(GROUPS[part])].mean():.1f}" for part in PARTS)


def _verdict(fit: FrameFit) -> str:
    return "" if fit.source == "filled" else why_failed(fit) or "no"
