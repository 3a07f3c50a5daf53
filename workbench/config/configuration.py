"""The whole configuration: its sections and stages, the rules across them, and the messages for invalid values."""

import difflib
from collections.abc import Iterable
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, Field, ValidationError, model_validator

from workbench.config.schedules import ALL_GROUPS, PRESET_STAGES, Stage, unknown_group, weights_in_turn
from workbench.config.sections import (
    CameraConfig,
    ConstantsConfig,
    ContourConfig,
    DeepConfig,
    FlowConfig,
    HeadConfig,
    IdentityConfig,
    InfillConfig,
    LandmarksConfig,
    Provenance,
    RefinementConfig,
    Section,
    SolverConfig,
    WeightsConfig,
)
from workbench.energies.systems import SYSTEMS
from workbench.energies.systems import System as SystemTraits
from workbench.energies.terms import NODES, TABLE, stage_factors, terms_of
from workbench.errors import ConfigError
from workbench.landmarks.scheme import IBUG68, LandmarkScheme
from workbench.landmarks.schemes import MOST_POINTS
from workbench.reading import shortened

VERSION = 3
DEFAULT_PRESET = "joint"
System = Literal[tuple(SYSTEMS)]
LONGEST_PROBLEM = 400
"""Most characters in an error message about a configuration, which may quote names of any length."""


class Config(Section):
    """A whole configuration."""

    version: Literal[3] = Field(VERSION, description="Version of this file's format.")
    preset: str = Field(DEFAULT_PRESET, description="The preset this configuration started from.")
    system: System = Field("face-it", description="face-it: fits landmarks; deep-energies: fits renders too.")
    camera: CameraConfig = CameraConfig()
    weights: WeightsConfig = WeightsConfig()
    constants: ConstantsConfig = ConstantsConfig()
    solver: SolverConfig = SolverConfig()
    contour: ContourConfig = ContourConfig()
    identity: IdentityConfig = IdentityConfig()
    landmarks: LandmarksConfig = LandmarksConfig()
    head: HeadConfig = HeadConfig()
    deep: DeepConfig = DeepConfig()
    flow: FlowConfig = FlowConfig()
    infill: InfillConfig = InfillConfig()
    refinement: RefinementConfig = RefinementConfig()
    subsets: dict[str, tuple[Annotated[int, Field(ge=0, lt=MOST_POINTS)], ...]] = Field(
        {}, description="Named sets of landmark numbers, used like the built-in groups."
    )
    stages: tuple[Stage, ...] = Field(min_length=1, default=(), description="Solved in this order.")
    provenance: Provenance | None = Field(None, description="Where an exported configuration comes from.")

    def point_weights(self, scheme: LandmarkScheme = IBUG68) -> list[float]:
        """Factor of each landmark in every stage: 1 unless entries of `landmarks.weights` overwrite it."""
        return weights_in_turn(self.landmarks.weights, self.subsets, 1.0, scheme)

    def moved_points(self, frame: int) -> dict[int, tuple[float, float]]:
        """The detections of a frame that were corrected by hand, by point number."""
        return {int(point): place for point, place in self.landmarks.moved.get(str(frame), {}).items()}

    @property
    def traits(self) -> SystemTraits:
        """The capabilities of the configured system."""
        return SYSTEMS[self.system]

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the energy's terms: those of the system, plus those that any stage adds."""
        return terms_of(self.system, self.named_terms(self.stages))

    @property
    def summed_terms(self) -> set[str]:
        """The terms in the energy of at least one enabled stage."""
        own = {name for name, term in TABLE.items() if self.system in term.systems}
        return own | self.named_terms(stage for stage in self.stages if stage.enabled)

    @property
    def compares_pictures(self) -> bool:
        """Whether a term of an enabled stage compares each frame's picture with the one before."""
        return any(TABLE[name].compares_pictures for name in self.summed_terms)

    @property
    def renders_character(self) -> bool:
        """Whether fits compare renders of `head.character`."""
        return self.traits.renders and self.deep.appearance == "character"

    @staticmethod
    def named_terms(stages: Iterable[Stage]) -> set[str]:
        """The terms that stages add to those of their system."""
        return {name for stage in stages for name in stage.terms}

    def running(self, start: bool) -> tuple[Stage, ...]:
        """The stages that run on the first frame of a shot (`start`) or on a later one."""
        return tuple(stage for stage in self.stages if stage.enabled and (start or stage.when == "always"))

    def omega(self) -> dict[str, float]:
        """What multiplies each term or node of the hierarchy, by the path of its ω, for example `weights.tau`."""
        places = {f"weights.{node.name}" for node in NODES}
        places |= {term.omega_key(self.system) for term in TABLE.values() if term.name != "landmarks"}
        found = {place: getattr(getattr(self, place.split(".")[0]), place.split(".")[1]) for place in places}
        if self.deep.lambda_reading == "residual":
            found["deep.regularisation"] **= 2
        return found

    def factors(self, stage: Stage) -> list[float]:
        """The factor in front of each of `terms` in a stage: the product of ω down its branch; 0 if the term is off."""
        return stage_factors(self.omega(), self.system, stage.free, stage.terms, self.terms)

    def changed(self, **sections: Any) -> "Config":
        """A copy of the configuration with the given keys of the given sections replaced, validated again.

        Raises `ConfigError` for unknown keys and bad values.
        """
        # The other sections as they are: to write them out and read them again would take most of the time.
        stored = {name: getattr(self, name) for name in type(self).model_fields}
        for section, values in sections.items():
            if isinstance(values, dict):
                old = stored.get(section) or {}
                stored[section] = {**(old.model_dump() if isinstance(old, Section) else old), **values}
            else:
                stored[section] = values
        return validated(stored, "The configuration")

    @model_validator(mode="after")
    def _names_are_known(self):
        for name in self.subsets:
            if not name.strip():
                raise ValueError("a subset needs a name: type one")
            if name in ALL_GROUPS or name.isdigit():
                raise ValueError(f"a subset cannot be called {name!r}: that is a built-in group or a point number")
        tables = {"landmarks.weights": self.landmarks.weights}
        tables |= {f"stage {stage.name!r}": stage.landmarks for stage in self.stages}
        for place, table in tables.items():
            for name in table:
                if problem := unknown_group(name, self.subsets):
                    raise ValueError(f"{place} {problem}")
        names = [stage.name for stage in self.stages]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two stages are called {name!r}: give each its own name")
        for stage in self.stages:
            foreign = [name for name in stage.free if name not in self.traits.blocks]
            if foreign:
                raise ValueError(f"stage {stage.name!r} frees {foreign[0]!r}, which needs system = 'deep-energies'")
        if self.system == "face-it" and self.camera.projection == "orthographic":
            raise ValueError("an orthographic camera needs system = 'deep-energies'")
        if not any(stage.enabled and stage.when == "always" for stage in self.stages):
            raise ValueError("no enabled stage runs on every frame: enable one with when = 'always'")
        return self

    @model_validator(mode="before")
    @classmethod
    def _default_stages(cls, data: Any):
        return {"stages": PRESET_STAGES[DEFAULT_PRESET], **data} if isinstance(data, dict) else data


def validated(stored: dict[str, Any], origin: str) -> Config:
    """The configuration with these values. Raises `ConfigError` for the first problem; `origin` names its source."""
    try:
        return Config.model_validate(stored)
    except ValidationError as error:
        raise ConfigError(f"{origin}: {shortened(_first_problem(error), LONGEST_PROBLEM)}") from error


def _first_problem(error: ValidationError) -> str:
    problem = error.errors()[0]
    place = shortened(".".join(str(part) for part in problem["loc"]))
    if problem["type"] == "value_error":
        said = str(problem["ctx"]["error"])
        return f"{place + ': ' if place else ''}{said}{'' if said.endswith(('.', '?')) else '.'}"
    if problem["type"] == "extra_forbidden":
        known = _known_keys(problem["loc"][:-1])
        near = difflib.get_close_matches(str(problem["loc"][-1]), known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"the keys here are {', '.join(known)}."
        return f"there is no key {place!r}; {hint}"
    return f"{place}: {problem['msg']} (got {quoted(problem.get('input'))})."


def quoted(value: Any) -> str:
    """A value as messages show it: shortened if it is long."""
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
