"""The workbench's own landmark network: small, so that a Jacobian with one forward pass per parameter is quick.

An encoder with three halvings below its stem and a decoder that adds what it passed: 256×256 colours to 68 heat maps of
64×64. Trained with batch normalisation, which is folded into the convolutions here.
"""

import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, library_of
from workbench.errors import ModelError
from workbench.networks.layers import Conv, empty_conv, enlarge
from workbench.networks.soft_argmax import patch_mass
from workbench.networks.weights import ARCHITECTURE, Weights, fill, read_weights, save_module
from workbench.reading import checked_json, shortened

NAME = "face-energy-landmarks-1"
"""Value of the metadata key `architecture`."""
WIDTHS, BLOCKS = "widths", "blocks"
"""Metadata keys: the channels at 64, 32, 16 and 8 pixels as a JSON list, the residual blocks at 8 pixels."""

MIDDLE, SPREAD = 0.5, 0.25
"""The network sees (picture − 0.5) / 0.25."""
LANDMARKS, PUPILS = 68, 2
MOST_CHANNELS, MOST_BLOCKS = 8192, 256
"""A file that names more is damaged; the network is built before its arrays are compared."""


class Calibration(eqx.Module):
    """A landmark's confidence as a piecewise linear function of its heat map's mass: measured, non-decreasing."""

    mass: Float[Array, "knots"]
    """Ascending, 0..1: the probability in the 3×3 patch around the maximum (`patch_mass`)."""
    confidence: Float[Array, "knots"]
    """0..1."""

    def __call__(self, mass: Float[AnyArray, "n"]) -> Float[AnyArray, "n"]:
        """Linear between the knots, constant beyond the first and last."""
        library = library_of(mass)
        knots = (library.asarray(values, mass.dtype) for values in (self.mass, self.confidence))
        return library.interp(mass, *knots)


class LandmarkNetwork(eqx.Module):
    """Stem, three encoder levels (d, e), three decoder levels (u, f), head; see `__call__`.

    softmax(50·H) over a heat map H is the probability of the landmark's place, which the soft-argmax with β = 50
    (Deep Energies Eq. 3) reads between pixels.
    """

    stem: Conv
    e0: Conv
    d1: Conv
    e1: tuple[Conv, ...]
    d2: Conv
    e2: tuple[Conv, ...]
    d3: Conv
    e3: tuple[Conv, ...]
    u2: Conv
    f2: Conv
    u1: Conv
    f1: Conv
    u0: Conv
    f0: Conv
    head: Conv
    calibration: Calibration | None = None
    pupils: Conv | None = None
    """Beside `head`: heat maps of the person's right and left pupil."""

    def __call__(self, picture: Float[AnyArray, "3 h w"]) -> Float[Array, "n h4 w4"]:
        """Heat maps (68; another network's `outputs`) of a quarter of the picture's size, RGB in 0..1.

        Those of the pupils, where the network has them, are `FrozenNetwork`'s alone.
        """
        x = (jnp.moveaxis(picture, 0, -1) - MIDDLE) / SPREAD
        x0 = _residual(_step(x, self.stem), self.e0)
        x1 = _residual(_step(x0, self.d1), *self.e1)
        x2 = _residual(_step(x1, self.d2), *self.e2)
        x3 = _residual(_step(x2, self.d3), *self.e3)
        x2 = _residual(x2 + enlarge(_step(x3, self.u2)), self.f2)
        x1 = _residual(x1 + enlarge(_step(x2, self.u1)), self.f1)
        x0 = _residual(x0 + enlarge(_step(x1, self.u0)), self.f0)
        return jnp.moveaxis(self.head(x0), -1, 0)

    def confidence_of(self, heat_maps: Float[AnyArray, "n h w"]) -> Float[AnyArray, "n"]:
        """How likely each landmark is found, 0..1: the calibrated mass of its map (the mass itself if uncalibrated)."""
        return confidence_by_mass(patch_mass(heat_maps), self.calibration)

    @property
    def widths(self) -> tuple[int, int, int, int]:
        """Channels at a quarter of the input's size, an eighth, a sixteenth and a 32nd."""
        return tuple(conv.weight.shape[0] for conv in (self.stem, self.d1, self.d2, self.d3))


def confidence_by_mass(mass: Float[AnyArray, "n"], calibration: Calibration | None) -> Float[AnyArray, "n"]:
    """The confidence of landmarks whose heat maps have this `patch_mass`; the mass itself if uncalibrated."""
    return mass if calibration is None else calibration(mass)


def empty_landmark_network(
    widths: tuple[int, int, int, int], blocks: int, knots: int = 0, outputs: int = LANDMARKS, pupils: bool = False
) -> LandmarkNetwork:
    """The network with zero weights: channels per level, residual blocks on the lowest, knots of the calibration."""
    c0, c1, c2, c3 = widths
    return LandmarkNetwork(
        stem=empty_conv(3, c0, 7, stride=4),
        e0=empty_conv(c0, c0, 3),
        d1=empty_conv(c0, c1, 3, stride=2),
        e1=tuple(empty_conv(c1, c1, 3) for _ in range(2)),
        d2=empty_conv(c1, c2, 3, stride=2),
        e2=tuple(empty_conv(c2, c2, 3) for _ in range(2)),
        d3=empty_conv(c2, c3, 3, stride=2),
        e3=tuple(empty_conv(c3, c3, 3) for _ in range(blocks)),
        u2=empty_conv(c3, c2, 1),
        f2=empty_conv(c2, c2, 3),
        u1=empty_conv(c2, c1, 1),
        f1=empty_conv(c1, c1, 3),
        u0=empty_conv(c1, c0, 1),
        f0=empty_conv(c0, c0, 3),
        head=empty_conv(c0, outputs, 1),
        calibration=Calibration(jnp.zeros(knots, jnp.float32), jnp.zeros(knots, jnp.float32)) if knots else None,
        pupils=empty_conv(c0, PUPILS, 1) if pupils else None,
    )


def read_landmark_network(path: str | Path) -> LandmarkNetwork:
    """The network of a safetensors file whose metadata names its widths and blocks.

    Raises `InputError` for a file that cannot be read, `ModelError` for weights of another network and for a
    calibration that is no ascending map into 0..1.
    """
    return landmark_network_from(read_weights(path))


def landmark_network_from(weights: Weights) -> LandmarkNetwork:
    """As `read_landmark_network`, of weights in memory."""
    if weights.architecture != NAME:
        raise ModelError(
            f"{weights.origin} should hold the weights of {NAME}, but its metadata names "
            f"{shortened(weights.architecture)}"
        )
    widths, blocks = network_size(weights)
    mass = weights.arrays.get("calibration.mass")
    knots, pupils = 0 if mass is None else mass.size, "pupils.weight" in weights.arrays
    network = fill(lambda: empty_landmark_network(widths, blocks, knots, pupils=pupils), weights)
    if network.calibration is not None:
        _check_calibration(network.calibration, weights.origin)
    return network


def save_landmark_network(path: str | Path, network: LandmarkNetwork, metadata: dict[str, str] | None = None) -> None:
    """Write the network with what `read_landmark_network` needs; `metadata` is added (licence, training data, ...)."""
    size = {WIDTHS: json.dumps(network.widths), BLOCKS: json.dumps(len(network.e3))}
    save_module(path, network, {**(metadata or {}), ARCHITECTURE: NAME, **size})


def _step(x: Float[Array, "h w c"], conv: Conv) -> Float[Array, "h2 w2 d"]:
    return jax.nn.relu(conv(x))


def _residual(x: Float[Array, "h w c"], *convs: Conv) -> Float[Array, "h w c"]:
    for conv in convs:
        x = x + jax.nn.relu(conv(x))
    return x


def network_size(weights: Weights) -> tuple[tuple[int, int, int, int], int]:
    try:
        widths, blocks = checked_json(weights.metadata[WIDTHS]), checked_json(weights.metadata[BLOCKS])
        c0, c1, c2, c3 = (_counted(width, MOST_CHANNELS) for width in widths)
        return (c0, c1, c2, c3), _counted(blocks, MOST_BLOCKS)
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(
            f"the metadata of {weights.origin} should hold {WIDTHS} (four numbers, as [32, 64, 128, 192]) and {BLOCKS} "
            f"(one number), got {shortened(weights.metadata.get(WIDTHS))} and "
            f"{shortened(weights.metadata.get(BLOCKS))}"
        ) from error


def _counted(number: object, most: int) -> int:
    if not isinstance(number, int) or isinstance(number, bool) or not 1 <= number <= most:
        raise ValueError(f"{number!r} is not a count of at most {most}")
    return number


def _check_calibration(calibration: Calibration, origin: str) -> None:
    mass, confidence = np.asarray(calibration.mass), np.asarray(calibration.confidence)
    in_range = all(((values >= 0) & (values <= 1)).all() for values in (mass, confidence))
    if not (in_range and (np.diff(mass) > 0).all() and (np.diff(confidence) >= 0).all()):
        raise ModelError(
            f"the calibration in {origin} should map ascending masses in 0..1 to confidences in 0..1 that never fall"
        )
