"""Objectives for clips of which something is known: pose, weights, mesh, labelled points."""

from jaxtyping import Float

from workbench.arrays import AnyArray, library_of
from workbench.objectives.distances import eye_distance, length, mean_known
from workbench.objectives.records import FittedClip, ObservedClip


def rotation_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Angle between the head's rotation and the true one, degrees."""
    library = library_of(fits.rotation)
    unknown = library.isnan(clip.truth.rotation).any(-1)
    scalar, vector = _quaternion(fits.rotation)
    true_scalar, true_vector = _quaternion(library.where(unknown[:, None], 0.0, clip.truth.rotation))
    # q* · p: its vector part is the sine and its scalar part the cosine of half the angle between both.
    along = scalar * true_scalar + (vector * true_vector).sum(-1)
    cross = library.cross(vector, library.asarray(true_vector))
    across = scalar[:, None] * true_vector - true_scalar[:, None] * vector - cross
    angle = library.degrees(2.0 * library.arctan2(length(across), library.abs(along)))
    return library.where(unknown, library.nan, angle)


def position_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Distance of the head from its true place, millimetres."""
    return length(fits.translation - clip.truth.translation)


def weight_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean distance of the blendshape weights from the true ones."""
    library = library_of(fits.expression)
    return library.abs(fits.expression - clip.truth.expression).mean(-1)


def surface_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean distance of the mesh from the true one with their centres on each other, millimetres."""
    fitted, true = (each - each.mean(1, keepdims=True) for each in (fits.surface, clip.truth.surface))
    return length(fitted - true).mean(-1)


def label_error(clip: ObservedClip, fits: FittedClip) -> Float[AnyArray, "n"]:
    """Mean distance of the model's landmarks from the labelled ones, % of the outer-eye distance."""
    labels = clip.truth.labels
    return mean_known(100.0 * length(fits.projected - labels) / eye_distance(clip)[:, None])


def _quaternion(axis_angle: Float[AnyArray, "n 3"]):
    library = library_of(axis_angle)
    angle = length(axis_angle)
    # sinc(x) is sin(πx)/(πx): no division by an angle of zero.
    return library.cos(0.5 * angle), 0.5 * library.sinc(0.5 * angle / library.pi)[:, None] * axis_angle
