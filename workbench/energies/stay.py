"""Terms that hold parameters where they are expected: the pose's prior (Deep Energies Sec. 5), and that of the flow
(Sec. 7)."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.energies.context import TermContext
from workbench.face.jaw import in_blendshapes
from workbench.face.parameters import FaceParameters


def pose_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "6"]:
    """Distance of the pose from the expected one, a radian counted as `rotation_mm` millimetres."""
    turned = jnp.asarray(parameters.rotation) - context.start.rotation
    moved = jnp.asarray(parameters.translation) - context.start.translation
    return jnp.concatenate([context.constants.rotation_mm * turned, moved])


def expression_residual(parameters: FaceParameters, context: TermContext) -> Float[Array, "n"]:
    """Distance of blendshapes and jaw from the expected ones, the jaw counted in blendshapes."""
    moved = jnp.asarray(parameters.expression) - context.start.expression
    if not len(parameters.jaw):
        return moved
    jaw = jnp.asarray(parameters.jaw) - context.start.jaw
    return jnp.concatenate([moved, in_blendshapes(jaw, context.jaw_unit)])
