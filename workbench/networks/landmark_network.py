"""The workbench's own landmark network: small, so that a Jacobian with one forward pass per parameter is quick.

An encoder with three halvings below its stem and a decoder that adds what it passed: 256×256 colours to 68 heat maps of
64×64. Trained with batch normalisation, which is folded into the convolutions here.
"""

import json
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from workbench.arrays import AnyArray, library_of
from workbench.errors import ModelError
from workbench.networks.encoder import (
    BLOCKS,
    WIDTHS,
    Encoder,
    check_largest,
    encoder_convolutions,
    network_size,
    residual,
    step,
)
from workbench.networks.layers import Conv, empty_conv, enlarge
from workbench.networks.soft_argmax import patch_mass
from workbench.networks.weights import ARCHITECTURE, Weights, fill, read_weights, save_module
from workbench.reading import shortened

NAME = "face-energy-landmarks-1"
"""Value of the metadata key `architecture`."""
LANDMARKS, PUPILS = 68, 2


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


class LandmarkNetwork(Encoder):
    """The encoder, three decoder levels (u, f) and the head; see `__call__`.

    softmax(50·H) over a heat map H is the probability of the landmark's place, which the soft-argmax with β = 50
    (Deep Energies Eq. 3) reads between pixels.
    """

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
    largest: Float[Array, "layers"] | None = None
    """The largest number that each layer passed on in most training pictures, in the order of `network_graph.py`; with
    them a frozen network computes in bytes."""

    def __call__(self, picture: Float[AnyArray, "3 h w"]) -> Float[Array, "n h4 w4"]:
        """Heat maps (68; another network's `outputs`) of a quarter of the picture's size, RGB in 0..1.

        Those of the pupils, where the network has them, are `FrozenNetwork`'s alone.
        """
        x0, x1, x2, x3 = self.features(picture)
        x2 = residual(x2 + enlarge(step(x3, self.u2)), self.f2)
        x1 = residual(x1 + enlarge(step(x2, self.u1)), self.f1)
        x0 = residual(x0 + enlarge(step(x1, self.u0)), self.f0)
        return jnp.moveaxis(self.head(x0), -1, 0)

    @property
    def passed_on(self) -> int:
        """Those of the encoder, and of each decoder level two convolutions and two sums."""
        return super().passed_on + 3 * 4

    def confidence_of(self, heat_maps: Float[AnyArray, "n h w"]) -> Float[AnyArray, "n"]:
        """How likely each landmark is found, 0..1: the calibrated mass of its map (the mass itself if uncalibrated)."""
        return confidence_by_mass(patch_mass(heat_maps), self.calibration)


def confidence_by_mass(mass: Float[AnyArray, "n"], calibration: Calibration | None) -> Float[AnyArray, "n"]:
    """The confidence of landmarks whose heat maps have this `patch_mass`; the mass itself if uncalibrated."""
    return mass if calibration is None else calibration(mass)


def empty_landmark_network(
    widths: tuple[int, int, int, int],
    blocks: int,
    knots: int = 0,
    outputs: int = LANDMARKS,
    pupils: bool = False,
    layers: int = 0,
) -> LandmarkNetwork:
    """The network with zero weights: channels per level, residual blocks on the lowest, knots of the calibration,
    layers whose largest numbers are known.
    """
    c0, c1, c2, c3 = widths
    return LandmarkNetwork(
        **encoder_convolutions(widths, blocks),
        u2=empty_conv(c3, c2, 1),
        f2=empty_conv(c2, c2, 3),
        u1=empty_conv(c2, c1, 1),
        f1=empty_conv(c1, c1, 3),
        u0=empty_conv(c1, c0, 1),
        f0=empty_conv(c0, c0, 3),
        head=empty_conv(c0, outputs, 1),
        calibration=Calibration(jnp.zeros(knots, jnp.float32), jnp.zeros(knots, jnp.float32)) if knots else None,
        pupils=empty_conv(c0, PUPILS, 1) if pupils else None,
        largest=jnp.zeros(layers, jnp.float32) if layers else None,
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
    knots, layers = weights.size_of("calibration.mass"), weights.size_of("largest")
    pupils = "pupils.weight" in weights.arrays
    network = fill(lambda: empty_landmark_network(widths, blocks, knots, pupils=pupils, layers=layers), weights)
    if network.calibration is not None:
        _check_calibration(network.calibration, weights.origin)
    check_largest(network, network.largest, weights.origin)
    return network


def all_maps(network: LandmarkNetwork) -> Conv:
    """The landmarks' heat maps and the pupils' as one convolution."""
    if network.pupils is None:
        return network.head
    parts = ((network.head.weight, network.pupils.weight), (network.head.bias, network.pupils.bias))
    weight, bias = (jnp.concatenate(both) for both in parts)
    return replace(network.head, weight=weight, bias=bias)


def save_landmark_network(path: str | Path, network: LandmarkNetwork, metadata: dict[str, str] | None = None) -> None:
    """Write the network with what `read_landmark_network` needs; `metadata` is added (licence, training data, ...)."""
    size = {WIDTHS: json.dumps(network.widths), BLOCKS: json.dumps(len(network.e3))}
    save_module(path, network, {**(metadata or {}), ARCHITECTURE: NAME, **size})


def _check_calibration(calibration: Calibration, origin: str) -> None:
    mass, confidence = np.asarray(calibration.mass), np.asarray(calibration.confidence)
    in_range = all(((values >= 0) & (values <= 1)).all() for values in (mass, confidence))
    if not (in_range and (np.diff(mass) > 0).all() and (np.diff(confidence) >= 0).all()):
        raise ModelError(
            f"the calibration in {origin} should map ascending masses in 0..1 to confidences in 0..1 that never "
            "decrease"
        )
