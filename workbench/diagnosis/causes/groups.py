"""Landmark groups inconsistent with the others: the jaw, a shifted or occluded group, points outside the picture."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from workbench.diagnosis.flags import FEWEST_OUTSIDE, outside_picture
from workbench.diagnosis.group_pull import between_poses
from workbench.diagnosis.innovation import offset_nats
from workbench.diagnosis.picture_evidence import change_of_patch
from workbench.diagnosis.records import Change
from workbench.diagnosis.trial import Finding, Trial, points_change
from workbench.landmarks.scheme import GROUPS, POINT_COUNT
from workbench.tracking import FrameFit

TRIED = ("jaw", "right_brow", "left_brow", "nose", "right_eye", "left_eye", "mouth")
"""Groups that may be shifted or hidden."""
SIDES = {
    "right_side": (*range(0, 8), *GROUPS["right_brow"], *GROUPS["right_eye"], 31, 32, 48, 49, 50, 58, 59, 60, 67),
    "left_side": (*range(9, 17), *GROUPS["left_brow"], *GROUPS["left_eye"], 34, 35, 52, 53, 54, 55, 56, 64, 65),
    "upper_face": (*GROUPS["brows"], *GROUPS["eyes"]),
    "chin": range(5, 12),
    "lower_face": (*range(4, 13), *GROUPS["mouth"]),
}
"""Larger parts of the face that an object may occlude."""
LEAST_OFFSET_PERCENT = 2.0
HARDLY_SEEN, SURELY_SEEN = 0.3, 0.6
"""Mean confidence below which the whole face is doubted, and above which another frame may replace it."""
LEAST_EXCESS = 6.0
"""Minimum nats above the usual for trying parts of the face."""
MOST_MUTED = 2 / 3
"""Share of the 68 points up to which those outside the picture may be muted: the others carry the fit alone."""
COHERENT = 1.0
"""Minimum ratio of the mean offset to the scatter around it for an offset of the whole group."""


def jaw_disagrees(trial: Trial) -> Iterator[Finding]:
    """The jaw contour implies another pose than the other points (Deep Energies Sec. 8.2, Fig. 7)."""
    mask = trial.scheme.group_mask("jaw")
    change = Change(
        "Give the jaw points a tenth of their weight in all frames",
        config={"landmarks": {"weights": {"jaw": 0.1}}},
    )
    fit = trial.refit(change)
    shift = _best_shift(trial, "jaw")
    if shift is None:
        return
    gain = max(trial.gain(fit, doubted=mask) + shift.nats, shift.gain)
    distance = float(trial.percent(np.linalg.norm(trial.points - fit.projected, axis=1)[mask].mean()))
    if gain <= 0.0 or distance < LEAST_OFFSET_PERCENT:
        return
    jaw_only = trial.refit(
        Change("", config={"landmarks": {"weights": trial.lessened("non_jaw", 0.1)}, "stages": _all_points(trial)})
    )
    degrees, millimetres = between_poses(fit, jaw_only)
    before, after = trial.error_percent(trial.fit, mask), trial.error_percent(fit, mask)
    yield Finding(
        code="jaw_disagrees",
        title="The jaw points disagree with the rest of the face",
        evidence=f"The jaw points lie {distance:.1f} % of the eye distance from where the others predict them (mean "
        f"offset {_vector(trial, shift.vector)}); the jaw alone implies a pose {degrees:.0f}° and "
        f"{millimetres:.0f} mm away.",
        change=change,
        gain=gain,
        before_percent=before,
        after_percent=after,
        doubted=mask,
        specificity=0.95,
        numbers={
            "distance_percent": distance,
            "offset_right_percent": float(trial.percent(shift.vector[0])),
            "offset_down_percent": float(trial.percent(shift.vector[1])),
            "scatter_percent": float(trial.percent(shift.scatter)),
            "pose_deg": degrees,
            "pose_mm": millimetres,
        },
        outranks=("occluded",),
    )


def group_biased(trial: Trial) -> Iterator[Finding]:
    """All points of a group have the same offset."""
    for group in TRIED[1:]:
        shift = _best_shift(trial, group)
        if shift is None or shift.gain <= 0.0 or not _long(trial, shift.vector):
            continue
        before, after, title = trial.error_percent(trial.fit), trial.error_percent(shift.fit), title_of(group)
        yield Finding(
            code="group_biased",
            title=f"The points of the {title} are shifted",
            evidence=f"All points of the {title} lie {_vector(trial, shift.vector)} from where the other points and "
            f"their own motion predict them, with a scatter of only {trial.percent(shift.scatter):.1f} %.",
            change=shift.change,
            gain=shift.gain,
            before_percent=before,
            after_percent=after,
            specificity=0.9,
            numbers={
                "offset_right_percent": float(trial.percent(shift.vector[0])),
                "offset_down_percent": float(trial.percent(shift.vector[1])),
                "offset_percent": float(trial.percent(np.linalg.norm(shift.vector))),
                "scatter_percent": float(trial.percent(shift.scatter)),
                "first_point": float(GROUPS[group][0]),
            },
        )


class _Shift(NamedTuple):
    """A hypothesis: a group is moved back by one vector."""

    vector: Float[np.ndarray, "2"]
    scatter: float
    """Root mean square distance of the group's points from the predicted shape after removing their offset, pixels."""
    change: Change
    fit: FrameFit
    gain: float
    nats: float
    """Part of the gain that the fit does not show: an unusual offset from the others, or a jump."""


def _best_shift(trial: Trial, group: str) -> _Shift | None:
    """The best of several estimates of a group's shift: from a fit without it, from motion, from a jump.

    None if even the best estimate cannot explain enough.
    """
    mask = trial.scheme.group_mask(group)
    without = trial.refit(muted(trial, group))
    offset, scatter = _offset(trial, without, mask)
    mean = (trial.points - without.projected)[mask].mean(axis=0)
    usual = trial.usual_offsets[group]
    vectors = [offset, *_motion_offset(trial, mask)]
    jump = trial.jump(group)
    if jump is not None:
        vectors.append(jump[0])
    most = trial.excess + offset_nats(trial.percent(mean), usual) + (0.0 if jump is None else jump[1])
    if most < LEAST_EXCESS:
        return None
    # An offset of scattered points is not an offset of the group.
    coherent = float(np.clip(np.linalg.norm(mean) / max(scatter, 1e-9) - 1.0, 0.0, 1.0))
    tried = []
    for vector in vectors:
        change, fit = _shifted_back(trial, mask, vector, title_of(group))
        nats = offset_nats(trial.percent(mean), usual) - offset_nats(trial.percent(mean - vector), usual)
        if jump is not None and np.linalg.norm(vector - jump[0]) < 0.5 * np.linalg.norm(jump[0]):
            nats += jump[1]
        nats = coherent * max(nats, 0.0)
        tried.append(_Shift(vector, scatter, change, fit, trial.gain(fit, 2.0, past_doubted=True) + nats, nats))
    return max(tried, key=lambda shift: shift.gain)


def occluded(trial: Trial) -> Iterator[Finding]:
    """The points of a part of the face scatter randomly, or have low detector confidence."""
    confidence = trial.case.observation.landmarks.confidence
    if confidence.mean() < HARDLY_SEEN:
        yield from _hardly_seen(trial)
        return
    if trial.excess < LEAST_EXCESS and confidence.min() > 0.5 * confidence.max():
        return
    for name in (*TRIED, *SIDES):
        mask, change = mask_of(trial, name), muted(trial, name)
        fit = trial.refit(change)
        gain = trial.gain(fit, doubted=mask)
        offset, scatter = _offset(trial, fit, mask)
        sure, others = float(confidence[mask].mean()), float(confidence[~mask].mean())
        unsure = sure < 0.5 * others
        if (gain <= 0.0 and not unsure) or trial.percent(scatter) < LEAST_OFFSET_PERCENT:
            continue
        title = title_of(name)
        picture = _picture_changed(trial, mask)
        before, after = trial.error_percent(trial.fit, mask), trial.error_percent(fit, mask)
        evidence = f"The {mask.sum()} points of the {title} scatter by {trial.percent(scatter):.1f} % of the eye "
        evidence += "distance around their predictions from the others, without a common direction"
        evidence += f"; the detector's confidence there is {sure:.2f} against {others:.2f}" if unsure else ""
        evidence += f"; the picture there changed {picture:.1f} times as much as elsewhere" if picture > 1.5 else ""
        incoherent = 1.0 if np.linalg.norm(offset) < COHERENT * scatter else 0.6
        yield Finding(
            code="occluded",
            title=f"The {title} seems to be hidden",
            evidence=evidence + ".",
            change=change,
            gain=gain,
            before_percent=before,
            after_percent=after,
            doubted=mask,
            specificity=min(
                1.0, incoherent * (0.9 + 0.05 * unsure + 0.05 * (picture > 1.5)) * _purity(trial, fit, mask)
            ),
            numbers={
                "scatter_percent": float(trial.percent(scatter)),
                "confidence": sure,
                "confidence_elsewhere": others,
                "picture_change": picture,
                "points": float(mask.sum()),
            },
            outranks=("group_biased",) if incoherent == 1.0 else (),
        )


def _hardly_seen(trial: Trial) -> Iterator[Finding]:
    """The detector's confidence is low for all points: they hardly count and E_τ alone carries the pose, or they count
    without deserving it."""
    sure = float(trial.case.observation.landmarks.confidence.mean())
    index = trial.case.observation.index
    others = [
        frame
        for frame in trial.case.shot
        if frame.landmarks is not None and frame.landmarks.confidence.mean() >= SURELY_SEEN
    ]
    nearest = min(others, key=lambda frame: abs(frame.index - index), default=None)
    change, fit = None, trial.fit
    if nearest is not None:
        label = f"Use the points of frame {nearest.index}, where the detector was confident"
        change = points_change(label, nearest.landmarks.points, trial.scheme.group_mask("all"))
        fit = trial.refit(change, trial.case.context._replace(last=None))
    yield Finding(
        code="occluded",
        title="The face is hardly visible",
        evidence=f"The detector's mean confidence is {sure:.2f}"
        + (
            ": its points hardly count, and only previous frames constrain the fit"
            if trial.case.config.landmarks.confidence
            else ", yet its points count as if it were sure: landmarks.confidence is off"
        )
        + (f"; the nearest frame where it is high is {nearest.index}." if nearest is not None else "."),
        change=change,
        gain=0.0,
        before_percent=trial.error_percent(trial.fit),
        after_percent=trial.error_percent(fit),
        direct=0.98,
        numbers={"confidence": sure, "nearest_sure": -1.0 if nearest is None else float(nearest.index)},
        outranks=("wrong_focal", "wrong_identity", "tau_fights_data", "low_flow_consistency", "motion_blur"),
    )


def face_outside(trial: Trial) -> Iterator[Finding]:
    """Points lie beyond the picture's edge, where a detector can only guess."""
    mask = outside_picture(trial.points, trial.case.observation.image_size)
    count = int(mask[:POINT_COUNT].sum())
    if count < FEWEST_OUTSIDE:
        return
    weights = {str(index): 0.0 for index in np.flatnonzero(mask)}
    change = Change("Mute these points in all frames", config={"landmarks": {"weights": weights}})
    fit, before = trial.fit, trial.error_percent(trial.fit, mask)
    enough = count <= MOST_MUTED * POINT_COUNT
    if enough:
        fit = trial.refit(change)
    after = trial.error_percent(fit, mask)
    better = enough and after < before
    evidence = f"{count} of the 68 points lie on or beyond the edge of the picture, where a detector can only guess"
    if better:
        evidence += "; without them the error of the others goes from {before} to {after} % of the eye distance"
    yield Finding(
        code="face_outside",
        title="The face leaves the picture",
        evidence=evidence + ".",
        change=change if better else None,
        gain=trial.gain(fit, doubted=mask),
        before_percent=before,
        after_percent=after if better else before,
        doubted=mask,
        direct=min(0.95, 0.5 + 0.05 * count),
        numbers={"points": float(count)},
        outranks=("occluded", "group_biased", "jaw_disagrees"),
    )


def muted(trial: Trial, name: str) -> Change:
    """The change that mutes a group, or one of `SIDES` point by point, in all frames."""
    named = name in trial.scheme.groups
    weights = {name: 0.0} if named else {str(point): 0.0 for point in np.flatnonzero(mask_of(trial, name))}
    label = f"Mute the points of the {title_of(name)} in all frames"
    return Change(label, config={"landmarks": {"weights": weights}})


def title_of(name: str) -> str:
    """A group, or one of `SIDES`, in words."""
    return name.replace("_", " ")


def mask_of(trial: Trial, name: str) -> Bool[np.ndarray, "points"]:
    """True for the points of a group, or of one of `SIDES` and those beyond the 68 that are nearest to one of them."""
    if name in trial.scheme.groups:
        return trial.scheme.group_mask(name)
    return np.isin(trial.nearest(range(POINT_COUNT)), SIDES[name])


def _all_points(trial: Trial) -> list[dict]:
    """The stages with all landmarks in each, so that the jaw affects the pose in a fit to the jaw."""
    return [{**stage.model_dump(), "landmarks": {"all": 1.0}} for stage in trial.case.config.stages]


def _offset(trial: Trial, fit: FrameFit, mask: Bool[np.ndarray, "points"]) -> tuple[Float[np.ndarray, "2"], float]:
    """Median offset of the masked points from a fit, and their root mean square scatter around it, pixels."""
    error = trial.points[mask] - fit.projected[mask]
    offset = np.median(error, axis=0)
    return offset, float(np.sqrt(((error - offset) ** 2).sum(1).mean()))


def _motion_offset(trial: Trial, mask: Bool[np.ndarray, "points"]) -> Iterator[Float[np.ndarray, "2"]]:
    """The group's deviation from the motion of the picture, or of neighbouring frames, relative to the other points."""
    places = [] if trial.carried is None else [trial.carried]
    if trial.case.before is not None and trial.case.after is not None:
        places.append(trial.middle(trial.points))
    for place in places:
        away = trial.points - place
        known = np.isfinite(away[:, 0])
        if (known & mask).sum() >= 3 and (known & ~mask).sum() >= 10:
            yield np.median(away[known & mask], axis=0) - np.median(away[known & ~mask], axis=0)


def _long(trial: Trial, vector: Float[np.ndarray, "2"]) -> bool:
    return bool(trial.percent(np.linalg.norm(vector)) >= LEAST_OFFSET_PERCENT)


def _shifted_back(trial: Trial, mask: Bool[np.ndarray, "points"], offset: Float[np.ndarray, "2"], title: str):
    points = trial.points - np.where(mask[:, None], offset, 0.0)
    change = points_change(f"Move the points of the {title} back", points, mask)
    return change, trial.refit(change)


def _purity(trial: Trial, fit: FrameFit, mask: Bool[np.ndarray, "points"]) -> float:
    """Fraction of the doubted points that are far off: occlusion hides a whole part of the face, not single points."""
    far = trial.percent(fit.residuals_px) / trial.reference.residual_percent > 2.0
    return 0.3 + 0.7 * float(far[mask].mean())


def _picture_changed(trial: Trial, mask: Bool[np.ndarray, "points"]) -> float:
    """Grey-level change under the group since the previous picture, relative to the other groups; 0 if unknown."""
    case = trial.case
    if case.picture is None or case.previous_picture is None or case.before is None:
        return 0.0
    before = case.before.landmarks.points
    others, others_before = trial.points[~mask], before[~mask]
    here, elsewhere = (
        change_of_patch(case.previous_picture, case.picture, before, chosen, others, others_before)
        for chosen in (mask, ~mask)
    )
    return here / max(elsewhere, 1.0)


def _vector(trial: Trial, vector: Float[np.ndarray, "2"]) -> str:
    right, down = trial.percent(vector)
    return (
        f"{abs(right):.1f} % {'right' if right >= 0 else 'left'} and {abs(down):.1f} % {'down' if down >= 0 else 'up'}"
    )
