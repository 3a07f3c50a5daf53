"""Objectives that need no truth: what was hidden from the fit, steadiness, the pictures' motion, another camera."""

from jaxtyping import Bool, Float

from workbench.arrays import AnyArray, library_of
from workbench.geometry import project
from workbench.landmarks.scheme import error_unit
from workbench.objectives.distances import eye_distance, length, mean_known, since_last
from workbench.objectives.folds import FOLDS, frame_folds
from workbench.objectives.records import FittedClip, ObservedClip


def landmark_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean distance of the model's landmarks from the detected ones, % of the outer-eye distance; all count alike,
    whatever the configuration makes of them."""
    return 100.0 * length(fits.projected - clip.points).mean(-1) / eye_distance(clip)


def left_out_points_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean distance from the detected landmarks that the fit had not seen, % of the outer-eye distance."""
    return _left_out_error("points", clip, fits)


def left_out_parts_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """The same where a fit has not seen anything of the face part that a landmark belongs to."""
    return _left_out_error("parts", clip, fits)


def left_out_frames_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean distance of a hidden frame's landmarks from the middle of its neighbours', % of the outer-eye distance.

    The middle is that of the model's landmarks in the picture. NaN without a neighbour on both sides.
    """
    hidden, found = frame_folds(len(clip.points))[:, :, 0], fits.folds["frames"]
    library = library_of(found)
    middle = 0.5 * (library.roll(found, 1, axis=1) + library.roll(found, -1, axis=1))
    predicted = library.where(hidden[:, :, None, None], middle, 0.0).sum(0)
    errors = 100.0 * length(predicted - clip.points).mean(-1) / eye_distance(clip)
    between = library.asarray(clip.follows) & library.append(clip.follows[1:], False)
    return library.where(between, errors, library.nan)


def jitter(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean second difference of the model's landmarks in the picture, % of the outer-eye distance.

    NaN without two frames before.
    """
    library = library_of(fits.projected)
    errors = 100.0 * length(since_last(fits.projected, 2)).mean(-1) / eye_distance(clip)
    return library.where(_two_before(clip), errors, library.nan)


def flow_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean distance between the motion of the model's landmarks and that of the picture there, % of the outer-eye
    distance. NaN where the picture's motion is not known."""
    library = library_of(fits.projected)
    errors = length(since_last(fits.projected) - clip.flow) / eye_distance(clip)[:, None]
    return library.where(library.asarray(clip.follows), 100.0 * mean_known(errors), library.nan)


def second_view_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean distance of the 51 inner landmarks from those that another camera sees, % of their outer-eye distance."""
    placed, points = clip.second
    there = fits.inner_camera @ placed.rotation_view_reference.T + placed.translation_view_reference_mm
    seen = library_of(fits.inner_camera).asarray(project(placed.camera, there))
    return 100.0 * mean_known(length(seen - points[:, 17:])) / error_unit(points)


def solver_steps(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Iterations of all stages."""
    return fits.iterations


def _left_out_error(kind: str, clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    hidden, found = FOLDS[kind](len(clip.points)), fits.folds[kind]
    library = library_of(found)
    errors = length(found - clip.points) / eye_distance(clip)[:, None]
    # Each landmark is hidden in one fold.
    return 100.0 * library.where(hidden, errors, 0.0).sum(0).mean(-1)


def _two_before(clip: ObservedClip) -> Bool[AnyArray, "n"]:
    library = library_of(clip.follows)
    follows = library.asarray(clip.follows)
    before = library.concatenate([library.zeros(1, bool), follows[:-1]])
    return follows & before
