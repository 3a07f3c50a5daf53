"""Causes seen in the pictures: something covers the face, blur, darkness, a head turned away, a cut, a jump."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from workbench.diagnosis.appearance import FACE, PARTS, FaceLook, UsualLook
from workbench.diagnosis.causes.groups import HARDLY_SEEN, mask_of, muted, title_of
from workbench.diagnosis.causes.motion import interpolated
from workbench.diagnosis.flags import JUMP_DEG, JUMP_MM
from workbench.diagnosis.reference import robust_similarity
from workbench.diagnosis.trial import Finding, Trial, points_change
from workbench.landmarks.shot_cuts import correlation, thumbnail_of

SURPRISING = 1.6
"""Multiple of the usual colour difference above which a cell shows something else than the face; 0.5 is common."""
COVERED_SHARE = (0.06, 0.8)
"""Share of the face's cells that is surprising: less is a wrinkle or an open mouth, more is not this face at all."""
LEAST_OVERLAP, SURE_OVERLAP = 0.2, 0.5
"""Overlap (intersection over union) of the surprising cells with a part of the face from which it may be covered if
the detector doubts it too, and from which it is in any case."""
DOUBTFUL = 0.7
"""Confidence relative to the usual one below which the detector doubts a part."""
SOFT, VERY_SOFT = 0.5, 0.15
"""Sharpness relative to the shot's at which a face begins to be blurred, and at which it surely is."""
SOFTER = 0.8
"""Factor on the sharpness of the softest tenth of the frames that a blurred face does not reach either."""
DARK, VERY_DARK = 60.0, 25.0
"""Median lightness of a face (0..255) at which it begins to be dark, and at which it surely is."""
DIMMED = 0.6
"""Lightness relative to the shot's below which a face counts as dark."""
TURNED_DEG, PROFILE_DEG = 40.0, 65.0
"""Yaw from which the far half of the face is foreshortened, and at which it is hidden."""
CUT = 0.6
"""Correlation of consecutive pictures below which they show different scenes."""
JUMP_PERCENT, UNUSUAL_JUMP = 4.0, 3.0
"""Distance of the points from the middle of the adjacent frames', % of the eye distance, that counts as a jump, and how
many times the shot's usual one it is."""
CONFIRMED = 0.4
"""Share of a jump that may be missing in the motion of the picture if the head itself jumps."""


def covered(trial: Trial) -> Iterator[Finding]:
    """A part of the face looks like in none of the frames near it, and the detector doubts it."""
    look, usual = trial.look, trial.usual_look
    if look is None or usual is None:
        return
    surprise = usual.surprise(look)
    surprising = (surprise > SURPRISING) & FACE
    share = surprising.sum() / FACE.sum()
    name, overlap = max(((name, _overlap(surprising, part)) for name, part in PARTS.items()), key=lambda pair: pair[1])
    mask, title = mask_of(trial, name), title_of(name)
    confidence = trial.case.observation.landmarks.confidence
    sure, others = float(confidence[mask].mean()), float(confidence[~mask].mean())
    doubts = float(trial.relative_confidence[mask].mean()) < DOUBTFUL
    needed = LEAST_OVERLAP if doubts else SURE_OVERLAP
    if not COVERED_SHARE[0] <= share <= COVERED_SHARE[1] or overlap < needed:
        return
    # Where all points are in doubt they may have slid, and with them the part that is named.
    slid = float(trial.relative_confidence[~mask].mean()) < DOUBTFUL
    part = PARTS[name] & surprising
    here, elsewhere = (float(np.median(surprise[cells])) for cells in (part, FACE & ~surprising))
    mask |= trial.relative_confidence < DOUBTFUL
    change, fit = _uncovered(trial, usual, name, mask, slid)
    muted_points = mask if change.config else None
    evidence = (
        f"{100 * part.sum() / PARTS[name].sum():.0f} % of the {title} looks like in none of the frames around: its "
        f"colours are {here:.1f} times as far from theirs as usual, {elsewhere:.1f} times elsewhere in the face"
    )
    if doubts:
        evidence += f"; the detector's confidence there is {sure:.2f}, elsewhere {others:.2f}"
    direct = float(np.interp(overlap, [LEAST_OVERLAP, 0.7], [0.5, 0.85]))
    if confidence.mean() < HARDLY_SEEN:
        direct = 0.985
    yield Finding(
        code="occluded",
        title="Something covers a part of the face" if slid else f"Something covers the {title}",
        evidence=evidence + ".",
        change=change,
        gain=trial.gain(fit, doubted=mask),
        before_percent=trial.error_percent(trial.fit, muted_points),
        after_percent=trial.error_percent(fit, muted_points),
        doubted=muted_points,
        direct=direct,
        numbers={
            "covered_share": float(share),
            "overlap": overlap,
            "colour_change": here,
            "colour_change_elsewhere": elsewhere,
            "confidence": sure,
            "confidence_elsewhere": others,
        },
        outranks=("doubted_part", "pose_jump", "group_biased", "jaw_disagrees", "low_flow_consistency"),
    )


def blurred_face(trial: Trial) -> Iterator[Finding]:
    """The face has less detail than in the frames near it, in every direction: out of focus, or moved."""
    look, usual = trial.look, trial.usual_look
    if look is None or usual is None or usual.sharpness <= 0.0:
        return
    sharpness = look.sharpness / usual.sharpness
    if sharpness > SOFT or look.sharpness > SOFTER * usual.least_sharpness:
        return
    yield _of_whole_face(
        trial,
        code="blurred_face",
        title="The face is blurred",
        evidence=f"The face has {100 * sharpness:.0f} % of the detail that it has in the frames around (squared slope "
        f"of the grey levels, at equal size and contrast).",
        direct=float(np.interp(sharpness, [VERY_SOFT, SOFT], [0.9, 0.45])),
        numbers={"sharpness": sharpness},
        outranks=("occluded", "doubted_part", "pose_jump"),
    )


def dark_face(trial: Trial) -> Iterator[Finding]:
    """The face is so dark that it has little contrast."""
    look, usual = trial.look, trial.usual_look
    if look is None:
        return
    usually = look.brightness if usual is None else usual.brightness
    dimmed = look.brightness < DIMMED * usually
    if look.brightness > DARK and not dimmed:
        return
    evidence = f"Its median lightness is {look.brightness:.0f} of 255"
    if usual is not None:
        evidence += f", against {usually:.0f} in the frames around" if dimmed else ", as in the frames around"
    absolute = float(np.interp(look.brightness, [VERY_DARK, DARK], [0.85, 0.4]))
    yield _of_whole_face(
        trial,
        code="dark_face",
        title="The face is dark",
        evidence=evidence + ".",
        direct=max(absolute, 0.7 if dimmed else 0.0),
        numbers={"brightness": look.brightness, "usual_brightness": usually},
        lasts=not dimmed,
        outranks=("occluded", "doubted_part", "pose_jump"),
    )


def turned_away(trial: Trial) -> Iterator[Finding]:
    """The head is turned so far that a part of the face is hidden by itself, where a detector guesses."""
    yaw, pitch, _ = (float(angle) for angle in trial.fit.angles_deg)
    turned = max(abs(yaw), abs(pitch) + TURNED_DEG - 35.0)
    if turned < TURNED_DEG:
        return
    side = "right" if yaw > 0.0 else "left"
    way = f"to the {side} by {abs(yaw):.0f}°" if abs(yaw) >= TURNED_DEG else f"up or down by {abs(pitch):.0f}°"
    yield _of_whole_face(
        trial,
        code="turned_away",
        title="The head is turned far from the camera",
        evidence=f"It is turned {way}: a part of the face hides another, and a detector guesses the points there.",
        direct=float(np.interp(turned, [TURNED_DEG, PROFILE_DEG], [0.45, 0.9])),
        numbers={"yaw_deg": yaw, "pitch_deg": pitch},
        lasts=True,
    )


def unseen_cut(trial: Trial) -> Iterator[Finding]:
    """The picture changes as at a cut, but the clip goes on as one shot."""
    case = trial.case
    if case.picture is None or case.previous_picture is None or case.before is None:
        return
    alike = correlation(thumbnail_of(case.previous_picture), thumbnail_of(case.picture))
    if alike > CUT:
        return
    yield Finding(
        code="unseen_cut",
        title="The picture changes as at a cut",
        evidence=f"It has a correlation of {alike:.2f} with the previous picture, but the clip goes on as one shot: "
        "the pose is held near another scene's. Track the parts before and after on their own (--frames).",
        change=None,
        gain=0.0,
        before_percent=trial.error_percent(trial.fit),
        after_percent=trial.error_percent(trial.fit),
        direct=0.9,
        numbers={"correlation": alike},
        outranks=("tau_fights_data", "low_flow_consistency", "motion_blur", "blurred_face", "dark_face", "jump"),
    )


def jump(trial: Trial) -> Iterator[Finding]:
    """All points are away from the middle of the adjacent frames': the detector jumps, or the head does."""
    before, after = trial.case.before, trial.case.after
    if before is None or after is None:
        return
    away = trial.points - 0.5 * (before.landmarks.points + after.landmarks.points)
    percent = float(trial.percent(np.linalg.norm(away, axis=1).mean()))
    steps = trial.points - before.landmarks.points
    arrived = float(trial.percent(np.linalg.norm(steps, axis=1).mean()))
    # Points that have hardly moved since the previous frame are where the next frame's jump away from.
    if percent < max(JUMP_PERCENT, UNUSUAL_JUMP * trial.reference.jump_percent) or arrived < 0.5 * percent:
        return
    moved, step = _picture_step(trial), np.median(steps, axis=0)
    evidence = f"The points lie {percent:.1f} % of the eye distance from the middle of the adjacent frames'"
    if moved is not None and np.linalg.norm(moved - step) < CONFIRMED * np.linalg.norm(step):
        yield _of_whole_face(
            trial,
            code="sudden_motion",
            title="The head moves abruptly",
            evidence=f"{evidence}, and the picture moves with them: the head itself starts, stops or turns back here.",
            direct=0.55,
            numbers={"jump_percent": percent},
            lasts=True,
        )
        return
    seen = "" if moved is None else f", but the picture has moved by {trial.percent(np.linalg.norm(moved)):.1f} % only"
    yield _of_whole_face(
        trial,
        code="jump",
        title="The points jump",
        evidence=f"{evidence}{seen}.",
        direct=float(np.interp(percent, [JUMP_PERCENT, 3.0 * JUMP_PERCENT], [0.5, 0.85])),
        numbers={"jump_percent": percent},
    )


def pose_jump(trial: Trial) -> Iterator[Finding]:
    """The head turns as no head does between the adjacent frames: here, or only from here to the next frame."""
    before, after, identity = trial.case.before, trial.case.after, trial.case.context.identity
    if before is None or after is None:
        return
    fits = [trial.reference.fit(frame, identity) for frame in (before, trial.case.observation, after)]
    first, now, last = (Rotation.from_rotvec(np.array(fit.rotation)) for fit in fits)
    turns = [(now * first.inv()).as_rotvec(degrees=True), (last * now.inv()).as_rotvec(degrees=True)]
    places = np.array([fit.translation[:2] for fit in fits])
    bend, swerve = float(np.linalg.norm(turns[1] - turns[0])), float(np.linalg.norm(np.diff(places, n=2, axis=0)))
    above = max(bend / JUMP_DEG, swerve / JUMP_MM)
    if above < 1.0:
        return
    arriving, leaving = (float(np.linalg.norm(turn)) for turn in turns)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    next_one = leaving > 1.5 * arriving if bend / JUMP_DEG == above else steps[1] > 1.5 * steps[0]
    yield _of_whole_face(
        trial,
        code="pose_jump",
        title="The pose of the next frame jumps" if next_one else "The pose jumps",
        evidence=f"With each frame fitted on its own, the head turns by {arriving:.0f}° and moves by {steps[0]:.0f} mm "
        f"from the previous frame to this one, and by {leaving:.0f}° and {steps[1]:.0f} mm to the next"
        + (f": look at frame {after.index}." if next_one else "."),
        direct=float(np.interp(above, [1.0, 3.0], [0.31, 0.38])),
        numbers={"arriving_deg": arriving, "leaving_deg": leaving, "arriving_mm": steps[0], "leaving_mm": steps[1]},
        lasts=bool(next_one),
        outranks=(),
    )


def _of_whole_face(
    trial: Trial,
    code: str,
    title: str,
    evidence: str,
    direct: float,
    numbers: dict[str, float],
    lasts: bool = False,
    outranks: tuple[str, ...] = ("doubted_part", "pose_jump"),
) -> Finding:
    """A finding that doubts every point, with those of the adjacent frames as its change if they fit better.

    `lasts`: the adjacent frames are no better, or the points are right.
    """
    change = interpolated(trial, trial.neighbours)
    before = after = trial.error_percent(trial.fit)
    if not lasts:
        after = trial.error_percent(trial.refit(change))
    better = after < before
    return Finding(
        code=code,
        title=title,
        evidence=evidence,
        change=change if better else None,
        gain=0.0,
        before_percent=before,
        after_percent=after if better else before,
        direct=direct,
        numbers=numbers,
        outranks=outranks,
    )


def _uncovered(trial: Trial, usual: UsualLook, name: str, mask: Bool[np.ndarray, "points"], slid: bool):
    """The hidden points from the nearest frame where nothing covers the part, moved along with the rest, and the fit.

    Where the rest has `slid` too, they stay where they were.
    """
    index = trial.case.observation.index
    clear = [k for k, look in usual.looks.items() if not _covers(usual, look, name)]
    nearest = min(clear, key=lambda k: abs(k - index), default=None)
    if nearest is None:
        change = muted(trial, name)
        return change, trial.refit(change)
    source = trial.case.observation_at(nearest).landmarks.points
    places = source if slid else robust_similarity(source, trial.points).to_image(source)
    change = points_change(f"Take the hidden points from frame {nearest}", places, mask)
    return change, trial.refit(change)


def _covers(usual: UsualLook, look: FaceLook, name: str) -> bool:
    return float((usual.surprise(look) > SURPRISING)[PARTS[name]].mean()) > SURE_OVERLAP


def _overlap(surprising: Bool[np.ndarray, "c c"], part: Bool[np.ndarray, "c c"]) -> float:
    return float((surprising & part).sum() / max((surprising | part).sum(), 1))


def _picture_step(trial: Trial) -> Float[np.ndarray, "2"] | None:
    """Median motion of the picture at the landmarks since the previous frame, pixels; None without pictures."""
    return None if trial.picture_steps is None else np.median(trial.picture_steps, axis=0)
