"""The jaw joint: linear blend skinning with six degrees of freedom (Deep Energies Sec. 3), next to the blendshapes.

A joint alone opens the mouth like a hinge; the blendshape `jawOpen` also shapes the lips. What the shape does beyond
the hinge is kept as a corrective in proportion to the angle, so that the joint at the model's own opening angle
(`JawUnit`) is that shape at weight 1.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from workbench.arrays import AnyArray
from workbench.face.jaw_unit import JAW_SHAPES, USUAL_JAW, JawUnit
from workbench.face.model import FaceModel
from workbench.geometry import rotation_matrix

# Programs hold the unit as constants: it never changes within a model.
jax.tree_util.register_static(JawUnit)


class JawJoint(NamedTuple):
    """What skinning needs, for some points of a model."""

    weights: Float[AnyArray, "v"]
    joint: Float[AnyArray, "3"]
    """Pivot of the mean identity, head frame, millimetres."""
    joint_identity: Float[AnyArray, "i 3"]
    corrective: Float[AnyArray, "v 3"]
    """`jawOpen` minus the hinge at the unit's angle, millimetres."""
    unit: JawUnit = USUAL_JAW
    """The model's."""


def jaw_joint(model: FaceModel) -> JawJoint:
    """The jaw joint of a face model; one that moves nothing if the model has none."""
    count, identities = len(model.neutral), len(model.identity_deltas)
    if "jaw" not in model.joints:
        still = np.zeros(count), np.zeros(3), np.zeros((identities, 3)), np.zeros((count, 3))
        return JawJoint(*still, model.jaw_unit)
    joint = np.asarray(model.joints["jaw"], float)
    made = JawJoint(
        np.asarray(model.jaw_weights, float),
        joint,
        model.identity_joint_deltas["jaw"],
        np.zeros((count, 3)),
        model.jaw_unit,
    )
    if "jawOpen" not in model.expression_names:
        return made
    opened = np.zeros(6)
    opened[0] = np.radians(made.unit.open_deg)
    hinge = np.asarray(move_jaw(made, model.neutral, np.zeros(identities), opened)) - model.neutral
    return made._replace(corrective=model.expression_deltas[model.expression_names.index("jawOpen")] - hinge)


def move_jaw(
    joint: JawJoint,
    vertices_head: Float[AnyArray, "v 3"],
    identity: Float[AnyArray, "i"],
    jaw: Float[AnyArray, "6"],
) -> Float[AnyArray, "v 3"]:
    """v + w·(R(v − J) + J + t − v), plus the corrective; head frame, millimetres. `jaw` is axis-angle, translation."""
    pivot = joint.joint
    if len(identity):
        pivot = pivot + identity @ joint.joint_identity
    turned = (vertices_head - pivot) @ rotation_matrix(jaw[:3]).T + pivot + jaw[3:]
    moved = vertices_head + jnp.asarray(joint.weights)[:, None] * (turned - vertices_head)
    return moved + jaw[0] / np.radians(joint.unit.open_deg) * joint.corrective


def posed_vertices(
    person: FaceModel,
    expression: Float[np.ndarray, "k"],
    jaw: Float[np.ndarray, "6"],
    scale: float | int = 1.0,
) -> Float[np.ndarray, "v 3"]:
    """x(w) of a person (identity baked in), jaw joint and scale included: head frame, millimetres."""
    vertices = person.vertices(expression)
    if np.any(jaw):
        vertices = np.asarray(move_jaw(jaw_joint(person), vertices, np.zeros(0), np.asarray(jaw, float)), float)
    return vertices if scale == 1.0 else scale * vertices


def in_blendshapes(jaw: Float[AnyArray, "*n 6"], unit: JawUnit) -> Float[AnyArray, "*n 6"]:
    """The joint's motion counted in jaw blendshapes, its unit in every term: 1 is what a shape moves at weight 1."""
    return jaw / unit.vector


def jaw_of_weights(model: FaceModel, expression: Float[np.ndarray, "k"]) -> Float[np.ndarray, "6"]:
    """The joint motion nearest to the jaw blendshapes of an expression."""
    weight = {
        name: float(expression[model.expression_names.index(name)]) if name in model.expression_names else 0.0
        for name in JAW_SHAPES
    }
    jaw, unit = np.zeros(6), model.jaw_unit
    jaw[0] = np.radians(unit.open_deg) * weight["jawOpen"]
    jaw[3] = unit.sideways_mm * (weight["jawLeft"] - weight["jawRight"])
    jaw[5] = -unit.forward_mm * weight["jawForward"]
    return jaw


def weights_with_jaw(
    names: tuple[str, ...], expression: Float[np.ndarray, "*n k"], jaw: Float[np.ndarray, "*n 6"], unit: JawUnit
) -> Float[np.ndarray, "*n k"]:
    """The expression with the joint's motion added as jaw blendshapes, for formats and characters without a joint.

    `unit` is that of the model that the joint belongs to. Turns about axes other than x have no blendshape and are
    lost.
    """
    weights, counted = np.array(expression, float), in_blendshapes(jaw, unit)
    parts = {
        "jawOpen": counted[..., 0],
        "jawForward": np.maximum(-counted[..., 5], 0.0),
        "jawLeft": np.maximum(counted[..., 3], 0.0),
        "jawRight": np.maximum(-counted[..., 3], 0.0),
    }
    for name, part in parts.items():
        if name in names:
            weights[..., names.index(name)] += part
    return weights
