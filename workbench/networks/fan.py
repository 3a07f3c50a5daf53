"""The Face Alignment Network of Bulat & Tzimiropoulos (ICCV 2017): the network that Deep Energies uses as 3D-FAN.

Four stacked hourglasses of pre-activated blocks: 256×256 colours to 68 heat maps of 64×64, each a Gaussian of height 1
around its landmark. 2D-FAN has the same layers; only its weights differ. The published weights are not part of the
workbench: a user supplies the file.
"""

import re
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.errors import ModelError
from workbench.networks.layers import BatchNorm, Conv, empty_batch_norm, empty_conv, enlarge, halve
from workbench.networks.torch_checkpoints import read_checkpoint
from workbench.networks.weights import Weights, fill

NAME = "fan"
"""Value of the metadata key `architecture`."""

FEATURES, LANDMARKS, DEPTH = 256, 68, 4
"""Channels of the hourglasses, heat maps, halvings in each hourglass."""


class ConvBlock(eqx.Module):
    """Three 3×3 convolutions in a row, half, a quarter and a quarter of the channels, side by side in the result.

    Each is preceded by batch norm and ReLU; the input is added, through a 1×1 convolution where the channels differ.
    """

    bn1: BatchNorm
    conv1: Conv
    bn2: BatchNorm
    conv2: Conv
    bn3: BatchNorm
    conv3: Conv
    downsample: tuple[BatchNorm, None, Conv] | None
    """As PyTorch's Sequential numbers it: 0 the norm, 1 the ReLU (without weights), 2 the convolution."""

    def __call__(self, x: Float[Array, "h w c"]) -> Float[Array, "h w d"]:
        """The block's maps."""
        half = self.conv1(jax.nn.relu(self.bn1(x)))
        quarter = self.conv2(jax.nn.relu(self.bn2(half)))
        last = self.conv3(jax.nn.relu(self.bn3(quarter)))
        beside = x
        if self.downsample is not None:
            norm, _, conv = self.downsample
            beside = conv(jax.nn.relu(norm(x)))
        return jnp.concatenate([half, quarter, last], axis=-1) + beside


class HourGlass(eqx.Module):
    """Down to a 16th of the size and up again, with a branch at every size."""

    blocks: dict[str, ConvBlock]
    """b1_n (the branch), b2_n (after halving), b3_n (before enlarging) for n = 4 to 1, and b2_plus_1 at the bottom."""

    def __call__(self, x: Float[Array, "h w c"]) -> Float[Array, "h w c"]:
        """The hourglass's maps."""
        return self._level(DEPTH, x)

    def _level(self, level: int, x: Float[Array, "h w c"]) -> Float[Array, "h w c"]:
        branch = self.blocks[f"b1_{level}"](x)
        low = self.blocks[f"b2_{level}"](halve(x))
        low = self._level(level - 1, low) if level > 1 else self.blocks["b2_plus_1"](low)
        return branch + enlarge(self.blocks[f"b3_{level}"](low))


class Fan(eqx.Module):
    """The network; arrays are named as in the published state dict."""

    conv1: Conv
    bn1: BatchNorm
    conv2: ConvBlock
    conv3: ConvBlock
    conv4: ConvBlock
    stacks: dict[str, HourGlass | ConvBlock | Conv | BatchNorm]
    """For each stack n: m, top_m_, conv_last, bn_end, l (heat maps) and, but for the last, bl and al (to the next)."""
    count: int = eqx.field(static=True)
    """Number of stacks."""

    def __call__(self, picture: Float[AnyArray, "3 h w"]) -> Float[Array, "68 h4 w4"]:
        """The last stack's heat maps of a picture, RGB in 0..1."""
        return self.all_heat_maps(picture)[-1]

    def all_heat_maps(self, picture: Float[AnyArray, "3 h w"]) -> list[Float[Array, "68 h4 w4"]]:
        """The heat maps of every stack; each refines the one before."""
        x = jax.nn.relu(self.bn1(self.conv1(jnp.moveaxis(jnp.asarray(picture), 0, -1))))
        x = self.conv4(self.conv3(halve(self.conv2(x))))
        answers = []
        for stack in range(self.count):
            y = self.stacks[f"top_m_{stack}"](self.stacks[f"m{stack}"](x))
            y = jax.nn.relu(self.stacks[f"bn_end{stack}"](self.stacks[f"conv_last{stack}"](y)))
            heat_maps = self.stacks[f"l{stack}"](y)
            answers.append(jnp.moveaxis(heat_maps, -1, 0))
            if stack + 1 < self.count:
                x = x + self.stacks[f"bl{stack}"](y) + self.stacks[f"al{stack}"](heat_maps)
        return answers

    def confidence_of(self, heat_maps: Float[AnyArray, "n h w"]) -> Float[Array, "n"]:
        """The height of each map's peak, 0..1: FAN was trained towards peaks of height 1."""
        return jnp.clip(jnp.max(heat_maps, axis=(1, 2)), 0, 1)


def empty_fan(count: int = 4) -> Fan:
    """The network with zero weights."""
    stacks: dict[str, HourGlass | ConvBlock | Conv | BatchNorm] = {}
    for stack in range(count):
        stacks[f"m{stack}"] = _empty_hour_glass()
        stacks[f"top_m_{stack}"] = empty_block(FEATURES, FEATURES)
        stacks[f"conv_last{stack}"] = empty_conv(FEATURES, FEATURES, 1)
        stacks[f"bn_end{stack}"] = empty_batch_norm(FEATURES)
        stacks[f"l{stack}"] = empty_conv(FEATURES, LANDMARKS, 1)
        if stack + 1 < count:
            stacks[f"bl{stack}"] = empty_conv(FEATURES, FEATURES, 1)
            stacks[f"al{stack}"] = empty_conv(LANDMARKS, FEATURES, 1)
    return Fan(
        conv1=empty_conv(3, 64, 7, stride=2),
        bn1=empty_batch_norm(64),
        conv2=empty_block(64, 128),
        conv3=empty_block(128, 128),
        conv4=empty_block(128, FEATURES),
        stacks=stacks,
        count=count,
    )


def empty_block(inputs: int, outputs: int) -> ConvBlock:
    """A block with zero weights."""
    half, quarter = outputs // 2, outputs // 4
    beside = (empty_batch_norm(inputs), None, empty_conv(inputs, outputs, 1, bias=False))
    return ConvBlock(
        bn1=empty_batch_norm(inputs),
        conv1=empty_conv(inputs, half, 3, bias=False),
        bn2=empty_batch_norm(half),
        conv2=empty_conv(half, quarter, 3, bias=False),
        bn3=empty_batch_norm(quarter),
        conv3=empty_conv(quarter, quarter, 3, bias=False),
        downsample=beside if inputs != outputs else None,
    )


def _empty_hour_glass() -> HourGlass:
    names = [f"{branch}_{level}" for level in range(1, DEPTH + 1) for branch in ("b1", "b2", "b3")]
    return HourGlass({name: empty_block(FEATURES, FEATURES) for name in [*names, "b2_plus_1"]})


def read_fan(path: str | Path) -> Fan:
    """The network of a published checkpoint (`read_checkpoint` lists the kinds) or of a converted file.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network.
    """
    return fan_from(read_checkpoint(path))


def fan_from(weights: Weights) -> Fan:
    """As `read_fan`, of weights in memory. Counters of training (`num_batches_tracked`) are passed over."""
    if weights.architecture not in (None, NAME):
        raise ModelError(f"{weights.origin} should hold a FAN, but its metadata names {weights.architecture}")
    arrays = {name: array for name, array in weights.arrays.items() if not name.endswith("num_batches_tracked")}
    count = len({name.split(".")[0] for name in arrays if re.match(r"m\d+\.", name)})
    if not count:
        raise ModelError(
            f"{weights.origin} should hold a FAN with arrays such as m0.b1_4.conv1.weight, got {_some(arrays)}: supply "
            "the checkpoint of the landmark network (3DFAN4-….pth.tar or .zip), not that of a face detector or of depth"
        )
    return fill(lambda: empty_fan(count), Weights(arrays, weights.metadata, weights.origin))


def _some(arrays: dict) -> str:
    return ", ".join(list(arrays)[:3]) or "no arrays"
