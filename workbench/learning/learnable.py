"""What can be learned by gradient: settings that every fit moves smoothly with.

Each is scaled: its learned number is the logarithm of a factor of its value in the configuration that learning starts
from, 0 at the start. What is 0 stays 0.
"""

from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from workbench.arrays import AnyArray
from workbench.config import Config
from workbench.config.schedules import ALL_GROUPS
from workbench.config.sections import WeightsConfig
from workbench.energies import TABLE, stage_factors
from workbench.errors import ConfigError
from workbench.geometry import Camera
from workbench.landmarks.scheme import IBUG68, POINT_COUNT, LandmarkScheme
from workbench.learning.chain import Weighing
from workbench.planning import plan_of

POINTS = "landmarks.weights"
FOV = "camera.fov_deg"
CONSTANTS = ("constants.delta", "constants.rotation_mm")
OMEGAS = tuple(f"weights.{name}" for name in WeightsConfig.model_fields)
LEARNABLE = (*OMEGAS, POINTS, *CONSTANTS, FOV)
"""Paths of all settings with a gradient. `landmarks.weights` are 68 factors, one a landmark; further points of a scheme
keep what they weigh."""
WIDEST_FOV_DEG = 170.0
"""Learning goes no farther: at 180° the focal length is 0."""
FARTHEST = float(np.log(100.0))
"""No factor goes farther from 1 than 100."""
DIGITS = 4
"""Significant digits of a learned value in a configuration."""

Logs = Mapping[str, Float[AnyArray, "m"]]
"""By path: logarithms of the factors, one number, or one a landmark."""


def start_of(config: Config, paths: Sequence[str]) -> dict[str, Float[np.ndarray, "m"]]:
    """The factors that learning starts from: all 1.

    Raises `ConfigError` for settings without a gradient, and for configurations whose fits have none.
    """
    check_smooth(config)
    for path in paths:
        if path not in LEARNABLE:
            raise ConfigError(
                f"{path!r} has no gradient; what can be learned is {', '.join(LEARNABLE)}. "
                "Limits, subsets and everything else can be searched (--search)."
            )
        if path != POINTS and _value(config, path) == 0.0:
            raise ConfigError(f"{path} is 0, and learning only scales values; start from a value above 0.")
    if FOV in paths and config.camera.matrix is not None:
        raise ConfigError("The camera is given as a matrix, which replaces camera.fov_deg; do not learn the latter.")
    if FOV in paths and config.camera.rig:
        raise ConfigError("The rig holds the lens (camera.rig), which replaces camera.fov_deg; do not learn it.")
    if not paths:
        raise ConfigError("There is nothing to learn; name settings, for example weights.tau landmarks.weights.")
    return {path: np.zeros(POINT_COUNT if path == POINTS else 1) for path in dict.fromkeys(paths)}


def limits_of(config: Config, paths: Sequence[str]) -> dict[str, tuple[float, float]]:
    """The least and the most logarithm that each setting may have, so that its value stays one that it can have."""
    widest = max(float(np.log(WIDEST_FOV_DEG / config.camera.fov_deg)), 0.0)
    return {path: (-FARTHEST, min(widest, FARTHEST) if path == FOV else FARTHEST) for path in paths}


def check_smooth(config: Config) -> None:
    """Raise `ConfigError` unless the fits of a configuration move smoothly with its settings."""
    if config.system != "face-it":
        raise ConfigError(
            "Gradients go through FACE IT!'s solver, and Deep Energies renders; start from joint, calibrated, gaze or "
            "dense (--preset)."
        )
    if config.compares_pictures:
        raise ConfigError("The flow term has no gradient by settings; take the term 'flow' out of the stages.")
    for name in sorted(config.summed_terms):
        term = TABLE[name]
        if not term.smooth and config.omega()[term.omega_key(config.system)] > 0.0:
            raise ConfigError(
                f"{term.omega_key(config.system)} is above 0, and {term.symbol} holds weights at a step or a kink, "
                "where there is no derivative; set it to 0 (the preset calibrated has smooth terms), or search "
                "(--search)."
            )


def weighing_of(config: Config, logs: Logs, camera: Camera, scheme: LandmarkScheme = IBUG68) -> Weighing:
    """What a configuration's fits to a scheme's landmarks are weighed with, at factors that may be traced; `camera` is
    the configuration's."""
    plan, factors = plan_of(config, scheme), {path: jnp.exp(jnp.asarray(log)) for path, log in logs.items()}
    omega = jnp.asarray(_factors(config, config.omega()))
    for path in OMEGAS:
        omega = jnp.where(_below(config, path), omega * _scalar(factors, path), omega) if path in factors else omega
    by_point = jnp.ones(len(scheme)).at[:POINT_COUNT].multiply(factors.get(POINTS, 1.0))
    constants = {path.split(".")[1]: _scalar(factors, path) for path in CONSTANTS}
    constants = {name: getattr(plan.constants, name) * factor for name, factor in constants.items()}
    half = 0.5 * np.radians(config.camera.fov_deg)
    longer = jnp.tan(half) / jnp.tan(half * _scalar(factors, FOV))
    return Weighing(
        omega=omega,
        landmark_weights=jnp.stack([stage.landmark_weights * by_point for stage in plan.stages]),
        constants=plan.constants._replace(**constants),
        camera=Camera(*camera)._replace(focal_px=jnp.asarray(camera.focal_px) * longer),
    )


def _factors(config: Config, omega: Mapping[str, float]) -> Float[np.ndarray, "s t"]:
    terms, system = config.terms, config.system
    return np.array([stage_factors(omega, system, stage.free, stage.terms, terms) for stage in config.stages])


def _below(config: Config, path: str) -> Bool[np.ndarray, "s t"]:
    """Which factors an ω multiplies: those of the terms below it in the hierarchy."""
    omega = config.omega()
    return _factors(config, omega | {path: 2.0 * omega[path]}) > _factors(config, omega)


def learned(config: Config, logs: Logs) -> Config:
    """The configuration with its settings scaled, to four digits."""
    sections: dict[str, dict] = {}
    for path, log in logs.items():
        section, key = path.split(".")
        factors = np.exp(np.asarray(log, float))
        if path == POINTS:
            values = np.array(config.point_weights()) * factors
            by_point = {str(point): _rounded(value) for point, value in enumerate(values)}
            found = {**_beyond(config), **by_point}
        else:
            found = _rounded(_value(config, path) * factors[0])
        sections.setdefault(section, {})[key] = found
    return config.changed(**sections)


def _beyond(config: Config) -> dict[str, float]:
    """The weights of groups and points beyond the 68, which stay."""
    groups = {**ALL_GROUPS, **config.subsets}

    def last_point(name: str) -> int:
        return int(name) if name.isdigit() else max(groups[name], default=0)

    return {name: value for name, value in config.landmarks.weights.items() if last_point(name) >= POINT_COUNT}


def _scalar(factors: Logs, path: str):
    return factors[path][0] if path in factors else 1.0


def _value(config: Config, path: str) -> float:
    section, key = path.split(".")
    return float(getattr(getattr(config, section), key))


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}")
