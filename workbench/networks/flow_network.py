"""The workbench's own flow network: small, coarse to fine, differentiable in both pictures.

As in PWC-Net (Sun et al., CVPR 2018): features at a quarter to a 32nd of the size; at each level those of the second
picture are warped by the flow so far, compared with those of the first around each place, and a decoder corrects the
flow; at a quarter a second, narrower look refines it. Similarities are of unit vectors, so contrast does not matter.
Trained with batch normalisation, which is folded into the convolutions here.
"""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.errors import InputError, ModelError
from workbench.networks.encoder import BLOCKS, WIDTHS, network_size
from workbench.networks.layers import Conv, empty_conv, enlarge
from workbench.networks.weights import ARCHITECTURE, Weights, fill, read_weights, save_module

NAME = "face-energy-flow-1"
"""Value of the metadata key `architecture`."""
MIDDLE, SPREAD = 0.5, 0.25
"""The network sees (picture − 0.5) / 0.25."""
STRIDE, MULTIPLE = 4, 32
"""The finest flow is at every fourth pixel; sides are multiples of 32."""
REACH, REFINED_REACH = 3, 2
"""Places to each side that are compared, in pixels of the level."""
MATCHED, SHARPNESS = 32, 4.0
"""Length of the compared vectors; the similarity of equal ones."""
DECODER = (64, 48, 32)
"""Channels of a decoder's three convolutions."""


class Decoder(eqx.Module):
    """What changes a level's flow."""

    c0: Conv
    c1: Conv
    c2: Conv
    out: Conv

    def __call__(self, x: Float[Array, "h w c"]) -> tuple[Float[Array, "h w 2"], Float[Array, "h w d"]]:
        """The change of the flow, and the features that it was made of."""
        for conv in (self.c0, self.c1, self.c2):
            x = jax.nn.relu(conv(x))
        return self.out(x), x


class FlowNetwork(eqx.Module):
    """Stem, encoder (d down, e residual blocks), matched vectors (m) and decoder (g) of each level, refinement (r)."""

    stem: Conv
    d: tuple[Conv, ...]
    e: tuple[tuple[Conv, ...], ...]
    m: tuple[Conv, ...]
    g: tuple[Decoder, ...]
    """Level 0 is a quarter of the size."""
    r: Decoder

    @property
    def multiple(self) -> int:
        """What sides must be multiples of."""
        return MULTIPLE

    @property
    def smallest_side(self) -> int:
        """Less than two pixels at the coarsest level are no picture."""
        return 2 * MULTIPLE

    def __call__(self, first: Float[AnyArray, "3 h w"], second: Float[AnyArray, "3 h w"]) -> Float[Array, "2 h w"]:
        """Flow from the first to the second picture in pixels; RGB in 0..1, sides multiples of 32 and at least 64."""
        height, width = first.shape[1:]
        if second.shape != first.shape or height % MULTIPLE or width % MULTIPLE or min(height, width) < 2 * MULTIPLE:
            raise InputError(
                f"the flow network sees two pictures of one size whose sides are multiples of {MULTIPLE} and at least "
                f"{2 * MULTIPLE}, got {width} × {height} and {second.shape[2]} × {second.shape[1]}; resize them"
            )
        flow = self.levels(first, second)[-1]
        return jnp.moveaxis(STRIDE * enlarged(flow, STRIDE), -1, 0)

    def levels(self, first: Float[AnyArray, "3 h w"], second: Float[AnyArray, "3 h w"]) -> list[Float[Array, "_ _ 2"]]:
        """Flows at a 32nd, a 16th, an eighth and twice a quarter of the size, each in its own pixels."""
        one, two = (self._features(picture) for picture in (first, second))
        flow, features, flows = None, None, []
        for level in reversed(range(len(self.d))):
            if features is not None:
                flow, features = 2 * enlarged(flow, 2), enlarge(features)
            flow, features = _corrected(self.g[level], *one[level], two[level][1], flow, features, REACH)
            flows.append(flow)
        return [*flows, _corrected(self.r, *one[0], two[0][1], flow, features, REFINED_REACH)[0]]

    def _features(self, picture) -> list[tuple[Array, Array]]:
        """Context and vectors to match, from fine to coarse."""
        x = _step((jnp.moveaxis(jnp.asarray(picture), 0, -1) - MIDDLE) / SPREAD, self.stem)
        levels = []
        for down, blocks, match in zip(self.d, self.e, self.m, strict=True):
            x = _step(x, down)
            for block in blocks:
                x = x + _step(x, block)
            levels.append((x, _unit(match(x))))
        return levels


def empty_flow_network(widths: tuple[int, int, int, int], blocks: int) -> FlowNetwork:
    """The network with zero weights: channels per level, residual blocks on each."""
    half, last = widths[0] // 2, DECODER[-1]
    inputs = (half, *widths[:-1])
    more = (*[2 + last] * (len(widths) - 1), 0)
    cells = (2 * REACH + 1) ** 2
    return FlowNetwork(
        stem=empty_conv(3, half, 5, stride=2),
        d=tuple(empty_conv(a, b, 3, stride=2) for a, b in zip(inputs, widths, strict=True)),
        e=tuple(tuple(empty_conv(width, width, 3) for _ in range(blocks)) for width in widths),
        m=tuple(empty_conv(width, MATCHED, 1) for width in widths),
        g=tuple(_empty_decoder(cells + width + extra) for width, extra in zip(widths, more, strict=True)),
        r=_empty_decoder((2 * REFINED_REACH + 1) ** 2 + widths[0] + 2 + last),
    )


def read_flow_network(path: str | Path) -> FlowNetwork:
    """The network of a safetensors file whose metadata names its widths and blocks.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    return flow_network_from(read_weights(path))


def flow_network_from(weights: Weights) -> FlowNetwork:
    """As `read_flow_network`, of weights in memory."""
    if weights.architecture != NAME:
        raise ModelError(
            f"{weights.origin} should hold the weights of {NAME}, but its metadata names {weights.architecture}"
        )
    widths, blocks = network_size(weights)
    return fill(lambda: empty_flow_network(widths, blocks), weights)


def save_flow_network(path: str | Path, network: FlowNetwork, metadata: dict[str, str] | None = None) -> None:
    """Write the network with what `read_flow_network` needs; `metadata` is added (licence, training data, ...)."""
    widths = [conv.weight.shape[0] for conv in network.d]
    size = {WIDTHS: json.dumps(widths), BLOCKS: json.dumps(len(network.e[0]))}
    save_module(path, network, {**(metadata or {}), ARCHITECTURE: NAME, **size})


def similarities(
    first: Float[Array, "h w c"], second: Float[Array, "h w c"], reach: int
) -> Float[Array, "h w n"]:  # fmt: skip
    """Products of each vector with those around its place in the second maps, row by row from the upper left.

    As products of whole rows, of which a band is kept: XLA compiles that in a third of the time of single shifts.
    """
    height, width, _ = first.shape
    span = 2 * reach + 1
    padded = jnp.pad(second, ((reach, reach), (reach, reach), (0, 0)))
    rows = jnp.stack([padded[down : down + height] for down in range(span)])
    products = jnp.einsum("hwc,dhvc->hdwv", first, rows)
    # Padding shifts each row of the products by one more than the last: the band comes to stand upright.
    flat = jnp.pad(products.reshape(height, span, -1), ((0, 0), (0, 0), (0, width)))
    band = flat.reshape(height, span, width, -1)[..., :span]
    return jnp.swapaxes(band, 1, 2).reshape(height, width, span * span)


def warped(maps: Float[Array, "h w c"], flow: Float[Array, "h w 2"]) -> Float[Array, "h w c"]:
    """Maps read bilinearly where the flow points to; zeros beyond the border."""
    height, width, _ = maps.shape
    rows, columns = jnp.indices((height, width)).astype(flow.dtype)
    x, y = columns + flow[..., 0], rows + flow[..., 1]
    left, top = (lax.stop_gradient(jnp.floor(place)) for place in (x, y))
    total = 0.0
    for down in (0, 1):
        for right in (0, 1):
            column, row = left + right, top + down
            there = (column >= 0) & (column < width) & (row >= 0) & (row < height)
            weight = (1 - jnp.abs(x - column)) * (1 - jnp.abs(y - row))
            values = maps[jnp.clip(row, 0, height - 1).astype(int), jnp.clip(column, 0, width - 1).astype(int)]
            total = total + jnp.where(there, weight, 0.0)[..., None] * values
    return total


def enlarged(field: Float[Array, "h w c"], factor: int) -> Float[Array, "h2 w2 c"]:
    """`factor` times the size, bilinear with pixel edges kept, held at the borders."""
    for axis in (0, 1):
        count = field.shape[axis]
        place = jnp.clip((jnp.arange(factor * count) + 0.5) / factor - 0.5, 0, count - 1).astype(field.dtype)
        first = jnp.floor(place).astype(int)
        share = (place - first).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        near, far = (jnp.take(field, jnp.minimum(index, count - 1), axis=axis) for index in (first, first + 1))
        field = near + share * (far - near)
    return field


def _corrected(decoder: Decoder, context, first, second, flow, features, reach: int):
    if features is None:
        change, features = decoder(jnp.concatenate([similarities(first, second, reach), context], axis=-1))
        return change, features
    near = similarities(first, warped(second, flow), reach)
    change, features = decoder(jnp.concatenate([near, context, flow, features], axis=-1))
    return flow + change, features


def _step(x: Float[Array, "h w c"], conv: Conv) -> Float[Array, "h2 w2 d"]:
    return jax.nn.relu(conv(x))


def _unit(x: Float[Array, "h w c"]) -> Float[Array, "h w c"]:
    return x * (lax.rsqrt((x * x).sum(axis=-1, keepdims=True) + 1e-6) * SHARPNESS**0.5)


def _empty_decoder(inputs: int) -> Decoder:
    c0, c1, c2 = DECODER
    return Decoder(
        c0=empty_conv(inputs, c0, 3),
        c1=empty_conv(c0, c1, 3, dilation=2),
        c2=empty_conv(c1, c2, 3, dilation=4),
        out=empty_conv(c2, 2, 3),
    )
