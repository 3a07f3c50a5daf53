"""The presets: the papers' energies and ours, each with its schedule."""

from typing import Any

from workbench.config.configuration import Config, quoted
from workbench.config.schedules import DEEP_STAGES, OUR_PARALLEL_STAGES, PARALLEL_STAGES, PRESET_STAGES
from workbench.config.sections import (
    CameraConfig,
    ConstantsConfig,
    ContourConfig,
    DeepConfig,
    FlowConfig,
    IdentityConfig,
    InfillConfig,
    LandmarksConfig,
    SolverConfig,
    WeightsConfig,
    own_weights,
)
from workbench.errors import ConfigError


def _preset_weights(preset: str) -> Any:
    """The ω values of a preset, from the table."""
    return WeightsConfig(**{term.name: term.presets[preset] for term in own_weights() if preset in term.presets})


# Common to the presets with the papers' names: pixels, no bounds, no confidences, nothing that slides, edges all alike.
AS_PRINTED: dict[str, Any] = {
    "solver": SolverConfig(bounded=False, unit="px"),
    "landmarks": LandmarksConfig(confidence=False),
    "contour": ContourConfig(mode="fixed"),
    "constants": ConstantsConfig(rotation_mm=1.0, weighted_edges=False),
}
# Sec. 8.2 prints E_2 = λw and calls it L2 regularisation. As the vector λw beside the residuals E_1, λ = 100 would keep
# the mouth half shut; as λ‖w‖² it opens as in the paper's figures. The paper prints no weight of Sec. 8.1's E_2.
DEEP_AS_PRINTED: dict[str, Any] = {
    "derivative": "forward",
    "edges": 1.0,
    "regularisation": 100.0,
    "lambda_reading": "energy",
}
# Secs. 6, 7 and 8.3. A point is downweighted (`robust`) only where it is off by 1,000 % of the eye distance: never.
FLOW_AS_PRINTED: dict[str, Any] = {
    "flow": FlowConfig(estimator="network", side=512, renders="network", robust=1000.0, stay=0.0),
    "infill": InfillConfig(passes="back-and-forth", lids="flow"),
}

PRESETS: dict[str, Config] = {
    # FACE IT!: the paper's terms, constants, schedule and iterations, and no identity. It prints no values of ω.
    "face-it": Config(
        preset="face-it",
        weights=_preset_weights("face-it"),
        identity=IdentityConfig(calibrate=False),
        stages=PRESET_STAGES["face-it"],
        **AS_PRINTED,
    ),
    # The same alternation with a calibrated identity, weights bounded to [0, 1] and a contour that slides with yaw.
    "calibrated": Config(
        preset="calibrated", weights=_preset_weights("calibrated"), stages=PRESET_STAGES["calibrated"]
    ),
    # Ours: pose and expression as one problem with 50 unknowns, because the alternation gets stuck.
    "joint": Config(preset="joint", weights=_preset_weights("joint"), stages=PRESET_STAGES["joint"]),
    # The same with the pupils: eyes that turn.
    "gaze": Config(
        preset="gaze",
        weights=_preset_weights("gaze"),
        landmarks=LandmarksConfig(detector="network+pupils", weights={"irises": 3.0}),
        stages=PRESET_STAGES["gaze"],
    ),
    # Ours after Wood et al. (ECCV 2022): the same problem on points of the whole face, each by its own covariance.
    # Those beyond the 68 err alike where they are neighbours, and together are worth less than their number.
    "dense": Config(
        preset="dense",
        weights=_preset_weights("dense"),
        landmarks=LandmarksConfig(detector="dense", weights={"dense": 0.05, "irises": 0.1}),
        stages=PRESET_STAGES["dense"],
    ),
    # Deep Energies as printed. Of its stages the order and the free parameters are; iteration limits and W are ours.
    "deep-energies": Config(
        preset="deep-energies",
        system="deep-energies",
        deep=DeepConfig(**DEEP_AS_PRINTED),
        stages=DEEP_STAGES,
        **AS_PRINTED,
        **FLOW_AS_PRINTED,
    ),
    # The same with the energy of Appendix C.1.
    "preselected-points": Config(
        preset="preselected-points",
        system="deep-energies",
        deep=DeepConfig(energy="points", **DEEP_AS_PRINTED),
        stages=DEEP_STAGES,
        **AS_PRINTED,
        **FLOW_AS_PRINTED,
    ),
    # Appendix C.2: parallel projection with a scale, the mean face and the first 10 + 10 components, no priors.
    "orthographic": Config(
        preset="orthographic",
        system="deep-energies",
        camera=CameraConfig(projection="orthographic"),
        identity=IdentityConfig(calibrate=False),
        deep=DeepConfig(appearance="model", identity=0.0, **DEEP_AS_PRINTED),
        stages=PARALLEL_STAGES,
        **AS_PRINTED,
        **FLOW_AS_PRINTED,
    ),
    # Ours: the same stages with errors in percent of the outer-eye distance, confidences, bounds on weights and jaw,
    # weighted edges, a sliding contour, a derivative that costs a tenth, and two networks' mean as N.
    "deep": Config(preset="deep", system="deep-energies", deep=DeepConfig(network="ensemble"), stages=DEEP_STAGES),
    "deep-points": Config(
        preset="deep-points", system="deep-energies", deep=DeepConfig(energy="points"), stages=DEEP_STAGES
    ),
    # Ours after C.2: priors on shape and expression, and a shape that does not explain the mouth.
    "deep-parallel": Config(
        preset="deep-parallel",
        system="deep-energies",
        camera=CameraConfig(projection="orthographic"),
        identity=IdentityConfig(calibrate=False),
        deep=DeepConfig(appearance="model"),
        stages=OUR_PARALLEL_STAGES,
    ),
}


FACE_IT_PRESETS = tuple(name for name, config in PRESETS.items() if config.system == "face-it")


def preset(name: str) -> Config:
    """The preset with this name. Raises `ConfigError` if there is none."""
    if name not in PRESETS:
        raise ConfigError(f"There is no preset {quoted(name)}; the presets are {', '.join(PRESETS)}.")
    return PRESETS[name]
