"""The encoder that the workbench's own networks share: a stem and three halvings, with residual convolutions."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from workbench.arrays import AnyArray
from workbench.errors import ModelError
from workbench.networks.layers import Conv, empty_conv
from workbench.networks.weights import Weights
from workbench.reading import checked_json, shortened

WIDTHS, BLOCKS = "widths", "blocks"
"""Metadata keys: the channels at 64, 32, 16 and 8 pixels as a JSON list, the residual blocks at 8 pixels."""
MIDDLE, SPREAD = 0.5, 0.25
"""The networks see (picture − 0.5) / 0.25."""
MOST_CHANNELS, MOST_BLOCKS = 8192, 256
"""A file that names more is damaged; the network is built before its arrays are compared."""


class Encoder(eqx.Module):
    """Stem and three levels (d, e), each half as large as the one before."""

    stem: Conv
    e0: Conv
    d1: Conv
    e1: tuple[Conv, ...]
    d2: Conv
    e2: tuple[Conv, ...]
    d3: Conv
    e3: tuple[Conv, ...]

    def features(self, picture: Float[AnyArray, "3 h w"]) -> tuple[Float[Array, "_ _ _"], ...]:
        """Features (height, width, channels) at a quarter of the size of RGB in 0..1, an eighth, a 16th and a 32nd."""
        x = (jnp.moveaxis(picture, 0, -1) - MIDDLE) / SPREAD
        x0 = residual(step(x, self.stem), self.e0)
        x1 = residual(step(x0, self.d1), *self.e1)
        x2 = residual(step(x1, self.d2), *self.e2)
        return x0, x1, x2, residual(step(x2, self.d3), *self.e3)

    @property
    def widths(self) -> tuple[int, int, int, int]:
        """Channels of the four levels, the largest first."""
        return tuple(conv.weight.shape[0] for conv in (self.stem, self.d1, self.d2, self.d3))

    @property
    def passed_on(self) -> int:
        """How many results layers pass on: of each level's first convolution, and of two for each residual one."""
        return 4 + 2 * (1 + len(self.e1) + len(self.e2) + len(self.e3))


def encoder_convolutions(widths: tuple[int, int, int, int], blocks: int) -> dict[str, Conv | tuple[Conv, ...]]:
    """The parts of an `Encoder` with zero weights: channels of each level, residual blocks on the lowest."""
    c0, c1, c2, c3 = widths
    return {
        "stem": empty_conv(3, c0, 7, stride=4),
        "e0": empty_conv(c0, c0, 3),
        "d1": empty_conv(c0, c1, 3, stride=2),
        "e1": tuple(empty_conv(c1, c1, 3) for _ in range(2)),
        "d2": empty_conv(c1, c2, 3, stride=2),
        "e2": tuple(empty_conv(c2, c2, 3) for _ in range(2)),
        "d3": empty_conv(c2, c3, 3, stride=2),
        "e3": tuple(empty_conv(c3, c3, 3) for _ in range(blocks)),
    }


def step(x: Float[Array, "h w c"], conv: Conv) -> Float[Array, "h2 w2 d"]:
    """Convolution and ReLU."""
    return jax.nn.relu(conv(x))


def residual(x: Float[Array, "h w c"], *convs: Conv) -> Float[Array, "h w c"]:
    """x + ReLU(conv(x)), for one convolution after the other."""
    for conv in convs:
        x = x + step(x, conv)
    return x


def network_size(weights: Weights) -> tuple[tuple[int, int, int, int], int]:
    """Widths and blocks, from the metadata of a file. Raises `ModelError`."""
    try:
        widths, blocks = checked_json(weights.metadata[WIDTHS]), checked_json(weights.metadata[BLOCKS])
        c0, c1, c2, c3 = (_counted(width, MOST_CHANNELS) for width in widths)
        return (c0, c1, c2, c3), _counted(blocks, MOST_BLOCKS)
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(
            f"the metadata of {weights.origin} should hold {WIDTHS} (four numbers, for example [32, 64, 128, 192]) and "
            f"{BLOCKS} "
            f"(one number), got {shortened(weights.metadata.get(WIDTHS))} and "
            f"{shortened(weights.metadata.get(BLOCKS))}"
        ) from error


def check_largest(network: Encoder, largest: Float[Array, "layers"] | None, origin: str) -> None:
    """Raises `ModelError` where the largest numbers that layers pass on are known, but not one for each of them."""
    if largest is not None and not (largest.shape == (network.passed_on,) and (largest > 0).all()):
        raise ModelError(
            f"`largest` in {origin} should hold a number above zero for each of the network's {network.passed_on} "
            f"layers, got {largest.size}, the smallest {float(largest.min()):g}: get the file again"
        )


def _counted(number: object, most: int) -> int:
    if not isinstance(number, int) or isinstance(number, bool) or not 1 <= number <= most:
        raise ValueError(f"{number!r} is not a count of at most {most}")
    return number
