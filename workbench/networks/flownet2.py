"""FlowNet2 (Ilg et al., CVPR 2017): the network that Deep Energies uses for optical flow, all five parts of it.

FlowNetC compares the features of both pictures over ±160 pixels. Two FlowNetS in turn correct its flow, each with the
second picture warped by the flow so far. FlowNetSD sees small motion, and a fusion makes one flow of both. Layers and
names of arrays are those of NVIDIA's flownet2-pytorch. Its published weights come from the authors' Caffe models, which
are for research only; they are not part of the workbench: a user supplies the file.
"""

from collections.abc import Iterable
from functools import partial
from itertools import pairwise
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.errors import InputError, ModelError
from workbench.networks.flow_network import enlarged, similarities
from workbench.networks.layers import Conv, TransposedConv, empty_conv, empty_transposed_conv, enlarge
from workbench.networks.torch_checkpoints import read_checkpoint
from workbench.networks.weights import Weights, fill

NAME = "flownet2"
"""Value of the metadata key `architecture`."""
WIDTH = 64
"""Channels of the first convolutions in the published weights; all others are multiples or parts of it."""
MULTIPLE = 64
"""Sides are halved six times."""
FLOW_UNIT = 20.0
"""Pixels that FlowNetC and FlowNetS count as 1; FlowNetSD counts as many for one pixel."""
FINEST = 2
"""They end at a quarter of the size: halvings."""
REACH = 10
"""FlowNetC compares ten places to each side, two pixels of an eighth of the size apart."""
SLOPE = 0.1
"""Of the leaky ReLU below 0."""

Layer = Conv | TransposedConv


class FlowNet(eqx.Module):
    """One of the five: an encoder that halves the size and a decoder that corrects the flow from coarse to fine.

    At level n, after n halvings: conv‹n› and conv‹n›_1 (encoder), deconv‹n› (doubles the maps of the level below),
    predict_flow‹n›, inter_conv‹n› before it in some, and upsampled_flow‹n+1›_to_‹n›. A tuple holds the one layer with
    weights of a PyTorch Sequential.
    """

    layers: dict[str, tuple[Layer] | Layer]

    def step(self, name: str, x: Float[Array, "h w c"]) -> Float[Array, "h2 w2 d"]:
        """One layer and the leaky ReLU."""
        return _leaky(self.layers[name][0](x))

    def encoded(self, x: Float[Array, "h w c"], levels: Iterable[int]) -> dict[int, Float[Array, "_ _ _"]]:
        """The encoder's maps by level."""
        maps = {}
        for level in levels:
            x = self.step(f"conv{level}", x)
            if f"conv{level}_1" in self.layers:
                x = self.step(f"conv{level}_1", x)
            maps[level] = x
        return maps

    def decoded(self, maps: dict[int, Float[Array, "_ _ _"]], finest: int = FINEST) -> Float[Array, "h w 2"]:
        """The flow at the finest level, in the network's own unit; `maps` are the encoder's."""
        coarsest = max(maps)
        x = maps[coarsest]
        flow = self.layers[f"predict_flow{coarsest}"](x)
        for level in range(coarsest - 1, finest - 1, -1):
            raised = self.step(f"deconv{level}", x)
            x = jnp.concatenate([maps[level], raised, self.layers[f"upsampled_flow{level + 1}_to_{level}"](flow)], -1)
            between = self.layers.get(f"inter_conv{level}")
            flow = self.layers[f"predict_flow{level}"](x if between is None else between[0](x))
        return flow


class FlowNet2(eqx.Module):
    """The network; arrays are named as in NVIDIA's state dict."""

    flownetc: FlowNet
    flownets_1: FlowNet
    flownets_2: FlowNet
    flownets_d: FlowNet
    flownetfusion: FlowNet

    @property
    def multiple(self) -> int:
        """What sides must be multiples of."""
        return MULTIPLE

    @property
    def smallest_side(self) -> int:
        """One pixel at the coarsest level."""
        return MULTIPLE

    def __call__(self, first: Float[AnyArray, "3 h w"], second: Float[AnyArray, "3 h w"]) -> Float[Array, "2 h w"]:
        """Flow from the first to the second picture in pixels; RGB in 0..1, sides multiples of 64."""
        return jnp.moveaxis(self.flows(first, second)["flownetfusion"], -1, 0)

    def flows(
        self, first: Float[AnyArray, "3 h w"], second: Float[AnyArray, "3 h w"]
    ) -> dict[str, Float[Array, "h w 2"]]:
        """What each part says at the pictures' size, in pixels as the parts after it take it; raises `InputError`."""
        height, width = first.shape[1:]
        if second.shape != first.shape or height % MULTIPLE or width % MULTIPLE or not height * width:
            raise InputError(
                f"FlowNet2 sees two pictures of one size whose sides are multiples of {MULTIPLE}, got "
                f"{width} × {height} and {second.shape[2]} × {second.shape[1]}; resize them"
            )
        first, second = (jnp.moveaxis(jnp.asarray(picture), 0, -1) for picture in (first, second))
        mean = (first.mean(axis=(0, 1)) + second.mean(axis=(0, 1))) / 2
        first, second = first - mean, second - mean
        rough = FLOW_UNIT * enlarged(_compared_flow(self.flownetc, first, second), 4)
        better = FLOW_UNIT * enlarged(_corrected_flow(self.flownets_1, first, second, rough), 4)
        # What the fusion sees is enlarged by repeating pixels, and FlowNetSD's flow is divided where the others are
        # multiplied: so it was in the Caffe model that was trained (flownet2-pytorch's issue 37).
        large = FLOW_UNIT * _repeated(_corrected_flow(self.flownets_2, first, second, better))
        pair = jnp.concatenate([first, second], axis=-1)
        small = _repeated(self.flownets_d.decoded(self.flownets_d.encoded(pair, range(7)))) / FLOW_UNIT
        errors = [lengths(first - warped(second, flow)) for flow in (small, large)]
        seen = jnp.concatenate([first, small, large, lengths(small), lengths(large), *errors], axis=-1)
        fused = self.flownetfusion.decoded(self.flownetfusion.encoded(seen, range(3)), finest=0)
        return {
            "flownetc": rough,
            "flownets_1": better,
            "flownets_2": large,
            "flownets_d": small,
            "flownetfusion": fused,
        }


def _compared_flow(
    network: FlowNet, first: Float[Array, "h w 3"], second: Float[Array, "h w 3"]
) -> Float[Array, "h4 w4 2"]:
    """FlowNetC: each picture to an eighth of its size, their correlation, and the rest of the encoder on it."""
    one, two = (network.encoded(picture, (1, 2)) for picture in (first, second))
    deep, other = (network.step("conv3", maps[2]) for maps in (one, two))
    costs = _leaky(correlation(deep, other))
    x = network.step("conv3_1", jnp.concatenate([network.step("conv_redir", deep), costs], axis=-1))
    return network.decoded({2: one[2], 3: x, **network.encoded(x, (4, 5, 6))})


def _corrected_flow(
    network: FlowNet, first: Float[Array, "h w 3"], second: Float[Array, "h w 3"], flow: Float[Array, "h w 2"]
) -> Float[Array, "h4 w4 2"]:
    """FlowNetS, which sees the second picture warped by the flow so far, and what differs then."""
    there = warped(second, flow)
    seen = jnp.concatenate([first, second, there, flow / FLOW_UNIT, lengths(first - there)], axis=-1)
    return network.decoded(network.encoded(seen, range(1, 7)))


def correlation(first: Float[Array, "h w c"], second: Float[Array, "h w c"]) -> Float[Array, "h w 441"]:
    """Mean products of each vector with those at 21×21 places two pixels apart, row by row; zero beyond the border.

    Steps of two stay among even or odd rows and columns: each of these four parts, of half the size, is compared alone.
    Sides are even.
    """
    height, width, channels = first.shape
    halved = (height // 2, width // 2)

    def parts(x):
        return x.reshape(halved[0], 2, halved[1], 2, channels).transpose(1, 3, 0, 2, 4).reshape(4, *halved, channels)

    near = jax.vmap(partial(similarities, reach=REACH))(parts(first), parts(second)) / channels
    return near.reshape(2, 2, *halved, -1).transpose(2, 0, 3, 1, 4).reshape(height, width, -1)


def warped(picture: Float[Array, "h w c"], flow: Float[Array, "h w 2"]) -> Float[Array, "h w c"]:
    """The picture read bilinearly where the flow points to; beyond the border its last pixels go on."""
    height, width, _ = picture.shape
    rows, columns = jnp.indices((height, width)).astype(flow.dtype)
    x, y = columns + flow[..., 0], rows + flow[..., 1]
    left, top = (lax.stop_gradient(jnp.floor(place)) for place in (x, y))
    right_share, lower_share = (x - left)[..., None], (y - top)[..., None]

    def at(row, column):
        return picture[jnp.clip(row, 0, height - 1).astype(int), jnp.clip(column, 0, width - 1).astype(int)]

    upper = (1 - right_share) * at(top, left) + right_share * at(top, left + 1)
    lower = (1 - right_share) * at(top + 1, left) + right_share * at(top + 1, left + 1)
    return (1 - lower_share) * upper + lower_share * lower


def lengths(vectors: Float[Array, "h w c"]) -> Float[Array, "h w 1"]:
    """√Σv², with derivative 0 where it is 0."""
    squares = (vectors * vectors).sum(axis=-1, keepdims=True)
    there = squares > 0
    return jnp.where(there, jnp.sqrt(jnp.where(there, squares, 1.0)), 0.0)


def empty_flownet2(width: int = WIDTH) -> FlowNet2:
    """The network with zero weights; `width`, a multiple of 4, is the number of channels at its start."""
    half, quarter = width // 2, width // 4
    skips = {2: 2 * width, 3: 4 * width, 4: 8 * width, 5: 8 * width, 6: 16 * width}
    raised = {2: width, 3: 2 * width, 4: 4 * width, 5: 8 * width}
    coarse = _coarse_encoder(width)
    simple = {
        **_wide_encoder(12, width),
        "conv3_1": (empty_conv(4 * width, 4 * width, 3),),
        **coarse,
        **_decoder(skips, raised, bias=False),
    }
    compared = {
        **_wide_encoder(3, width),
        "conv_redir": (empty_conv(4 * width, half, 1),),
        "conv3_1": (empty_conv(half + (2 * REACH + 1) ** 2, 4 * width, 3),),
        **coarse,
        **_decoder(skips, raised),
    }
    small = {
        **_fine_encoder(6, width),
        "conv3": (empty_conv(2 * width, 4 * width, 3, stride=2),),
        "conv3_1": (empty_conv(4 * width, 4 * width, 3),),
        **coarse,
        **_decoder(skips, raised, between=True),
    }
    fusion = {
        **_fine_encoder(11, width),
        **_decoder({0: width, 1: 2 * width, 2: 2 * width}, {0: quarter, 1: half}, between=True),
    }
    return FlowNet2(*(FlowNet(layers) for layers in (compared, simple, simple, small, fusion)))


def _wide_encoder(inputs: int, width: int) -> dict[str, tuple[Layer]]:
    """To an eighth of the size with large kernels."""
    return {
        "conv1": (empty_conv(inputs, width, 7, stride=2),),
        "conv2": (empty_conv(width, 2 * width, 5, stride=2),),
        "conv3": (empty_conv(2 * width, 4 * width, 5, stride=2),),
    }


def _fine_encoder(inputs: int, width: int) -> dict[str, tuple[Layer]]:
    """From full size to a quarter with small kernels."""
    return {
        "conv0": (empty_conv(inputs, width, 3),),
        "conv1": (empty_conv(width, width, 3, stride=2),),
        "conv1_1": (empty_conv(width, 2 * width, 3),),
        "conv2": (empty_conv(2 * width, 2 * width, 3, stride=2),),
        "conv2_1": (empty_conv(2 * width, 2 * width, 3),),
    }


def _coarse_encoder(width: int) -> dict[str, tuple[Layer]]:
    """From an eighth of the size to a 64th."""
    channels = (4 * width, 8 * width, 8 * width, 16 * width)
    layers = {}
    for level, (inputs, outputs) in enumerate(pairwise(channels), start=4):
        layers[f"conv{level}"] = (empty_conv(inputs, outputs, 3, stride=2),)
        layers[f"conv{level}_1"] = (empty_conv(outputs, outputs, 3),)
    return layers


def _decoder(
    skips: dict[int, int], raised: dict[int, int], *, between: bool = False, bias: bool = True
) -> dict[str, tuple[Layer] | Layer]:
    """Channels by level: `skips` from the encoder, `raised` from below. `bias`: whether what doubles flow has one."""
    seen = {level: skips[level] + (raised[level] + 2 if level in raised else 0) for level in skips}
    layers: dict[str, tuple[Layer] | Layer] = {}
    for level, channels in seen.items():
        last = between and level in raised
        layers[f"predict_flow{level}"] = empty_conv(raised[level] if last else channels, 2, 3)
        if last:
            layers[f"inter_conv{level}"] = (empty_conv(channels, raised[level], 3),)
        if level in raised:
            layers[f"deconv{level}"] = (empty_transposed_conv(seen[level + 1], raised[level]),)
            layers[f"upsampled_flow{level + 1}_to_{level}"] = empty_transposed_conv(2, 2, bias=bias)
    return layers


def read_flownet2(path: str | Path) -> FlowNet2:
    """The network of NVIDIA's checkpoint (`FlowNet2_checkpoint.pth.tar`) or of a converted file.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    return flownet2_from(read_checkpoint(path))


def flownet2_from(weights: Weights) -> FlowNet2:
    """As `read_flownet2`, of weights in memory. The width is that of the file: narrower networks are read too."""
    if weights.architecture not in (None, NAME):
        raise ModelError(f"{weights.origin} should hold {NAME}, but its metadata names {weights.architecture}")
    start = weights.arrays.get("flownetfusion.conv0.0.weight")
    if start is None:
        some = ", ".join(list(weights.arrays)[:3]) or "no arrays"
        raise ModelError(
            f"{weights.origin} should hold FlowNet2 with arrays such as flownetfusion.conv0.0.weight, got {some}: "
            "supply NVIDIA's FlowNet2_checkpoint.pth.tar (FlowNet2-C, -CS, -CSS, -S and -SD are parts of it alone)"
        )
    width = start.shape[0] // 4 * 4 if start.ndim else WIDTH
    return fill(lambda: empty_flownet2(width), weights)


def looks_like_flownet2(weights: Weights) -> bool:
    """Whether these are of FlowNet2, or of one of its parts."""
    return any("predict_flow" in name for name in weights.arrays)


def _repeated(field: Float[Array, "h w c"]) -> Float[Array, "h4 w4 c"]:
    """Four times the size, every pixel repeated: `interpolate(scale_factor=4, mode="nearest")`."""
    return enlarge(enlarge(field))


def _leaky(x: Float[Array, "h w c"]) -> Float[Array, "h w c"]:
    return jax.nn.leaky_relu(x, SLOPE)
