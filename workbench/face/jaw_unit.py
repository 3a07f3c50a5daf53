"""The unit of the jaw joint: what the jaw blendshapes of a face model at weight 1 move it by."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

JAW_SHAPES = ("jawOpen", "jawForward", "jawLeft", "jawRight")
"""Blendshapes that the joint replaces."""
JAW_RANGE = np.array([[-0.05, -0.25, -0.15, -12.0, -6.0, -12.0], [0.70, 0.25, 0.15, 12.0, 12.0, 12.0]])
"""Least and most that the joint moves in a model with `USUAL_JAW`: radians about x (opening), y and z, then
millimetres."""
LEAST_SHARE = 0.1
"""A blendshape that moves the joint by less than this share of the usual does not tell its unit."""
WIDEST_DEG = 90.0
"""Nor does one that opens it wider."""


@dataclass(frozen=True)
class JawUnit:
    """The motion of the jaw joint that counts as 1 in every term, as a jaw blendshape at weight 1 does."""

    open_deg: float
    """Angle about +x (head frame) at which the joint is `jawOpen`."""
    sideways_mm: float
    """Shift that is `jawLeft` or `jawRight`."""
    forward_mm: float
    """Shift that is `jawForward`."""

    @property
    def vector(self) -> Float[np.ndarray, "6"]:
        """For each number of the joint: radians, then millimetres.

        Turns about y and z count as those about x do, shifts up and down as the mean of the other two.
        """
        between_mm = 0.5 * (self.sideways_mm + self.forward_mm)
        return np.array([*[np.radians(self.open_deg)] * 3, self.sideways_mm, between_mm, self.forward_mm])

    @property
    def relative(self) -> Float[np.ndarray, "6"]:
        """The same as a fraction of `USUAL_JAW`."""
        return self.vector / USUAL_JAW.vector

    def scaled(self, size: float) -> "JawUnit":
        """The unit of a head that is `size` times as large and otherwise the same: angles do not depend on size."""
        return JawUnit(self.open_deg, size * self.sideways_mm, size * self.forward_mm)


USUAL_JAW = JawUnit(26.5, 8.0, 8.0)
"""The default head's, which its file holds; in proportion to the size, that of models whose shapes do not tell it."""


def fitted_jaw_unit(
    arms: Float[np.ndarray, "n 3"],
    weights: Float[np.ndarray, "n"],
    shapes: Mapping[str, Float[np.ndarray, "n 3"]],
    usual: JawUnit,
) -> JawUnit:
    """The unit with which the joint moves some points most nearly as the jaw blendshapes do (least squares).

    The points hang on the joint by `weights` w, `arms` are w times their offsets from its pivot, and `shapes` their
    offsets under `JAW_SHAPES`; head frame, millimetres. `usual` replaces what no shape determines.
    """
    sideways = [
        sign * _shift(weights, shapes[name][:, 0])
        for name, sign in (("jawLeft", 1.0), ("jawRight", -1.0))
        if name in shapes
    ]
    forward = [-_shift(weights, shapes["jawForward"][:, 2])] if "jawForward" in shapes else []
    opened = [_opening_deg(arms, shapes["jawOpen"])] if "jawOpen" in shapes else []
    return JawUnit(
        _told(opened, usual.open_deg, WIDEST_DEG),
        _told(sideways, usual.sideways_mm),
        _told(forward, usual.forward_mm),
    )


def _opening_deg(arms: np.ndarray, offsets: np.ndarray) -> float:
    """The angle a about +x with the least Σ‖(R(a) − 1)·arm − offset‖².

    The sum is a constant minus 2·(c·cos a + s·sin a), so that tan a = s/c.
    """
    y, z = arms[:, 1], arms[:, 2]
    along = y @ (y + offsets[:, 1]) + z @ (z + offsets[:, 2])
    across = y @ offsets[:, 2] - z @ offsets[:, 1]
    return float(np.degrees(np.arctan2(across, along)))


def _shift(weights: np.ndarray, offsets: np.ndarray) -> float:
    """The shift t with the least Σ(w·t − offset)²; 0 where nothing hangs on the joint."""
    return float(weights @ offsets / max(weights @ weights, 1e-12))


def _told(found: list[float], usual: float, most: float = np.inf) -> float:
    """The mean of what was found where it is a motion, else the usual."""
    mean = sum(found) / len(found) if found else 0.0
    return mean if LEAST_SHARE * usual <= mean <= most else usual
