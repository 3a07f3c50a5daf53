"""Lists of fixed length out of masks: what is few in a picture is worked on as a list."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

GROUP = 64
"""Entries of a mask that are looked at together first."""


def indices_of(mask: Bool[Array, "n"], capacity: int) -> tuple[Int[Array, "c"], Bool[Array, "c"], Int[Array, ""]]:
    """Indices of the true entries in ascending order, which of them are in use, and how many found no room.

    Unused indices are 0.
    """
    groups = jnp.pad(mask, (0, -len(mask) % GROUP)).reshape(-1, GROUP)
    # First the groups that have any: most of a picture has none, and a prefix sum over all of it costs more.
    group, group_used = _first(groups.any(axis=1), min(capacity, len(groups)))
    entries = (groups[group] & group_used[:, None]).ravel()
    place, used = _first(entries, capacity)
    index = group[place // GROUP] * GROUP + place % GROUP
    lost = jnp.maximum(mask.sum(dtype=jnp.int32) - capacity, 0)
    return jnp.where(used, index, 0), used, lost


def _first(mask: Bool[Array, "n"], capacity: int) -> tuple[Int[Array, "c"], Bool[Array, "c"]]:
    place = jnp.where(mask, jnp.cumsum(mask, dtype=jnp.int32) - 1, capacity)
    index = jnp.full(capacity, -1, jnp.int32).at[place].set(jnp.arange(len(mask), dtype=jnp.int32), mode="drop")
    return jnp.maximum(index, 0), index >= 0
