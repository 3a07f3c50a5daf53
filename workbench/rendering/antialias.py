"""Smooth contours, with the derivative that a picture has where surfaces end.

A pixel's colour is the mean over its square. Where a contour runs through it, moving the contour by v changes that
mean by ∫ (c_in − c_out) (v·n) dl along the piece inside the pixel: this is the whole derivative of visibility, and a
renderer that only differentiates its shading misses it (Li et al. 2018, "Differentiable Monte Carlo Ray Tracing
through Edge Sampling", where the same integral is sampled at random; here each piece is integrated exactly).
"""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from workbench.rendering.contours import ContourPieces


def blend_shares(pieces: ContourPieces, inside: Bool[Array, "n"], pixel_count: int) -> Float[Array, "n"]:
    """How far the colour of a pixel's centre has to move by each of its pieces' (c_in − c_out) to be the pixel's mean.

    `inside` says whether the centre shows the surface in front. The pieces in a pixel that agree in this are taken for
    one contour, and together stand for a straight line with their mean normal through their mean middle; the share of
    the pixel's square inside this line is exact. A contour that ends within the pixel counts in part.
    """
    index = jnp.arange(len(inside), dtype=jnp.int32)
    used = pieces.length > 0.0
    place = 2 * pieces.pixel + inside
    first = jnp.zeros(2 * pixel_count, jnp.int32).at[jnp.where(used, place, 2 * pixel_count)].max(index, mode="drop")
    contour = first[place]
    length = pieces.length[:, None]
    columns = jnp.concatenate([pieces.outward, pieces.middle, jnp.ones_like(length)], axis=1)
    sums = jnp.zeros((len(index), 5), jnp.float32).at[contour].add(length * columns)[contour]
    normal, middle, total = sums[:, :2], sums[:, 2:4], jnp.maximum(sums[:, 4], 1e-6)
    span = jnp.maximum(jnp.linalg.norm(normal, axis=1), 1e-6)
    distance = (normal * middle).sum(axis=1) / (span * total)
    share, chord = half_plane_in_square(normal / span[:, None], distance)
    part = jnp.minimum(total / jnp.maximum(chord, 1e-6), 1.0)
    return jnp.where(used, (share - inside) * part * pieces.length / total, 0.0)


def half_plane_in_square(
    normal: Float[Array, "n 2"], distance: Float[Array, "n"]
) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
    """Area of {q in the unit square around 0: n·q ≤ d} and the length of its straight side, for unit normals n."""
    large = jnp.maximum(jnp.abs(normal[:, 0]), jnp.abs(normal[:, 1]))
    small = jnp.minimum(jnp.abs(normal[:, 0]), jnp.abs(normal[:, 1]))
    outer, inner = 0.5 * (large + small), 0.5 * (large - small)
    beyond = jnp.clip(outer - jnp.abs(distance), 0.0, 2.0 * outer)
    slope = jnp.maximum(large * small, 1e-6)
    middle = jnp.abs(distance) <= inner
    cut = jnp.where(middle, 0.5 - jnp.abs(distance) / large, 0.5 * beyond * beyond / slope)
    chord = jnp.where(middle, 1.0 / large, beyond / slope)
    return jnp.where(distance >= 0.0, 1.0 - cut, cut), chord


def contour_change(
    pieces: ContourPieces, shares: Float[Array, "n"], a: Float[Array, "n 2"], b: Float[Array, "n 2"],
    inside: Float[Array, "n c"], outside: Float[Array, "n c"],
) -> Float[Array, "n c"]:  # fmt: skip
    """What each piece adds to its pixel; a and b are the ends of its edge, the only thing here that moves.

    The value smooths the picture. The displacement is zero in value and carries the derivative.
    """
    middle = a + (b - a) * pieces.place[:, None]
    displacement = ((middle - lax.stop_gradient(middle)) * pieces.outward).sum(axis=1)
    jump = inside - outside
    return shares[:, None] * jump + (pieces.length * displacement)[:, None] * lax.stop_gradient(jump)
