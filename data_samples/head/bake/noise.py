"""Smooth pseudo-random fields that need no stored state, so that paint is the same on every machine."""

import numpy as np
from jaxtyping import Float


def noise(points: Float[np.ndarray, "n d"], seed: int) -> Float[np.ndarray, "n"]:
    """Value noise in 0..1 with one lattice cell per unit, smoothly interpolated, in any dimension."""
    cell = np.floor(points).astype(np.int64)
    share = points - cell
    share = share * share * (3 - 2 * share)
    total = np.zeros(len(points))
    dimensions = points.shape[1]
    for corner in np.ndindex(*(2,) * dimensions):
        offset = np.array(corner)
        weight = np.prod(np.where(offset == 1, share, 1 - share), axis=1)
        total += weight * _hashed(cell + offset, seed)
    return total


def _hashed(cell: np.ndarray, seed: int) -> np.ndarray:
    """A well mixed 0..1 number for every integer cell (multiply-xor hash of 32 bits)."""
    primes = np.array([0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D], np.uint64)[: cell.shape[1]]
    mask = np.uint64(0xFFFFFFFF)
    mixed = (cell.astype(np.uint64) * primes).sum(axis=1, dtype=np.uint64) + np.uint64(seed * 7919)
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        mixed &= mask
        mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
    mixed &= mask
    return (mixed ^ (mixed >> np.uint64(16))).astype(float) / 2**32
