"""What expressions usually are: which blendshapes are two sides of one motion, and which act together.

Learned by `workbench train expressions`: the second moment of the weights of many expressions, by blendshape name. It
is about the neutral face, not about the mean expression, so that a face at rest is the likeliest of all.
"""

import json
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from safetensors import safe_open

from workbench.arrays import AnyArray
from workbench.errors import ModelError
from workbench.face.default_head import GAZE_NAMES
from workbench.reading import checked_file, reading

ONE_SIDED = ("jawLeft", "jawRight", "mouthLeft", "mouthRight")
"""Motions of the whole jaw and mouth to one side: they are opposites, and no pairs."""
LEAST_DEVIATION = 0.03
"""Of every weight from what the others say of it: no combination is impossible."""


class UsualExpressions(NamedTuple):
    """Two matrices by which weights are judged."""

    sides: Float[AnyArray, "pairs k"]
    """Each row takes the right side's weight from the left side's."""
    whitening: Float[AnyArray, "known k"]
    """W with WᵀW = S⁻¹, S the second moment of the weights that it knows; 0 for the others."""


class Moments(NamedTuple):
    """What was learned from many expressions."""

    names: tuple[str, ...]
    second: Float[np.ndarray, "k k"]
    """The mean of w wᵀ."""


@cache
def usual_expressions(names: tuple[str, ...]) -> UsualExpressions:
    """The matrices for blendshapes of these names, by the bundled moments.

    Blendshapes that the moments do not know are judged by symmetry alone, where they end in Left and Right. How eyes
    turn is left to the gaze's own terms.
    """
    moments = bundled_moments()
    known = [name for name in names if name in moments.names and name not in GAZE_NAMES]
    rows = [moments.names.index(name) for name in known]
    second = moments.second[np.ix_(rows, rows)] + LEAST_DEVIATION**2 * np.eye(len(rows))
    whitening = np.zeros((len(known), len(names)))
    whitening[:, [names.index(name) for name in known]] = np.linalg.inv(np.linalg.cholesky(second))
    usual = UsualExpressions(_sides(names), whitening)
    for matrix in usual:
        matrix.setflags(write=False)
    return usual


def other_side(name: str) -> str:
    """The name of the same blendshape on the other side of the face."""
    return name.replace("Left", "Right") if "Left" in name else name.replace("Right", "Left")


def _sides(names: tuple[str, ...]) -> Float[np.ndarray, "pairs k"]:
    pairs = [
        (names.index(name), names.index(other_side(name)))
        for name in names
        if name.endswith("Left") and other_side(name) in names and name not in (*ONE_SIDED, *GAZE_NAMES)
    ]
    sides = np.zeros((len(pairs), len(names)))
    for row, (left, right) in enumerate(pairs):
        sides[row, left], sides[row, right] = 1.0, -1.0
    return sides


@cache
def bundled_moments() -> Moments:
    """The moments that come with the package."""
    return read_moments(Path(__file__).with_suffix(".safetensors"))


def read_moments(path: Path) -> Moments:
    """A file of `write_moments`. Raises `ModelError` for one that is damaged, or that holds something else."""
    path = checked_file(path, "moments of expressions", ModelError)
    with (
        reading(path, "moments of expressions", "learn them again (workbench train expressions)", ModelError),
        safe_open(path, framework="np") as stored,
    ):
        listed = (stored.metadata() or {}).get("names")
        second = stored.get_tensor("second").astype(float) if "second" in stored.keys() else np.zeros((0, 0))  # noqa: SIM118
        names = tuple(json.loads(listed)) if listed else ()
    if not names or second.shape != (len(names), len(names)):
        raise ModelError(
            f"{path} should hold a matrix 'second' with a row and a column for each of its names, got shape "
            f"{second.shape} and {len(names)} names; learn it again (workbench train expressions)."
        )
    return Moments(names, second)


def write_moments(path: Path, moments: Moments, notes: dict[str, str]) -> None:
    """Write moments in single precision, with `notes` on where they come from."""
    from workbench.networks.weights import write_weights  # here: faces do without networks

    write_weights(path, {"second": moments.second.astype(np.float32)}, {**notes, "names": json.dumps(moments.names)})
