"""Do the landmarks of synchronised clips fit the rig that they are said to come from?

One point seen by two calibrated cameras lies on its epipolar line in the other picture, and two views of it meet in one
place. The inner 51 landmarks are such points to within what a detector means by them; the jaw contour is not: every
camera sees its own silhouette. Landmarks are compared in undistorted pixels and judged in percent of the eye distance.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import jax
import numpy as np
from jaxtyping import Float

from workbench.errors import InputError
from workbench.geometry import (
    PlacedCamera,
    Rig,
    View,
    epipolar_distance,
    reprojection_error,
    resized_view,
    to_view,
    triangulate,
    undistorted_pixels,
)
from workbench.landmarks.files import LandmarkRecord
from workbench.landmarks.scheme import (
    GROUPS,
    LEFT_EYE_OUTER_CORNER,
    POINT_COUNT,
    RIGHT_EYE_OUTER_CORNER,
    error_unit,
    first_68,
)

INNER = np.array(GROUPS["inner"])
NOSE_TIP, MOUTH_CORNERS = 30, (48, 54)
SHAPE = np.searchsorted(INNER, [RIGHT_EYE_OUTER_CORNER, LEFT_EYE_OUTER_CORNER, NOSE_TIP, *MOUTH_CORNERS]).tolist()
"""Places among the inner landmarks of those that tell how a triangulated face is turned and how large it is."""
Points = Float[np.ndarray, "f 68 2"]
Clip = dict[int, np.ndarray]
"""The 68 landmarks of each frame with a face, undistorted pixels."""
MOST_FRAMES = 1500
"""Longer clips are sampled evenly: the medians do not change."""
MOST_OFFSET = 15
"""Frames by which a clip is shifted to see whether it then fits better."""
FEW_FRAMES = 12
"""Below this many frames nothing is said about a time offset."""
DOUBT_PERCENT = 3.0
"""Median epipolar distance, in percent of the eye distance, above which a rig is doubted. On renders of the default
head, 30° apart, the network detector gives 0.4 and dlib 0.6 to 0.9; photos are harder."""
BETTER = 0.8
"""An offset in time is reported if it lowers the median to this part."""
EXPLAINS = 0.5
"""Another explanation is reported if it lowers the median to this part."""
EYE_DISTANCE_MM = (70.0, 115.0)
"""Between the outer corners of adults' eyes; the default head has 88.5."""
IN_FRONT = 0.95


@dataclass(frozen=True)
class PairCheck:
    """Two views of one clip."""

    views: tuple[str, str]
    frames: int
    """Frames in which both have a face."""
    median_px: float
    """Median symmetric epipolar distance over frames and inner landmarks."""
    p95_px: float
    median_percent: float
    """The median in percent of the eye distance in the pictures (`error_unit`)."""
    offset: int | None
    """Frame k of the first fits frame k + offset of the second best; None where nothing can be said."""
    offset_median_px: float
    """The median with that offset; NaN where nothing can be said."""


@dataclass(frozen=True)
class ViewCheck:
    """One view against the points that all views give together."""

    name: str
    frames: int
    """Frames with a face."""
    median_px: float
    """Median distance of the landmarks from the triangulated points' projections."""
    p95_px: float
    others_px: float
    """The same median over the other views when they are triangulated without this one; NaN below three views."""


@dataclass(frozen=True)
class RigCheck:
    """How landmarks fit a rig."""

    pairs: tuple[PairCheck, ...]
    """Those that see the face together in some frame."""
    views: tuple[ViewCheck, ...]
    eye_distance_mm: float
    """Median distance between the triangulated outer eye corners: reveals a wrong unit."""
    warnings: tuple[str, ...]
    """What seems wrong and what would fit better, one plain sentence each."""


def check_rig(rig: Rig, clips: Sequence[Iterable[LandmarkRecord]]) -> RigCheck:
    """Compare the landmarks of each view, frame by frame by number, with what the rig says.

    `clips`: records of each view in the rig's order. Clips that were scaled down evenly are accepted. Raises
    `InputError` for another number of clips, a rig of one view, pictures of another shape than the calibration's, and
    views that never see the face together.
    """
    if len(rig) < 2:
        raise InputError("A check compares views, but the rig has only one; a single camera cannot be checked.")
    if len(clips) != len(rig):
        raise InputError(
            f"The rig has {len(rig)} views ({', '.join(rig.names)}), got {len(clips)} landmark clips; "
            "give one for each view, in this order."
        )
    recorded = [_undistorted_clip(view, clip) for view, clip in zip(rig.views, clips, strict=True)]
    rig, points = Rig(tuple(view for view, _ in recorded)), [found for _, found in recorded]
    together = [(a, b) for a, b in combinations(range(len(rig)), 2) if points[a].keys() & points[b].keys()]
    if not together:
        raise InputError(
            f"No two of the views {', '.join(rig.names)} have a face in the same frame; frames are matched by number."
        )
    pairs = tuple(_pair_check(rig, a, b, points[a], points[b]) for a, b in together)
    stacked = _stacked(points)
    places = triangulate(rig.placed, stacked)
    views = _view_checks(rig, points, stacked, places)
    eye_distance = _quantile(np.linalg.norm(_triples(places)[:, 0], axis=1), 0.5)
    warnings = [*_pair_warnings(pairs), *_explanations(rig, pairs, points), *_view_warnings(views)]
    warnings += _place_warnings(rig, places, eye_distance)
    return RigCheck(pairs, views, eye_distance, tuple(warnings))


def _undistorted_clip(view: View, clip: Iterable[LandmarkRecord]) -> tuple[View, Clip]:
    """The view without its distortion and at the size of the clip's pictures, and the clip's points for it."""
    found = {record.frame: record.landmarks for record in clip if record.landmarks is not None}
    if not found:
        raise InputError(f"The landmarks of view {view.name!r} have no face in any frame; nothing can be compared.")
    sizes = {landmarks.image_size for landmarks in found.values()}
    if len(sizes) > 1:
        raise InputError(f"The pictures of view {view.name!r} have {len(sizes)} sizes; a clip of a rig has one.")
    view = resized_view(view, sizes.pop())
    points = undistorted_pixels(view.camera, np.stack([first_68(landmarks.points) for landmarks in found.values()]))
    straight = replace(view, camera=view.camera._replace(distortion=np.zeros(8)))
    return straight, dict(zip(found, points, strict=True))


# --- pairs ---


def _pair_check(rig: Rig, a: int, b: int, points_a: Clip, points_b: Clip) -> PairCheck:
    names, views = (rig.names[a], rig.names[b]), (rig.placed_view(a), rig.placed_view(b))
    pixels = _together(points_a, points_b, 0)
    distances = _off_lines(views, *pixels)
    median = _quantile(distances, 0.5)
    units = [float(np.median(error_unit(points))) for points in pixels]
    percent = 100.0 * median / (0.5 * sum(units))
    offset, best = _best_offset(views, points_a, points_b)
    return PairCheck(
        names, len(points_a.keys() & points_b.keys()), median, _quantile(distances, 0.95), percent, offset, best
    )


def _best_offset(views: tuple[PlacedCamera, PlacedCamera], points_a: Clip, points_b: Clip) -> tuple[int | None, float]:
    """The shift of the second clip with the lowest median; none (0) unless it is clearly lower."""
    medians = {}
    for shift in range(-MOST_OFFSET, MOST_OFFSET + 1):
        pixels_a, pixels_b = _together(points_a, points_b, shift)
        if len(pixels_a) >= FEW_FRAMES:
            medians[shift] = _quantile(_off_lines(views, pixels_a, pixels_b), 0.5)
    if 0 not in medians:
        return None, float("nan")
    best = min(medians, key=lambda shift: medians[shift])
    best = best if medians[best] < BETTER * medians[0] else 0
    return best, medians[best]


def _together(points_a: Clip, points_b: Clip, shift: int) -> tuple[Points, Points]:
    """The points of frames k of the first clip and k + shift of the second where both have a face."""
    frames = _sampled(k for k in points_a if k + shift in points_b)
    shape = (len(frames), POINT_COUNT, 2)
    return (
        np.array([points_a[k] for k in frames]).reshape(shape),
        np.array([points_b[k + shift] for k in frames]).reshape(shape),
    )


def _off_lines(views: tuple[PlacedCamera, PlacedCamera], a: Points, b: Points) -> Float[np.ndarray, "f 51"]:
    """How far the inner landmarks are from their epipolar lines, pixels."""
    return epipolar_distance(*views, a[:, INNER], b[:, INNER])


# --- all views together ---


def _stacked(points: Sequence[Clip]) -> Float[np.ndarray, "v n 2"]:
    """The frames in which two views have a face, one after the other; NaN where a view has none."""
    counts: dict[int, int] = {}
    for found in points:
        for frame in found:
            counts[frame] = counts.get(frame, 0) + 1
    frames = _sampled(frame for frame, count in counts.items() if count >= 2)
    nothing = np.full((len(INNER), 2), np.nan)
    return np.stack(
        [np.concatenate([found[frame][INNER] if frame in found else nothing for frame in frames]) for found in points]
    )


def _view_checks(rig: Rig, points: Sequence[Clip], stacked: np.ndarray, places: np.ndarray) -> tuple[ViewCheck, ...]:
    errors = reprojection_error(rig.placed, places, stacked)
    made = []
    for index, name in enumerate(rig.names):
        others = float("nan")
        if len(rig) > 2:
            rest = [v for v in range(len(rig)) if v != index]
            views = jax.tree.map(lambda values, rest=rest: values[np.array(rest)], rig.placed)
            others = _quantile(reprojection_error(views, triangulate(views, stacked[rest]), stacked[rest]), 0.5)
        median, p95 = _quantile(errors[index], 0.5), _quantile(errors[index], 0.95)
        made.append(ViewCheck(name, len(points[index]), median, p95, others))
    return tuple(made)


# --- what it means ---


def _pair_warnings(pairs: Sequence[PairCheck]) -> list[str]:
    found = []
    for pair in pairs:
        a, b = pair.views
        if pair.offset:
            found.append(
                f"{a} and {b}: frame 100 of {a} fits frame {100 + pair.offset} of {b} "
                f"({pair.offset_median_px:.2f} instead of {pair.median_px:.2f} px): are the clips synchronised?"
            )
        if _is_doubtful(pair):
            found.append(
                f"{a} and {b}: landmarks lie {pair.median_px:.1f} px ({pair.median_percent:.1f} % of the eye distance) "
                f"off their epipolar lines; up to {DOUBT_PERCENT:g} % is usual."
            )
    return found


def _is_doubtful(pair: PairCheck) -> bool:
    """Whether the landmarks stay off their lines when the clips are shifted as fits best."""
    left = pair.offset_median_px / pair.median_px if pair.offset else 1.0
    return left * pair.median_percent > DOUBT_PERCENT


def _explanations(rig: Rig, pairs: Sequence[PairCheck], points: Sequence[Clip]) -> list[str]:
    """What would bring the landmarks onto their lines and the nose before the eyes: clips in another order, poses
    turned round."""
    median, inside_out = _fit(rig, points)
    found = ["The face comes out inside out, with the nose behind the eyes."] if inside_out else []
    if not inside_out and not any(_is_doubtful(pair) for pair in pairs):
        return []

    def better(candidate: tuple[float, bool]) -> bool:
        return not candidate[1] and candidate[0] < (1.0 if inside_out else EXPLAINS) * median

    for a, b in combinations(range(len(rig)), 2):
        swapped = list(points)
        swapped[a], swapped[b] = points[b], points[a]
        if better(_fit(rig, swapped)):
            found.append(f"The landmarks of {rig.names[a]} and {rig.names[b]} fit better swapped: are they in order?")
    turned = _turned_round(rig)
    if turned is not None and better(_fit(turned, points)):
        found.append('The poses fit better inverted: are they world_from_view (pose = "world_from_view")?')
    return found


def _fit(rig: Rig, points: Sequence[Clip]) -> tuple[float, bool]:
    """Mean of the pairs' median epipolar distances, pixels, and whether the face comes out inside out."""
    medians = []
    for a, b in combinations(range(len(rig)), 2):
        views = rig.placed_view(a), rig.placed_view(b)
        medians.append(_quantile(_off_lines(views, *_together(points[a], points[b], 0)), 0.5))
    across, down, nose = np.moveaxis(_triples(triangulate(rig.placed, _stacked(points))), 1, 0)
    outwards = -np.einsum("ni,ni->n", np.cross(across, down), nose)
    return float(np.nanmean(medians)), _quantile(outwards, 0.5) < 0


def _triples(places: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "f 3 3"]:
    """For each frame: from eye to eye, from the eyes to the mouth's corners, from the eyes to the tip of the nose."""
    face = places.reshape(-1, len(INNER), 3)
    right_eye, left_eye, nose, right_mouth, left_mouth = (face[:, i] for i in SHAPE)
    eyes, mouth = 0.5 * (right_eye + left_eye), 0.5 * (right_mouth + left_mouth)
    return np.stack([left_eye - right_eye, mouth - eyes, nose - eyes], axis=1)


def _turned_round(rig: Rig) -> Rig | None:
    """The rig whose file meant world_from_view by what was read as view_from_world; None where that cannot be."""
    try:
        return Rig(
            tuple(replace(v, rotation_view_world=v.rotation_view_world.T, translation_view_world_mm=v.position_world_mm)
                  for v in rig.views)
        )  # fmt: skip
    except InputError:
        return None


def _view_warnings(views: Sequence[ViewCheck]) -> list[str]:
    """With three views or more, the one without which the others agree."""
    if len(views) < 3 or not np.isfinite([view.others_px for view in views]).all():
        return []
    best, second = sorted(views, key=lambda view: view.others_px)[:2]
    together = float(np.mean([view.median_px for view in views]))
    if best.others_px < EXPLAINS * together and best.others_px < EXPLAINS * second.others_px:
        return [
            f"{best.name} is likely off: without it the others agree to {best.others_px:.2f} px, "
            f"with it to {together:.2f} px."
        ]
    return []


def _place_warnings(rig: Rig, places: Float[np.ndarray, "n 3"], eye_distance: float) -> list[str]:
    found = []
    low, high = EYE_DISTANCE_MM
    if not low <= eye_distance <= high:
        found.append(
            f"The eyes' outer corners come out {eye_distance:.3g} mm apart; adults have {low:g} to {high:g}: "
            "is the rig's unit right?"
        )
    seen = places[np.isfinite(places).all(axis=1)]
    for index, name in enumerate(rig.names):
        in_front = float((to_view(seen, rig.placed_view(index))[:, 2] > 0).mean()) if len(seen) else 1.0
        if in_front < IN_FRONT:
            found.append(f"{100 * (1 - in_front):.0f} % of the points come out behind {name}: is its pose inverted?")
    return found


def _sampled(frames: Iterable[int]) -> list[int]:
    ordered = sorted(frames)
    step = max(1, -(-len(ordered) // MOST_FRAMES))
    return ordered[::step]


def _quantile(values: np.ndarray, level: float) -> float:
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, level)) if finite.size else float("nan")
