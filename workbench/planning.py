"""From a configuration to the plan of a run, at the door: below it nobody reads a configuration."""

from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from workbench.config import Config, Stage, preset
from workbench.energies import TABLE, EnergyConstants
from workbench.errors import ConfigError
from workbench.face import load_character
from workbench.face.characters import PLAIN, own_file
from workbench.geometry import read_rig
from workbench.landmarks.scheme import IBUG68, LandmarkScheme
from workbench.landmarks.schemes import DENSE
from workbench.rendering import CharacterLook, character_look, plain_look
from workbench.tracking.deep_target import network_scheme
from workbench.tracking.plan import (
    CameraPlan,
    DeepPlan,
    FlowPlan,
    IdentityPlan,
    InfillPlan,
    Plan,
    RefinementPlan,
    SolverPlan,
    StagePlan,
)

Section = TypeVar("Section", IdentityPlan, DeepPlan, FlowPlan, InfillPlan, RefinementPlan)


def plan_of(config: Config, scheme: LandmarkScheme = IBUG68) -> Plan:
    """The plan of a configuration for landmarks of a scheme.

    Raises `InputError` and `ConfigError` for a rig that cannot be used, and for landmarks that the system cannot.
    """
    points = np.array(config.point_weights(scheme))
    if config.traits.renders:
        _check_network(config, scheme)
        # The gaze is held where the model has it: an iris in the photo says nothing about the head.
        points[list(scheme.groups.get("irises", ()))] = 0.0
    return Plan(
        system=config.system,
        terms=config.terms,
        linked=any(TABLE[name].links_frames for name in config.summed_terms),
        compares_pictures=config.compares_pictures,
        stages=tuple(_stage(config, stage, points, scheme) for stage in config.stages),
        camera=camera_plan(config),
        solver=SolverPlan(
            config.solver.method, config.solver.bounded, config.solver.tolerance, config.solver.unit == "percent"
        ),
        constants=EnergyConstants(**{name: float(value) for name, value in config.constants.model_dump().items()}),
        sliding=config.contour.mode == "sliding",
        point_weights=points,
        confident=config.landmarks.confidence,
        identity=identity_plan(config),
        deep=_taken(DeepPlan, config.deep),
        flow=_taken(FlowPlan, config.flow),
        infill=infill_plan(config),
        refinement=refinement_plan(config),
        by_points=plan_of(_by_points(config, scheme), scheme) if config.traits.renders else None,
        look=_look(config.head.character) if config.renders_character else None,
    )


def identity_plan(config: Config) -> IdentityPlan:
    """How a face's shape is calibrated.

    With a guessed lens millimetres mean little, and the size is free: the shape comes closer to the points.
    """
    plan = _taken(IdentityPlan, config.identity)
    return replace(plan, size=0.0) if config.camera.guessed else plan


def infill_plan(config: Config) -> InfillPlan:
    """Which frames of a track are usable, and how others are filled."""
    return _taken(InfillPlan, config.infill)


def refinement_plan(config: Config) -> RefinementPlan:
    """How a track is steadied."""
    return _taken(RefinementPlan, config.refinement)


def camera_plan(config: Config) -> CameraPlan:
    """The camera or the rig, of which the files are read.

    Raises `InputError` and `ConfigError` for a rig that cannot be used.
    """
    camera = config.camera
    if camera.rig and camera.projection == "orthographic":
        raise ConfigError("A rig's cameras are perspective; set camera.projection or leave camera.rig empty.")
    return CameraPlan(
        fov_deg=camera.fov_deg,
        matrix=None if camera.matrix is None else np.array(camera.matrix),
        distortion=np.array(camera.distortion, float),
        parallel=camera.projection == "orthographic",
        rig=read_rig(Path(camera.rig)) if camera.rig else None,
    )


def _look(character: str) -> CharacterLook:
    """A character as renders show it; raises `ModelError` for one that cannot be read."""
    file = own_file(character)
    return _look_of(character, file.stat().st_mtime_ns if file is not None and file.is_file() else None)


@lru_cache(maxsize=2)
def _look_of(character: str, _written_ns: int | None) -> CharacterLook:
    """A character's look as of when its file was written: a character may be written again."""
    return plain_look() if character == PLAIN else character_look(load_character(character))


def _stage(config: Config, stage: Stage, points: np.ndarray, scheme: LandmarkScheme) -> StagePlan:
    return StagePlan(
        name=stage.name,
        enabled=stage.enabled,
        first_only=stage.when == "start",
        free=stage.free,
        shapes=stage.shapes,
        limit=stage.limit,
        landmark_weights=np.multiply(stage.landmark_weights(config.subsets, scheme), points),
        omega=np.array(config.factors(stage)),
    )


def _taken(kind: type[Section], section: Any) -> Section:
    """The values of a section that a plan has."""
    return kind(**{field.name: getattr(section, field.name) for field in fields(kind)})


def _check_network(config: Config, scheme: LandmarkScheme) -> None:
    """Raise `ConfigError` for landmarks that are not what N sees, and for a dense one in a rig."""
    seen = network_scheme(config.deep.network)
    if seen is not scheme:
        detector = "dense" if seen is DENSE else "network"
        other = 'deep.network = "dense"' if scheme is DENSE else f'landmarks.detector = "{detector}"'
        raise ConfigError(
            f"Deep Energies compares photo and render at the {len(seen)} points of its network, and these landmarks "
            f"are the {len(scheme)} of {scheme.name!r}; set {other}, or choose a FACE IT! preset."
        )
    if config.camera.rig and scheme is DENSE:
        raise ConfigError(
            'A dense network looks through one camera; set deep.network = "ensemble" or leave camera.rig empty.'
        )


def _by_points(config: Config, scheme: LandmarkScheme) -> Config:
    """FACE IT!'s configuration for identity and first pose, with this one's camera, landmarks and identity.

    Of a rig it looks through the first camera.
    """
    camera = config.camera.model_copy(update={"projection": "perspective"})
    base = preset("dense" if scheme is DENSE else "joint")
    kept = {name: getattr(config, name) for name in ("identity", "subsets", "contour")}
    weights = {**base.landmarks.weights, **config.landmarks.weights}
    kept["landmarks"] = config.landmarks.model_copy(update={"weights": weights})
    return base.model_copy(update={**kept, "camera": camera})
