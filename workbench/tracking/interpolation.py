"""Interpolation and averaging of parameters over frames, without the pictures: linear, splines, means.

Rotations use SciPy: slerp, rotation splines, and the mean of Markley et al. ("Averaging quaternions", 2007).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from workbench.errors import InputError
from workbench.face import FaceParameters

SPLINE_FRAMES = 4
"""Number of known frames on each side that a spline passes through."""
PARTS = ("translation", "expression", "jaw", "scale")
"""What is interpolated and averaged number by number. The scale stands for the distance in parallel projection."""


def between(before: FaceParameters, after: FaceParameters, share: float | int) -> FaceParameters:
    """Interpolation by a fraction `share`: t, w, jaw and scale linear, θ spherical (Deep Energies Appendix A)."""
    turned = Slerp([0.0, 1.0], _rotations([before, after]))(float(share))
    mixed = {
        name: (1.0 - share) * np.asarray(getattr(before, name)) + share * np.asarray(getattr(after, name))
        for name in PARTS
    }
    return before._replace(rotation=turned.as_rotvec(), **mixed)


def splined(
    times: Sequence[float | int], known: Sequence[FaceParameters], wanted: Sequence[float | int]
) -> list[FaceParameters]:
    """Parameters at the wanted times between known frames: θ and t by cubic splines, the rest by monotone splines.

    Monotone splines stay within the range of the known frames. With two known frames everything is linear. Raises
    `InputError` for fewer than two.
    """
    if len(known) < 2:
        raise InputError(f"A spline needs at least two known frames, got {len(known)}.")
    if len(known) == 2:
        span = times[1] - times[0]
        return [between(known[0], known[1], (time - times[0]) / span) for time in wanted]
    turned = RotationSpline(times, _rotations(known))(wanted).as_rotvec()
    stacked = {name: np.stack([np.asarray(getattr(item, name), float) for item in known]) for name in PARTS}
    found = {
        name: (CubicSpline if name == "translation" else PchipInterpolator)(times, values)(wanted)
        for name, values in stacked.items()
    }
    return [
        known[0]._replace(rotation=turned[k], **{name: values[k] for name, values in found.items()})
        for k in range(len(wanted))
    ]


def averaged(frames: Sequence[FaceParameters], weights: Sequence[float]) -> FaceParameters:
    """Weighted mean; for rotations the one whose matrix is closest to all (Deep Energies Appendix B)."""
    weights = np.asarray(weights, float)
    mixed = {
        name: np.tensordot(weights / weights.sum(), np.stack([np.asarray(getattr(f, name)) for f in frames]), axes=1)
        for name in PARTS
    }
    middle = frames[len(frames) // 2]
    return middle._replace(rotation=_rotations(frames).mean(weights).as_rotvec(), **mixed)


def _rotations(frames: Sequence[FaceParameters]) -> Rotation:
    vectors: Float[np.ndarray, "n 3"] = np.stack([np.asarray(frame.rotation, float) for frame in frames])
    return Rotation.from_rotvec(vectors)
