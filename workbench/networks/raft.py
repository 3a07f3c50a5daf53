"""RAFT (Teed & Deng, ECCV 2020) in its small form as published with torchvision: `raft_small`.

Features at an eighth of the size, products of all pairs, and a recurrent unit that reads them around where the flow
points to and corrects it, twelve times. The published weights are not part of the workbench: a user supplies the file.
"""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.errors import InputError, ModelError
from workbench.networks.layers import Conv, empty_conv, halve
from workbench.networks.torch_checkpoints import read_checkpoint
from workbench.networks.weights import Weights, fill

NAME = "raft-small"
"""Value of the metadata key `architecture`."""
STRIDE, SMALLEST_SIDE = 8, 128
LEVELS, REACH = 4, 3
"""Halvings of the products plus one, and how far around the flow's target they are read at each."""
HIDDEN, CONTEXT = 96, 64
"""Channels of the recurrent unit's state, and of its context from the first picture."""
UPDATES = 12
NORM_EPSILON = 1e-5
"""PyTorch's `InstanceNorm2d.eps`."""


class Bottleneck(eqx.Module):
    """Three convolutions in a row (1×1, 3×3, 1×1), and the input added. A tuple holds the one layer with weights."""

    convnormrelu1: tuple[Conv]
    convnormrelu2: tuple[Conv]
    convnormrelu3: tuple[Conv]
    downsample: tuple[Conv] | None

    def __call__(self, x: Float[Array, "h w c"], norm) -> Float[Array, "h2 w2 d"]:
        """The block's maps; `norm` follows each convolution."""
        y = x
        for layer in (self.convnormrelu1, self.convnormrelu2, self.convnormrelu3):
            y = jax.nn.relu(norm(layer[0](y)))
        beside = x if self.downsample is None else norm(self.downsample[0](x))
        return jax.nn.relu(beside + y)


class Encoder(eqx.Module):
    """A picture to maps of an eighth of its size."""

    convnormrelu: tuple[Conv]
    layer1: tuple[Bottleneck, Bottleneck]
    layer2: tuple[Bottleneck, Bottleneck]
    layer3: tuple[Bottleneck, Bottleneck]
    conv: Conv

    def __call__(self, x: Float[Array, "h w 3"], norm) -> Float[Array, "h8 w8 c"]:
        """The encoder's maps; `norm` follows each convolution but the last."""
        x = jax.nn.relu(norm(self.convnormrelu[0](x)))
        for block in (*self.layer1, *self.layer2, *self.layer3):
            x = block(x, norm)
        return self.conv(x)


class MotionEncoder(eqx.Module):
    """What the recurrent unit receives about flow and correlation."""

    convcorr1: tuple[Conv]
    convflow1: tuple[Conv]
    convflow2: tuple[Conv]
    conv: tuple[Conv]

    def __call__(self, flow: Float[Array, "h w 2"], products: Float[Array, "h w c"]) -> Float[Array, "h w 82"]:
        """The maps, the flow itself last."""
        seen = jax.nn.relu(self.convcorr1[0](products))
        moved = jax.nn.relu(self.convflow2[0](jax.nn.relu(self.convflow1[0](flow))))
        both = jax.nn.relu(self.conv[0](jnp.concatenate([seen, moved], axis=-1)))
        return jnp.concatenate([both, flow], axis=-1)


class Gru(eqx.Module):
    """A gated recurrent unit of convolutions."""

    convz: Conv
    convr: Conv
    convq: Conv

    def __call__(self, state: Float[Array, "h w s"], x: Float[Array, "h w c"]) -> Float[Array, "h w s"]:
        """The next state."""
        both = jnp.concatenate([state, x], axis=-1)
        update, reset = jax.nn.sigmoid(self.convz(both)), jax.nn.sigmoid(self.convr(both))
        proposed = jnp.tanh(self.convq(jnp.concatenate([reset * state, x], axis=-1)))
        return (1 - update) * state + update * proposed


class RecurrentBlock(eqx.Module):
    """The one unit that the small form has."""

    convgru1: Gru


class FlowHead(eqx.Module):
    """State to the flow's correction."""

    conv1: Conv
    conv2: Conv

    def __call__(self, state: Float[Array, "h w s"]) -> Float[Array, "h w 2"]:
        """In pixels of the eighth."""
        return self.conv2(jax.nn.relu(self.conv1(state)))


class UpdateBlock(eqx.Module):
    """One step of the recurrence."""

    motion_encoder: MotionEncoder
    recurrent_block: RecurrentBlock
    flow_head: FlowHead

    def __call__(self, state, context, products, flow) -> tuple[Array, Array]:
        """The next state, and the flow's correction."""
        x = jnp.concatenate([context, self.motion_encoder(flow, products)], axis=-1)
        state = self.recurrent_block.convgru1(state, x)
        return state, self.flow_head(state)


class RaftSmall(eqx.Module):
    """The network; arrays are named as in torchvision's state dict."""

    feature_encoder: Encoder
    context_encoder: Encoder
    update_block: UpdateBlock
    updates: int = eqx.field(static=True, default=UPDATES)

    @property
    def multiple(self) -> int:
        """What sides must be multiples of."""
        return STRIDE

    @property
    def smallest_side(self) -> int:
        """The products of smaller pictures cannot be halved three times."""
        return SMALLEST_SIDE

    def __call__(self, first: Float[AnyArray, "3 h w"], second: Float[AnyArray, "3 h w"]) -> Float[Array, "2 h w"]:
        """Flow from the first to the second picture in pixels; RGB in 0..1, sides multiples of 8 and at least 128."""
        return jnp.moveaxis(STRIDE * _enlarged(self.flows(first, second)[-1], STRIDE), -1, 0)

    def flows(
        self, first: Float[AnyArray, "3 h w"], second: Float[AnyArray, "3 h w"]
    ) -> Float[Array, "updates h8 w8 2"]:
        """The flow after each update, in its own pixels."""
        height, width = first.shape[1:]
        if second.shape != first.shape or height % STRIDE or width % STRIDE or min(height, width) < SMALLEST_SIDE:
            raise InputError(
                f"RAFT sees two pictures of one size whose sides are multiples of {STRIDE} and at least "
                f"{SMALLEST_SIDE}, got {width} × {height} and {second.shape[2]} × {second.shape[1]}; resize them"
            )
        first, second = (2 * jnp.moveaxis(jnp.asarray(picture), 0, -1) - 1 for picture in (first, second))
        one, two = (self.feature_encoder(picture, instance_norm) for picture in (first, second))
        pyramid = product_pyramid(one, two)
        told = self.context_encoder(first, lambda x: x)
        state, context = jnp.tanh(told[..., :HIDDEN]), jax.nn.relu(told[..., HIDDEN:])
        rows, columns = jnp.indices(one.shape[:2]).astype(one.dtype)
        start = jnp.stack([columns, rows], axis=-1)

        def update(carried, _):
            state, flow = carried
            state, change = self.update_block(state, context, products_around(pyramid, start + flow), flow)
            return (state, flow + change), flow + change

        return lax.scan(update, (state, jnp.zeros_like(start)), length=self.updates)[1]


def product_pyramid(
    first: Float[Array, "h w c"], second: Float[Array, "h w c"]
) -> list[Float[Array, "h w _ _"]]:  # fmt: skip
    """Products of each vector of the first with all of the second over √c, and those halved, three times."""
    products = jnp.einsum("ijc,klc->ijkl", first, second) / first.shape[-1] ** 0.5
    pyramid = [products]
    for _ in range(LEVELS - 1):
        height, width = (2 * (side // 2) for side in products.shape[2:])
        products = jax.vmap(lambda row: jnp.moveaxis(halve(jnp.moveaxis(row, 0, -1)), -1, 0))(
            products[:, :, :height, :width]
        )
        pyramid.append(products)
    return pyramid


def products_around(
    pyramid: list[Float[Array, "h w _ _"]], target: Float[Array, "h w 2"]
) -> Float[Array, "h w n"]:  # fmt: skip
    """The products around each target (x, y) at every level, bilinear, zero beyond the border; x varies more slowly."""
    found = []
    for level, products in enumerate(pyramid):
        height, width = products.shape[2:]
        place = target / 2**level
        corner = lax.stop_gradient(jnp.floor(place))
        share = place - corner
        reach = jnp.arange(-REACH, REACH + 2)
        columns, rows = (corner[..., axis, None].astype(jnp.int32) + reach for axis in (0, 1))
        there = ((columns >= 0) & (columns < width))[..., :, None] & ((rows >= 0) & (rows < height))[..., None, :]
        i, j = jnp.indices(products.shape[:2])
        window = products[
            i[..., None, None],
            j[..., None, None],
            jnp.clip(rows, 0, height - 1)[..., None, :],
            jnp.clip(columns, 0, width - 1)[..., :, None],
        ]
        window = jnp.where(there, window, 0.0)
        right, down = share[..., 0, None, None], share[..., 1, None, None]
        window = window[..., :-1, :] * (1 - right) + window[..., 1:, :] * right
        window = window[..., :-1] * (1 - down) + window[..., 1:] * down
        found.append(window.reshape(*window.shape[:2], -1))
    return jnp.concatenate(found, axis=-1)


def instance_norm(x: Float[Array, "h w c"]) -> Float[Array, "h w c"]:
    """Mean 0 and variance 1 in each channel, as `torch.nn.InstanceNorm2d` without weights."""
    centred = x - x.mean(axis=(0, 1))
    return centred * lax.rsqrt((centred * centred).mean(axis=(0, 1)) + NORM_EPSILON)


def empty_raft(updates: int = UPDATES) -> RaftSmall:
    """The network with zero weights."""
    gru = HIDDEN + CONTEXT + 82
    return RaftSmall(
        feature_encoder=_empty_encoder(128),
        context_encoder=_empty_encoder(HIDDEN + CONTEXT),
        update_block=UpdateBlock(
            motion_encoder=MotionEncoder(
                convcorr1=(empty_conv(LEVELS * (2 * REACH + 1) ** 2, 96, 1),),
                convflow1=(empty_conv(2, 64, 7),),
                convflow2=(empty_conv(64, 32, 3),),
                conv=(empty_conv(128, 80, 3),),
            ),
            recurrent_block=RecurrentBlock(Gru(*(empty_conv(gru, HIDDEN, 3) for _ in range(3)))),
            flow_head=FlowHead(empty_conv(HIDDEN, 128, 3), empty_conv(128, 2, 3)),
        ),
        updates=updates,
    )


def _empty_encoder(outputs: int) -> Encoder:
    return Encoder(
        convnormrelu=(empty_conv(3, 32, 7, stride=2),),
        layer1=(_empty_bottleneck(32, 32, 1), _empty_bottleneck(32, 32, 1)),
        layer2=(_empty_bottleneck(32, 64, 2), _empty_bottleneck(64, 64, 1)),
        layer3=(_empty_bottleneck(64, 96, 2), _empty_bottleneck(96, 96, 1)),
        conv=empty_conv(96, outputs, 1),
    )


def _empty_bottleneck(inputs: int, outputs: int, stride: int) -> Bottleneck:
    inner = outputs // 4
    return Bottleneck(
        convnormrelu1=(empty_conv(inputs, inner, 1),),
        convnormrelu2=(empty_conv(inner, inner, 3, stride=stride),),
        convnormrelu3=(empty_conv(inner, outputs, 1),),
        downsample=None if stride == 1 else (empty_conv(inputs, outputs, 1, stride=stride),),
    )


def read_raft(path: str | Path) -> RaftSmall:
    """The network of torchvision's checkpoint (`raft_small_C_T_V2-….pth`) or of a converted file.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    return raft_from(read_checkpoint(path))


def raft_from(weights: Weights, updates: int = UPDATES) -> RaftSmall:
    """As `read_raft`, of weights in memory."""
    if weights.architecture not in (None, NAME):
        raise ModelError(f"{weights.origin} should hold {NAME}, but its metadata names {weights.architecture}")
    if not looks_like_raft(weights) or any("mask_predictor" in name for name in weights.arrays):
        some = ", ".join(list(weights.arrays)[:3]) or "no arrays"
        raise ModelError(
            f"{weights.origin} should hold torchvision's raft_small with arrays such as "
            f"update_block.flow_head.conv1.weight, got {some}: supply raft_small_C_T_V2-….pth (raft_large is another "
            "network, and the original RAFT release names its arrays differently)"
        )
    return fill(lambda: empty_raft(updates), weights)


def looks_like_raft(weights: Weights) -> bool:
    """Whether these are of a RAFT of torchvision, small or large."""
    return "update_block.flow_head.conv1.weight" in weights.arrays


def _enlarged(field: Float[Array, "h w c"], factor: int) -> Float[Array, "h2 w2 c"]:
    """`factor` times the size, bilinear with the corners' centres kept, as `interpolate(align_corners=True)`."""
    for axis in (0, 1):
        count = field.shape[axis]
        place = jnp.linspace(0, count - 1, factor * count).astype(field.dtype)
        first = jnp.clip(jnp.floor(place).astype(int), 0, count - 2)
        share = (place - first).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1)).astype(field.dtype)
        near, far = jnp.take(field, first, axis=axis), jnp.take(field, first + 1, axis=axis)
        field = near + share * (far - near)
    return field
