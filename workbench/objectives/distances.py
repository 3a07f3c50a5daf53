"""Lengths, units and means that objectives share; all can be differentiated where nothing moves."""

from jaxtyping import Float

from workbench.arrays import AnyArray, library_of
from workbench.landmarks.scheme import error_unit
from workbench.objectives.records import ObservedClip


def length(vectors: Float[AnyArray, "*n d"]) -> Float[AnyArray, "*n"]:
    """Euclidean length; its derivative is zero at zero, and where a vector is NaN and so has none."""
    library = library_of(vectors)
    unknown = library.isnan(vectors).any(-1)
    known = library.where(unknown[..., None], 0.0, vectors)
    squared = (known * known).sum(-1)
    zero = squared == 0.0
    found = library.where(zero, 0.0, library.sqrt(library.where(zero, 1.0, squared)))
    return library.where(unknown, library.nan, found)


def eye_distance(clip: ObservedClip) -> Float[AnyArray, "n"]:
    """The observed outer-eye distance of each frame, pixels (`error_unit`)."""
    return error_unit(clip.points)


def mean_known(values: Float[AnyArray, "n m"]) -> Float[AnyArray, "n"]:
    """Mean over what is not NaN in each row; NaN for a row without anything."""
    library = library_of(values)
    known = ~library.isnan(values)
    count = known.sum(-1)
    total = library.where(known, values, 0.0).sum(-1)
    return library.where(count > 0, total / library.maximum(count, 1), library.nan)


def since_last(values: Float[AnyArray, "n *d"], order: int = 1) -> Float[AnyArray, "n *d"]:
    """Difference of each frame from the one before, or of the second order; 0 in the first `order` frames."""
    library = library_of(values)
    found = library.diff(values, n=order, axis=0)
    return library.concatenate([library.zeros_like(library.asarray(values)[:order]), found])
