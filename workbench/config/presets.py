"""The presets: the papers' energies and ours, each with its schedule."""

from typing import Any

from workbench.config.configuration import Config, quoted
from workbench.config.schedules import DEEP_STAGES, PARALLEL_STAGES, PRESET_STAGES
from workbench.config.sections import (
    CameraConfig,
    ContourConfig,
    DeepConfig,
    IdentityConfig,
    SolverConfig,
    WeightsConfig,
    own_weights,
)
from workbench.errors import ConfigError


def _preset_weights(preset: str) -> Any:
    """The ω of a preset, from the table."""
    return WeightsConfig(**{term.name: term.presets[preset] for term in own_weights() if preset in term.presets})


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


def preset(name: str) -> Config:
    """A named preset. Raises `ConfigError` for a name that does not exist."""
    if name not in PRESETS:
        raise ConfigError(f"There is no preset {quoted(name)}; the presets are {', '.join(PRESETS)}.")
    return PRESETS[name]
