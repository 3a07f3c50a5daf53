"""Trained weights as they are shipped."""

from pathlib import Path

import numpy as np

from workbench.networks import Weights, write_weights

NOTES = {"licence": "Apache-2.0", "data": "renders of the default head only"}
"""What a file says of itself."""


def write_shipped(path: Path, raw: Weights, seed: int, **measured: np.ndarray) -> None:
    """Write the weights in half precision, and in single what was `measured` with them."""
    arrays = {name: array.astype(np.float16) for name, array in raw.arrays.items()}
    arrays |= {name: array.astype(np.float32) for name, array in measured.items()}
    write_weights(path, arrays, {**raw.metadata, **NOTES, "seed": str(seed)})
