"""Names for the kinds of number that functions here take, and the library that computes with them."""

from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

AnyArray = jax.Array | np.ndarray
"""NumPy's on the host, JAX's on a device or under a trace."""
Scalar = Float[AnyArray, ""] | float
Count = Int[AnyArray, ""] | int


def shapes_of(arguments: object) -> tuple[jax.tree_util.PyTreeDef, tuple[jax.ShapeDtypeStruct, ...]]:
    """What a program is compiled for: the structure of its arguments, and the shape and kind of each array in them."""
    leaves, tree = jax.tree.flatten(arguments)
    return tree, tuple(jax.ShapeDtypeStruct(np.shape(leaf), np.asarray(leaf).dtype) for leaf in leaves)


def library_of(*arrays: AnyArray | float) -> ModuleType:
    """`jax.numpy` where one of the arrays is JAX's, else `numpy`: one formula, on the host without a dispatch."""
    return jnp if any(isinstance(array, jax.Array) for array in arrays) else np
