"""What a run does, as data: camera, schedule of stages, ω weights, identity, landmarks. Stored as commented TOML."""

import difflib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, get_args

import tomlkit
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, field_validator, model_validator
from pydantic.json_schema import GenerateJsonSchema

from workbench.energies.systems import PARAMETER_BLOCKS, SYSTEMS
from workbench.energies.systems import System as SystemTraits
from workbench.energies.terms import NODES, TABLE, Term, stage_factors, terms_of
from workbench.errors import ConfigError
from workbench.files import atomic_path
from workbench.landmarks.scheme import GROUPS
from workbench.reading import checked_file, reading, shortened, toml_tables

VERSION = 2
DEFAULT_PRESET = "joint"
System = Literal[tuple(SYSTEMS)]
NAMED_TERMS = tuple(name for name in TABLE if name not in ("landmarks", "identity"))
"""What a stage may name: the landmarks are in every stage, and the identity's prior wherever the identity is free."""
LONGEST_PROBLEM = 400
"""Characters of what is wrong with a configuration: names in it may be of any length."""
NonNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
FrameKey = Annotated[str, Field(pattern=r"^\d+$")]
PointKey = Annotated[str, Field(pattern=r"^([0-9]|[1-5][0-9]|6[0-7])$")]
"""A point number from 0 to 67; TOML's keys are text."""
Iterations = Annotated[int, Field(ge=0, le=500)]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class CameraConfig(_Section):
    """Camera: given as a matrix, or guessed from a field of view."""

    fov_deg: Annotated[float, Field(gt=0.0, lt=180.0)] = Field(
        45.0, description="Field of view over the longer side, degrees; a guess unless you know it."
    )
    matrix: list[list[float]] | None = Field(None, description="OpenCV camera matrix in pixels; replaces fov_deg.")
    distortion: list[float] = Field([], description="OpenCV distortion, 0, 4, 5 or 8 coefficients.")
    projection: Literal["perspective", "orthographic"] = Field(
        "perspective", description="orthographic: no perspective, as by a tele lens; the head's scale replaces z."
    )
    rig: str = Field("", description="Rig file of several cameras (Deep Energies); replaces the camera above.")


def _omega(name: str) -> Any:
    """The field of a term's ω, with default and comment from the table."""
    term = TABLE[name]
    source = f" ({term.equation})" if term.equation else ""
    return Field(term.default, description=f"{term.omega_symbol}: {term.says}{source}.")


def _own_weights() -> list[Term]:
    """The terms whose ω lies in the section `weights`."""
    return [term for term in TABLE.values() if term.of != "landmarks" and not term.key]


WeightsConfig = create_model(
    "WeightsConfig",
    __base__=_Section,
    __doc__="ω in the hierarchy of FACE IT! Eqs. 5-7: a term's factor is the product down its branch.",
    **{
        node.name: (NonNegative, Field(1.0, description=f"{node.symbol}: {node.says} ({node.source})."))
        for node in NODES
    },
    **{term.name: (NonNegative, _omega(term.name)) for term in _own_weights()},
)


def _preset_weights(preset: str) -> Any:
    """The ω of a preset, from the table."""
    return WeightsConfig(**{term.name: term.presets[preset] for term in _own_weights() if preset in term.presets})


class ConstantsConfig(_Section):
    """Constants inside the terms."""

    a: float = Field(1.002, description="E_β: upper bound.")
    b: Annotated[float, Field(gt=0.0)] = Field(2e-5, description="E_β: width of its steps.")
    c: float = Field(2.5, description="E_β: offset.")
    delta: Annotated[float, Field(gt=0.0)] = Field(0.01, description="Smoothed L1: where it turns quadratic.")
    rotation_mm: NonNegative = Field(100.0, description="E_τ: millimetres that one radian counts as.")


class SolverConfig(_Section):
    """How each stage is solved."""

    method: Literal["lm", "optimistix-lm", "optimistix-dogleg"] = Field(
        "lm", description="lm: ours, which keeps bounds by an active set; Optimistix' two cut a step off at them."
    )
    bounded: bool = Field(True, description="Keep every weight in [0, 1] (off: only the terms hold them).")
    tolerance: NonNegative = Field(1e-6, description="Stop when a step lowers the energy by less than this part.")
    unit: Literal["px", "percent"] = Field(
        "percent", description="Unit of landmark residuals: pixels, or percent of the outer-eye distance."
    )


class ContourConfig(_Section):
    """The jaw contour."""

    mode: Literal["sliding", "fixed"] = Field(
        "sliding", description="sliding: the 17 jaw points slide along the face with the yaw; fixed: they stay."
    )


class IdentityConfig(_Section):
    """Calibration of the subject's face shape before tracking."""

    calibrate: bool = Field(True, description="Estimate one identity per shot (or photo); off: the model's mean face.")
    window: Annotated[int, Field(ge=1, le=1000)] = Field(90, description="Frames of a shot to choose from.")
    frames: Annotated[int, Field(ge=1, le=24)] = Field(12, description="Frames of the window that are used.")
    weight: NonNegative = _omega("identity")
    expression: NonNegative = Field(40.0, description="ω of the smoothed L1 norm of the weights during calibration.")
    jaw: NonNegative = Field(0.3, description="Landmark weight of the jaw contour in the second pass.")
    limits: tuple[Iterations, Iterations] = Field((30, 15), description="Iterations of the two passes.")


class LandmarksConfig(_Section):
    """Detection and tracking of the 68 points."""

    detector: Literal["auto", "dlib+network", "network", "dlib", "dlib-hog", "dlib-cnn"] = Field(
        "auto", description="Face detector and predictor; auto: dlib+network where dlib is installed, else network."
    )
    face: tuple[float, float] | None = Field(None, description="A point in the wanted face, pixels; else the largest.")
    weights: dict[str, NonNegative] = Field(
        {}, description="Factor by group, subset or point number, in every stage and in the identity; 0 mutes."
    )
    moved: dict[FrameKey, dict[PointKey, tuple[float, float]]] = Field(
        {}, description="Detections put right by hand: frame number, then point number, then its place in pixels."
    )


class DeepConfig(_Section):
    """Deep Energies: photo and render through one network (Sec. 4 to 8); FACE IT! reads none of this."""

    energy: Literal["deep", "points", "mixed"] = Field(
        "deep", description="Landmarks of the model: seen in its render, preselected on it, or mixed by confidence."
    )
    derivative: Literal["broyden", "forward", "differences"] = Field(
        "broyden", description="forward: through renderer and network, as published; broyden: 8 times faster."
    )
    start: Literal["frontal", "landmarks"] = Field(
        "frontal", description="frontal: facing the camera in the picture's middle; landmarks: the pose they give."
    )
    distance_mm: Annotated[float, Field(gt=0.0)] = Field(650.0, description="Distance of the frontal start.")
    appearance: Literal["estimate", "model"] = Field(
        "estimate", description="Colours and light: from the most neutral frame, or the model's own."
    )
    network: str = Field("", description="Weights of the landmark network (.safetensors); empty: the bundled one.")
    edges: NonNegative = _omega("edges")
    regularisation: NonNegative = _omega("regularisation")
    tolerance: NonNegative = Field(1e-3, description="A stage stops when a step gains less than this part.")
    identity: NonNegative = Field(10.0, description="Weight of ‖identity‖² in stages that free it.")
    prior: NonNegative = _omega("prior")
    largest_error: NonNegative = Field(6.0, description="Failed above this mean landmark error, % of eye distance.")
    largest_disagreement: NonNegative = Field(
        12.0, description="Failed if jaw and other landmarks differ by more in their mean error, % of eye distance."
    )


class FlowConfig(_Section):
    """Optical flow between neighbouring frames, for infill and refinement (Deep Energies Sec. 6 and 7)."""

    estimator: str = Field("dis", min_length=1, description="dis, farneback, network, or the path of a weights file.")
    side: Annotated[int, Field(ge=64, le=1024)] = Field(
        384, description="Pixels that the square about the face is brought to; the paper has 512."
    )
    points: Annotated[int, Field(ge=16, le=5000)] = Field(600, description="Surface points that are compared.")
    renders: Literal["exact", "estimated"] = Field(
        "exact", description="Flow of the renders: of the moving mesh, or by the same estimator as the photos."
    )
    robust: Annotated[float, Field(gt=0.0)] = Field(
        1.0, description="Percent of the eye distance from which a point counts less and less."
    )
    stay: NonNegative = _omega("stay")
    iterations: Iterations = Field(8, description="Step limit of each robust least-squares fit.")


class InfillConfig(_Section):
    """Frames without a usable fit, filled from their neighbours (Deep Energies Sec. 6, 8.3, Appendix A)."""

    method: Literal["none", "flow", "linear", "spline"] = Field("none", description="none leaves failed frames as is.")
    rounds: Annotated[int, Field(ge=1, le=10)] = Field(
        1, description="Flow: passes through a gap, forward and backward in turn."
    )
    longest: Annotated[int, Field(ge=1)] = Field(10_000, description="Gaps of more frames stay.")
    largest_error: NonNegative = Field(
        10.0, description="Mean landmark error, % of eye distance, above which a fit counts as failed."
    )
    frames: tuple[tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]], ...] = Field(
        (), description="Frames that are filled although they have a fit: first and last of each part."
    )

    @field_validator("frames")
    @classmethod
    def _in_order(cls, value):
        for first, last in value:
            if last < first:
                raise ValueError(f"a part goes from its first to its last frame, got {first} to {last}")
        return tuple(sorted(value))

    def named(self, frame: int) -> bool:
        """Whether a frame is filled although it has a fit."""
        return any(first <= frame <= last for first, last in self.frames)


class RefinementConfig(_Section):
    """Steadier tracks (Deep Energies Sec. 7, Appendix B)."""

    method: Literal["none", "averaging", "self", "plate", "hybrid"] = Field(
        "none", description="hybrid: averaging, then the flow of the pictures (plate)."
    )
    sweeps: Annotated[int, Field(ge=1, le=20)] = Field(1, description="Times that every frame is solved.")
    order: Literal["jacobi", "gauss-seidel"] = Field(
        "jacobi", description="jacobi: from the neighbours of the last sweep; gauss-seidel: from the newest."
    )
    centre: Annotated[float, Field(gt=0.0, le=1.0)] = Field(
        0.5, description="Averaging: weight of the frame itself; its neighbours share the rest."
    )
    prior: NonNegative = Field(0.0, description="Flow: weight of staying at the fit before, pose in mm, 1 rad as 100.")
    reestimate: Annotated[int, Field(ge=0, le=10)] = Field(
        0, description="Times that the expression is re-fitted with the pose held (B.1), each with its refinement."
    )


class Stage(_Section):
    """One solve: what is free, what each landmark counts, how many iterations."""

    name: str = Field(min_length=1, description="What tables and plots call it.")
    free: tuple[Literal[PARAMETER_BLOCKS], ...] = Field(
        min_length=1, description="What the stage solves for; the rest stays."
    )
    shapes: tuple[str, ...] = Field(
        (), description="Deep Energies: free blendshapes by name or start of name, or first:N; empty: all."
    )
    terms: tuple[Literal[NAMED_TERMS], ...] = Field(
        (), description="Terms beside those that the system has in every stage."
    )
    landmarks: dict[str, NonNegative] = Field({"all": 1.0}, description="Weight by group; later entries win.")
    limit: Iterations = Field(15, description="Most iterations.")
    when: Literal["always", "start"] = Field("always", description="start: only on the first frame of a shot.")
    enabled: bool = Field(True, description="Off: the stage is left out.")

    @field_validator("free")
    @classmethod
    def _in_order(cls, value):
        if len(set(value)) != len(value):
            raise ValueError("lists a parameter twice")
        return tuple(name for name in PARAMETER_BLOCKS if name in value)

    def landmark_weights(self, subsets: Mapping[str, Sequence[int]] = MappingProxyType({})) -> list[float]:
        """Weight of each of the 68 landmarks: zero, then each group or subset in turn."""
        return _weights_in_turn(self.landmarks, subsets, 0.0)


def _weights_in_turn(table: Mapping[str, float], subsets: Mapping[str, Sequence[int]], start: float) -> list[float]:
    weights = [start] * 68
    for name, weight in table.items():
        for index in (int(name),) if name.isdigit() else (GROUPS | dict(subsets))[name]:
            weights[index] = weight
    return weights


def _unknown_group(name: str, subsets: Mapping[str, Sequence[int]]) -> str | None:
    """What is wrong with the name of a landmark group, None if nothing."""
    if name in GROUPS or name in subsets or (name.isdigit() and int(name) < 68):
        return None
    near = difflib.get_close_matches(name, [*GROUPS, *subsets], 1)
    hint = f"did you mean {near[0]!r}?" if near else f"the groups are {', '.join([*GROUPS, *subsets])}"
    return f"knows no landmark group {name!r}; {hint}"


class Provenance(_Section):
    """Where an exported configuration comes from; a run does not read it."""

    # Metrics of frames without a face are not finite.
    model_config = ConfigDict(allow_inf_nan=True)

    exported: str = Field("", description="Date and time, UTC.")
    versions: dict[str, str] = Field({}, description="Software that the numbers below were computed with.")
    model: str = Field("", description="Name and SHA-256 of the face model.")
    inputs: list[str] = Field([], description="Path and SHA-256 of each input.")
    landmarks: str = Field("", description="Path and SHA-256 of the landmark file, if one was used.")
    changed: list[str] = Field([], description="What differs from the preset that the tuning started from.")
    before: dict[str, float] = Field({}, description="Metrics with that preset.")
    after: dict[str, float] = Field({}, description="Metrics with this configuration.")


POSE = ("rotation", "translation")
ROBUST_START = Stage(name="initial pose", free=POSE, landmarks={"robust": 1.0}, when="start")


DEEP_STAGES = (
    # Few iterations on purpose: translation alone would grow and shrink the face to reach the landmarks.
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
"""After Deep Energies Sec. 8.1 and 8.2; limits and the mouth's weight of 3 are ours. The last one is B.1's, for after a
temporal refinement."""

FIRST_10 = ("first:10",)
PARALLEL_STAGES = (
    Stage(name="translation", free=("translation",), landmarks={"non_jaw": 1.0}, limit=5, terms=("edges",)),
    Stage(name="rigid and scale", free=(*POSE, "scale"), limit=15, terms=("edges",)),
    Stage(name="shape", free=(*POSE, "identity"), shapes=FIRST_10, limit=12),
    Stage(name="expression", free=(*POSE, "expression"), shapes=FIRST_10, limit=12, terms=("regularisation",)),
)
"""After Deep Energies Appendix C.2; the priors on shape and expression are ours. The first ten are the largest of a
statistical basis. The default head's blendshapes are in alphabetical order: no jaw, no mouth among the first ten."""


class Config(_Section):
    """A whole configuration."""

    version: Literal[2] = Field(VERSION, description="Of this file's format.")
    preset: str = Field(DEFAULT_PRESET, description="The preset this configuration started from.")
    system: System = Field("face-it", description="face-it: from landmarks; deep-energies: from renders as well.")
    camera: CameraConfig = CameraConfig()
    weights: WeightsConfig = WeightsConfig()
    constants: ConstantsConfig = ConstantsConfig()
    solver: SolverConfig = SolverConfig()
    contour: ContourConfig = ContourConfig()
    identity: IdentityConfig = IdentityConfig()
    landmarks: LandmarksConfig = LandmarksConfig()
    deep: DeepConfig = DeepConfig()
    flow: FlowConfig = FlowConfig()
    infill: InfillConfig = InfillConfig()
    refinement: RefinementConfig = RefinementConfig()
    subsets: dict[str, tuple[Annotated[int, Field(ge=0, lt=68)], ...]] = Field(
        {}, description="Named sets of landmark numbers, used like the built-in groups."
    )
    stages: tuple[Stage, ...] = Field(min_length=1, default=(), description="Solved in this order.")
    provenance: Provenance | None = Field(None, description="Where an exported configuration comes from.")

    def point_weights(self) -> list[float]:
        """Factor of each of the 68 landmarks in every stage: one, then each entry of `landmarks.weights` in turn."""
        return _weights_in_turn(self.landmarks.weights, self.subsets, 1.0)

    def moved_points(self, frame: int) -> dict[int, tuple[float, float]]:
        """The detections of a frame that were put right by hand, by point."""
        return {int(point): place for point, place in self.landmarks.moved.get(str(frame), {}).items()}

    @property
    def traits(self) -> SystemTraits:
        """What its system can do."""
        return SYSTEMS[self.system]

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the energy's terms: the system's, and those that any stage names."""
        return terms_of(self.system, self.named_terms(self.stages))

    @property
    def summed_terms(self) -> set[str]:
        """The terms that count in some stage that runs."""
        own = {name for name, term in TABLE.items() if self.system in term.systems}
        return own | self.named_terms(stage for stage in self.stages if stage.enabled)

    @staticmethod
    def named_terms(stages: Iterable[Stage]) -> set[str]:
        """The terms that stages name beside their system's own."""
        return {name for stage in stages for name in stage.terms}

    def running(self, start: bool) -> tuple[Stage, ...]:
        """The stages that run on the first frame of a shot (`start`) or on a later one."""
        return tuple(stage for stage in self.stages if stage.enabled and (start or stage.when == "always"))

    def omega(self) -> dict[str, float]:
        """Every ω by its place, as `weights.tau`."""
        places = {f"weights.{node.name}" for node in NODES}
        places |= {term.omega_key(self.system) for term in TABLE.values() if term.name != "landmarks"}
        return {place: getattr(getattr(self, place.split(".")[0]), place.split(".")[1]) for place in places}

    def factors(self, stage: Stage) -> list[float]:
        """The factor in front of each of `terms` in a stage: the product of ω down its branch; 0 where it is off."""
        return stage_factors(self.omega(), self.system, stage.free, stage.terms, self.terms)

    def changed(self, **sections: Any) -> "Config":
        """The configuration with some keys of some sections replaced, checked again.

        Raises `ConfigError` for unknown keys and bad values.
        """
        stored = self.model_dump()
        for section, values in sections.items():
            stored[section] = {**(stored.get(section) or {}), **values} if isinstance(values, dict) else values
        return _validated(stored, "The configuration")

    @model_validator(mode="after")
    def _names_are_known(self):
        for name in self.subsets:
            if name in GROUPS or name.isdigit() or not name:
                raise ValueError(f"a subset cannot be called {name!r}: that is a built-in group or a point number")
        tables = {"landmarks.weights": self.landmarks.weights}
        tables |= {f"stage {stage.name!r}": stage.landmarks for stage in self.stages}
        for place, table in tables.items():
            for name in table:
                if problem := _unknown_group(name, self.subsets):
                    raise ValueError(f"{place} {problem}")
        for stage in self.stages:
            foreign = [name for name in stage.free if name not in self.traits.blocks]
            if foreign:
                raise ValueError(f"stage {stage.name!r} frees {foreign[0]!r}, which takes system = 'deep-energies'")
        if self.system == "face-it" and self.camera.projection == "orthographic":
            raise ValueError("an orthographic camera takes system = 'deep-energies'")
        if not any(stage.enabled and stage.when == "always" for stage in self.stages):
            raise ValueError("no enabled stage runs on every frame: enable one with when = 'always'")
        return self

    @model_validator(mode="before")
    @classmethod
    def _default_stages(cls, data: Any):
        return {"stages": PRESET_STAGES[DEFAULT_PRESET], **data} if isinstance(data, dict) else data


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
        # The contour of a detector is a silhouette, not a set of points: in full it would turn the head.
        Stage(name="pose and expression", free=(*POSE, "expression"), landmarks={"all": 1.0, "jaw": 0.1}, limit=30),
    ),
}

PRESETS: dict[str, Config] = {
    # The paper's terms and schedule: residuals in pixels, E_β and E_σ as single residuals, no bounds, one fixed
    # contour, no identity. It prints no values of ω; these leave E_fit in charge on a 640-pixel picture, while weights
    # run far beyond [0, 1]. That points count with their confidence is ours.
    "face-it": Config(
        preset="face-it",
        weights=_preset_weights("face-it"),
        solver=SolverConfig(bounded=False, unit="px"),
        contour=ContourConfig(mode="fixed"),
        identity=IdentityConfig(calibrate=False),
        stages=PRESET_STAGES["face-it"],
    ),
    # The same alternation on a calibrated identity, weights truly in [0, 1], contour sliding with the yaw.
    "calibrated": Config(
        preset="calibrated", weights=_preset_weights("calibrated"), stages=PRESET_STAGES["calibrated"]
    ),
    # Ours: pose and expression as one problem of 50 unknowns, where the alternation sticks.
    "joint": Config(preset="joint", weights=_preset_weights("joint"), stages=PRESET_STAGES["joint"]),
    # Deep Energies: the order of the stages and what each frees are the paper's. It prints no iteration limits, no
    # bounds, neither W nor the weight of its edge term: these are ours. So is λ: the paper's 100 stands beside errors
    # in pixels, and in a residual λw that would be squared with it.
    "deep-energies": Config(preset="deep-energies", system="deep-energies", stages=DEEP_STAGES),
    # The same with the energy of Appendix C.1.
    "preselected-points": Config(
        preset="preselected-points", system="deep-energies", deep=DeepConfig(energy="points"), stages=DEEP_STAGES
    ),
    # Appendix C.2: parallel projection with a scale, the mean face and the first 10 + 10 components.
    "orthographic": Config(
        preset="orthographic",
        system="deep-energies",
        camera=CameraConfig(projection="orthographic"),
        identity=IdentityConfig(calibrate=False),
        deep=DeepConfig(appearance="model"),
        stages=PARALLEL_STAGES,
    ),
}


FACE_IT_PRESETS = tuple(name for name, config in PRESETS.items() if config.system == "face-it")


@dataclass(frozen=True)
class Difference:
    """One value that two configurations do not share."""

    path: str
    """As `weights.tau`; `stages.pose.limit` for a stage by its name."""
    before: Any
    """None where the value is new."""
    after: Any
    """None where it is gone."""

    def __str__(self) -> str:
        return f"{self.path}: {_short(self.before)} → {_short(self.after)}"


def differences(before: Config, after: Config) -> list[Difference]:
    """What differs, in the order of the file; `provenance` and `preset` are no settings."""
    old, new = _flat(before), _flat(after)
    paths = [*new, *(path for path in old if path not in new)]
    return [Difference(path, old.get(path), new.get(path)) for path in paths if old.get(path) != new.get(path)]


def _flat(config: Config) -> dict[str, Any]:
    stored = config.model_dump(exclude={"version", "preset", "provenance", "stages"})
    found: dict[str, Any] = {}
    for section, values in stored.items():
        if not isinstance(values, dict):
            found[section] = values
            continue
        for key, value in values.items():
            if isinstance(value, dict):
                found |= {f"{section}.{key}.{name}": entry for name, entry in value.items()}
            else:
                found[f"{section}.{key}"] = value
    found["stages"] = [stage.name for stage in config.stages]
    for stage in config.stages:
        for key, value in stage.model_dump(exclude={"name"}).items():
            found[f"stages.{stage.name}.{key}"] = value
    return found


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(str(entry) for entry in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_short(entry)}" for key, entry in value.items()) + "}"
    return "(none)" if value is None else str(value)


def preset(name: str) -> Config:
    """A named preset. Raises `ConfigError` for a name that does not exist."""
    if name not in PRESETS:
        raise ConfigError(f"There is no preset {_quoted(name)}; the presets are {', '.join(PRESETS)}.")
    return PRESETS[name]


def read_config(path: str | Path) -> Config:
    """Configuration of a TOML file; what it leaves out comes from its `preset` (default: `DEFAULT_PRESET`).

    Raises `ConfigError` for a missing file, invalid TOML, unknown keys (with the nearest known one) and bad values.
    """
    absent = f"The configuration {path} does not exist; `workbench track` writes one as config.toml."
    path = checked_file(path, "a configuration", ConfigError, absent, may_be_empty=True)
    with reading(path, "a configuration", "begin with what `workbench config show` prints", ConfigError):
        return parse_config(toml_tables(path, ConfigError), str(path))


def parse_config(stored: Mapping[str, Any], origin: str) -> Config:
    """Configuration of a plain dictionary of any version; what it leaves out comes from its `preset`.

    `origin` names it in messages. Raises `ConfigError` as `read_config`.
    """
    stored = _migrated(dict(stored), origin)
    base = preset(str(stored.get("preset", DEFAULT_PRESET))).model_dump()
    for key, value in stored.items():
        base[key] = {**base[key], **value} if isinstance(value, dict) and isinstance(base.get(key), dict) else value
    return _validated(base, origin)


def _migrated(stored: dict[str, Any], origin: str) -> dict[str, Any]:
    version = stored.get("version", VERSION)
    if not isinstance(version, int) or isinstance(version, bool) or not 1 <= version <= VERSION:
        raise ConfigError(f"{origin}: version is {_quoted(version)}, this workbench reads 1 to {VERSION}; upgrade it.")
    for step in range(version, VERSION):
        stored = MIGRATIONS[step](stored)
    return {**stored, "version": VERSION}


def _from_1(stored: dict[str, Any]) -> dict[str, Any]:
    """1 → 2: `contour.sliding` became `contour.mode`; what names no preset stands on the default of that time."""
    stored = {"preset": "calibrated", **stored}
    contour = stored.get("contour")
    if not isinstance(contour, dict) or "sliding" not in contour:
        return stored
    renamed = {key: value for key, value in contour.items() if key != "sliding"}
    return {**stored, "contour": {**renamed, "mode": "sliding" if contour["sliding"] else "fixed"}}


MIGRATIONS = {1: _from_1}
"""By version: what turns a stored configuration into one of the next version."""


def _validated(stored: dict[str, Any], origin: str) -> Config:
    try:
        return Config.model_validate(stored)
    except ValidationError as error:
        raise ConfigError(f"{origin}: {shortened(_first_problem(error), LONGEST_PROBLEM)}") from error


def write_config(config: Config, path: str | Path) -> None:
    """Write a configuration as TOML with a comment at each value, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text(config_toml(config), encoding="utf-8")


def config_toml(config: Config) -> str:
    """The configuration as TOML text with a comment at each value, in stable order."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Face Energy Workbench configuration. Lengths in millimetres and pixels."))
    for name, field in type(config).model_fields.items():
        value = getattr(config, name)
        if isinstance(value, BaseModel):
            document.add(name, _table(value))
        elif name == "subsets":
            document.add(name, _subsets_table(value, field.description))
        elif name == "stages":
            stages = tomlkit.aot()
            for stage in value:
                stages.append(_table(stage))
            document.add(name, stages)
        elif value is not None:
            document.add(name, _commented(value, field.description))
    return tomlkit.dumps(document)


class _SchemaOfFiles(GenerateJsonSchema):
    """As pydantic makes it, without titles made of keys and without defaults: those come from a file's preset."""

    def field_title_should_be_set(self, schema) -> bool:
        return False

    def default_schema(self, schema) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def dict_schema(self, schema) -> dict[str, Any]:
        made = super().dict_schema(schema)
        return {**made, "additionalProperties": False} if "patternProperties" in made else made


def config_schema() -> str:
    """JSON Schema (draft 2020-12) of configuration files of the present version, as text.

    It knows keys, types, ranges and choices. Rules that join several values are left to `read_config`.
    """
    schema = Config.model_json_schema(schema_generator=_SchemaOfFiles)
    for name, field in Config.model_fields.items():
        section = field.annotation
        if isinstance(section, type) and issubclass(section, BaseModel):
            schema["properties"][name]["description"] = section.__doc__
    schema["properties"]["preset"]["enum"] = list(PRESETS)
    head = {
        "$schema": GenerateJsonSchema.schema_dialect,
        "$id": f"urn:face-energy-workbench:configuration:{VERSION}",
        "title": "Face Energy Workbench configuration",
        "description": "What a run does. What a file leaves out comes from its preset.",
    }
    rest = {key: value for key, value in schema.items() if key not in head}
    return json.dumps({**head, **rest}, indent=2, ensure_ascii=False) + "\n"


def _table(section: BaseModel):
    table = tomlkit.table()
    if section.__doc__ and not isinstance(section, Stage):
        table.comment(section.__doc__.splitlines()[0])
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        if value is None or (value == () and isinstance(section, Stage)):
            continue
        table.add(name, _commented(value, field.description))
    return table


def _subsets_table(subsets: Mapping[str, Sequence[int]], description: str | None):
    table = tomlkit.table().comment(description or "")
    for name, points in subsets.items():
        table.add(name, list(points))
    return table


def _commented(value: Any, description: str | None):
    if isinstance(value, dict):
        item = tomlkit.inline_table()
        item.update(value)
    else:
        item = tomlkit.item(list(value) if isinstance(value, tuple) else value)
    return item.comment(description) if description else item


def _first_problem(error: ValidationError) -> str:
    problem = error.errors()[0]
    place = shortened(".".join(str(part) for part in problem["loc"]))
    if problem["type"] == "value_error":
        return f"{place + ': ' if place else ''}{problem['ctx']['error']}."
    if problem["type"] == "extra_forbidden":
        known = _known_keys(problem["loc"][:-1])
        near = difflib.get_close_matches(str(problem["loc"][-1]), known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"the keys here are {', '.join(known)}."
        return f"there is no key {place!r}; {hint}"
    return f"{place}: {problem['msg']} (got {_quoted(problem.get('input'))})."


def _quoted(value: Any) -> str:
    return shortened(repr(value))


def _known_keys(location: tuple) -> list[str]:
    section: Any = Config
    for part in location:
        if part == "stages":
            section = Stage
        elif isinstance(part, str) and part in section.model_fields:
            annotation = section.model_fields[part].annotation
            section = next((kind for kind in get_args(annotation) if issubclass(kind, BaseModel)), annotation)
    return list(section.model_fields)
