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
    """The ω values of a preset, from the table."""
    return WeightsConfig(**{term.name: term.presets[preset] for term in own_weights() if preset in term.presets})


PRESETS: dict[str, Config] = {
    # The paper's terms and schedule: residuals in pixels, E_β and E_σ as single residuals, no bounds, one fixed
    # contour, no identity. The paper gives no values of ω; with these, E_fit dominates on a 640-pixel picture, and
    # weights run far beyond [0, 1]. Weighting points by their confidence is our addition.
    "face-it": Config(
        preset="face-it",
        weights=_preset_weights("face-it"),
        solver=SolverConfig(bounded=False, unit="px"),
        contour=ContourConfig(mode="fixed"),
        identity=IdentityConfig(calibrate=False),
        stages=PRESET_STAGES["face-it"],
    ),
    # The same alternation with a calibrated identity, weights bounded to [0, 1] and a contour that slides with yaw.
    "calibrated": Config(
        preset="calibrated", weights=_preset_weights("calibrated"), stages=PRESET_STAGES["calibrated"]
    ),
    # Ours: pose and expression as one problem with 50 unknowns, because the alternation gets stuck.
    "joint": Config(preset="joint", weights=_preset_weights("joint"), stages=PRESET_STAGES["joint"]),
    # Deep Energies: the order of the stages and their free parameters are the paper's. It gives no iteration limits, no
    # bounds, no W and no weight for its edge term: these are ours. So is λ: the paper's 100 goes with errors in pixels,
    # and in a residual λw it would be squared.
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
    """The preset with this name. Raises `ConfigError` if there is none."""
    if name not in PRESETS:
        raise ConfigError(f"There is no preset {quoted(name)}; the presets are {', '.join(PRESETS)}.")
    return PRESETS[name]
