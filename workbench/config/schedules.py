"""Schedules: the stages that solve a frame, and the schedules of the presets."""

import difflib
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal

from pydantic import Field, field_validator

from workbench.config.sections import Iterations, NonNegative, Section
from workbench.energies.systems import PARAMETER_BLOCKS
from workbench.energies.terms import TABLE
from workbench.landmarks.scheme import IBUG68, LandmarkScheme
from workbench.landmarks.schemes import MOST_POINTS, SCHEMES

NAMED_TERMS = tuple(name for name in TABLE if name not in ("landmarks", "identity"))
"""The terms a stage may add. Landmarks are in every stage; the identity prior is wherever the identity is free."""


class Stage(Section):
    """One solve: its free parameters, the weight of each landmark, and the number of iterations."""

    in_turn = ("landmarks",)

    name: str = Field(min_length=1, description="Name in tables and plots.")
    free: tuple[Literal[PARAMETER_BLOCKS], ...] = Field(
        min_length=1, description="What the stage solves for; the rest is held."
    )
    shapes: tuple[str, ...] = Field(
        (),
        description="Deep Energies: free blendshapes by name or prefix, or first:N (of the identity too); empty: all.",
    )
    terms: tuple[Literal[NAMED_TERMS], ...] = Field(
        (), description="Terms in addition to those that the system always has."
    )
    landmarks: dict[str, NonNegative] = Field({"all": 1.0}, description="Weight by group; later entries win.")
    limit: Iterations = Field(15, description="Maximum number of iterations.")
    when: Literal["always", "start"] = Field(
        "always", description="start: only on the first frame of a shot (FACE IT!)."
    )
    enabled: bool = Field(True, description="false: the stage is skipped.")

    @field_validator("free")
    @classmethod
    def _in_order(cls, value):
        if len(set(value)) != len(value):
            raise ValueError("lists a parameter twice")
        return tuple(name for name in PARAMETER_BLOCKS if name in value)

    @field_validator("shapes")
    @classmethod
    def _counted(cls, value):
        for shape in value:
            kind, colon, count = shape.partition(":")
            if kind == "first" and colon and not count.isdecimal():
                raise ValueError(f"has {shape!r}; write first:N with a whole number N, for example first:10")
        return value

    def landmark_weights(
        self, subsets: Mapping[str, Sequence[int]] = MappingProxyType({}), scheme: LandmarkScheme = IBUG68
    ) -> list[float]:
        """Weight of each landmark: 0, then overwritten by each group or subset in turn."""
        return weights_in_turn(self.landmarks, subsets, 0.0, scheme)


def weights_in_turn(
    table: Mapping[str, float], subsets: Mapping[str, Sequence[int]], start: float, scheme: LandmarkScheme = IBUG68
) -> list[float]:
    """Weight of each landmark: `start`, then overwritten by each group, subset or point number in turn.

    What the scheme has no points for weighs nothing.
    """
    weights = dict.fromkeys(range(len(scheme)), start)
    groups = {**ALL_GROUPS, **scheme.groups, **subsets}
    for name, weight in table.items():
        chosen = (int(name),) if name.isdigit() else groups[name]
        weights |= {index: weight for index in chosen if index in weights}
    return list(weights.values())


ALL_GROUPS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {name: points for scheme in SCHEMES.values() for name, points in scheme.groups.items()}
)
"""Every group's name, with the points that the largest scheme gives it."""


def unknown_group(name: str, subsets: Mapping[str, Sequence[int]]) -> str | None:
    """What is wrong with the name of a landmark group; None if it is valid."""
    if name in ALL_GROUPS or name in subsets or (name.isdecimal() and int(name) < MOST_POINTS):
        return None
    near = difflib.get_close_matches(name, [*ALL_GROUPS, *subsets], 1)
    hint = f"did you mean {near[0]!r}?" if near else f"the groups are {', '.join([*ALL_GROUPS, *subsets])}"
    return f"knows no landmark group {name!r}; {hint}"


POSE = ("rotation", "translation")
ROBUST_START = Stage(name="initial pose", free=POSE, landmarks={"robust": 1.0}, when="start")

DEEP_STAGES = (
    # Few iterations on purpose: translation alone would move the face in depth, scaling it to reach the landmarks.
    Stage(name="translation", free=("translation",), landmarks={"non_jaw": 1.0}, limit=5, terms=("edges",)),
    Stage(name="rigid, not the jaw", free=POSE, landmarks={"non_jaw": 1.0}, limit=10, terms=("edges",)),
    Stage(name="rigid, jaw alone", free=POSE, landmarks={"jaw": 1.0}, limit=3, terms=("edges",)),
    Stage(name="rigid, all", free=POSE, limit=10, terms=("edges",)),
    Stage(
        name="jaw open",
        free=(*POSE, "jaw_open"),
        landmarks={"all": 1.0, "mouth": 3.0},
        limit=8,
        terms=("regularisation",),
    ),
    Stage(name="jaw", free=("jaw",), landmarks={"all": 1.0, "mouth": 3.0}, limit=8, terms=("regularisation",)),
    Stage(
        name="jaw and mouth",
        free=(*POSE, "expression", "jaw"),
        shapes=("mouth",),
        limit=12,
        terms=("regularisation",),
    ),
    Stage(
        name="re-estimation",
        free=("expression", "jaw"),
        shapes=("mouth",),
        limit=12,
        terms=("regularisation",),
        enabled=False,
    ),
)
"""After Deep Energies Sec. 8.1 and 8.2; the limits and the mouth's weight of 3 are ours. The last stage is from B.1 and
is meant for use after a temporal refinement."""

FIRST_10 = ("first:10",)
PARALLEL_STAGES = (
    Stage(name="translation", free=("translation",), landmarks={"non_jaw": 1.0}, limit=5, terms=("edges",)),
    Stage(name="rigid and scale", free=(*POSE, "scale"), limit=15, terms=("edges",)),
    Stage(name="shape", free=(*POSE, "identity"), shapes=FIRST_10, limit=12),
    Stage(name="expression", free=(*POSE, "expression"), shapes=FIRST_10, limit=12),
)
"""After Deep Energies Appendix C.2, the first two with the edges and landmarks of Sec. 8.1; the limits are ours.

The first ten are the largest of a statistical basis. The default head's blendshapes are in alphabetical order: its
first ten move neither jaw nor mouth."""

OUR_PARALLEL_STAGES = (
    *PARALLEL_STAGES[:2],
    # Shape must not explain an open mouth, which the next stage cannot take back.
    Stage(
        name="shape",
        free=(*POSE, "identity"),
        shapes=FIRST_10,
        landmarks={"all": 1.0, "mouth": 0.0, "jaw": 0.0},
        limit=12,
    ),
    Stage(name="expression", free=(*POSE, "expression"), shapes=FIRST_10, limit=12, terms=("regularisation",)),
)

PRESET_STAGES: dict[str, tuple[Stage, ...]] = {
    "face-it": (
        ROBUST_START,
        Stage(name="pose", free=POSE),
        Stage(name="expression", free=("expression",)),
    ),
    "calibrated": (
        ROBUST_START,
        Stage(name="first pose", free=POSE, landmarks={"non_jaw": 1.0}, when="start"),
        Stage(name="first expression", free=("expression",), when="start"),
        Stage(name="pose", free=POSE, landmarks={"non_jaw": 1.0}),
        Stage(name="expression", free=("expression",)),
    ),
    "joint": (
        ROBUST_START,
        # A detected contour is a silhouette, not a set of fixed points: with its full weight it would turn the head.
        Stage(name="pose and expression", free=(*POSE, "expression"), landmarks={"all": 1.0, "jaw": 0.1}, limit=30),
    ),
}
PRESET_STAGES["gaze"] = PRESET_STAGES["dense"] = tuple(
    stage if stage is ROBUST_START else stage.model_copy(update={"terms": ("vergence", "opposites", "gaze")})
    for stage in PRESET_STAGES["joint"]
)
"""As `joint`, with eyes that turn."""
