"""One name for arrays of either kind: NumPy's on the host, JAX's on a device or under a trace."""

import jax
import numpy as np

AnyArray = jax.Array | np.ndarray
