"""The unknowns of a fit as one named vector: unit, typical size, range, and what a stage may move of it.

FACE IT!, Deep Energies, flow and identity calibration take the blocks that they need, in this order.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from workbench.arrays import AnyArray
from workbench.errors import ConfigError
from workbench.face.jaw_unit import USUAL_JAW, JawUnit
from workbench.face.landmark_model import seen_shapes
from workbench.face.model import FaceModel
from workbench.face.parameters import FaceParameters
from workbench.landmarks.scheme import lip_distance


@dataclass(frozen=True)
class Unknown:
    """A block of the vector."""

    unit: str
    typical: tuple[float, ...]
    """Usual change within a stage, one for all entries or one each: trust regions are round in unknowns divided by
    it. The jaw's is that of `USUAL_JAW`."""


UNKNOWNS = {
    "rotation": Unknown("radians, axis-angle", (0.1,)),
    "translation": Unknown("millimetres", (10.0,)),
    "expression": Unknown("blendshape weights", (0.3,)),
    "identity": Unknown("standard deviations", (1.0,)),
    "jaw": Unknown("radians, axis-angle; then millimetres", (0.1, 0.1, 0.1, 3.0, 3.0, 3.0)),
    "scale": Unknown("1", (0.05,)),
}
BLOCKS = tuple(UNKNOWNS)
FIRST = "first:"
"""What begins the number of a stage's shapes, as in first:10."""
MOUTH_OPENS_MM = 3.0
"""A mouth that opens parts its lips farther than this."""


def pack(parameters: FaceParameters, blocks: tuple[str, ...] = BLOCKS) -> Float[AnyArray, "n"]:
    """Some blocks of the parameters as one vector."""
    return jnp.concatenate([jnp.asarray(getattr(parameters, name), float) for name in blocks])


def unpack(
    vector: Float[AnyArray, "n"], parameters: FaceParameters, blocks: tuple[str, ...] = BLOCKS
) -> FaceParameters:
    """`parameters` with these blocks replaced by the entries of `vector`."""
    return parameters._replace(**{name: vector[slot] for name, slot in slots(parameters, blocks).items()})


def slots(parameters: FaceParameters, blocks: tuple[str, ...] = BLOCKS) -> dict[str, slice]:
    """Position of each block in the vector."""
    ends = np.cumsum([len(getattr(parameters, name)) for name in blocks]).tolist()
    return {name: slice(start, end) for name, start, end in zip(blocks, [0, *ends], ends, strict=False)}


def typical_sizes(
    parameters: FaceParameters, blocks: tuple[str, ...] = BLOCKS, jaw_unit: JawUnit = USUAL_JAW
) -> Float[np.ndarray, "n"]:
    """The typical size of every entry of the vector, the jaw's in proportion to the model's unit."""
    sizes = {name: np.broadcast_to(UNKNOWNS[name].typical, len(getattr(parameters, name))) for name in blocks}
    if len(sizes.get("jaw", ())):
        sizes["jaw"] = sizes["jaw"] * jaw_unit.relative
    return np.concatenate([sizes[name] for name in blocks])


def derivative_by_columns(
    of: Callable[[FaceParameters], Float[AnyArray, "*shape"]],
    parameters: FaceParameters,
    columns: Int[AnyArray, "c"],
    blocks: tuple[str, ...] = BLOCKS,
    jaw_unit: JawUnit = USUAL_JAW,
) -> Float[AnyArray, "c *shape"]:
    """Forward-mode derivative of a function by some of the scaled unknowns; 0 for columns that do not exist."""
    vector, sizes = pack(parameters, blocks), jnp.asarray(typical_sizes(parameters, blocks, jaw_unit))
    tangents = jax.nn.one_hot(columns, len(vector), dtype=vector.dtype) * sizes

    def along(tangent):
        return jax.jvp(lambda at: of(unpack(at, parameters, blocks)), (vector,), (tangent,))[1]

    return jax.vmap(along)(tangents)


def parameter_range(model: FaceModel, bounded: bool) -> tuple[FaceParameters, FaceParameters]:
    """Least and largest value of every parameter; blendshapes have none unless `bounded`."""
    limits, (lowest, highest) = [], model.weight_range().T
    for sign, expression, jaw in ((-1.0, lowest, model.jaw_range[0]), (1.0, highest, model.jaw_range[1])):
        limits.append(
            FaceParameters(
                rotation=np.full(3, sign * np.inf),
                translation=np.full(3, sign * np.inf),
                expression=np.array(expression, float) if bounded else np.full(len(expression), sign * np.inf),
                identity=np.full(len(model.identity_deltas), sign * np.inf),
                jaw=np.array(jaw, float),
                scale=np.full(1, sign * np.inf),
            )
        )
    return limits[0], limits[1]


def free_parameters(
    model: FaceModel, free: Sequence[str], shapes: Sequence[str] = (), parallel: bool = False, stage: str = ""
) -> FaceParameters:
    """True for what a stage moves, shaped like the parameters; never a blendshape that no landmark sees, nor the
    distance of a head that is seen in `parallel` projection.

    `free` names blocks, or `jaw_open` for the joint's opening alone. `shapes` chooses blendshapes by name, start of
    name, or first:N, which also holds for the components of the identity; empty: all. Raises `ConfigError`, which names
    the `stage`, for shapes that the model lacks.
    """
    freed = FaceParameters(
        rotation=np.full(3, "rotation" in free),
        translation=np.full(3, "translation" in free),
        expression=np.zeros(len(model.expression_names), bool),
        identity=np.zeros(len(model.identity_deltas), bool),
        jaw=np.full(6, "jaw" in free),
        scale=np.full(1, "scale" in free),
    )
    if "expression" in free:
        freed.expression[:] = _chosen(model.expression_names, shapes, stage) & seen_shapes(model)
    if "identity" in free:
        counted = [shape for shape in shapes if shape.startswith(FIRST)]  # components have no names
        freed.identity[:] = _chosen([""] * len(model.identity_deltas), counted, stage)
    freed.jaw[0] |= "jaw_open" in free
    freed.translation[2] &= not parallel
    return freed


def keeps_the_mouth_shut(model: FaceModel, shapes: Sequence[str]) -> bool:
    """Whether none of the chosen blendshapes, each as far as it goes, parts the lips by `MOUTH_OPENS_MM`."""
    chosen = _chosen(model.expression_names, shapes, "")
    parted = lip_distance(model.landmarks.of(model.expression_deltas[chosen]))
    farthest = parted * np.abs(model.weight_range()).max(axis=1)[chosen]
    return bool(farthest.max(initial=0.0) < MOUTH_OPENS_MM)


def _chosen(names: Sequence[str], shapes: Sequence[str], stage: str) -> Bool[np.ndarray, "k"]:
    if not shapes:
        return np.ones(len(names), bool)
    chosen = np.zeros(len(names), bool)
    for shape in shapes:
        if shape.startswith(FIRST):
            chosen[: int(shape.removeprefix(FIRST))] = True
            continue
        found = np.array([name.startswith(shape) for name in names])
        if not found.any():
            raise ConfigError(
                f"Stage {stage!r} frees the blendshapes {shape!r}, which this model does not have; "
                "name blendshapes, the start of their names, or first:N."
            )
        chosen |= found
    return chosen
