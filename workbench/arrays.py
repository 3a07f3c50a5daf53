"""Names for the kinds of number that functions here take."""

import jax
import numpy as np
from jaxtyping import Float, Int

AnyArray = jax.Array | np.ndarray
"""NumPy's on the host, JAX's on a device or under a trace."""
Scalar = Float[AnyArray, ""] | float
Count = Int[AnyArray, ""] | int
