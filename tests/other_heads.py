"""The default head in another size and with other jaw blendshapes, as models that bring no unit of the jaw along."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from workbench.face import FaceModel


def resized(head: FaceModel, size: float) -> FaceModel:
    """Every length times `size`."""
    return replace(
        head,
        name="resized",
        neutral=size * head.neutral,
        expression_deltas=size * head.expression_deltas,
        identity_deltas=size * head.identity_deltas,
        joints={name: size * place for name, place in head.joints.items()},
        identity_joint_deltas={name: size * moved for name, moved in head.identity_joint_deltas.items()},
        fixed_jaw_unit=None,
    )


def with_shapes(head: FaceModel, **shapes: np.ndarray) -> FaceModel:
    """Some blendshapes replaced by these offsets, millimetres."""
    deltas = head.expression_deltas.copy()
    for name, offsets in shapes.items():
        deltas[head.expression_names.index(name)] = offsets
    return replace(head, name="other-shapes", expression_deltas=deltas, fixed_jaw_unit=None)


def half_open(head: FaceModel) -> FaceModel:
    """A `jawOpen` that opens the mouth half as far."""
    return with_shapes(head, jawOpen=0.5 * head.expression_deltas[head.expression_names.index("jawOpen")])


def hinged(head: FaceModel, open_deg: float, sideways_mm: float, forward_mm: float) -> FaceModel:
    """Jaw blendshapes that the joint alone makes."""
    weights, arms = head.jaw_weights[:, None], head.neutral - head.joints["jaw"]
    turned = Rotation.from_euler("x", open_deg, degrees=True).apply(arms) - arms
    side, front = np.array([sideways_mm, 0.0, 0.0]), np.array([0.0, 0.0, -forward_mm])
    motions = {"jawOpen": turned, "jawLeft": side, "jawRight": -side, "jawForward": front}
    return with_shapes(head, **{name: weights * motion for name, motion in motions.items()})


def with_one_identity(head: FaceModel) -> FaceModel:
    """The mean face alone, without an identity basis, as a folder of OBJ files is."""
    return replace(head.personal(np.zeros(len(head.identity_deltas))), name="one-identity")
