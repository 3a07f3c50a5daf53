"""The table of objectives: every measure of a clip's fits, one row each.

An objective is a function in a file of this package, and a row here. From the row follow its name on the command line,
its column in tables, its axis in figures and its line in the documentation.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import Literal

from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.errors import ConfigError, InputError
from workbench.objectives.records import FittedClip, ObservedClip

Need = Literal["rotation", "translation", "expression", "surface", "labels", "flow", "second"]
NEEDED = {
    "rotation": "the true rotation of the head (--truth)",
    "translation": "the true place of the head (--truth)",
    "expression": "the true blendshape weights (--truth)",
    "surface": "the true pose, weights and identity (--truth)",
    "labels": "labelled landmarks (--truth)",
    "flow": "the clip's pictures",
    "second": "the clip of a second camera and the rig of both (--view, --rig)",
}
"""What each need is, for the error if it is missing."""


@dataclass(frozen=True)
class Objective:
    """One measure; less is better for all of them."""

    name: str
    says: str
    """What it measures, in plain words; no full stop."""
    blind: str
    """What it cannot see: how a fit can be bad and this good; no full stop."""
    unit: str
    """Empty for pure numbers."""
    function: str
    """Module and function of this package, from an `ObservedClip` and a `FittedClip` to one number per frame."""
    needs: Need | None = None
    folds: str = ""
    """The kind of folds (`FOLDS`) whose fits it looks at; empty: only the fits that see everything."""
    digits: int = 3

    @property
    def label(self) -> str:
        """Its axis in figures."""
        return f"{self.name}, {self.unit}" if self.unit else self.name


ROWS = (
    Objective(
        name="error",
        says="distance of the model's landmarks from the detected ones",
        blind="whether the detections are right: more freedom always lowers it, down to fitting their noise",
        unit="% of the eye distance",
        function="without_truth:landmark_error",
    ),
    Objective(
        name="left-out-points",
        says="distance from every fifth detected landmark, predicted by fits that saw the others only",
        blind="errors that a hidden point shares with its neighbours, such as a whole contour that sits too far out, "
        "and jitter of all points together",
        unit="% of the eye distance",
        function="without_truth:left_out_points_error",
        folds="points",
    ),
    Objective(
        name="left-out-parts",
        says="distance from the detected landmarks of each part of the face (jaw, brows, nose, eyes, mouth), predicted "
        "by fits that saw the other parts only",
        blind="what a part does by itself, such as a mouth or lids that open: no fit can foresee it, and a stiff one "
        "loses nothing",
        unit="% of the eye distance",
        function="without_truth:left_out_parts_error",
        folds="parts",
    ),
    Objective(
        name="left-out-frames",
        says="distance from a hidden frame's landmarks, predicted as the middle of its neighbours' fits",
        blind="errors that stay the same from frame to frame; fast motion such as a blink counts as error, for the "
        "middle of two frames cannot have it",
        unit="% of the eye distance",
        function="without_truth:left_out_frames_error",
        folds="frames",
    ),
    Objective(
        name="jitter",
        says="second difference of the model's landmarks in the picture, from frame to frame",
        blind="everything but steadiness: a head that never moves is perfect, so compare it at equal error",
        unit="% of the eye distance",
        function="without_truth:jitter",
    ),
    Objective(
        name="flow",
        says="distance between the motion of the model's landmarks and the motion of the picture there",
        blind="where the head is: a fit that is off by the same amount in all frames moves correctly; also depth, and "
        "what moves without texture",
        unit="% of the eye distance",
        function="without_truth:flow_error",
        needs="flow",
    ),
    Objective(
        name="second-view",
        says="distance of the model's landmarks, fitted to one camera, from those that another camera sees",
        blind="errors that the detector makes in both pictures alike, and errors along the line between the cameras",
        unit="% of the eye distance",
        function="without_truth:second_view_error",
        needs="second",
    ),
    Objective(
        name="rotation",
        says="angle between the head's rotation and the true one",
        blind="place and expression",
        unit="degrees",
        function="with_truth:rotation_error",
        needs="rotation",
    ),
    Objective(
        name="position",
        says="distance of the head from its true place",
        blind="rotation and expression; a wrong focal length or head size counts mostly as distance",
        unit="mm",
        function="with_truth:position_error",
        needs="translation",
    ),
    Objective(
        name="weights",
        says="mean distance of the blendshape weights from the true ones",
        blind="that different weights can make the same face: a fit may look right and be counted wrong",
        unit="",
        function="with_truth:weight_error",
        needs="expression",
        digits=4,
    ),
    Objective(
        name="mesh",
        says="mean distance of the mesh from the true one, centre on centre",
        blind="where the head is; wide cheeks and skull outweigh lips and lids, which are small",
        unit="mm",
        function="with_truth:surface_error",
        needs="surface",
    ),
    Objective(
        name="labels",
        says="distance of the model's landmarks from labelled ones",
        blind="depth, frames without labels, and the labels' own error",
        unit="% of the eye distance",
        function="with_truth:label_error",
        needs="labels",
    ),
    Objective(
        name="iterations",
        says="steps that the solver takes per frame: what a setting costs in time",
        blind="how good the fit is; and a step that frees weights takes longer than one of the pose alone",
        unit="steps",
        function="without_truth:solver_steps",
        digits=1,
    ),
)
TABLE: Mapping[str, Objective] = MappingProxyType({row.name: row for row in ROWS})


def measure(name: str) -> Callable[[ObservedClip, FittedClip], Float[AnyArray, "n"]]:
    """The function of an objective. Raises `ConfigError` for an unknown name."""
    module, function = objective(name).function.split(":")
    return getattr(import_module(f"workbench.objectives.{module}"), function)


def objective(name: str) -> Objective:
    """The row of this name. Raises `ConfigError` if there is none."""
    if name not in TABLE:
        raise ConfigError(f"There is no objective {name!r}; the objectives are {', '.join(TABLE)}.")
    return TABLE[name]


def measured_by(names: Iterable[str], clip: ObservedClip, fits: FittedClip) -> dict[str, Float[AnyArray, "n"]]:
    """Some objectives of the fits of a clip, each with one number per frame.

    Raises `InputError` if the clip lacks what an objective needs.
    """
    names = tuple(names)
    check_usable(names, clip)
    return {name: measure(name)(clip, fits) for name in names}


def check_usable(names: Iterable[str], clip: ObservedClip) -> None:
    """Raise `InputError` if a clip lacks what an objective needs."""
    for name in names:
        if not usable(objective(name), clip):
            raise lacking(name)


def lacking(name: str) -> InputError:
    """The error for a clip that lacks what an objective needs."""
    return InputError(f"The objective {name!r} needs {NEEDED[TABLE[name].needs]}; this clip does not have it.")


def usable(row: Objective, clip: ObservedClip) -> bool:
    """Whether a clip has what an objective needs."""
    if row.needs is None:
        return True
    return getattr(clip if row.needs in ("flow", "second") else clip.truth, row.needs) is not None
