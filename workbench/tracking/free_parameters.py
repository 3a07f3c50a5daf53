"""What may move and how far: the free parameters of stages, and the range of each parameter."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool

from workbench.errors import ConfigError
from workbench.face import FaceModel, FaceParameters, seen_shapes
from workbench.tracking.plan import StagePlan

JAW_LOWER = (-0.05, -0.25, -0.15, -12.0, -6.0, -12.0)
JAW_UPPER = (0.70, 0.25, 0.15, 12.0, 12.0, 12.0)
"""Range of the jaw joint: radians about x (opening), y, z, then millimetres. It suits the default head and is taken for
every model."""


def free_parameters(model: FaceModel, stages: Iterable[StagePlan], parallel: bool = False) -> FaceParameters:
    """True for what any of the stages frees, shaped like the parameters of a fit; never a blendshape that no landmark
    sees, nor the distance of a head that is seen in `parallel` projection.

    Raises `ConfigError` for blendshapes that the model lacks.
    """
    free = FaceParameters(
        rotation=np.zeros(3, bool),
        translation=np.zeros(3, bool),
        expression=np.zeros(len(model.expression_names), bool),
        identity=np.zeros(len(model.identity_deltas), bool),
        jaw=np.zeros(6, bool),
        scale=np.zeros(1, bool),
    )
    for stage in stages:
        for name in stage.free:
            if name in ("rotation", "translation", "scale"):
                getattr(free, name)[:] = True
            elif name == "jaw_open":
                free.jaw[0] = True
            elif name == "jaw":
                free.jaw[:] = True
            else:
                names = model.expression_names if name == "expression" else [""] * len(model.identity_deltas)
                getattr(free, name)[:] |= _chosen_shapes(stage, tuple(names))
    free.expression[:] &= seen_shapes(model)
    if parallel:
        free.translation[2] = False
    return free


def parameter_range(model: FaceModel, bounded: bool) -> tuple[FaceParameters, FaceParameters]:
    """Least and largest value of every parameter; blendshapes have none unless `bounded`."""
    limits, (lowest, highest) = [], model.weight_range().T
    for sign, expression, jaw in ((-1.0, lowest, JAW_LOWER), (1.0, highest, JAW_UPPER)):
        limits.append(
            FaceParameters(
                rotation=np.full(3, sign * np.inf),
                translation=np.full(3, sign * np.inf),
                expression=np.array(expression, float) if bounded else np.full(len(expression), sign * np.inf),
                identity=np.full(len(model.identity_deltas), sign * np.inf),
                jaw=np.array(jaw),
                scale=np.full(1, sign * np.inf),
            )
        )
    return limits[0], limits[1]


def _chosen_shapes(stage: StagePlan, names: tuple[str, ...]) -> Bool[np.ndarray, "k"]:
    if not stage.shapes:
        return np.ones(len(names), bool)
    chosen = np.zeros(len(names), bool)
    for shape in stage.shapes:
        if shape.startswith("first:"):
            chosen[: int(shape.removeprefix("first:"))] = True
            continue
        found = np.array([name.startswith(shape) for name in names])
        if not found.any():
            raise ConfigError(
                f"Stage {stage.name!r} frees the blendshapes {shape!r}, which this model does not have; "
                "name blendshapes, the start of their names, or first:N."
            )
        chosen |= found
    return chosen
